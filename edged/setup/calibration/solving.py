"""A draft's views solved: the rig as the command line would write it, and how far points move by it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydantic import JsonValue

from edged.files.rig import rig_text
from edged.setup.calibration.drafts import Solution
from edged.setup.calibration.views import Calibrated, Views, report_of, solve
from edged.setup.pairs import Progress, silent
from edged.vision.calibration.calibrate import Calibration
from edged.vision.calibration.lenschoice import LensWish, choice_in_words
from edged.vision.calibration.nextbestview import plan_views, volume_points
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply
from edged.vision.geometry.triangulation import triangulate_raw


def solution_of(
    views: Views,
    lens: LensWish,
    about: Mapping[str, str],
    former: StereoRig | None = None,
    progress: Progress = silent,
) -> Solution:
    """Solve, judge, and compare with the rig before. Raises `CalibrationError` when the views give no rig."""
    solved = solve(views, lens, progress=progress)
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
    """How far points of the working volume lie from where the former rig saw them in the same pixels, µm.

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
