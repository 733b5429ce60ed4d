"""Rig to robot: true transforms are found, their sigma is right, and impossible input is refused."""

from __future__ import annotations

import json
import math
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers import cells
from helpers.snapshots import make_target, make_transform
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from scipy.spatial.transform import Rotation
from scipy.special import fdtri

from edged.commands.register import FlangePoses, hand_eye_command, read_poses, self_test, touch
from edged.domain.arrays import FloatArray
from edged.errors import CalibrationError, FileFormatError
from edged.files.rig import load_rig, load_rig_quality, save_rig
from edged.files.touched import read_touched
from edged.robot.covariance import robot_covariance
from edged.robot.handeye import Mount, hand_eye
from edged.robot.orientations import (
    ANGLES_DEG,
    LENGTH_UNITS_MM,
    POSE_FORMATS,
    Brand,
    Convention,
    matrix_quaternion,
    pose_of,
    rotation_vector_rad,
    transform_of,
)
from edged.robot.readings import rank_readings
from edged.robot.touch import register_points
from edged.sim.render.scene import chessboard_plate
from edged.sim.views import calibration_views
from edged.vision.geometry.rigid import apply, invert, quaternion, rotation_vector, transform

ROBOT_FROM_RIG = make_transform((2.9, 0.3, -0.2), (420.0, -60.0, 510.0))
FLANGE_FROM_RIG = make_transform((0.02, -0.03, 1.2), (55.0, -8.0, 90.0))
ROBOT_FROM_BOARD = make_transform((0.1, -0.05, 0.7), (610.0, -120.0, 35.0))
BOARD = "chessboard:9x6:4.0"
BOARD_MM = np.array([[x * 7.0, y * 7.0, 0.0] for y in range(6) for x in range(9)])


