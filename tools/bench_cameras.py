#!/usr/bin/env python3
"""Measure the cameras: latency and skew, lost packets, pulled cables, reconnects, faults, processor time.

    tools/bench cameras [--only PART ...] [--minutes M] [--json FILE]

prints Markdown. Two virtual GigE Vision cameras (1280x960, in a process of their own, in a network name
space of their own) are received by the real Aravis. Every picture carries the time of its exposure in a
pattern over all its pixels: one that is torn, old, or not of the same exposure as its partner counts as
wrong, whatever the receiver says. Skews are of virtual cameras: of the program, not of a wire.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import functools
import gc
import logging
import random
import sys
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from bench_service import enter_namespace, resources
from benching import bench_parser, finish
from cameraworld import ADDRESSES, CameraWorld, exposed_ns_of
from helpers.livecell import LiveCell
from helpers.snapshots import make_target

from edged.adapters.aravis import AravisCamera, AravisSettings
from edged.adapters.modbus import ModbusSettings
from edged.app.cameras import head_of
from edged.cell.stereohead import StereoHead
from edged.config.cameras import CamerasSection, TriggerSection
from edged.domain.arrays import SIDES
from edged.domain.frames import FramePair
from edged.domain.measurement import Outcome, Status
from edged.errors import CaptureError
from edged.logs import fields_of
from edged.plc.registers import Flag

Figures = dict[str, Any]
MODES: dict[str, dict[str, object]] = {
    "software": {},
    "free-run": {"rate_hz": 20.0},
    "action": {},
    "chain": {"output": "Line2", "line": "Line1"},
    "line": {"line": "Line1"},
}
"""Trigger modes and their settings. In "line" a pulse reaches both cameras by a wire, as from a sensor."""
SMALL_PACKET = 1500
POLL_S = 0.002


def head(mode: str = "software", *, timeout_s: float = 1.0, max_skew_ms: float = 100.0) -> StereoHead:
    """A stereo head as the daemon makes it. The skew is measured, not limited: two cores do all the work."""
    section = CamerasSection.model_validate(
        {
            "source": "aravis",
            "timeout_s": timeout_s,
            "max_skew_ms": max_skew_ms,
            "left": {"device": ADDRESSES["left"], "serial": "BENCH-left"},
            "right": {"device": ADDRESSES["right"], "serial": "BENCH-right"},
            "trigger": TriggerSection.model_validate({"mode": mode, **MODES.get(mode, {})}),
        }
    )
    return head_of(section)


@dataclass
class Judge:
    """Checks every published pair against the truth."""

    max_skew_ms: float = 100.0
    good: int = 0
    wrong: list[str] = field(default_factory=list)
    skews_ms: list[float] = field(default_factory=list)

    def look(self, pair: FramePair, asked_ns: int) -> None:
        """Check a pair. asked_ns : host UTC ns of the request; an earlier exposure is old."""
        times = [exposed_ns_of(frame.camera, frame.image) for frame in (pair.left, pair.right)]
        if None in times:
            self.wrong.append("a picture is torn, or the other camera's")
            return
        left_ns, right_ns = (at for at in times if at is not None)
        skew_ms = abs(left_ns - right_ns) * 1e-6
        if skew_ms > self.max_skew_ms:
            self.wrong.append(f"exposures {skew_ms:.1f} ms apart")
        elif min(left_ns, right_ns) < asked_ns:
            self.wrong.append(f"exposed {(asked_ns - min(left_ns, right_ns)) * 1e-6:.2f} ms too early")
        else:
            self.good += 1
            self.skews_ms.append(skew_ms)


def percentiles(values: list[float]) -> str:
    """p50 / p99."""
    p50, p99 = np.percentile(values, (50, 99))
    return f"{p50:.2f} | {p99:.2f}"


def run(script: Callable[[StereoHead], Awaitable[None]], of: StereoHead) -> None:
    """Open the head, run the script, close it."""

    async def main() -> None:
        try:
            await of.open()
            await script(of)
        finally:
            await of.close()

    asyncio.run(main())


# --- latency ------------------------------------------------------------


def latency(world: CameraWorld, options: argparse.Namespace) -> Figures:
    """Time from requesting an exposure to both images in memory, for each trigger mode."""
    print("\n| trigger | trigger to both images p50 ms | p99 | true skew p50 ms | p99 | wrong |")
    print("|---|---:|---:|---:|---:|---:|")
    figures: Figures = {"wrong": []}
    for mode in MODES:
        times_ms: list[float] = []
        judge = Judge()
        try:
            pulse = world.pulse if mode == "line" else None
            run(functools.partial(_time, options.exposures, pulse, times_ms, judge), head(mode))
        except CaptureError as error:
            print(f"| {mode} | the virtual camera does not offer it: {error} |")
            continue
        print(f"| {mode} | {percentiles(times_ms)} | {percentiles(judge.skews_ms)} | {len(judge.wrong)} |")
        figures[mode] = {"times_ms": times_ms, "skews_ms": judge.skews_ms}
        figures["wrong"] += [f"{mode}: {text}" for text in judge.wrong]
    return figures


async def _time(
    count: int, pulse: Callable[[], None] | None, times_ms: list[float], judge: Judge, of: StereoHead
) -> None:
    for number in range(count + 1):
        asked_ns, began_s = time.time_ns(), time.perf_counter()
        coming = asyncio.create_task(of.capture())
        if pulse is not None:
            await asyncio.sleep(0.02)  # BUSY has been published by then
            began_s = time.perf_counter()
            pulse()
        pair = await coming
        if number > 0:  # the first one allocates buffers
            times_ms.append((time.perf_counter() - began_s) * 1e3)
            judge.look(pair, asked_ns)
        await asyncio.sleep(0.02)


# --- lost packets ------------------------------------------------------------


def losses(world: CameraWorld, options: argparse.Namespace) -> Figures:
    """Incomplete frames, with packets of 1500 bytes: 840 per image."""
    print("\n| packets lost | resend | frames | published whole | faults | published and not whole |")
    print("|---:|---|---:|---:|---:|---:|")
    figures: Figures = {}
    for loss in (0.0, 0.001, 0.01):
        for resend in (True, False):
            tally = asyncio.run(_lossy(world, loss, resend, options.frames))
            print(
                f"| {loss * 100:g} % | {'yes' if resend else 'no'} | {options.frames} | {tally['whole']}"
                f" | {tally['fault']} | {tally['wrong']} |"
            )
            figures[f"{loss:g} {'with' if resend else 'without'} resend"] = dict(tally)
    return figures


async def _lossy(world: CameraWorld, loss: float, resend: bool, frames: int) -> Counter[str]:
    settings = AravisSettings(ADDRESSES["left"], packet_size=SMALL_PACKET, resend=resend)
    camera, tally = AravisCamera("left", settings), Counter[str]()
    await camera.open()
    world.fault("left", "packet_loss", loss)
    try:
        for _ in range(frames):
            try:
                async with asyncio.timeout(1.0):
                    await camera.trigger()
                    frame = await camera.frame()
            except (CaptureError, TimeoutError):
                tally["fault"] += 1
            else:
                tally["whole" if exposed_ns_of("left", frame.image) else "wrong"] += 1
    finally:
        world.fault("left", "packet_loss", 0.0)
        await camera.close()
    return tally


# --- cable ------------------------------------------------------------


class Watched(LiveCell):
    """The daemon's loop, handshake and Modbus server on real cameras; the judge takes the place of vision."""

    def __init__(self, period_s: float) -> None:
        super().__init__(ModbusSettings(port=0, validity_s=2.0), period_s)
        self.head = self._asking = _Asking(head())
        self.judge = Judge()

    def _locate(self, pair: FramePair, lap: Callable[[str], None]) -> Outcome:
        self.judge.look(pair, self._asking.asked_ns)
        lap("find")
        return Outcome(Status.OK, (make_target(),))


