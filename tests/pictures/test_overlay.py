"""Pictures of results: features are drawn at their places, and problems are named in words."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from helpers.cells import flange, frame_pair, pictures, pose, scene

from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Match, NearMiss, Reject, Slot3D, Status
from edged.pictures.captions import REASONS, feature_lines, headline, pose_lines, reasons, size_lines
from edged.pictures.evidence import (
    GOLD,
    GREEN,
    LONGEST_WHISKER_PX,
    MAGENTA,
    RED,
    Residuals,
    features_of,
    magnification,
    missing_outlines,
    residuals,
    slot_outline,
)
from edged.pictures.lettering import shortened, width_of
from edged.pictures.overlay import BADGES, TITLE_HEIGHT_PX, WIDTH_PX, draw_pair
from edged.pictures.view import box_around, view_of, zoom_for
from edged.pipeline import PairInspection, PreparedRig, inspect, judge, prepare
from edged.sim.cell import demo_part
from edged.vision.part.job import Job, MeasurementSpec
from edged.vision.teaching.pair import teach

ELSEWHERE = pose(turn_deg=25.0, tilt_deg=4.0)


@functools.cache
def taught() -> tuple[PreparedRig, Job]:
    """The demo's flange on the small rig."""
    here = flange()
    rig = prepare(here.rig)
    return rig, teach(here.left, here.right, rig.rectification, here.region, "flange")


@functools.cache
def seen() -> tuple[Image, Image, PairInspection]:
    """The flange at another place, and its inspection."""
    rig, job = taught()
    left, right = pictures(rig.rig, scene((demo_part(), ELSEWHERE)), seed=3)
    return left, right, inspect(frame_pair(left, right), job, rig)


def drawn(job: Job, inspection: PairInspection) -> Image:
    """The picture of a result."""
    rig, _ = taught()
    left, right, _ = seen()
    status = judge(inspection).status
    return draw_pair(left, right, rig.rig, job, inspection.measured, inspection.dismissed, status)


def count(picture: Image, colour: tuple[int, ...]) -> int:
    """The number of pixels of exactly this colour."""
    return int((picture == np.array(colour, np.uint8)).all(axis=2).sum())


def with_reject(inspection: PairInspection, reject: Reject) -> PairInspection:
    """The inspection with its parts rejected for a reason."""
    measured = tuple(replace(one, target=replace(one.target, reject=reject)) for one in inspection.measured)
    return replace(inspection, measured=measured)


