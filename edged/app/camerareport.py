"""Report on two cameras tested for some minutes: what they are, how well they synchronise, what they lose.

Not responsible for: the content of the pictures.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from edged.adapters.aravis import AravisCamera
from edged.app.cameras import CellHead, head_of
from edged.config.cameras import CamerasSection
from edged.errors import CaptureError
from edged.payload import Json

TOGETHER_SHARE = 0.5
"""Share of the time spent on pairs by software trigger; the rest runs both at full rate."""
PERCENTILES = (50, 99)
REST_S = 0.1
"""Pause after a fault; the head decides itself when closed cameras are reopened."""


async def camera_report(devices: Sequence[str], seconds: float) -> Json:
    """Test two cameras, given by address or serial number, for this time. Raises `CaptureError`.

    The report identifies no camera: it contains no serial number and no address.
    """
    sides = {side: {"device": device} for side, device in zip(("left", "right"), devices, strict=True)}
    wide = {
        "source": "aravis",
        "timeout_s": 3.0,
        "max_skew_ms": 1000.0,
        "max_arrival_skew_ms": 1000.0,
        **sides,
    }
    report: Json = {}
    async with _opened({**wide, "trigger": {"mode": "software"}}) as head:
        report["cameras"] = [await _said(camera) for camera in _cameras(head)]
        report["together"] = await together(head, seconds * TOGETHER_SHARE)
    async with _opened({**wide, "trigger": {"mode": "free-run"}}) as head:
        report["full_rate"] = await _full_rate(head, seconds * (1 - TOGETHER_SHARE))
    return report


@contextlib.asynccontextmanager
async def _opened(section: dict[str, Any]) -> Any:
    head = head_of(CamerasSection.model_validate(section))
    try:
        await head.open()
        yield head
    finally:
        await head.close()


def _cameras(head: CellHead) -> list[AravisCamera]:
    return [camera for camera in head.cameras if isinstance(camera, AravisCamera)]


async def _said(camera: AravisCamera) -> Json:
    health = camera.health
    lacks = [] if health is None else [str(lack) for lack in health.lacks]
    gamma = 1.0 if health is None else health.gamma
    return {**asdict(await camera.description()), "lacks": lacks, "gamma": gamma}


async def together(head: CellHead, seconds: float) -> Json:
    """Capture pairs by software trigger for this time; return their number, latency, skew and faults.

    A lasting fault counts once.
    """
    times_ms, skews_us = list[float](), list[float]()
    faults, lasting = Counter[str](), None
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        began_s = time.perf_counter()
        try:
            pair = await head.capture()
        except CaptureError as error:
            faults[type(error).__name__] += error is not lasting
            lasting = error
            await asyncio.sleep(REST_S)
            continue
        times_ms.append((time.perf_counter() - began_s) * 1e3)
        skews_us.append(abs(pair.left.exposed_ns - pair.right.exposed_ns) * 1e-3)
    temperatures = [
        None if (health := camera.health) is None else health.temperature_c for camera in _cameras(head)
    ]
    bounds = [
        None if (health := camera.health) is None else health.clock_bound_ns for camera in _cameras(head)
    ]
    return {
        "pairs": len(times_ms),
        "faults": dict(faults),
        "trigger_to_images_ms": _percentiles(times_ms),
        "skew_us": _percentiles(skews_us),
        "clock_bound_us": [None if bound is None else bound * 1e-3 for bound in bounds],
        "temperature_c": temperatures,
    }


def _percentiles(values: Sequence[float]) -> list[float]:
    return [round(float(value), 3) for value in np.percentile(values, PERCENTILES)] if values else []


async def _full_rate(head: CellHead, seconds: float) -> Json:
    """Let both cameras free-run at full rate; images are received and dropped."""
    cameras = _cameras(head)
    before = [camera.health for camera in cameras]
    began_s = time.monotonic()
    await asyncio.gather(*(_drain(camera, began_s + seconds) for camera in cameras))
    took_s = time.monotonic() - began_s
    figures = []
    for first, camera in zip(before, cameras, strict=True):
        last = camera.health
        counts = {} if first is None or last is None else _difference(asdict(first), asdict(last))
        delay_us = None if last is None else last.packet_delay_us
        rate_hz = round(counts.get("complete", 0) / took_s, 2)
        figures.append({"rate_hz": rate_hz, "packet_delay_us": delay_us, **counts})
    return {"seconds": round(took_s, 1), "cameras": figures}


def _difference(first: Json, last: Json) -> dict[str, int]:
    names = ("complete", "failed", "resent", "lost")
    return {name: last[name] - (first[name] or 0) for name in names if last[name] is not None}


async def _drain(camera: AravisCamera, until_s: float) -> None:
    while (left_s := until_s - time.monotonic()) > 0:
        with contextlib.suppress(CaptureError, TimeoutError):
            async with asyncio.timeout(left_s):
                await camera.frame()
