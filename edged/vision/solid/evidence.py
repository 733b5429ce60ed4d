"""Evidence of both pictures for a pose, against chance and against other poses.

Edges are looked for at every sample that a pose predicts. An edge within a pixel may be there by chance, more
often where the surroundings have many edges; and an edge that is there may not show where two surfaces happen
to be equally bright. Neighbouring samples see the same thing: together they count as one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from edged.domain.arrays import B8, I64, FloatArray
from edged.vision.solid.edgemodel import EdgeModel, are_unbroken, chains_of
from edged.vision.solid.lock import Pyramids, edges_beside, seen_by
from edged.vision.solid.params import EVIDENCE, LOCK
from edged.vision.solid.visible import find_neighbours


@dataclass(frozen=True, slots=True, eq=False)
class PoseEvidence:
    """Evidence of the samples of a pose, those of the left camera first.

    hit (M,) : an edge lies within a pixel.  chance (M,) : probability of that by chance.
    curve (M,) : number of the model's curve.  pixels (M, 2), camera (M,).
    walled (M,) : both faces are turned to the camera.
    """

    hit: B8
    chance: FloatArray
    curve: I64
    pixels: FloatArray
    camera: I64
    walled: B8

    def log_ratio(self, chosen: B8 | None = None, *, by_edge: bool = False) -> FloatArray:
        """(K,) log likelihood ratio of the part against chance, of each block of the chosen samples.

        by_edge : an edge does not show in a picture as a whole, however long it is: its blocks together say
        no more against the part than that.
        """
        rows = np.arange(len(self.hit)) if chosen is None else np.flatnonzero(chosen)
        if not len(rows):
            return np.zeros(0)
        key = self.curve[rows] * 2 + self.camera[rows]
        new = np.r_[True, key[1:] != key[:-1]]
        place = np.arange(len(rows)) - np.maximum.accumulate(np.where(new, np.arange(len(rows)), 0))
        first = np.flatnonzero(new | (place % EVIDENCE.block == 0))
        counts = np.diff(np.r_[first, len(rows)])
        share = np.add.reduceat(self.hit[rows].astype(np.float64), first) / counts
        chance = np.clip(np.add.reduceat(self.chance[rows], first) / counts, 0.02, 0.95)
        shows = np.where(are_unbroken(self.curve[rows[first]]), EVIDENCE.shown, EVIDENCE.shown_of_two)
        hit = shows * EVIDENCE.found + (1 - shows) * chance
        whole = counts / EVIDENCE.block
        ratios = np.asarray(
            whole * (share * np.log(hit / chance) + (1 - share) * np.log((1 - hit) / (1 - chance)))
        )
        if by_edge:
            edge = np.cumsum(new)[first] - 1
            least, sums = np.log(1 - shows), np.bincount(edge, ratios)[edge]
            ratios *= np.where(sums < least, least / np.minimum(sums, least), 1.0)
        return ratios

    def shown(self) -> tuple[I64, B8]:
        """Numbers (K,) of the model's curves that have samples, and whether (K,) the evidence is for each.

        Both edges of a break count together.
        """
        of_sample = chains_of(self.curve)
        numbers = np.unique(of_sample)
        sums = [float(self.log_ratio(of_sample == number).sum()) for number in numbers]
        return numbers, np.array(sums, np.float64) > 0.0


def evidence_of(model: EdgeModel, pyramids: Pyramids, pose: FloatArray) -> PoseEvidence:
    """Evidence of both pictures for a part at a pose, rig_from_part (4, 4)."""
    hits, chances, curves, pixels, cameras, walled = [], [], [], [], [], []
    for k, seen in enumerate(seen_by(model, pyramids, pose, EVIDENCE.spacing_px)):
        offsets = edges_beside(pyramids, k, seen, EVIDENCE.reach_px, EVIDENCE.together)
        away = np.abs(offsets)
        hits.append(np.nanmin(np.where(np.isfinite(away), away, np.inf), axis=1) < EVIDENCE.agree_px)
        # density of edges per px that are not the part's, averaged over a stretch of the curve
        near = np.empty((len(seen.row), 4))
        find_neighbours(
            seen.pixels,
            seen.normals,
            seen.curve,
            pyramids.pictures[0][k].drawn,
            LOCK.own_px,
            EVIDENCE.reach_px,
            1,
            near,
        )
        own = (np.abs(offsets[:, :, None] - near[:, None]) < EVIDENCE.own_px).any(axis=2)
        beside = ((away > EVIDENCE.own_px) & (away < EVIDENCE.reach_px) & ~own).sum(axis=1)
        density = beside / (2 * (EVIDENCE.reach_px - EVIDENCE.own_px))
        density = _smooth(density)
        chances.append(1 - np.exp(-2 * EVIDENCE.agree_px * density))
        curves.append(seen.curve)
        pixels.append(seen.pixels)
        cameras.append(np.full(len(seen.row), k))
        walled.append(seen.walled)
    return PoseEvidence(*(np.concatenate(both) for both in (hits, chances, curves, pixels, cameras, walled)))


def _smooth(density: FloatArray) -> FloatArray:
    """The density averaged along the samples."""
    if not len(density):
        return density
    kernel = np.ones(EVIDENCE.stretch) / EVIDENCE.stretch
    return np.convolve(np.pad(density, EVIDENCE.stretch // 2, mode="edge"), kernel, mode="valid")[
        : len(density)
    ]


def apart(mine: PoseEvidence, other: PoseEvidence) -> B8:
    """(M,) which samples of one pose the other does not predict within a few pixels."""
    result, reach = np.ones(len(mine.hit), bool), EVIDENCE.apart_px
    for k in (0, 1):
        theirs = np.rint(other.pixels[other.camera == k]).astype(np.int64)
        if not len(theirs):
            continue
        corner = theirs.min(axis=0) - reach
        width, height = theirs.max(axis=0) - corner + reach + 1
        drawn = np.zeros((height, width), np.uint8)
        drawn[theirs[:, 1] - corner[1], theirs[:, 0] - corner[0]] = 1
        drawn = np.asarray(cv2.dilate(drawn, np.ones((2 * reach + 1,) * 2, np.uint8)), np.uint8)
        rows = np.flatnonzero(mine.camera == k)
        x, y = (np.rint(mine.pixels[rows]).astype(np.int64) - corner).T
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        result[rows[inside]] = drawn[y[inside], x[inside]] == 0
    return result


def margin_over(first: PoseEvidence, other: PoseEvidence) -> float:
    """Sigmas by which one pose is likelier than another, by the samples that only one of them predicts."""
    mine = first.log_ratio(apart(first, other), by_edge=True)
    theirs = other.log_ratio(apart(other, first), by_edge=True)
    return sigmas_of(np.concatenate([mine, -theirs]))


def sigmas_of(ratios: FloatArray) -> float:
    """A sum of log ratios divided by its standard deviation, which is taken to be at least 1.

    But no more sigmas than such a sum says at best, if few ratios scatter little: twice a log likelihood
    ratio is a square of sigmas (S. S. Wilks, doi:10.1214/aoms/1177732360).
    """
    spread = math.sqrt(len(ratios)) * float(ratios.std()) if len(ratios) else 0.0
    total = float(ratios.sum())
    return math.copysign(min(abs(total) / max(spread, 1.0), math.sqrt(2.0 * abs(total))), total)
