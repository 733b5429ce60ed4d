"""Outlines in a plane: circles, straight edges and slots.

A curve lives in a face: a plane with an origin and axes u, v, normal (away from the cameras, as z of a part
frame). What moves it in an image is only its motion across itself, so each sample carries one number per
parameter: the speed of the curve along its own normal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray
from edged.vision.kernels.jit import F2

Kind = Literal["circle", "edge", "slot"]
PLANE_PARAMETERS = 3
"""Height of the plane over the face, and its slopes along u and v."""
MIN_RADIUS_MM = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """A plane in the rig frame: origin (3,), axes (3, 3) with rows u, v, normal (right-handed)."""

    origin: FloatArray
    axes: FloatArray

    @property
    def normal(self) -> FloatArray:
        """(3,) unit; the third axis."""
        return np.asarray(self.axes[2])

    def to_rig(self, points: FloatArray) -> FloatArray:
        """Points (N, 3) of the rig frame for points (N, 2) in the face, or (N, 3) with a height over it."""
        return np.asarray(self.origin + points @ self.axes[: points.shape[-1]])

    def from_rig(self, points_mm: FloatArray) -> FloatArray:
        """Points (N, 3) in the axes of the face: u, v, height."""
        return np.asarray((points_mm - self.origin) @ self.axes.T)

    def moved(self, plane: FloatArray) -> Face:
        """The face after a step of height and slopes; the axes stay as near to the old ones as they can."""
        height, slope_u, slope_v = plane
        u, v, n = self.axes
        normal = n - slope_u * u - slope_v * v
        normal = normal / np.linalg.norm(normal)
        across = u - (u @ normal) * normal
        across = across / np.linalg.norm(across)
        return Face(self.origin + height * n, np.stack([across, np.cross(normal, across), normal]))


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One outline in the face.

    parameters : mm and rad. Of a circle (x, y, radius); of an edge (x, y, angle): its middle, its direction
    (u to v); of a slot (x, y, angle, length, width): its centre, its long axis, its length over all.
    polarity : +1 brighter along the normal, -1 darker, 0 not known. The normal points outwards; of an edge
    it is the direction turned by 90° from u to v.
    length_mm : of an edge; its ends are no result of a fit.
    height_mm : of its plane along the face's normal; kept.
    signs (2, S) : the polarity over each of S equal stretches of the outline, in the left and the right
    image, 0 where it is not to be measured; None: the polarity is that of the whole curve in both.
    break_mm : width of the edge break either end of which it may be; 0: what the images show of one.
    """

    name: str
    kind: Kind
    parameters: FloatArray
    polarity: int
    length_mm: float = 0.0
    height_mm: float = 0.0
    signs: npt.NDArray[np.int64] | None = None
    break_mm: float = 0.0

    def signs_at(self, side: int, count: int) -> npt.NDArray[np.int64]:
        """(count,) the polarity at samples of `spread`; 0 : not known, or, of stretches, not measured."""
        if self.signs is None:
            return np.full(count, self.polarity)
        stretch = (np.arange(count) + 0.5) / count * self.signs.shape[1]
        return np.asarray(self.signs[side, stretch.astype(np.int64)])

    @property
    def closed(self) -> bool:
        """Whether it ends where it begins."""
        return self.kind != "edge"

    @property
    def direction(self) -> FloatArray:
        """(2,) unit: of an edge, or a slot's long axis."""
        angle = float(self.parameters[2])
        return np.array([math.cos(angle), math.sin(angle)])

    @property
    def perimeter_mm(self) -> float:
        """Length of the outline.

        >>> slot = Curve("s", "slot", np.array([0.0, 0.0, 0.0, 9.0, 4.0]), 1)  # 9 mm long, 4 mm wide
        >>> round(slot.perimeter_mm - (2 * 5 + 4 * math.pi), 9)
        0.0
        """
        if self.kind == "circle":
            return float(2 * math.pi * self.parameters[2])
        if self.kind == "edge":
            return self.length_mm
        length, width = self.parameters[3:]
        return float(2 * (length - width) + math.pi * width)

    @property
    def free(self) -> int:
        """Unknowns of a fit: an edge cannot be moved along itself."""
        return 2 if self.kind == "edge" else len(self.parameters)

    def lift(self) -> FloatArray:
        """(P, free): the parameters by the unknowns of a fit."""
        if self.kind != "edge":
            return np.eye(len(self.parameters))
        x, y = self.direction
        return np.array([[-y, 0.0], [x, 0.0], [0.0, 1.0]])

    def moved(self, delta: FloatArray) -> Curve | None:
        """After a step of its unknowns; None when there is nothing left of it."""
        parameters = self.parameters + self.lift() @ delta
        if not np.isfinite(parameters).all() or (parameters[2:][-1] < MIN_RADIUS_MM and self.kind != "edge"):
            return None
        if self.kind == "slot" and parameters[3] < parameters[4]:
            return None
        return replace(self, parameters=parameters)

    def outline(self, share: FloatArray, margin_mm: float = 0.0) -> CurveOutline:
        """Samples at shares (N,) in [0, 1) of the outline; an edge keeps a margin from its ends."""
        if self.kind == "circle":
            points, normals, speed = _circle(self, share)
        elif self.kind == "edge":
            points, normals, speed = _edge(self, share, margin_mm)
        else:
            points, normals, speed = _slot(self, share)
        return CurveOutline(np.column_stack([points, np.full(len(share), self.height_mm)]), normals, speed)

    def spread(self, count: int, margin_mm: float = 0.0) -> CurveOutline:
        """`outline` at so many places, evenly spread."""
        if self.kind != "circle":
            return self.outline((np.arange(count) + 0.5) / count, margin_mm)
        x, y, radius = self.parameters
        normals, speed = _around(count)
        points = np.empty((count, 3))
        points[:, :2] = (x, y) + radius * normals
        points[:, 2] = self.height_mm
        return CurveOutline(points, normals, speed)