class _Asking:
    """Records when the head was asked for a pair."""

    def __init__(self, of: StereoHead) -> None:
        self._head, self.asked_ns = of, 0

    async def open(self) -> None:
        await self._head.open()

    async def capture(self) -> FramePair:
        self.asked_ns = time.time_ns()
        return await self._head.capture()

    async def close(self) -> None:
        await self._head.close()


async def _valid(port: int, wanted: bool, limit_s: float = 30.0) -> float:
    """Poll RESULT_VALID as a PLC does until it is as wanted; return that moment in monotonic s."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    deadline_s = time.monotonic() + limit_s
    try:
        while time.monotonic() < deadline_s:
            writer.write(b"\0\1\0\0\0\6\1\4" + (300).to_bytes(2, "big") + b"\0\x08")
            words = (await reader.readexactly(9 + 16))[9:]
            if bool(int.from_bytes(words[14:16], "big") & Flag.VALID) == wanted:
                return time.monotonic()
            await asyncio.sleep(POLL_S)
    finally:
        writer.close()
        await writer.wait_closed()
    raise TimeoutError(f"RESULT_VALID did not become {wanted} within {limit_s:g} s")


def cable(world: CameraWorld, options: argparse.Namespace) -> Figures:
    """Time from pulling a cable to RESULT_VALID = 0 on Modbus, and from its return to RESULT_VALID = 1."""
    gone_s, back_s = [], []
    rng = random.Random(1)
    with Watched(period_s=0.1) as cell:
        for number in range(options.pulls):
            asyncio.run(_valid(cell.port, wanted=True))
            time.sleep(rng.uniform(0.3, 0.5))
            side = SIDES[number % 2]
            pulled_s = time.monotonic()
            world.fault(side, "unplugged", True)
            gone_s.append(asyncio.run(_valid(cell.port, wanted=False)) - pulled_s)
            time.sleep(rng.uniform(0.5, 4.0))
            returned_s = time.monotonic()
            world.fault(side, "unplugged", False)
            back_s.append(asyncio.run(_valid(cell.port, wanted=True)) - returned_s)
        wrong = cell.judge.wrong
    print("\n| through the daemon's Modbus server, 10 cycles/s | p50 s | largest |\n|---|---:|---:|")
    both = {"pulled cable to RESULT_VALID = 0": gone_s, "return to RESULT_VALID = 1": back_s}
    for name, times_s in both.items():
        print(f"| {name} ({options.pulls} times) | {np.median(times_s):.2f} | {max(times_s):.2f} |")
    print(f"\n{cell.judge.good} pairs, {len(wrong)} wrong")
    return {"gone_s": gone_s, "back_s": back_s, "wrong": wrong}


# --- reconnects ------------------------------------------------------------


def reconnects(_world: CameraWorld, options: argparse.Namespace) -> Figures:
    """Open, take one pair, close, again and again; report leaks."""
    marks: list[tuple[int, float, int, int]] = []
    failed = Counter[str]()

    async def main() -> None:
        for number in range(options.reconnects + 1):
            one = head()
            try:
                await one.open()
                await one.capture()
            except CaptureError as error:  # a busy machine loses packets; only leaks count
                failed[type(error).__name__] += 1
            finally:
                await one.close()
            del one
            if number in (options.reconnects // 10, options.reconnects):
                await asyncio.sleep(1.0)  # until threads that are ending have ended
                gc.collect()
                marks.append((number, *resources()))

    began_s = time.monotonic()
    asyncio.run(main())
    each_ms = (time.monotonic() - began_s) / options.reconnects * 1e3
    print("\n| connections of both cameras | memory MiB | descriptors | threads |\n|---:|---:|---:|---:|")
    for number, memory, files, threads in marks:
        print(f"| {number} | {memory:.1f} | {files} | {threads} |")
    print(f"\n{each_ms:.0f} ms for open, one pair and close; without a pair: {_counted(failed) or 'none'}")
    return {"marks": marks, "each_ms": each_ms, "failed": failed}


# --- faults ------------------------------------------------------------


class _Lines(logging.Handler):
    """Counts errors of the log, by the number of the fault injected last."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.lines: Counter[int] = Counter()
        self.codes: Counter[int] = Counter()
        self.injected = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.lines[self.injected] += 1
        self.codes[int(fields_of(record).get("fault", 0))] += 1


