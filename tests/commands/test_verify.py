"""`edged verify`: a rig that holds, a turned camera, a wrong baseline, and undecided cases."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.boards import board_poses, draw_board, right_pose, synthetic_views
from helpers.cells import flange
from helpers.rigs import make_rig
from rich.console import Console

from edged.commands.verify import verify
from edged.domain.arrays import FloatArray
from edged.errors import ImageError, UserError
from edged.files.jobs import save_job
from edged.files.rig import save_rig
from edged.setup.calibration.checking import Limits
from edged.vision.boards.board import Chessboard, NotDetected, parse_board
from edged.vision.calibration.verification import Length, check_board, pose_of_board
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import make_rectification
from edged.vision.geometry.rigid import rotation_matrix, transform
from edged.vision.teaching.pair import teach

RIG = make_rig(focal_px=1590.0, size=(640, 480))
SPEC = "dots:7x7:5"
LIMITS = Limits(0.3, 0.1)


def longer_baseline(rig: StereoRig, factor: float) -> StereoRig:
    """The rig with its baseline multiplied by a factor."""
    relation = rig.right_from_left.copy()
    relation[:3, 3] *= factor
    return replace(rig, right_from_left=relation)


def turned(rig: StereoRig, degrees: tuple[float, float, float]) -> StereoRig:
    """The rig with its right camera turned."""
    turn = transform(rotation_matrix(np.radians(degrees)), np.zeros(3))
    return replace(rig, right_from_left=turn @ rig.right_from_left)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pair of a plate and one of a part, their rigs, and the taught part."""
    folder = tmp_path_factory.mktemp("verify")
    board, part = parse_board(SPEC), flange()
    pose = board_poses(RIG, board, 1, seed=4)[0]
    for side, camera, place in (("left", RIG.left, pose), ("right", RIG.right, right_pose(RIG, pose))):
        cv2.imwrite(str(folder / f"{side}.png"), draw_board(board, camera, place, noise=1.5))
    cv2.imwrite(str(folder / "blank.png"), np.full((480, 640), 90, np.uint8))
    cv2.imwrite(str(folder / "small.png"), np.full((240, 320), 90, np.uint8))
    for side, image in (("left", part.left), ("right", part.right)):
        cv2.imwrite(str(folder / f"part_{side}.png"), image)
    save_rig(folder / "rig.json", RIG)
    save_rig(folder / "part_rig.json", part.rig)
    save_job(folder / "job", teach(part.left, part.right, make_rectification(part.rig), part.region, "f", 1))
    return folder


def run(
    folder: Path,
    rig: str = "rig.json",
    images: tuple[str, str] = ("left.png", "right.png"),
    **options: object,
) -> tuple[int, str]:
    """Exit code and output."""
    arguments = {"board": None, "job": None, "lengths": [], "limits": LIMITS} | options
    said = io.StringIO()
    code = verify(
        folder / rig,
        (folder / images[0], folder / images[1]),
        arguments["board"],
        arguments["job"],
        arguments["lengths"],
        arguments["limits"],
        as_json=False,
        console=Console(file=said, width=200),
    )
    return code, said.getvalue()


@pytest.mark.slow
def test_a_rig_that_holds_is_ok(folder: Path) -> None:
    """The true rig passes, and the output says what rows alone cannot show."""
    code, said = run(folder, board=SPEC)
    assert code == 0
    assert said.startswith("OK test")
    assert "Rows alone do not see a wrong baseline" in said


@pytest.mark.slow
def test_the_pitch_alone_names_the_plate(folder: Path) -> None:
    """The plate is recognised in the pair and reported before the verdict."""
    code, said = run(folder, board="5.0 mm")
    assert code == 0
    assert said.startswith("board dots:7x7:5:2.5")
    assert "a plate of 7x7 dots (2 of 2 pictures looked at)" in said
    assert "\nOK test" in said


