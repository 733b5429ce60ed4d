"""Where on a rounded edge its contour lies: what a pair shows of it, and its part in the pose's sigma."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.cells import small_rig
from helpers.edgemodels import model, seen
from helpers.tilted import lying

from edged.domain.arrays import I64, FloatArray
from edged.vision.geometry.rigid import apply, invert, turn_between
from edged.vision.solid.arcs import across_breaks, arc_shifts, deeper, if_rounded
from edged.vision.solid.bestfit import blocks_alike, jackknife
from edged.vision.solid.edgemodel import are_unbroken, chains_of, sampled
from edged.vision.solid.params import PROFILE
from edged.vision.solid.profiles import Profiles, adjusted_to
from edged.vision.solid.visible import VisibleSamples

BROKEN = replace(model("D3", 0.2), merged_mm=0.3)
WHERE = lying(small_rig(), 25.0, 20.0, 40.0)


def shown() -> Profiles:
    """Profiles of a pair whose edges are at the model's places."""
    samples, both = sampled(BROKEN, 0.5), [seen(BROKEN, WHERE, camera) for camera in (0, 1)]
    camera: I64 = np.repeat([0, 1], [len(each.row) for each in both])
    across, rounded = (
        np.concatenate([of(BROKEN, samples, each) for each in both]) for of in (across_breaks, if_rounded)
    )
    joined = VisibleSamples._make(np.concatenate(field) for field in zip(*both, strict=True))
    ones = np.ones(len(camera))
    return Profiles(joined, camera, samples.points[joined.row], 0 * ones, 100 * ones, ones, across, rounded)


def moved_px(motion_mm: FloatArray) -> FloatArray:
    """(M,) px along the normals in the left camera, of samples that move (M, 3)."""
    visible = seen(BROKEN, WHERE, 0)
    points = sampled(BROKEN, 0.5).points[visible.row]
    moved = small_rig().left.project(apply(WHERE, points + motion_mm))
    return np.asarray(np.einsum("mj,mj->m", moved - visible.pixels, visible.normals))


def test_what_is_open_of_a_break_moves_its_edges_alone() -> None:
    """The free parameters of breaks move broken edges alone: across by the chord, inwards by both faces,
    deeper by an unknown width."""
    samples, visible = sampled(BROKEN, 0.5), seen(BROKEN, WHERE, 0)
    first, second = samples.normals[visible.row, :3], samples.normals[visible.row, 3:]
    broken = ~are_unbroken(visible.curve)
    assert 0 < broken.sum() < len(broken)
    inward_mm = (1 - math.cos(math.pi / 4)) / math.sqrt(3) * 0.3
    for found, motion in (
        (across_breaks(BROKEN, samples, visible), 0.2 * (second - first)),
        (if_rounded(BROKEN, samples, visible), -inward_mm * (first + second)),
        (deeper(BROKEN, visible), np.array([0.0, 0.0, 0.3 / math.sqrt(3)])),
    ):
        assert found[broken] == pytest.approx(moved_px(motion)[broken], abs=0.05)
        assert not found[~broken].any()
        assert np.abs(found).max() > 0.3
    known = replace(BROKEN, merged_mm=0.1)  # its breaks are wide enough to show their form
    assert not if_rounded(known, samples, visible).any()
    assert not deeper(known, visible).any()


@pytest.mark.parametrize("spread", [0.0, 0.25])
def test_a_pair_tells_how_far_its_edges_wander_on_their_arcs(spread: float) -> None:
    """The spread of the edges on their arcs is found, and the pose stays, which it does not with chamfers."""
    profiles = shown()
    arcs = arc_shifts(profiles.seen, profiles.camera, profiles.across_px)
    rng = np.random.default_rng(3)
    off = spread * rng.standard_normal(int(arcs.group.max()) + 1)[arcs.group] * profiles.across_px
    off += 0.05 * rng.standard_normal(len(off))
    fit = adjusted_to(BROKEN, WHERE, replace(profiles, shift_px=off), 1.0, None, alike=False)
    assert fit is not None
    if spread:
        assert fit.arcs.sigma == pytest.approx(spread, rel=0.35)
    else:
        assert fit.arcs.sigma < 0.05
    held = replace(profiles, shift_px=off, across_px=0 * off)  # as if all were chamfers
    as_before = adjusted_to(BROKEN, WHERE, held, 1.0, None, alike=False)
    assert as_before is not None
    errors_mm = [
        float(np.linalg.norm(apply(one.pose, BROKEN.centre) - apply(WHERE, BROKEN.centre)))
        + 0.5 * BROKEN.size_mm * turn_between(one.pose, WHERE)
        for one in (fit, as_before)
    ]
    assert errors_mm[0] < (0.7 * errors_mm[1] if spread else 0.005)


