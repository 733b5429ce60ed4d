"""A step of the joint fit: kernels and plain arithmetic lay, see and solve alike."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.adjustments import choose_widths
from helpers.rigs import make_rig
from naive import curves as naive

from edged.domain.arrays import SIDES, Image
from edged.vision.curves.commonmode import Pairs
from edged.vision.curves.flatcurves import CurvesAt, Freedom, LaidCurves, flattened, lay, move
from edged.vision.curves.jointstep import Solved, solve_step, sums_of
from edged.vision.curves.outlines import (
    Curve,
    Face,
    circle_axes,
    curvatures,
    flat_cameras,
    project_outline,
    projected,
)
from edged.vision.curves.params import BREAKS, SEEN_SHARE
from edged.vision.curves.planestate import (
    fit_curves,
    hints_at_breaks,
    laid_at,
    px_per_mm_of,
    shown,
    signs_of,
    some_of,
    take_steps,
)
from edged.vision.curves.samples import JointSolution
from edged.vision.curves.sighting import CameraEdges, add_contrasts, look
from edged.vision.edges.subpixel import WIDTHS_PX, edges_at_widths
from edged.vision.geometry.camera import LensModel, StereoRig
from edged.vision.geometry.rigid import about_z, rotation_matrix

AWAY = rotation_matrix(np.array([0.2, -0.15, 0.0])) @ np.array([0.0, 0.0, 1.0])
FACE = Face(np.array([8.0, 3.0, 230.0]), np.vstack([circle_axes(AWAY), AWAY]))
STRETCHES = np.array([[1, 1, 0, -1], [0, 1, 1, 1]])
CURVES = (
    Curve("c", "circle", np.array([1.0, -2.0, 9.0]), 1, height_mm=0.7),
    Curve("s", "slot", np.array([-3.0, 2.0, 0.4, 9.0, 4.0]), -1, height_mm=-1.5),
    Curve("e", "edge", np.array([4.0, 5.0, 1.1]), 1, length_mm=12.0, signs=STRETCHES),
    Curve("d", "circle", np.array([-5.0, 4.0, 3.0]), -1),
)
FREE = Freedom(1, 1, math.nan)
FREEDOMS = {"free": FREE, "held": Freedom(0, 0, math.nan), "rigid": Freedom(1, 1, 0.02)}


def placed(rig: StereoRig, freedom: Freedom = FREE, curves: tuple[Curve, ...] = CURVES) -> CurvesAt:
    """The curves of the face before the rig."""
    return CurvesAt(*flat_cameras(rig), FACE.flat(), flattened(curves), freedom)


def picture(seed: int) -> Image:
    """Edges everywhere, 1280x960."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, (240, 320)).astype(np.uint8)
    return np.ascontiguousarray(np.kron(coarse, np.ones((4, 4), np.uint8)))


@pytest.mark.parametrize("model", ["division", "brown"])
def test_curves_are_laid_as_each_by_itself(model: LensModel) -> None:
    """Points, normals and speeds are those of `Curve.outline`, with the given spacing in the left image."""
    rig = make_rig(model)
    laid = lay(placed(rig), 2.0)
    for k, curve in enumerate(CURVES):
        rows = slice(*laid.starts[k : k + 2])
        count = rows.stop - rows.start
        middle = FACE.to_rig(np.array([[*curve.parameters[:2], curve.height_mm]]))[0]
        ends = rig.left.project(middle + np.array([[0.0] * 3, 0.01 * FACE.axes[0], 0.01 * FACE.axes[1]]))
        scale = 100.0 * float(np.linalg.norm(ends[1:] - ends[0], axis=1).mean())
        own = curve.outline((np.arange(count) + 0.5) / count, 5.0 / scale)
        for found, expected in zip(laid.outline, own, strict=True):
            np.testing.assert_allclose(found[rows, : expected.shape[1]], expected, rtol=1e-12, atol=1e-12)
        assert not laid.outline.speed[rows, curve.free :].any()
        way = curve.perimeter_mm * scale - (0.0 if curve.closed else 10.0)
        assert count == int(way / 2.0)