def points(rng: np.random.Generator, number: int, sigma_mm: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Points in the rig's frame, and in the robot's with noise."""
    rig = rng.uniform(-60, 60, (number, 3)) + np.array([0, 0, 200])
    return rig, apply(ROBOT_FROM_RIG, rig) + rng.normal(0, sigma_mm, rig.shape)


def poses(
    rng: np.random.Generator,
    number: int,
    mount: Mount = "eye-to-hand",
    sigma_mm: float = 0.0,
    sigma_rad: float = 0.0,
) -> tuple[list[FloatArray], list[FloatArray], FloatArray, FloatArray]:
    """robot_from_flange, rig_from_board, and the true X and Y of a hand-eye."""
    X, Y = ROBOT_FROM_RIG, make_transform((0.1, -0.4, 1.2), (15.0, -8.0, 90.0))
    told, seen = [], []
    for _ in range(number):
        board = transform(
            Rotation.from_rotvec(rng.uniform(-0.6, 0.6, 3)).as_matrix(),
            rng.uniform(-30, 30, 3) + np.array([0, 0, 220]),
        )
        A = X @ board @ invert(Y)
        noise = transform(
            Rotation.from_rotvec(rng.normal(0, sigma_rad, 3)).as_matrix(), rng.normal(0, sigma_mm, 3)
        )
        seen.append(board @ noise)
        told.append(A if mount == "eye-to-hand" else invert(A))
    return told, seen, X, Y


# --- touched points ----------------------------------------------------------------------------


def test_touched_points_give_the_transform() -> None:
    """Exact points give the exact transform, with the scale 1."""
    found = register_points(*points(np.random.default_rng(1), 5))

    assert np.allclose(found.robot_from_rig, ROBOT_FROM_RIG, atol=1e-9)
    assert found.scale == pytest.approx(1.0)
    assert found.held_out_mm.max() < 1e-9


@pytest.mark.long
def test_the_doubt_of_touched_points_is_honest() -> None:
    """Over many draws the squared error in units of the stated covariance is 1 per coordinate."""
    rng, ratios, scales = np.random.default_rng(2), [], []
    for _ in range(300):
        found = register_points(*points(rng, 12, 0.2))
        error = found.robot_from_rig @ invert(ROBOT_FROM_RIG)
        vector = np.concatenate([error[:3, 3], rotation_vector(error[:3, :3])])
        ratios.append(vector @ np.linalg.solve(found.covariance, vector) / 6)
        scales.append(((found.scale - 1) / found.sigma_scale) ** 2)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.12)
    assert np.mean(scales) == pytest.approx(1.07, abs=0.25)


def test_one_wrong_point_stands_out_when_left_out() -> None:
    """A point that is 2 mm off has by far the largest left-out error."""
    rig, robot = points(np.random.default_rng(3), 7, 0.05)
    robot[4] += [0.0, 2.0, 0.0]

    held_out = register_points(rig, robot).held_out_mm
    assert int(np.argmax(held_out)) == 4
    assert held_out[4] > 2 * np.sort(held_out)[-2]


@pytest.mark.slow
@pytest.mark.parametrize("number", [5, 6, 12])
def test_the_wrong_point_is_named_and_no_innocent_one(number: int) -> None:
    """An error of 4 mm in one point names that point and no other, though others often have the larger
    left-out error."""
    named, misleading = [], 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        rig, robot = points(rng, number, 0.05)
        wrong = int(rng.integers(number))
        direction = rng.normal(size=3)
        robot[wrong] += 4.0 * direction / np.linalg.norm(direction)
        found = register_points(rig, robot)
        misleading += int(np.argmax(found.held_out_mm)) != wrong
        named.append(None if found.culprit is None else found.culprit == wrong)

    assert misleading > 0 or number > 5
    assert False not in named
    assert named.count(True) >= 190


def test_of_four_points_in_a_plane_none_is_blamed_for_a_height() -> None:
    """With four points in a plane a wrong height is seen, but no point is named."""
    rig = np.array([[0.0, 0, 200], [50, 0, 200], [50, 40, 200], [0, 40, 200]])
    robot = apply(ROBOT_FROM_RIG, rig) + np.random.default_rng(5).normal(0, 0.02, (4, 3))
    robot[2] += 0.6 * ROBOT_FROM_RIG[:3, 2]
    found = register_points(rig, robot)

    assert found.culprit is None
    assert found.held_out_mm.min() > 0.4


@pytest.mark.slow
def test_good_points_have_no_culprit() -> None:
    """For 300 draws of six good points fewer than 6 have a culprit."""
    rng = np.random.default_rng(6)
    assert sum(register_points(*points(rng, 6, 0.1)).culprit is not None for _ in range(300)) < 6


@pytest.mark.slow
def test_three_points_are_enough_and_know_how_little_they_know() -> None:
    """With three points the error also fits the stated covariance, of three degrees of freedom."""
    rng, ratios = np.random.default_rng(7), []
    rig = np.array([[0.0, 0, 200], [60, 0, 205], [0, 50, 190]])
    for _ in range(1500):
        found = register_points(rig, apply(ROBOT_FROM_RIG, rig) + rng.normal(0, 0.1, (3, 3)))
        error = found.robot_from_rig @ invert(ROBOT_FROM_RIG)
        vector = np.concatenate([error[:3, 3], rotation_vector(error[:3, :3])])
        ratios.append(vector @ np.linalg.solve(found.covariance, vector) / 6)

    # the mean of F(6, 3), which is 3, converges too slowly to be seen; its median does not
    assert np.median(ratios) == pytest.approx(fdtri(6, 3, 0.5) / 3, rel=0.08)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda rig, robot: (rig[:2], robot[:2]), "three or more points"),
        (lambda rig, robot: (rig, robot / 1000), "they look like m, expected mm"),
        (lambda rig, robot: (rig, robot / 25.4), "they look like inches"),
        (lambda rig, robot: (rig, robot * [1, -1, 1]), "a mirror image"),
        (lambda rig, robot: (rig, robot[:, [1, 0, 2]]), "a mirror image"),
        (lambda _, robot: (np.linspace([0, 0, 0], [9, 9, 9], 6), robot), "on one line in the rig"),
        (lambda rig, robot: (np.vstack([rig[:5], rig[:1]]), robot), "points 1 and 6 are nearly the same"),
        (lambda rig, robot: (rig, np.where(robot > 0, np.nan, robot)), "finite"),
    ],
)
def test_points_that_cannot_be_right_are_named(change: object, expected: str) -> None:
    """Wrong units, mirrored, collinear and repeated points are refused with the reason."""
    rig, robot = points(np.random.default_rng(4), 6, 0.1)
    with pytest.raises(CalibrationError, match=expected):
        register_points(*change(rig, robot))


# --- hand-eye ----------------------------------------------------------------------------------


@pytest.mark.parametrize("mount", ["eye-to-hand", "eye-in-hand"])
def test_hand_eye_finds_rig_and_board(mount: Mount) -> None:
    """From exact poses both unknowns are found exactly, for a rig on the flange, too."""
    told, seen, X, Y = poses(np.random.default_rng(5), 8, mount)
    found = hand_eye(told, seen, BOARD_MM, mount)

    assert np.allclose(found.rig, X, atol=1e-6)
    assert np.allclose(found.board, Y, atol=1e-6)
    assert found.rms_mm < 1e-6


@pytest.mark.long
def test_the_doubt_of_hand_eye_is_honest() -> None:
    """The scatter over many draws is that which each draw states."""
    rng, errors, stated, held = np.random.default_rng(6), [], [], []
    told, _, X, _ = poses(np.random.default_rng(7), 14)
    for _ in range(25):
        told, seen, X, _ = poses(rng, 14, sigma_mm=0.05, sigma_rad=0.0005)
        found = hand_eye(told, seen, BOARD_MM, "eye-to-hand")
        error = found.rig @ invert(X)
        at = ROBOT_FROM_RIG @ np.array([0, 0, 220, 1.0])  # where the board was, not the robot's origin
        errors.append((error @ at - at)[:3])
        J = np.hstack([np.eye(3), -_skew(at[:3])])
        stated.append(np.diag(J @ found.covariance @ J.T))
        held.append(np.sqrt(np.mean(found.held_out_mm**2)))
    ratio = np.mean(np.square(errors)) / np.mean(stated)
    assert 0.6 < ratio < 1.6
    assert np.mean(held) < 0.2


def test_a_hand_eye_of_few_poses_says_how_little_it_knows() -> None:
    """With six poses the squared error over the stated variance is about 1."""
    rng, ratios = np.random.default_rng(11), []
    for _ in range(60):
        told, seen, X, _ = poses(rng, 6, sigma_mm=0.05, sigma_rad=0.0005)
        found = hand_eye(told, seen, BOARD_MM, "eye-to-hand", hold_out=False)
        error = found.rig @ invert(X)
        step = np.concatenate([error[:3, 3], rotation_vector(error[:3, :3])])
        ratios.append(np.mean(step**2 / np.diag(found.covariance)))
    assert 0.3 < np.mean(ratios) < 1.6


def _skew(v: FloatArray) -> FloatArray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0.0]])


def test_a_mistyped_pose_is_left_out() -> None:
    """A pose with one wrong digit is left out and named, and does not move the result."""
    told, seen, X, _ = poses(np.random.default_rng(8), 10, sigma_mm=0.02, sigma_rad=0.0002)
    told[3] = transform(told[3][:3, :3], told[3][:3, 3] + [10.0, 0.0, 0.0])

    found = hand_eye(told, seen, BOARD_MM, "eye-to-hand")
    assert np.flatnonzero(~found.used).tolist() == [3]
    assert np.abs(found.rig[:3, 3] - X[:3, 3]).max() < 0.5
    assert found.held_out_mm[3] > 5


@pytest.mark.long
def test_a_mistyped_pose_does_not_keep_the_others_from_being_saved(
    pictured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A wrong pose is rejected and named, and does not count in the verdict or the rig file."""
    lines = (pictured / "poses.csv").read_text().splitlines()
    name, x, *rest = lines[2].split(",")
    lines[2] = ",".join([name, f"{float(x) + 30:.4f}", *rest])
    (tmp_path / "poses.csv").write_text("\n".join(lines))
    output = tmp_path / "registered.json"
    arguments = pictured / "rig.json", FlangePoses(pictured, tmp_path / "poses.csv", BOARD), "kuka"
    console = Console(width=200)

    assert hand_eye_command(*arguments, "eye-to-hand", output, 0.2, False, console) == 0
    assert "rejected as outlier" in capsys.readouterr().out
    note = load_rig_quality(output)["registration"]
    assert (note["poses"], note["rejected"]) == (7, ["p2"])
    assert note["held_out_rms_mm"] < 0.2


def test_motions_that_leave_something_open_are_refused() -> None:
    """Poses with shifts only, or with rotations about one axis, and fewer than four poses are refused."""
    told, seen, X, Y = poses(np.random.default_rng(9), 6)
    shifts = [transform(told[0][:3, :3], pose[:3, 3]) for pose in told]
    with pytest.raises(CalibrationError, match="only shift"):
        hand_eye(shifts, [invert(X) @ pose @ Y for pose in shifts], BOARD_MM, "eye-to-hand")
    about_z = [
        transform(Rotation.from_euler("z", 20 * k, degrees=True).as_matrix(), pose[:3, 3])
        for k, pose in enumerate(told)
    ]
    with pytest.raises(CalibrationError, match="about one axis"):
        hand_eye(about_z, [invert(X) @ pose @ Y for pose in about_z], BOARD_MM, "eye-to-hand")
    with pytest.raises(CalibrationError, match="4 or more poses"):
        hand_eye(told[:3], seen[:3], BOARD_MM, "eye-to-hand")


# --- conventions -------------------------------------------------------------------------------


def shown(brand: Brand, pose: FloatArray) -> tuple[float, ...]:
    """A pose as a brand's controller shows it."""
    R, t = pose[:3, :3], pose[:3, 3]
    if brand is Brand.UR:
        return (*(t / 1000), *rotation_vector_rad(R))
    if brand is Brand.ABB:
        return (*t, *quaternion(R))
    convention = {
        Brand.KUKA: Convention.KUKA_ABC,
        Brand.EPSON: Convention.KUKA_ABC,
        Brand.STAUBLI: Convention.STAUBLI_XYZ,
        Brand.KAWASAKI: Convention.KAWASAKI_OAT,
        Brand.DOOSAN: Convention.KAWASAKI_OAT,
    }.get(brand, Convention.FIXED_XYZ)
    return (*t, *ANGLES_DEG[convention](R))


@pytest.mark.parametrize("brand", list(Brand))
@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1))
def test_what_a_brand_shows_is_read_back(brand: Brand, seed: int) -> None:
    """Reading is the inverse of writing, for every brand and orientation."""
    rng = np.random.default_rng(seed)
    pose = transform(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-900, 900, 3))

    assert np.allclose(transform_of(brand, shown(brand, pose)), pose, atol=1e-6)
    assert np.allclose(transform_of(brand, pose_of(brand, pose)), pose, atol=1e-6)


