"""`edged locate`: one stereo pair, offline."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from edged.commands.exchanged import SWAPPED, is_swapped
from edged.domain.arrays import FloatArray, Image
from edged.domain.frames import FramePair
from edged.domain.measurement import Outcome, Status, Target
from edged.domain.picking import GraspPose
from edged.domain.stopwatch import Stopwatch
from edged.errors import UserError
from edged.files.atomic import write_file
from edged.files.images import load_image
from edged.files.jobs import load_job
from edged.files.outputs import check_outputs
from edged.files.ply import save_ply
from edged.files.rig import load_rig
from edged.payload import outcome_to_json
from edged.pictures.captions import reasons, why_nothing
from edged.pictures.cloud import cloud_picture
from edged.pipeline import cloud as point_cloud
from edged.pipeline import inspect, judge, prepare
from edged.robot.orientations import Convention
from edged.robot.picking import frame_of, picked
from edged.robot.reading import frame_name, reading_of
from edged.setup.recordings.regression import pictured, within_reach
from edged.vision.geometry.camera import StereoRig


@dataclass(frozen=True, slots=True)
class LocateOutputs:
    """Files to write.

    overlay, cloud : pictures (PNG) of the evidence and of the point cloud; ply : the point cloud itself.
    """

    overlay: Path | None = None
    ply: Path | None = None
    cloud: Path | None = None


def locate(
    rig: Path,
    job: Path,
    left: Path,
    right: Path,
    as_json: bool,
    console: Console,
    outputs: LocateOutputs | None = None,
    convention: str = "fixed_xyz",
) -> int:
    """Locate and print; 0 if a good target was found, else 1.

    convention : meaning of A, B, C in the printed pose, as `modbus.convention`. Raises `UserError`.
    """
    wanted = outputs or LocateOutputs()
    overlay, ply, cloud = wanted.overlay, wanted.ply, wanted.cloud
    check_outputs({"--overlay": overlay, "--ply": ply, "--cloud": cloud}, {"LEFT": left, "RIGHT": right})
    known = {member.name.lower(): member for member in Convention}
    if convention not in known:
        raise UserError(f"--convention {convention!r}: expected one of {', '.join(known)}")
    prepared, taught = prepare(load_rig(rig)), load_job(job)
    pair = FramePair.of_images(load_image(left), load_image(right))
    watch = Stopwatch()
    inspection, frame = inspect(pair, taught, prepared, watch), frame_of(prepared.rig)
    timing_ms = {stage: round(taken_ms, 3) for stage, taken_ms in watch.stages_ms().items()}
    inspection = within_reach(inspection, taught, frame)
    outcome = picked(judge(inspection), taught.picking, frame)
    swapped = outcome.status is not Status.OK and is_swapped(*pair.images, taught, prepared)
    if overlay is not None:
        _write_picture(overlay, pictured(pair.images, inspection, prepared, taught, outcome.status))
    if ply is not None or cloud is not None:
        points = point_cloud(pair, taught, prepared, inspection)
        if ply is not None:
            save_ply(ply, points)
        if cloud is not None:
            best = outcome.targets[0].match if outcome.targets else None
            poses = [part.target.rig_from_part for part in inspection.measured if part.target.match is best]
            _write_picture(cloud, cloud_picture(points, poses[0] if poses else None))
    if as_json:
        print(
            json.dumps(
                outcome_to_json(
                    outcome,
                    cycle=0,
                    calibration=prepared.rig.calibration_id,
                    timing_ms=timing_ms,
                    robot_from_rig=prepared.rig.robot_from_rig,
                    registration=prepared.rig.registration_covariance,
                )
            )
        )
        if swapped:
            sys.stderr.write(f"edged: {SWAPPED}\n")
    elif swapped:
        console.print(f"status {outcome.status}")
        console.print(SWAPPED, soft_wrap=True)
    else:
        _print(outcome, prepared.rig, known[convention], console)
    return 0 if outcome.status is Status.OK else 1


def _write_picture(path: Path, picture: Image) -> None:
    _, png = cv2.imencode(".png", picture)
    write_file(path, png.tobytes())


def _print(outcome: Outcome, rig: StereoRig, convention: Convention, console: Console) -> None:
    console.print(f"status {outcome.status}")
    for target in outcome.targets:
        table = Table(
            title=f"{target.job}, score {target.match.score:.3f}, in the rig's frame", title_justify="left"
        )
        for column in ("", "x mm", "y mm", "z mm", "radius mm", "sigma mm"):
            table.add_column(column, justify="right")
        rows: list[tuple[str, FloatArray, float | None, FloatArray]]
        rows = [("position", target.position_mm, None, target.sigma_mm)]
        rows += [(c.name, c.centre_mm, c.radius_mm, c.sigma_centre_mm) for c in target.circles]
        for name, place, radius, sigma in rows:
            table.add_row(
                name,
                *(f"{value:.4f}" for value in place),
                "" if radius is None else f"{radius:.4f}",
                " ".join(f"{value:.4f}" for value in sigma),
            )
        console.print(table)
        frame = frame_name(rig.robot_from_rig)
        console.print(f"as the PLC reads it: in the {frame}'s frame, A, B, C {convention.name.lower()}")
        console.print(_as_read(target, rig, convention))
        if target.grasp is not None:
            console.print(_taken(target.grasp, rig), markup=False)
        if target.measurements:
            console.print(_measurements(target))
        if target.free_axis is not None:
            console.print("  looks the same from all sides: its rotation about its axis is not known")
        if target.doubt_mm:
            console.print(
                f"  rows or sizes contradict the rig: systematic depth uncertainty {target.doubt_mm:.3f} mm"
            )
        if target.reject:
            console.print(f"  not good: {', '.join(reasons(target.reject))} ({target.reject.name})")
    if outcome.dismissed or not outcome.targets:
        nearest = None if outcome.nearest is None else outcome.nearest.answer
        for line in why_nothing(outcome.dismissed, nearest):
            console.print(line, markup=False, highlight=False)


def _as_read(target: Target, rig: StereoRig, convention: Convention) -> Table:
    table = Table()
    for column in ("", "value", "sigma"):
        table.add_column(column, justify="right")
    reading = reading_of(target, rig.robot_from_rig, rig.registration_covariance, convention)
    for names, unit, values, sigmas in (
        ("XYZ", " mm", reading.position_mm, reading.sigma_mm),
        ("ABC", "°", reading.angles_deg, reading.sigma_deg),
    ):
        for name, value, sigma in zip(names, values, sigmas, strict=True):
            table.add_row(name, f"{value:.3f}{unit}", f"{sigma:.4f}")
    return table


def _taken(grasp: GraspPose, rig: StereoRig) -> str:
    """Return the grasp as text, in the frame of the printed pose."""
    frame_from_rig = np.eye(4) if rig.robot_from_rig is None else rig.robot_from_rig
    shift = np.zeros(3) if grasp.robot_shift is None else grasp.robot_shift.shift_mm
    tip, start = (
        " ".join(f"{value:.3f}" for value in (frame_from_rig @ pose)[:3, 3] + shift)
        for pose in (grasp.rig_from_tcp, grasp.rig_from_approach)
    )
    turn = math.degrees(grasp.turn_rad)
    return f"  grasp {grasp.number} ({grasp.name}), turned by {turn:.1f}°: tip at {tip} mm, from {start} mm"


def _measurements(target: Target) -> Table:
    table = Table(title="measured", title_justify="left")
    for column in ("", "of", "value", "sigma", "nominal", "tolerance", ""):
        table.add_column(column, justify="right")
    verdicts = {True: "OK", False: "NOT OK", None: ""}
    for measurement in target.measurements:
        wanted = (
            "" if value is None else f"{value:.4f}" for value in (measurement.nominal, measurement.tolerance)
        )
        numbers = (f"{measurement.value:.4f} {measurement.unit}", f"{measurement.sigma:.4f}", *wanted)
        table.add_row(measurement.name, measurement.kind, *numbers, verdicts[measurement.ok])
    return table