@pytest.mark.parametrize(
    "wrong",
    [
        Curve("far", "circle", np.array([0.0, 0.0, 1e6]), 1),
        Curve("none", "circle", np.array([0.0, 0.0, math.nan]), 1),
        Curve("behind", "circle", np.array([0.0, 0.0, 2.0]), 1, height_mm=-300.0),
        Curve("short", "edge", np.array([0.0, 0.0, 0.0]), 1, length_mm=0.1),
    ],
    ids=lambda curve: curve.name,
)
def test_what_no_image_can_show_is_not_laid(wrong: Curve) -> None:
    """One curve behind the cameras, of no size or too large leaves no samples at all, and no exception."""
    laid = lay(placed(make_rig(), FREE, (*CURVES, wrong)), 2.0)
    assert (0,) * 6 == tuple(laid.starts)
    assert len(laid.outline.points) == 0


def test_a_step_moves_as_curve_and_face_do() -> None:
    """Free curves move with the plane, one that moves too far stays, and for a rigid part the face moves."""
    rig, rng = make_rig(), np.random.default_rng(1)
    free = [curve.free for curve in CURVES]
    delta = 0.01 * rng.normal(size=3 + sum(free))
    delta[3 + sum(free[:3]) + 2] = 2.0  # more than half of the small circle's radius
    face, parameters = np.empty((4, 3)), np.empty((len(CURVES), 5))
    assert move(placed(rig), delta, face, parameters)
    expected = FACE.moved(delta[:3])
    np.testing.assert_allclose(face, np.vstack([expected.axes, expected.origin]), atol=1e-12)
    first = 3
    for k, curve in enumerate(CURVES[:3]):
        moved = curve.moved(delta[first : first + free[k]])
        assert moved is not None
        np.testing.assert_allclose(parameters[k, : len(moved.parameters)], moved.parameters, atol=1e-12)
        first += free[k]
    np.testing.assert_array_equal(parameters[3, :3], CURVES[3].parameters)
    together = np.append(0.01 * rng.normal(size=7), np.zeros(sum(free)))
    assert move(placed(rig, FREEDOMS["rigid"]), together, face, parameters)
    plane = FACE.moved(together[:3])
    np.testing.assert_allclose(face[:3], about_z(together[5]).T @ plane.axes, atol=1e-12)
    np.testing.assert_allclose(face[3], plane.origin + together[3:5] @ plane.axes[:2], atol=1e-12)
    np.testing.assert_array_equal(parameters[:, :3], [curve.parameters[:3] for curve in CURVES])


@pytest.mark.parametrize("place", [0, 1, 4])
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e9])
def test_a_step_that_has_run_away_is_none(place: int, value: float) -> None:
    """NaN, a plane turned on its side, or the only circle far away: `move` returns False."""
    delta = np.zeros(6)
    delta[place] = value
    face, parameters = np.empty((4, 3)), np.empty((1, 5))
    assert not move(placed(make_rig(), FREE, CURVES[3:]), delta, face, parameters)


@pytest.mark.parametrize("final", [False, True])
@pytest.mark.parametrize("side", [0, 1])
def test_a_camera_sees_what_its_parts_see(side: int, final: bool) -> None:
    """A camera's edges equal projection, edges at the widths, choice and bend one after the other."""
    rig, image = make_rig(), picture(side)
    at = placed(rig)
    laid = lay(at, 2.0)
    found = look(at, laid, image, side, 2.5, 1.5, final)
    seen, counts = project_outline(rig, SIDES[side], FACE, laid.outline), np.diff(laid.starts)
    signs = np.concatenate([c.signs_at(side, int(n)) for c, n in zip(CURVES, counts, strict=True)])
    widths, step = (WIDTHS_PX, 0.5) if final else (WIDTHS_PX[2:3], 1.0)
    edges = edges_at_widths(image, seen.pixels, seen.normals, 2.5, signs, widths, step)
    edges.offset_px[:, signs == 0] = np.nan
    angle = np.arctan2(seen.normals[:, 1], seen.normals[:, 0])
    rest = [math.sqrt(2) * f(m * angle) for m in (1, 2) for f in (np.cos, np.sin)]
    waves = np.column_stack([np.ones(len(angle)), *rest])
    edge = slice(*laid.starts[2:4])
    way = (np.arange(counts[2]) + 0.5) / counts[2]
    waves[edge, 1:] = math.sqrt(2) * np.cos(np.pi * np.outer(way, np.arange(1, 5)))
    chosen = choose_widths(edges, laid.starts, waves if final else waves[:, :0], 1.5)
    bend = curvatures(seen.pixels, seen.normals, laid.starts)
    bend[edge] = 0.0
    expected = chosen.offset_px + 0.5 * np.repeat(chosen.blur2_px2, counts) * bend
    assert np.isfinite(expected).sum() > 400
    assert np.isnan(expected[edge]).sum() >= counts[2] // 4
    np.testing.assert_allclose(found.offset, expected, atol=1e-9)
    np.testing.assert_allclose(found.base, chosen.base, atol=1e-9)
    np.testing.assert_allclose(found.bias, chosen.bias_px, atol=1e-9)
    np.testing.assert_array_equal(found.clipped, edges.clipped)
    for one, other in zip(found.seen, seen, strict=True):
        np.testing.assert_array_equal(one, other)


