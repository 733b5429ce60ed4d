"""`edged golden`: records where the part lay when the robot's path was taught, from one stereo pair."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from edged.commands.exchanged import SWAPPED, is_swapped
from edged.domain.events import Snapshot
from edged.domain.frames import FramePair
from edged.errors import UserError
from edged.files.golden import golden_file, save_golden
from edged.files.images import load_image
from edged.files.jobs import load_job
from edged.files.outputs import check_folder
from edged.files.rig import load_rig
from edged.owners import as_owner
from edged.pipeline import locate, prepare
from edged.robot.golden import golden_of, golden_target
from edged.robot.orientations import Convention
from edged.robot.picking import frame_of, picked
from edged.robot.reading import reading_of


def golden(rig: Path, job: Path, left: Path, right: Path, console: Console) -> int:
    """Save the golden part of a job beside the rig; 0: saved, 1: not exactly one good part.

    Raises `UserError`.
    """
    loaded, taught = load_rig(rig), load_job(job)
    if loaded.robot_from_rig is None:
        how = "the robot carries it: let its program say GOLDEN" if loaded.flange_from_rig is not None else ""
        raise UserError(f"--rig {rig}: {how or 'not registered to a robot (edged register)'}")
    check_folder(golden_file(rig.resolve(), taught.number).parent)
    pair, prepared = FramePair.of_images(load_image(left), load_image(right)), prepare(loaded)
    outcome = picked(locate(pair, taught, prepared), taught.picking, frame_of(loaded))
    snapshot = Snapshot(
        cycle=0,
        status=outcome.status,
        command=None,
        job=taught.name,
        job_number=taught.number,
        calibration_id=loaded.calibration_id,
        fingerprint="",
        simulated=False,
        exposed_ns=left.stat().st_mtime_ns,  # pictures do not contain their own time
        published_ns=0,
        targets=outcome.targets,
        robot_from_rig=loaded.robot_from_rig,
        registration_covariance=loaded.registration_covariance,
    )
    target = golden_target(snapshot)
    if isinstance(target, str):
        swapped = not outcome.targets and is_swapped(*pair.images, taught, prepared)
        console.print(f"{job}: nothing was kept: {SWAPPED if swapped else target}", markup=False)
        return 1
    place = golden_file(rig, taught.number)
    with as_owner(rig.parent) as folder:
        save_golden(
            golden_file(folder / rig.name, taught.number), golden_of(snapshot, target, taught, loaded)
        )
    registration = loaded.registration_covariance
    found = reading_of(target, loaded.robot_from_rig, registration, Convention.FIXED_XYZ)
    at, sigma = (" ".join(f"{mm:.3f}" for mm in three) for three in (found.position_mm, found.sigma_mm))
    console.print(f"{place}: kept, at {at} mm in the robot's frame, one sigma {sigma} mm", markup=False)
    return 0
