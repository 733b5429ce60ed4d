"""`edged board`: a calibration board or reference marks to print, with rulers to check the print's scale."""

from __future__ import annotations

import math
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from edged.errors import UserError
from edged.files.atomic import write_file
from edged.files.outputs import check_outputs
from edged.files.pdf import PageShapes, Text, one_page
from edged.vision.boards.artwork import Artwork, artwork
from edged.vision.boards.board import NominalBoard, parse_board
from edged.vision.marks.frame import MarkFrame, frame_artwork, parse_frame

PAPERS = {
    "A5": (148.0, 210.0),
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "letter": (215.9, 279.4),
}
MARGIN_MM = 8.0
"""Margin that printers leave blank."""
BESIDE_MM, BELOW_MM = 9.0, 18.0
"""Room for the rulers, and for the lines of text below."""
RULER_MM, STEP_MM = 200.0, 10.0
"""Greatest length of a ruler, and the distance between its marks."""


def board(
    spec: str | None, paper: str | None, output: Path, console: Console, *, marks: str | None = None
) -> int:
    """Write the page of a board or of reference marks. Raises `UserError` if it fits on no paper."""
    if output.suffix.lower() != ".pdf":
        raise UserError(f"{output}: expected a name that ends in .pdf")
    check_outputs({"--output": output})
    if (spec is None) == (marks is None):
        raise UserError("expected either a board, such as chessboard:11x8:15, or --marks")
    wanted = parse_frame(marks) if marks is not None else parse_board(spec or "")
    drawn = frame_artwork(wanted) if isinstance(wanted, MarkFrame) else artwork(wanted)
    name, size = _paper(drawn, paper, wanted)
    write_file(output, one_page(size, *_page(drawn, size, wanted), f"edged {wanted}"))
    console.print(
        f"{escape(str(output))}: {escape(str(wanted))} on {name}, {size[0]:g} x {size[1]:g} mm. "
        "Print it at 100 %, without fitting; then measure both rulers",
        soft_wrap=True,
    )
    return 0


def _paper(
    drawn: Artwork, paper: str | None, wanted: NominalBoard | MarkFrame
) -> tuple[str, tuple[float, float]]:
    """Return name and size (w, h) of the smallest paper on which the board fits, portrait or landscape."""
    known = {name.lower(): name for name in PAPERS}
    if paper is not None and paper.lower() not in known:
        raise UserError(f"--paper {paper!r}: expected one of {', '.join(PAPERS)}")
    names = [known[paper.lower()]] if paper is not None else [n for n in PAPERS if n != "letter"]
    needed = _needed(drawn)
    for name in names:
        short, long = PAPERS[name]
        for size in ((short, long), (long, short)):
            if needed[0] <= size[0] and needed[1] <= size[1]:
                return name, size
    short, long = PAPERS[names[-1]]
    spare = max(
        min(
            (w - needed[0] + _ink(drawn)[0]) / _ink(drawn)[0],
            (h - needed[1] + _ink(drawn)[1]) / _ink(drawn)[1],
        )
        for w, h in ((short, long), (long, short))
    )
    advice = ""
    if spare > 0 and not isinstance(wanted, MarkFrame):
        advice = f"; a pitch of {math.floor(100 * spare * wanted.pitch_mm) / 100:g} mm would fit"
    raise UserError(
        f"{wanted}: needs {needed[0]:.0f} x {needed[1]:.0f} mm with its rulers, {names[-1]} has "
        f"{short:g} x {long:g} mm{advice}"
    )


def _ink(drawn: Artwork) -> tuple[float, float]:
    return drawn.high[0] - drawn.low[0], drawn.high[1] - drawn.low[1]


def _needed(drawn: Artwork) -> tuple[float, float]:
    width, height = _ink(drawn)
    return width + 2 * MARGIN_MM + 2 * BESIDE_MM, height + 2 * MARGIN_MM + BESIDE_MM + BELOW_MM


def _page(
    drawn: Artwork, size: tuple[float, float], wanted: NominalBoard | MarkFrame
) -> tuple[list[PageShapes], list[Text]]:
    """Return board, rulers and text; the board is centred in the space that the text leaves."""
    width, height = _ink(drawn)
    left = (size[0] - width) / 2
    top = MARGIN_MM + BESIDE_MM + (size[1] - _needed(drawn)[1]) / 2
    x0, y0 = left - drawn.low[0], top - drawn.low[1]
    shapes = [
        PageShapes(
            0.0 if ink.black else 1.0,
            [(x + x0, y + y0, w, h) for x, y, w, h in ink.rectangles],
            [(x + x0, y + y0, r) for x, y, r in ink.circles],
            [(a + x0, b + y0, c + x0, d + y0, e + x0, f + y0) for a, b, c, d, e, f in ink.triangles],
        )
        for ink in drawn.ink
    ]
    across = min(RULER_MM, max(math.floor((size[0] - 2 * MARGIN_MM) / STEP_MM) * STEP_MM, STEP_MM))
    along = min(RULER_MM, max(math.floor(height / STEP_MM) * STEP_MM, STEP_MM))
    below = top + height + 7.0
    shapes.append(PageShapes(0.0, _ruler((size[0] - across) / 2, below, across, upright=False)))
    shapes.append(PageShapes(0.0, _ruler(left - 7.0, top, along, upright=True)))
    texts = [
        Text(
            MARGIN_MM,
            below + 5.5,
            3.0,
            f"edged board --marks {wanted}   Print at 100 %, glue it on steel or glass; cut the middle out."
            if isinstance(wanted, MarkFrame)
            else f"edged --board {wanted}   Print at 100 %, glue it on something flat.",
        ),
        Text(
            MARGIN_MM,
            below + 9.5,
            3.0,
            f"The rulers must measure {across:g} mm and {along:g} mm; what they are off, the board is, too.",
        ),
    ]
    return shapes, texts


def _ruler(x: float, y: float, length: float, *, upright: bool) -> list[tuple[float, float, float, float]]:
    """Return a ruler of 0.2 mm wide lines; its ends are the outer edges of its first and last marks."""
    thin, marks = 0.2, round(length / STEP_MM)
    places = [min(k * STEP_MM, length - thin) if k else 0.0 for k in range(marks + 1)]
    if upright:
        return [(x, y, thin, length), *((x - 1.5, y + place, 3.0, thin) for place in places)]
    return [(x, y, length, thin), *((x + place, y - 1.5, thin, 3.0) for place in places)]
