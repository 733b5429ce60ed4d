"""Verdicts on the samples of a registration, with known truth."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.rigs import make_rig

from edged.domain.arrays import FloatArray
from edged.robot.orientations import Brand, pose_of
from edged.setup.registration import verdict
from edged.setup.registration.verdict import Judged, judge_points, judge_poses
from edged.vision.boards.board import parse_boards
from edged.vision.geometry.rigid import apply, invert, rotation_matrix, transform

RIG = make_rig()
(BOARD,) = parse_boards("chessboard:11x8:4")
ROBOT_FROM_RIG = transform(rotation_matrix(np.array([2.0, 0.3, -0.4])), np.array([600.0, -40.0, 900.0]))
FLANGE_FROM_BOARD = transform(rotation_matrix(np.array([0.1, 3.0, 0.2])), np.array([10.0, -20.0, 80.0]))
PLACES = np.random.default_rng(4).uniform(-80, 80, (6, 3)) + np.array([0, 0, 400.0])


def touched(change: FloatArray | float = 1.0, brand: Brand = Brand.KUKA, rig_scale: float = 1.0) -> Judged:
    """Six points with 10 µm of noise. change : factor of the typed values; rig_scale : of the rig's
    lengths."""
    noise = np.random.default_rng(5).normal(0, 0.01, (6, 3))
    shown = (apply(ROBOT_FROM_RIG, PLACES) + noise) * change
    if brand is Brand.UR:
        shown = shown / 1000
    points = {
        f"point_{k}": (rig_scale * place, tuple(numbers.tolist()))
        for k, (place, numbers) in enumerate(zip(PLACES, shown, strict=True))
    }
    return judge_points(RIG, points, brand, 0.5)


def told(judged: Judged) -> tuple[str, dict[str, str | float]]:
    """Code and params of the trouble, with which nothing is registered."""
    assert judged.trouble is not None and judged.registered is None
    return judged.trouble.code, judged.trouble.params


def test_touches_that_agree_are_good_in_any_brands_units() -> None:
    """Agreeing touches are good with the noise's sigma, also for a robot that uses metres."""
    for brand in (Brand.KUKA, Brand.UR):
        judged = touched(brand=brand)
        assert judged.trouble is None and judged.registered is not None
        assert judged.registered.rig.robot_from_rig is not None
        off = apply(judged.registered.rig.robot_from_rig, PLACES) - apply(ROBOT_FROM_RIG, PLACES)
        assert np.abs(off).max() < 0.025
        assert 0.002 < max(judged.sigma[:3]) < 0.02


def test_a_board_of_another_length_a_mirror_and_other_units_are_told() -> None:
    """A wrong board length, a mirrored axis and other units each have a code, with percent or unit."""
    code, params = told(touched(rig_scale=1.02))
    assert "scale" == code
    assert -1.96 == pytest.approx(params["percent"], abs=0.02)
    assert "mirrored" == told(touched(np.array([1.0, -1.0, 1.0])))[0]
    assert ("other_units", {"unit": "mm"}) == told(touched(1000.0, Brand.UR))
    assert ("other_units", {"unit": "m"}) == told(touched(0.001))
    assert ("other_units", {"unit": "inch"}) == told(touched(1 / 25.4))


def test_points_that_say_too_little_are_told_by_name() -> None:
    """Too few points, a repeated place, and points on a line are named."""
    zero = (0.0, 0.0, 0.0)
    assert ("too_few", {"count": 1, "least": 3}) == told(
        judge_points(RIG, {"point_1": (PLACES[0], zero)}, Brand.KUKA, 0.5)
    )
    line = {f"point_{k}": (np.array([k * 10.0, 0, 400]), (k * 10.0, 0.0, 0.0)) for k in range(4)}
    assert "on_one_line" == told(judge_points(RIG, line, Brand.KUKA, 0.5))[0]
    twice = {**line, "point_9": (np.array([10.0, 0, 400]), (10.0, 0.0, 0.0))}
    code, params = told(judge_points(RIG, twice, Brand.KUKA, 0.5))
    assert ("same_place", {"one": "point_1", "two": "point_9"}) == (code, params)


def posed(turns_deg: list[tuple[float, float, float]], brand: Brand | None = Brand.KUKA) -> Judged:
    """Poses of a KUKA whose flange is turned like this, about its own axes, from one pose."""
    flange = transform(rotation_matrix(np.array([3.0, 0.1, 0.2])), np.array([500.0, 50.0, 300.0]))
    poses = {}
    for k, turn in enumerate(turns_deg):
        turned = transform(rotation_matrix(np.radians(turn)), np.array([3.0 * k, -2.0 * k, k % 3]))
        robot_from_flange = flange @ turned
        view = invert(ROBOT_FROM_RIG) @ robot_from_flange @ FLANGE_FROM_BOARD
        poses[f"pose_{k}"] = (view, pose_of(Brand.KUKA, robot_from_flange))
    return judge_poses(RIG, poses, BOARD, brand, "eye-to-hand", 0.5)


@pytest.mark.long
def test_the_turn_that_poses_lack_is_told() -> None:
    """The missing kind of turn is named: all, tilts, or tilts in one direction."""
    assert "all" == posed([(0, 0, 0)] * 4).missing
    wrist = posed([(0, 0, k * 15) for k in range(4)])
    assert ("tilt", "turns_missing") == (wrist.missing, told(wrist)[0])
    assert [0, 15, 30, 45] == pytest.approx([one.turn_deg for one in wrist.sky.values()])
    assert "wrist" == posed([(k * 10, 0, 0) for k in range(4)]).missing
    both = posed([(0, 0, 0), (20, 0, 0), (0, 20, 0), (0, 0, 30)])
    assert ("", None) == (both.missing, both.trouble)
    tilts = [(round(one.tilt_deg, 6), round(one.azimuth_deg, 6)) for one in both.sky.values()]
    assert [(0, 0), (20, -90), (20, 0), (0, 0)] == tilts


@pytest.mark.long
def test_poses_that_no_equation_takes_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of the linear algebra has the code "calibration"."""

    def fail(*_: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(verdict, "from_poses", fail)
    judged = posed([(0, 0, 0), (20, 0, 0), (0, 20, 0), (0, 0, 30)])
    assert judged.trouble is not None
    assert ("calibration", "SVD did not converge") == (judged.trouble.code, judged.trouble.text)


@pytest.mark.long
def test_poses_of_nobody_are_ranked_and_of_a_stranger_told() -> None:
    """Without a brand the best reading comes first, and KUKA numbers are not read as FANUC's."""
    turns = [(0, 0, 0), (20, 5, 0), (0, 20, 10), (-10, 0, 30), (5, -15, -20)]
    nobody = posed(turns, None)
    assert "no_brand" == told(nobody)[0]
    assert "A B C" == nobody.readings[0].orientation[:5]
    code, params = told(posed(turns, Brand.FANUC))
    assert ("other_reading", "kuka", "zyx-deg", "fixed") == (
        code,
        *(params[name] for name in ("brand", "orientation", "mount")),
    )
    right = posed(turns)
    assert right.registered is not None
    assert 0 == right.stated