FAULTS: tuple[tuple[str, str, Any, Any], ...] = (
    ("a cable is pulled", "unplugged", True, False),
    ("a stream stalls", "stalled", True, False),
    ("an image freezes", "frozen", True, False),
    ("frame numbers stand still", "repeat_id", True, False),
    ("a tenth of the packets is lost", "packet_loss", 0.1, 0.0),
    ("images come 1.5 s late", "delay_s", 1.5, 0.0),
)


def _injure(world: CameraWorld, side: str, number: int, lasts_s: float) -> str:
    """Inject one fault for some time; return its name."""
    if number < len(FAULTS):
        name, fault, sick, well = FAULTS[number]
        world.fault(side, fault, sick)
        time.sleep(lasts_s)
        world.fault(side, fault, well)
        return name
    if number == len(FAULTS):
        world.take(side)
        time.sleep(lasts_s)
        world.release(side)
        return "another program takes control"
    world.switch_off(side)
    if number == len(FAULTS) + 1:
        time.sleep(lasts_s)
        world.switch_on(side)
        return "a camera is switched off and on"
    world.switch_on(side, "STRANGER")
    time.sleep(lasts_s)
    world.switch_off(side)
    world.switch_on(side)
    return "another camera is put there"


def faults(world: CameraWorld, options: argparse.Namespace) -> Figures:
    """Random faults of random length every few seconds, at 10 cycles/s, through loop and Modbus server."""
    rng, kinds, lines = random.Random(options.seed), Counter[str](), _Lines()
    logging.getLogger("edged").addHandler(lines)
    heal_s: list[tuple[str, float]] = []
    with Watched(period_s=0.1) as cell:
        asyncio.run(_valid(cell.port, wanted=True))
        time.sleep(2.0)
        before = resources()
        until_s = time.monotonic() + 60 * options.minutes
        while time.monotonic() < until_s:
            lines.injected += 1
            side = rng.choice(SIDES)
            name = _injure(world, side, rng.randrange(len(FAULTS) + 3), rng.uniform(0.3, 3.0))
            kinds[name] += 1
            ended_s = time.monotonic()
            heal_s.append((name, asyncio.run(_valid(cell.port, wanted=True)) - ended_s))
            # mostly longer than the log's window, in which a repeated fault is only counted
            time.sleep(rng.uniform(0.5, 4.0))
        time.sleep(3.0)
        gc.collect()
        after = resources()
    logging.getLogger("edged").removeHandler(lines)
    judge, injected = cell.judge, sum(kinds.values())
    print(f"\n{options.minutes:g} minutes at 10 cycles/s, {injected} faults: {_counted(kinds)}.\n")
    print("| | |\n|---|---:|")
    print(f"| good pairs | {judge.good} |\n| wrong pairs published | {len(judge.wrong)} |")
    slowest = max(heal_s, key=lambda one: one[1])
    print(
        f"| end of a fault to RESULT_VALID = 1, p50 | {np.median([took_s for _, took_s in heal_s]):.2f} s |"
    )
    print(f"| the same, largest ({slowest[0]}) | {slowest[1]:.2f} s |")
    most = max(lines.lines.values(), default=0)
    print(f"| errors in the log, in all / most for one fault | {sum(lines.lines.values())} / {most} |")
    for name, first, last in zip(("memory MiB", "descriptors", "threads"), before, after, strict=True):
        print(f"| {name} before / after | {first:.0f} / {last:.0f} |")
    codes = {str(code): count for code, count in sorted(lines.codes.items())}
    print(f"\nerror codes in the log: {_counted(codes)}")
    return {
        "faults": kinds, "good": judge.good, "wrong": judge.wrong, "heal_s": heal_s, "before": before,
        "after": after, "log_lines": sum(lines.lines.values()), "log_most": most, "codes": codes,
    }  # fmt: skip


