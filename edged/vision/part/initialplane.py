"""Initial plane of a face, from one contour seen by both cameras.

Each point of a contour in the rectified left image has its partner on the same row of the right one, but a
row alone does not tell which of the edges on it that is. The points of a planar contour have disparities
d = a x + b y + c: a vote finds c, and a RANSAC over the remaining rivals finds the plane.
Points on edges along the row have no disparity of their own and are left out.
"""

from __future__ import annotations

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.vision.edges.subpixel import edges_along_normals
from edged.vision.geometry.rectification import Rectification, StereoImages
from edged.vision.geometry.rigid import Plane
from edged.vision.geometry.triangulation import triangulate
from edged.vision.kernels.jit import for_kernel, kernel
from edged.vision.part.params import START


def find_plane(
    images: StereoImages,
    points_px: FloatArray,
    normals: FloatArray,
    polarity: int,
    depth_mm: tuple[float, float],
    min_slope: float = 1.5,
) -> Plane | None:
    """The plane of a contour; None when the right image does not show it.

    points_px, normals (N, 2) : the contour in the rectified left image, a few px accurate.
    polarity : +1 brighter along the normals.  depth_mm : search range of the rectified depth.
    """
    rectification = images.rectification
    across = np.abs(normals[:, 0]) >= START.min_along_row
    points, directions = points_px[across], normals[across]
    offsets, slopes = edges_along_normals(images.rectified_left, points, directions, 4.0, polarity)
    seen = np.isfinite(offsets) & (np.abs(slopes) >= min_slope)
    if seen.sum() < 12:
        return None
    points = points[seen] + directions[seen] * offsets[seen, None]
    sign = np.sign(directions[seen, 0]) * polarity
    shift = rectification.centre_right_px[0] - rectification.centre_left_px[0]
    strength = rectification.focal_px * rectification.baseline_mm
    low, high = strength / depth_mm[1] - shift, strength / depth_mm[0] - shift
    rivals = _rivals(images.rectified_right, points, sign, low, high, min_slope)
    plane = _vote_and_fit(points, rivals, low, high)
    if plane is None:
        return None
    corners = points[[0, len(points) // 3, 2 * len(points) // 3]]
    return plane_of_disparities(rectification, plane, corners)


def plane_of_disparities(
    rectification: Rectification, disparity: FloatArray, corners: FloatArray
) -> Plane | None:
    """The plane of disparities d = a x + b y + c, by three points of it; None where these are in line.

    disparity (3,) : a, b, c.  corners (3, 2) : of the rectified left image.
    """
    space = triangulate(rectification, corners, corners[:, 0] - (corners @ disparity[:2] + disparity[2]))
    normal = np.cross(space[1] - space[0], space[2] - space[0])
    length = float(np.linalg.norm(normal))
    if not np.isfinite(length) or length < 1e-9:
        return None
    normal = normal / length * (-1.0 if normal @ space[0] > 0 else 1.0)
    return Plane.through(space.mean(axis=0), normal)


def _rivals(
    right: Image, points: FloatArray, sign: FloatArray, low: float, high: float, min_slope: float
) -> FloatArray:
    """(N, START.rivals) disparities of each row's strongest edges with the right sign, NaN where fewer."""
    image = for_kernel(right, np.uint8)
    return row_edges(
        image, np.ascontiguousarray(points), np.ascontiguousarray(sign), low, high, min_slope, START.rivals
    )


@kernel("f8[:, ::1](u1[:, ::1], f8[:, ::1], f8[::1], f8, f8, f8, i8)")
def row_edges(
    image: Image,
    points: FloatArray,
    sign: FloatArray,
    low: float,
    high: float,
    min_slope: float,
    most: int,
) -> FloatArray:
    """Disparities (N, most) in [low, high] of the strongest edges on each point's row, NaN where fewer.

    sign (N,) : of the slope along the row, at least min_slope grey values per px.
    """
    height, width = image.shape
    count = points.shape[0]
    found = np.full((count, most), np.nan)
    strength = np.zeros(most)
    slopes = np.empty(width)
    for n in range(count):
        y = int(np.rint(points[n, 1]))
        if y < 1 or y > height - 2:
            continue
        first = max(3, int(np.floor(points[n, 0] - high)))
        last = min(width - 4, int(np.ceil(points[n, 0] - low)))
        strength[:] = 0.0
        for x in range(first - 1, last + 2):
            total = 0.0
            for dy in range(-1, 2):
                row = image[y + dy]
                total += (2.0 * row[x + 2] + row[x + 1]) - (row[x - 1] + 2.0 * row[x - 2])
            slopes[x] = sign[n] * total / 30.0  # 3 rows x (2 x 4 + 1 x 2) px
        for x in range(first, last + 1):
            here = slopes[x]
            if here < min_slope or here < slopes[x - 1] or here <= slopes[x + 1]:
                continue
            weakest = 0
            for k in range(most):
                if strength[k] < strength[weakest]:
                    weakest = k
            if here > strength[weakest]:
                curvature = slopes[x - 1] - 2.0 * here + slopes[x + 1]
                strength[weakest] = here
                found[n, weakest] = points[n, 0] - (x + 0.5 * (slopes[x - 1] - slopes[x + 1]) / curvature)
    return found


def _vote_and_fit(points: FloatArray, rivals: FloatArray, low: float, high: float) -> FloatArray | None:
    """(a, b, c) of d = a x + b y + c with the most points within START.tolerance_px; None for too few."""
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    window = max(4.0, 0.5 * START.max_slope * extent)
    centre = points.mean(axis=0)
    votes = [
        (np.count_nonzero((np.abs(rivals - c) < window).any(axis=1)), c)
        for c in np.arange(low, high + window / 2, window / 2)
    ]
    top = max(vote for vote, _ in votes)
    best, best_count = np.zeros(3), 0
    centred = np.ascontiguousarray(points - centre)
    for vote, c in votes:
        if vote < 0.5 * top or vote < 8:
            continue
        near = np.where(np.abs(rivals - c) < window, rivals, np.nan)
        a, b, c, count = ransac(
            centred, near, START.trials, START.max_slope, START.tolerance_px, 0.02 * extent**2
        )
        if count > best_count:
            best, best_count = np.array([a, b, c]), int(count)
    if best_count < max(10, 0.35 * len(points)):
        return None
    for _ in range(4):
        misfit = rivals - (np.column_stack([points - centre, np.ones(len(points))]) @ best)[:, None]
        nearest = np.nanargmin(np.where(np.isfinite(misfit), np.abs(misfit), np.inf), axis=1)
        residual = misfit[np.arange(len(points)), nearest]
        good = np.abs(residual) < 2 * START.tolerance_px
        if good.sum() < 6:
            return None
        matrix = np.column_stack([points[good] - centre, np.ones(int(good.sum()))])
        best = best + np.linalg.lstsq(matrix, residual[good], rcond=None)[0]
    return np.array([best[0], best[1], best[2] - best[:2] @ centre])


@kernel("UniTuple(f8, 4)(f8[:, ::1], f8[:, ::1], i8, f8, f8, f8)")
def ransac(
    points: FloatArray,
    rivals: FloatArray,
    trials: int,
    max_slope: float,
    tolerance: float,
    min_area: float,
) -> tuple[float, float, float, float]:
    """(a, b, c, count) of the plane through three points, one rival each, that most points agree with."""
    count, most = rivals.shape
    best_a = best_b = best_c = 0.0
    best_count = 0
    # a generator of its own (Numerical Recipes' LCG): the same image gives the same plane, bit by bit
    state = np.uint32(12345)
    pick = np.empty(3, np.int64)
    value = np.empty(3)
    for _ in range(trials):
        usable = True
        for k in range(3):
            state = np.uint32(state * np.uint32(1664525) + np.uint32(1013904223))
            pick[k] = (np.int64(state) >> 8) % count
            known = 0
            for r in range(most):
                if np.isfinite(rivals[pick[k], r]):
                    known += 1
            if known == 0:
                usable = False
                break
            state = np.uint32(state * np.uint32(1664525) + np.uint32(1013904223))
            wanted = (np.int64(state) >> 8) % known
            for r in range(most):
                if np.isfinite(rivals[pick[k], r]):
                    if wanted == 0:
                        value[k] = rivals[pick[k], r]
                    wanted -= 1
        if not usable:
            continue
        x1, y1 = points[pick[1], 0] - points[pick[0], 0], points[pick[1], 1] - points[pick[0], 1]
        x2, y2 = points[pick[2], 0] - points[pick[0], 0], points[pick[2], 1] - points[pick[0], 1]
        area = x1 * y2 - x2 * y1
        if abs(area) < min_area:
            continue
        d1, d2 = value[1] - value[0], value[2] - value[0]
        a, b = (d1 * y2 - d2 * y1) / area, (x1 * d2 - x2 * d1) / area
        if max(abs(a), abs(b)) > max_slope:
            continue
        c = value[0] - a * points[pick[0], 0] - b * points[pick[0], 1]
        agree = 0
        for n in range(count):
            predicted = a * points[n, 0] + b * points[n, 1] + c
            for r in range(most):
                if abs(rivals[n, r] - predicted) < tolerance:
                    agree += 1
                    break
        if agree > best_count:
            best_a, best_b, best_c, best_count = a, b, c, agree
    return best_a, best_b, best_c, float(best_count)
