"""`edged board`: the printed board is found by the detector, in the requested size."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pypdfium2
import pytest
from rich.console import Console

from edged.commands.board import PAPERS, board
from edged.domain.arrays import Image
from edged.errors import CalibrationError, UserError
from edged.vision.boards.board import Detection, parse_board
from edged.vision.boards.detection import detect_board
from edged.vision.marks.frame import parse_frame
from edged.vision.marks.measuring import search_marks

DPI = 150
SPECS = ["chessboard:11x8:15", "dots:7x7:20", "charuco:12x9:15:11:5X5_250", "circles:4x11:15:8"]


def printed(spec: str, folder: Path, paper: str | None = None) -> Image:
    """The page as rendered by an independent program."""
    board(spec, paper, folder / "board.pdf", Console(quiet=True))
    page = pypdfium2.PdfDocument(folder / "board.pdf")[0]
    return np.ascontiguousarray(np.squeeze(page.render(scale=DPI / 72, grayscale=True).to_numpy()))


@pytest.mark.slow
@pytest.mark.parametrize("spec", SPECS)
def test_the_printed_board_is_found_in_its_size(spec: str, tmp_path: Path) -> None:
    """Every mark is found, and each distance is right to a thousandth, the page's rounding to whole px."""
    wanted = parse_board(spec)
    found = detect_board(np.asarray(cv2.GaussianBlur(printed(spec, tmp_path), (0, 0), 0.8), np.uint8), wanted)
    assert isinstance(found, Detection)
    assert len(wanted.points_mm) == len(found.ids)
    seen = found.pixels[np.argsort(found.ids)] * 25.4 / DPI
    far = np.array([0, len(wanted.points_mm) - 1])
    true = float(np.linalg.norm(np.diff(wanted.points_mm[far], axis=0)))
    assert pytest.approx(true, rel=1e-3) == float(np.linalg.norm(np.diff(seen[far], axis=0)))


def test_the_rulers_have_their_length(tmp_path: Path) -> None:
    """The horizontal ruler is 200 mm long."""
    page = printed("chessboard:11x8:15", tmp_path)
    rows = [np.flatnonzero(row < 128) for row in page]
    longest = max((row for row in rows if len(row) and np.ptp(row) + 1 == len(row)), key=len)
    assert pytest.approx(200.0, abs=0.3) == len(longest) * 25.4 / DPI


def test_the_smallest_paper_that_fits_is_taken(tmp_path: Path) -> None:
    """The smallest paper that fits is used, or the requested one, rotated if needed."""
    assert printed("chessboard:5x4:10", tmp_path).shape[0] < 1.01 * PAPERS["A5"][1] / 25.4 * DPI
    wide = printed("chessboard:11x8:15", tmp_path, "a4")
    assert wide.shape[1] > wide.shape[0]


@pytest.mark.parametrize(
    ("spec", "paper", "name", "message"),
    [
        ("chessboard:11x8:30", "A4", "b.pdf", "A4 has 210 x 297 mm; a pitch of"),
        ("chessboard:11x8:300", None, "b.pdf", "A1 has"),
        ("chessboard:11x8:15", "A9", "b.pdf", "expected one of A5, A4"),
        ("chessboard:11x8:15", None, "b.png", "ends in .pdf"),
        ("chess:11x8:15", None, "b.pdf", "not a kind of board"),
    ],
)
def test_what_cannot_be_printed_is_named(
    spec: str, paper: str | None, name: str, message: str, tmp_path: Path
) -> None:
    """The error names the board, the paper and what would fit, and nothing is written."""
    with pytest.raises((UserError, CalibrationError), match=message):
        board(spec, paper, tmp_path / name, Console(quiet=True))
    assert [] == list(tmp_path.iterdir())


def test_the_pitch_that_is_offered_fits(tmp_path: Path) -> None:
    """The pitch suggested by the error fits."""
    with pytest.raises(UserError) as caught:
        board("chessboard:11x8:30", "A4", tmp_path / "b.pdf", Console(quiet=True))
    pitch = str(caught.value).partition("a pitch of ")[2].split()[0]
    assert 0 == board(f"chessboard:11x8:{pitch}", "A4", tmp_path / "b.pdf", Console(quiet=True))


@pytest.mark.slow
def test_printed_marks_are_found_where_they_were_asked_for(tmp_path: Path) -> None:
    """Every code is found, and each distance of two dots is right to a thousandth."""
    board(None, None, tmp_path / "m.pdf", Console(quiet=True), marks="120x90:8:6:40")
    page = pypdfium2.PdfDocument(tmp_path / "m.pdf")[0]
    image = np.ascontiguousarray(np.squeeze(page.render(scale=DPI / 72, grayscale=True).to_numpy()))
    found, frame = search_marks(image), parse_frame("120x90:8:6:40")
    assert tuple(frame.codes) == found.codes
    seen = found.centres_px * 25.4 / DPI
    apart = seen - seen[0] - (frame.places[:, :2] - frame.places[0, :2])
    assert np.abs(apart).max() < 0.6


@pytest.mark.parametrize(("spec", "marks"), [(None, None), ("chessboard:11x8:15", "120x90:8:4")])
def test_a_board_or_marks_are_drawn_not_both(tmp_path: Path, spec: str | None, marks: str | None) -> None:
    """Both and neither are refused."""
    with pytest.raises(UserError, match="either a board"):
        board(spec, None, tmp_path / "b.pdf", Console(quiet=True), marks=marks)


def test_marks_that_fit_on_no_paper_are_refused(tmp_path: Path) -> None:
    """The error names the largest paper."""
    with pytest.raises(UserError, match="A1 has"):
        board(None, None, tmp_path / "b.pdf", Console(quiet=True), marks="2000x90:8:4")
