"""Plates of round marks: found as a grid of ellipses, measured by fitting each dot.

HALCON-like plates have a square grid and one filled corner of their frame; the orientation of
OpenCV's asymmetric grids follows from the shift of their rows.

The dot model is an ellipse with a blurred edge:

    I(p) = (a + b erf((|B (p - c)| - 1) / (√2 s))) (1 + g·(p - c))

symmetric about c except for the light gradient g (which multiplies: black stays black), so that
blur, spread of ink and saturation do not move c. But c is the centre of the *ellipse*, which is not
the image of the circle's centre: seen obliquely, the near half of a circle is larger than the far
half. The difference (up to some tenths of a pixel) is computed from the plate's homography or, once
they are known, from lens and pose.
Source of the effect: J. Heikkilä, PAMI 2000, doi:10.1109/34.879788.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import cv2
import numpy as np

from edged.domain.arrays import I64, FloatArray, Image
from edged.vision.boards.board import CircleGrid, Detection, DotBoard, NotDetected
from edged.vision.boards.markmodels import fit_dots
from edged.vision.boards.params import DETECTION
from edged.vision.geometry.camera import CameraModel
from edged.vision.geometry.rigid import apply, rotation_2d

_SHAPE = [0, 1, 6, 7, 8]  # columns of a fit with the ellipse x, y, b11, b12, b22
_CIRCLE_POINTS = 64  # five would do: a projected circle is exactly an ellipse


Plate = DotBoard | CircleGrid


def detect_dots(image: Image, board: Plate) -> Detection | NotDetected:
    """Find all marks of a plate; dark on light, or light on dark.

    image (H, W) uint8.  Mark 0 is next to the filled corner or, in an asymmetric grid, at the end whose row
    is not shifted.
    """
    reasons: list[str] = []
    for picture in (image, np.asarray(255 - image)):
        for share in DETECTION.blocks:
            blobs = _ellipses(picture, min(image.shape) // share)
            grid = _grow_grid(blobs, board)
            if isinstance(grid, NotDetected):
                reasons.append(grid.reason)
                continue
            ordered = _orient(picture, grid, blobs[:, :2], board) if isinstance(board, DotBoard) else grid
            if isinstance(ordered, NotDetected):
                reasons.insert(0, ordered.reason)  # a near miss is the user's most likely problem
                continue
            return _measure_first(image, board, blobs[ordered])
    return NotDetected(reasons[0])


def remeasure_dots(
    image: Image, board: Plate, found: Detection, camera: CameraModel, camera_from_board: FloatArray
) -> Detection | NotDetected:
    """Measure a detected plate again with the lens and the plate's pose known."""

    def to_pixels(plane_mm: FloatArray) -> FloatArray:
        points = np.concatenate([plane_mm, np.zeros_like(plane_mm[..., :1])], axis=-1)
        return camera.project(apply(camera_from_board, points))

    return _measure(image, board, found.ids, to_pixels, to_pixels(board.points_mm[found.ids, :2]))


def _measure_first(image: Image, board: Plate, ellipses: FloatArray) -> Detection | NotDetected:
    """Fit the dots with a homography from the ellipses' centres, then again with one from the result."""
    ids = np.arange(len(ellipses))
    centres = ellipses[:, :2]
    found: Detection | NotDetected = NotDetected("no dots measured")
    for _ in range(2):
        plane = board.points_mm[ids, :2]
        homography = _homography(plane, centres)
        if homography is None:
            return NotDetected("the dots found do not lie in one plane")
        # The homography gives the shapes; positions are the measured ones, which include the distortion.
        shift = centres - _map_plane(homography, plane)

        def to_pixels(
            circles: FloatArray, homography: FloatArray = homography, shift: FloatArray = shift
        ) -> FloatArray:
            return np.asarray(_map_plane(homography, circles) + shift[:, None])

        found = _measure(image, board, ids, to_pixels, centres)
        if isinstance(found, NotDetected):
            return found
        ids, centres = found.ids, found.pixels
    return found