def test_contrasts_of_both_images_add_up() -> None:
    """The contrast is the sum of the strong slopes along each curve in both images, whatever their sign."""
    rig, images = make_rig(), (picture(3), picture(4))
    at, total = placed(rig), np.zeros(len(CURVES))
    laid = lay(at, 3.0)
    add_contrasts(at, laid, *images, 4.0, 1.5, total)
    expected = np.zeros(len(CURVES))
    for side, image in zip(SIDES, images, strict=True):
        seen = project_outline(rig, side, FACE, laid.outline)
        slope = np.nan_to_num(
            edges_at_widths(image, seen.pixels, seen.normals, 4.0, 0, WIDTHS_PX[2:3]).slope[0]
        )
        expected += np.add.reduceat(np.where(np.abs(slope) >= 1.5, slope, 0.0), laid.starts[:-1])
    np.testing.assert_allclose(total, expected)


def sights(at: CurvesAt, laid: LaidCurves, seed: int) -> tuple[CameraEdges, CameraEdges]:
    """Edges of both cameras scattered about the curves: some in one camera only, some wrong, none of the
    slot."""
    rng, count = np.random.default_rng(seed), int(laid.starts[-1])
    found = []
    for camera in (at.left, at.right):
        seen = projected(camera, at.face, laid.outline)
        offset = 0.3 * seen.gain / seen.gain.mean() + rng.normal(0, 0.03, count)
        offset[rng.random(count) < 0.05] += 1.5
        base = np.where(rng.random(count) < 0.1, 0.0, rng.uniform(0.5, 1.0, count))
        base[laid.starts[1] + 8 : laid.starts[2]] = 0.0
        offset[base == 0] = np.nan
        bias = rng.uniform(0.01, 0.05, len(CURVES))
        found.append(CameraEdges(seen, offset, base, bias, rng.uniform(0.5, 2.0, 4), rng.random(count) < 0.1))
    return found[0], found[1]


def solved(
    freedom: Freedom, final: bool
) -> tuple[StereoRig, LaidCurves, tuple[CameraEdges, CameraEdges], Solved]:
    """A step with such edges."""
    rig = make_rig()
    at = placed(rig, freedom)
    laid = lay(at, 4.0)
    seen = sights(at, laid, 7)
    return rig, laid, seen, solve_step(at, laid, *seen, final)


@pytest.mark.parametrize("final", [False, True])
@pytest.mark.parametrize("name", FREEDOMS)
def test_the_problem_is_that_of_the_plain_arithmetic(name: str, final: bool) -> None:
    """The rows, designs, shifts, unknowns and priors are those of the plain arithmetic."""
    rig, laid, seen, step = solved(FREEDOMS[name], final)
    samples = step.formed.samples
    offset, base = (np.stack([getattr(one, field) for one in seen]) for field in ("offset", "base"))
    few = slice(*laid.starts[1:3])
    base[:, few] = 0.0
    gain, normals = (np.stack([getattr(one.seen, field) for one in seen]) for field in ("gain", "normals"))
    curves = naive.paired_rows(offset, base, gain, laid.starts, final)
    assert [0, *np.cumsum([len(parts) for parts in curves])] == list(samples.parts)
    assert curves[1] == []
    space = FACE.to_rig(laid.outline.points)
    design = np.stack([one.seen.design for one in seen])
    if final:
        pixels = np.stack([one.seen.pixels for one in seen])
        rows = naive.across_rows(rig, space, pixels, normals)
        design = np.concatenate([design, rows[:, :, None]], axis=2)
        outwards, eye = laid.outline.normals @ FACE.axes[:2], rig.right_from_left
        slant = np.stack(
            [
                np.sum(rays * outwards, axis=1) / np.abs(rays @ AWAY)
                for rays in (space, space + eye[:3, :3].T @ eye[:3, 3])
            ]
        )
        shapes = naive.displaced(normals[0], gain, slant)
    m = 0
    for k, part in enumerate(rows for parts in curves for rows in parts):
        assert samples.starts[k] == m
        for of_left, of_right, value, heavy in part:
            row = of_left @ design[0] + of_right @ design[1]
            np.testing.assert_allclose(samples.design[m], row, rtol=1e-7, atol=1e-7)
            assert samples.values[m] == pytest.approx(value, abs=1e-9)
            assert samples.base[m] == pytest.approx(heavy)
            if final:
                wave = of_left @ shapes[0] + of_right @ shapes[1]
                np.testing.assert_allclose(samples.waves[m], wave, rtol=1e-9, atol=1e-9)
            m += 1
    assert m == len(samples.values)


