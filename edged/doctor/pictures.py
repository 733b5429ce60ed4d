"""Takes a few test pictures as the daemon would."""

from __future__ import annotations

import asyncio
import statistics
import time
from collections.abc import Iterator

from edged.app.cameras import camera_facts, camera_gammas, head_of
from edged.config.configuration import Config
from edged.doctor.findings import Check, bad, ok, skip, warn
from edged.domain.frames import FramePair
from edged.domain.marks import MarksState
from edged.errors import (
    CameraBusy,
    CameraSetupError,
    CameraUnreachable,
    CaptureError,
    EdgedError,
    ExposuresDiffer,
    FileFormatError,
    FrameIncomplete,
    FrameTimeout,
    PairingError,
    WrongCamera,
)
from edged.files.marks import marks_file, marks_of, read_marks
from edged.sim.world import VirtualWorld
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import linear_pair

TRIGGERS = 5
MARKS_NAME = "reference marks"

REMEDIES: dict[type[EdgedError], str] = {
    CameraBusy: "close the viewer, or the daemon that has it: systemctl status 'edged*'",
    WrongCamera: "cables or addresses were swapped: edged cameras lists who is where",
    CameraSetupError: "the setting that the message names, below [cameras.left] or [cameras.right]",
    CameraUnreachable: "cable and power; what answers: edged cameras",
    FrameIncomplete: "packets are lost: MTU, receive buffers and link above; a switch without flow control",
    FrameTimeout: "no image came: trigger source, exposure_us against cameras.timeout_s, firewall above",
    ExposuresDiffer: "hold part and light still between both exposures of cameras.exposure_ratio",
    PairingError: "one trigger for both cameras? cameras.max_skew_ms",
}
"""Remedy by type of error; the first match applies."""


def take_pictures(config: Config, rig: StereoRig | None) -> Iterator[Check]:
    """Open the cameras, take a few pairs, and check that they and the cameras' response fit the rig.

    rig : None before the calibration.
    """
    source, mode = config.cameras.source, config.cameras.trigger.mode
    if mode == "line" or config.cycle.mode == "external" or config.cameras.trigger.first_line:
        yield skip("test pictures", "somebody else triggers the cameras: run it and see")
        return
    try:
        if source.startswith("virtual"):
            with VirtualWorld(gige=source == "virtual") as world:
                yield from asyncio.run(_shoot(config, rig, world))
        else:
            yield from asyncio.run(_shoot(config, rig, None))
    except EdgedError as error:
        yield bad("test pictures", str(error), "CAPTURE_FAULT in every cycle", _remedy(error))


async def _shoot(config: Config, rig: StereoRig | None, world: VirtualWorld | None) -> list[Check]:
    head = head_of(config.cameras, world)
    times_ms, skews_ms, faults = [], [], list[CaptureError]()
    marks: list[Check] = []
    sizes = None if rig is None else [(camera.height, camera.width) for camera in (rig.left, rig.right)]
    try:
        await head.open()
        for _ in range(TRIGGERS):
            start = time.perf_counter()
            try:
                pair = await head.capture()
            except CaptureError as error:
                faults.append(error)
                continue
            times_ms.append((time.perf_counter() - start) * 1e3)
            skews_ms.append(abs(pair.left.exposed_ns - pair.right.exposed_ns) * 1e-6)
            if sizes is not None and [pair.left.image.shape, pair.right.image.shape] != sizes:
                return [
                    bad(
                        "test pictures",
                        f"{pair.left.image.shape[::-1]} and {pair.right.image.shape[::-1]} pixels",
                        "the rig was calibrated for another size: every cycle fails",
                        "calibrate again, or set Width and Height as they were",
                    )
                ]
            if not marks:
                marks += look_at_marks(config, rig, pair)
        facts, gammas = camera_facts(head), camera_gammas(head)
    finally:
        await head.close()
    text = f"{len(times_ms)} of {TRIGGERS} pairs"
    if times_ms:
        text += f", {statistics.median(times_ms):.0f} ms from trigger to both images"
        text += f", skew up to {max(skews_ms):.2f} ms"
    for side, parts in facts.items():
        text += f"; {side}: " + "; ".join(part["text"] for part in parts if part["code"] != "lacks")
    lacking = [
        ok(f"{side} camera", part["text"])
        for side, parts in facts.items()
        for part in parts
        if part["code"] == "lacks"
    ]
    if faults:
        return [
            bad("test pictures", f"{text}; {faults[0]}", "CAPTURE_FAULT in such cycles", _remedy(faults[0])),
            *lacking,
            *marks,
            *_responses(rig, gammas),
        ]
    return [ok("test pictures", text), *lacking, *marks, *_responses(rig, gammas)]


def _responses(rig: StereoRig | None, gammas: dict[str, tuple[float, str]]) -> Iterator[Check]:
    """Warn about each camera whose grey values are, or were at calibration, not proportional to the light."""
    for side, (gamma, linear) in gammas.items():
        measured, then = "edges are measured best where it is 1", "before you calibrate"
        calibrated = 1.0
        if rig is not None:
            calibrated = rig.left.gamma if side == "left" else rig.right.gamma
            measured, then = f"the calibration measured {calibrated:g}", "and calibrate again"
        if gamma != 1.0 or calibrated != 1.0:
            yield warn(
                f"{side} response",
                f"the camera's Gamma is {gamma:g}, and {measured}",
                "a response that the calibration does not know moves every edge: radii by about 10 µm",
                f"set {linear} under cameras.{side}.features {then}",
            )


def _remedy(error: EdgedError) -> str:
    """Return the remedy for the most likely cause."""
    for kind, remedy in REMEDIES.items():
        if isinstance(error, kind):
            return remedy
    return "what the message names"


def look_at_marks(config: Config, rig: StereoRig | None, pair: FramePair) -> Iterator[Check]:
    """Check the marks taught with this calibration, if any; marks of another one are reported elsewhere."""
    place = marks_file(config.cell.rig)
    if rig is None or not place.is_file():
        return
    try:
        taught = marks_of(read_marks(place), place, rig)
    except FileFormatError:  # already reported with the configuration
        return
    if taught is None:
        return
    from edged.vision.marks.tracking import MarksFilter, MarksSettings  # imports the compiler

    settings = MarksSettings(config.marks.material, config.marks.range_k)
    tracker = MarksFilter(taught, settings)
    left, right = linear_pair(rig, *pair.images)
    _, report = tracker.step(tracker.begin(), left, right, pair.exposed_ns)
    seen = f"{report.seen} of {report.taught} are seen"
    if report.state is MarksState.CORRECTED:
        moved = " and ".join(f"{1e3 * (way or 0.0):.0f}" for way in (report.left_mm, report.right_mm))
        yield ok(MARKS_NAME, f"{seen}; the cameras moved by {moved} um since they were taught")
        return
    yield warn(
        MARKS_NAME,
        f"{report.state.name}: {report.why or seen}",
        "results are refused"
        if not report.valid
        else "results are corrected by the last marks that were seen",
        "uncover and wipe them, is it this cell's plate? each dot: edged marks status",
    )
