"""Circles, straight edges and slots of one face, fitted in space to the raw edges of both cameras at once.

The paper fits an ellipse in each rectified image and triangulates its centre; but the image of a circle's
centre is not the centre of its ellipse (0.1-0.3 mm at 24° vergence). Here the unknowns are the plane and each
curve's own parameters in it. The curves are projected through lens and pose of each camera, edges are
measured across the projected curves, and their offsets along the normals are the residuals of one robust
least-squares problem. Nothing is rectified, no ellipse is formed, no point needs a partner in the other
image.

One solution for all curves gives what distances and angles between features need: their joint covariance, in
which the errors that they share, of the plane, of the light and of the calibration, cancel as they do in the
result. What both cameras say in common and what they say against each other are different witnesses (see
`commonmode`), each with a scatter and a correlation along the edge of its own. Half of the variance of the
systematic edge shifts is each curve's own, half is shared by the curves of one kind: five holes in one light
are not five independent witnesses (see `systematic`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from edged.domain import SIDES, FloatArray, Image
from edged.vision.curves.adjustment import ROUGHLY, SETTLED, propagate, solve
from edged.vision.curves.commonmode import pair, samples_of
from edged.vision.curves.operatorwidth import START_WIDTH, choose_widths
from edged.vision.curves.outlineprojection import (
    ProjectedOutline,
    camera_pose,
    circle_axes,
    curvatures,
    project_outline,
)
from edged.vision.curves.outlines import PLANE_PARAMETERS, Curve, Face, Outline
from edged.vision.curves.systematic import fourier_basis, shift_basis, slants
from edged.vision.edges.subpixel import FINE_STEP_PX, WIDTHS_PX, edges_at_widths
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.projection import shifts_by_calibration
from edged.vision.geometry.rigid import apply
from edged.vision.kernels.parallel import for_both
from edged.vision.kernels.robust import MIN_SAMPLES

AGREE_PX = 0.5
"""An edge that scatters more is another one, whatever the others do."""
MARGIN_PX = 5.0
"""Of an edge at both ends: the corner's blur, seen through the widest operator."""
MIN_SPOKES, MAX_SPOKES = 24, 2000
MIN_SPOKES_AROUND = 48
MIN_RADIUS_PX, MIN_LENGTH_PX, MAX_LENGTH_PX = 3.0, 3.0, 1e6
COARSE_SPACING_PX = 3.0  # while the curves still move
STILL_PX = 0.2  # edges measured anew at curves that moved by less come out the same, to 0.003 px
RUNAWAY = 0.5
"""Of its size: a curve that would move by more in one step stays, and must not take the others with it."""
MAX_SLOPE, MAX_RISE = 0.5, 0.2
"""Of the plane in one step: slope, and height in shares of the distance."""
PROBE_MM = 0.01
PROBES_MM = PROBE_MM * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""A point and two beside it, for the scale of the image there."""
CLIPPED_PX, CLIPPED_APART = 0.15, 0.3
"""By which a saturated surface moves the edge beside it (a step cut off at half its height: 0.2 px), and what
of it both cameras do not have in common."""
SOFT_PX, SOFT_SHIFT_PX = 1.1, 0.15
"""Blur from which an edge is one with what lies beside it (`operatorwidth` tells it up to 1.2), and by how
much that moves it: by a tenth of the blur, as of something with a tenth of the contrast."""
ROW_SIGMA_PX = 0.3
"""How far the rows of both images may lie apart, before anything was measured."""
RAY_STEP = 1e-3  # of the distance: along the ray of the left camera the right image shows the row
WAVES = 5
START_WIDTHS_PX = WIDTHS_PX[START_WIDTH : START_WIDTH + 1]


Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class FitParams:
    """How curves are measured.

    reach_px : search range along the normals, one iteration each; the last one is repeated until the curves
    stand still, `repeats` times at most; with 0 repeats the curves are only laid where they are.
    spacing_px : of the samples. min_slope : grey values per px below which there is no edge. min_support :
    share of its samples that a curve must show in each image.
    """

    reach_px: tuple[float, ...] = (6.0, 4.0, 2.5, 2.0)
    spacing_px: float = 1.0
    min_slope: float = 1.5
    min_support: float = 0.4
    repeats: int = 4


DEFAULT_PARAMS = FitParams()


@dataclass(frozen=True, slots=True, eq=False)
class CurveFit:
    """A fitted curve and how well it is supported.

    support (2,), left and right : share of the samples with an edge that agrees.  rms_px : weighted,
    of those.  mismatch_px : mean offset in the left image minus that in the right one.
    points (2, N, 2) raw px, NaN where there is no edge; weights (2, N) in [0, 1].
    """

    curve: Curve
    support: FloatArray
    rms_px: float
    mismatch_px: float
    points: FloatArray
    weights: FloatArray

    @property
    def name(self) -> str:
        """Of the curve."""
        return self.curve.name

    @property
    def least_support(self) -> float:
        """Of the camera that sees less of it."""
        return float(self.support.min())


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """A face and its curves.

    fits : in the order asked for, without those that the images do not show.
    covariance (P, P) : of the plane (height, slopes along u and v, see `Face.moved`), then of the parameters
    of each fit's curve, mm and rad, correlations included.
    edge_covariance (P, P) : what of it comes from the edges, not from the calibration.
    row_shift_px, row_sigma_px : by which the right image shows all curves farther across the rows than the
    left one, raw px; sigma with the calibration's; NaN where the curves were only laid where they are.
    """

    face: Face
    fits: tuple[CurveFit, ...]
    covariance: FloatArray
    edge_covariance: FloatArray
    row_shift_px: float
    row_sigma_px: float

    def by_edges(self) -> PlaneFit:
        """The same with the covariance that the edges alone give: against what the same rig measured."""
        return replace(self, covariance=self.edge_covariance)

    @property
    def parameters(self) -> FloatArray:
        """(P,) : 0 for the plane, then each curve's."""
        return np.concatenate([np.zeros(PLANE_PARAMETERS), *(fit.curve.parameters for fit in self.fits)])

    def place(self, name: str) -> slice | None:
        """Where a curve's parameters are in `parameters` and `covariance`."""
        first = PLANE_PARAMETERS
        for fit in self.fits:
            last = first + len(fit.curve.parameters)
            if fit.name == name:
                return slice(first, last)
            first = last
        return None

    def fit_of(self, name: str) -> CurveFit | None:
        """The fit of a curve; None when the images do not show it."""
        return next((fit for fit in self.fits if fit.name == name), None)


