"""The edge model of a solid, its visible edges, and the measurement of its profiles."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.cells import small_rig
from helpers.edgemodels import CAD, model, seen
from helpers.tilted import lying

from edged.domain.arrays import FloatArray
from edged.files.step import read_step
from edged.vision.geometry.rigid import apply, turn_between
from edged.vision.kernels.jit import for_kernel
from edged.vision.solid.bestfit import disagreement_px
from edged.vision.solid.edgemodel import chains_of, model_of, sampled, widths_of
from edged.vision.solid.forms import with_breaks
from edged.vision.solid.params import SYMMETRY
from edged.vision.solid.profiles import Profiles, adjusted_to, scatter_of
from edged.vision.solid.shifts import find_shifts
from edged.vision.solid.symmetry import like_turns
from edged.vision.solid.visible import Cameras, VisibleSamples, find_neighbours, moved
from edged.vision.teaching.cadbody import body_of


def test_samples_move_in_the_picture_as_the_design_says() -> None:
    """The samples move as the design states for each of the part's six motions, and for wider breaks."""
    where = lying(small_rig(), 30.0, 20.0, 40.0)
    for camera in (0, 1):
        view = Cameras.of(small_rig(), 0)
        for k in range(6):
            twist = np.zeros(6)
            twist[k] = 1e-4
            before = seen(model(), where, camera)
            points = sampled(model(), 0.5).points[before.row]
            there = view.from_rig[camera] @ moved(model(), where, twist)
            after = view.models[camera].project(apply(there, points))
            along = np.einsum("mi,mi->m", after - before.pixels, before.normals)
            assert along == pytest.approx(
                1e-4 * before.design[:, k], abs=1e-6 * np.abs(before.design[:, k]).max()
            )


@pytest.mark.slow
def test_both_edges_of_a_break_lie_apart_by_its_width() -> None:
    """Both edges of a break are its width apart in either face, and only outer edges without a drawn break
    have one."""
    narrow, broken = sampled(model("D3", 0.1), 0.5), sampled(model("D3", 0.4), 0.5)
    assert narrow.sharp.sum() > 1.6 * sampled(model(), 0.5).sharp.sum()
    moves = np.linalg.norm(broken.by_break, axis=1)
    assert set(np.round(moves, 9)) == {0.0, 1.0}
    hub = model("D4", 0.2)  # drawn with its breaks
    beside = np.einsum("ej,ej->e", hub.normals[:, 0], hub.normals[:, 1])
    assert (hub.breaks_mm[np.abs(beside - math.sqrt(0.5)) < 0.01] == 0).all()


@pytest.mark.parametrize("name", ["D1", "D2", "D3", "D4"])
def test_a_body_keeps_the_breaks_that_a_pair_has_shown(name: str) -> None:
    """The width of each edge is kept in the body's line between the same vertices, and read back from it."""
    body = body_of(read_step(CAD / f"{name}.step"), np.eye(4))
    assert body is not None
    plain = model_of(body)
    shown = with_breaks(plain, np.random.default_rng(0).uniform(0.1, 0.6, len(plain.start)))
    widths = widths_of(body.lines[:, :2], shown.sides, shown.breaks_mm)
    again = model_of(replace(body, breaks_mm=widths))
    assert (shown.breaks_mm > 0).any()
    assert np.array_equal(shown.breaks_mm, again.breaks_mm)
    assert np.array_equal(widths, widths_of(body.lines[:, 1::-1], shown.sides, shown.breaks_mm))


def test_neighbours_are_the_edges_that_a_sample_would_meet() -> None:
    """Two parallel edges 3 px apart are each other's neighbours, with the right sign."""
    x = np.arange(20.0, 80.0, 0.7)
    pixels = np.concatenate([np.column_stack([x, np.full_like(x, y)]) for y in (40.0, 43.0)])
    normals = np.tile([0.0, 1.0], (len(pixels), 1))
    curve = np.repeat([4, 5], len(x))
    drawn, near = np.full((100, 100), -1, np.int32), np.empty((len(pixels), 4))
    find_neighbours(pixels, normals, for_kernel(curve, np.int64), drawn, 0.3, 8.0, 1, near)
    assert near[: len(x), 0] == pytest.approx(3.0)
    assert near[len(x) :, 2] == pytest.approx(-3.0)
    assert np.isnan(near[: len(x), 1:]).all()
    assert (drawn == -1).all()


@pytest.mark.parametrize("gap_px", [1.0, 2.0, 4.0])
def test_two_merged_edges_are_measured_as_one_pair(gap_px: float) -> None:
    """A bright break between a dark wall and a grey face, blurred by 0.6 px, is measured to 0.02 px."""
    places = np.arange(-10, 11) * 0.5
    shift, blur = 0.37, 0.6

    def step(at: float) -> FloatArray:
        return np.array([0.5 * (1 + math.erf((x - at) / blur / math.sqrt(2))) for x in places])

    grey = 40.0 + 130.0 * step(shift) - 60.0 * step(shift + gap_px)
    profiles, near = np.tile(grey, (5, 1)), np.full((5, 4), np.nan)
    near[:, 0] = gap_px
    found, weight, height = np.zeros(5), np.zeros(5), np.zeros(5)
    find_shifts(profiles, np.zeros(5, np.int64), near, blur, 2, found, weight, height)
    assert found == pytest.approx(shift, abs=0.02)
    assert (weight > 0).all()
    assert height == pytest.approx(130.0, rel=0.12)  # damped, where both hardly part


