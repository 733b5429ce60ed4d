"""Pictures of calibration boards, and marks without pictures, for tests.

A board is drawn as a smooth function of the place on its plane, sampled where each pixel's ray
meets it: exact for any lens, with edges of a known spread and no sampling error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
from scipy.special import erf

from edged.domain.arrays import FloatArray, Image
from edged.vision.boards.board import Board, Chessboard, CircleGrid, Detection, DotBoard, StereoView
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import apply, rotation_matrix, rotation_vector, transform

BLACK, WHITE, BACKGROUND = 25.0, 210.0, 60.0


def draw_board(
    board: Board,
    camera: CameraModel,
    camera_from_board: FloatArray,
    noise: float = 0.0,
    seed: int = 0,
    blur_mm: float = 0.08,
) -> Image:
    """Picture (H, W) uint8 that a camera takes of a board. blur_mm : edge spread (sigma) on the board."""
    rays = _rays(camera)
    normal, offset = camera_from_board[:3, 2], camera_from_board[:3, 3]
    with np.errstate(divide="ignore"):
        depth = (normal @ offset) / (rays @ normal)
    plane = (rays * depth[..., None] - offset) @ camera_from_board[:3, :2]
    shade = {Chessboard: _chessboard, DotBoard: _dots, CircleGrid: _circles}[type(board)]
    image = shade(board, plane[..., 0], plane[..., 1], blur_mm)
    image = np.where(depth > 0, image, BACKGROUND)
    image = image + np.random.default_rng(seed).normal(0, noise, image.shape) if noise else image
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@cache
def _rays(camera: CameraModel) -> FloatArray:
    y, x = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    normalised = camera.normalise(np.stack([x, y], axis=-1))
    return np.concatenate([normalised, np.ones_like(normalised[..., :1])], axis=-1)


def _step(distance_mm: FloatArray, blur_mm: float) -> FloatArray:
    """Smooth step: 0 far below zero, 1 far above."""
    return np.asarray(0.5 + 0.5 * erf(distance_mm / (np.sqrt(2) * blur_mm)))


def _box(
    x: FloatArray, y: FloatArray, bounds: tuple[float, float, float, float], blur_mm: float
) -> FloatArray:
    """1 inside the rectangle (x0, y0, x1, y1)."""
    inside_x = _step(x - bounds[0], blur_mm) * _step(bounds[2] - x, blur_mm)
    return np.asarray(inside_x * _step(y - bounds[1], blur_mm) * _step(bounds[3] - y, blur_mm))


def _chessboard(board: Chessboard, x: FloatArray, y: FloatArray, blur_mm: float) -> FloatArray:
    p = board.pitch_mm

    def wave(t: FloatArray) -> FloatArray:
        # sign changes at every multiple of the pitch, + in the first square
        nearest = np.rint(t / p)
        return np.asarray(erf((t - nearest * p) / (np.sqrt(2) * blur_mm)) * np.where(nearest % 2 == 0, 1, -1))

    squares = BLACK + (WHITE - BLACK) * (0.5 - 0.5 * wave(x) * wave(y))
    field = _box(x, y, (-p, -p, board.columns * p, board.rows * p), blur_mm)
    sheet = _box(x, y, (-1.6 * p, -1.6 * p, (board.columns + 0.6) * p, (board.rows + 0.6) * p), blur_mm)
    paper = WHITE + (squares - WHITE) * field
    return np.asarray(BACKGROUND + (paper - BACKGROUND) * sheet)


def _dots(board: DotBoard, x: FloatArray, y: FloatArray, blur_mm: float) -> FloatArray:
    p = board.pitch_mm
    column = np.clip(np.rint(x / p), 0, board.columns - 1)
    row = np.clip(np.rint(y / p), 0, board.rows - 1)
    radius = np.hypot(x - column * p, y - row * p)
    dark = _step(board.diameter_mm / 2 - radius, blur_mm)
    far_x, far_y = (board.columns - 1) * p, (board.rows - 1) * p
    inner = _box(x, y, (-0.75 * p, -0.75 * p, far_x + 0.75 * p, far_y + 0.75 * p), blur_mm)
    outer = _box(x, y, (-p, -p, far_x + p, far_y + p), blur_mm)
    sheet = _box(x, y, (-1.1 * p, -1.1 * p, far_x + 1.1 * p, far_y + 1.1 * p), blur_mm)
    corner = _step((-p - x - y) / np.sqrt(2), blur_mm)
    dark = np.maximum(dark, np.maximum(outer * (1 - inner), corner * outer))
    paper = WHITE + (BLACK - WHITE) * dark
    return np.asarray(BACKGROUND + (paper - BACKGROUND) * sheet)


def _circles(board: CircleGrid, x: FloatArray, y: FloatArray, blur_mm: float) -> FloatArray:
    p = board.pitch_mm
    dark = np.zeros_like(x)
    for mark_x, mark_y, _ in board.points_mm:
        near = (abs(x - mark_x) < 0.6 * p) & (abs(y - mark_y) < 0.6 * p)
        radius = np.hypot(x[near] - mark_x, y[near] - mark_y)
        dark[near] = np.maximum(dark[near], _step(board.diameter_mm / 2 - radius, blur_mm))
    far_x, far_y = board.points_mm[:, :2].max(axis=0)
    sheet = _box(x, y, (-1.1 * p, -1.1 * p, far_x + 1.1 * p, far_y + 1.1 * p), blur_mm)
    return np.asarray(BACKGROUND + (WHITE + (BLACK - WHITE) * dark - BACKGROUND) * sheet)


def board_poses(rig: StereoRig, board: Board, n: int, seed: int, tilt_deg: float = 25.0) -> list[FloatArray]:
    """Poses left_from_board (4, 4), tilted differently, in which both cameras see the whole board."""
    rng = np.random.default_rng(seed)
    points = board.points_mm
    centre, margin = points.mean(axis=0), 1.2 * board.pitch_mm
    edge = np.array(
        [
            [x, y, 0]
            for x in (-margin, points[:, 0].max() + margin)
            for y in (-margin, points[:, 1].max() + margin)
        ]
    )
    vergence = float(np.arccos(np.clip(rig.right_from_left[2, 2], -1, 1)))
    far = rig.baseline_mm / max(2 * np.tan(vergence / 2), 0.3)
    poses: list[FloatArray] = []
    for _ in range(100_000):
        tilt = np.radians(rng.uniform(-tilt_deg, tilt_deg, 2))
        rotation = rotation_matrix(np.array([tilt[0], tilt[1], 0])) @ rotation_matrix(
            np.array([0, 0, rng.uniform(-0.4, 0.4)])
        )
        pixel = rng.uniform((0, 0), (rig.left.width, rig.left.height))
        place = np.append(rig.left.normalise(pixel), 1.0) * far * rng.uniform(0.85, 1.25)
        pose = transform(rotation, place - rotation @ centre)
        if _visible(rig, apply(pose, edge)):
            poses.append(pose)
            if len(poses) == n:
                return poses
    raise ValueError("the board does not fit into this rig's common view")


def _visible(rig: StereoRig, points: FloatArray) -> bool:
    for camera, place in ((rig.left, points), (rig.right, apply(rig.right_from_left, points))):
        if (place[:, 2] <= 0).any():
            return False
        pixels = camera.project(place)
        if not ((pixels > 1) & (pixels < (camera.width - 2, camera.height - 2))).all():
            return False
    return True


def synthetic_views(
    rig: StereoRig,
    board: Board,
    poses: list[FloatArray],
    sigma_px: float,
    seed: int,
    disturb: Callable[[int, StereoRig], StereoRig] = lambda _, rig: rig,
    stated_sigma_px: float | None = None,
) -> list[StereoView]:
    """Marks with Gaussian noise, as a perfect detector would give them.

    disturb(view number, rig) : the rig as it really was at that view.
    """
    rng = np.random.default_rng(seed)
    ids = np.arange(len(board.points_mm))
    views = []
    for number, pose in enumerate(poses):
        real = disturb(number, rig)
        points = apply(pose, board.points_mm)
        found = []
        for camera, place in ((real.left, points), (real.right, apply(real.right_from_left, points))):
            pixels = camera.project(place) + rng.normal(0, sigma_px, (len(ids), 2))
            sigma = np.full(len(ids), stated_sigma_px or max(sigma_px, 1e-4))
            found.append(Detection(ids, pixels, sigma, 0.6, 150.0))
        views.append(StereoView(f"view_{number:02}", board, found[0], found[1]))
    return views


def right_pose(rig: StereoRig, left_from_board: FloatArray) -> FloatArray:
    """right_from_board (4, 4)."""
    return rig.right_from_left @ left_from_board


def relation_error(found: StereoRig, true: StereoRig) -> FloatArray:
    """(6,) true minus found of right_from_left: rotation vector on the left, translation."""
    turn = rotation_vector(true.right_from_left[:3, :3] @ found.right_from_left[:3, :3].T)
    return np.concatenate([turn, true.right_from_left[:3, 3] - found.right_from_left[:3, 3]])


def parameter_error(found: StereoRig, true: StereoRig) -> FloatArray:
    """(P,) true minus found, in the order of `StereoRig.parameter_names`."""
    values = [
        np.array([getattr(c, n) for c in pair for n in ("fx", "fy", "cx", "cy")]).reshape(2, 4)
        for pair in ((true.left, found.left), (true.right, found.right))
    ]
    lenses = [
        np.subtract(true.left.distortion, found.left.distortion),
        np.subtract(true.right.distortion, found.right.distortion),
    ]
    return np.concatenate(
        [
            values[0][0] - values[0][1],
            lenses[0],
            values[1][0] - values[1][1],
            lenses[1],
            relation_error(found, true),
        ]
    )


# --- pictures as real cameras make them ---------------------------------------------------------------

_SUBPIXELS = 5


@cache
def sharp_board(board: Board, camera: CameraModel, tilts_rad: tuple[float, float, float]) -> FloatArray:
    """Picture (H, W) of a board through a perfect lens, so that only a pixel's own width blurs its edges.

    tilts_rad : about x, y and the optical axis.  The board's marks: `board_in_the_middle`.
    """
    n = _SUBPIXELS
    fine = replace(
        camera,
        width=n * camera.width,
        height=n * camera.height,
        fx=n * camera.fx,
        fy=n * camera.fy,
        cx=n * (camera.cx + 0.5) - 0.5,
        cy=n * (camera.cy + 0.5) - 0.5,
    )
    pose = board_in_the_middle(board, camera, tilts_rad)
    # half a subpixel of blur prevents aliasing at the edges and hardly adds to the pixel's own
    image = draw_board(board, fine, pose, blur_mm=0.5 * pose[2, 3] / fine.fx)
    light = image.reshape(camera.height, n, camera.width, n).mean(axis=(1, 3))
    return np.asarray(60.0 + (light - BLACK) * (120.0 / (WHITE - BLACK)))  # with room for halos


def board_in_the_middle(
    board: Board, camera: CameraModel, tilts_rad: tuple[float, float, float]
) -> FloatArray:
    """camera_from_board (4, 4) of a board that fills three quarters of the picture."""
    rotation = rotation_matrix(np.array([*tilts_rad[:2], 0.0])) @ rotation_matrix(
        np.array([0.0, 0.0, tilts_rad[2]])
    )
    size = np.ptp(board.points_mm, axis=0)[:2] + 2 * board.pitch_mm
    depth = float((size * (camera.fx, camera.fy) / (camera.width, camera.height)).max()) / 0.75
    middle = np.append(camera.normalise(np.array([camera.width / 2, camera.height / 2])), 1.0) * depth
    return transform(rotation, middle - rotation @ board.points_mm.mean(axis=0))


def processed(
    light: FloatArray,
    *,
    gain: float = 1.0,
    noise: float = 1.0,
    gamma: float = 1.0,
    sharpening: float = 0.0,
    radius_px: float = 1.0,
    jpeg: int = 0,
    seed: int = 0,
) -> Image:
    """Picture that a camera's electronics make of light (H, W): clipping, gamma, unsharp mask, JPEG.

    sharpening : 0.3 makes halos of 5 %, 0.6 of 9 %, 1.0 of 14 % of a step that one pixel blurs.
    """
    grey = np.clip(gain * light + np.random.default_rng(seed).normal(0, noise, light.shape), 0, 255)
    grey = np.rint(255 * (grey / 255) ** gamma)
    grey = grey + sharpening * (grey - cv2.GaussianBlur(grey, (0, 0), radius_px))
    image = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    if not jpeg:
        return image
    _, packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, jpeg])
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), np.uint8)