def fit_plane(
    rig: StereoRig,
    images: tuple[Image, Image],
    face: Face,
    curves: Sequence[Curve],
    params: FitParams = DEFAULT_PARAMS,
    *,
    fixed_normal: bool = False,
    fixed_radius: bool = False,
) -> PlaneFit | None:
    """Measure curves of one plane together; None when the images show none, or too few to know the plane.

    images : left and right, raw (H, W) uint8.  face, curves : a start, as good as params.reach_px[0].
    fixed_normal : the plane's direction is known better from elsewhere (a small hole in a large face).
    fixed_radius : circles keep theirs; rivals beside a rim then do not fit.
    """
    return _fitted(_State(rig, images, face, tuple(curves), params, fixed_normal, fixed_radius))


def fit_circle(
    rig: StereoRig,
    images: tuple[Image, Image],
    centre_mm: FloatArray,
    normal: FloatArray,
    radius_mm: float,
    polarity: int = 0,
    params: FitParams = DEFAULT_PARAMS,
    *,
    name: str = "circle",
    fixed_normal: bool = False,
    fixed_radius: bool = False,
) -> PlaneFit | None:
    """Measure one circle near a first guess; the rest as `fit_plane`.

    centre_mm, normal (3,) : rig frame; the normal points towards the cameras.
    polarity : +1 brighter outside, -1 darker outside, 0 whichever most of its edge shows.
    """
    face = Face(np.asarray(centre_mm, np.float64), np.vstack([circle_axes(-normal), -normal]))
    circle = Curve(name, "circle", np.array([0.0, 0.0, radius_mm]), polarity)
    return fit_plane(
        rig, images, face, [circle], params, fixed_normal=fixed_normal, fixed_radius=fixed_radius
    )


