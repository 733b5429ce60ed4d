"""Types of calibration boards, and the result of detecting one.

A board's frame has x along a row (across the columns), y along a column, z into the board (right-handed, as
seen by a camera that looks at it). Marks are numbered row by row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from edged.domain.arrays import I64, FloatArray, Side
from edged.domain.numerals import decimal, is_whole
from edged.errors import CalibrationError

_MAX_MARKS_PER_SIDE = 100  # limit for a board specification
_GRAMMAR = {
    "chessboard": "chessboard:COLSxROWS:SQUARE_MM (inner corners), e.g. chessboard:11x8:4.0",
    "dots": "dots:COLSxROWS:PITCH_MM[:DIAMETER_MM] (diameter half the pitch if not given), e.g. dots:7x7:5.0",
    "circles": "circles:COLSxROWS:PITCH_MM[:DIAMETER_MM] (asymmetric, in OpenCV's terms: circles in a row "
    "x rows, pitch from row to row; diameter half the pitch if not given), e.g. circles:4x11:5.0",
    "charuco": "charuco:COLSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY (squares), e.g. charuco:12x9:4:3:5X5_250",
}


@dataclass(frozen=True, slots=True)
class Chessboard:
    """columns x rows inner corners, `pitch_mm` apart.

    Mark 0 lies next to a black corner square, if the board has one.
    """

    columns: int
    rows: int
    pitch_mm: float

    @property
    def points_mm(self) -> FloatArray:
        """(N, 3) all marks in the board's frame."""
        return _grid(self.columns, self.rows, self.pitch_mm)

    @property
    def is_symmetric(self) -> bool:
        """Whether the board looks the same turned by 180°, so that one image cannot resolve it."""
        return (self.columns + self.rows) % 2 == 0

    def __str__(self) -> str:
        return f"chessboard:{self.columns}x{self.rows}:{self.pitch_mm:g}"


@dataclass(frozen=True, slots=True)
class DotBoard:
    """columns x rows round marks, `pitch_mm` apart, with a filled corner of the frame next to mark 0."""

    columns: int
    rows: int
    pitch_mm: float
    diameter_mm: float

    @property
    def points_mm(self) -> FloatArray:
        """(N, 3) all marks in the board's frame."""
        return _grid(self.columns, self.rows, self.pitch_mm)

    @property
    def is_symmetric(self) -> bool:
        """False: the orientation mark resolves the orientation."""
        return False

    @property
    def gap_mm(self) -> float:
        """Gap between the edges of neighbouring dots."""
        return self.pitch_mm - self.diameter_mm

    def __str__(self) -> str:
        return f"dots:{self.columns}x{self.rows}:{self.pitch_mm:g}:{self.diameter_mm:g}"


@dataclass(frozen=True, slots=True)
class CircleGrid:
    """Rows of round marks, each shifted by half a step from the previous one; no orientation mark.

    Each row has `columns` marks, two pitches apart; the rows are one pitch apart.
    """

    columns: int
    rows: int
    pitch_mm: float
    diameter_mm: float

    @property
    def lattice(self) -> I64:
        """(N, 2) positions of all marks in whole pitches."""
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        return np.column_stack([2 * column + row % 2, row])

    @property
    def points_mm(self) -> FloatArray:
        """(N, 3) all marks in the board's frame."""
        return np.column_stack([self.lattice * self.pitch_mm, np.zeros(self.columns * self.rows)])

    @property
    def is_symmetric(self) -> bool:
        """True for an even number of rows: it looks the same from the other end."""
        return self.rows % 2 == 0

    @property
    def gap_mm(self) -> float:
        """Gap between the edges of neighbouring marks."""
        return math.sqrt(2) * self.pitch_mm - self.diameter_mm

    def __str__(self) -> str:
        return f"circles:{self.columns}x{self.rows}:{self.pitch_mm:g}:{self.diameter_mm:g}"


@dataclass(frozen=True, slots=True)
class Charuco:
    """A chessboard of columns x rows *squares*, ArUco markers in the white ones; may be partly visible."""

    columns: int
    rows: int
    pitch_mm: float
    marker_mm: float
    dictionary: str

    @property
    def points_mm(self) -> FloatArray:
        """(N, 3) all inner corners in the board's frame."""
        return _grid(self.columns - 1, self.rows - 1, self.pitch_mm)

    @property
    def is_symmetric(self) -> bool:
        """False: the markers resolve the orientation."""
        return False

    def __str__(self) -> str:
        return f"charuco:{self.columns}x{self.rows}:{self.pitch_mm:g}:{self.marker_mm:g}:{self.dictionary}"


NominalBoard = Chessboard | DotBoard | CircleGrid | Charuco


@dataclass(frozen=True, slots=True, eq=False)
class ShapedBoard:
    """A board whose marks were measured: points_mm (N, 3) differs slightly from the nominal points."""

    stated: NominalBoard
    points_mm: FloatArray

    @property
    def pitch_mm(self) -> float:
        """The nominal pitch."""
        return self.stated.pitch_mm

    @property
    def is_symmetric(self) -> bool:
        """False: the numbering was resolved before the shape was measured."""
        return False

    def __str__(self) -> str:
        return f"{self.stated} (shape measured)"


Board = NominalBoard | ShapedBoard