def test_brands_agree_with_an_independent_library() -> None:
    """The brands' angles agree with scipy's Euler sequences."""
    angles = (31.0, -22.0, 73.0)
    for brand, sequence in (
        (Brand.KUKA, "ZYX"),
        (Brand.FANUC, "xyz"),
        (Brand.YASKAWA, "xyz"),
        (Brand.STAUBLI, "XYZ"),
        (Brand.KAWASAKI, "ZYZ"),
        (Brand.DOOSAN, "ZYZ"),
        (Brand.MITSUBISHI, "xyz"),
        (Brand.EPSON, "ZYX"),
        (Brand.DENSO, "xyz"),
        (Brand.TECHMAN, "xyz"),
    ):
        expected = Rotation.from_euler(sequence, angles, degrees=True).as_matrix()
        assert np.allclose(transform_of(brand, (1, 2, 3, *angles))[:3, :3], expected), brand
    q = Rotation.from_euler("xyz", angles, degrees=True).as_quat()
    assert np.allclose(matrix_quaternion(q[3], *q[:3]), Rotation.from_quat(q).as_matrix())
    v = np.array([0.4, -1.1, 0.7])
    assert np.allclose(transform_of(Brand.UR, (0.1, 0, 0, *v))[:3, :3], Rotation.from_rotvec(v).as_matrix())
    assert transform_of(Brand.UR, (0.1, 0, 0, *v))[0, 3] == pytest.approx(100.0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("brand", "mount"),
    [
        (Brand.UR, "eye-to-hand"),
        (Brand.KUKA, "eye-in-hand"),
        (Brand.ABB, "eye-to-hand"),
        (Brand.KAWASAKI, "eye-to-hand"),
    ],
)
def test_the_self_test_finds_the_convention(brand: Brand, mount: Mount) -> None:
    """The true reading fits best, by a wide margin."""
    told, seen, _, _ = poses(np.random.default_rng(10), 6, mount, 0.02, 0.0002)
    numbers = [shown(brand, pose) for pose in told]

    ranked = rank_readings(numbers, seen, BOARD_MM, POSE_FORMATS, LENGTH_UNITS_MM)

    assert ranked[0].mount == mount
    assert ranked[0].length_unit == ("m" if brand is Brand.UR else "mm")
    word = {Brand.UR: "rotation vector in rad", Brand.ABB: "scalar first"}.get(brand, brand.value)
    assert word in ranked[0].orientation.lower()
    assert ranked[1].rms_mm > 3 * ranked[0].rms_mm


