"""Stereo pairs in a folder: `NAME_left.*` and `NAME_right.*`, PNG, TIFF, BMP or JPEG."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from edged.domain.arrays import SIDES, Side
from edged.domain.numerals import is_whole
from edged.errors import ImageError

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


@dataclass(frozen=True, slots=True)
class ImagePair:
    """The two files of one exposure."""

    name: str
    left: Path
    right: Path


def find_pairs(folder: Path) -> list[ImagePair]:
    """Find the pairs of a folder, in natural order of names: v2 comes before v10.

    Raises `ImageError` that names every half without its counterpart and every duplicate, or the
    folder if it holds no pair at all.
    """
    if not folder.is_dir():
        raise ImageError(f"{folder}: not a folder; expected pairs NAME_left.png and NAME_right.png")
    halves: dict[str, dict[str, Path]] = {side: {} for side in SIDES}
    problems: list[str] = []
    for path in sorted(folder.iterdir()):
        name, underscore, side = path.stem.rpartition("_")
        if path.suffix.lower() not in SUFFIXES or not underscore or side not in SIDES:
            continue
        if (known := halves[side].setdefault(name, path)) != path:
            problems.append(f"{path.name}: {known.name} is another picture of the same name")
    for side, other in (SIDES, SIDES[::-1]):
        problems += [
            f"{path.name}: {name}_{other} is missing"
            for name, path in sorted(halves[side].items())
            if name not in halves[other]
        ]
    if problems:
        raise ImageError(f"{folder}: incomplete pairs\n" + "\n".join(f"  {problem}" for problem in problems))
    if not halves["left"]:
        formats = ", ".join(suffix[1:] for suffix in SUFFIXES)
        raise ImageError(f"{folder}: no pictures NAME_left.* and NAME_right.* ({formats})")
    names = sorted(halves["left"], key=_as_counted)
    return [ImagePair(name, halves["left"][name], halves["right"][name]) for name in names]


def _as_counted(name: str) -> tuple[list[str | int], str]:
    """Key for natural order: numbers compare by value; ties, such as 1 and 01, by the plain name."""
    parts = re.split(r"([0-9]+)", name)  # text and numbers alternate
    return [int(part) if index % 2 else part for index, part in enumerate(parts)], name


def half_of(folder: Path, name: str, side: Side) -> Path:
    """The file NAME_SIDE.* of a folder with any of `SUFFIXES`; NAME_SIDE.png if there is none."""
    return next(
        (path for suffix in SUFFIXES if (path := folder / f"{name}_{side}{suffix}").is_file()),
        folder / f"{name}_{side}.png",
    )


def next_number(folder: Path, name: str) -> int:
    """Number after the highest of NAME_NN_left.* and NAME_NN_right.* in a folder; 0 if there is none."""
    numbers = [-1]
    for path in folder.iterdir():
        stem, underscore, side = path.stem.rpartition("_")
        digits = stem.removeprefix(f"{name}_")
        if underscore and side in SIDES and digits != stem and is_whole(digits):
            numbers.append(int(digits))
    return max(numbers) + 1
