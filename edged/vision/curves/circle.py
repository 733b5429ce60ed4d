"""Circles in space as the cameras see them, and what a fit says about one (`circlefit` fits them)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from edged.domain import Circle3D, FloatArray


@dataclass(frozen=True, slots=True)
class CircleFitParams:
    """How circles are measured.

    reach_px : search range along the normals, one iteration each; the last one is repeated until
    the circles stand still. spacing_px : of the samples along the edge. min_slope : grey values
    per px below which there is no edge.
    """

    reach_px: tuple[float, ...] = (6.0, 4.0, 2.5, 2.0)
    spacing_px: float = 1.0
    min_slope: float = 1.5
    repeats: int = 4


@dataclass(frozen=True, slots=True, eq=False)
class CircleGuess:
    """Where a circle of the face should be: rig frame, mm.

    polarity : +1 brighter outside, -1 darker outside, 0 whichever most of its edge shows.
    """

    name: str
    centre_mm: FloatArray
    radius_mm: float
    polarity: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class CircleFit:
    """A fitted circle and how well it is supported.

    circle : rig frame.  covariance (6, 6) : of (centre, normal tilt about `axes[0]`, about `axes[1]`,
    radius) in mm and rad.  axes (2, 3) : unit vectors u, v that span the plane; a tilt about u moves the
    point at v up the normal.
    support_left, support_right : share of the circumference with an edge that agrees.
    rms_px : weighted rms of the edges that agree.
    points_left, points_right (N, 2) : measured edge points in raw pixels, NaN where there is none.
    weights_left, weights_right (N,) : in [0, 1].  polarity : +1 or -1, as found.
    """

    circle: Circle3D
    covariance: FloatArray
    axes: FloatArray
    support_left: float
    support_right: float
    rms_px: float
    points_left: FloatArray
    points_right: FloatArray
    weights_left: FloatArray
    weights_right: FloatArray
    polarity: int

    def renamed(self, name: str) -> CircleFit:
        """The same fit under another name."""
        return replace(self, circle=replace(self.circle, name=name))


@dataclass(frozen=True, slots=True, eq=False)
class FaceFit:
    """Circles measured together in one plane; their normals are equal.

    first : the first one.  others : the rest in the order asked for, None where the images show too little.
    covariance (P, P) of the joint unknowns: centre of the first circle (3), tilt about axes u, v (2), radius
    of the first; then for each further circle its centre along u and v from the first, and its radius.
    """

    first: CircleFit
    others: tuple[CircleFit | None, ...]
    covariance: FloatArray
