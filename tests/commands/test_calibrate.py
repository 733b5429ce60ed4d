"""`edged calibrate`: from a folder of pictures to a rig file; every bad folder has its own message."""

from __future__ import annotations

import io
import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.boards import board_poses, draw_board, right_pose
from helpers.rigs import make_rig
from rich.console import Console

from edged.commands.calibrate import calibrate
from edged.errors import UserError
from edged.files.rig import load_rig, save_rig
from edged.vision.boards.board import parse_board

SPEC = "chessboard:8x6:6"
RIG = make_rig(focal_px=1590.0, size=(640, 480))


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six pairs of a board drawn through RIG, with noise."""
    folder = tmp_path_factory.mktemp("pictures")
    board = parse_board(SPEC)
    for number, pose in enumerate(board_poses(RIG, board, 6, seed=3)):
        for side, camera, camera_pose in (
            ("left", RIG.left, pose),
            ("right", RIG.right, right_pose(RIG, pose)),
        ):
            image = draw_board(board, camera, camera_pose, noise=1.5, seed=number)
            cv2.imwrite(str(folder / f"v{number}_{side}.png"), image)
    return folder


@pytest.fixture
def folder(pictures: Path, tmp_path: Path) -> Path:
    """A copy of four pairs that a test may spoil."""
    return Path(shutil.copytree(pictures, tmp_path / "pictures", ignore=shutil.ignore_patterns("v[45]_*")))


def run(
    folder: Path, output: Path, report: Path | None = None, board: str | None = SPEC, model: str = "division"
) -> str:
    """Run the command and return its output."""
    said = io.StringIO()
    assert calibrate(folder, board, output, model, report, Console(file=said, width=200)) == 0
    return said.getvalue()


@pytest.mark.long
def test_a_folder_becomes_a_rig(pictures: Path, tmp_path: Path) -> None:
    """The rig is the true one within its stated sigma and reproducible, the old file is kept under its own
    calibration id, and a registration is dropped."""
    output, report = tmp_path / "rig.json", tmp_path / "report.html"
    save_rig(output, replace(RIG, robot_from_rig=np.eye(4)))
    said = run(pictures, output, report)
    rig = load_rig(output)
    assert "run `edged register` again" in said
    assert rig.robot_from_rig is None
    assert load_rig(tmp_path / "rig.test.json").robot_from_rig is not None
    assert rig.covariance is not None
    sigma = np.sqrt(np.diag(rig.covariance))
    names = list(rig.parameter_names)
    for side, found, true in (("left", rig.left, RIG.left), ("right", rig.right, RIG.right)):
        for name in ("fx", "cx", "cy"):
            error = getattr(found, name) - getattr(true, name)
            assert abs(error) < 4 * sigma[names.index(f"{side}.{name}")]
    shift = rig.right_from_left[:3, 3] - RIG.right_from_left[:3, 3]
    assert (np.abs(shift) < 4 * sigma[-3:]).all()
    quality = json.loads(output.read_text())["quality"]
    assert quality["stereo_rms_px"] < 0.04
    assert quality["views"] == 6
    assert "stereo rms" in said
    page = report.read_text()
    assert str(pictures) not in page  # it is read on other PCs
    assert "pairs in the folder pictures" in page
    assert "it may be good beside orange fields" in page
    assert rig.calibration_id in page
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")

    old = output.read_bytes()
    said = run(pictures, output)
    kept = tmp_path / f"rig.{rig.calibration_id}.json"
    assert kept.read_bytes() == old
    assert kept.name in said
    assert json.loads(old) == json.loads(output.read_text())


@pytest.mark.long
def test_the_lens_model_is_chosen_and_told(pictures: Path, tmp_path: Path) -> None:
    """With model "auto" the command, the report and the rig file state the chosen model and its weight."""
    output, report = tmp_path / "rig.json", tmp_path / "report.html"
    said = run(pictures, output, report, model="auto")
    weights = json.loads(output.read_text())["quality"]["lenses"]
    assert {"division", "brown", "brown without p1, p2"} == set(weights)
    best = max(weights, key=lambda name: weights[name])
    assert best.split()[0] == load_rig(output).left.model
    words = f"chosen by the views: {best} ({100 * weights[best]:.0f} %"
    assert f"lens model {words}" in said
    assert words in report.read_text()


@pytest.mark.slow
def test_a_report_does_not_replace_the_rig(pictures: Path, tmp_path: Path) -> None:
    """Using the same file for both is refused before the work."""
    path = tmp_path / "x.json"
    with pytest.raises(UserError, match="--output and --report are the same file"):
        calibrate(pictures, "chessboard:9x6:5.0", path, "division", path, Console(stderr=True))
    assert not (tmp_path / "x.json").exists()


@pytest.mark.long
def test_jpeg_and_bmp_are_read_too(folder: Path, tmp_path: Path) -> None:
    """Pictures may be of any format OpenCV reads without loss of meaning."""
    for number, suffix in ((0, ".jpg"), (1, ".bmp"), (2, ".TIF")):
        for side in ("left", "right"):
            path = folder / f"v{number}_{side}.png"
            cv2.imwrite(str(path.with_suffix(suffix.lower())), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
            path.with_suffix(suffix.lower()).rename(path.with_suffix(suffix))
            path.unlink()
    run(folder, tmp_path / "rig.json")
    assert json.loads((tmp_path / "rig.json").read_text())["quality"]["views"] == 4


def refused(
    folder: Path, tmp_path: Path, expected: str, board: str | None = SPEC, model: str = "division"
) -> None:
    """The command raises a UserError matching `expected`, and leaves an existing rig unchanged."""
    output = tmp_path / "rig.json"
    output.write_text("precious")
    with pytest.raises(UserError, match=expected):
        run(folder, output, board=board, model=model)
    assert output.read_text() == "precious"
    assert sorted(path.name for path in tmp_path.glob("*rig*")) == ["rig.json"]


@pytest.mark.slow
def test_missing_halves_are_refused(folder: Path, tmp_path: Path) -> None:
    """The error names the pictures without a partner."""
    (folder / "v2_right.png").unlink()
    (folder / "v3_left.png").unlink()
    refused(folder, tmp_path, r"v2_left.png: v2_right is missing(.|\n)*v3_right.png: v3_left is missing")


@pytest.mark.slow
def test_mixed_sizes_are_refused(folder: Path, tmp_path: Path) -> None:
    """The error names the picture with its size and the usual one."""
    image = cv2.imread(str(folder / "v1_left.png"), cv2.IMREAD_GRAYSCALE)
    cv2.imwrite(str(folder / "v1_left.png"), image[:400])
    refused(folder, tmp_path, r"640 x 480(.|\n)*v1_left.png: 640 x 400")


@pytest.mark.slow
def test_a_broken_picture_is_refused(folder: Path, tmp_path: Path) -> None:
    """The error names a file that is no picture."""
    (folder / "v3_left.png").write_bytes(b"not a picture")
    refused(folder, tmp_path, "v3_left.png: not an image")


@pytest.mark.long
def test_the_wrong_count_of_corners_is_refused(folder: Path, tmp_path: Path) -> None:
    """The error names the board that is in the pictures, or the reason for every view."""
    refused(
        folder, tmp_path, r"--board: .*show 8x6 .*, not 12x4.* chessboard:8x6:6", board="chessboard:12x4:6"
    )
    refused(
        folder,
        tmp_path,
        "--board: .*a chessboard of 8x6 inner corners, not dots:8x6:6[^;]*; state chessboard:8x6:",
        board="dots:8x6:6",
    )
    for grey, path in enumerate(sorted(folder.glob("*.png")), 90):
        cv2.imwrite(str(path), np.full((480, 640), grey, np.uint8))
    expected = r"0 of 4 pairs(.|\n)*v0: left: no 12x4 inner corners"
    refused(folder, tmp_path, expected, board="chessboard:12x4:6")


@pytest.mark.slow
def test_without_a_board_the_pictures_are_asked(folder: Path, tmp_path: Path) -> None:
    """The error names the recognised board, and says what length to measure and enter."""
    refused(
        folder,
        tmp_path,
        r"a chessboard of 8x6 inner corners \(4 of 4 .*(.|\n)*Measure the side of a square"
        r"(.|\n)*: chessboard:8x6:MM, or MM alone",
        board=None,
    )


@pytest.mark.long
def test_a_length_alone_suffices(folder: Path, tmp_path: Path) -> None:
    """The board is recognised, reported, and stored in the rig as if it had been stated in full.

    A wrong length scales the baseline and cannot be seen in pictures, which the output says.
    """
    said = run(folder, tmp_path / "rig.json", board="6,06 mm")
    first, second, *_ = said.splitlines()
    assert "board chessboard:8x6:6.06: a chessboard of 8x6 inner corners (4 of 4 pictures looked at)" == first
    assert "the pictures cannot prove it" in said
    assert load_rig(tmp_path / "rig.json").baseline_mm == pytest.approx(RIG.baseline_mm * 1.01, rel=1e-3)
    assert second.split() == ["left", "right"]  # no progress is shown without a terminal
    assert "chessboard:8x6:6.06" == json.loads((tmp_path / "rig.json").read_text())["quality"]["board"]


@pytest.mark.slow
def test_pictures_that_disagree_are_listed(folder: Path, tmp_path: Path) -> None:
    """If pictures show different boards, each is named with what it shows, in the order of the folder."""
    other = parse_board("chessboard:7x5:6")
    for number, pose in enumerate(board_poses(RIG, other, 2, seed=5)):
        cv2.imwrite(str(folder / f"v{number}_left.png"), draw_board(other, RIG.left, pose))
    refused(
        folder,
        tmp_path,
        r"do not agree(.|\n)*v0_left.png: a chessboard of 7x5 inner corners(.|\n)*v3_left.png: a chess.*8x6",
        board="6",
    )


@pytest.mark.slow
def test_pictures_without_a_board_are_named(folder: Path, tmp_path: Path) -> None:
    """If no board is recognised, the error says so, with an example of a board."""
    for path in folder.glob("*.png"):
        cv2.imwrite(str(path), np.full((480, 640), 90, np.uint8))
    refused(
        folder, tmp_path, "no board was recognised in v0_left.png(.|\n)*example chessboard:11x8", board=None
    )


@pytest.mark.slow
def test_one_camera_twice_is_refused(folder: Path, tmp_path: Path) -> None:
    """If left and right are the same file, every pair is named and nothing is calibrated."""
    for left in folder.glob("*_left.png"):
        shutil.copy(left, left.with_name(left.name.replace("left", "right")))
    refused(folder, tmp_path, r"0 of 4 pairs(.|\n)*v0: left: the left and the right picture are the same")


@pytest.mark.slow
def test_both_images_of_one_camera_are_refused(folder: Path, tmp_path: Path) -> None:
    """Two exposures of the same camera have no baseline, which the error says."""
    rng = np.random.default_rng(0)
    for left in folder.glob("*_left.png"):
        image = cv2.imread(str(left), cv2.IMREAD_GRAYSCALE)
        noisy = np.clip(image + rng.normal(0, 1.5, image.shape), 0, 255).astype(np.uint8)
        cv2.imwrite(str(left.with_name(left.name.replace("left", "right"))), noisy)
    refused(folder, tmp_path, "both cameras are in one place")


@pytest.mark.slow
def test_a_copied_pair_counts_once(folder: Path, tmp_path: Path) -> None:
    """A duplicate pair is left out by name, as it would make the sigmas too small."""
    for side in ("left", "right"):
        shutil.copy(folder / f"v2_{side}.png", folder / f"v9_{side}.png")
    said = run(folder, tmp_path / "rig.json")
    assert "v9: left: the same picture as in v2" in said
    assert json.loads((tmp_path / "rig.json").read_text())["quality"]["views"] == 4


@pytest.mark.slow
def test_one_view_only_is_refused(folder: Path, tmp_path: Path) -> None:
    """A single pair is refused."""
    for path in folder.glob("v[1-3]_*"):
        path.unlink()
    refused(folder, tmp_path, "1 of 1 pairs show the board in both images, expected at least 3")


@pytest.mark.slow
def test_a_blurred_view_is_named(folder: Path, tmp_path: Path) -> None:
    """A blurred view is named, whether it is used or left out."""
    image = cv2.imread(str(folder / "v3_left.png"), cv2.IMREAD_GRAYSCALE)
    cv2.imwrite(str(folder / "v3_left.png"), cv2.GaussianBlur(image, (0, 0), 3))
    said = run(folder, tmp_path / "rig.json")
    assert "v3" in said
    assert "blurred" in said


@pytest.mark.slow
def test_unknown_model_and_impossible_outputs_are_refused(folder: Path, tmp_path: Path) -> None:
    """An unknown model and impossible outputs are refused before the work."""
    refused(folder, tmp_path, "expected one of auto, division, brown", model="fisheye")
    for output in (tmp_path, tmp_path / "nowhere" / "rig.json"):
        with pytest.raises(UserError, match="folder"):
            run(folder, output)


@pytest.mark.slow
def test_an_interrupt_leaves_no_file(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After Ctrl-C the output folder is unchanged."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("edged.setup.calibration.views.detect_board", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(folder, tmp_path / "rig.json")
    assert [path.name for path in tmp_path.iterdir()] == ["pictures"]
