"""Marks of boards as a perfect detector would give them, without pictures, to measure calibrations."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.boards.board import Board, Detection, StereoView
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply
from edged.vision.geometry.triangulation import triangulate_raw
from edged.vision.geometry.uncertainty import calibration_covariance

STATED_SHARE = 0.6
"""Share of the marks' noise that their own fits state; the calibration has to find the rest."""


def seen_by(
    rig: StereoRig, board: Board, name: str, pose: FloatArray, noise_px: float, rng: np.random.Generator
) -> StereoView:
    """View of a board at left_from_board (4, 4), with noise on each coordinate."""
    ids = np.arange(len(board.points_mm))
    sigma = np.full(len(ids), STATED_SHARE * noise_px)
    places = apply(pose, board.points_mm)
    both = zip((rig.left, rig.right), (places, apply(rig.right_from_left, places)), strict=True)
    left, right = (
        Detection(ids, camera.project(seen) + rng.normal(0, noise_px, (len(ids), 2)), sigma, 0.6, 150.0)
        for camera, seen in both
    )
    return StereoView(name, board, left, right)


def views_at(
    rig: StereoRig, board: Board, poses: Iterable[FloatArray], noise_px: float, seed: int
) -> list[StereoView]:
    """One view for each pose."""
    rng = np.random.default_rng((seed, 11))
    return [seen_by(rig, board, f"view_{n:03}", pose, noise_px, rng) for n, pose in enumerate(poses, 1)]


def is_whole(rig: StereoRig, points_mm: FloatArray, border_px: float = 8.0) -> bool:
    """Whether both cameras see all of these points."""
    last = np.array((rig.left.width, rig.left.height)) - 1 - border_px
    both = rig.left.project(points_mm), rig.right.project(apply(rig.right_from_left, points_mm))
    return all(bool((pixels >= border_px).all() and (pixels <= last).all()) for pixels in both)


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """Stated sigma and true error (3,) in µm, rms over points, and the mean of chi² per degree of freedom."""

    sigma_um: FloatArray
    error_um: FloatArray
    chi2: float


def compared(rig: StereoRig, truth: StereoRig, points_mm: FloatArray) -> Compared:
    """Compare a calibrated rig with the true one, which sees these points (N, 3)."""
    pixels = truth.left.project(points_mm), truth.right.project(apply(truth.right_from_left, points_mm))
    error = triangulate_raw(rig, *pixels) - points_mm
    covariance = calibration_covariance(rig, points_mm)
    solved = np.linalg.solve(covariance, error[..., None])[..., 0]
    return Compared(
        1e3 * np.sqrt(np.mean(np.einsum("nii->ni", covariance), axis=0)),
        1e3 * np.sqrt(np.mean(error**2, axis=0)),
        float(np.mean(np.sum(error * solved, axis=1))) / 3,
    )