def _measure(
    image: Image,
    board: Plate,
    ids: I64,
    to_pixels: Callable[[FloatArray], FloatArray],
    centres: FloatArray,
) -> Detection | NotDetected:
    """Fit the dots whose centres are expected at centres (N, 2).

    to_pixels : maps points (N, K, 2) of the plate, one row for each dot, to the image.
    The dots' size is measured, too: the stated one may be a guess, and it determines how far an ellipse's
    centre is from the image of the circle's centre.
    """
    for _ in range(DETECTION.size_rounds):
        expected = np.array([ellipse_of(outline) for outline in to_pixels(_circles(board, ids))])
        fits = _fit(image, board, expected)
        ok = fits[:, 5] > 0
        if not ok.any():
            break
        size = float(np.median(np.sqrt(_inverse_areas(expected[ok]) / _inverse_areas(fits[ok][:, _SHAPE]))))
        if abs(size - 1) < DETECTION.size_tolerance:
            break
        board = replace(board, diameter_mm=size * board.diameter_mm)
    contrast = float(np.median(fits[:, 4]))
    ok &= fits[:, 4] > 0.25 * contrast
    if not contrast >= DETECTION.min_contrast:
        return NotDetected(
            f"contrast of {contrast:.0f} grey values is too low (at least {DETECTION.min_contrast:.0f})"
        )
    if ok.sum() < max(6, 0.5 * len(ids)):
        return NotDetected(
            f"only {ok.sum()} of {len(ids)} dots can be measured (blurred, saturated or covered)"
        )
    eccentricity = expected[:, :2] - centres
    good = fits[ok]
    return Detection(
        ids[ok], good[:, :2] - eccentricity[ok], good[:, 2].copy(), float(np.median(good[:, 3])), contrast
    )


def _fit(image: Image, board: Plate, expected: FloatArray) -> FloatArray:
    """Results (N, 9) of `fit_dots` for expected ellipses (N, 5); NaN and not ok where these are invalid."""
    usable = np.isfinite(expected).all(axis=1)
    # The window is limited by the gap to the next dot in the direction of greatest foreshortening.
    gap = _minor_px(expected) * 2 * board.gap_mm / board.diameter_mm
    start = np.column_stack(
        [expected, _major_px(expected) + np.clip(DETECTION.dot_window_share * gap, 2.0, 8.0)]
    )
    fits = np.full((len(expected), 9), np.nan)
    fits[:, 4:6] = 0
    some = np.empty((int(usable.sum()), 9))
    fit_dots(np.ascontiguousarray(image), np.ascontiguousarray(start[usable]), some)
    fits[usable] = some
    return fits


def _circles(board: Plate, ids: I64) -> FloatArray:
    """Outlines (N, K, 2) of the dots on the plate."""
    angles = np.linspace(0, 2 * np.pi, _CIRCLE_POINTS, endpoint=False)
    ring = 0.5 * board.diameter_mm * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.asarray(board.points_mm[ids, None, :2] + ring)


def _homography(plane: FloatArray, pixels: FloatArray) -> FloatArray | None:
    """Homography (3, 3) from plate (N, 2) to image (N, 2), or None if there is none."""
    homography, _ = cv2.findHomography(plane, pixels, 0)
    return None if homography is None else np.asarray(homography, dtype=np.float64)


def _map_plane(homography: FloatArray, plane: FloatArray) -> FloatArray:
    mapped = np.concatenate([plane, np.ones_like(plane[..., :1])], axis=-1) @ homography.T
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def ellipse_of(outline: FloatArray) -> FloatArray:
    """Fit an ellipse (x, y, b11, b12, b22) to points (K, 2); NaN if there is none.

    Least squares on the conic a x² + b xy + c y² + d x + e y = 1, about the points' centroid.
    """
    middle = outline.mean(axis=0)
    x, y = (outline - middle).T
    spread = float(np.sqrt(np.mean(x * x + y * y)))
    x, y = x / spread, y / spread
    a, b, c, d, e = np.linalg.lstsq(
        np.column_stack([x * x, x * y, y * y, x, y]), np.ones_like(x), rcond=None
    )[0]
    conic = np.array([[a, b / 2], [b / 2, c]])
    if not np.isfinite(conic).all() or np.linalg.det(conic) <= 0:
        return np.full(5, np.nan)
    centre = np.linalg.solve(conic, [-d / 2, -e / 2])
    size = 1 + centre @ conic @ centre
    values, vectors = np.linalg.eigh(conic / size)
    if values[0] <= 0:
        return np.full(5, np.nan)
    root = vectors @ np.diag(np.sqrt(values)) @ vectors.T / spread
    return np.array([*(centre * spread + middle), root[0, 0], root[0, 1], root[1, 1]])


