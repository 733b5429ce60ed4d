"""Bad pictures: a stated reason, or the truth with a larger sigma; never a wrong result with a small
sigma."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.cells import PLACE_MM, frame_pair, pictures, pose, region_around, scene
from helpers.flatparts import HONEST, METAL, cell, chi2, only

from edged.domain.arrays import Image
from edged.domain.measurement import Outcome, Reject, Status, Target
from edged.errors import ImageError
from edged.pipeline import locate
from edged.sim.render.scene import Disc, Part, RoundedBox, Surface
from edged.vision.part.job import Job
from edged.vision.teaching.pair import teach

COVER = Surface(albedo=0.3, contrast=0.1, seed=3)
LAMP = Surface(albedo=3.0)


def seen(job: Job, left: Image, right: Image) -> Outcome:
    """The outcome for the pair, with the disc's rig."""
    return locate(frame_pair(left, right), job, cell("disc").rig)


def patient(job: Job, min_support: float = 0.2) -> Job:
    """The job with limits for parts of which half may be hidden."""
    return replace(
        job,
        search=replace(job.search, min_score=0.4),
        limits=replace(job.limits, min_support=min_support),
    )


def whole() -> Target:
    """The target of the part in full view."""
    here = cell("disc")
    return only(seen(here.job, *here.see(pose())))


@pytest.mark.slow
@pytest.mark.parametrize(("shift_mm", "vaguer"), [(25.0, 0.8), (30.0, 1.3)])
def test_a_circle_cut_by_the_border(shift_mm: float, vaguer: float) -> None:
    """A circle partly outside of the picture gives the truth with a larger sigma if little is left of it,
    or is refused for too few edges. The sigma is an estimate, good to about a fifth."""
    here = cell("disc")
    where = pose((PLACE_MM[0], PLACE_MM[1] + shift_mm, PLACE_MM[2]))
    images = here.see(where)
    target = only(seen(patient(here.job), *images))
    assert target.reject is Reject.NONE
    assert chi2(target, here.true_pose(where)[:3, 3]) < HONEST
    assert target.sigma_mm[2] > vaguer * whole().sigma_mm[2]
    assert only(seen(patient(here.job, 0.95), *images)).reject & Reject.FEW_EDGES


@pytest.mark.slow
@pytest.mark.parametrize("hidden", ["left", "right"])
def test_half_hidden_in_one_camera(hidden: str) -> None:
    """A part half hidden from one camera has a larger sigma, or is refused for too few edges."""
    here = cell("disc")
    cover = Part("cover", RoundedBox(10.0, 0.0, 20.0, 40.0), COVER)
    nearer = pose((PLACE_MM[0], PLACE_MM[1], PLACE_MM[2] - 2.0))
    left, right = here.see(pose())
    covered = pictures(here.rig.rig, scene((here.part, pose()), (cover, nearer)), 7)
    images = (covered[0], right) if hidden == "left" else (left, covered[1])
    target = only(seen(patient(here.job), *images))
    assert target.reject is Reject.NONE
    assert chi2(target, here.true_pose(pose())[:3, 3]) < HONEST
    assert target.sigma_mm[2] > 1.3 * whole().sigma_mm[2]
    assert only(seen(patient(here.job, 0.9), *images)).reject & Reject.FEW_EDGES


@pytest.mark.slow
@pytest.mark.parametrize("chamfer_mm", [0.2, 0.3, 0.4, 0.7])
@pytest.mark.parametrize("albedo", [0.45, 0.55])
def test_the_double_edge_of_a_chamfer(chamfer_mm: float, albedo: float) -> None:
    """With rim and foot 1.5 to 5 px apart, on a part taught without a chamfer, the result is the face's
    place or a refusal.

    The foot has the taught radius but lies lower, so the face's holes do not lie in its plane. If blur
    merges both edges, a circle between them fits both pictures, with a larger sigma, and the normal may be
    held by too little.
    """
    here = cell("disc")
    foot = pose()
    foot[:3, 3] += chamfer_mm * foot[:3, 2]
    body = Part("body", Disc(0, 0, 13), replace(METAL, albedo=albedo))
    top = replace(here.part, outline=Disc(0, 0, 13.0 - chamfer_mm))
    images = pictures(here.rig.rig, scene((body, foot), (top, pose())), 7)
    outcome = seen(here.job, *images)
    if outcome.status is Status.OK:
        assert chi2(only(outcome), here.true_pose(pose())[:3, 3]) < HONEST
        assert only(outcome).sigma_mm[0] > 5 * whole().sigma_mm[0]
    else:
        refusals = Reject.TOLERANCE | Reject.AMBIGUOUS_EDGE | Reject.LEFT_RIGHT_MISMATCH | Reject.SIGMA_LIMIT
        assert only(outcome).reject & refusals
    if chamfer_mm > 0.3:
        assert only(outcome).reject & Reject.AMBIGUOUS_EDGE


@pytest.mark.slow
def test_a_second_edge_beside_a_lone_circle() -> None:
    """A bevel of 0.5 mm in similar contrast, with nothing else on the part, is refused unless it was
    taught."""
    here = cell("round")
    foot = pose()
    foot[:3, 3] += 0.5 * foot[:3, 2]
    body = Part("body", Disc(0, 0, 12), replace(METAL, albedo=0.45))
    top = replace(here.part, outline=Disc(0, 0, 11.5))
    images = pictures(here.rig.rig, scene((body, foot), (top, pose())), 7)
    assert not here.job.reference_circle.double
    assert only(locate(frame_pair(*images), here.job, here.rig)).reject == Reject.AMBIGUOUS_EDGE
    region = region_around(here.rig.rig, pose()[:3, 3], 15.0)
    bevelled = teach(*images, here.rig.rectification, region, "bevelled")
    assert bevelled.reference_circle.double
    again = pictures(here.rig.rig, scene((body, foot), (top, pose())), 8)
    assert only(locate(frame_pair(*again), bevelled, here.rig)).reject is Reject.NONE