@pytest.mark.parametrize("final", [False, True])
@pytest.mark.parametrize("name", FREEDOMS)
def test_the_step_is_that_of_the_plain_solver(name: str, final: bool) -> None:
    """The movement of every curve (0 if it is held or not seen) and the residuals are those of the plain
    solver."""
    _, laid, seen, step = solved(FREEDOMS[name], final)
    formed, free = step.formed, [curve.free for curve in CURVES]
    shared = 7 if name == "rigid" else 3
    first = np.cumsum([shared, *free])
    held = {"held": {1, 2, first[0] + 2, first[3] + 2}}.get(name, set())
    used = [u for u in range(first[-1]) if u not in held and not first[1] <= u < first[2]]
    assert used == list(formed.used)
    priors = (sum(u >= shared - 1 for u in used) if name == "rigid" else 0) + (25 if final else 0)
    assert (len(used) + (25 if final else 0), priors) == (formed.unknowns, formed.priors)
    delta, covariance, weights, _ = naive.solve(formed.samples, formed.unknowns, formed.priors)
    sigma = np.sqrt(np.diag(covariance))[: len(used)]
    assert step.rounds
    np.testing.assert_allclose(
        step.delta[used] / sigma, delta[: len(used)] / sigma, atol=0.02 if final else 0.2
    )
    assert not np.delete(step.delta, used).any()
    np.testing.assert_allclose(step.solution.weights, weights, atol=0.02 if final else 0.2)
    moved = np.zeros(len(CURVES))
    for k in range(len(CURVES)):
        unknowns = [*range(shared), *range(first[k], first[k + 1])]
        for one in seen:
            design = one.seen.design[slice(*laid.starts[k : k + 2]), : len(unknowns)]
            moved[k] = max(moved[k], np.abs(design @ step.delta[unknowns]).max())
    np.testing.assert_allclose(step.moved_px, moved)
    offset = np.stack([one.offset for one in seen])
    np.testing.assert_allclose(
        step.points[1], seen[1].seen.pixels + seen[1].seen.normals * offset[1, :, None]
    )
    assert (step.residuals[:, step.weights.min(axis=0) > 0.5] != 0).all()
    for side in range(2):
        for k in range(len(CURVES)):
            rows = slice(*laid.starts[k : k + 2])
            good = (step.weights[side, rows] > 0) & (np.abs(step.residuals[side, rows]) < 0.5)
            assert step.sums.support[side, k] == pytest.approx(good.mean())


def test_nothing_seen_moves_nothing() -> None:
    """Without edges only the rows' shift is unknown, no curve is supported, and nothing raises."""
    at = placed(make_rig())
    laid = lay(at, 4.0)
    left, right = sights(at, laid, 1)
    none = np.zeros_like(left.base)
    step = solve_step(at, laid, left._replace(base=none), right._replace(base=none), True)
    assert (0, 1) == (len(step.formed.used), step.formed.unknowns)
    assert not step.delta.any()
    assert not step.sums.support.any()


def test_curves_of_one_polarity_are_one_kind() -> None:
    """Curves of one polarity share one displacement; kinds are numbered from 0."""
    rig = make_rig()
    for sign, kinds in ((1, 1), (-1, 1), (0, 2)):
        curves = tuple(
            Curve(c.name, c.kind, c.parameters, sign or c.polarity, c.length_mm, c.height_mm) for c in CURVES
        )
        at = placed(rig, FREE, curves)
        laid = lay(at, 4.0)
        left, right = sights(at, laid, 2)
        step = solve_step(at, laid, left, right, True)
        assert sorted(set(step.formed.samples.kinds.tolist())) == list(range(kinds))
        assert step.formed.priors == 12 * kinds + 1