@pytest.mark.slow
def test_a_wrong_baseline_is_seen_by_the_length_alone(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a baseline 0.5 % too long, all rows agree but the plate is 0.5 % too large, and the verdict
    NOT_OK."""
    save_rig(folder / "long.json", longer_baseline(RIG, 1.005))
    console = Console(file=io.StringIO())
    images = folder / "left.png", folder / "right.png"
    code = verify(folder / "long.json", images, SPEC, None, [], LIMITS, as_json=True, console=console)
    document = json.loads(capsys.readouterr().out)
    assert (code, document["verdict"]) == (1, "NOT_OK")
    assert document["epipolar_rms_px"] < 0.05
    (length,) = document["lengths"]
    assert length["error_percent"] == pytest.approx(0.5, abs=0.03)
    assert length["verdict"] == "NOT_OK"
    assert document["board"]["marks"] == 49
    assert "size" not in document["board"]


@pytest.mark.slow
def test_a_turned_camera_is_seen_by_the_rows(folder: Path) -> None:
    """A right camera turned by 0.05° about its x axis moves rows by more than a pixel."""
    save_rig(folder / "turned.json", turned(RIG, (0.05, 0.0, 0.0)))
    code, said = run(folder, "turned.json", board=SPEC)
    assert code == 1
    assert "epipolar rms" in said
    assert "too large" in said


@pytest.mark.slow
def test_a_wrong_plate_is_a_wrong_length(folder: Path) -> None:
    """A plate stated 1 % too large is NOT_OK."""
    code, said = run(folder, board="dots:7x7:5.05")
    assert code == 1
    assert said.startswith("NOT_OK")


@pytest.mark.slow
def test_a_limit_below_the_noise_is_undecided(folder: Path) -> None:
    """If the view is too uncertain for the limit, the verdict is UNDECIDED and states its uncertainty."""
    code, said = run(folder, board=SPEC, limits=Limits(0.3, 1e-4))
    assert code == 1
    assert said.startswith("UNDECIDED")
    assert "length uncertainty of this view" in said


@pytest.mark.slow
@pytest.mark.parametrize("images", [("blank.png", "right.png"), ("left.png", "blank.png")])
def test_no_plate_is_no_verdict(images: tuple[str, str], folder: Path) -> None:
    """A picture without the plate gives exit code 1 with a reason."""
    code, said = run(folder, images=images, board=SPEC)
    assert code == 1
    assert f"{'left' if images[0] == 'blank.png' else 'right'}: " in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, "either --board SPEC or --job DIR"),
        ({"board": SPEC, "job": Path("x")}, "either --board SPEC or --job DIR"),
        ({"board": SPEC, "lengths": ["c0=1"]}, "--length belongs to --job"),
        ({"board": "plate:3x3"}, "not a kind of board"),
        ({"board": SPEC, "limits": Limits(float("nan"), 0.1)}, "expected finite numbers"),
        (
            {"board": SPEC, "images": ("small.png", "right.png")},
            "small.png: left image: 320x240, the rig was calibrated for 640x480",
        ),
        ({"board": SPEC, "rig": "left.png"}, "not JSON"),
        ({"board": SPEC, "images": ("nothing.png", "right.png")}, "no such file"),
    ],
)
def test_wrong_usage_is_named(options: dict[str, object], expected: str, folder: Path) -> None:
    """The error names what is wrong."""
    with pytest.raises(UserError) as caught:
        run(folder, **options)
    assert expected in str(caught.value)


# --- a part instead of a board ------------------------------------------------------------------


def run_part(folder: Path, *lengths: str, rig: str = "part_rig.json") -> tuple[int, str]:
    """`run` with the part's pictures and job."""
    images = "part_left.png", "part_right.png"
    return run(folder, rig, images, job=folder / "job", lengths=list(lengths))


@pytest.mark.slow
def test_a_part_of_known_size_verifies_a_rig(folder: Path) -> None:
    """With a known diameter and a distance of two holes the rig is OK."""
    circles = [circle.centre_mm for circle in teach_circles()]
    distance = float(np.linalg.norm(circles[2] - circles[3]))
    code, said = run_part(folder, "c0=28.0", f"c2-c3={distance:.5f}")
    assert code == 0, said
    assert "c0, true 28 mm" in said


def teach_circles() -> tuple[object, ...]:
    """Circles of the job."""
    part = flange()
    return teach(part.left, part.right, make_rectification(part.rig), part.region, "f", 1).circles


@pytest.mark.slow
def test_a_part_shows_a_wrong_baseline(folder: Path) -> None:
    """A baseline 1 % too long is NOT_OK, as the part is 1 % too large."""
    save_rig(folder / "part_long.json", longer_baseline(flange().rig, 1.01))
    code, said = run_part(folder, "c0=28.0", rig="part_long.json")
    assert code == 1
    assert said.startswith("NOT_OK")


@pytest.mark.slow
def test_a_part_without_a_known_length_is_refused(folder: Path) -> None:
    """It is refused, as rows alone do not show a wrong baseline."""
    with pytest.raises(UserError, match="Rows alone do not see a wrong baseline"):
        run_part(folder)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("length", "expected"),
    [("c0", "expected NAME=MM"), ("c0=-1", "expected NAME=MM"), ("c0=nan", "expected NAME=MM"),
     ("c99=5", "the job has c0, c1"), ("c0-c99=5", "the job has c0, c1")],
)  # fmt: skip
def test_an_unknown_length_is_named(length: str, expected: str, folder: Path) -> None:
    """An unknown feature is refused with the known ones."""
    with pytest.raises(UserError) as caught:
        run_part(folder, length)
    assert expected in str(caught.value)


