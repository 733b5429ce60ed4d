"""The pose of a whole taught part from the edges of both cameras: six unknowns, however many curves.

One curve alone is easily misled: beside a thick part's rim runs the foot of its wall, beside a hole's its
ground, and a chamfer in the light is brighter than the face. Either may be the stronger edge over half of the
curve. But rivals mislead each curve in its own way, while all true edges fit one pose, and over some of each
curve there is but one edge. So the part is laid as a rigid whole onto what both images show, all edges near a
curve being candidates; what has rivals counts less.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain.arrays import SIDES, FloatArray, Image
from edged.vision.curves.outlineprojection import ProjectedOutline, project_outline
from edged.vision.curves.outlines import Curve, Face, Outline
from edged.vision.edges.subpixel import edge_profiles
from edged.vision.geometry.rigid import rotation_matrix, transform
from edged.vision.geometry.stereoimages import StereoImages
from edged.vision.kernels.robust import mad_sigma, tukey_weights

FAR_PX = (16.0, 12.0, 8.0, 6.0)
"""How far edges may lie from the curves: a match knows its distance to one percent, that is ten px."""
NEAR_PX = (5.0, 4.0, 3.0, 2.5, *(2.0,) * 10)
"""The last one is repeated until the pose stands still."""
STILL_PX = 0.1
GLANCE_PX = 4.0
FAR_SPACING_PX = 5.0
SPACING_PX = 2.5
HOPELESS = 0.25
"""Share of the curves that after the far steps either camera must agree with."""
STEP_PX = 0.5
ALONG_PX = 10.0
"""Length of a curve whose profiles are averaged: texture has no edge that long."""
BLUR_PX = 1.0
MARGIN_PX = 5.0
"""Of an edge at both ends: beside a corner the other edge is as near."""
MIN_SLOPE = 2.0
"""Grey values per px."""
RIVAL_SHARE = 0.35
"""Of the strongest slope of a profile, from which another extremum is a candidate, too."""
ODD_PX, ODD_SHARE = 2.0, 0.5
"""An edge of the other sign than taught is taken only if it is nearer by so much, and counts less: light and
walls turn some signs round, but most remain."""
MOST = 5
"""Candidates of one profile."""
AGREE_PX = 1.0
LEAST_SIGMA_PX = 0.4
TIGHT_SIGMA_PX, TIGHT_STEPS = 0.6, 10
"""Where a shadow displaces many edges of one camera alike, by an edge break, they draw the pose between both
and the scatter hides it. Laid anew with the sigma of edges that agree, it goes with one of both; the pose
that more of the curves agree with is taken."""
GOOD_SHARE = 0.75
"""Of a pose that both cameras agree with this much there is no better one."""
ROUNDS = 5
MAX_STEP_RAD = 0.2
CONDITION = 1e8
FEWEST = 24


@dataclass(frozen=True, slots=True, eq=False)
class Lock:
    """A pose rig_from_part (4, 4), and the share of the curves that agree with it in each camera (2,).

    moved_px : by which the last step moved the curves, rms.
    """

    pose: FloatArray
    agreeing: FloatArray
    moved_px: float

    @property
    def share(self) -> float:
        """Of the camera that agrees less."""
        return float(self.agreeing.min())


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """All edges across N samples: offset_px and slope (N, MOST), NaN and 0 where there are no more."""

    offset_px: FloatArray
    slope: FloatArray


def lock(
    images: StereoImages, curves: Sequence[Curve], pose: FloatArray, *, near: bool = False
) -> Lock | None:
    """Lay curves of the part's frame onto the edges of both images, from a pose rig_from_part (4, 4).

    near : the pose is good to a few px. None where the images do not show so many of the curves, or the pose
    runs away.
    """
    found: Lock | None = None
    for reaches, spacing_px in ((FAR_PX, FAR_SPACING_PX), (NEAR_PX, SPACING_PX)):
        if near and reaches is FAR_PX:
            continue
        if pose[2, 3] <= 0 or (found is not None and found.share < HOPELESS):
            return None
        outline, starts = spread(images, curves, pose, spacing_px)
        together = max(1, round(ALONG_PX / spacing_px))
        for reach in reaches:
            found = _step(images, curves, outline, starts, pose, reach, together)
            if found is None:
                return None
            pose = found.pose
            if reach == NEAR_PX[-1] and found.moved_px < STILL_PX:
                break
    if found is None or found.share >= GOOD_SHARE:
        return found
    tight = found
    for _ in range(TIGHT_STEPS):
        moved = _step(
            images, curves, outline, starts, tight.pose, NEAR_PX[-1], together, most_sigma_px=TIGHT_SIGMA_PX
        )
        if moved is None:
            return found
        tight = moved
        if tight.moved_px < STILL_PX:
            break
    return max(found, tight, key=lambda one: float(one.agreeing.sum()))


def glance(
    images: StereoImages, curves: Sequence[Curve], pose: FloatArray, reach_px: float = GLANCE_PX
) -> float:
    """Share of the curves that the cameras agree with about a pose that is good to a few px; 0: none."""
    if pose[2, 3] <= 0:
        return 0.0
    outline, starts = spread(images, curves, pose, FAR_SPACING_PX)
    seen = _step(images, curves, outline, starts, pose, reach_px, round(ALONG_PX / FAR_SPACING_PX))
    return 0.0 if seen is None else float(seen.agreeing.mean())


def spread(
    images: StereoImages, curves: Sequence[Curve], pose: FloatArray, spacing_px: float
) -> tuple[Outline, npt.NDArray[np.int64]]:
    """Samples of all curves with their motion by shift and turn in the face; where each begins (K + 1,)."""
    px_per_mm = images.rig.left.fx / float(pose[2, 3])
    outlines = []
    for curve in curves:
        count = max(int(curve.perimeter_mm * px_per_mm / spacing_px), FEWEST)
        outlines.append(curve.spread(count, 0.0 if curve.closed else MARGIN_PX / px_per_mm))
    points = np.concatenate([one.points for one in outlines])
    normals = np.concatenate([one.normals for one in outlines])
    turning = points[:, 0] * normals[:, 1] - points[:, 1] * normals[:, 0]
    starts = np.cumsum([0, *(len(one.points) for one in outlines)])
    return Outline(points, normals, np.column_stack([normals, turning])), starts


def candidates(
    image: Image,
    seen: ProjectedOutline,
    starts: npt.NDArray[np.int64],
    reach_px: float,
    together: int,
) -> Candidates:
    """All edges of either sign within reach; of so many profiles together along their curve."""
    half = reach_px + 3 * BLUR_PX + STEP_PX
    with np.errstate(invalid="ignore"):
        profiles, places = edge_profiles(image, seen.pixels, seen.normals, half, STEP_PX)
    smooth = np.empty_like(profiles)
    for first, last in itertools.pairwise(starts):
        around = np.arange(first - together // 2, last + (together - 1) // 2)
        around = first + (around - first) % (last - first)
        total = np.cumsum(np.vstack([np.zeros(profiles.shape[1]), profiles[around]]), axis=0)
        smooth[first:last] = (total[together:] - total[:-together]) / together
    steps = np.arange(-round(3 * BLUR_PX / STEP_PX), round(3 * BLUR_PX / STEP_PX) + 1) * STEP_PX
    operator = steps * np.exp(-0.5 * (steps / BLUR_PX) ** 2)
    operator /= np.sum(operator * steps)  # a ramp of one grey value per px gives 1
    inside = np.asarray(np.isfinite(smooth).all(axis=1))
    slopes = cv2.filter2D(
        np.where(inside[:, None], smooth, 0.0), cv2.CV_64F, operator[None], borderType=cv2.BORDER_REPLICATE
    )
    size = np.abs(slopes)
    peak = np.zeros(slopes.shape, bool)
    peak[:, 1:-1] = (size[:, 1:-1] >= size[:, :-2]) & (size[:, 1:-1] > size[:, 2:])
    peak[:, np.abs(places) > reach_px] = False
    size = np.where(peak, size, 0.0)
    least = np.maximum(RIVAL_SHARE * size.max(axis=1, keepdims=True), MIN_SLOPE)
    size = np.where(size >= least, size, 0.0)
    order = np.argsort(-size, axis=1)[:, :MOST]
    rows = np.arange(len(size))[:, None]
    chosen = size[rows, order] > 0
    absolute = np.abs(slopes)
    before, here = absolute[rows, np.maximum(order - 1, 0)], absolute[rows, order]
    after = absolute[rows, np.minimum(order + 1, slopes.shape[1] - 1)]
    bend = before - 2 * here + after
    with np.errstate(invalid="ignore", divide="ignore"):
        fraction = np.where(bend < 0, 0.5 * (before - after) / bend, 0.0)
    offset = np.where(chosen, places[order] + STEP_PX * fraction, np.nan)
    return Candidates(offset, np.where(chosen, slopes[rows, order], 0.0))


def _step(
    images: StereoImages,
    curves: Sequence[Curve],
    outline: Outline,
    starts: npt.NDArray[np.int64],
    pose: FloatArray,
    reach: float,
    together: int,
    *,
    most_sigma_px: float = math.inf,
) -> Lock | None:
    """The pose that fits the edges within reach best, and how many agree with it.

    most_sigma_px : by which edges scatter that are taken for the curves' own.
    """
    face = Face(pose[:3, 3], pose[:3, :3].T)
    expected = np.repeat([curve.polarity for curve in curves], np.diff(starts))
    designs, offsets, signs = [], [], []
    for side, image in zip(SIDES, images.raw, strict=True):
        with np.errstate(invalid="ignore", divide="ignore"):
            seen = project_outline(images.rig, side, face, outline)
        if not np.isfinite(seen.design).all():
            return None
        edges = candidates(image, seen, starts, reach, together)
        offsets.append(edges.offset_px)
        signs.append(np.sign(edges.slope) * expected[:, None])
        designs.append(seen.design)
    design, offset, odd = np.concatenate(designs), np.concatenate(offsets), np.concatenate(signs) < 0
    many = np.isfinite(offset).sum(axis=1)
    known = many > 0
    if known.sum() < FEWEST:
        return None
    rows, choices, odd = design[known], offset[known], odd[known]
    trust = 1.0 / many[known] ** 2
    penalty = np.where(odd, ODD_PX, 0.0)
    delta, values = np.zeros(design.shape[1]), np.zeros(len(rows))
    every = np.arange(len(rows))
    for _ in range(ROUNDS):
        ahead = rows @ delta
        chosen = np.nanargmin(np.abs(choices - ahead[:, None]) + penalty, axis=1)
        values = choices[every, chosen]
        residuals = values - ahead
        sigma_px = min(max(mad_sigma(residuals), LEAST_SIGMA_PX), most_sigma_px)
        weights = trust * tukey_weights(residuals, sigma_px)
        weights *= np.where(odd[every, chosen], ODD_SHARE, 1.0)
        normal = rows.T @ (rows * weights[:, None])
        scale = np.sqrt(np.diag(normal))
        if not (scale > 0).all() or np.linalg.cond(normal / np.outer(scale, scale)) > CONDITION:
            return None
        delta = np.linalg.solve(normal, rows.T @ (weights * values))
    height, slope_u, slope_v, shift_u, shift_v, turn = delta
    if max(abs(slope_u), abs(slope_v), abs(turn)) > MAX_STEP_RAD:
        return None
    # a rise of a u + b v turns the face about v by -a, and about u by b
    motion = transform(
        rotation_matrix(np.array([slope_v, -slope_u, turn])), np.array([shift_u, shift_v, height])
    )
    agree = np.zeros(len(offset), bool)
    agree[known] = np.abs(values - rows @ delta) < AGREE_PX
    moved_px = float(np.sqrt(np.mean((rows @ delta) ** 2)))
    return Lock(np.asarray(pose @ motion), agree.reshape(2, -1).mean(axis=1), moved_px)