def outline_mm(board: Board, margin_mm: float = 0.0) -> FloatArray:
    """Corners (4, 3) of the rectangle around the marks, from (x_min, y_min) via (x_max, y_min), board frame.

    margin_mm : added on all sides; detectors need to see one pitch beyond the marks.
    """
    (left, top, _), (right, bottom, _) = board.points_mm.min(axis=0), board.points_mm.max(axis=0)
    left, top, right, bottom = left - margin_mm, top - margin_mm, right + margin_mm, bottom + margin_mm
    return np.array([[left, top, 0.0], [right, top, 0.0], [right, bottom, 0.0], [left, bottom, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """A board found in one image.

    ids (N,) : indices of the board's points.  pixels (N, 2).
    sigma_px (N,) : standard deviation of one coordinate, from the fit of that mark.
    blur_px : median sigma of the edge spread.  contrast : median grey value step from black to white.
    """

    ids: I64
    pixels: FloatArray
    sigma_px: FloatArray
    blur_px: float
    contrast: float


@dataclass(frozen=True, slots=True)
class NotDetected:
    """No usable board was found in an image; reason says why."""

    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class StereoView:
    """One pair of images of one board."""

    name: str
    board: Board
    left: Detection | NotDetected
    right: Detection | NotDetected

    def found(self, side: Side) -> Detection:
        """The detection in one image; raises `TypeError` if there is none."""
        detection = self.left if side == "left" else self.right
        if isinstance(detection, NotDetected):
            raise TypeError(f"{self.name}: no board in the {side} image: {detection.reason}")
        return detection


def parse_board(text: str) -> NominalBoard:
    """Parse a board specification such as "chessboard:11x8:4.0".

    Raises `CalibrationError` that names the wrong part and shows the grammar.
    """
    kind, *parts = text.strip().split(":")
    kind = kind.lower()
    if kind not in _GRAMMAR:
        raise CalibrationError(
            f"board {text!r}: {kind!r} is not a kind of board; expected one of\n  "
            + "\n  ".join(_GRAMMAR.values())
        )
    counts = {"chessboard": (2,), "dots": (2, 3), "circles": (2, 3), "charuco": (4,)}[kind]
    if len(parts) not in counts:
        raise CalibrationError(
            f"board {text!r}: {len(parts)} value{'s' if len(parts) != 1 else ''} after the kind, expected "
            f"{_GRAMMAR[kind]}"
        )
    columns, rows = _size(text, kind, parts[0])
    pitch = _length(text, kind, "pitch" if kind in ("dots", "circles") else "square", parts[1])
    if kind == "chessboard":
        return Chessboard(columns, rows, pitch)
    if kind in ("dots", "circles"):
        diameter = _length(text, kind, "diameter", parts[2]) if len(parts) == 3 else pitch / 2
        grid = (DotBoard if kind == "dots" else CircleGrid)(columns, rows, pitch, diameter)
        if grid.gap_mm <= 0:
            raise CalibrationError(
                f"board {text!r}: dots of {diameter:g} mm overlap at a pitch of {pitch:g} mm"
            )
        return grid
    marker = _length(text, kind, "marker", parts[2])
    if marker >= pitch:
        raise CalibrationError(f"board {text!r}: markers of {marker:g} mm do not fit squares of {pitch:g} mm")
    name = parts[3].upper().removeprefix("DICT_")
    if not isinstance(getattr(cv2.aruco, f"DICT_{name}", None), int):
        known = ", ".join(sorted(n[5:] for n in dir(cv2.aruco) if n.startswith("DICT_")))
        raise CalibrationError(
            f"board {text!r}: {parts[3]!r} is not an ArUco dictionary; expected one of {known}"
        )
    markers = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}")).bytesList)
    if columns * rows // 2 > markers:
        raise CalibrationError(
            f"board {text!r}: {columns * rows // 2} markers needed, the dictionary {name} has {markers}"
        )
    return Charuco(columns, rows, pitch, marker, name)


def parse_boards(text: str) -> tuple[NominalBoard, ...]:
    """Parse one or more specifications separated by commas; each view shows one of the boards."""
    return tuple(parse_board(part) for part in text.split(","))


def _size(text: str, kind: str, part: str) -> tuple[int, int]:
    columns, cross, rows = part.lower().partition("x")
    if not (cross and is_whole(columns) and is_whole(rows)):
        raise CalibrationError(f"board {text!r}: {part!r} is not COLSxROWS; expected {_GRAMMAR[kind]}")
    size = int(columns[:9]), int(rows[:9])
    if not all(3 <= n <= _MAX_MARKS_PER_SIDE for n in size):
        raise CalibrationError(f"board {text!r}: {part}: columns and rows must be 3 to {_MAX_MARKS_PER_SIDE}")
    return size


def _length(text: str, kind: str, name: str, part: str) -> float:
    try:
        value = decimal(part)
    except ValueError:
        value = math.nan
    if not 0.001 <= value <= 10_000:
        raise CalibrationError(
            f"board {text!r}: {name} {part!r} is not a length in mm (0.001 to 10000); "
            f"expected {_GRAMMAR[kind]}"
        )
    return value


def _grid(columns: int, rows: int, pitch_mm: float) -> FloatArray:
    y, x = np.mgrid[0:rows, 0:columns].astype(np.float64) * pitch_mm
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(columns * rows)])
