"""Calibration: the true rig is found, the stated sigma is the error, and bad input is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.boards import board_poses, parameter_error, synthetic_views
from helpers.rigs import make_rig

from edged.domain.arrays import FloatArray
from edged.errors import CalibrationError
from edged.vision.boards.board import Board, Chessboard, Detection, NotDetected, StereoView
from edged.vision.calibration.bundle import BundleState, LensFreedom, Observations, adjust
from edged.vision.calibration.calibrate import Calibration, calibrate_stereo
from edged.vision.calibration.crossvalidation import hold_out
from edged.vision.calibration.verdict import judge_calibration
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import rotation_matrix, rotation_vector, transform

BOARD = Chessboard(11, 8, 4.0)
SIZE = (1280, 960)


def calibrate(views: list[StereoView], rig: StereoRig) -> Calibration:
    """Calibrate with the lens model of the true rig."""
    return calibrate_stereo(views, SIZE, SIZE, rig.left.model)


def views_of(
    rig: StereoRig, n: int = 12, sigma_px: float = 0.02, seed: int = 0, board: Board = BOARD
) -> list[StereoView]:
    """n synthetic views, tilted differently."""
    return synthetic_views(rig, board, board_poses(rig, board, n, seed), sigma_px, seed)


@pytest.mark.long
@pytest.mark.parametrize("model", ["brown", "division"])
@pytest.mark.parametrize("vergence_deg", [0.0, 24.0])
def test_exact_marks_give_the_exact_rig(model: str, vergence_deg: float) -> None:
    """Without noise every parameter of the rig is found, with verged and parallel cameras."""
    rig = make_rig(model, vergence_deg)
    found = calibrate(views_of(rig, sigma_px=0.0), rig)
    error = parameter_error(found.rig, rig)
    names = list(rig.parameter_names)
    focal = abs(error[names.index("left.fx")] - 0)
    assert focal < 1e-3
    assert np.abs(error[-6:-3]).max() < 1e-6
    assert np.abs(error[-3:]).max() < 1e-4
    assert found.rms_px < 1e-5
    assert found.excluded == ()
    assert found.outliers == 0


@pytest.mark.long
@pytest.mark.parametrize("model", ["brown", "division"])
def test_the_stated_covariance_is_the_error(model: str) -> None:
    """Over repeated noise the normalised squared error per parameter is 1, and none is beyond 4.5 sigma."""
    rig = make_rig(model)
    poses = board_poses(rig, BOARD, 8, 3)
    squares, worst, runs = [], 0.0, 6
    for seed in range(runs):
        # half the noise is stated, half is for the estimator to find
        views = synthetic_views(rig, BOARD, poses, 0.02, seed, stated_sigma_px=0.01)
        found = calibrate(views, rig)
        assert found.rig.covariance is not None
        error, covariance = parameter_error(found.rig, rig), found.rig.covariance
        # fy is fx, and k3 is fixed: the independent ones
        free = np.array([n.split(".")[1] not in ("fy", "k3") for n in rig.parameter_names])
        error, covariance = error[free], covariance[np.ix_(free, free)]
        squares.append(error @ np.linalg.solve(covariance, error) / free.sum())
        worst = max(worst, float(np.max(np.abs(error) / np.sqrt(np.diag(covariance)))))
        assert found.model_error_px == pytest.approx((0.0173, 0.0173), abs=0.002)
    # chi² of 6 * (14 to 20) values over their number: 1 +- 0.15
    assert np.mean(squares) == pytest.approx(1, abs=0.35)
    assert worst < 4.5


@pytest.mark.long
def test_precise_marks_count_more_than_rough_ones() -> None:
    """Marks that are ten times rougher and have the sigma to match hardly spoil the result."""
    rig = make_rig()
    poses = board_poses(rig, BOARD, 10, 5)
    fine = synthetic_views(rig, BOARD, poses, 0.01, 1)
    rough = synthetic_views(rig, BOARD, poses, 0.2, 2)
    rng = np.random.default_rng(0)

    def mixed(a: Detection, b: Detection) -> Detection:
        poor = rng.random(len(a.ids)) < 0.3
        pixels = np.where(poor[:, None], b.pixels, a.pixels)
        return replace(a, pixels=pixels, sigma_px=np.where(poor, 0.2, 0.01))

    views = [
        replace(
            f, left=mixed(f.found("left"), r.found("left")), right=mixed(f.found("right"), r.found("right"))
        )
        for f, r in zip(fine, rough, strict=True)
    ]
    alike = [
        replace(
            v,
            left=replace(v.found("left"), sigma_px=np.full(88, 0.05)),
            right=replace(v.found("right"), sigma_px=np.full(88, 0.05)),
        )
        for v in views
    ]
    knowing = parameter_error(calibrate(views, rig).rig, rig)
    ignorant = parameter_error(calibrate(alike, rig).rig, rig)
    assert np.linalg.norm(knowing[-3:]) < 0.5 * np.linalg.norm(ignorant[-3:])


def test_a_view_as_good_as_its_marks_state_is_kept() -> None:
    """A view as good as its stated sigma is kept even if all others are far better."""
    rig = make_rig()
    poses = board_poses(rig, BOARD, 6, 5)
    fine = synthetic_views(rig, BOARD, poses, 0.001, 1, stated_sigma_px=0.01)
    usual = synthetic_views(rig, BOARD, poses, 0.012, 2, stated_sigma_px=0.01)
    assert () == calibrate([*fine[:5], usual[5]], rig).excluded
    wrong = synthetic_views(rig, BOARD, poses, 0.1, 2, stated_sigma_px=0.01)
    assert ["view_05"] == [name for name, _ in calibrate([*fine[:5], wrong[5]], rig).excluded]


@pytest.mark.long
def test_wrong_marks_are_dropped() -> None:
    """Marks that are off by pixels are found and counted, and do not move the result."""
    rig = make_rig()
    views = views_of(rig)
    spoiled = views[3].found("right").pixels.copy()
    spoiled[[5, 40]] += (3.0, -2.0)
    views[3] = replace(views[3], right=replace(views[3].found("right"), pixels=spoiled))
    found = calibrate(views, rig)
    clean = calibrate(views_of(rig), rig)
    assert found.outliers == 2
    assert np.abs(found.rig.right_from_left - clean.rig.right_from_left)[:3, 3].max() < 0.002


@pytest.mark.long
def test_one_bad_view_is_left_out_and_named() -> None:
    """A view in which the board slipped between both exposures is named; the rest is used."""
    rig = make_rig()
    views = views_of(rig)
    bad = views_of(rig, seed=9)[0]
    views[4] = replace(views[4], right=bad.right)
    found = calibrate(views, rig)
    assert [name for name, _ in found.excluded] == ["view_04"]
    assert "residuals" in found.excluded[0][1]
    assert found.rms_px < 0.04


@pytest.mark.slow
def test_missed_boards_are_named_with_their_reason() -> None:
    """A view without the board in one image is left out, with the detector's reason."""
    rig = make_rig()
    views = views_of(rig)
    views[2] = replace(views[2], right=NotDetected("too dark"))
    assert calibrate(views, rig).excluded == (("view_02", "right: too dark"),)