@pytest.mark.slow
def test_no_part_is_no_verdict(folder: Path) -> None:
    """Without the part in the picture the verdict is UNDECIDED with NO_TARGET."""
    code, said = run(
        folder, "part_rig.json", ("blank.png", "blank.png"), job=folder / "job", lengths=["c0=28"]
    )
    assert code == 1
    assert said.startswith("UNDECIDED")
    assert "NO_TARGET" in said


# --- the numbers --------------------------------------------------------------------------------


def check_of(
    rig: StereoRig, board: Chessboard, pose: FloatArray, seed: int, sigma_px: float = 0.05
) -> Length:
    """The length that `rig` measures for a board seen by RIG with noise."""
    view = synthetic_views(RIG, board, [pose], sigma_px, seed)[0]
    placed = pose_of_board(rig, view)
    assert not isinstance(placed, NotDetected)
    return check_board(rig, *placed).size


@pytest.mark.slow
def test_the_stated_sigma_of_the_size_is_its_scatter() -> None:
    """Over 120 draws of noise, the normalised error of the length has a standard deviation of 1."""
    board = Chessboard(8, 6, 4.0)
    pose = board_poses(RIG, board, 1, seed=2)[0]
    sizes = [check_of(RIG, board, pose, seed) for seed in range(120)]
    normalised = np.array([size.error_mm / size.sigma_mm for size in sizes])
    assert abs(normalised.mean()) < 0.25
    assert 0.83 < normalised.std() < 1.17


@pytest.mark.parametrize("factor", [0.98, 1.002])
def test_the_size_is_the_error_of_the_baseline(factor: float) -> None:
    """Without noise the length is wrong by exactly the baseline's factor."""
    board = Chessboard(8, 6, 4.0)
    pose = board_poses(RIG, board, 1, seed=2)[0]
    size = check_of(longer_baseline(RIG, factor), board, pose, 0, sigma_px=0.0)
    assert size.measured_mm / size.true_mm == pytest.approx(factor, abs=1e-9)


def test_a_symmetric_board_may_be_numbered_from_either_end() -> None:
    """The rows determine which end of a symmetric board comes first in the right image."""
    board = Chessboard(8, 6, 4.0)
    view = synthetic_views(RIG, board, [board_poses(RIG, board, 1, seed=2)[0]], 0.02, 0)[0]
    right = view.found("right")
    other_end = replace(view, right=replace(right, ids=len(board.points_mm) - 1 - right.ids))
    for each in (view, other_end):
        placed = pose_of_board(RIG, each)
        assert not isinstance(placed, NotDetected)
        assert check_board(RIG, *placed).epipolar_rms_px < 0.05


@pytest.mark.parametrize(
    ("error", "sigma", "expected"),
    [(0.05, 0.01, "OK"), (0.2, 0.01, "NOT_OK"), (-0.2, 0.01, "NOT_OK"), (0.09, 0.01, "UNDECIDED"),
     (0.11, 0.01, "UNDECIDED"), (0.0, 0.1, "UNDECIDED")],
)  # fmt: skip
def test_the_verdict_leaves_room_for_the_uncertainty(error: float, sigma: float, expected: str) -> None:
    """OK and NOT_OK keep two sigma from the limit on either side, as ISO 14253-1 does."""
    assert Length("x", 100.0, 100.0 + error, sigma).verdict(0.1) == expected


@pytest.mark.slow
def test_images_of_another_size_are_refused(folder: Path) -> None:
    """An ImageError names both sizes."""
    with pytest.raises(ImageError, match="640x480"):
        run(folder, images=("small.png", "small.png"), board=SPEC)