def _counted(counts: Any) -> str:
    return ", ".join(f"{name} ({count})" for name, count in counts.items())


# --- processor time ------------------------------------------------------------


def processor(_world: CameraWorld, options: argparse.Namespace) -> Figures:
    """Processor time of receiving 2 x 20 images a second, without looking at them."""
    used = [0.0, 0.0, 0.0]

    async def script(of: StereoHead) -> None:
        await of.capture()
        cpu_s, began_s = time.process_time(), time.monotonic()
        for number in range(round(20 * options.seconds)):
            await asyncio.sleep(max(0.0, began_s + number * 0.05 - time.monotonic()))
            with contextlib.suppress(CaptureError):
                await of.capture()
                used[2] += 1
        used[0], used[1] = time.process_time() - cpu_s, time.monotonic() - began_s

    run(script, head())
    cpu_s, wall_s, pairs = used
    print(
        f"\n2 x {pairs / wall_s:.1f} images/s of 1280x960: {cpu_s / wall_s * 100:.0f} % of one core, "
        f"{cpu_s / pairs / 2 * 1e3:.2f} ms for each image"
    )
    return {"cpu_s": cpu_s, "wall_s": wall_s, "pairs": pairs}


PARTS: dict[str, Callable[[CameraWorld, argparse.Namespace], Figures]] = {
    "latency": latency,
    "losses": losses,
    "cable": cable,
    "reconnects": reconnects,
    "faults": faults,
    "processor": processor,
}


def main() -> None:
    """Run the parts one after another."""
    parser = bench_parser(__doc__)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--exposures", type=int, default=100, help="of each trigger mode")
    parser.add_argument("--frames", type=int, default=60, help="for each loss")
    parser.add_argument("--pulls", type=int, default=8)
    parser.add_argument("--reconnects", type=int, default=500)
    parser.add_argument("--minutes", type=float, default=1.0, help="of random faults")
    parser.add_argument("--seconds", type=float, default=10.0, help="of receiving for the processor time")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    enter_namespace()
    logging.getLogger("edged").propagate = False
    logging.getLogger("edged").addHandler(logging.NullHandler())
    figures = {}
    with CameraWorld() as world:
        for part in options.only:
            figures[part] = PARTS[part](world, options)
            sys.stdout.flush()
    finish(options, figures)
    wrong = [text for part in figures.values() for text in part.get("wrong", [])]
    if wrong:
        sys.exit(f"{len(wrong)} wrong: {'; '.join(wrong[:5])}")


if __name__ == "__main__":
    main()
