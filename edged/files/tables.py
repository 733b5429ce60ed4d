"""Read tables of numbers from common sources: Excel, a robot's log, typed by hand.

Cells are separated by commas, semicolons, tabs or spaces; if the separator is not a comma, a comma is the
decimal sign. Leading lines without a number are a header; text after `#` is a comment.
"""

from __future__ import annotations

import codecs
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from edged.domain.numerals import decimal
from edged.errors import FileFormatError
from edged.files.atomic import read_bytes

MAX_TEXT_BYTES = 32 << 20
"""Largest file: 600,000 lines of three numbers with all their digits."""
MAX_LINES = 600_000
MAX_LINE_LETTERS = 10_000
"""Longest line, in characters; a pose has seven numbers."""
_DECIMAL_COMMA = re.compile(r"[-+−]?[0-9]+,[0-9]+(?:[eE][-+]?[0-9]+)?")


@dataclass(frozen=True, slots=True)
class TableLine:
    """Cells of a line and its number in the file, from 1; a blank line has no cells."""

    number: int
    cells: tuple[str, ...]


def read_text(path: Path, what: str) -> str:
    """Read a text file, with or without a byte order mark. Raises `FileFormatError`."""
    data = read_bytes(path, what, MAX_TEXT_BYTES)
    encoding = "utf-16" if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: not UTF-8 text (save it as UTF-8): {error}") from error


def read_table(path: Path, what: str = "a table") -> list[TableLine]:
    """Read the lines of a table, including blank ones, without header and comments.

    Raises `FileFormatError`.
    """
    found: list[TableLine] = []
    is_header = True
    for number, line in enumerate(io.StringIO(read_text(path, what), newline=None), 1):
        if number > MAX_LINES:
            raise FileFormatError(f"{path}: more than {MAX_LINES} lines")
        if len(line) > MAX_LINE_LETTERS:
            raise FileFormatError(
                f"{path}: line {number}: {len(line)} letters: expected at most {MAX_LINE_LETTERS}"
            )
        content = line.split("#")[0].strip()
        if content:
            cells = split(content)
            is_header = is_header and not any(_is_number(cell) for cell in cells)
            if not is_header:
                found.append(TableLine(number, cells))
        elif not line.strip() and found:
            found.append(TableLine(number, ()))
    if not any(line.cells for line in found):
        raise FileFormatError(f"{path}: empty: no line with numbers in it")
    return found


def read_named(path: Path, counts: tuple[int, ...], expected: str) -> dict[str, tuple[float, ...]]:
    """Read lines of a name followed by numbers.

    counts : allowed counts of numbers. expected : description of such a line, for messages.
    Raises `FileFormatError` that names the line.
    """
    found: dict[str, tuple[float, ...]] = {}
    for line in read_table(path):
        if not line.cells:
            continue
        place, (name, *cells) = f"{path}: line {line.number}", line.cells
        if len(cells) not in counts:
            raise FileFormatError(f"{place}: expected {expected}, got {len(line.cells)} values")
        if name in found:
            raise FileFormatError(f"{place}: {name} is there twice")
        found[name] = numbers_of(cells, place)
    return found


def numbers_of(cells: Sequence[str], place: str) -> tuple[float, ...]:
    """Parse cells as numbers. Raises `FileFormatError` that begins with the place."""
    try:
        return tuple(number_of(cell) for cell in cells)
    except ValueError as error:
        raise FileFormatError(f"{place}: {error}") from None


def split(content: str) -> tuple[str, ...]:
    """Split a line into cells."""
    for separator in (";", "\t"):
        if separator in content:
            return tuple(_plain(cell) for cell in content.split(separator))
    words = content.split()
    if (
        len(words) > 1
        and not any("," in word.strip(",") and not _DECIMAL_COMMA.fullmatch(word) for word in words)
        and not any(word.endswith(",") for word in words)
    ):
        return tuple(_plain(word) for word in words)
    return tuple(cell.strip().strip('"').strip() for cell in content.split(","))


def number_of(cell: str) -> float:
    """Parse a finite number. Raises ValueError that quotes the text."""
    return decimal(cell.replace("−", "-"))


def _plain(cell: str) -> str:
    """A cell without quotes and with a decimal point."""
    text = cell.strip().strip('"').strip()
    return text.replace(",", ".") if _DECIMAL_COMMA.fullmatch(text) else text


def _is_number(cell: str) -> bool:
    try:
        number_of(cell)
    except ValueError:
        return False
    return True
