"""The actual shape of a board: bent, and not printed exactly to size.

The deviation from the nominal marks, in x, y and z, is a polynomial of low degree in the position on the
board, as the effects of glue, paper, moisture and printers are smooth. Translation, rotation and scaling of
the whole board are no deviations: these seven are excluded (the poses belong to the views, and the size is
taken as stated, as no picture can determine it).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.boards.board import Board, NominalBoard, ShapedBoard
from edged.vision.boards.params import DETECTION

_RANK_TOLERANCE = 1e-9  # relative: rounding


@dataclass(frozen=True, slots=True, eq=False)
class PlateBasis:
    """Deformation modes of a board, orthogonal to each other and to the seven similarities.

    weights (M, Q), similarity (7, Q) : coefficients of the monomials, and of the similarities subtracted, in
    each of Q modes, whose rms deviation over the board is 1 mm.  middle, half (2,) : mm, normalise x and y to
    -1 .. 1.
    """

    middle: FloatArray
    half: FloatArray
    weights: FloatArray
    similarity: FloatArray

    @property
    def count(self) -> int:
        """Number of modes, Q."""
        return int(self.weights.shape[1])

    def at(self, points_mm: FloatArray) -> FloatArray:
        """Deviation (N, 3, Q) in mm at nominal marks (N, 3), per unit of each mode."""
        designs = (
            _monomials(self, points_mm) @ self.weights - _similarities(self, points_mm) @ self.similarity
        )
        return np.asarray(designs.reshape(len(points_mm), 3, -1))


def plate_basis(board: Board) -> PlateBasis:
    """Compute the deformation modes of a board from all its marks."""
    points = nominal(board).points_mm
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    empty = PlateBasis(0.5 * (low + high), 0.5 * (high - low), np.zeros((0, 0)), np.zeros((0, 0)))
    design, rigid = _monomials(empty, points), _similarities(empty, points)
    along = np.linalg.lstsq(rigid, design, rcond=None)[0]
    _, singular, turned = np.linalg.svd(design - rigid @ along, full_matrices=False)
    kept = singular > _RANK_TOLERANCE * singular[0]
    weights = turned[kept].T / singular[kept] * np.sqrt(len(points))
    return PlateBasis(empty.middle, empty.half, weights, along @ weights)


def shaped(board: Board, basis: PlateBasis, coefficients: FloatArray) -> ShapedBoard:
    """The board with its marks displaced by the estimated deformation."""
    stated = nominal(board)
    return ShapedBoard(stated, stated.points_mm + basis.at(stated.points_mm) @ coefficients)


def nominal(board: Board) -> NominalBoard:
    """The nominal board, without a measured shape."""
    return board.stated if isinstance(board, ShapedBoard) else board


def deviation_mm(board: ShapedBoard) -> tuple[float, float]:
    """Height difference between lowest and highest mark, and rms deviation in the board's plane."""
    difference = board.points_mm - board.stated.points_mm
    return float(np.ptp(difference[:, 2])), float(np.sqrt(np.mean(np.sum(difference[:, :2] ** 2, axis=1))))


def _monomials(basis: PlateBasis, points_mm: FloatArray) -> FloatArray:
    """Design matrix (3 N, 3 K): x^i y^j for each coordinate."""
    x, y = ((points_mm[:, :2] - basis.middle) / basis.half).T
    columns = [x**i * y**j for i in range(DETECTION.degree + 1) for j in range(DETECTION.degree + 1 - i)]
    return np.asarray(np.kron(np.stack(columns, axis=1), np.eye(3)))


def _similarities(basis: PlateBasis, points_mm: FloatArray) -> FloatArray:
    """Design matrix (3 N, 7): translations, small rotations and scaling about the middle."""
    arms = points_mm - np.append(basis.middle, 0.0)
    size = float(np.linalg.norm(basis.half))
    turns = [np.cross(axis, arms) / size for axis in np.eye(3)]
    shifts = [np.broadcast_to(axis, arms.shape) for axis in np.eye(3)]
    return np.stack([column.ravel() for column in (*shifts, *turns, arms / size)], axis=1)
