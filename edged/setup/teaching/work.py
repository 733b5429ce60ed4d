"""Functions that the worker process runs for job drafts."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from edged.errors import FileFormatError, TeachError
from edged.files.dxf import read_dxf
from edged.files.images import load_image
from edged.setup.outlines import Line, line
from edged.setup.teaching.model import MOST_DRAWN_POINTS, MOST_OUTLINES
from edged.vision.teaching.foreground import parts_at


def regions_at(pictures: Path, x: float, y: float) -> tuple[Line, ...]:
    """Outlines of the objects around a point of the left picture, largest first."""
    return tuple(line(outline) for outline in parts_at(load_image(pictures / "left.png"), x, y))


def read_drawing(
    data: bytes, name: str, units: str | None, layers: tuple[str, ...]
) -> tuple[tuple[tuple[float, float], ...], ...]:
    """Closed outlines of a DXF drawing, mm. name : of the drawing, for messages.

    Raises `TeachError` with what is wrong and where in the drawing.
    """
    with TemporaryDirectory(prefix="edged-drawing-") as folder:
        path = Path(folder) / "drawing.dxf"
        path.write_bytes(data)
        try:
            outlines = read_dxf(path, layers, units, MOST_DRAWN_POINTS)
        except FileFormatError as error:
            code = f"drawing_{error.code}" if error.code else "drawing"
            raise TeachError(str(error).replace(str(path), name), code, **error.params) from error
    if len(outlines) > MOST_OUTLINES:
        raise TeachError(
            f"{name}: more than {MOST_OUTLINES} outlines: not the drawing of one part", "drawing_large"
        )
    return tuple(tuple((float(x), float(y)) for x, y in outline) for outline in outlines)