def _axes(ellipses: FloatArray) -> FloatArray:
    """Inverse semi-axes (N, 2), that of the longer axis first."""
    b11, b12, b22 = ellipses[:, 2], ellipses[:, 3], ellipses[:, 4]
    mean, difference = 0.5 * (b11 + b22), np.hypot(0.5 * (b11 - b22), b12)
    return np.column_stack([mean - difference, mean + difference])


def _inverse_areas(ellipses: FloatArray) -> FloatArray:
    """Inverse products (N,) of the semi-axes."""
    return np.asarray(ellipses[:, 2] * ellipses[:, 4] - ellipses[:, 3] ** 2)


def _major_px(ellipses: FloatArray) -> FloatArray:
    return np.asarray(1 / _axes(ellipses)[:, 0])


def _minor_px(ellipses: FloatArray) -> FloatArray:
    return np.asarray(1 / _axes(ellipses)[:, 1])


# --- finding ------------------------------------------------------------------------------------


def _ellipses(image: Image, block_px: int) -> FloatArray:
    """Find dark elliptic blobs (M, 5) as x, y, b11, b12, b22."""
    smooth = cv2.GaussianBlur(image, (3, 3), 0)
    block = max(11, block_px | 1)
    dark = cv2.adaptiveThreshold(smooth, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, block, 12)
    contours, hierarchy = cv2.findContours(dark, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    # Outer borders only: the border of a hole is a light dot on a dark plate.
    outer = (
        [contour for contour, links in zip(contours, hierarchy[0], strict=True) if links[3] < 0]
        if contours
        else []
    )
    found = [blob for contour in outer if (blob := _blob(contour)) is not None]
    return np.array(found).reshape(-1, 5)


def _blob(contour: cv2.typing.MatLike) -> FloatArray | None:
    if len(contour) < 3 * DETECTION.min_diameter_px:
        return None
    area = cv2.contourArea(contour)
    (x, y), (first, second), angle_deg = cv2.fitEllipse(contour)
    shorter, longer = min(first, second), max(first, second)
    if not (shorter >= DETECTION.min_diameter_px and shorter >= DETECTION.min_aspect * longer):
        return None
    # a contour runs through pixel centres, half a pixel inside the blob's edge
    if abs(area / (0.25 * np.pi * first * second) - 1) > DETECTION.roundness:
        return None
    axes = rotation_2d(-math.radians(angle_deg))
    matrix = axes.T @ np.diag([2 / first, 2 / second]) @ axes
    return np.array([x, y, matrix[0, 0], matrix[0, 1], matrix[1, 1]])


def _grow_grid(blobs: FloatArray, board: Plate) -> I64 | NotDetected:
    """Indices into blobs of a complete, right-handed grid.

    For a square grid (rows, columns), its orientation still open; for an asymmetric one (N,) in the board's
    order.
    """
    wanted = board.columns * board.rows
    if len(blobs) < wanted:
        return NotDetected(f"{len(blobs)} dots found, the plate has {wanted}")
    best = 0
    for places in _grids(blobs):
        best = max(best, len(places))
        if len(places) != wanted:
            continue
        grid = _rectangle(places, board) if isinstance(board, DotBoard) else _asymmetric(places, board)
        if grid is not None:
            return grid
    if best == wanted:
        return NotDetected(f"the {best} dots found are arranged in another way than the plate's")
    return NotDetected(f"the dots form a grid of {best} marks, the plate has {wanted}")


def recognise_dots(image: Image) -> Plate | None:
    """Recognise a complete plate of round marks of any size in an image (H, W) uint8, pitch 1 mm; or None.

    The filled corner distinguishes columns from rows; a square grid without one gets at least as many columns
    as rows.
    """
    for picture in (image, np.asarray(255 - image)):
        for share in DETECTION.blocks:
            blobs = _ellipses(picture, min(image.shape) // share)
            for places in _grids(blobs):
                if (
                    len(places) >= DETECTION.min_dots
                    and (plate := _plate_of(picture, places, blobs)) is not None
                ):
                    return plate
    return None


def _plate_of(image: Image, places: dict[tuple[int, int], int], blobs: FloatArray) -> Plate | None:
    """The plate whose marks have these lattice positions, if there is one."""
    keys, seen = np.array(list(places)), blobs[list(places.values())]
    rows, columns = sorted((np.ptp(keys, axis=0) + 1).tolist())
    if len(keys) == columns * rows and rows >= 3:
        board = DotBoard(columns, rows, 1.0, _diameter(keys, seen))
        return _marked(image, places, blobs[:, :2], board)
    for steps in _STEPS:
        lattice = keys @ steps.T
        narrow, wide = sorted((np.ptp(lattice, axis=0) + 1).tolist())
        for columns, rows in ((narrow // 2, wide), (wide // 2, narrow)):
            if min(columns, rows) < 3 or len(keys) != columns * rows:
                continue
            plate = CircleGrid(columns, rows, 1.0, _diameter(lattice, seen))
            if plate.gap_mm > 0 and _asymmetric(places, plate) is not None:
                return plate
    return None


def _diameter(lattice: I64, blobs: FloatArray) -> float:
    """Diameter of the marks (N, 5) in units of their lattice (N, 2), rounded to a hundredth."""
    design = np.column_stack([lattice, np.ones(len(lattice))])
    map_px = np.linalg.lstsq(design, blobs[:, :2], rcond=None)[0][:2]
    size_px = 2 / np.sqrt(np.median(_inverse_areas(blobs)))
    return round(float(size_px / np.sqrt(abs(np.linalg.det(map_px)))), 2)


def _marked(
    image: Image, places: dict[tuple[int, int], int], centres: FloatArray, board: DotBoard
) -> DotBoard:
    """The board, or with rows and columns swapped if only then its filled corner matches the image."""
    turned = replace(board, columns=board.rows, rows=board.columns)
    for plate in (board, turned):
        grid = _rectangle(places, plate)
        if grid is not None and not isinstance(_orient(image, grid, centres, plate), NotDetected):
            return plate
    return board


def _grids(blobs: FloatArray) -> Iterator[dict[tuple[int, int], int]]:
    """Grids grown from the blobs nearest the middle: positions (i, j) -> index."""
    if not len(blobs):
        return
    centres = blobs[:, :2]
    sizes = 1 / np.sqrt(_inverse_areas(blobs))
    for seed in np.argsort(np.linalg.norm(centres - np.median(centres, axis=0), axis=1))[:12]:
        alike = np.abs(np.log(sizes / sizes[seed])) < np.log(DETECTION.size_ratio)
        yield _grow_from(int(seed), np.where(alike[:, None], centres, np.inf))


def _rectangle(places: dict[tuple[int, int], int], board: DotBoard) -> I64 | None:
    """Indices as a grid (rows, columns) if it has the board's shape."""
    keys = np.array(list(places))
    low = keys.min(axis=0)
    shape = tuple(keys.max(axis=0) - low + 1)
    if shape not in ((board.columns, board.rows), (board.rows, board.columns)):
        return None
    grid = np.full((shape[1], shape[0]), -1)
    for (i, j), index in places.items():
        grid[j - low[1], i - low[0]] = index
    return grid if shape == (board.columns, board.rows) else np.rot90(grid)


_STEPS = [
    np.array(steps)
    for steps in ([[1, -1], [1, 1]], [[1, 0], [1, 2]], [[1, -2], [1, 0]], [[2, 1], [0, 1]], [[2, -1], [0, 1]])
]
"""Steps of an asymmetric grid along the two growth directions, as columns, up to quarter turns. The nearest
neighbours lie on its diagonals; seen obliquely, the mark two rows or columns further may be nearer."""
_QUARTER = np.array([[0, -1], [1, 0]])  # rotation by 90°


def _asymmetric(places: dict[tuple[int, int], int], board: CircleGrid) -> I64 | None:
    """Indices (N,) in the board's order, if the marks match the board in one of four quarter turns."""
    wanted = {(int(x), int(y)): number for number, (x, y) in enumerate(board.lattice)}
    keys, indices = np.array(list(places)), np.array(list(places.values()))
    for steps in _STEPS:
        lattice = keys @ steps.T
        for _ in range(4):
            lattice = lattice @ _QUARTER.T
            numbers = [wanted.get((int(x), int(y))) for x, y in lattice - lattice.min(axis=0)]
            if None not in numbers:
                ordered = np.empty(len(indices), dtype=np.int64)
                ordered[np.array(numbers, dtype=np.int64)] = indices
                return ordered
    return None


def _grow_from(seed: int, centres: FloatArray) -> dict[tuple[int, int], int]:
    """Grid positions (i, j) -> index, grown from a seed with steps that adapt to the perspective.

    centres (M, 2) : inf for blobs that are excluded.
    """
    away = centres - centres[seed]
    distances = np.linalg.norm(away, axis=1)
    order = [k for k in np.argsort(distances)[1:9] if np.isfinite(distances[k])]
    if len(order) < 2:
        return {}
    across = away[order[0]]
    sines = [_cross(across, away[k]) / (np.linalg.norm(across) * np.linalg.norm(away[k])) for k in order]
    beside = [k for k, sine in zip(order, sines, strict=True) if abs(sine) > 0.6]
    if not beside:
        return {}
    down = away[beside[0]]
    if _cross(across, down) < 0:
        down = -down
    places = {(0, 0): seed}
    steps = {(0, 0): (across, down)}
    taken, queue = {seed}, [(0, 0)]
    while queue:
        place = queue.pop(0)
        here = centres[places[place]]
        for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            target = (place[0] + di, place[1] + dj)
            if target in places:
                continue
            step = di * steps[place][0] + dj * steps[place][1]
            distances = np.linalg.norm(centres - here - step, axis=1)
            nearest = int(np.argmin(distances))
            if nearest in taken or distances[nearest] > DETECTION.step_tolerance * np.linalg.norm(step):
                continue
            taken.add(nearest)
            places[target] = nearest
            real = centres[nearest] - here
            old = steps[place]
            steps[target] = (real * di, old[1]) if di else (old[0], real * dj)
            queue.append(target)
    return places


def _cross(a: FloatArray, b: FloatArray) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def _orient(image: Image, grid: I64, centres: FloatArray, board: DotBoard) -> I64 | NotDetected:
    """Indices (N,) of the marks in the board's order, with mark 0 at the filled corner."""
    turns = range(4) if board.columns == board.rows else (0, 2)
    marked = []
    for turn in turns:
        turned = np.rot90(grid, turn).ravel()
        if _first_corner_is_filled(image, centres[turned], board):
            marked.append(turned)
    if len(marked) != 1:
        return NotDetected(
            f"the orientation mark (one filled corner of the frame) shows at {len(marked)} corners"
        )
    return np.asarray(marked[0], dtype=np.int64)


def _first_corner_is_filled(image: Image, pixels: FloatArray, board: DotBoard) -> bool:
    """Whether the plate is dark between mark 0 and the corner of the frame next to it.

    Uses the homography of the four marks at that corner: over such a distance distortion is negligible.
    """
    near = np.array([0, 1, board.columns, board.columns + 1])
    homography = _homography(board.points_mm[near, :2], pixels[near])
    if homography is None:
        return False
    p = board.pitch_mm
    offset = -DETECTION.corner_offset * p
    places = np.array([[offset, offset], [0.5 * p, 0.5 * p], [0.0, 0.0]])
    smooth = cv2.blur(image, (3, 3))
    x, y = np.rint(_map_plane(homography, places)).astype(int).T
    if not ((x >= 0) & (y >= 0) & (x < image.shape[1]) & (y < image.shape[0])).all():
        return False
    corner, plate, dot = (float(v) for v in smooth[y, x])
    return corner < 0.5 * (plate + dot)