def _fitted(start: _State) -> PlaneFit | None:
    """Lay the curves where they are, then measure them."""
    params = start.params
    state: _State | None = start
    step: _Step | None = None
    spacing_px = max(params.spacing_px, COARSE_SPACING_PX)
    for number, reach in enumerate(params.reach_px[:-1] if params.repeats else params.reach_px):
        if number == 1 and state is not None:
            # far away there is one dominant edge; from here on each curve keeps its sign
            state = state.with_polarity(reach, spacing_px)
        step = None if state is None else state.step(reach, spacing_px, final=False)
        state = None if state is None or step is None else state.moved(step)
        if number > 0 and step is not None and step.moved_px.max() < STILL_PX:
            break
    if state is None:
        return None
    if params.repeats:
        state = state.with_polarity(params.reach_px[-1], params.spacing_px)
    left = params.repeats
    while left:
        step = state.step(params.reach_px[-1], params.spacing_px, final=True)
        kept = [] if step is None else step.supported(params.min_support)
        if step is None or not kept:
            return None
        if params.min_support and len(kept) < len(state.curves):  # what is not there must not pull the others
            state = replace(state, curves=tuple(state.curves[k] for k in kept))
            continue
        left -= 1
        moved = state.moved(step)
        if moved is None:
            return None
        state = moved
        if step.moved_px.max() < STILL_PX:
            break
    return None if step is None else state.result(step)


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """One step of the joint problem.

    delta (U,), covariance, edge_covariance (U, U) : 0 for what is held or not seen.  moved_px (K,) :
    farthest that each curve moves.  row_shift_px, row_sigma_px : as `PlaneFit` has them.
    starts (K + 1,) : where its samples begin.  offsets, weights, residuals (2, N), points (2, N, 2).
    """

    delta: FloatArray
    covariance: FloatArray
    edge_covariance: FloatArray
    moved_px: FloatArray
    row_shift_px: float
    row_sigma_px: float
    starts: npt.NDArray[np.int64]
    points: FloatArray
    offsets: FloatArray
    weights: FloatArray
    residuals: FloatArray

    def support(self) -> FloatArray:
        """(2, K) share of the samples of each curve with an edge that agrees, left and right."""
        agree = (self.weights > 0) & (np.abs(self.residuals) < AGREE_PX)
        return np.add.reduceat(agree, self.starts[:-1], axis=1, dtype=np.float64) / np.diff(self.starts)

    def supported(self, share: float) -> list[int]:
        """The curves that were seen, by so much of both images."""
        seen = np.add.reduceat(self.weights, self.starts[:-1], axis=1).sum(axis=0) >= MIN_SAMPLES
        return np.flatnonzero(seen & (self.support().min(axis=0) >= share)).tolist()


