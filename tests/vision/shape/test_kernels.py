"""The kernels of the shape search against their plain-loop twins."""

from __future__ import annotations

import math

import numpy as np
import pytest
from naive import shape as naive

from edged.vision.edges.subpixel import edges_at_widths
from edged.vision.geometry.rigid import rotation_2d
from edged.vision.shape import ambiguity as rivals
from edged.vision.shape import localsearch as nearby
from edged.vision.shape import refine, scan

RNG = np.random.default_rng(7)


def _gradients(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    return (rng.integers(-400, 400, (height, width)).astype(np.int16) for _ in range(2))


def _maps(unsigned: bool, reach: int = 8) -> tuple[np.ndarray, np.ndarray, int]:
    """Kernel maps, the same as (16, H, W), and the pad."""
    gx, gy = _gradients(21, 34)
    rows, columns, pad = scan.map_geometry(21, 34, reach)
    maps = np.zeros((16, 2, 2, rows, columns), np.int8)
    scratch = np.zeros((2, 2, 2, rows, columns), np.float32)
    scan.fill_responses(gx, gy, np.ones((1, 1), np.uint8), 150**2, unsigned, pad, scratch, maps)
    plain = np.zeros((16, 21, 34), np.int64)
    for y in range(21):
        for x in range(34):
            plain[:, y, x] = maps[:, (y + pad) & 1, (x + pad) & 1, (y + pad) >> 1, (x + pad) >> 1]
    return maps, plain, pad


@pytest.mark.parametrize("unsigned", [False, True])
def test_responses_are_seven_cosines(unsigned: bool) -> None:
    """Each response is 7 cos(direction - orientation) to half a unit; weak gradients respond nowhere."""
    _, plain, _ = _maps(unsigned)
    gx, gy = _gradients(21, 34)
    assert np.abs(plain - naive.shape_responses(gx, gy, 150**2, unsigned)).max() <= 0.5 + 1e-4


def test_masked_pixels_respond_nowhere() -> None:
    """A pixel that is not valid has no response in any map."""
    gx, gy = _gradients(21, 34)
    rows, columns, pad = scan.map_geometry(21, 34, 8)
    maps = np.zeros((16, 2, 2, rows, columns), np.int8)
    scratch = np.zeros((2, 2, 2, rows, columns), np.float32)
    scan.fill_responses(gx, gy, np.zeros((21, 34), np.uint8), 0, False, pad, scratch, maps)
    assert not maps.any()


def _points(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(11)
    return rng.uniform(-5, 5, (count, 2)), rng.uniform(-np.pi, np.pi, count)


def test_scan_finds_the_best_pose_of_each_place() -> None:
    """Best score and pose per position, sign and sector are those of trying every pose by hand."""
    maps, plain, pad = _maps(False)
    points, directions = _points(32)
    poses = np.column_stack(
        [RNG.uniform(-np.pi, np.pi, 12), RNG.uniform(0.9, 1.1, 12), RNG.uniform(0.9, 1.1, 12)]
    )
    rows, columns = maps.shape[3:]
    offsets = np.empty((12, 32), np.int64)
    scan.pose_offsets(points, directions, poses, rows, columns, pad, offsets)
    sectors = np.floor(poses[:, 0] * (8 / (2 * np.pi))).astype(np.int64) % 8
    best = np.zeros((2, 8, 11 * columns), np.int16)
    pose = np.zeros(best.shape, np.int32)
    scan.scan(maps.reshape(-1), offsets, sectors, 11 * columns, 20, True, best, pose)
    expected = np.zeros((2, 8, 11, 17), np.int64)
    for p, candidate in enumerate(poses):
        for y in range(11):
            for x in range(17):
                value = naive.shape_similarity(plain, points, directions, 2 * x, 2 * y, candidate)
                for sign in (0, 1):
                    signed = value if sign == 0 else -value
                    if signed >= 20:
                        cell = expected[sign, sectors[p]]
                        cell[y, x] = max(cell[y, x], signed)
    found = best.reshape(2, 8, 11, columns)[..., :17]
    assert expected.any()
    np.testing.assert_array_equal(found, expected)
    for sign, sector, y, x in zip(*np.nonzero(found), strict=True):
        which = pose.reshape(2, 8, 11, columns)[sign, sector, y, x]
        value = naive.shape_similarity(plain, points, directions, 2 * x, 2 * y, poses[which])
        assert abs(value) == found[sign, sector, y, x]


def test_scan_without_inversion_ignores_negative_sums() -> None:
    """With one polarity only the first half of the table is filled."""
    maps, _, pad = _maps(False)
    points, directions = _points(32)
    rows, columns = maps.shape[3:]
    offsets = np.empty((1, 32), np.int64)
    scan.pose_offsets(points, directions, np.array([[0.3, 1.0, 1.0]]), rows, columns, pad, offsets)
    best = np.zeros((2, 8, 11 * columns), np.int16)
    pose = np.zeros(best.shape, np.int32)
    scan.scan(maps.reshape(-1), offsets, np.zeros(1, np.int64), 11 * columns, 10, False, best, pose)
    assert best[0].any()
    assert not best[1].any()


def test_group_sums_and_extremes() -> None:
    """16 rows of bytes are added without overflow, group to group, and the largest magnitude is found."""
    maps = RNG.integers(-7, 8, 4000).astype(np.int8)
    maps[100:1000] = 7
    offsets = RNG.integers(0, 3000, (2, 32))
    offsets[1, :16] = 50
    words = np.full(scan.BLOCK, 999, np.int16)
    sums = np.empty(scan.BLOCK, np.int8)
    length = 293
    for n in (0, 16):
        scan.add_group(maps, offsets, 1, n, 5, length, sums, words)
    expected = sum(maps[o + 5 : o + 5 + length].astype(int) for o in offsets[1])
    np.testing.assert_array_equal(words[:length], expected)
    assert (words[length:] == 999).all()
    assert scan.highest(words, length, False) == expected.max()
    assert scan.highest(words, length, True) == np.abs(expected).max()


def test_peaks_are_local_maxima_and_the_best_survive() -> None:
    """Every peak beats its eight neighbours; a table that is too small keeps the highest."""
    best = np.zeros((2, 8, 30 * 40), np.int16)
    best[:] = np.random.default_rng(0).integers(0, 600, best.shape)
    peaks = np.zeros((5000, 5), np.int64)
    number = scan.collect_peaks(best, 30, 38, 40, 300, peaks)
    expected = set()
    for sign in range(2):
        for sector in range(8):
            plane = np.pad(best[sign, sector].reshape(30, 40)[:, :38].astype(int), 1, constant_values=-1)
            for y in range(30):
                for x in range(38):
                    window = plane[y : y + 3, x : x + 3].copy()
                    value, window[1, 1] = window[1, 1], -1
                    before = max(window[0].max(), window[1, 0])
                    if value >= 300 and value > before and value >= window.max():
                        expected.add((value, sign, sector, y, x))
    assert {tuple(row) for row in peaks[:number].tolist()} == expected
    few = np.zeros((20, 5), np.int64)
    kept = scan.collect_peaks(best, 30, 38, 40, 300, few)
    assert kept == 20
    assert sorted(few[:, 0]) == sorted(p[0] for p in expected)[-20:]


def test_polish_never_lowers_the_score() -> None:
    """A candidate ends where the twin computes the reported score, at least as high as where it began."""
    maps, plain, pad = _maps(False, reach=16)
    points, directions = _points(32)
    start = np.array([[10.0, 8, 0.2, 1.0, 1.0, 1], [20.0, 12, -1.2, 1.05, 0.95, -1]])
    candidates, values = start.copy(), np.zeros(2)
    scan.polish(maps, points, directions, pad, np.array([0.1, 0.02, 0.02]), candidates, values)
    for before, after, value in zip(start, candidates, values, strict=True):
        sign = int(before[5])
        old, new = (
            sign * naive.shape_similarity(plain, points, directions, int(c[0]), int(c[1]), c[2:5])
            for c in (before, after)
        )
        assert value * 7 * 32 == pytest.approx(new)
        assert new >= old


def test_response_sum_is_the_similarity() -> None:
    """Placed points at any pixel sum to the twin's similarity, also half outside the image."""
    maps, plain, pad = _maps(False)
    points, directions = _points(16)
    placed = np.empty((16, 3), np.int64)
    scan.place_on_maps(points, directions, 0.7, 1.1, 0.9, pad, placed)
    for x, y in ((0, 0), (7, 4), (33, 20)):
        expected = naive.shape_similarity(plain, points, directions, x, y, np.array([0.7, 1.1, 0.9]))
        assert scan.response_sum(maps, placed, x, y) == expected


def test_one_candidate_per_place_and_rotation() -> None:
    """The first of near poses stays; another angle, place or sign is kept."""
    rows = np.array(
        [
            [10.0, 10, 0, 1, 1, 1],
            [12.0, 10, 0.1, 1, 1, 1],
            [12.0, 10, 1.0, 1, 1, 1],
            [12.0, 10, 0.1, 1, 1, -1],
            [30.0, 10, 0, 1, 1, 1],
            [10.0, 10, 2 * math.pi - 0.1, 1, 1, 1],
        ]
    )
    kept = np.empty(6, np.int64)
    assert kept[: scan.best_of_each_place(rows, 6, 0.35, kept)].tolist() == [0, 2, 3, 4]
    assert scan.best_of_each_place(rows, 2, 0.35, kept) == 2


def _pose() -> np.ndarray:
    pose = refine.start_pose(40.3, 30.7, 0.4, 1.05, 0.97)
    pose[6:] = 0.002, -0.001
    return pose


def test_place_maps_points_and_turns_normals() -> None:
    """Points go where the formula says; normals stay unit and at right angles to the mapped edge."""
    points, angles = _points(40)
    normals = np.column_stack([np.cos(angles), np.sin(angles)])
    pose = _pose()
    placed = np.empty((40, 4))
    refine.place(points, normals, pose, placed)
    for n in range(40):
        np.testing.assert_allclose(placed[n, :2], naive.shape_point(pose, points[n]), atol=1e-12)
        edge = pose[2:6].reshape(2, 2) @ np.array([-normals[n, 1], normals[n, 0]])
        assert abs(edge @ placed[n, 2:]) < 1e-12
        assert np.hypot(*placed[n, 2:]) == pytest.approx(1)


@pytest.mark.parametrize("sign", [1, -1, 0])
def test_gradient_edges_are_the_strongest_extrema(sign: int) -> None:
    """Offsets and cosines are those of the plain loop."""
    rng = np.random.default_rng(5)
    gx, gy = (rng.integers(-500, 500, (50, 60)).astype(np.int16) for _ in range(2))
    angles = rng.uniform(0, 2 * np.pi, 80)
    placed = np.column_stack([rng.uniform(8, 50, 80), rng.uniform(8, 40, 80), np.cos(angles), np.sin(angles)])
    edges = np.empty((80, 2))
    refine.gradient_edges(gx, gy, placed, 2.5, sign, 40.0, edges)
    expected = np.array([naive.shape_edge(gx, gy, place, 2.5, sign, 40.0) for place in placed])
    np.testing.assert_allclose(edges, expected, atol=1e-9)
    assert np.isfinite(edges[:, 0]).sum() > 40


def test_gradient_edges_beyond_the_image_are_none() -> None:
    """A normal that leaves the image gives NaN, not a read beyond the array."""
    gx = np.full((20, 20), 100, np.int16)
    edges = np.zeros((3, 2))
    placed = np.array([[0.0, 5, 1, 0], [np.nan, 5, 1, 0], [1e9, -1e9, 0, 1]])
    refine.gradient_edges(gx, gx, placed, 2.0, 1, 1.0, edges)
    assert np.isnan(edges[:, 0]).all()


def test_edge_directions_are_sobel_cosines() -> None:
    """On a ramp the gradient has one direction everywhere; the cosine is that to the normal."""
    y, x = np.mgrid[:30, :30]
    image = (3 * x + 2 * y).astype(np.uint8)
    angles = np.linspace(0, 6, 20)
    placed = np.column_stack([np.full(20, 15.2), np.full(20, 14.9), np.cos(angles), np.sin(angles)])
    edges = np.zeros((20, 2))
    edges[3, 0] = np.nan
    refine.edge_directions(image, placed, 1, edges)
    expected = np.cos(angles - math.atan2(2, 3))
    expected[3] = 0
    np.testing.assert_allclose(edges[:, 1], expected, atol=1e-9)


def test_median_of_magnitudes() -> None:
    """Only the used values count; none gives NaN."""
    values, used = np.array([-5.0, 1, 2, -100]), np.array([True, True, True, False])
    assert refine.median_magnitude(values, used, np.empty(4)) == 2
    assert np.isnan(refine.median_magnitude(values, np.zeros(4, bool), np.empty(4)))


@pytest.mark.parametrize("freedom", [3, 4, 5, 6, 8])
def test_jacobian_and_step_agree_with_differences(freedom: int) -> None:
    """The derivative of each offset equals the difference of the mapped point under a small step."""
    points, angles = _points(30)
    points = points * 8
    pose = _pose()
    placed = np.empty((30, 4))
    refine.place(points, np.column_stack([np.cos(angles), np.sin(angles)]), pose, placed)
    design = np.zeros((30, 8))
    refine.jacobian(points, placed, pose, freedom, design)
    for k in range(freedom):
        ends = []
        for side in (1e-6, -1e-6):
            step = np.zeros(freedom)
            step[k] = side
            moved = pose.copy()
            refine.apply_step(moved, np.concatenate([step, np.zeros(8 - freedom)]), freedom)
            np.testing.assert_allclose(moved, naive.shape_step(pose, step, freedom), atol=1e-12)
            ends.append(np.array([naive.shape_point(moved, point) for point in points]))
        slope = np.sum((ends[0] - ends[1]) / 2e-6 * placed[:, 2:], axis=1)
        np.testing.assert_allclose(design[:, k], slope, atol=1e-6)


def test_robust_step_is_a_tukey_fit() -> None:
    """The step equals numpy's robust fit, with a third of the edges far off; the score counts the rest."""
    points, angles = _points(300)
    points = points * 20
    pose = refine.start_pose(200.0, 200.0, 0.3, 1.0, 1.0)
    placed = np.empty((300, 4))
    refine.place(points, np.column_stack([np.cos(angles), np.sin(angles)]), pose, placed)
    design = np.zeros((300, 8))
    refine.jacobian(points, placed, pose, 4, design)
    true_step = np.array([0.4, -0.3, 0.004, -0.003])
    rng = np.random.default_rng(1)
    edges = np.column_stack([design[:, :4] @ true_step + rng.normal(0, 0.1, 300), np.ones(300)])
    edges[::3, 0] += 1.9
    edges[::3, 1] = 0.5
    moved, result = pose.copy(), refine.no_step()
    assert refine.robust_step(points, placed, edges, moved, 4, 1.0, 8, result)
    summary = result.summary
    step = naive.tukey_fit(design[:, :4], edges[:, 0], 8, 0.02)
    np.testing.assert_allclose(moved, naive.shape_step(pose, step, 4), atol=2e-4)
    np.testing.assert_allclose(step, true_step, atol=0.05)
    assert summary[0] == pytest.approx(2 / 3, abs=0.01)
    assert summary[1] == pytest.approx(2 / 3, abs=0.01)


def test_too_few_edges_determine_nothing() -> None:
    """Fewer than two edges per unknown: refused, the pose stays."""
    points, angles = _points(20)
    pose = _pose()
    placed = np.empty((20, 4))
    refine.place(points, np.column_stack([np.cos(angles), np.sin(angles)]), pose, placed)
    edges = np.full((20, 2), np.nan)
    edges[:7] = 0.1
    moved = pose.copy()
    assert not refine.robust_step(points, placed, edges, moved, 4, 1.0, 8, refine.no_step())
    np.testing.assert_array_equal(moved, pose)


def test_motion_is_an_upper_limit() -> None:
    """No point moves farther than stated, and the farthest not much less, also with a tilt."""
    points, _ = _points(40)
    rng = np.random.default_rng(4)
    for _ in range(20):
        before = _pose()
        after = before + rng.normal(0, 1, 8) * np.array([0.3, 0.3, 0.01, 0.01, 0.01, 0.01, 1e-4, 1e-4])
        moved = naive.shape_motion(points, before, after)
        assert moved <= refine.motion(points, before, after) <= 4 * moved + 0.05


def test_settle_takes_the_steps_one_by_one() -> None:
    """Robust steps bring a displaced pose back to a disc; one that would repeat a short one is left out."""
    rows, columns = np.mgrid[:120, :120]
    image = 400 * np.tanh((20 - np.hypot(columns - 60, rows - 58)) / 1.5)
    gy, gx = (np.asarray(g, np.int16) for g in np.gradient(np.asarray(image)))
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    normals = np.column_stack([-np.cos(angles), -np.sin(angles)])
    points = -20 * normals
    steps = np.array([[2.0, 4], [2.0, 4], [1.5, 4]])
    start = refine.start_pose(61.2, 57.1, 0.0, 1.0, 1.0)
    by_hand, result = start.copy(), refine.no_step()
    placed, edges = np.empty((60, 4)), np.empty((60, 2))
    for reach, freedom in steps[:2]:
        refine.place(points, normals, by_hand, placed)
        refine.gradient_edges(gx, gy, placed, reach, 1, 5.0, edges)
        assert refine.robust_step(points, placed, edges, by_hand, int(freedom), 0.1, 4, result)
    settled = start.copy()
    assert refine.settle(points, normals, refine.Gradient(gx, gy, 1, 5.0), steps, 0.1, settled, result)
    np.testing.assert_array_equal(settled, by_hand)
    np.testing.assert_allclose(settled[:2], [60, 58], atol=0.1)
    nothing = np.zeros_like(gx)
    assert not refine.settle(
        points, normals, refine.Gradient(nothing, nothing, 1, 5.0), steps, 0.1, settled, result
    )


def test_start_poses_are_those_of_each_row() -> None:
    """Many poses at once equal each for itself, bit by bit."""
    rows = np.random.default_rng(1).uniform(-2, 2, (20, 5))
    expected = [refine.start_pose(*row) for row in rows.tolist()]
    np.testing.assert_array_equal(refine.start_poses(*rows.T), expected)
    for pose, (x, y, angle, scale_x, scale_y) in zip(expected, rows.tolist(), strict=True):
        linear = rotation_2d(angle) @ np.diag([scale_x, scale_y])
        np.testing.assert_allclose(pose, [x, y, *linear.ravel(), 0.0, 0.0], rtol=1e-15)


@pytest.mark.parametrize("sizes_y", [None, (0.8, 1.3)])
@pytest.mark.parametrize("view_stretch", [None, 1.2])
def test_poses_within_ranges(sizes_y: tuple[float, float] | None, view_stretch: float | None) -> None:
    """Size, stretch and turn of random poses are judged as by hand, and a pose with NaN is out of range."""
    rng = np.random.default_rng(3)
    none = (math.nan, math.nan)
    for extent in (0.7, 4.0, 2 * math.pi):
        ranges = refine.Ranges(
            0.9, 1.2, *(sizes_y or none), math.nan if view_stretch is None else view_stretch, -0.4, extent
        )
        verdicts = []
        for _ in range(100):
            pose = refine.start_pose(3.0, 4.0, rng.uniform(-np.pi, np.pi), *rng.uniform(0.8, 1.3, 2))
            pose[2:6] += rng.normal(0, 0.03, 4)
            wanted = naive.shape_is_within(
                pose, (0.9, 1.2), sizes_y, view_stretch, (-0.4, extent), 0.05, refine.MAX_STRETCH
            )
            verdicts.append(wanted)
            assert wanted == refine.is_within(pose, ranges, 0.05)
        assert 0 < sum(verdicts) < 100
        pose[7] = math.nan
        assert not refine.is_within(pose, ranges, 0.05)


@pytest.mark.parametrize("freedom", [refine.RIGID, refine.SIMILARITY, refine.STRETCH, refine.AFFINE, 8])
def test_covariance_of_a_pose(freedom: int) -> None:
    """It is that of the inverse normal matrix, propagated by differences; NaN for what is not fitted."""
    rng = np.random.default_rng(freedom)
    design = rng.normal(size=(40, 8))
    matrix = design.T @ design
    pose = refine.start_pose(3.0, 4.0, 0.4, 1.1, 0.9)
    found = refine.covariance(matrix, freedom, 0.3, pose)
    used = 3 if freedom == refine.RIGID else 5
    expected = naive.shape_covariance(matrix, freedom, 0.3, pose)[:used, :used]
    np.testing.assert_allclose(found[:used, :used], expected, rtol=1e-5, atol=1e-9)
    assert np.isnan(found[used:]).all()
    assert np.isnan(refine.covariance(matrix, 0, 0.3, pose)).all()
    assert np.isnan(refine.covariance(-matrix, freedom, 0.3, pose)).all()


def test_odd_signs_are_dropped() -> None:
    """An edge whose contrast is opposite to most of those in its cell is none; ties stay."""
    rng = np.random.default_rng(8)
    points, slopes = rng.uniform(-20, 20, (200, 2)), rng.normal(1.0, 2.0, 200)
    edges = np.zeros((200, 2))
    edges[:, 0] = np.where(rng.random(200) < 0.2, np.nan, rng.normal(size=200))
    expected = naive.shape_odd_signs(points, slopes, 7.0, edges[:, 0])
    assert np.isnan(expected).sum() > np.isnan(edges[:, 0]).sum()
    refine.drop_odd_signs(points, slopes, 7.0, edges)
    np.testing.assert_array_equal(edges[:, 0], expected)


@pytest.mark.parametrize("clipped", [False, True])
def test_the_finest_level_is_measured_step_by_step(clipped: bool) -> None:
    """Pose, score, sigma and agreeing edges are those of both steps by hand; no contrast: score 0."""
    rows, columns = np.mgrid[:160, :160]
    image = np.clip(
        np.rint(120 + 100 * np.tanh((50 - np.hypot(columns - 80, rows - 78)) / 1.5)), 0, 255
    ).astype(np.uint8)
    if clipped:
        image[:60] = np.clip(image[:60].astype(int) * 2, 0, 255)
    angles = np.random.default_rng(2).uniform(0, 2 * np.pi, 200)
    normals = np.column_stack([-np.cos(angles), -np.sin(angles)])
    points = -50.0 * normals
    ranges = refine.Ranges(0.9, 1.1, math.nan, math.nan, math.nan, 0.0, 2 * math.pi)
    asked = refine.Finest(1, 3.0, 12.0, refine.SIMILARITY, 0.001, 0.3, ranges)
    start = refine.start_pose(80.8, 77.4, 0.0, 1.0, 1.0)
    pose, result, agreeing = start.copy(), refine.no_step(), np.empty(200)
    score = refine.settle_finest(image, points, normals, asked, pose, agreeing, result)
    by_hand, wanted = start.copy(), refine.no_step()
    for count, reach in ((refine.FIRST_POINTS, 2.0), (200, 1.5)):
        placed, edges = np.empty((count, 4)), np.empty((count, 2))
        refine.place(points[:count], normals[:count], by_hand, placed)
        seen = edges_at_widths(image, placed[:, :2], placed[:, 2:], reach, 1, (refine.EDGE_SIGMA_PX,), 1.0)
        slopes = seen.slope[0]
        edges[:, 0] = np.where(np.abs(slopes) >= 3.0, seen.offset_px[0], np.nan)
        edges[:, 0] = naive.shape_odd_signs(points[:count], slopes, 12.0, edges[:, 0])
        refine.edge_directions(image, placed, 1, edges)
        before = by_hand.copy()
        assert refine.robust_step(points[:count], placed, edges, by_hand, 4, 0.001, 8, wanted)
        expected = min(wanted.summary[0], 1.0)
        expected_slopes = np.where(np.abs(edges[:, 0]) < refine.AGREES_PX, slopes, 0.0)
        hidden = np.isfinite(edges[:, 0]) & seen.clipped
        if count == 200 and hidden.any():
            edges[seen.clipped, 0] = np.nan
            by_hand = before
            assert refine.robust_step(points, placed, edges, by_hand, 4, 0.001, 8, wanted)
    assert clipped == hidden.any()
    np.testing.assert_array_equal(pose, by_hand)
    np.testing.assert_array_equal(agreeing, expected_slopes)
    assert (score, result.summary[2]) == (expected, wanted.summary[2])
    np.testing.assert_allclose(pose[:2], [80, 78], atol=0.1)
    flat = np.full_like(image, 90)
    assert refine.settle_finest(flat, points, normals, asked, pose, agreeing, result) == 0.0


def test_light_beside_a_rim() -> None:
    """Thresholds and grey values beside a rim are by rank, from strong edges; NaN where it is not even."""
    rng = np.random.default_rng(4)
    for scatter in (2.0, 40.0):
        slope, inward = rng.normal(0, 20, 120), rng.integers(-1, 2, 120)
        beside = np.column_stack([rng.normal(60, scatter, 120), rng.normal(90, 5, 120)] * 2)[:, :3].copy()
        beside[:, 2] = rng.normal(150, scatter, 120)
        swapped = inward < 0
        beside[swapped] = beside[swapped][:, ::-1]
        beside[::9, 1] = np.nan
        strong, *levels = rivals.light_of(slope, beside, inward, 2.0, 0.0)
        assert strong == max(0.2 * sorted(abs(slope))[84], 2.0)
        good = (np.abs(slope) >= strong) & np.isfinite(beside).all(axis=1)
        step = sorted(abs(beside[good, 2] - beside[good, 0]))[good.sum() * 25 // 100]
        rim = good & (inward != 0)
        inside = [row[2] if way > 0 else row[0] for row, way in zip(beside[rim], inward[rim], strict=True)]
        outside = [row[0] if way > 0 else row[2] for row, way in zip(beside[rim], inward[rim], strict=True)]
        for greys, level, varies in ((inside, *levels[:2]), (outside, *levels[2:])):
            sigma = 1.4826 * np.median(np.abs(greys - np.median(greys)))
            if 1.35 * sigma >= 0.35 * step:
                assert math.isnan(level)
            else:
                assert (level, varies) == (np.median(greys), min(max(4 * sigma, 0.1 * step), 0.35 * step))
        middle = float(np.median(inside))
        greys = rivals.face_greys(slope, beside, inward, strong)
        assert greys == (middle - 0.75 * step, middle + 0.75 * step)
        verdicts = rivals.weigh_points(slope, beside, inward, strong, 100.0, 60.0, 60.0, 20.0)
        for n, verdict in enumerate(verdicts.tolist()):
            bare = all(abs(grey - 100.0) < 60.0 for grey in beside[n])
            empty = all(abs(grey - 60.0) < 20.0 for grey in beside[n]) and inward[n] != 0
            assert verdict == (1 if abs(slope[n]) >= strong else -1 if bare or empty else 0)
    assert rivals.face_greys(slope[:5], beside[:5], inward[:5], strong) == (-math.inf, math.inf)


def test_points_beside_an_outline_are_found() -> None:
    """The sorted search for points beside an outline agrees with trying every pair."""
    rng = np.random.default_rng(5)
    angles = rng.uniform(-np.pi, np.pi, 400)
    both = np.column_stack([rng.uniform(0, 60, (400, 2)), np.cos(angles), np.sin(angles)])
    points, outline = both[:150], both[150:]
    outline = outline[np.argsort(outline[:, 0])]
    found = np.empty((150, 2))
    rivals.meet(points, outline, 2.0, 5.0, 0.8, found)
    expected = [naive.meets(place, outline, 2.0, 5.0, 0.8) for place in points]
    assert 10 < np.isfinite(found[:, 0]).sum() < 140
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("sign", [-1, 0, 1])
@pytest.mark.parametrize("place", [(20.3, 11.8), (2.0, 19.0), (-30.0, 500.0)])
def test_agreement_around_a_pose(sign: int, place: tuple[float, float]) -> None:
    """A moved pose scores the mean cosine at its points' nearest pixels, 0 for those outside the image."""
    gx, gy = _gradients(21, 34)
    points, directions = _points(9)
    normals = np.column_stack([np.cos(directions), np.sin(directions)])
    poses = np.array([refine.start_pose(*place, angle, 1.1, 0.9) for angle in (0.3, -2.0)])
    scores = np.empty((2, nearby.PLACES, nearby.PLACES), np.float32)
    nearby.scan_nearby(gx, gy, points, normals, poses, sign, 150.0, scores)
    placed = np.empty((9, 4))
    for pose, found in zip(poses, scores, strict=True):
        refine.place(points, normals, pose, placed)
        for i in range(nearby.PLACES):
            for j in range(nearby.PLACES):
                shift = nearby.STRIDE_PX * np.array([j, i, 0, 0]) - nearby.REACH_PX * np.array([1, 1, 0, 0])
                expected = [naive.shape_agreement(gx, gy, point, sign, 150.0) for point in placed + shift]
                assert found[i, j] == pytest.approx(float(np.mean(expected)), abs=1e-5)
