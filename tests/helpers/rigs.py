"""Rigs for tests: both lens models, parallel and strongly converging."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from edged.domain.arrays import FloatArray
from edged.vision.geometry.camera import CameraModel, LensModel, StereoRig
from edged.vision.geometry.rigid import apply, rotation_matrix, transform


def make_camera(
    model: LensModel, focal_px: float = 3180.0, size: tuple[int, int] = (1280, 960), shift_px: float = 5.0
) -> CameraModel:
    """A camera with visible distortion, its principal point off the middle by shift_px."""
    distortion = (-0.24,) if model == "division" else (-0.21, 0.14, 5e-4, -4e-4, 0.0)
    cx, cy = (size[0] - 1) / 2 + shift_px, (size[1] - 1) / 2 - shift_px
    return CameraModel(model, *size, focal_px, focal_px, cx, cy, distortion)


def make_rig(
    model: LensModel = "division",
    vergence_deg: float = 24.0,
    baseline_mm: float = 110.0,
    focal_px: float = 3180.0,
    size: tuple[int, int] = (1280, 960),
    tilt_deg: float = 1.0,
    left_share: float = 0.5,
) -> StereoRig:
    """A rig whose cameras turn towards each other by vergence_deg, with a slight relative twist.

    left_share : share of the vergence that the left camera takes; negative when it looks outwards.
    """
    vergence, tilt = np.radians(vergence_deg), np.radians(tilt_deg)
    right_from_left = rotation_matrix(np.array([tilt, vergence, -tilt / 2]))
    # The baseline leaves the left camera at 90° minus the camera's share of the vergence from its axis.
    inward = left_share * vergence
    direction = np.array([np.cos(inward), 0.01, np.sin(inward)])
    centre = direction * (baseline_mm / np.linalg.norm(direction))
    return StereoRig(
        make_camera(model, focal_px, size),
        make_camera(model, focal_px * 0.995, size, shift_px=-4.0),
        transform(right_from_left, -right_from_left @ centre),
        "test",
    )


rigs = st.builds(
    make_rig,
    model=st.sampled_from(["division", "brown"]),
    vergence_deg=st.floats(0, 35),
    baseline_mm=st.floats(20, 400),
    focal_px=st.floats(1000, 3000),
    size=st.just((640, 480)),
    tilt_deg=st.floats(-2, 2),
    left_share=st.floats(-0.3, 1),
)


def random_points(rig: StereoRig, n: int, seed: int) -> FloatArray:
    """Points (n, 3) that both cameras of the rig see, near the point where their axes converge."""
    rng = np.random.default_rng(seed)
    found: list[FloatArray] = []
    vergence = np.arccos(np.clip(rig.right_from_left[2, 2], -1, 1))
    far = rig.baseline_mm / max(vergence, 0.15)
    for _ in range(200):
        pixel = rng.uniform((0, 0), (rig.left.width - 1, rig.left.height - 1), (4 * n, 2))
        depth = rng.uniform(0.6, 1.6, (4 * n, 1)) * far
        points = np.column_stack([rig.left.normalise(pixel), np.ones(4 * n)]) * depth
        in_right = apply(rig.right_from_left, points)
        with np.errstate(invalid="ignore"):
            seen = rig.right.project(in_right)
            # Brown's polynomial folds far points back into the image: the round trip reveals them.
            ideal = in_right[:, :2] / in_right[:, 2:]
            genuine = np.abs(rig.right.normalise(seen) - ideal).max(axis=1) < 1e-9
            inside = (
                (seen >= 0).all(axis=1) & (seen[:, 0] < rig.right.width) & (seen[:, 1] < rig.right.height)
            )
        found.extend(points[inside & genuine & (in_right[:, 2] > 0)])
        if len(found) >= n:
            return np.array(found[:n])
    raise ValueError("this rig has hardly any common view")