def test_sums_leave_out_what_is_not_seen() -> None:
    """Support, rms, mean and information of two curves equal values computed by hand."""
    weights = np.array([[1.0, 0.5, 0.0, 1.0], [1.0, 1.0, 1.0, 1.0]])
    residuals = np.array([[0.1, 0.6, 0.0, 0.2], [0.0, 0.0, 0.0, 0.0]])
    offset = np.array([[1.0, 2.0, np.nan, 3.0], [0.0, 0.0, 1.0, 1.0]])
    flags = np.array([[True, True, False, False], [False, False, False, True]])
    left_alone = np.array([8, 9, 14, 15]), np.array([0, 2, 4]), np.array([0, 1, 2]), np.zeros(2, bool)
    pairs = Pairs(np.zeros(4, bool), np.array([0.2, 0.4, 0.5, 0.7]), np.ones((2, 4)), *left_alone, np.ones(4))
    known = JointSolution(
        np.zeros(0), np.zeros((0, 0)), np.array([1.0, 0.5, 1.0, 1.0]), np.zeros(4), np.array([100.0, 400.0]),
        np.zeros((2, 2)),
    )  # fmt: skip
    arcs = np.array([2.0, 3.0, 1.0, 1.0])
    sums = sums_of(np.array([0, 2, 4]), arcs, pairs, known, weights, residuals, offset, flags, ~flags)
    np.testing.assert_allclose(sums.support, [[0.5, 0.5], [1.0, 1.0]])
    np.testing.assert_allclose(sums.total, [3.5, 3.0])
    np.testing.assert_allclose(sums.mean, [[2.0 / 1.5, 3.0], [0.0, 1.0]])
    np.testing.assert_allclose(sums.rms, [math.sqrt(0.19 / 3.5), math.sqrt(0.04 / 3.0)])
    np.testing.assert_allclose(sums.information, [[0.0, 0.0, 30.0, 0.0], [0.0, 0.0, 0.0, 400.0]])
    np.testing.assert_allclose(sums.share, [0.3, 0.6])
    assert [[True, False], [False, False]] == sums.clipped.tolist()
    assert [[False, True], [True, False]] == sums.soft.tolist()


def discs(rig: StereoRig, curves: tuple[Curve, ...]) -> tuple[Image, Image]:
    """Both pictures of dark discs in a bright face, slightly blurred."""
    pictures = []
    for side, camera in zip(SIDES, (rig.left, rig.right), strict=True):
        image = np.full((camera.height, camera.width), 190, np.uint8)
        for curve in curves:
            seen = project_outline(rig, side, FACE, curve.spread(400)).pixels
            cv2.fillPoly(image, [np.rint(16 * seen).astype(np.int32)], 60, cv2.LINE_AA, 4)
        pictures.append(cv2.GaussianBlur(image, (0, 0), 1.0))
    return pictures[0], pictures[1]


def in_turn(
    at: CurvesAt,
    images: tuple[Image, Image],
    reaches: tuple[float, ...],
    coarse: int,
    fine: int,
    support: float,
) -> tuple[int, int, CurvesAt, CurvesAt, Solved]:
    """Steps by the single kernels: their number, start and end of the last one, and its edges."""
    made, refined, final = 0, 0, not coarse
    while True:
        reach, laid = reaches[-1 if final else made], lay(at, 1.5 if final else 3.0)
        if final or made:
            at = laid_at(at, at.face, at.curves.parameters, signs_of(at, laid, *images, reach, 1.5))
        left, right = (look(at, laid, images[side], side, reach, 1.5, final) for side in (0, 1))
        step = solve_step(at, laid, left, right, final)
        good = (step.sums.total >= 8) & (step.sums.support.min(axis=0) >= support)
        if final and support and not good.all():
            numbers = np.flatnonzero(good)
            flat = at.curves
            at = at._replace(
                curves=flat._replace(
                    kinds=flat.kinds[numbers],
                    parameters=flat.parameters[numbers],
                    length_mm=flat.length_mm[numbers],
                    height_mm=flat.height_mm[numbers],
                    polarity=flat.polarity[numbers],
                    first=np.zeros(len(numbers) + 1, np.int64),
                )
            )
            continue
        before, face, parameters = at, np.empty((4, 3)), np.empty(at.curves.parameters.shape)
        assert move(at, step.delta, face, parameters)
        at = laid_at(at, face, parameters, at.curves.polarity)
        still = (final or made > 0) and step.moved_px.max() < 0.2
        made, refined = made + (not final), refined + final
        if refined and (still or refined == fine):
            return made, refined, before, at, step
        if not final:
            final = still or made == coarse
            if final and not fine:
                return made, refined, before, at, step


