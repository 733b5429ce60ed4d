"""Poses as a robot's pendant shows them: labels, rounding, and pasted text."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from edged.errors import UserError
from edged.robot.orientations import LENGTH_UNITS_MM, POSE_FORMATS, Brand, transform_of
from edged.vision.geometry.rigid import transform


@dataclass(frozen=True, slots=True)
class Pendant:
    """Format of a pose on a pendant. labels : of position and orientation, in order.

    length : "mm" or "m". angle : "deg", "rad", or "" for a quaternion. shape : template of a pose in the
    maker's language, with %s for each number.
    """

    labels: tuple[str, ...]
    length: str
    angle: str
    shape: str = ""

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each label."""
        return (self.length,) * 3 + (self.angle,) * (len(self.labels) - 3)

    def rounded(self, numbers: tuple[float, ...]) -> list[str]:
        """Numbers rounded as the pendant shows them: to 0.01 mm and 0.001°."""
        digits = {"mm": 2, "m": 5, "deg": 3, "rad": 5, "": 6}
        units = self.units[: len(numbers)]
        return [f"{number:.{digits[unit]}f}" for number, unit in zip(numbers, units, strict=True)]

    def text(self, numbers: tuple[float, ...]) -> str:
        """Format a pose or position, to read or copy."""
        shown = self.rounded(numbers)
        if self.shape and len(numbers) == len(self.labels):
            return self.shape % tuple(shown)
        return ", ".join(
            f"{label} {number}" for label, number in zip(self.labels[: len(shown)], shown, strict=True)
        )


PENDANTS: dict[Brand, Pendant] = {
    Brand.UR: Pendant(("X", "Y", "Z", "RX", "RY", "RZ"), "m", "rad", "p[%s, %s, %s, %s, %s, %s]"),
    Brand.KUKA: Pendant(("X", "Y", "Z", "A", "B", "C"), "mm", "deg", "{X %s, Y %s, Z %s, A %s, B %s, C %s}"),
    Brand.FANUC: Pendant(("X", "Y", "Z", "W", "P", "R"), "mm", "deg"),
    Brand.YASKAWA: Pendant(("X", "Y", "Z", "Rx", "Ry", "Rz"), "mm", "deg"),
    Brand.ABB: Pendant(("X", "Y", "Z", "q1", "q2", "q3", "q4"), "mm", "", "[[%s, %s, %s], [%s, %s, %s, %s]]"),
    Brand.STAUBLI: Pendant(("X", "Y", "Z", "Rx", "Ry", "Rz"), "mm", "deg"),
    Brand.KAWASAKI: Pendant(("X", "Y", "Z", "O", "A", "T"), "mm", "deg"),
    Brand.DOOSAN: Pendant(("X", "Y", "Z", "A", "B", "C"), "mm", "deg", "posx(%s, %s, %s, %s, %s, %s)"),
    Brand.MITSUBISHI: Pendant(("X", "Y", "Z", "A", "B", "C"), "mm", "deg", "(%s, %s, %s, %s, %s, %s)"),
    Brand.EPSON: Pendant(("X", "Y", "Z", "U", "V", "W"), "mm", "deg"),
    Brand.DENSO: Pendant(("X", "Y", "Z", "RX", "RY", "RZ"), "mm", "deg"),
    Brand.TECHMAN: Pendant(("X", "Y", "Z", "Rx", "Ry", "Rz"), "mm", "deg"),
}


def mm_per_unit(brand: Brand) -> float:
    """Unit of length on the brand's pendant, in mm."""
    return LENGTH_UNITS_MM[PENDANTS[brand].length]


# --- pasted ---------------------------------------------------------------------------------------

