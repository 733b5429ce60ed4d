"""Common to all benches: arguments, `--json FILE`, and access to the helpers of the tests."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

TESTS = Path(__file__).resolve().parent.parent / "tests"
sys.path.insert(0, str(TESTS))


class _Printed:
    """Standard output that remembers what was printed."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self.text = stream, ""

    def write(self, text: str) -> int:
        self.text += text
        return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def bench_parser(doc: str | None) -> argparse.ArgumentParser:
    """A parser whose `--help` is the module's docstring, with `--json FILE`; see `finish`."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here, too")
    if not isinstance(sys.stdout, _Printed):  # one bench may call another
        sys.stdout = _Printed(sys.stdout)
    return parser


def finish(options: argparse.Namespace, figures: Any = None) -> None:
    """Write the figures as JSON where `--json` asks for it; without figures, the printed tables and lines."""
    if options.json is None:
        return
    if figures is None:
        figures = list(_tables(getattr(sys.stdout, "text", "").splitlines()))
    options.json.write_text(json.dumps(figures, indent=1, default=_plain) + "\n")


def wilson(good: int, total: int) -> tuple[float, float]:
    """95 % confidence bounds of a share; 0 and 1 without any. E. B. Wilson, J. Am. Stat. Assoc. 22, 1927."""
    if total == 0:
        return 0.0, 1.0
    z2 = 1.959964**2
    middle = (good + z2 / 2) / (total + z2)
    half = math.sqrt(z2 * (good * (total - good) / total + z2 / 4)) / (total + z2)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def share(good: int, total: int) -> str:
    """A count, and the bounds of its share."""
    low, high = wilson(good, total)
    return f"{good} of {total} ({100 * low:.0f}-{100 * high:.0f} %)"


def _plain(value: Any) -> Any:
    """Convert a dataclass, an array or a path for JSON."""
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


def _tables(lines: list[str]) -> Iterator[Any]:
    """Markdown tables as lists of rows, each {column: cell}; other lines unchanged."""
    rows: list[dict[str, str]] = []
    columns: list[str] = []
    for line in filter(None, (line.strip() for line in lines)):
        cells = [cell.strip() for cell in line.strip("|").split("|")] if line.startswith("|") else []
        if not cells:
            columns = []
            yield line
        elif not columns:
            columns, rows = cells, []
            yield rows
        elif set(line) - set("|-: "):
            rows.append(dict(zip(columns, cells, strict=False)))
