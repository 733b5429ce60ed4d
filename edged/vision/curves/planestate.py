"""Plane and curves at one moment of a fit: sampled, measured, and the step that fits best."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import B8, I64, SIDES, FloatArray, Image
from edged.vision.curves.adjustment import solve
from edged.vision.curves.commonmode import Pairs, pair, samples_of
from edged.vision.curves.operatorwidth import START_WIDTH, choose_widths
from edged.vision.curves.outlines import (
    PLANE_PARAMETERS,
    Curve,
    CurveOutline,
    Face,
    ProjectedOutline,
    camera_pose,
    curvatures,
    project_outline,
)
from edged.vision.curves.params import FIT, FitParams
from edged.vision.curves.samples import JointSolution, Samples
from edged.vision.curves.systematic import fourier_basis, shift_basis, slants
from edged.vision.edges.params import EDGE
from edged.vision.edges.subpixel import WIDTHS_PX, edges_at_widths
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import about_z, apply
from edged.vision.kernels.jit import for_both
from edged.vision.kernels.robust import MIN_SAMPLES

RIGID_PARAMETERS = 4
"""Parameters of a rigid part besides its plane: shift along u and v, turn, growth."""
PROBES_MM = FIT.probe_mm * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""A point and two beside it, for the scale of the image there."""
WAVES = 5  # columns of `fourier_basis`
START_WIDTHS_PX = WIDTHS_PX[START_WIDTH : START_WIDTH + 1]


@dataclass(frozen=True, slots=True, eq=False)
class CurveEdges:
    """Edges found along the curves in both images.

    offset_px (2, N), NaN where there is no edge; base (2, N) prior weights, 0 for curves of which one image
    shows too little; bias_px (2, K) : sigma to expect of systematic shifts.  clipped (2, N) bool : beside a
    saturated surface.  soft (2, N) bool : of a curve that is blurred.
    """

    offset_px: FloatArray
    base: FloatArray
    bias_px: FloatArray
    clipped: B8
    soft: B8


class FitProblem(NamedTuple):
    """A step's problem and its solution.

    face, curves : as they lay; outline, sides : the samples in the face and in both images; starts (K + 1,) :
    where each curve's begin.  used (V,) : the unknowns of the fit that were solved for.  final : with
    systematic shifts, and with the shift of the rows as the last unknown.
    """

    samples: Samples
    solution: JointSolution
    pairs: Pairs
    face: Face
    curves: tuple[Curve, ...]
    outline: CurveOutline
    sides: tuple[ProjectedOutline, ProjectedOutline]
    edges: CurveEdges
    starts: I64
    used: I64
    final: bool