FAR = (6.0, 4.0, 2.5, 2.0)


@pytest.mark.parametrize(
    ("reaches", "coarse", "fine", "support"),
    [((3.0,), 1, 0, 0.0), (FAR, 4, 0, 0.4), (FAR, 3, 4, 0.0), (FAR, 3, 4, 0.4), ((2.0,), 0, 1, 0.4)],
)
def test_steps_in_one_kernel_are_those_of_one_after_the_other(
    reaches: tuple[float, ...], coarse: int, fine: int, support: float
) -> None:
    """The steps in one kernel equal, bit by bit, those of the single kernels one after the other.

    In fine steps a curve that is not there is left out.
    """
    rig, true = make_rig(), (CURVES[0], CURVES[3])
    start = tuple(replace(curve, parameters=curve.parameters + 0.05, polarity=0) for curve in true)
    nothing = replace(CURVES[3], parameters=np.array([12.0, 9.0, 1.5]), polarity=1)
    images, at = discs(rig, true), placed(rig, FREE, (start[0], nothing, start[1]))
    found = take_steps(at, *images, np.array(reaches), coarse, fine, np.array([3.0, 1.5]), 1.5, support)
    made, refined, before, after, step = in_turn(at, images, reaches, coarse, fine, support)
    assert (made, refined) == (found.coarse, found.fine)
    assert ([0, 2] if fine and support else [0, 1, 2]) == found.numbers.tolist()
    assert (coarse > 1 or fine > 0) == (found.polarity == 1).all()
    np.testing.assert_array_equal(found.face, after.face)
    np.testing.assert_array_equal(found.parameters, after.curves.parameters)
    np.testing.assert_array_equal(found.places, before.curves.parameters)
    np.testing.assert_array_equal(found.before, before.face)
    np.testing.assert_array_equal(found.solved.weights, step.weights)
    np.testing.assert_array_equal(found.solved.solution.covariance, step.solution.covariance)
    # a filled outline is half a pixel larger
    np.testing.assert_allclose(
        found.parameters[[0, -1], :2], [curve.parameters[:2] for curve in true], atol=0.02
    )


@pytest.mark.parametrize(("coarse", "fine"), [(4, 0), (3, 4)])
@pytest.mark.parametrize("plain", [True, False])
def test_a_fit_leaves_what_its_result_needs(coarse: int, fine: int, plain: bool) -> None:
    """A fit has state, sums and covariance of its steps, and the whole only where more is to be added."""
    rig, true = make_rig(), (CURVES[0], CURVES[3])
    images, at = discs(rig, true), placed(rig, Freedom(0, 1, math.nan), true)
    asked = (np.array(FAR), coarse, fine, np.array([3.0, 1.5]), 1.5, 0.4)
    found, steps = fit_curves(at, *images, *asked, plain), take_steps(at, *images, *asked)
    for name in ("coarse", "fine", "numbers", "face", "parameters", "polarity"):
        np.testing.assert_array_equal(getattr(found, name), getattr(steps, name))
    for name in ("delta", "points", "weights"):
        np.testing.assert_array_equal(getattr(found, name), getattr(steps.solved, name))
    for value, expected in zip(found.sums, steps.solved.sums, strict=True):
        np.testing.assert_array_equal(value, expected)
    np.testing.assert_array_equal(found.starts, steps.laid.starts)
    solution, used = steps.solved.solution, steps.solved.formed.used
    np.testing.assert_array_equal(found.shifts, solution.bias)
    expected = np.zeros((len(found.delta), len(found.delta)))
    expected[np.ix_(used, used)] = solution.covariance[: len(used), : len(used)]
    np.testing.assert_array_equal(found.covariance, expected)
    assert not expected[1].any()  # a held slope
    row = (solution.delta[-1], solution.covariance[-1, -1]) if fine else (math.nan, math.nan)
    np.testing.assert_array_equal((found.row, found.row_variance), row)
    assert (fine > 0 and not plain) == (found.whole is not None)
    if found.whole is not None:
        np.testing.assert_array_equal(found.whole.solved.residuals, steps.solved.residuals)


