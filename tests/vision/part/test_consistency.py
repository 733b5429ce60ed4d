"""Contradictions to the rig, from a displaced camera or a late image: refused, or in the distance's sigma."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.cells import frame_pair, pose
from helpers.flatparts import HONEST, cell, chi2, only

from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Outcome, Reject, Status, Target
from edged.pipeline import locate
from edged.vision.part.consistency import doubted, scale_deviation, without_doubt
from edged.vision.part.job import usual_tolerance_mm

PLACE = pose((7.5, 1.0, 204.0), turn_deg=12.0, tilt_deg=3.0)


def shifted(image: Image, x_px: float, y_px: float) -> Image:
    """The image of a displaced camera."""
    height, width = image.shape
    move = np.array([[1.0, 0.0, x_px], [0.0, 1.0, y_px]])
    return np.asarray(
        cv2.warpAffine(image, move, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE),
        np.uint8,
    )


def located(name: str, left: Image, right: Image) -> Outcome:
    """The outcome for the pair with the taught job."""
    return locate(frame_pair(left, right), cell(name).job, cell(name).rig)


@functools.cache
def seen(name: str) -> tuple[Image, Image]:
    """Both pictures of the part there."""
    return cell(name).see(PLACE)


@functools.cache
def good(name: str) -> Target:
    """The target measured with cameras in place."""
    return only(located(name, *seen(name)))


def error(name: str, target: Target) -> FloatArray:
    """The error of the position, in the frame of the teaching."""
    return target.position_mm - cell(name).true_pose(PLACE)[:3, 3]


@pytest.mark.long
@pytest.mark.parametrize("name", ["disc", "plate", "round"])
def test_a_good_picture_leaves_no_doubt(name: str) -> None:
    """With matching rows and sizes as taught, no doubt is added to any sigma, and nothing is refused."""
    assert good(name).doubt_mm == 0.0
    assert good(name).reject is Reject.NONE


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "across_px"), [("disc", 0.3), ("disc", -0.45), ("disc", 0.55), ("plate", 0.3), ("round", 0.4)]
)
def test_a_camera_knocked_askew(name: str, across_px: float) -> None:
    """With a camera displaced across the rows, an error of 0.1 mm lies within the sigma, to which a doubt
    is added."""
    left, right = seen(name)
    target = only(located(name, left, shifted(right, across_px, across_px)))
    assert np.linalg.norm(error(name, target)) > 0.05
    assert chi2(target, cell(name).true_pose(PLACE)[:3, 3]) < HONEST
    assert target.doubt_mm > 0.03


@pytest.mark.parametrize("along_px", [0.5, -0.5, 2.0, -2.0])
def test_a_camera_knocked_along_the_rows(along_px: float) -> None:
    """A camera displaced along the rows changes all sizes by one factor: larger sigma, or out of
    tolerance."""
    left, right = seen("disc")
    target = only(located("disc", left, shifted(right, along_px, 0.0)))
    assert abs(error("disc", target)[2]) > 0.1
    assert chi2(target, cell("disc").true_pose(PLACE)[:3, 3]) < HONEST
    assert bool(target.reject & Reject.TOLERANCE) == (abs(along_px) > 0.6)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "moved_mm"), [("disc", 0.3), ("disc", 1.0), ("plate", 0.3), ("round", 1.0)])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_right_image_too_late_along_the_baseline(name: str, moved_mm: float, sign: int) -> None:
    """A part that moved along the baseline between both exposures is refused for its sizes."""
    here = cell(name)
    later = PLACE.copy()
    later[:3, 3] += sign * moved_mm * here.rig.rectification.rectified_from_left[0]
    outcome = located(name, seen(name)[0], here.see(later, 8)[1])
    assert outcome.status is Status.LOW_QUALITY
    assert only(outcome).reject & Reject.TOLERANCE


@pytest.mark.slow
@pytest.mark.parametrize("moved_mm", [-0.1, 0.1, 0.4])
def test_a_right_image_too_late_across_the_baseline(moved_mm: float) -> None:
    """A part that moved across the rows between both exposures is refused for a left-right mismatch."""
    here = cell("disc")
    later = PLACE.copy()
    later[:3, 3] += moved_mm * here.rig.rectification.rectified_from_left[1]
    outcome = located("disc", seen("disc")[0], here.see(later, 8)[1])
    assert outcome.status is not Status.OK
    reasons = [one.reject for one in (*outcome.targets, *outcome.dismissed)]
    assert all(reject & Reject.LEFT_RIGHT_MISMATCH for reject in reasons)


def test_growth_is_what_all_sizes_have_in_common() -> None:
    """If all circles are 0.1 % larger and farther apart, the growth is 0.1 %, also with one hole
    elsewhere; one circle alone gives none."""
    job, target = cell("disc").job, good("disc")
    origin = target.rig_from_part[:3, 3]
    place = {one.name: one for one in job.circles}
    exact = tuple(
        replace(
            circle,
            centre_mm=origin + 1.001 * target.rig_from_part[:3, :3] @ place[circle.name].centre_mm,
            radius_mm=1.001 * place[circle.name].radius_mm,
        )
        for circle in target.circles
    )
    growth, sigma = scale_deviation(job, exact)
    assert growth == pytest.approx(0.001, abs=1e-9)
    assert 0 < sigma < 3e-4
    elsewhere = replace(exact[2], centre_mm=exact[2].centre_mm + np.array([0.3, 0.0, 0.0]))
    assert scale_deviation(job, (*exact[:2], elsewhere))[0] == pytest.approx(0.001, abs=1e-9)
    assert math.isnan(scale_deviation(job, exact[:1])[0])


@pytest.mark.parametrize("name", ["disc", "plate"])
def test_a_doubt_is_in_every_length_and_can_be_taken_out_again(name: str) -> None:
    """A doubt of 0.1 % of the distance adds as much to every radius, and can be removed again."""
    target = good(name)
    vague = doubted(target, 0.001, 60.0)
    distance = float(np.linalg.norm(target.position_mm))
    assert vague.doubt_mm == pytest.approx(0.001 * distance)
    ray = target.position_mm / distance
    more = ray @ (vague.covariance - target.covariance)[:3, :3] @ ray
    assert math.sqrt(more) == pytest.approx(0.001 * distance)
    across = np.cross(ray, [0.0, 1.0, 0.0])
    beside = across @ (vague.covariance - target.covariance)[:3, :3] @ across / (across @ across)
    assert math.sqrt(beside) == pytest.approx(0.001 * 0.5 * 60.0)  # half of what one camera's knock does
    for one, two in zip(target.circles, vague.circles, strict=True):
        added = math.sqrt(two.sigma_radius_mm**2 - one.sigma_radius_mm**2)
        assert added == pytest.approx(0.001 * one.radius_mm)
    for before, after in zip(target.corners, vague.corners, strict=True):
        assert np.trace(after.covariance) > np.trace(before.covariance)
    again = without_doubt(vague, 60.0)
    assert again.doubt_mm == 0.0
    np.testing.assert_allclose(again.covariance, target.covariance, atol=1e-12)
    for edge, same in zip(target.edges, again.edges, strict=True):
        np.testing.assert_allclose(same.covariance, edge.covariance, atol=1e-12)


@pytest.mark.parametrize(
    ("size_mm", "expected_mm"), [(5.0, 0.025), (26.0, 0.05), (100.0, 0.075), (300.0, 0.1), (5000.0, 0.25)]
)
def test_the_usual_tolerance(size_mm: float, expected_mm: float) -> None:
    """The usual tolerance is half of ISO 2768-1 fine, at least half a pixel, plus three sigmas of the
    teaching."""
    assert usual_tolerance_mm(size_mm, 0.02) == expected_mm
    assert usual_tolerance_mm(size_mm, 1.2) == 0.6
    assert usual_tolerance_mm(size_mm, 0.02, 0.01) == pytest.approx(expected_mm + 0.03)


def test_a_taught_job_has_a_tolerance() -> None:
    """A round part gets a tolerance of its radius, the other one of its edges' places."""
    pixel_mm = 205.0 / cell("disc").rig.rectification.focal_px
    limits = cell("disc").job.limits
    assert limits.radius_tolerance_mm == pytest.approx(max(0.05, 0.5 * pixel_mm), abs=0.01)
    assert limits.form_tolerance_mm is None
    limits = cell("plate").job.limits
    assert limits.radius_tolerance_mm is None
    assert limits.form_tolerance_mm is not None
    assert 0.05 <= limits.form_tolerance_mm <= 0.1