@dataclass(frozen=True, slots=True, eq=False)
class _Edges:
    """What the curves show in both images.

    offset_px (2, N), NaN where there is no edge; base (2, N) prior weights, 0 for curves of which one image
    shows too little; bias_px (2, K) : sigma to expect of systematic shifts.  clipped (2, N) bool : beside a
    saturated surface.  soft (2, N) bool : of a curve that is blurred.
    """

    offset_px: FloatArray
    base: FloatArray
    bias_px: FloatArray
    clipped: Flags
    soft: Flags


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """Plane and curves at one moment of the fit; what is held: the normal, the circles' radii."""

    rig: StereoRig
    images: tuple[Image, Image]
    face: Face
    curves: tuple[Curve, ...]
    params: FitParams
    fixed_normal: bool
    fixed_radius: bool

    def _px_per_mm(self) -> FloatArray:
        """(K,) scale of the left image at each curve; NaN behind the camera."""
        middles = np.array([[*curve.parameters[:2], curve.height_mm] for curve in self.curves])
        probes = (middles[:, None] + PROBES_MM).reshape(-1, 3)
        space = self.face.to_rig(probes)
        with np.errstate(invalid="ignore", divide="ignore"):
            pixels = self.rig.left.project(space).reshape(-1, 3, 2)
        scales = np.linalg.norm(pixels[:, 1:] - pixels[:, :1], axis=2).mean(axis=1) / PROBE_MM
        return np.where(space[::3, 2] > 0, scales, np.nan)

    def _sampled(self, spacing_px: float) -> tuple[Outline, npt.NDArray[np.int64]] | None:
        """Samples of all curves, and where each curve's begin (K + 1,).

        None when one lies behind the cameras, or has a size that no image can show.
        """
        outlines = []
        for curve, scale in zip(self.curves, self._px_per_mm(), strict=True):
            size_px = curve.perimeter_mm * scale - (0.0 if curve.closed else 2 * MARGIN_PX)
            least_px = 2 * math.pi * MIN_RADIUS_PX if curve.kind == "circle" else MIN_LENGTH_PX
            if not least_px < size_px < MAX_LENGTH_PX:  # False for NaN
                return None
            fewest = MIN_SPOKES_AROUND if curve.closed else MIN_SPOKES
            count = min(max(int(size_px / spacing_px), fewest), MAX_SPOKES)
            outlines.append(curve.spread(count, MARGIN_PX / scale))
        starts = np.cumsum([0, *(len(one.points) for one in outlines)])
        speed = np.zeros((starts[-1], max(curve.free for curve in self.curves)))
        for k, one in enumerate(outlines):
            speed[starts[k] : starts[k + 1], : one.speed.shape[1]] = one.speed
        points = np.concatenate([one.points for one in outlines])
        return Outline(points, np.concatenate([one.normals for one in outlines]), speed), starts

    @property
    def unknowns(self) -> int:
        return PLANE_PARAMETERS + sum(curve.free for curve in self.curves)

    def _columns(self, seen: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
        """(K, C): which unknown each column of the design is, -1 where a curve has none, or it is held.

        seen (K,) : of the others nothing is known.
        """
        columns = np.full((len(self.curves), PLANE_PARAMETERS + max(c.free for c in self.curves)), -1)
        columns[:, :PLANE_PARAMETERS] = np.arange(PLANE_PARAMETERS)
        if self.fixed_normal:
            columns[:, 1:PLANE_PARAMETERS] = -1
        first = PLANE_PARAMETERS
        for k, curve in enumerate(self.curves):
            columns[k, PLANE_PARAMETERS : PLANE_PARAMETERS + curve.free] = first + np.arange(curve.free)
            if self.fixed_radius and curve.kind == "circle":
                columns[k, PLANE_PARAMETERS + 2] = -1
            first += curve.free
        columns[~seen] = -1
        return columns

    def with_polarity(self, reach: float, spacing_px: float) -> _State:
        """Give curves of unknown polarity the sign of most of their contrast."""
        sampled = None if all(curve.polarity for curve in self.curves) else self._sampled(spacing_px)
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

    def step(self, reach: float, spacing_px: float, *, final: bool) -> _Step | None:
        """Measure the edges at the present curves, and solve for the step that fits them best.

        final : each curve chooses its operator width, and systematic shifts are reckoned with.
        """
        sampled = self._sampled(spacing_px)
        if sampled is None:
            return None
        outline, starts = sampled
        sides, edges = self._measure(outline, starts, reach, final)
        gain = np.stack([side.gain for side in sides])
        pairs = pair(edges.offset_px, edges.base, gain, starts, together=final)
        columns = self._columns(np.diff(pairs.parts) > 0)
        # unknowns that are held leave no gap: the solver would find them undetermined
        used = np.unique(columns[columns >= 0])
        dense = np.where(columns < 0, -1, np.searchsorted(used, columns))
        samples, priors = samples_of(
            pairs,
            self._with_row_shift(outline, sides) if final else tuple(side.design for side in sides),
            np.pad(dense, ((0, 0), (0, 1)), constant_values=-1) if final else dense,
            edges.offset_px,
            edges.bias_px,
            np.array([curve.polarity for curve in self.curves]),
            self._shift_basis(outline, sides, gain) if final else None,
            len(used),
        )
        if final:
            samples.columns[samples.columns[:, 0] >= 0, -1] = len(used) + priors
            priors += 1
        solution = solve(samples, len(used) + priors, priors, SETTLED if final else ROUGHLY)
        if solution is None:
            return None
        by_edges = known = solution.covariance[: len(used), : len(used)]
        row, row_shift, row_variance = len(solution.delta) - 1, math.nan, math.nan
        if final:
            row_shift, row_variance = float(solution.delta[row]), float(solution.covariance[row, row])
        if final and (edges.clipped.any() or edges.soft.any()):
            by_cause = propagate(samples, solution, pairs.rows_of(*self._poor_light(edges, sides, starts)))
            by_edges = by_edges + by_cause[: len(used)] @ by_cause[: len(used)].T
            row_variance += float(by_cause[row] @ by_cause[row])
            known = by_edges
        if final and self.rig.covariance is not None:
            space = self.face.to_rig(outline.points)
            causes = pairs.rows_of(*shifts_by_calibration(self.rig, space, *(side.normals for side in sides)))
            by_cause = propagate(samples, solution, causes)
            row_variance += float(by_cause[row] @ self.rig.covariance @ by_cause[row])
            by_cause = by_cause[: len(used)]
            known = known + by_cause @ self.rig.covariance @ by_cause.T
        delta, covariances = np.zeros(self.unknowns), np.zeros((2, self.unknowns, self.unknowns))
        delta[used] = solution.delta[: len(used)]
        for whole, part in zip(covariances, (known, by_edges), strict=True):
            whole[np.ix_(used, used)] = part
        return _Step(
            delta,
            covariances[0],
            covariances[1],
            self._motion(sides, delta, starts),
            ROW_SIGMA_PX * row_shift,
            ROW_SIGMA_PX * math.sqrt(row_variance),
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
        self, outline: Outline, starts: npt.NDArray[np.int64], reach: float, final: bool
    ) -> tuple[tuple[ProjectedOutline, ProjectedOutline], _Edges]:
        """The present curves in both images, and the edges across them."""
        counts = np.diff(starts)
        signs = np.repeat([curve.polarity for curve in self.curves], counts)
        widths, fine = (WIDTHS_PX, FINE_STEP_PX) if final else (START_WIDTHS_PX, 1.0)
        nothing = np.zeros((starts[-1], 0))

        def side(
            number: int,
        ) -> tuple[ProjectedOutline, FloatArray, FloatArray, FloatArray, tuple[Flags, Flags]]:
            seen = project_outline(self.rig, SIDES[number], self.face, outline)
            image = self.images[number]
            edges = edges_at_widths(image, seen.pixels, seen.normals, reach, signs, widths, fine)
            waves = self._waves(seen, starts) if final else nothing
            chosen = choose_widths(edges, starts, waves, self.params.min_slope)
            offsets = chosen.offset_px
            if final:
                # blur averages over a disc: where the edge is bent, the extremum of the slope lies nearer to
                # the centre of the bend by blur² x curvature / 2
                blur2_px2 = np.repeat(chosen.blur2_px2, counts)
                offsets = offsets + 0.5 * blur2_px2 * self._curvature(seen, starts)
            soft = np.repeat(chosen.blur2_px2 >= SOFT_PX**2, counts)
            return seen, offsets, chosen.base, chosen.bias_px, (edges.clipped, soft)

        # side by side only what takes long enough: handing it over costs as much as a coarse step
        both = for_both(side) if final else (side(0), side(1))
        (left, *of_left, poor_left), (right, *of_right, poor_right) = both
        offsets, base, bias = (np.stack(pair) for pair in zip(of_left, of_right, strict=True))
        few = np.add.reduceat(base > 0, starts[:-1], axis=1).min(axis=0) < MIN_SAMPLES
        base = np.where(np.repeat(few, counts), 0.0, base)
        return (left, right), _Edges(
            offsets, base, bias, *(np.stack(one) for one in zip(poor_left, poor_right, strict=True))
        )

    def _poor_light(
        self,
        edges: _Edges,
        sides: tuple[ProjectedOutline, ProjectedOutline],
        starts: npt.NDArray[np.int64],
    ) -> tuple[FloatArray, FloatArray]:
        """(N, 4) for each camera: by how much saturation and blur move the edges, one sigma, px.

        A saturated sensor moves all of them towards the dark, in both cameras much alike: they see one light.
        A blurred edge is one with what lies beside it, a chamfer, a wall, a shadow: to one side of the part,
        in each camera by itself. Along the rows that is a depth.
        """
        towards = -np.repeat([float(curve.polarity) for curve in self.curves], np.diff(starts))
        left, right = CLIPPED_PX * towards * edges.clipped
        none = np.zeros(len(towards))
        soft_left, soft_right = (
            SOFT_SHIFT_PX * seen.normals[:, 0] * soft for seen, soft in zip(sides, edges.soft, strict=True)
        )
        return (
            np.column_stack([left, CLIPPED_APART * left, soft_left, none]),
            np.column_stack([right, -CLIPPED_APART * right, none, soft_right]),
        )

    def _with_row_shift(
        self, outline: Outline, sides: tuple[ProjectedOutline, ProjectedOutline]
    ) -> tuple[FloatArray, FloatArray]:
        """The designs of both images with a column for a shift of one against the other across the rows.

        No place in space explains such a shift: it is what a knocked camera, or a calibration that is a
        little wrong, does to all curves alike. Without it every curve would seem displaced by itself. Half of
        it is each camera's: nobody knows which one has moved.
        """
        rig, space = self.rig, self.face.to_rig(outline.points)
        right_centre = -rig.right_from_left[:3, :3].T @ rig.right_from_left[:3, 3]
        # a row is what one camera shows of a ray of the other
        on_left = rig.left.project(space + RAY_STEP * (space - right_centre))
        on_right = rig.right.project(apply(rig.right_from_left, space * (1 + RAY_STEP)))
        columns = []
        # both rays run away from each other: what is down in one image is up in the other
        for seen, beyond in zip(sides, (on_left, on_right), strict=True):
            along = beyond - seen.pixels
            with np.errstate(invalid="ignore", divide="ignore"):
                across = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
            columns.append(0.5 * ROW_SIGMA_PX * np.sum(seen.normals * across, axis=1))
        left, right = (
            np.column_stack([seen.design, column]) for seen, column in zip(sides, columns, strict=True)
        )
        return left, right

    def _shift_basis(
        self, outline: Outline, sides: tuple[ProjectedOutline, ProjectedOutline], gain: FloatArray
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
        starts: npt.NDArray[np.int64],
    ) -> FloatArray:
        """(K,) farthest that a step of the unknowns moves each curve, px."""
        by_curve = np.append(delta, 0.0)[self._columns(np.ones(len(self.curves), bool))]
        by_sample = by_curve.repeat(np.diff(starts), axis=0)
        moved = np.abs([np.sum(side.design * by_sample, axis=1) for side in sides]).max(axis=0)
        return np.asarray(np.maximum.reduceat(moved, starts[:-1]))

    def _waves(self, seen: ProjectedOutline, starts: npt.NDArray[np.int64]) -> FloatArray:
        """(N, 5): what tells a systematic shift from scatter; an edge, of one direction, has half waves."""
        waves = fourier_basis(seen.normals)
        for k, curve in enumerate(self.curves):
            if not curve.closed:
                waves[starts[k] : starts[k + 1]] = _half_waves(int(starts[k + 1] - starts[k]))
        return waves

    def _curvature(self, seen: ProjectedOutline, starts: npt.NDArray[np.int64]) -> FloatArray:
        """(N,) of the projected curves, 1 / px."""
        closed = np.repeat([curve.closed for curve in self.curves], np.diff(starts))
        return np.where(closed, curvatures(seen.pixels, seen.normals, starts), 0.0)

    def moved(self, step: _Step) -> _State | None:
        """The state after a step; None when it has run away."""
        plane = step.delta[:PLANE_PARAMETERS]
        if not np.isfinite(step.delta).all() or np.abs(plane[1:]).max() > MAX_SLOPE:
            return None
        if abs(plane[0]) > MAX_RISE * abs(self.face.origin[2]):
            return None
        curves, first = [], PLANE_PARAMETERS
        for curve in self.curves:
            own = step.delta[first : first + curve.free]
            first += curve.free
            away = curve.kind == "circle" and np.abs(own).max() >= RUNAWAY * curve.parameters[2]
            fresh = None if away else curve.moved(own)
            if fresh is None and len(self.curves) == 1:
                return None
            curves.append(curve if fresh is None else fresh)
        return replace(self, face=self.face.moved(plane), curves=tuple(curves))

    def result(self, step: _Step) -> PlaneFit | None:
        """What was measured; None for nothing."""
        kept = step.supported(self.params.min_support)
        if not kept:
            return None
        fits, support = [], step.support()
        for k in kept:
            rows = slice(*step.starts[k : k + 2])
            weights = step.weights[:, rows]
            with np.errstate(invalid="ignore"):
                means = np.nansum(step.offsets[:, rows] * weights, axis=1) / weights.sum(axis=1)
            fits.append(
                CurveFit(
                    self.curves[k],
                    support[:, k],
                    float(np.sqrt(np.sum(weights * step.residuals[:, rows] ** 2) / weights.sum())),
                    float(means[0] - means[1]),
                    step.points[:, rows],
                    weights,
                )
            )
        first = np.cumsum([PLANE_PARAMETERS, *(curve.free for curve in self.curves)])
        unknowns = np.concatenate(
            [np.arange(PLANE_PARAMETERS), *(np.arange(*first[k : k + 2]) for k in kept)]
        )
        lift = _block_diagonal([np.eye(PLANE_PARAMETERS), *(self.curves[k].lift() for k in kept)])
        whole, by_edges = (
            np.asarray(lift @ inner[np.ix_(unknowns, unknowns)] @ lift.T)
            for inner in (step.covariance, step.edge_covariance)
        )
        return PlaneFit(self.face, tuple(fits), whole, by_edges, step.row_shift_px, step.row_sigma_px)


def derived(fit: PlaneFit, function: Callable[[FloatArray], FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Values (M,) of a function of `fit.parameters` and their covariance (M, M), to first order."""
    parameters = fit.parameters
    step = 1e-5  # mm and rad; curves are smooth over far more
    jacobian = np.stack(
        [
            (function(parameters + step * unit) - function(parameters - step * unit)) / (2 * step)
            for unit in np.eye(len(parameters))
        ],
        axis=-1,
    )
    return function(parameters), np.asarray(jacobian @ fit.covariance @ jacobian.T)


def _half_waves(count: int) -> FloatArray:
    """(N, 5): half waves along a curve, each with a mean square of 1."""
    way = (np.arange(count) + 0.5) / count
    return np.column_stack(
        [np.ones(count), *(math.sqrt(2.0) * np.cos(m * np.pi * way) for m in range(1, WAVES))]
    )


def _block_diagonal(blocks: list[FloatArray]) -> FloatArray:
    result = np.zeros((sum(b.shape[0] for b in blocks), sum(b.shape[1] for b in blocks)))
    row = column = 0
    for block in blocks:
        result[row : row + block.shape[0], column : column + block.shape[1]] = block
        row, column = row + block.shape[0], column + block.shape[1]
    return result