@pytest.mark.slow
def test_a_saturated_highlight_along_the_edge() -> None:
    """A saturated spot over a sixth of the rim leaves the truth, with a larger sigma."""
    here = cell("disc")
    lamp = Part("lamp", Disc(11.0, 3.0, 7.0), LAMP)
    images = pictures(here.rig.rig, scene((here.part, pose()), (lamp, pose())), 7)
    assert np.mean(images[0] == 255) > 0.01
    target = only(seen(here.job, *images))
    assert target.reject is Reject.NONE
    assert chi2(target, here.true_pose(pose())[:3, 3]) < HONEST
    assert target.sigma_mm[2] > whole().sigma_mm[2]


@pytest.mark.slow
def test_too_much_light_moves_every_edge_alike() -> None:
    """A saturated part looks larger, and the sigma of its radius covers the error."""
    here = cell("disc")
    left, right = here.see(pose())
    brighter = 1.3 * 255.0 / np.percentile(left, 99)
    left, right = (np.minimum(image * brighter, 255).astype(np.uint8) for image in (left, right))
    target = only(seen(here.job, left, right))
    circle, clear = target.circles[0], whole().circles[0]
    assert abs(circle.radius_mm - here.job.reference_circle.radius_mm) < 4 * circle.sigma_radius_mm
    assert circle.sigma_radius_mm > 2 * clear.sigma_radius_mm


@pytest.mark.parametrize("soft", [(True, True), (False, True)])
def test_blur_is_in_the_sigma_of_the_depth(soft: tuple[bool, bool]) -> None:
    """If one or both cameras are out of focus, the depth's sigma is larger and covers the error."""
    here = cell("disc")
    left, right = (
        np.asarray(cv2.GaussianBlur(image, (0, 0), 1.8), np.uint8) if blurred else image
        for image, blurred in zip(here.see(pose()), soft, strict=True)
    )
    target = only(seen(here.job, left, right))
    assert chi2(target, here.true_pose(pose())[:3, 3]) < HONEST
    assert target.sigma_mm[2] > 3 * whole().sigma_mm[2]


def test_noise_is_no_mismatch_of_rows() -> None:
    """With three times the usual noise the rows of both images still agree."""
    here = cell("disc")
    rng = np.random.default_rng(3)
    left, right = (
        np.clip(image + rng.normal(0, 12, image.shape), 0, 255).astype(np.uint8) for image in here.see(pose())
    )
    assert only(seen(here.job, left, right)).epipolar_rms_px < 0.25


@pytest.mark.parametrize(("nearest_mm", "farthest_mm"), [(150.0, 200.0), (210.0, 260.0)])
def test_a_disparity_outside_of_the_range(nearest_mm: float, farthest_mm: float) -> None:
    """A part nearer or farther than the job allows is measured and refused for that."""
    here = cell("disc")
    job = replace(here.job, limits=replace(here.job.limits, depth_mm=(nearest_mm, farthest_mm)))
    outcome = seen(job, *here.see(pose()))
    assert outcome.status is Status.LOW_QUALITY
    assert only(outcome).reject == Reject.OUT_OF_VOLUME


@pytest.mark.slow
def test_a_depth_that_the_size_contradicts() -> None:
    """With a displaced camera, which shifts every disparity, the part is refused for its size or a
    mismatch."""
    here = cell("disc")
    left, right = here.see(pose())
    assert seen(here.job, left, right).status is Status.OK
    for shift_px in (-60, -25, 25, 60):
        outcome = seen(here.job, left, np.roll(right, shift_px, axis=1))
        reasons = [one.reject for one in outcome.targets] + [one.reject for one in outcome.dismissed]
        assert len(reasons) == 1
        assert reasons[0] & (Reject.TOLERANCE | Reject.LEFT_RIGHT_MISMATCH)


@pytest.mark.parametrize("case", ["left twice", "right upside down"])
def test_a_right_image_that_is_none(case: str) -> None:
    """If the right image does not show what the left one shows, there is no target, for a left-right
    mismatch."""
    here = cell("disc")
    left, right = here.see(pose())
    outcome = seen(here.job, left, left if case == "left twice" else right[::-1].copy())
    assert outcome.status is Status.NO_TARGET
    assert [one.reject for one in outcome.dismissed] == [Reject.LEFT_RIGHT_MISMATCH]


@pytest.mark.slow
def test_swapped_images() -> None:
    """With swapped images there is no target, and a candidate of a lenient search is dismissed for a
    mismatch."""
    here = cell("disc")
    left, right = here.see(pose())
    assert seen(here.job, right, left).status is Status.NO_TARGET
    outcome = seen(patient(here.job), right, left)
    assert outcome.status is Status.NO_TARGET
    assert [one.reject for one in outcome.dismissed] == [Reject.LEFT_RIGHT_MISMATCH]


def test_images_of_another_size() -> None:
    """Images of another size than the calibrated cameras' are refused with both sizes."""
    here = cell("disc")
    left, right = here.see(pose())
    with pytest.raises(ImageError, match="right image: 600x480, the rig was calibrated for 640x480"):
        seen(here.job, left, right[:, :600].copy())
