"""Correction of a rig whose cameras have moved since they were calibrated, with its covariance.

A displacement (14,) holds for the left and then for the right camera: rotation vector (rad) and shift (mm),
applied on the left of camera_from_rig, about the camera's centre; and the relative growth of its focal
length. World is the frame of the rig as calibrated, with the left camera at its origin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import SIDES, FloatArray, Side
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.projection import project_with_jacobians
from edged.vision.geometry.rigid import apply, invert, rotation_matrix, skew, transform

OF_CAMERA = 7  # elements for each camera, see the module's docstring
DISPLACEMENT = 2 * OF_CAMERA  # elements for both


def of_side(side: Side) -> slice:
    """The elements of a displacement that belong to one camera."""
    start = OF_CAMERA * SIDES.index(side)
    return slice(start, start + OF_CAMERA)


@dataclass(frozen=True, slots=True, eq=False)
class RigCorrection:
    """Present displacement of the cameras from the calibrated rig.

    displacement (14,), see the module's docstring; covariance (14, 14) of it.
    """

    displacement: FloatArray
    covariance: FloatArray

    def camera_from_world(self, rig: StereoRig, side: Side) -> FloatArray:
        """Present pose (4, 4) of a camera. rig : as calibrated."""
        vector = self.displacement[of_side(side)]
        moved = transform(rotation_matrix(vector[:3]), vector[3:6])
        return moved if side == "left" else np.asarray(moved @ rig.right_from_left)

    def camera(self, rig: StereoRig, side: Side) -> CameraModel:
        """A camera with its present focal length."""
        model, grown = rig.camera(side), 1.0 + float(self.displacement[of_side(side)][6])
        return replace(model, fx=model.fx * grown, fy=model.fy * grown)

    def world_from_left(self, rig: StereoRig) -> FloatArray:
        """(4, 4) from the left camera as it is now to the frame of the calibrated rig."""
        return invert(self.camera_from_world(rig, "left"))

    def applied(self, rig: StereoRig) -> StereoRig:
        """The rig as it is now; its frame is the left camera as it is now.

        The covariance of the calibration is unchanged.
        """
        left, right = (self.camera(rig, side) for side in SIDES)
        right_from_left = self.camera_from_world(rig, "right") @ self.world_from_left(rig)
        return replace(rig, left=left, right=right, right_from_left=right_from_left)


def seen_with_slopes(
    rig: StereoRig, displacement: FloatArray, side: Side, points_mm: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pixels (N, 2) of points (N, 3) of the world, and their derivatives.

    Returns also d pixels / d displacement of this camera (N, 2, 7) and d pixels / d point (N, 2, 3). The
    derivative by rotation is that of a small rotation after the displacement: at 10 mrad exact to 0.5 %.
    """
    correction = RigCorrection(displacement, np.empty((0, 0)))
    camera, pose = correction.camera(rig, side), correction.camera_from_world(rig, side)
    places = apply(pose, points_mm)
    pixels, by_place, by_lens = project_with_jacobians(camera, places)
    shift = displacement[of_side(side)][3:6]
    slopes = np.empty((len(places), 2, OF_CAMERA))
    slopes[:, :, :3] = -by_place @ skew(places - shift)
    slopes[:, :, 3:6] = by_place
    focal = rig.camera(side)
    slopes[:, :, 6] = by_lens[:, :, 0] * focal.fx + by_lens[:, :, 1] * focal.fy
    return pixels, slopes, by_place @ pose[:3, :3]


def shift_by_displacement(rig: StereoRig, correction: RigCorrection, points_mm: FloatArray) -> FloatArray:
    """(N, 3, 14): motion in mm of triangulated points of the world (N, 3) per unit of the displacement.

    To first order, for fixed images: the cameras are elsewhere than assumed, and the point follows.
    """
    by_point, by_cameras = [], np.zeros((len(points_mm), 4, DISPLACEMENT))
    for row, side in zip((0, 2), SIDES, strict=True):
        _, slopes, by_place = seen_with_slopes(rig, correction.displacement, side, points_mm)
        by_cameras[:, row : row + 2, of_side(side)] = slopes
        by_point.append(by_place)
    stacked = np.concatenate(by_point, axis=1)
    transposed = stacked.transpose(0, 2, 1)
    return np.asarray(-np.linalg.solve(transposed @ stacked, transposed @ by_cameras))