def test_curves_that_show_enough_are_kept() -> None:
    """A curve is kept with enough samples in all, and enough of it in both images."""
    support = np.array([[0.9, 0.3, 0.9, 0.5], [0.9, 0.9, 0.9, 0.4]])
    rig = make_rig()
    steps = take_steps(
        placed(rig), *discs(rig, CURVES[:1]), np.array([3.0]), 1, 0, np.array([3.0, 1.5]), 1.5, 0.0
    )
    sums = steps.solved.sums._replace(support=support, total=np.array([50.0, 50.0, 5.0, 12.0]))
    assert [0, 3] == shown(sums, 0.4).tolist()


def test_hints_at_breaks() -> None:
    """A shift of a wide operator, or shifts nearer to those of a usual break, hint; neither does not."""
    rig, true = make_rig(), (CURVES[0], CURVES[3])
    asked = (np.array(FAR), 3, 4, np.array([3.0, 1.5]), 1.5, 0.4)
    steps = take_steps(placed(rig, FREE, true), *discs(rig, true), *asked)
    starts, gain = steps.laid.starts, steps.solved.pairs.gain
    scale = [np.abs(gain[:, a:b]).mean() for a, b in itertools.pairwise(starts)]
    np.testing.assert_allclose(px_per_mm_of(gain, starts), scale)
    assert not hints_at_breaks(steps)
    for wide_px, least in ((0.079, False), (0.081, True)):
        bias = np.zeros((2, 2))
        bias[1, 0] = wide_px
        assert least == hints_at_breaks(steps._replace(solved=steps.solved._replace(bias=bias)))
    usual_px = math.sqrt(0.5) * SEEN_SHARE * BREAKS.usual_mm * np.average(scale, weights=np.diff(starts))
    for factor in (0.99, 1.01):
        shifts = np.full((2, 2), factor * math.sqrt(BREAKS.sharp_px * usual_px))
        solution = steps.solved.solution._replace(bias=shifts)
        solved = steps.solved._replace(solution=solution, bias=np.zeros((2, 2)))
        assert (factor > 1) == hints_at_breaks(steps._replace(solved=solved))


def test_curves_that_are_left_keep_their_stretches() -> None:
    """The signs of a stretch stay with its curve when others are left out."""
    curves = (CURVES[0], CURVES[2], CURVES[3], replace(CURVES[2], signs=-STRETCHES[:, :2]))
    for numbers in ([0, 1, 3], [1], [2], [3]):
        found = some_of(flattened(curves), np.array(numbers))
        for value, expected in zip(found, flattened([curves[k] for k in numbers]), strict=True):
            np.testing.assert_array_equal(value, expected)


def lost(at: CurvesAt, images: tuple[Image, Image], coarse: int, fine: int) -> bool:
    """Whether the curves are lost during the steps."""
    reaches = np.array([6.0, 4.0])
    found = take_steps(at, *images, reaches, coarse, fine, np.array([3.0, 1.5]), 1.5, 0.4)
    return found.coarse == found.fine == 0


def test_a_circle_that_runs_away_is_lost() -> None:
    """A circle is lost if its edge is outside by more than half of its radius."""
    rig, start = make_rig(), replace(CURVES[3], parameters=np.array([-5.0, 4.0, 0.5]), polarity=1)
    wide = replace(start, parameters=np.array([-5.0, 4.0, 0.82]))
    images = discs(rig, (wide,))
    assert lost(placed(rig, FREE, (start,)), images, 2, 0)
    assert not lost(placed(rig, FREE, (wide,)), images, 2, 0)


@pytest.mark.parametrize(("coarse", "fine"), [(2, 0), (1, 2), (0, 2)])
def test_what_cannot_be_laid_or_seen_is_lost(coarse: int, fine: int) -> None:
    """Curves behind the cameras, too large, or, in fine steps, outside of the picture are lost."""
    rig, images = make_rig(), discs(make_rig(), CURVES[:1])
    behind = replace(CURVES[0], height_mm=-300.0)
    large, aside = (
        replace(behind, parameters=np.array(where)) for where in ((0.0, 0.0, 1e6), (900.0, 0.0, 9.0))
    )
    for wrong in (behind, replace(large, height_mm=0.0), *([replace(aside, height_mm=0.0)] if fine else ())):
        assert lost(placed(rig, FREE, (wrong,)), images, coarse, fine)