@pytest.mark.slow
def test_marks_seen_by_one_camera_only_still_count() -> None:
    """Partial views, as of ChArUco, calibrate as well: each camera may see other marks."""
    rig = make_rig()
    rng = np.random.default_rng(2)

    def part(seen: Detection) -> Detection:
        kept = np.sort(rng.permutation(88)[:50])
        return replace(seen, ids=seen.ids[kept], pixels=seen.pixels[kept], sigma_px=seen.sigma_px[kept])

    views = [
        replace(v, left=part(v.found("left")), right=part(v.found("right"))) for v in views_of(rig, 16, 0.01)
    ]
    found = calibrate(views, rig)
    assert found.rms_px == pytest.approx(0.01 * np.sqrt(2), rel=0.1)
    assert abs(found.rig.baseline_mm - rig.baseline_mm) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("upside_down", [False, True])
def test_a_symmetric_board_numbered_from_either_end(upside_down: bool) -> None:
    """Views of a symmetric board that are numbered from either end still give the true baseline."""
    board = Chessboard(9, 7, 4.0)
    rig = make_rig()
    rng = np.random.default_rng(0)
    views = []
    for view in views_of(rig, 10, board=board):
        turned = rng.random(2) < (1.0 if upside_down else 0.5)
        left, right = (
            replace(seen, ids=62 - seen.ids) if turn else seen
            for seen, turn in zip((view.found("left"), view.found("right")), turned, strict=True)
        )
        views.append(replace(view, left=left if not upside_down else view.left, right=right))
    found = calibrate(views, rig)
    assert found.rms_px < 0.04
    assert abs(found.rig.baseline_mm - rig.baseline_mm) < 0.1