def test_a_wrong_count_or_quaternion_is_named() -> None:
    """A wrong count or quaternion is refused with what the brand shows."""
    with pytest.raises(ValueError, match=r"expected 6 numbers .*A B C in degrees"):
        transform_of(Brand.KUKA, (1.0, 2.0))
    with pytest.raises(ValueError, match="length 2"):
        transform_of(Brand.ABB, (0, 0, 0, 2, 0, 0, 0))


# --- with pictures of a board --------------------------------------------------------------------


@pytest.fixture(scope="module")
def pictured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight rendered pairs of a board on a KUKA's flange, its shown poses, and the rig."""
    folder = tmp_path_factory.mktemp("handeye")
    rig = cells.small_rig()
    save_rig(folder / "rig.json", rig)
    flange_from_board = make_transform((0.2, 0.1, -0.5), (12.0, 5.0, 80.0))
    lines, carried = [], []
    for number, view in enumerate(calibration_views(rig, chessboard_plate(9, 6, 4.0), 8, seed=4)):
        for side, image in (("left", view.left), ("right", view.right)):
            cv2.imwrite(str(folder / f"p{number}_{side}.png"), image)
        flange = ROBOT_FROM_RIG @ view.rig_from_plate @ invert(flange_from_board)
        lines.append(f"p{number}," + ",".join(f"{value:.4f}" for value in shown(Brand.KUKA, flange)))
        holder = ROBOT_FROM_BOARD @ invert(view.rig_from_plate) @ invert(FLANGE_FROM_RIG)
        carried.append(f"p{number}," + ",".join(f"{value:.6f}" for value in shown(Brand.UR, holder)))
    (folder / "poses.csv").write_text("\n".join(lines))
    (folder / "carried.csv").write_text("\n".join(carried))
    return folder