@dataclass(frozen=True, slots=True, eq=False)
class FitStep:
    """One step of the joint problem.

    delta (U,), covariance, edge_covariance (U, U) : 0 for what is held or not seen.  moved_px (K,) :
    farthest that each curve moves.  row_shift_px, row_sigma_px : as `PlaneFit` has them.
    starts (K + 1,) : where its samples begin.  offsets, weights, residuals (2, N), points (2, N, 2).
    """

    delta: FloatArray
    problem: FitProblem
    moved_px: FloatArray
    row_shift_px: float
    starts: I64
    points: FloatArray
    offsets: FloatArray
    weights: FloatArray
    residuals: FloatArray

    def support(self) -> FloatArray:
        """(2, K) share of the samples of each curve with an edge that agrees, left and right."""
        agree = (self.weights > 0) & (np.abs(self.residuals) < FIT.agree_px)
        return np.add.reduceat(agree, self.starts[:-1], axis=1, dtype=np.float64) / np.diff(self.starts)

    def supported(self, share: float) -> list[int]:
        """The curves of which both images show at least this share."""
        seen = np.add.reduceat(self.weights, self.starts[:-1], axis=1).sum(axis=0) >= MIN_SAMPLES
        return np.flatnonzero(seen & (self.support().min(axis=0) >= share)).tolist()


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Plane and curves at one moment of the fit; what is held: the normal, the circles' radii.

    Of a rigid part the curves stay as they were taught, and the face moves with the part.
    """

    rig: StereoRig
    images: tuple[Image, Image]
    face: Face
    curves: tuple[Curve, ...]
    params: FitParams
    fixed_normal: bool
    fixed_radius: bool
    rigid_mm: float | None = None

    @property
    def shared(self) -> int:
        """Unknowns of all curves together, which come first."""
        return PLANE_PARAMETERS if self.rigid_mm is None else PLANE_PARAMETERS + RIGID_PARAMETERS

    def _px_per_mm(self) -> FloatArray:
        """(K,) scale of the left image at each curve; NaN behind the camera."""
        middles = np.array([[*curve.parameters[:2], curve.height_mm] for curve in self.curves])
        probes = (middles[:, None] + PROBES_MM).reshape(-1, 3)
        space = self.face.to_rig(probes)
        with np.errstate(invalid="ignore", divide="ignore"):
            pixels = self.rig.left.project(space).reshape(-1, 3, 2)
        scales = np.linalg.norm(pixels[:, 1:] - pixels[:, :1], axis=2).mean(axis=1) / FIT.probe_mm
        return np.where(space[::3, 2] > 0, scales, np.nan)

    def sampled(self, spacing_px: float) -> tuple[CurveOutline, I64] | None:
        """Samples of all curves, and where each curve's begin (K + 1,).

        None when one lies behind the cameras, or has a size that no image can show.
        """
        outlines = []
        for curve, scale in zip(self.curves, self._px_per_mm(), strict=True):
            size_px = curve.perimeter_mm * scale - (0.0 if curve.closed else 2 * FIT.margin_px)
            least_px = 2 * math.pi * FIT.min_radius_px if curve.kind == "circle" else FIT.min_length_px
            if not least_px < size_px < FIT.max_length_px:  # False for NaN
                return None
            fewest = FIT.min_samples_around if curve.closed else FIT.min_samples
            count = min(max(int(size_px / spacing_px), fewest), FIT.max_samples)
            outlines.append(curve.spread(count, FIT.margin_px / scale))
        starts = np.cumsum([0, *(len(outline.points) for outline in outlines)])
        points = np.concatenate([outline.points for outline in outlines])
        normals = np.concatenate([outline.normals for outline in outlines])
        common = self.shared - PLANE_PARAMETERS
        speed = np.zeros((starts[-1], common + max(curve.free for curve in self.curves)))
        for k, outline in enumerate(outlines):
            speed[starts[k] : starts[k + 1], common : common + outline.speed.shape[1]] = outline.speed
        if self.rigid_mm is not None:
            speed *= self.rigid_mm
            speed[:, :2] = normals
            speed[:, 2] = points[:, 0] * normals[:, 1] - points[:, 1] * normals[:, 0]
            speed[:, 3] = FIT.growth_sigma * np.sum(points[:, :2] * normals, axis=1)
        return CurveOutline(points, normals, speed), starts

    @property
    def unknowns(self) -> int:
        """Number of unknowns of the whole problem."""
        return self.shared + sum(curve.free for curve in self.curves)

    def columns(self, seen: B8) -> I64:
        """(K, C): which unknown each column of the design is, -1 where a curve has none, or it is held.

        seen (K,) : of the others nothing is known.
        """
        first = self.shared
        columns = np.full((len(self.curves), first + max(c.free for c in self.curves)), -1)
        columns[:, :first] = np.arange(first)
        if self.fixed_normal:
            columns[:, 1:PLANE_PARAMETERS] = -1
        for k, curve in enumerate(self.curves):
            columns[k, self.shared : self.shared + curve.free] = first + np.arange(curve.free)
            if self.fixed_radius and curve.kind == "circle":
                columns[k, self.shared + 2] = -1
            first += curve.free
        columns[~seen] = -1
        return columns

    def with_polarity(self, reach: float, spacing_px: float) -> State:
        """Give curves of unknown polarity the sign of most of their contrast."""
        sampled = None if all(curve.polarity for curve in self.curves) else self.sampled(spacing_px)
        if sampled is None:
            return self
        outline, starts = sampled
        total = np.zeros(len(self.curves))
        for side, image in zip(SIDES, self.images, strict=True):
            seen = project_outline(self.rig, side, self.face, outline)
            slope = edges_at_widths(image, seen.pixels, seen.normals, reach, 0, START_WIDTHS_PX).slope[0]
            strong = np.abs(np.nan_to_num(slope)) >= self.params.min_slope
            total += np.add.reduceat(np.where(strong, slope, 0.0), starts[:-1])
        signs = np.where(total < 0, -1, 1)
        return replace(
            self,
            curves=tuple(
                replace(curve, polarity=curve.polarity or int(sign))
                for curve, sign in zip(self.curves, signs, strict=True)
            ),
        )

    def step(self, reach: float, spacing_px: float, *, final: bool) -> FitStep | None:
        """Measure the edges at the present curves, and solve for the step that fits them best.

        final : each curve chooses its operator width, and systematic shifts are reckoned with.
        """
        sampled = self.sampled(spacing_px)
        if sampled is None:
            return None
        outline, starts = sampled
        sides, edges = self._measure(outline, starts, reach, final)
        gain = np.stack([side.gain for side in sides])
        pairs = pair(edges.offset_px, edges.base, gain, starts, together=final)
        columns = self.columns(np.diff(pairs.parts) > 0)
        # unknowns that are held leave no gap: the solver would find them undetermined
        used = np.unique(columns[columns >= 0])
        dense = np.where(columns < 0, -1, np.searchsorted(used, columns))
        samples, priors = samples_of(
            pairs,
            self.with_row_shift(outline, sides) if final else tuple(side.design for side in sides),
            np.pad(dense, ((0, 0), (0, 1)), constant_values=-1) if final else dense,
            edges.offset_px,
            edges.bias_px,
            np.array([curve.polarity for curve in self.curves]),
            self.shift_basis(outline, sides, gain) if final else None,
            len(used),
        )
        if final:
            samples.columns[samples.columns[:, 0] >= 0, -1] = len(used) + priors
            priors += 1
        known_before = 0  # of a rigid part: its growth, and each curve's own places and sizes
        if self.rigid_mm is not None:
            known_before = int(np.count_nonzero(used >= self.shared - 1))
        solution = solve(
            samples, len(used) + priors, known_before + priors, FIT.settled if final else FIT.roughly
        )
        if solution is None:
            return None
        delta = np.zeros(self.unknowns)
        delta[used] = solution.delta[: len(used)]
        return FitStep(
            delta,
            FitProblem(
                samples, solution, pairs, self.face, self.curves, outline, sides, edges, starts, used, final
            ),
            self._motion(sides, delta, starts),
            FIT.row_sigma_px * float(solution.delta[-1]) if final else math.nan,
            starts,
            np.stack(
                [
                    side.pixels + side.normals * offset[:, None]
                    for side, offset in zip(sides, edges.offset_px, strict=True)
                ]
            ),
            edges.offset_px,
            pairs.weights_by_camera(solution.weights),
            pairs.by_camera(solution.residuals),
        )

    def _measure(
        self, outline: CurveOutline, starts: I64, reach: float, final: bool
    ) -> tuple[tuple[ProjectedOutline, ProjectedOutline], CurveEdges]:
        """The present curves in both images, and the edges across them."""
        counts = np.diff(starts)
        widths, fine = (WIDTHS_PX, EDGE.fine_step_px) if final else (START_WIDTHS_PX, 1.0)
        nothing = np.zeros((starts[-1], 0))

        def side(
            number: int,
        ) -> tuple[
            ProjectedOutline,
            FloatArray,
            FloatArray,
            FloatArray,
            tuple[B8, B8],
        ]:
            seen = project_outline(self.rig, SIDES[number], self.face, outline)
            image = self.images[number]
            signs = np.concatenate(
                [curve.signs_at(number, count) for curve, count in zip(self.curves, counts, strict=True)]
            )
            edges = edges_at_widths(image, seen.pixels, seen.normals, reach, signs, widths, fine)
            for k, curve in enumerate(self.curves):
                if curve.signs is not None:
                    rows = slice(starts[k], starts[k + 1])
                    edges.offset_px[:, rows][:, signs[rows] == 0] = np.nan
            waves = self._waves(seen, starts) if final else nothing
            chosen = choose_widths(edges, starts, waves, self.params.min_slope)
            offsets = chosen.offset_px
            if final:
                # blur averages over a disc: where the edge is bent, the extremum of the slope lies nearer to
                # the centre of the bend by blur² x curvature / 2
                blur2_px2 = np.repeat(chosen.blur2_px2, counts)
                offsets = offsets + 0.5 * blur2_px2 * self._curvature(seen, starts)
            soft = np.repeat(chosen.blur2_px2 >= FIT.soft_px**2, counts)
            return seen, offsets, chosen.base, chosen.bias_px, (edges.clipped, soft)

        # side by side only what takes long enough: handing it over costs as much as a coarse step
        both = for_both(side) if final else (side(0), side(1))
        (left, *of_left, poor_left), (right, *of_right, poor_right) = both
        offsets, base, bias = (np.stack(pair) for pair in zip(of_left, of_right, strict=True))
        few = np.add.reduceat(base > 0, starts[:-1], axis=1).min(axis=0) < MIN_SAMPLES
        base = np.where(np.repeat(few, counts), 0.0, base)
        return (left, right), CurveEdges(
            offsets, base, bias, *(np.stack(pair) for pair in zip(poor_left, poor_right, strict=True))
        )

    def with_row_shift(
        self, outline: CurveOutline, sides: tuple[ProjectedOutline, ProjectedOutline]
    ) -> tuple[FloatArray, FloatArray]:
        """The designs (N, C) of both images with a column for a shift of one against the other across rows.

        No place in space explains such a shift: it is what a knocked camera, or a calibration that is a
        little wrong, does to all curves alike. Without it every curve would seem displaced by itself. Half of
        it is each camera's: which one has moved is unknown.
        """
        rig, space = self.rig, self.face.to_rig(outline.points)
        right_centre = -rig.right_from_left[:3, :3].T @ rig.right_from_left[:3, 3]
        # a row is what one camera shows of a ray of the other
        on_left = rig.left.project(space + FIT.ray_step * (space - right_centre))
        on_right = rig.right.project(apply(rig.right_from_left, space * (1 + FIT.ray_step)))
        columns = []
        # both rays run away from each other: what is down in one image is up in the other
        for seen, beyond in zip(sides, (on_left, on_right), strict=True):
            along = beyond - seen.pixels
            with np.errstate(invalid="ignore", divide="ignore"):
                across = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
            columns.append(0.5 * FIT.row_sigma_px * np.sum(seen.normals * across, axis=1))
        left, right = (
            np.column_stack([seen.design, column]) for seen, column in zip(sides, columns, strict=True)
        )
        return left, right

    def shift_basis(
        self, outline: CurveOutline, sides: tuple[ProjectedOutline, ProjectedOutline], gain: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(N, A) each: the shapes of systematic shifts in both images."""
        points, across = self.face.to_rig(outline.points), outline.normals @ self.face.axes[:2]
        poses = (camera_pose(self.rig, side)[1] for side in SIDES)
        slant = np.stack([slants(points, across, self.face.normal, pose) for pose in poses])
        return shift_basis(sides[0].normals, gain, slant)

    def _motion(
        self,
        sides: tuple[ProjectedOutline, ProjectedOutline],
        delta: FloatArray,
        starts: I64,
    ) -> FloatArray:
        """(K,) farthest that a step of the unknowns moves each curve, px."""
        by_curve = np.append(delta, 0.0)[self.columns(np.ones(len(self.curves), bool))]
        by_sample = by_curve.repeat(np.diff(starts), axis=0)
        moved = np.abs([np.sum(side.design * by_sample, axis=1) for side in sides]).max(axis=0)
        return np.asarray(np.maximum.reduceat(moved, starts[:-1]))

    def _waves(self, seen: ProjectedOutline, starts: I64) -> FloatArray:
        """(N, 5): what tells a systematic shift from scatter; an edge, of one direction, has half waves."""
        waves = fourier_basis(seen.normals)
        for k, curve in enumerate(self.curves):
            if not curve.closed:
                waves[starts[k] : starts[k + 1]] = _half_waves(int(starts[k + 1] - starts[k]))
        return waves

    def _curvature(self, seen: ProjectedOutline, starts: I64) -> FloatArray:
        """(N,) of the projected curves, 1 / px."""
        closed = np.repeat([curve.closed for curve in self.curves], np.diff(starts))
        return np.where(closed, curvatures(seen.pixels, seen.normals, starts), 0.0)

    def moved(self, step: FitStep) -> State | None:
        """The state after a step; None when it has run away."""
        plane = step.delta[:PLANE_PARAMETERS]
        if not np.isfinite(step.delta).all() or np.abs(plane[1:]).max() > FIT.max_slope:
            return None
        if abs(plane[0]) > FIT.max_rise * abs(self.face.origin[2]):
            return None
        if self.rigid_mm is not None:
            shift_u, shift_v, turn = step.delta[PLANE_PARAMETERS : self.shared - 1]
            face = self.face.moved(plane)
            origin = face.origin + shift_u * face.axes[0] + shift_v * face.axes[1]
            return replace(self, face=Face(origin, about_z(float(turn)).T @ face.axes))
        curves, first = [], PLANE_PARAMETERS
        for curve in self.curves:
            own = step.delta[first : first + curve.free]
            first += curve.free
            away = curve.kind == "circle" and np.abs(own).max() >= FIT.runaway * curve.parameters[2]
            fresh = None if away else curve.moved(own)
            if fresh is None and len(self.curves) == 1:
                return None
            curves.append(curve if fresh is None else fresh)
        return replace(self, face=self.face.moved(plane), curves=tuple(curves))


def _half_waves(count: int) -> FloatArray:
    """(N, 5): half waves along a curve, each with a mean square of 1."""
    way = (np.arange(count) + 0.5) / count
    return np.column_stack(
        [np.ones(count), *(math.sqrt(2.0) * np.cos(m * np.pi * way) for m in range(1, WAVES))]
    )
