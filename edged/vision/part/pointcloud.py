"""Point cloud of a measured part: its contours, and its faces by NCC (paper, 5.2 and Fig. 9).

Contour points are edges that both cameras measured on one curve. Face points are matched by NCC and refined
by least-squares matching along their rows (see `stereo`), on a grid over the part, within the depth limits
of its job.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rectification import Rectification, StereoImages
from edged.vision.geometry.rigid import apply, invert
from edged.vision.geometry.triangulation import triangulate, triangulate_raw, triangulation_covariance
from edged.vision.part.job import Job
from edged.vision.part.measured import MeasuredPart
from edged.vision.part.params import MEASURING
from edged.vision.stereo.matching import MatchStatus, match_ncc

CONTOUR, FACE = 0, 1  # kinds of points, in files too


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """Points of all measured parts.

    points_mm (N, 3) : rig frame.  kinds (N,) : CONTOUR or FACE.  sigma_mm (N,) : of each point's depth.
    refused : how many points of the grid could not be matched, by reason.
    """

    points_mm: FloatArray
    kinds: npt.NDArray[np.uint8]
    sigma_mm: FloatArray
    refused: Mapping[str, int]


@dataclass(frozen=True, slots=True, eq=False)
class FacePoints:
    """Matched points (N, 3) mm, rig frame, with the sigma (N,) of their depth; refusals by reason."""

    points_mm: FloatArray
    sigma_mm: FloatArray
    refused: Mapping[str, int]


def point_cloud(images: StereoImages, job: Job, measured: Sequence[MeasuredPart]) -> PointCloud:
    """The contours and faces of all measured parts."""
    rectification = images.rectification
    contours, faces = [np.zeros((0, 3))], []
    for part in measured:
        contours += [contour_points(rectification, *pair) for pair in edge_pairs(part)]
        faces.append(face_points(images, part, job.limits.depth_mm))
    contour = np.concatenate(contours)
    points = np.concatenate([contour, *(face.points_mm for face in faces)])
    kinds = np.full(len(points), FACE, np.uint8)
    kinds[: len(contour)] = CONTOUR
    per_px = contour[:, 2] ** 2 / (rectification.focal_px * rectification.baseline_mm)
    sigma = np.concatenate(
        [per_px * MEASURING.cloud_sigma_px * np.sqrt(2), *(face.sigma_mm for face in faces)]
    )
    refused: dict[str, int] = {}
    for face in faces:
        for reason, count in face.refused.items():
            refused[reason] = refused.get(reason, 0) + count
    return PointCloud(points, kinds, sigma, refused)


def edge_pairs(part: MeasuredPart) -> list[tuple[FloatArray, FloatArray]]:
    """For each curve of a part, the raw edge points (N, 2), left and right, that fit it in both images."""
    pairs = []
    for fit in part.fits:
        left, right = fit.points[:, fit.weights.min(axis=0) > MEASURING.cloud_min_weight]
        pairs.append((left, right))
    return pairs


def contour_points(rectification: Rectification, left: FloatArray, right: FloatArray) -> FloatArray:
    """Points (M, 3), rig frame, of edge points (N, 2) in both raw images; those without depth are omitted."""
    points = triangulate_raw(rectification.rig, left, right)
    return np.asarray(points[np.isfinite(points).all(axis=1)])


def face_points(
    images: StereoImages,
    part: MeasuredPart,
    depth_mm: tuple[float, float],
    grid_px: int = MEASURING.cloud_grid_px,
) -> FacePoints:
    """Points of a part between its contours, by NCC.

    depth_mm : (nearest, farthest) rig z to search.
    """
    rectification = images.rectification
    grid = _grid(rectification, part, grid_px)
    if not len(grid):
        return FacePoints(np.zeros((0, 3)), np.zeros(0), {})
    ranges = _ranges(images, grid, depth_mm)
    matches = match_ncc(images.rectified_left, images.rectified_right, grid, ranges)
    good = matches.accepted
    right_x = grid[good, 0] - matches.disparity_px[good]
    points = triangulate(rectification, grid[good], right_x)
    variance = np.zeros((int(good.sum()), 3, 3))
    variance[:, 2, 2] = matches.sigma_px[good] ** 2
    covariance = triangulation_covariance(rectification, grid[good], right_x, variance)
    refused = {
        reason.name: int(np.count_nonzero(matches.reason == reason))
        for reason in MatchStatus
        if reason is not MatchStatus.ACCEPTED and (matches.reason == reason).any()
    }
    return FacePoints(points, np.sqrt(covariance[:, 2, 2]), refused)


def _grid(rectification: Rectification, part: MeasuredPart, step_px: int) -> FloatArray:
    """(N, 2) rectified left pixels inside the hull of the part's edges, away from every edge."""
    edges = [rectification.rectify_points("left", left) for left, _ in edge_pairs(part) if len(left)]
    if not edges:
        return np.zeros((0, 2))
    points = np.concatenate(edges)
    points = points[np.isfinite(points).all(axis=1)].astype(np.float32)
    inside = np.zeros((rectification.size[1], rectification.size[0]), np.uint8)
    cv2.fillConvexPoly(inside, np.rint(cv2.convexHull(points)).astype(np.int32), 255)
    for x, y in np.rint(points).astype(int):
        cv2.circle(inside, (int(x), int(y)), int(MEASURING.cloud_margin_px), 0, -1)
    ys, xs = np.nonzero(inside[step_px // 2 :: step_px, step_px // 2 :: step_px])
    return np.column_stack([xs, ys]).astype(np.float64) * step_px + step_px // 2


def _ranges(images: StereoImages, grid: FloatArray, depth_mm: tuple[float, float]) -> FloatArray:
    """(N, 2) lowest and highest disparity of each point for depths along the rig's z."""
    rectification = images.rectification
    per_mm = images.rays("left", grid) @ rectification.rectified_from_left[2]
    nearest, farthest = (per_mm * depth for depth in depth_mm)
    strength = rectification.focal_px * rectification.baseline_mm
    shift = rectification.centre_left_px[0] - rectification.centre_right_px[0]
    return np.column_stack([strength / farthest, strength / nearest]) + shift


def heights_mm(points_mm: FloatArray, rig_from_part: FloatArray) -> FloatArray:
    """Points (N, 3) in the part frame; the third column is how far behind its face they lie."""
    return apply(invert(rig_from_part), points_mm)
