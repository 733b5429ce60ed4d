"""Functions that the worker process runs for calibrations; imported only there.

The rig is solved as on the command line; in addition, the shift of points against the former rig is computed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from pydantic import JsonValue

from edged.domain.arrays import FloatArray, Image
from edged.errors import UserError
from edged.files.rig import rig_text
from edged.setup.calibration import checking, guidance
from edged.setup.calibration.checking import Finding, Limits
from edged.setup.calibration.drafts import Looks, Solution, views_of
from edged.setup.calibration.guidance import Guided
from edged.setup.calibration.views import Calibrated, Views, report_of
from edged.setup.calibration.views import solve as solved_views
from edged.setup.inuse import RigInUse
from edged.setup.pairs import Progress, silent
from edged.vision.boards.board import NominalBoard
from edged.vision.calibration.calibrate import Calibration
from edged.vision.calibration.lenschoice import LensWish, choice_in_words
from edged.vision.calibration.nextbestview import plan_views, volume_points
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply
from edged.vision.geometry.triangulation import triangulate_raw
from edged.vision.part.job import Job

Boards = Sequence[NominalBoard]


def guide(
    pictures: Path,
    boards: Boards,
    looks: Mapping[str, Looks],
    lens: LensWish,
    goal_um: float | None,
    taken: Sequence[FloatArray],
    share: float,
    progress: Progress,
) -> Guided:
    """Calibrate from the views in use, and suggest the next views."""
    views = views_of(pictures, list(looks), boards, looks)
    return guidance.guide(views, lens, goal_um, taken, progress, share=share)


def solve(
    pictures: Path,
    boards: Boards,
    looks: Mapping[str, Looks],
    lens: LensWish,
    former: RigInUse | None,
    about: Mapping[str, str],
    progress: Progress,
) -> Solution:
    """Solve the rig. former : the one in use before."""
    before = None
    with contextlib.suppress(UserError):
        before = None if former is None else former.stereo()
    return solution_of(views_of(pictures, list(looks), boards, looks), lens, about, before, progress)


def check_board(rig: RigInUse, images: tuple[Image, Image], board: NominalBoard, limits: Limits) -> Finding:
    """Check a rig with a pair of a board."""
    return checking.by_board(rig.stereo(), images, [board], limits)


def check_part(
    rig: RigInUse, images: tuple[Image, Image], job: Job, known_mm: Mapping[str, float], limits: Limits
) -> Finding:
    """Check a rig with a pair of a part."""
    return checking.by_part(rig.stereo(), images, job, known_mm, limits)


def solution_of(
    views: Views,
    lens: LensWish,
    about: Mapping[str, str],
    former: StereoRig | None = None,
    progress: Progress = silent,
) -> Solution:
    """Solve, judge, and compare with the former rig. Raises `CalibrationError` if the views give no rig."""
    solved = solved_views(views, lens, progress=progress)
    progress("the report", 0, 0)
    return Solution(
        solved.rig.calibration_id,
        rig_text(solved.rig, solved.quality),
        report_of(solved, about).encode(),
        _figures(solved, former),
    )


def _figures(solved: Calibrated, former: StereoRig | None) -> dict[str, JsonValue]:
    calibration, plan = solved.calibration, plan_views(solved.calibration, 0)
    return {
        "views": {
            **{view.name: {"rms_px": None, "heldout_px": None} for view in solved.views},
            **{
                fit.name: {
                    "rms_px": round(fit.rms_px, 4),
                    "heldout_px": next(
                        (round(view.reprojection_rms_px, 4) for view in solved.held if view.name == fit.name),
                        None,
                    ),
                }
                for fit in calibration.views
            },
        },
        "excluded": dict(calibration.excluded),
        "stereo_rms_px": solved.quality["stereo_rms_px"],
        "epipolar_rms_px": solved.quality["epipolar_rms_px"],
        "held_out": solved.quality["held_out"],
        "lens": choice_in_words(calibration.lenses) if calibration.lenses else None,
        "grade": solved.verdict.grade,
        "verdict": list(solved.verdict.why),
        "notes": [*calibration.notes, *(finding.text for finding in solved.found if finding.remedy)],
        "sigma_um": None if plan is None else [round(1e3 * float(value), 2) for value in plan.sigma_mm],
        "moved_um": None if former is None else moved_um(calibration, former),
    }


def moved_um(calibration: Calibration, former: StereoRig) -> dict[str, JsonValue] | None:
    """Shift of points of the working volume against the former rig, for the same pixels, in µm.

    rms and max of the distance; mean of X, Y, Z. None for cameras with other pictures.
    """
    rig = calibration.rig
    sizes = [[(camera.width, camera.height) for camera in (of.left, of.right)] for of in (rig, former)]
    points = volume_points(calibration)
    if sizes[0] != sizes[1] or not len(points):
        return None
    pixels = rig.left.project(points), rig.right.project(apply(rig.right_from_left, points))
    moved = 1e3 * (points - triangulate_raw(former, *pixels))
    distance = np.linalg.norm(moved, axis=1)
    if not np.isfinite(distance).all():
        return None
    return {
        "rms": round(float(np.sqrt(np.mean(distance**2))), 1),
        "max": round(float(distance.max()), 1),
        "mean": [round(float(value), 1) for value in moved.mean(axis=0)],
    }