@pytest.mark.slow
def test_two_boards_in_one_calibration() -> None:
    """Views of different boards are adjusted together."""
    rig = make_rig()
    other = Chessboard(6, 5, 7.0)
    views = [*views_of(rig, 8), *views_of(rig, 8, seed=1, board=other)]
    found = calibrate([replace(v, name=f"{i}") for i, v in enumerate(views)], rig)
    assert {fit.view.board for fit in found.views} == {BOARD, other}
    assert abs(found.rig.baseline_mm - rig.baseline_mm) < 0.05


@pytest.mark.long
@pytest.mark.parametrize("aspect", [1.0, 1.002])
def test_fx_leaves_fy_only_where_the_data_demand_it(aspect: float) -> None:
    """Square pixels stay exactly square; pixels that are oblong by 0.2 % are measured as oblong."""
    rig = make_rig()
    oblong = replace(
        rig,
        left=replace(rig.left, fy=rig.left.fx * aspect),
        right=replace(rig.right, fy=rig.right.fx * aspect),
    )
    found = calibrate(views_of(oblong), oblong)
    for camera in (found.rig.left, found.rig.right):
        if aspect == 1.0:
            assert camera.fx == camera.fy
        else:
            assert camera.fy / camera.fx == pytest.approx(aspect, abs=2e-4)


@pytest.mark.long
@pytest.mark.parametrize("k3", [0.0, -30.0])
def test_k3_is_released_only_where_the_data_demand_it(k3: float) -> None:
    """A lens without sixth-order distortion keeps k3 = 0; one with it does not."""
    rig = make_rig("brown")
    lens = (-0.21, 0.14, 5e-4, -4e-4, k3)
    rig = replace(rig, left=replace(rig.left, distortion=lens), right=replace(rig.right, distortion=lens))
    found = calibrate(views_of(rig, 16, 0.01), rig)
    estimated = found.rig.left.distortion[4]
    assert (estimated == 0.0) == (k3 == 0.0)
    assert found.rms_px == pytest.approx(0.01 * np.sqrt(2), rel=0.08)


@pytest.mark.long
def test_the_same_input_gives_the_same_name() -> None:
    """The same views give the same calibration id, other values another."""
    rig = make_rig()
    first, again = calibrate(views_of(rig), rig), calibrate(views_of(rig), rig)
    assert first.rig.calibration_id == again.rig.calibration_id
    assert calibrate(views_of(rig, seed=1), rig).rig.calibration_id != first.rig.calibration_id


def test_a_blurred_view_is_noted() -> None:
    """A view with edges twice as wide as usual is named."""
    rig = make_rig()
    views = views_of(rig)
    views[6] = replace(views[6], left=replace(views[6].found("left"), blur_px=2.1))
    notes = calibrate(views, rig).notes
    assert len(notes) == 1
    assert "view_06" in notes[0]
    assert "left image is blurred" in notes[0]


# --- refusals -------------------------------------------------------------------------------------


def test_too_few_views_are_refused_with_all_reasons() -> None:
    """Two usable pairs are not enough; every other pair's reason is in the message."""
    rig = make_rig()
    views = views_of(rig, 4)
    views[0] = replace(views[0], left=NotDetected("out of focus"))
    views[1] = replace(views[1], right=NotDetected("board cut off"))
    with pytest.raises(CalibrationError, match=r"2 of 4 pairs(.|\n)*out of focus(.|\n)*board cut off"):
        calibrate(views, rig)
    with pytest.raises(CalibrationError, match="0 of 0 pairs"):
        calibrate([], rig)


def test_parallel_boards_are_refused() -> None:
    """Boards that are all parallel are refused as parallel."""
    rig = make_rig()
    poses = board_poses(rig, BOARD, 8, 0, tilt_deg=0.5)
    with pytest.raises(CalibrationError, match="parallel"):
        calibrate(synthetic_views(rig, BOARD, poses, 0.02, 0), rig)


def test_swapped_images_are_refused() -> None:
    """Exchanged left and right images are refused as swapped."""
    rig = make_rig()
    views = [replace(v, left=v.right, right=v.left) for v in views_of(rig)]
    with pytest.raises(CalibrationError, match="swapped"):
        calibrate(views, rig)


