"""Calibrating without a console: the same numbers as the command, with pairs added and removed."""

from __future__ import annotations

import io
import json
from collections import Counter
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.boards import board_poses, draw_board, right_pose
from helpers.rigs import make_rig
from rich.console import Console

from edged.commands.calibrate import calibrate
from edged.commands.verify import verify
from edged.domain.arrays import Image
from edged.errors import CalibrationError, ImageError
from edged.files.pairs import ImagePair
from edged.files.rig import load_rig, load_rig_quality, save_rig
from edged.setup.calibration.checking import Limits, by_board
from edged.setup.calibration.views import Calibrated, Views, solve
from edged.setup.pairs import Pair, Picture
from edged.vision.boards.board import NotDetected, parse_board

SPEC = "chessboard:8x6:6"
BOARD = parse_board(SPEC)
RIG = make_rig(focal_px=1590.0, size=(640, 480))
Images = dict[str, tuple[Image, Image]]


@pytest.fixture(scope="module")
def images() -> Images:
    """Six pairs of a board drawn through RIG, with noise."""
    drawn: Images = {}
    for number, pose in enumerate(board_poses(RIG, BOARD, 6, seed=3)):
        left = draw_board(BOARD, RIG.left, pose, noise=1.5, seed=number)
        right = draw_board(BOARD, RIG.right, right_pose(RIG, pose), noise=1.5, seed=number)
        drawn[f"v{number}"] = left, right
    return drawn


@pytest.fixture(scope="module")
def solved(images: Images) -> Calibrated:
    """A rig solved from arrays, after a seventh pair was added and removed, and a copy of one added first."""
    views = Views([BOARD])
    views.add([Pair.of_images(name, *pair) for name, pair in images.items() if name != "v5"])
    views.add([Pair.of_images("v5", *images["v0"])])
    assert isinstance(views.found[-1].left, NotDetected)
    views.add([Pair.of_images("v5", *images["v5"]), Pair.of_images("v6", *images["v1"])])
    views.remove("v6")
    return solve(views, "division")


@pytest.mark.long
def test_arrays_and_files_give_the_same_rig_to_the_last_bit(
    images: Images, solved: Calibrated, tmp_path: Path
) -> None:
    """Parameters, covariance, id and quality are bit-identical."""
    folder, output = tmp_path / "pictures", tmp_path / "rig.json"
    folder.mkdir()
    for name, pair in images.items():
        for side, image in zip(("left", "right"), pair, strict=True):
            cv2.imwrite(str(folder / f"{name}_{side}.png"), image)
    assert calibrate(folder, SPEC, output, "division", None, Console(file=io.StringIO())) == 0

    written = load_rig(output)
    assert solved.rig.calibration_id == written.calibration_id
    assert solved.rig.covariance is not None
    assert written.covariance is not None
    assert solved.rig.covariance.tobytes() == written.covariance.tobytes()
    assert solved.rig.right_from_left.tobytes() == written.right_from_left.tobytes()
    assert json.loads(json.dumps(solved.quality)) == load_rig_quality(output)


@pytest.mark.long
def test_each_picture_is_read_twice(images: Images) -> None:
    """Each picture is read once to find the board and once to measure, with small copies kept for the report.

    The first one is read once more, to find out early if the board was stated wrongly.
    """
    reads: Counter[str] = Counter()

    def counted(label: str, image: Image) -> Image:
        reads[label] += 1
        return image

    def pair(name: str, left: Image, right: Image) -> Pair:
        labels = [(f"{name}_left", left), (f"{name}_right", right)]
        return Pair(name, *(Picture(label, partial(counted, label, image)) for label, image in labels))

    views = Views([BOARD])
    views.add([pair(name, *both) for name, both in images.items()])
    solved = solve(views, "division")

    expected = {f"{name}_{side}": 2 for name in images for side in ("left", "right")}
    assert expected | {f"{next(iter(images))}_left": 3} == dict(reads)
    assert list(images) == list(solved.thumbnails)
    assert {(180, 240)} == {small.shape for both in solved.thumbnails.values() for small in both}


@pytest.mark.slow
def test_a_check_says_the_same_to_the_last_bit(
    images: Images, solved: Calibrated, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A check of a pair in memory equals that of the command exactly."""
    paths = [tmp_path / f"{side}.png" for side in ("left", "right")]
    for path, image in zip(paths, images["v2"], strict=True):
        cv2.imwrite(str(path), image)
    save_rig(tmp_path / "rig.json", solved.rig, solved.quality)
    limits = Limits(0.3, 0.1)

    verify(tmp_path / "rig.json", (paths[0], paths[1]), SPEC, None, [], limits, True, Console())
    said = json.loads(capsys.readouterr().out)
    found = by_board(load_rig(tmp_path / "rig.json"), images["v2"], [BOARD], limits)

    assert said["verdict"] == found.verdict
    assert said["epipolar_rms_px"] == found.epipolar_rms_px
    assert [one["measured_mm"] for one in said["lengths"]] == [one.measured_mm for one in found.lengths]


@pytest.mark.long
def test_progress_counts_each_stage_to_its_end(images: Images) -> None:
    """Stages of many pieces report all of them, others only their start."""
    told: list[tuple[str, int, int]] = []
    views = Views([BOARD])
    views.add(
        [Pair.of_images(name, *images[name]) for name in ("v0", "v1", "v2")], lambda *now: told.append(now)
    )
    solve(views, "division", progress=lambda *now: told.append(now))
    last = {stage: (done, total) for stage, done, total in told}

    assert (6, 6) == last["finding the board"] == last["measuring the marks and edges"]
    assert (0, 0) == last["bundle adjustment"] == last["holding views out"] == last["the verdict"]


@pytest.mark.slow
def test_whoever_is_told_can_end_the_work(images: Images) -> None:
    """An exception in the progress function ends the work, and no pair is added."""

    def stop(stage: str, done: int, total: int) -> None:
        raise InterruptedError(stage)

    views = Views([BOARD])
    with pytest.raises(InterruptedError, match="finding the board"):
        views.add([Pair.of_images("v0", *images["v0"])], stop)
    assert [] == views.pairs


@pytest.mark.slow
def test_a_picture_that_cannot_be_read_adds_none(images: Images, tmp_path: Path) -> None:
    """If one picture cannot be read, none of the pairs is added."""
    broken = ImagePair("broken", tmp_path / "no_left.png", tmp_path / "no_right.png")
    views = Views([BOARD])
    with pytest.raises(ImageError, match=r"no_left\.png"):
        views.add([Pair.of_images("v0", *images["v0"]), Pair.of_files(broken)])
    assert [] == views.pairs


def test_nothing_gives_no_rig() -> None:
    """Without pairs an error says so."""
    with pytest.raises(CalibrationError, match="no pairs"):
        solve(Views([BOARD]), "division")


@pytest.mark.slow
def test_pairs_of_several_sizes_are_named(images: Images) -> None:
    """Pictures of an unusual size are named, with the usual size."""
    left, right = images["v0"]
    views = Views([BOARD])
    views.add([Pair.of_images("v0", left, right), Pair.of_images("v1", *images["v1"])])
    views.add([Pair.of_images("odd", np.ascontiguousarray(left[:-2]), right)])
    with pytest.raises(CalibrationError, match=r"most are 640 x 480, but\n  odd_left: 640 x 478"):
        solve(views, "division")
