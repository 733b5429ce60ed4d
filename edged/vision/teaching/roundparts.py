"""Parts that are known by circles about one axis: whether the pair shows anything that tells their turn.

The wall in a bore, the outer wall and shadows are seen from one side, which turns with the camera: a turn by
these is wrong, and no curve that is measured contradicts it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edged.domain.arrays import B8, FloatArray, Image
from edged.vision.edges.contours import Contour
from edged.vision.geometry.rigid import Plane, apply, invert
from edged.vision.part.job import CircleFeature
from edged.vision.part.pose import circle_curve
from edged.vision.teaching.background import agreeing_with, mostly
from edged.vision.teaching.features import TeachingView
from edged.vision.teaching.levels import mask_along
from edged.vision.teaching.params import TEACHING


def rims_of_round_part(
    view: TeachingView, rig_from_part: FloatArray, circles: Sequence[CircleFeature]
) -> Image | None:
    """Mask (h, w) uint8 of circles about one axis, if nothing tells the turn; None if something does.

    That are edges in the circles' faces, by both pictures, that do not run around the axis.
    rig_from_part (4, 4) : its origin on the axis.
    """
    rims = mask_along(
        view.images.rectification, [circle_curve(circle, True) for circle in circles], rig_from_part
    )
    heights = sorted({round(float(circle.centre_mm[2]), 2) for circle in circles})
    normal, origin = rig_from_part[:3, 2], rig_from_part[:3, 3]
    faces = [Plane(normal, float(normal @ origin) + height) for height in heights]
    telling = 0
    for contour in view.contours_in(view.mask):
        in_faces = [mostly(agreeing_with(view, face, contour), contour.closed) for face in faces]
        tells = np.any(in_faces, axis=0) & ~_runs_around(view, rig_from_part, contour)
        telling += int(np.count_nonzero(tells & ~_is_in(rims, contour)))
    return np.minimum(rims, view.mask) if telling < TEACHING.telling_px else None


def _is_in(mask: Image, contour: Contour) -> B8:
    """(N,) whether points of a contour lie in a mask."""
    x, y = np.rint(contour.points).astype(np.intp).T
    return np.asarray(mask[np.clip(y, 0, mask.shape[0] - 1), np.clip(x, 0, mask.shape[1] - 1)] > 0)


def _runs_around(view: TeachingView, rig_from_part: FloatArray, contour: Contour) -> B8:
    """(N,) whether a contour, laid on the face, runs along a circle about the axis there."""
    face = Plane.through(rig_from_part[:3, 3], rig_from_part[:3, 2])
    along = np.column_stack([-contour.normals[:, 1], contour.normals[:, 0]])
    here, ahead = (
        apply(invert(rig_from_part), face.meet(view.images.rays("left", points)))[:, :2]
        for points in (contour.points, contour.points + along)
    )
    step = ahead - here
    across = np.abs(np.sum(step * here, axis=1))
    lengths = np.linalg.norm(step, axis=1) * np.linalg.norm(here, axis=1)
    return np.asarray(across < TEACHING.around_sine * np.maximum(lengths, 1e-12))