class CurveOutline(NamedTuple):
    """Samples of curves: points (N, 3), u, v and height; normals (N, 2) in the face.

    speed (N, F) : motion along the normal by the unknowns of the sample's curve.
    """

    points: F2
    normals: F2
    speed: F2


Samples = tuple[FloatArray, FloatArray, FloatArray]
"""Points (N, 2), normals (N, 2) and speed (N, free), as an `CurveOutline` has them."""


def _circle(curve: Curve, share: FloatArray) -> Samples:
    x, y, radius = curve.parameters
    normals, speed = _at_phase(2 * np.pi * share)
    return (x, y) + radius * normals, normals, speed


def _at_phase(phase: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normals (N, 2) and speed (N, 3) of any circle."""
    normals = np.column_stack([np.cos(phase), np.sin(phase)])
    return normals, np.column_stack([normals, np.ones(len(phase))])


@lru_cache(maxsize=64)  # of a job's few circles at two spacings
def _around(count: int) -> tuple[FloatArray, FloatArray]:
    normals, speed = _at_phase(2 * np.pi * (np.arange(count) + 0.5) / count)
    normals.flags.writeable = speed.flags.writeable = False
    return normals, speed


def _edge(curve: Curve, share: FloatArray, margin_mm: float) -> Samples:
    direction = curve.direction
    along = (share - 0.5) * max(curve.length_mm - 2 * margin_mm, 0.0)
    normal = np.array([-direction[1], direction[0]])
    points = curve.parameters[:2] + along[:, None] * direction
    return points, np.tile(normal, (len(share), 1)), np.column_stack([np.ones(len(share)), along])


def _slot(curve: Curve, share: FloatArray) -> Samples:
    """Around from the middle of the right end: arc, upper line, left arc, lower line, arc."""
    x, y, _, length, width = curve.parameters
    half, radius = 0.5 * (length - width), 0.5 * width
    way = share * curve.perimeter_mm
    quarter = 0.5 * np.pi * radius
    first, second = way < quarter, way < quarter + 2 * half
    third, fourth = way < 3 * quarter + 2 * half, way < 3 * quarter + 4 * half
    on_line = (~first & second) | (~third & fourth)
    phase = np.select(
        [first, second, third, fourth],
        [
            way / radius,
            np.full_like(way, 0.5 * np.pi),
            (way - 2 * half) / radius,
            np.full_like(way, 1.5 * np.pi),
        ],
        (way - 4 * half) / radius,
    )
    middle = np.select(
        [first, second, third, fourth],
        [half, half - (way - quarter), -half, -half + (way - 3 * quarter - 2 * half)],
        half,
    )
    normals = np.column_stack([np.cos(phase), np.sin(phase)])
    points = radius * normals
    points[:, 0] += middle
    swing = points[:, 0] * normals[:, 1] - points[:, 1] * normals[:, 0]
    by_length = np.where(on_line, 0.0, 0.5 * np.abs(normals[:, 0]))
    turn = np.stack([curve.direction, [-curve.direction[1], curve.direction[0]]])
    turned = normals @ turn
    return points @ turn + (x, y), turned, np.column_stack([turned, swing, by_length, 0.5 - by_length])
