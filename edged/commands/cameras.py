"""`edged cameras` and `edged grab`: what is on the network, and a pair of its pictures."""

from __future__ import annotations

import asyncio
import json
from dataclasses import asdict
from pathlib import Path

import cv2
from rich.console import Console
from rich.table import Table

from edged.app.cameras import head_of
from edged.app.discovery import aravis_missing, list_cameras
from edged.capture.stereohead import StereoHead
from edged.config import load
from edged.domain import FramePair
from edged.errors import FileFormatError, UserError
from edged.files.atomic import write_atomically
from edged.sim.world import VirtualWorld


def cameras(as_json: bool, console: Console) -> int:
    """List every GenICam camera that answers; 0 when there is one, else 1."""
    if missing := aravis_missing():
        raise UserError(missing)
    found = list_cameras()
    if as_json:
        print(json.dumps([asdict(info) for info in found]))
    elif found:
        table = Table("serial", "vendor", "model", "address", "protocol", "use")
        for info in found:
            table.add_row(
                info.serial, info.vendor, info.model, info.address, info.protocol, info.control or "not asked"
            )
        console.print(table)
    else:
        console.print(
            "no camera answers: cable, power, and is a port of this machine in the camera's network?"
        )
    return 0 if found else 1


def grab(config: Path, output: Path, count: int, name: str, console: Console) -> int:
    """Save pairs of the configured cameras as NAME_NN_left.png, NAME_NN_right.png."""
    section = load(config).cameras
    if section.source.startswith("virtual"):
        with VirtualWorld(gige=section.source == "virtual") as world:
            pairs = asyncio.run(_capture(head_of(section, world), count))
    else:
        pairs = asyncio.run(_capture(head_of(section), count))
    try:
        output.mkdir(parents=True, exist_ok=True)
        for number, pair in enumerate(pairs):
            for side, frame in (("left", pair.left), ("right", pair.right)):
                _, png = cv2.imencode(".png", frame.image)
                write_atomically(output / f"{name}_{number:02d}_{side}.png", png.tobytes())
    except OSError as error:
        raise FileFormatError(f"{output}: cannot be written: {error.strerror or error}") from error
    skew_ms = max(abs(pair.left.exposed_ns - pair.right.exposed_ns) for pair in pairs) * 1e-6
    console.print(f"{len(pairs)} pair(s) in {output}, skew up to {skew_ms:.2f} ms")
    return 0


async def _capture(head: StereoHead, count: int) -> list[FramePair]:
    try:
        await head.open()
        return [await head.capture() for _ in range(count)]
    finally:
        await head.close()