@pytest.mark.long
@pytest.mark.parametrize(
    ("angle_deg", "first", "kept"), [(0.02, 7, range(7, 14)), (1.0, 8, range(8)), (1.0, 4, range(4, 14))]
)
def test_a_camera_bumped_between_views_costs_the_smaller_part(
    angle_deg: float, first: int, kept: range
) -> None:
    """A camera turned by a fiftieth of a degree is noticed, the longer run of views is used, and the place
    is named.

    With equal runs the later one is used, because the cameras still stand so.
    """
    rig = make_rig()
    bump = transform(rotation_matrix(np.array([0.0, np.radians(angle_deg), 0.0])), np.zeros(3))

    def bumped(number: int, real: StereoRig) -> StereoRig:
        return replace(real, right_from_left=bump @ real.right_from_left) if number >= first else real

    views = synthetic_views(rig, BOARD, board_poses(rig, BOARD, 14, 2), 0.02, 2, bumped)
    found = calibrate(views, rig)

    assert [f"view_{number:02}" for number in kept] == [fit.name for fit in found.views]
    place = f"a camera was moved between view_{first - 1:02} and view_{first:02}: by about "
    where = "before" if kept.start else "after"
    assert len(views) - len(kept) == len(found.excluded)
    assert all(f"taken {where} {place}" in reason for _, reason in found.excluded)
    (movement,) = found.movements
    assert movement.since is (kept.start == 0)
    (note,) = (note for note in found.notes if place in note)
    assert ("moved since: take fresh views" in note) is movement.since
    grade = judge_calibration(found, hold_out(found)).grade
    assert grade == "repeat" if movement.since else grade != "good"
    true = bump @ rig.right_from_left if kept.start else rig.right_from_left
    assert np.abs(found.rig.right_from_left[:3, 3] - true[:3, 3]).max() < 0.1


