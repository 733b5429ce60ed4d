"""Measurement model of the tracking of reference marks: expected dots in a pair, and their innovation.

The errors of the taught positions (2, N, 2), and those due to a dot's position in the pixel grid, are
consider parameters, which are never updated: see `edged.vision.marks.tracking`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from edged.domain.arrays import I64, SIDES, FloatArray
from edged.domain.marks import MarksTrack
from edged.vision.geometry.correction import DISPLACEMENT, of_side, seen_with_slopes
from edged.vision.marks.params import MARKS
from edged.vision.marks.taught import TaughtMarks

GRID = np.tile([1e-5, 1e-5, 1e-5, 0.005, 0.005, 0.005, 1e-5], 2)
"""Grid steps of a displacement (rad, mm, share): half a step moves a dot by at most 0.1 px."""


@dataclass(frozen=True, slots=True, eq=False)
class DotsInPair:
    """Dots in both pictures: pixels (2, N, 2), sigma_px (2, N); NaN where a dot was not seen.

    strange : codes in the pictures that were not taught; known only after a search. unlike : taught codes
    whose dot does not look as taught.
    """

    pixels: FloatArray
    sigma_px: FloatArray
    strange: tuple[int, ...] = ()
    unlike: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ObservedDots:
    """Selected dots compared with a track: innovation (M,), its covariance and the gain.

    slopes (M, 14) : Jacobian.  rows (M,) : indices into the taught coordinates.  root (M, M) : the inverse of
    the covariance is root^T root.  common (M, 8 N) : covariance of these coordinates' consider parameters
    with all consider parameters.
    """

    innovation: FloatArray
    root: FloatArray
    gain: FloatArray
    slopes: FloatArray
    rows: I64
    common: FloatArray

    @classmethod
    def observe(
        cls,
        taught: TaughtMarks,
        considered: FloatArray,
        track: MarksTrack,
        dots: DotsInPair,
        marks: I64,
        at: FloatArray | None = None,
    ) -> ObservedDots:
        """Observation of some marks' dots, linearised at a displacement: the track's own, or `at`.

        considered (4 N, 4 N) : covariance of the taught positions. The error from the pixel grid is
        `bias_share` times one of 4 N biases with twice the variance of a single one, as it is the difference
        of the bias at teaching and the present one.
        """
        here = track.displacement if at is None else at
        count = len(taught.codes)
        expected, slopes = expected_dots(taught, here)
        difference = dots.pixels - expected
        chosen = np.zeros((2, count, 2), bool)
        chosen[:, marks] = np.isfinite(dots.pixels[:, marks])
        rows = np.flatnonzero(chosen)
        H = slopes.reshape(-1, DISPLACEMENT)[rows]
        innovation = difference.reshape(-1)[rows] - H @ (track.displacement - here)
        sigma = taught.noise * np.hypot(dots.sigma_px, MARKS.noise_px)
        noise = np.repeat(sigma.reshape(-1) ** 2, 2)[rows]
        places = len(considered)
        share = bias_share(taught, dots).reshape(-1)[rows]
        common = np.zeros((len(rows), 2 * places))
        common[:, :places] = considered[rows]
        common[np.arange(len(rows)), places + rows] = 2.0 * MARKS.bias_px**2 * share
        cross = track.cross[:, rows] + share * track.cross[:, places + rows]
        HC = H @ cross
        considered_too = common[:, rows] + share * common[:, places + rows]
        S = H @ track.covariance @ H.T + HC + HC.T + considered_too + np.diag(noise)
        root = np.asarray(np.linalg.inv(np.linalg.cholesky(S)))
        gain = track.covariance @ H.T + cross
        return cls(innovation, root, gain, H, rows, common)

    @property
    def count(self) -> int:
        """Number of coordinates."""
        return len(self.innovation)

    @property
    def misfit(self) -> float:
        """chi² of the innovation."""
        whitened = self.root @ self.innovation
        return float(whitened @ whitened)

    def applied(self, track: MarksTrack) -> MarksTrack:
        """Update the track with these dots; the consider parameters stay as they are."""
        whitened = self.gain @ self.root.T  # K S^(1/2)
        K = whitened @ self.root
        covariance = track.covariance - whitened @ whitened.T
        cross = track.cross - K @ (self.slopes @ track.cross + self.common)
        return replace(
            track,
            displacement=track.displacement + K @ self.innovation,
            covariance=0.5 * (covariance + covariance.T),
            cross=cross,
        )

    def worst(self, marks: I64) -> int:
        """Index, within `marks`, of the mark whose removal reduces the misfit most.

        Removing rows B reduces the misfit by w_B' (S^-1)_BB^-1 w_B, with w = S^-1 innovation.
        """
        count = self.common.shape[1] // 8
        inverse = self.root.T @ self.root
        weighted = inverse @ self.innovation
        of_mark = self.rows // 2 % count
        gains = []
        for mark in marks:
            rows = np.flatnonzero(of_mark == mark)
            gains.append(weighted[rows] @ np.linalg.solve(inverse[np.ix_(rows, rows)], weighted[rows]))
        return int(np.argmax(gains))


def bias_share(taught: TaughtMarks, dots: DotsInPair) -> FloatArray:
    """Share (2, N, 2) of the bias that remains in the difference between teaching and this exposure.

    A dot that lies where it was taught has the same bias; after moving by a pixel the two are uncorrelated.
    For a bias that is a wave over each pixel the variance goes as 1 - cos(2 pi d), which is
    1 - exp(-2 pi^2 d^2) for small d.
    """
    moved = np.sum((dots.pixels - taught.pixels) ** 2, axis=2, keepdims=True)
    still = MARKS.bias_still**2
    share = np.sqrt(still + (1.0 - still) * -np.expm1(-2.0 * np.pi**2 * moved))
    return np.broadcast_to(share, dots.pixels.shape)


def expected_dots(taught: TaughtMarks, displacement: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Expected positions of the dots (2, N, 2), and their Jacobian by the displacement (2, N, 2, 14).

    Linearised at the nearest point of a grid of displacements, so fine that the nonlinearity within a step is
    below 1e-5 px, and cached: the cameras of a cell stay near one grid point for minutes.
    """
    near = np.round(displacement / GRID) * GRID
    pixels, slopes = _on_grid(taught, near.tobytes())
    return pixels + slopes @ (displacement - near), slopes


@lru_cache(maxsize=8)
def _on_grid(taught: TaughtMarks, displacement: bytes) -> tuple[FloatArray, FloatArray]:
    at: FloatArray = np.frombuffer(displacement)
    pixels = np.array(taught.residual_px)
    slopes = np.zeros((*pixels.shape, DISPLACEMENT))
    for index, side in enumerate(SIDES):
        seen, own, _ = seen_with_slopes(taught.rig, at, side, taught.placed.places_mm)
        pixels[index] += seen
        slopes[index, :, :, of_side(side)] = own
    for array in (pixels, slopes):
        array.flags.writeable = False
    return pixels, slopes


def chance_limit(count: int) -> float:
    """Quantile 1 - 1e-6 of chi² with `count` degrees of freedom (Wilson and Hilferty, PNAS 17, 1931)."""
    share = 2.0 / (9.0 * count)
    return float(count * (1.0 - share + MARKS.chance * math.sqrt(share)) ** 3)
