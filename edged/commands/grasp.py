"""`edged grasp touch`: teaches a grasp from the robot's pose when its tool grips the part."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from edged.commands.exchanged import SWAPPED, is_swapped
from edged.domain.arrays import FloatArray
from edged.domain.frames import FramePair
from edged.domain.measurement import Reject, Target
from edged.domain.numerals import decimal
from edged.domain.picking import Grasp
from edged.errors import UserError
from edged.files.atomic import write_file
from edged.files.images import load_image
from edged.files.jobs import TEXT, job_of, load_job, read_job
from edged.files.jobs.text import grasp_to_toml
from edged.files.rig import load_rig
from edged.pictures.captions import reasons
from edged.pipeline import locate, prepare
from edged.robot.covariance import robot_pose
from edged.robot.grasping import lever_covariance
from edged.robot.orientations import Brand, Convention, transform_of
from edged.robot.picking import frame_of
from edged.robot.reading import reading_of
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import invert


@dataclass(frozen=True, slots=True)
class Touch:
    """The robot's pose and the options of a grasp.

    pose : of the tool's tip, as shown by the controller, numbers separated by commas.
    """

    pose: str
    brand: str
    name: str
    approach_mm: float
    retreat_mm: float
    symmetry: int


def touch(rig: Path, job: Path, left: Path, right: Path, asked: Touch, console: Console) -> int:
    """Add a grasp to a job; 0: written, 1: the part was not found, or is not good. Raises `UserError`.

    left, right : pictures of the part as it lies when the robot grips it.
    """
    loaded, taught = load_rig(rig), load_job(job)
    if loaded.robot_from_rig is None:
        raise UserError(f"--rig {rig}: not registered to a robot beside it (edged register)")
    robot_from_tcp = _pose(asked)
    pair = FramePair.of_images(load_image(left), load_image(right))
    prepared = prepare(loaded)
    outcome = locate(pair, taught, prepared)
    good = [target for target in outcome.targets if target.reject is Reject.NONE]
    if len(good) != 1:
        why_not = sorted({words for target in outcome.targets for words in reasons(target.reject)})
        why = f"{len(good)} good parts, expected one" if good else ", ".join(why_not) or str(outcome.status)
        if not good and is_swapped(*pair.images, taught, prepared):
            why = SWAPPED
        console.print(f"{job}: nothing was written: {why}", markup=False)
        return 1
    frame = frame_of(loaded)
    if not frame.is_mapped(good[0].position_mm):
        raise UserError(f"--rig {rig}: the part lies beyond the map of the robot's error")
    mapped = replace(good[0], robot_shift=frame.shift(good[0].position_mm))
    part_from_tcp = invert(robot_pose(mapped, loaded.robot_from_rig)) @ robot_from_tcp
    grasp = Grasp(
        asked.name,
        part_from_tcp,
        taught.rig_from_part @ part_from_tcp,
        asked.approach_mm,
        asked.retreat_mm,
        asked.symmetry,
    )
    lines = grasp_to_toml(grasp)
    _append(job, lines)
    sigma = " ".join(f"{value:.3f}" for value in _sigma_mm(mapped, part_from_tcp, loaded))
    console.print(f"{job / TEXT}: added, one sigma of the tip {sigma} mm:", markup=False)
    for line in lines:
        console.print(f"  {line}", markup=False, highlight=False)
    return 0


def _pose(asked: Touch) -> FloatArray:
    """Return robot_from_tcp (4, 4)."""
    try:
        brand = Brand(asked.brand.lower())
    except ValueError:
        raise UserError(f"--brand {asked.brand}: expected one of {', '.join(Brand)}") from None
    try:
        return transform_of(brand, tuple(decimal(number.strip()) for number in asked.pose.split(",")))
    except ValueError as error:
        raise UserError(f"--pose {asked.pose}: {error}") from None


def _append(job: Path, lines: list[str]) -> None:
    """Append lines after the user's own text, which is kept; the result is parsed before it is written."""
    files = read_job(job)
    text = files[TEXT].rstrip() + ("\n\n" + "\n".join(lines) + "\n").encode()
    job_of({**files, TEXT: text}, job)
    write_file(job / TEXT, text)


def _sigma_mm(target: Target, part_from_tcp: FloatArray, rig: StereoRig) -> FloatArray:
    """Return sigma (3,) of the tip in the robot's frame for this measurement."""
    pose = target.rig_from_part @ part_from_tcp
    held = replace(target, rig_from_part=pose, covariance=lever_covariance(target, pose, is_any=False))
    registration = rig.registration_covariance
    return reading_of(held, rig.robot_from_rig, registration, Convention.FIXED_XYZ).sigma_mm
