"""What to look for, and what was found."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal, get_args

import numpy as np

from edged.domain.arrays import FloatArray
from edged.errors import UserError

Polarity = Literal["same", "global", "local", "ignore"]
SubPixel = Literal["none", "rigid", "similarity", "stretch", "affine", "projective"]
EACH_EDGE_ITSELF: tuple[Polarity, ...] = ("local", "ignore")
"""Where the sign of one edge says nothing about that of another."""


@dataclass(frozen=True, slots=True)
class SearchParams:
    """What to look for. Names as in the field; wrong values raise `UserError` that names them.

    angle_start_rad, angle_extent_rad : range of the rotation against the teaching.
    scale_min, scale_max : range of the size.
    scale_y_min, scale_y_max : range of the size along the model's y axis, independent of x; None: as along x.
    min_score : (0, 1], share of the model that must be seen and agree.
    max_matches : the best ones are returned.
    max_overlap : of two matches that share more than this of their area, the better one remains.
    polarity : contrast "same" as taught; "global": all may be inverted together; "local": each
        stretch of the outline by itself; "ignore": each edge by itself, which clutter imitates most easily.
    min_contrast : grey values per px below which there is no edge.
    sub_pixel : what the refinement may adapt: "none" (the grid of the search), "rigid" (position, angle;
        with a range of scales these are fitted, too),
        "similarity" (and size), "stretch" (sizes along x and y), "affine", "projective" (a tilted face).
    allow_partial : whether a match may reach beyond the image.
    """

    angle_start_rad: float = -np.pi
    angle_extent_rad: float = 2 * np.pi
    scale_min: float = 0.9
    scale_max: float = 1.1
    min_score: float = 0.6
    max_matches: int = 1
    max_overlap: float = 0.5
    polarity: Polarity = "global"
    min_contrast: float = 2.0
    scale_y_min: float | None = None
    scale_y_max: float | None = None
    sub_pixel: SubPixel = "projective"
    allow_partial: bool = True

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not np.isfinite(value):
                raise UserError(f"search.{field.name}: expected a finite number, got {value}")
        _in_range("angle_extent_rad", self.angle_extent_rad, 0, 2 * np.pi + 1e-9)
        _in_range("angle_start_rad", self.angle_start_rad, -1e3, 1e3)
        _in_range("scale_min", self.scale_min, 0.1, 10)
        _in_range("scale_max", self.scale_max, self.scale_min, 10)
        _in_range("min_score", self.min_score, 0.1, 1)
        _in_range("max_matches", self.max_matches, 1, 1000)
        _in_range("max_overlap", self.max_overlap, 0, 1)
        _in_range("min_contrast", self.min_contrast, 0, 255)
        if (self.scale_y_min is None) != (self.scale_y_max is None):
            raise UserError("search.scale_y_min, scale_y_max: expected both or none")
        if self.scale_y_min is not None and self.scale_y_max is not None:
            _in_range("scale_y_min", self.scale_y_min, 0.1, 10)
            _in_range("scale_y_max", self.scale_y_max, self.scale_y_min, 10)
        for name, given, modes in (
            ("polarity", self.polarity, get_args(Polarity)),
            ("sub_pixel", self.sub_pixel, get_args(SubPixel)),
        ):
            if given not in modes:
                raise UserError(f"search.{name}: expected one of {modes}, got {given!r}")


def _in_range(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise UserError(f"search.{name}: expected {low:g} to {high:g}, got {value:g}")


@dataclass(frozen=True, slots=True, eq=False)
class ShapeMatch:
    """One found shape, in px of the searched image.

    x_px, y_px : the model's origin.  angle_rad : from x to y.  scale_x, scale_y : along the model's axes.
    linear (2, 2), tilt (2,) : the map that was fitted, see `apply`; score in [0, 1].
    inverted : all contrasts are opposite to the taught ones.
    ambiguous : another rotation explains the image nearly as well.
    model : index of the model among those looked for.
    symmetric : the taught shape looks the same at other angles; this is the one nearest to the taught.
    covariance (5, 5) : of x_px, y_px, angle_rad, scale_x, scale_y, from the residuals of the edges; NaN
        where the mode leaves one at rest or nothing was refined.
    """

    x_px: float
    y_px: float
    angle_rad: float
    scale_x: float
    scale_y: float
    score: float
    linear: FloatArray
    tilt: FloatArray
    inverted: bool
    ambiguous: bool
    model: int
    symmetric: bool
    covariance: FloatArray

    def apply(self, points_px: FloatArray) -> FloatArray:
        """Image points (N, 2) of model points (N, 2): origin + linear p / (1 + tilt . p)."""
        depth = 1 + points_px @ self.tilt
        return np.asarray(points_px @ self.linear.T / depth[:, None] + (self.x_px, self.y_px))

    def transform(self) -> FloatArray:
        """(2, 3) affine map from model points (relative to its origin) to the image."""
        return np.column_stack([self.linear, (self.x_px, self.y_px)])