def test_light_that_shows_the_upper_ends_of_unseen_breaks_moves_no_part() -> None:
    """If light shows the upper ends of unseen breaks of 0.07 mm, holes grow, outlines shrink, and the pose
    stays.

    With path-traced pictures an edge with no other place would turn the part by up to 0.6 degrees.
    """
    where = lying(small_rig(), 20.0, 20.0, 40.0)
    both = [seen(model(), where, camera) for camera in (0, 1)]
    camera = np.repeat([0, 1], [len(each.row) for each in both])
    samples = VisibleSamples._make(np.concatenate(field) for field in zip(*both, strict=True))
    ones = np.ones(len(camera))
    shown = Profiles(
        samples,
        camera,
        sampled(model(), 0.5).points[samples.row],
        0.07 * samples.by_break,
        100 * ones,
        ones,
        0 * ones,
        0 * ones,
    )
    turned_deg = []
    for unseen in (samples.by_break, 0 * samples.by_break):  # known to be possible, and not
        profiles = replace(shown, seen=samples._replace(by_break=unseen))
        fit = adjusted_to(model(), where, profiles, 0.5, None, alike=True)
        assert fit is not None
        turned_deg.append(math.degrees(turn_between(fit.pose, where)))
        assert apply(fit.pose, model().centre) == pytest.approx(apply(where, model().centre), abs=0.01)
    assert turned_deg[0] < 0.01
    assert turned_deg[1] > 0.2


def test_each_curve_says_by_its_own_scatter_what_it_is_worth() -> None:
    """A curve that is displaced as a whole has a large sigma of its own; one with few samples gets that of
    the others."""
    rng = np.random.default_rng(0)
    counts, offsets = (200, 60, 200, 4), (0.0, 0.8, 0.0, 0.0)
    left = np.concatenate([rng.normal(at, 0.06, many) for many, at in zip(counts, offsets, strict=True)])
    stretch = np.repeat(np.arange(4), counts)
    sigma = [scatter_of(left, stretch, np.ones(len(left), bool))[stretch == k][0] for k in range(4)]
    assert sigma[1] > 0.7
    assert max(sigma[0], sigma[2], sigma[3]) < 0.1


def test_curves_that_the_cameras_see_elsewhere_say_how_far_light_draws() -> None:
    """The disagreement of curves that are 0.6 px to the right or left in one camera is 0.4 px."""
    where = lying(small_rig(), 20.0, 20.0, 40.0)
    both = [seen(model(), where, camera) for camera in (0, 1)]
    camera = np.repeat([0, 1], [len(each.row) for each in both])
    samples = VisibleSamples._make(np.concatenate(field) for field in zip(*both, strict=True))
    points, ones = sampled(model(), 0.5).points[samples.row], np.ones(len(camera))
    profiles = Profiles(samples, camera, points, 0.0 * ones, 100 * ones, ones, 0 * ones, 0 * ones)
    side = np.where(chains_of(samples.curve) % 2 == 0, 1.0, -1.0)
    off = np.where(camera == 0, 0.6 * side, 0.0) * samples.normals[:, 0]
    assert disagreement_px(profiles, off) == pytest.approx(0.6 / math.sqrt(2), rel=0.2)
    assert disagreement_px(profiles, 0 * off) == 0.0


@pytest.mark.slow
def test_turns_that_leave_a_part_like_itself_are_its_rivals() -> None:
    """A flange with four holes has the quarter turns as rivals, an L-shaped plate none."""
    flange = model("D1")
    turns = [math.degrees(math.atan2(one[1, 0], one[0, 0])) % 360 for one in like_turns(flange, (0.0, 0.0))]
    # by half a step at most, from where the lock converges
    near = 0.5 * math.degrees(SYMMETRY.step_rad)
    assert all(any(abs(turn - quarter) <= near for turn in turns) for quarter in (90, 180, 270))
    plate = model("D3")
    assert not like_turns(plate, (float(plate.centre[0]), float(plate.centre[1])))


def test_a_part_hides_its_own_far_side() -> None:
    """From above few samples of the bottom outline are visible."""
    bottom = float(model().vertices[:, 2].max())
    points = sampled(model(), 0.5).points[seen(model(), lying(small_rig(), 0.0, 0.0, 0.0), 0).row]
    low = points[np.abs(points[:, 2] - bottom) < 1e-6]
    assert len(low) < 0.3 * (np.abs(sampled(model(), 0.5).points[:, 2] - bottom) < 1e-6).sum()