_LONGEST = 2000
_SIGNED = r"(?<![A-Za-z0-9_.,])[-+]?"
_TAIL = r"(?:[eE][-+]?[0-9]+)?"
_END = r"(?![0-9_])"
"""A number followed by an underscore does not count; the digits here prevent matching a part of it."""
_POINT = re.compile(rf"{_SIGNED}(?:[0-9]+\.?[0-9]*|\.[0-9]+){_TAIL}{_END}")
_POINT_OR_COMMA = re.compile(rf"{_SIGNED}(?:[0-9]+(?:[.,][0-9]+)?|[.,][0-9]+){_TAIL}{_END}")
_BEYOND = re.compile(r"\)\s*\(|[,\s]S\s*:?\s*[0-9]+\s*,?\s*T\b")
"""Begin of configuration and turns after the pose: MELFA's second bracket, KUKA's S and T."""
_NEXT_GROUP = re.compile(r"\]\s*,\s*\[")
"""Separator of the groups of a robtarget, of which the first two are position and orientation."""


def numbers_in(text: str, counts: tuple[int, ...]) -> tuple[float, ...]:
    """Extract the numbers of one pose or point from text, however they are separated and labelled.

    counts : allowed counts. Labels, brackets, degree signs, units and text after a pose are ignored; a comma
    is the decimal sign where something else separates, or where only that gives an allowed count.
    Raises `UserError`.

    >>> numbers_in("X 512,03  Y -88,12  Z 35,40", (3,))
    (512.03, -88.12, 35.4)
    >>> numbers_in("p[0.1,0.2,0.3,0,3.14,0]", (6, 7))
    (0.1, 0.2, 0.3, 0.0, 3.14, 0.0)
    """
    if len(text) > _LONGEST:
        raise UserError(f"expected one pose, got {len(text)} letters")
    plain = text.replace("−", "-").replace("–", "-").replace("\u00a0", " ")
    plain = ", ".join(_NEXT_GROUP.split(_BEYOND.split(plain)[0])[:2]).strip()
    separated = _floats(_POINT.findall(plain.replace(",", " ")))
    decimal = _floats(_POINT_OR_COMMA.findall(plain))
    for found in (decimal,) if _is_decimal(plain) else (separated, decimal):
        if len(found) in counts and all(map(math.isfinite, found)):
            return found
    expected = " or ".join(map(str, counts))
    got = len(decimal if _is_decimal(plain) else separated)
    raise UserError(f"expected {expected} numbers, got {got}: {plain[:80]}")


def _is_decimal(plain: str) -> bool:
    """Whether every comma is a decimal sign: between digits, once per number, and other separators exist."""
    commas = re.findall(r"[0-9],[0-9]", plain)
    others = re.search(r"[0-9]\.[0-9]|,(?![0-9])|(?<![0-9]),|,[0-9]+,", plain)
    return bool(commas) and others is None and re.search(r"[0-9]\S*[\s;]+\S*[0-9]", plain) is not None


def _floats(found: list[str]) -> tuple[float, ...]:
    return tuple(float(text.replace(",", ".")) for text in found)


# --- readings -------------------------------------------------------------------------------------

READING_CODES: dict[str, str] = dict(
    zip(
        POSE_FORMATS,
        (
            "vector-rad",
            "vector-deg",
            "zyx-deg",
            "zyx-rad",
            "fixed-deg",
            "fixed-rad",
            "moving-deg",
            "moving-rad",
            "oat-deg",
            "oat-rad",
            "scalar-first",
            "scalar-last",
        ),
        strict=True,
    )
)
"""Codes of the `POSE_FORMATS`, for programs and for the web page, which translates them."""


def brands_of(orientation: str, length_unit: str) -> tuple[Brand, ...]:
    """Brands whose pendants write poses in this orientation and unit; may be none or several."""
    count, reader = POSE_FORMATS[orientation]
    unit = np.array((0.5, 0.1, 0.7, 0.5)) if count == 4 else np.array((0.4, -0.7, 1.1))
    probe = (1.0, 2.0, 3.0, *(unit / np.linalg.norm(unit) if count == 4 else unit).tolist())
    pose = transform(np.asarray(reader(*probe[3:])), LENGTH_UNITS_MM[length_unit] * np.array(probe[:3]))
    return tuple(
        brand
        for brand in Brand
        if len(PENDANTS[brand].labels) == len(probe) and np.allclose(transform_of(brand, probe), pose)
    )