def test_roundings_are_told_from_chamfers_by_where_their_middle_lies() -> None:
    """All edges half a sigma farther inside do not make the part lie deeper."""
    profiles = shown()
    inside = replace(profiles, shift_px=0.5 * profiles.rounded_px)
    fit = adjusted_to(BROKEN, WHERE, inside, 1.0, None, alike=False)
    assert fit is not None
    depth_mm = (apply(fit.pose, BROKEN.centre) - apply(WHERE, BROKEN.centre))[2]
    plain = adjusted_to(BROKEN, WHERE, replace(inside, rounded_px=0 * inside.camera), 1.0, None, alike=False)
    assert plain is not None
    off_mm = (apply(plain.pose, BROKEN.centre) - apply(WHERE, BROKEN.centre))[2]
    assert abs(depth_mm) < 0.2 * abs(off_mm)


def test_nothing_is_left_of_what_the_unknowns_explain() -> None:
    """Freed values do not change with any shift along the arcs."""
    profiles = shown()
    arcs = replace(arc_shifts(profiles.seen, profiles.camera, profiles.across_px), sigma=1e3)
    weights = np.linspace(1.0, 2.0, len(profiles.camera))
    along = np.cos(arcs.group) * profiles.across_px
    both = np.column_stack([along, along + 1.0])
    assert arcs.free(weights, along) == pytest.approx(0.0, abs=1e-5)
    assert arcs.free(weights, both)[:, 1] == pytest.approx(arcs.free(weights, np.ones(len(along))), abs=1e-5)


def test_heights_that_a_pair_had_wrong_cost_the_pose_no_more_than_its_sigma_says() -> None:
    """If each curve is 0.2 mm (rms) higher or deeper than in the model, the pose's error fits a sigma with
    that."""
    profiles, rng = shown(), np.random.default_rng(5)
    curve = chains_of(profiles.seen.curve)
    chi2: dict[float, list[float]] = {0.0: [], 0.2: []}
    for _ in range(10):
        deeper_mm = rng.normal(0.0, 0.2, int(curve.max()) + 1)
        uneven = replace(profiles, shift_px=profiles.seen.design[:, 5] * deeper_mm[curve])
        for height_mm, found in chi2.items():
            model = replace(BROKEN, height_mm=height_mm)
            fit = adjusted_to(model, WHERE, uneven, 1.0, None, alike=True)
            assert fit is not None
            off_mm = (invert(WHERE) @ fit.pose @ np.r_[BROKEN.centre, 1.0])[:3] - BROKEN.centre
            known = PROFILE.correlated * fit.inverse[3:6, 3:6]
            found.append(float(off_mm @ np.linalg.solve(known, off_mm)) / 3)
    assert np.mean(chi2[0.0]) > 4 > 2 > np.mean(chi2[0.2]), chi2


def test_what_faces_one_way_errs_alike() -> None:
    """Light that shifts all edges of one direction in a camera is in the jackknife by directions, and hardly
    in that by curves."""
    rng = np.random.default_rng(3)
    profiles = shown()
    sector, design = blocks_alike(profiles), profiles.seen.design
    _, curve = np.unique(2 * chains_of(profiles.seen.curve) + profiles.camera, return_inverse=True)
    count = len(sector)
    weights, inverse = np.ones(count), np.linalg.inv(design.T @ design)
    ratios = []
    for _ in range(40):
        shift = 0.1 * rng.normal(size=sector.max() + 1)[sector] + 0.02 * rng.normal(size=count)
        twist = inverse @ (design.T @ shift)
        left = shift - design @ twist
        ratios.append(
            [
                twist @ np.linalg.solve(jackknife(design, design, weights, left, inverse, block), twist) / 6
                for block in (curve, sector)
            ]
        )
    by_curve, by_direction = np.median(ratios, axis=0)
    assert by_direction < 3.0
    assert by_curve > 2 * by_direction
