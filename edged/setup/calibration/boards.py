"""Finds which board the pictures show: as stated, or recognised in them; its size must be stated."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from typing import TypeVar

import numpy as np

from edged.errors import CalibrationError
from edged.setup.pairs import Picture, Progress, silent, work_on
from edged.vision.boards.board import Charuco, Chessboard, CircleGrid, NominalBoard, parse_boards
from edged.vision.boards.detection import agreed_board, in_words, of_size, recognise_board

LOOKED_AT = 6
"""Pictures examined to recognise a board that was not stated: enough to outvote one where it is cut off."""
_LENGTH = re.compile(r"([0-9]{1,9}(?:[.,][0-9]{1,9})?)\s*(?:mm)?", re.IGNORECASE)

T = TypeVar("T")
Stated = tuple[NominalBoard, ...] | float | None
"""Full specifications of boards; or only the length, mm, of the board in the pictures; or nothing."""


def stated_boards(text: str | None) -> Stated:
    """Parse boards or a length from user input. Raises `CalibrationError` that names the wrong part."""
    if text is None:
        return None
    length = _LENGTH.fullmatch(text.strip())
    return parse_boards(text) if length is None else float(length[1].replace(",", "."))


def boards_in(
    stated: Stated, pictures: Sequence[Picture], progress: Progress = silent
) -> tuple[tuple[NominalBoard, ...], str]:
    """The stated boards, or the one that the pictures show, and a remark on how it was recognised, or "".

    Raises `CalibrationError`: without a length, its message says which board is seen and how to state it.
    """
    if isinstance(stated, tuple):
        return stated, ""
    some = spread(pictures)
    seen = work_on([partial(_recognise, picture) for picture in some], "looking for the board", progress)
    board = _agreed(some, seen)
    where = f"{sum(found is not None for found in seen)} of {len(some)} pictures looked at"
    if stated is None:
        raise CalibrationError(
            f"the pictures show {in_words(board)} ({where}), but not how large it is. Measure "
            f"{_what_to_measure(board)} and state it in mm: {_with_mm(board)}, or MM alone",
            "which_board",
        )
    (whole,) = parse_boards(str(of_size(board, stated)))
    return (whole,), f"board {whole}: {in_words(board)} ({where})"


def check_board_shown(pictures: Sequence[Picture], board: NominalBoard, progress: Progress = silent) -> None:
    """Check pictures without the stated board. Raises `CalibrationError` if most agree on another one."""
    some = spread(pictures)
    looked = work_on(
        [partial(_recognise, picture) for picture in some], "looking for another board", progress
    )
    known = [found for found in looked if found is not None]
    seen = agreed_board(known) if 2 * len(known) > len(some) else None
    if seen is None or may_be(board, seen):
        return
    fits = of_size(seen, board.pitch_mm)
    if isinstance(board, Chessboard) and isinstance(fits, Chessboard):
        raise CalibrationError(
            f"the pictures show {fits.columns}x{fits.rows} inner corners, not {board.columns}x{board.rows}; "
            f"count where four squares meet, not the squares, and state {fits}",
            "other_board",
            stated=str(board),
            seen=str(fits),
        )
    raise CalibrationError(
        f"the pictures show {in_words(seen)}, not {board}; state {fits}",
        "other_board",
        stated=str(board),
        seen=str(fits),
    )


def shows_another(picture: Picture, board: NominalBoard) -> bool:
    """Whether another board is recognised in it: takes a tenth of the time of an unsuccessful search."""
    seen = _recognise(picture)
    return seen is not None and not may_be(board, seen)


def _recognise(picture: Picture) -> NominalBoard | None:
    return recognise_board(picture.read())


def may_be(board: NominalBoard, seen: NominalBoard) -> bool:
    """Whether the stated board could be the one that is seen."""
    if isinstance(board, Charuco) and isinstance(seen, Charuco):
        kinds = [each.dictionary.rpartition("_")[0] for each in (board, seen)]
        return board.columns == seen.columns and board.rows >= seen.rows and kinds[0] == kinds[1]
    if isinstance(board, CircleGrid) and isinstance(seen, CircleGrid):  # 4x10 and 5x8 are the same circles
        return {2 * board.columns, board.rows} == {2 * seen.columns, seen.rows}
    return type(board) is type(seen) and {board.columns, board.rows} == {seen.columns, seen.rows}


def spread(pictures: Sequence[T], most: int = LOOKED_AT) -> list[T]:
    """Up to `most` of the pictures, evenly spread from the first to the last."""
    chosen = np.unique(np.linspace(0, len(pictures) - 1, min(len(pictures), most)).round().astype(int))
    return [pictures[index] for index in chosen]


def _agreed(pictures: Sequence[Picture], seen: Sequence[NominalBoard | None]) -> NominalBoard:
    """The board seen in most pictures. Raises `CalibrationError` if none is seen, or they disagree."""
    known = [board for board in seen if board is not None]
    names = [picture.label for picture in pictures]
    if not known:
        raise CalibrationError(
            f"no board was recognised in {', '.join(names)}; state it, for example "
            "chessboard:11x8:4.0 (inner corners, square in mm)",
            "which_board",
        )
    board = agreed_board(known)
    if board is None:
        lines = [
            f"  {name}: {in_words(found) if found is not None else 'no board recognised'}"
            for name, found in zip(names, seen, strict=True)
        ]
        raise CalibrationError(
            "the pictures do not agree on one board; state it, or several separated by commas:\n"
            + "\n".join(lines),
            "which_board",
        )
    return board


def _with_mm(board: NominalBoard) -> str:
    """The board's specification with MM in place of its length."""
    kind = str(board).partition(":")[0]
    size = f"{kind}:{board.columns}x{board.rows}"
    if isinstance(board, Charuco):
        return f"{size}:MM:MARKER_MM:{board.dictionary}"
    return f"{size}:MM"


def _what_to_measure(board: NominalBoard) -> str:
    if isinstance(board, Chessboard | Charuco):
        return "the side of a square (over ten squares, a tenth of that)"
    if isinstance(board, CircleGrid):
        return "the distance from one row of circles to the next"
    return "the distance from the middle of a dot to the next"