@pytest.mark.slow
def test_hand_eye_from_rendered_boards(pictured: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From rendered pictures robot_from_rig is right to hundredths of a millimetre at the board."""
    output = pictured / "registered.json"
    code = hand_eye_command(
        pictured / "rig.json", FlangePoses(pictured, pictured / "poses.csv", BOARD), "kuka", "eye-to-hand",
        output, 0.2, True, Console(stderr=True),
    )  # fmt: skip
    report = json.loads(capsys.readouterr().out)

    assert (code, report["good"]) == (0, True)
    saved = load_rig(output).robot_from_rig
    assert saved is not None
    at = np.array([0.0, 0.0, 205.0])
    assert np.linalg.norm(apply(saved, at) - apply(ROBOT_FROM_RIG, at)) < 0.05


@pytest.mark.slow
def test_a_carried_rig_from_rendered_boards(pictured: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same pictures with the rig on a UR's flange give flange_from_rig, with date and method in the
    file."""
    output = pictured / "carried.json"
    code = hand_eye_command(
        pictured / "rig.json", FlangePoses(pictured, pictured / "carried.csv", BOARD), "ur", "eye-in-hand",
        output, 0.2, True, Console(stderr=True),
    )  # fmt: skip
    report = json.loads(capsys.readouterr().out)

    assert (code, report["good"]) == (0, True)
    saved = load_rig(output)
    assert saved.robot_from_rig is None
    assert saved.flange_from_rig is not None
    assert saved.registration_covariance is not None
    at = np.array([0.0, 0.0, 205.0])
    assert np.linalg.norm(apply(saved.flange_from_rig, at) - apply(FLANGE_FROM_RIG, at)) < 0.05
    note = load_rig_quality(output)["registration"]
    assert (note["how"], note["poses"]) == ("hand-eye, eye-in-hand", 8)
    assert datetime.fromisoformat(note["when"]).tzinfo is not None


@pytest.mark.long
def test_the_wrong_brand_is_found_out(pictured: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """KUKA's angles read as FANUC's are refused, and the self-test names the right reading."""
    arguments = pictured / "rig.json", FlangePoses(pictured, pictured / "poses.csv", BOARD)
    output = pictured / "wrong.json"
    console = Console(stderr=True)

    assert hand_eye_command(*arguments, "fanuc", "eye-to-hand", output, 0.2, True, console) == 1
    assert not output.exists()
    capsys.readouterr()
    assert self_test(*arguments, "fanuc", True, console) == 1
    report = json.loads(capsys.readouterr().out)
    assert "KUKA" in report["ranked"][0]["orientation"]
    assert report["decided"]
    assert self_test(*arguments, "kuka", True, console) == 0


@pytest.mark.long
def test_poses_need_no_board_in_full(pictured: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The millimetres of a square suffice as board; without them the recognised board is named."""
    rig = pictured / "rig.json"

    def taken(board: str | None) -> FlangePoses:
        return FlangePoses(pictured, pictured / "poses.csv", board)

    console = Console(width=200)

    assert self_test(rig, taken("4.0"), "kuka", False, console) == 0
    assert "board chessboard:9x6:4: a chessboard of 9x6 inner corners" in capsys.readouterr().out
    with pytest.raises(CalibrationError, match=r"--board: .*: chessboard:9x6:MM, or MM alone"):
        self_test(rig, taken(None), "kuka", False, console)
    with pytest.raises(CalibrationError, match="2 boards, expected the one"):
        self_test(rig, taken("chessboard:9x6:4,chessboard:9x6:5"), "kuka", False, console)


# --- files and the command -----------------------------------------------------------------------


def test_touch_saves_only_what_is_good(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A good registration is saved with its covariance, and the old rig is kept; a bad one changes
    nothing."""
    rig_file, table = tmp_path / "rig.json", tmp_path / "points.csv"
    save_rig(rig_file, cells.small_rig())
    before = rig_file.read_bytes()
    rig, robot = points(np.random.default_rng(11), 6, 0.02)
    rows = [",".join(f"{value:.6f}" for value in (*a, *b)) for a, b in zip(rig, robot, strict=True)]
    table.write_text("# touched today\n" + "\n".join(rows[:5]) + "\n")

    assert touch(rig_file, table, rig_file, 1e-4, True, Console(stderr=True)) == 1
    assert rig_file.read_bytes() == before
    assert touch(rig_file, table, rig_file, 0.5, True, Console(stderr=True)) == 0
    reports = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    saved = load_rig(rig_file)
    assert [report["good"] for report in reports] == [False, True]
    assert saved.robot_from_rig is not None
    assert np.abs(saved.robot_from_rig - ROBOT_FROM_RIG).max() < 0.2
    assert saved.registration_covariance is not None
    assert len(list(tmp_path.glob("rig.*.json"))) == 1


def test_each_registration_before_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each former rig is kept, with numbers for the same calibration."""
    rig_file, table = tmp_path / "rig.json", tmp_path / "points.csv"
    save_rig(rig_file, cells.small_rig())
    former = []
    for seed in (11, 12, 12, 13):
        former.append(rig_file.read_bytes())
        rig, robot = points(np.random.default_rng(seed), 6, 0.02)
        rows = [",".join(f"{value:.6f}" for value in (*a, *b)) for a, b in zip(rig, robot, strict=True)]
        table.write_text("\n".join(rows))
        assert touch(rig_file, table, rig_file, 0.5, False, Console(width=200)) == 0

    name = f"rig.{cells.small_rig().calibration_id}"
    different = [*dict.fromkeys(former)]  # the same points within a second are the same rig
    kept = [tmp_path / f"{name}{number}.json" for number in ("", ".2", ".3", ".4")[: len(different)]]
    assert different == [path.read_bytes() for path in kept]
    assert sorted(kept) == sorted(tmp_path.glob("rig.*.json"))
    assert str(kept[-1]) in capsys.readouterr().out.replace("\n", "")


def test_three_touched_points_register(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three points with matching distances register, and it is said that a wrong one would not be seen."""
    rig_file, table = tmp_path / "rig.json", tmp_path / "points.csv"
    save_rig(rig_file, cells.small_rig())
    rig, robot = points(np.random.default_rng(12), 3, 0.02)
    for shift, expected in ((2.0, 1), (0.0, 0)):
        moved = robot + np.array([[shift, shift, shift], [0, 0, 0], [0, 0, 0]])
        rows = [",".join(f"{value:.6f}" for value in (*a, *b)) for a, b in zip(rig, moved, strict=True)]
        table.write_text("\n".join(rows))
        assert expected == touch(rig_file, table, rig_file, 0.5, False, Console(width=200))
        assert "only more points show" in capsys.readouterr().out
    assert load_rig(rig_file).robot_from_rig is not None


def test_a_wrong_point_is_named_on_the_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A wrong point is named by its line, and nothing is saved."""
    rig_file, table = tmp_path / "rig.json", tmp_path / "points.csv"
    save_rig(rig_file, cells.small_rig())
    rig, robot = points(np.random.default_rng(13), 5, 0.02)
    robot[1] += [4.0, 0.0, 0.0]
    rows = [",".join(f"{value:.6f}" for value in (*a, *b)) for a, b in zip(rig, robot, strict=True)]
    table.write_text("\n".join(rows))

    assert 1 == touch(rig_file, table, rig_file, 0.5, False, Console(width=200))
    assert "line 2 is wrong by" in capsys.readouterr().out


def test_results_of_locate_are_points(tmp_path: Path) -> None:
    """The output of `edged locate --json` is a point in a line p1.json,x,y,z."""
    good = {"targets": [{"reject": [], "position_mm": [1.0, 2.0, 3.0]}]}
    (tmp_path / "p1.json").write_text(json.dumps(good))
    (tmp_path / "bad.json").write_text(
        json.dumps({"targets": [{"reject": ["RESIDUAL"], "position_mm": [1, 2, 3]}]})
    )
    table = tmp_path / "points.csv"
    table.write_text("p1.json, 10, 20, 30\n")
    names, rig, robot = read_touched(table)
    assert (names, rig.tolist(), robot.tolist()) == (["p1"], [[1, 2, 3]], [[10, 20, 30]])
    table.write_text("bad.json,1,2,3\n")
    with pytest.raises(FileFormatError, match=r"line 1: .*bad.json: no good target"):
        read_touched(table)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("", "empty"), ("a,1,2,3\n", "line 1: expected NAME and six"),
     ("a,1,2,3,4,5,x\n", "line 1: expected a finite number, got 'x'"),
     ("a,1,2,3,4,5,nan\n", "finite"), ("a,1,2,3,4,5,6\na,1,2,3,4,5,6\n", "line 2: a is there twice")],
)  # fmt: skip
def test_a_bad_line_of_poses_is_named(tmp_path: Path, text: str, expected: str) -> None:
    """A bad line is named by its number."""
    (tmp_path / "poses.csv").write_text(text)
    with pytest.raises(FileFormatError, match=expected):
        read_poses(tmp_path / "poses.csv")


def test_the_registrations_doubt_reaches_the_result() -> None:
    """Sigma in the robot's frame grows with the distance from the touched points."""
    registration = np.diag([1e-4, 1e-4, 1e-4, 1e-8, 1e-8, 1e-8])
    near, far = make_target(x_mm=0.0), make_target(x_mm=1000.0)
    alone = robot_covariance(far, np.eye(4), None)

    assert np.allclose(alone, far.covariance)
    grown = robot_covariance(far, np.eye(4), registration) - alone
    assert math.sqrt(grown[1, 1] - 1e-4) == pytest.approx(1e-4 * math.hypot(1000, 200), rel=1e-3)
    assert robot_covariance(near, np.eye(4), registration)[1, 1] - near.covariance[1, 1] < grown[1, 1]
