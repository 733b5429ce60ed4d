"""What plain OpenCV makes of a round part: ellipses in both images, their centres triangulated.

The textbook way, for comparison: Otsu's threshold, contours, `fitEllipse` of the largest outline that is one,
`undistortPoints` and `triangulatePoints` of both centres, the radius from the left ellipse's long axis. The
centre of an ellipse is not the image of the circle's centre, and no error is stated.
"""

from __future__ import annotations

import cv2
import numpy as np

from edged.domain import FloatArray, Image
from edged.vision.camera import StereoRig

BLUR_PX = 1.0
ROUND_PX = 1.5
"""Median distance of the outline from its ellipse beyond which it is none."""
MIN_SIZE_PX = 60.0


def largest_ellipse(image: Image) -> tuple[FloatArray, float] | None:
    """Centre (2,) and long half axis in px of the largest outline that is an ellipse."""
    smooth = cv2.GaussianBlur(image, (0, 0), BLUR_PX)
    _, bright = cv2.threshold(smooth, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    contours, _ = cv2.findContours(bright, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    best: tuple[FloatArray, float] | None = None
    for contour in contours:
        if len(contour) < MIN_SIZE_PX * np.pi:
            continue
        (x, y), axes, angle = cv2.fitEllipse(contour)
        if min(axes) < MIN_SIZE_PX or max(axes) > 1.5 * min(axes):
            continue
        turn = np.deg2rad(angle)
        along = contour[:, 0] - np.array([x, y])
        along = along @ np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        distance = np.abs(np.hypot(*(2 * along / axes).T) - 1) * 0.5 * min(axes)
        if np.median(distance) < ROUND_PX and (best is None or max(axes) / 2 > best[1]):
            best = np.array([x, y]), max(axes) / 2
    return best


def circle_by_opencv(rig: StereoRig, left: Image, right: Image) -> tuple[FloatArray, float] | None:
    """Centre (3,) in the rig frame and radius in mm; None where either image shows no ellipse."""
    found = largest_ellipse(left), largest_ellipse(right)
    if found[0] is None or found[1] is None:
        return None
    rays = [
        camera.normalise(one[0][None])[0] for camera, one in zip((rig.left, rig.right), found, strict=True)
    ]
    projections = np.eye(4)[:3], rig.right_from_left[:3]
    homogeneous = cv2.triangulatePoints(*projections, rays[0][:, None], rays[1][:, None])[:, 0]
    centre = homogeneous[:3] / homogeneous[3]
    return centre, float(found[0][1] * centre[2] / rig.left.fx)