@pytest.mark.slow
def test_a_camera_that_never_stands_still_is_refused() -> None:
    """If no run of views is long enough to calibrate from, the error names the movement."""
    rig = make_rig()

    def loose(number: int, real: StereoRig) -> StereoRig:
        turn = rotation_matrix(np.array([0.0, np.radians(0.5 * (number // 2)), 0.0]))
        return replace(real, right_from_left=transform(turn, np.zeros(3)) @ real.right_from_left)

    views = synthetic_views(rig, BOARD, board_poses(rig, BOARD, 8, 2), 0.02, 2, loose)
    with pytest.raises(CalibrationError, match=r"moved between .*take the views again"):
        calibrate(views, rig)


def test_random_marks_are_refused() -> None:
    """Marks that are no board at all end in an error, not in a rig."""
    rig = make_rig()
    rng = np.random.default_rng(0)

    def nonsense(seen: Detection) -> Detection:
        return replace(seen, pixels=rng.uniform((0, 0), SIZE, (88, 2)))

    views = [
        replace(v, left=nonsense(v.found("left")), right=nonsense(v.found("right"))) for v in views_of(rig)
    ]
    with pytest.raises(CalibrationError):
        calibrate(views, rig)


# --- the adjustment itself --------------------------------------------------------------------------


def _observations(views: list[StereoView], side: str) -> Observations:
    found = [view.found(side) for view in views]
    return Observations(
        np.repeat(np.arange(len(views)), [len(seen.ids) for seen in found]),
        np.concatenate([v.board.points_mm[s.ids] for v, s in zip(views, found, strict=True)]),
        np.concatenate([seen.pixels for seen in found]),
        np.concatenate([seen.sigma_px for seen in found]),
    )


def _disturbed(pose: FloatArray, rng: np.random.Generator) -> FloatArray:
    return transform(rotation_matrix(rng.normal(0, 0.01, 3)), rng.normal(0, 0.5, 3)) @ pose


@pytest.mark.parametrize("model", ["brown", "division"])
def test_the_bundle_converges_from_a_rough_start_to_one_optimum(model: str) -> None:
    """From different rough starts the adjustment ends at the same parameters."""
    rig = make_rig(model)
    poses = board_poses(rig, BOARD, 6, 1)
    views = synthetic_views(rig, BOARD, poses, 0.05, 3)
    left, right = _observations(views, "left"), _observations(views, "right")
    distortion = ("kappa",) if model == "division" else ("k1", "k2", "p1", "p2")
    freedom = LensFreedom(True, distortion)
    ends = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        start = BundleState(
            replace(rig.left, fx=rig.left.fx * 1.02, fy=rig.left.fx * 1.02, cx=650.0),
            replace(rig.right, distortion=(0.0,) * len(rig.right.distortion)),
            _disturbed(rig.right_from_left, rng),
            np.array([_disturbed(pose, rng) for pose in poses]),
        )
        result = adjust(start, left, right, freedom, freedom)
        assert result.converged
        ends.append(result)
    assert ends[0].chi2 == pytest.approx(ends[1].chi2, rel=1e-7)
    assert np.allclose(ends[0].state.right_from_left, ends[1].state.right_from_left, atol=2e-4)
    assert ends[0].chi2 / ends[0].freedom == pytest.approx(1, abs=0.1)


def test_the_covariance_is_the_inverse_of_the_full_normal_matrix() -> None:
    """Rig and pose covariances with eliminated poses equal the blocks of the dense inverse."""
    rig = make_rig()
    poses = board_poses(rig, BOARD, 4, 1)
    views = synthetic_views(rig, BOARD, poses, 0.05, 3)
    left, right = _observations(views, "left"), _observations(views, "right")
    freedom = LensFreedom(True, ("kappa",))
    state = BundleState(rig.left, rig.right, rig.right_from_left, np.array(poses))
    result = adjust(state, left, right, freedom, freedom, robust=False)

    def residuals(x: FloatArray) -> FloatArray:
        s = result.state
        cameras = [
            replace(
                c,
                fx=c.fx + d[0],
                fy=c.fy + d[0],
                cx=c.cx + d[1],
                cy=c.cy + d[2],
                distortion=(c.distortion[0] + d[3],),
            )
            for c, d in ((s.left, x[:4]), (s.right, x[4:8]))
        ]
        turned = rotation_matrix(x[8:11]) @ s.right_from_left[:3, :3]
        relation = transform(turned, s.right_from_left[:3, 3] + x[11:14])
        values = []
        for camera, seen, is_right in ((cameras[0], left, False), (cameras[1], right, True)):
            for view in range(4):
                step = x[14 + 6 * view : 20 + 6 * view]
                pose = s.left_from_board[view]
                pose = transform(rotation_matrix(step[:3]) @ pose[:3, :3], pose[:3, 3] + step[3:])
                if is_right:
                    pose = relation @ pose
                mine = seen.view == view
                points = seen.points_mm[mine] @ pose[:3, :3].T + pose[:3, 3]
                values.append(((seen.pixels[mine] - camera.project(points)) / 0.05).ravel())
        return np.concatenate(values)

    scale = np.array(([0.1, 0.1, 0.1, 1e-4] * 2) + [1e-5] * 3 + [1e-2] * 3 + ([1e-5] * 3 + [1e-2] * 3) * 4)
    jacobian = np.stack([(residuals(step) - residuals(-step)) / 2 for step in np.diag(scale)], axis=1)
    dense = np.linalg.inv(jacobian.T @ jacobian) * np.outer(scale, scale)
    independent = [i for i, n in enumerate(rig.parameter_names) if not n.endswith(".fy")]
    assert np.allclose(
        result.covariance[np.ix_(independent, independent)], dense[:14, :14], rtol=2e-3, atol=1e-15
    )
    for view in range(4):
        block = slice(14 + 6 * view, 20 + 6 * view)
        assert np.allclose(result.pose_covariance[view], dense[block, block], rtol=2e-3, atol=1e-15)


def test_robust_loss_holds_against_a_tenth_of_wrong_marks() -> None:
    """With a tenth of the marks off by two pixels the robust optimum stays closer to the truth."""
    rig = make_rig()
    poses = board_poses(rig, BOARD, 6, 1)
    views = synthetic_views(rig, BOARD, poses, 0.02, 3)
    left, right = _observations(views, "left"), _observations(views, "right")
    rng = np.random.default_rng(0)
    wrong = rng.random(len(left.view)) < 0.1
    left = replace(left, pixels=left.pixels + wrong[:, None] * rng.normal(0, 2, left.pixels.shape))
    freedom = LensFreedom(True, ("kappa",))
    state = BundleState(rig.left, rig.right, rig.right_from_left, np.array(poses))
    errors = [
        np.linalg.norm(
            rotation_vector(
                adjust(state, left, right, freedom, freedom, robust=robust).state.right_from_left[:3, :3]
                @ rig.right_from_left[:3, :3].T
            )
        )
        for robust in (True, False)
    ]
    assert errors[0] < 0.5 * errors[1]