@pytest.mark.long
def test_a_result_shows_verdict_reference_fits_and_residuals() -> None:
    """The badge is green; both images have gold for the reference, green for others, magenta for
    residuals."""
    _, job = taught()
    picture = drawn(job, seen()[2])

    assert picture.shape[1] == 2 * WIDTH_PX
    assert tuple(picture[TITLE_HEIGHT_PX // 2, 4]) == BADGES[Status.OK][1]
    left, right = np.hsplit(picture, 2)
    for half in (left, right):
        images = half[TITLE_HEIGHT_PX + 44 : TITLE_HEIGHT_PX + 900]
        assert min(count(images, colour) for colour in (GOLD, GREEN, MAGENTA)) > 10


@pytest.mark.slow
def test_a_rejected_result_is_red_and_says_why() -> None:
    """The badge and the mark on the part are red, and every reason has words."""
    _, job = taught()
    inspection = with_reject(seen()[2], Reject.TOLERANCE | Reject.SIGMA_LIMIT)
    picture = drawn(job, inspection)

    assert tuple(picture[TITLE_HEIGHT_PX // 2, 4]) == BADGES[Status.LOW_QUALITY][1]
    assert count(picture, RED) > count(drawn(job, seen()[2]), RED) + 100
    text = headline(job, inspection.measured, ())
    assert "size out of tolerance" in text
    assert "sigma over its limit" in text
    assert set(REASONS) == set(Reject)
    assert reasons(Reject.NONE) == []


@pytest.mark.slow
def test_a_picture_without_a_part_says_what_was_looked_for() -> None:
    """Without a part there are only the title and the images; the title has the best score, if known, and the
    needed one.
    """
    _, job = taught()
    picture = drawn(job, PairInspection((), ()))
    assert picture.shape == (TITLE_HEIGHT_PX + 960, 2 * WIDTH_PX, 3)
    assert count(picture, MAGENTA) == 0
    assert headline(job, (), ()) == "flange: nothing is like it, 0.60 is needed"
    nearest = NearMiss(Match(320.0, 240.0, 0.0, 1.0, 1.0, 0.51), 0.6)
    assert headline(job, (), (), nearest) == "flange: the best scores 0.51, 0.60 is needed"


@pytest.mark.long
def test_many_parts_are_counted_not_written_about_without_end() -> None:
    """Seven parts add at most three rows of numbers to the picture."""
    _, job = taught()
    (one,) = seen()[2].measured
    few, many = (drawn(job, PairInspection((one,) * number, ())) for number in (6, 7))
    assert few.shape[0] < many.shape[0] < few.shape[0] + 60


@pytest.mark.slow
def test_what_no_lens_shows_and_endless_names_do_no_harm() -> None:
    """A circle half a kilometre away and a name of a thousand letters do no harm."""
    _, job = taught()
    far = replace(job.circles[1], name="x" * 1000, centre_mm=np.array([5e5, 3e5, 0.0]))
    strange = replace(job, circles=(*job.circles, far))
    assert drawn(strange, seen()[2]).shape[1] == 2 * WIDTH_PX
    assert shortened("x" * 1000, 100, 22).endswith("…")
    assert width_of(shortened("x" * 1000, 100, 22), 22) <= 100
    assert shortened("c0", 100, 22) == "c0"


def test_residuals_are_edge_minus_projected_curve() -> None:
    """Edges that are moved outwards by some pixels have that residual, in both images."""
    rig, _ = taught()
    (one,) = seen()[2].measured
    for feature in features_of(one):
        for side, (camera, moved) in enumerate(
            ((rig.rig.left, np.eye(4)), (rig.rig.right, rig.rig.right_from_left))
        ):
            view = view_of(seen()[side], camera, moved, (0, 0, 640, 480), 1280)
            curve = view.raw(feature.outline_mm)[::7]
            outward = curve - curve.mean(axis=0)
            edges = curve + 0.25 * outward / np.linalg.norm(outward, axis=1, keepdims=True)
            shifted = replace(feature, edges_px=(edges, edges), weights=(np.ones(len(edges)),) * 2)
            # of an ellipse the way from its middle is not quite its normal
            assert residuals(view, shifted, side).across_px == pytest.approx(
                np.full(len(edges), 0.25), abs=0.02
            )
            assert np.sqrt(np.mean(residuals(view, feature, side).across_px ** 2)) < 0.3


def test_the_magnification_is_one_two_or_five_and_keeps_whiskers_short() -> None:
    """The magnification is 1, 2 or 5 times a power of ten, and keeps 19 of 20 residuals within the longest
    whisker."""
    rng = np.random.default_rng(1)
    for sigma_px in np.geomspace(0.003, 3, 12):
        for scale in (0.5, 1.0, 3.0):
            across = rng.normal(0, sigma_px, 500)
            nothing = np.zeros((500, 2))
            one = Residuals(nothing, nothing, across, np.ones(500, np.bool_), np.zeros(500))
            factor = magnification([one], scale)
            assert f"{factor:e}"[0] in "125"
            lengths = np.quantile(np.abs(across), 0.95) * factor * scale
            assert factor == 1.0 or 0.35 * LONGEST_WHISKER_PX < lengths <= LONGEST_WHISKER_PX
    assert magnification([], 1.0) == 1.0


def test_features_that_were_not_measured_are_where_the_pose_puts_them() -> None:
    """A feature that was not measured is drawn within 0.1 mm of its true place, and named in the table."""
    _, job = taught()
    (one,) = seen()[2].measured
    target = one.target
    left_out = target.circles[-1]
    poorer = replace(target, circles=target.circles[:-1])

    outlines = missing_outlines(job, poorer)

    assert left_out.name in outlines
    assert outlines[left_out.name].mean(axis=0) == pytest.approx(left_out.centre_mm, abs=0.1)
    assert left_out.name not in missing_outlines(job, target)
    lines = {line.name: line.size for line in feature_lines(job, replace(one, target=poorer))}
    assert lines[left_out.name] == "not measured"


def test_a_slots_outline_has_its_size_and_even_steps() -> None:
    """A slot's outline has its length, width and perimeter, in even steps."""
    slot = Slot3D("s", np.array([1.0, 2, 200]), np.array([0.6, 0.8, 0]), 9.0, 4.0, np.eye(5))
    outline = slot_outline(
        slot.centre_mm, (slot.length_mm, slot.width_mm), slot.direction, np.array([0, 0, 1.0])
    )
    steps = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1)

    along = (outline - slot.centre_mm) @ slot.direction
    across = (outline - slot.centre_mm) @ np.array([-0.8, 0.6, 0])
    assert np.ptp(along) == pytest.approx(9, abs=1e-3)
    assert np.ptp(across) == pytest.approx(4, abs=1e-3)
    assert steps.sum() == pytest.approx(2 * 5 + 4 * np.pi, abs=1e-3)
    assert steps.max() < 1.05 * steps.min()


def test_pose_and_sizes_are_those_of_the_target() -> None:
    """The values have place, tilt and turn against teaching with sigma, sizes with tolerances, and
    features not seen."""
    rig, job = taught()
    wanted = (
        MeasurementSpec("bore", "radius", ("c1",), 1.0, 0.05),
        MeasurementSpec("rim", "radius", ("c0",), None, None),
    )
    left, right, _ = seen()
    (one,) = inspect(frame_pair(left, right), replace(job, measurements=wanted), rig).measured
    values = {
        name: (float(value), float(sigma.split()[0].rstrip("°")))
        for name, value, sigma in pose_lines(one.target)
    }

    assert [values[name][0] for name in "xyz"] == pytest.approx(one.target.position_mm, abs=1e-4)
    assert values["tilt"][0] == pytest.approx(4.0, abs=0.2)
    assert values["turn"][0] == pytest.approx(25.0, abs=0.5)
    assert all(0 < sigma < 0.5 for _, sigma in values.values())
    lines = {name: (text, ok) for name, text, ok in size_lines(one.target.measurements)}
    assert lines["bore"][1] is False
    assert lines["bore"][0].endswith("mm, wanted 1 ± 0.05")
    assert lines["rim"][1] is None
    unseen = replace(one.target.measurements[0], value=float("nan"), sigma=float("nan"))
    assert size_lines([unseen]) == [("bore", "not seen, wanted 1 ± 0.05", False)]


@pytest.mark.parametrize("points", [np.array([[600.0, 300], [700, 380]]), np.array([[2.0, 3], [90, 60]])])
def test_small_parts_are_shown_larger_and_whole(points: FloatArray) -> None:
    """The zoomed box lies in the image, has its proportions and holds the part; without a part it is the
    whole image."""
    size = 1280, 960
    zoom = zoom_for([size, size], [points, points])
    x, y, width, height = box_around(size, points, zoom)

    assert 2 < zoom <= 4
    assert width / height == pytest.approx(1280 / 960, rel=0.01)
    assert 0 <= x <= points[:, 0].min() < points[:, 0].max() <= x + width <= 1280
    assert 0 <= y <= points[:, 1].min() < points[:, 1].max() <= y + height <= 960
    nothing = np.zeros((0, 2))
    assert zoom_for([size, size], [nothing, nothing]) == 1.0
    assert box_around(size, nothing, 1.0) == (0, 0, 1280, 960)
    corners = np.array([[0.0, 0], [1279, 959]])
    assert zoom_for([size, size], [points, corners]) == 1.0
