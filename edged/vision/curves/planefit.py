"""Curves of one face, fitted together to the raw edges of both cameras.

The unknowns are the plane and each curve's own parameters in it; the residuals are the offsets of edges
measured across the projected curves (see `circlefit`, which does the same for circles alone, from worse
starts). One solution for all of them gives what distances and angles between features need: their joint
covariance, in which the errors that they share, of the plane, of the light and of the calibration, cancel as
they do in the result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from edged.domain import SIDES, FloatArray, Image
from edged.vision.curves.adjustment import ROUGHLY, SETTLED, Samples, Solution, propagate, solve
from edged.vision.curves.circleprojection import bends
from edged.vision.curves.commonmode import Pairs, pair, samples_of
from edged.vision.curves.operatorwidth import START_WIDTH, choose_widths
from edged.vision.curves.outlines import PLANE_PARAMETERS, Curve, Face, Outline, Seen, see
from edged.vision.curves.systematic import displacements, slow_waves
from edged.vision.edges.subpixel import FINE_STEP_PX, WIDTHS_PX, edges_at_widths
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.projection import shifts_by_calibration
from edged.vision.kernels.robust import MIN_SAMPLES

AGREE_PX = 0.5
"""An edge that scatters more is another one, whatever the others do."""
MARGIN_PX = 5.0
"""Of an edge at both ends: the corner's blur, seen through the widest operator."""
MIN_SPOKES, MAX_SPOKES = 24, 2000
MIN_SIZE_PX = 3.0
STILL_PX = 0.2  # edges measured anew at curves that moved by less come out the same, to 0.003 px
WAVES = 5
START_WIDTHS_PX = WIDTHS_PX[START_WIDTH : START_WIDTH + 1]


@dataclass(frozen=True, slots=True)
class PlaneFitParams:
    """How curves are measured.

    reach_px : search range along the normals, one iteration each; the last one is repeated until the curves
    stand still, `repeats` times at most. spacing_px : of the samples. min_slope : grey values per px below
    which there is no edge. min_support : share of its samples that a curve must show in each image.
    """

    reach_px: tuple[float, ...] = (3.0, 2.0)
    spacing_px: float = 1.0
    min_slope: float = 1.5
    min_support: float = 0.4
    repeats: int = 3


@dataclass(frozen=True, slots=True, eq=False)
class CurveFit:
    """A fitted curve and how well it is supported.

    support (2,), left and right : share of the samples with an edge that agrees.  rms_px : of those.
    mismatch_px : mean offset in the left image minus that in the right one.
    points (2, N, 2) raw px, NaN where there is no edge; weights (2, N) in [0, 1].
    """

    curve: Curve
    support: FloatArray
    rms_px: float
    mismatch_px: float
    points: FloatArray
    weights: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """A face and its curves.

    fits : in the order asked for, without those that the images do not show.
    covariance (P, P) : of the plane (height, slopes along u and v, see `Face.moved`), then of the parameters
    of each fit's curve, mm and rad, correlations included.
    """

    face: Face
    fits: tuple[CurveFit, ...]
    covariance: FloatArray

    @property
    def parameters(self) -> FloatArray:
        """(P,) : 0 for the plane, then each curve's."""
        return np.concatenate([np.zeros(PLANE_PARAMETERS), *(fit.curve.parameters for fit in self.fits)])

    def place(self, name: str) -> slice | None:
        """Where a curve's parameters are in `parameters` and `covariance`."""
        first = PLANE_PARAMETERS
        for fit in self.fits:
            last = first + len(fit.curve.parameters)
            if fit.curve.name == name:
                return slice(first, last)
            first = last
        return None


def fit_plane(
    rig: StereoRig,
    images: tuple[Image, Image],
    face: Face,
    curves: Sequence[Curve],
    params: PlaneFitParams | None = None,
) -> PlaneFit | None:
    """Measure curves of one plane together; None when the images show none, or too few to know the plane.

    images : left and right, raw (H, W) uint8.  face, curves : a start, as good as params.reach_px[0].
    """
    params = params or PlaneFitParams()
    state: _State | None = _State(rig, face, tuple(curves))
    for number, reach in enumerate(params.reach_px):
        if number == 1 and state is not None:
            state = state.with_polarity(images, reach, params)
        step = None if state is None else state.step(images, reach, params, final=False)
        state = None if state is None or step is None else state.moved(step.delta)
    if state is None:
        return None
    state = state.with_polarity(images, params.reach_px[-1], params)
    for _ in range(params.repeats + 1):
        step = state.step(images, params.reach_px[-1], params, final=True)
        kept = [] if step is None else step.supported(params.min_support)
        if step is None or not kept:
            return None
        if len(kept) < len(state.curves):  # what is not there must not pull the others
            state = replace(state, curves=tuple(state.curves[k] for k in kept))
            continue
        moved = state.moved(step.delta)
        if moved is None:
            return None
        state = moved
        if step.moved_px < STILL_PX:
            return state.result(step)
    return None


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """One step of the joint problem.

    moved_px : farthest that a curve moves.  offsets, weights, residuals (2, N), points (2, N, 2).
    """

    delta: FloatArray
    covariance: FloatArray
    moved_px: float
    starts: npt.NDArray[np.int64]
    points: FloatArray
    offsets: FloatArray
    weights: FloatArray
    residuals: FloatArray

    def support(self, k: int) -> FloatArray:
        rows = slice(*self.starts[k : k + 2])
        agree = (self.weights[:, rows] > 0) & (np.abs(self.residuals[:, rows]) < AGREE_PX)
        return np.asarray(agree.mean(axis=1))

    def supported(self, share: float) -> list[int]:
        return [k for k in range(len(self.starts) - 1) if self.support(k).min() >= share]


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """All curves of a state in one image; as `Seen`, with designs in columns of the widest curve."""

    pixels: FloatArray
    normals: FloatArray
    design: FloatArray
    points_mm: FloatArray
    gain: FloatArray
    slant: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """Plane and curves at one moment of the fit."""

    rig: StereoRig
    face: Face
    curves: tuple[Curve, ...]

    def _outlines(self, spacing_px: float) -> list[Outline] | None:
        outlines = []
        for curve in self.curves:
            steps = curve.outline(np.zeros(1)).points + np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.01]])
            with np.errstate(invalid="ignore", divide="ignore"):
                pixels = self.rig.left.project(self.face.to_rig(steps))
            px_per_mm = float(np.linalg.norm(pixels[1:] - pixels[0], axis=1).mean()) / 0.01
            size_px = curve.perimeter_mm * px_per_mm - (0.0 if curve.closed else 2 * MARGIN_PX)
            if not MIN_SIZE_PX < size_px < 1e6:  # False for NaN
                return None
            count = int(np.clip(size_px / spacing_px, MIN_SPOKES, MAX_SPOKES))
            outlines.append(curve.outline((np.arange(count) + 0.5) / count, MARGIN_PX / px_per_mm))
        return outlines

    def _seen(self, outlines: list[Outline]) -> tuple[_Side, _Side]:
        sides = []
        for side in SIDES:
            seen = [see(self.rig, side, self.face, c, o) for c, o in zip(self.curves, outlines, strict=True)]
            width = max(one.design.shape[1] for one in seen)
            sides.append(
                _Side(
                    np.concatenate([one.pixels for one in seen]),
                    np.concatenate([one.normals for one in seen]),
                    np.concatenate([_widened(one, width) for one in seen]),
                    np.concatenate([one.points_mm for one in seen]),
                    np.concatenate([one.gain for one in seen]),
                    np.concatenate([one.slant for one in seen]),
                )
            )
        return sides[0], sides[1]

    def _columns(self) -> npt.NDArray[np.int64]:
        """(K, C): which unknown each column of the design is, -1 where a curve has none."""
        columns = np.full((len(self.curves), PLANE_PARAMETERS + max(c.free for c in self.curves)), -1)
        columns[:, :PLANE_PARAMETERS] = np.arange(PLANE_PARAMETERS)
        first = PLANE_PARAMETERS
        for k, curve in enumerate(self.curves):
            columns[k, PLANE_PARAMETERS : PLANE_PARAMETERS + curve.free] = first + np.arange(curve.free)
            first += curve.free
        return columns

    @property
    def unknowns(self) -> int:
        return PLANE_PARAMETERS + sum(curve.free for curve in self.curves)

    def with_polarity(self, images: tuple[Image, Image], reach: float, params: PlaneFitParams) -> _State:
        """Give curves of unknown polarity the sign of most of their contrast."""
        outlines = None if all(c.polarity for c in self.curves) else self._outlines(params.spacing_px)
        if outlines is None:
            return self
        starts = np.cumsum([0, *(len(outline.points) for outline in outlines)])
        total = np.zeros(len(self.curves))
        for image, seen in zip(images, self._seen(outlines), strict=True):
            slope = edges_at_widths(image, seen.pixels, seen.normals, reach, 0, START_WIDTHS_PX).slope[0]
            strong = np.abs(np.nan_to_num(slope)) >= params.min_slope
            total += np.add.reduceat(np.where(strong, slope, 0.0), starts[:-1])
        signs = np.where(total < 0, -1, 1)
        return replace(
            self,
            curves=tuple(
                replace(curve, polarity=curve.polarity or int(sign))
                for curve, sign in zip(self.curves, signs, strict=True)
            ),
        )

    def step(
        self, images: tuple[Image, Image], reach: float, params: PlaneFitParams, *, final: bool
    ) -> _Step | None:
        """Measure the edges at the present curves, and solve for the step that fits them best."""
        outlines = self._outlines(params.spacing_px)
        if outlines is None:
            return None
        starts = np.cumsum([0, *(len(outline.points) for outline in outlines)])
        sides = self._seen(outlines)
        offsets, base, bias = self._measure(images, sides, starts, reach, params, final)
        gain = np.stack([seen.gain for seen in sides])
        pairs = pair(offsets, base, gain, starts, together=final)
        slant = np.stack([seen.slant for seen in sides])
        samples, priors = samples_of(
            pairs,
            tuple(seen.design for seen in sides),
            self._columns(),
            offsets,
            bias,
            np.array([curve.polarity for curve in self.curves]),
            displacements(sides[0].normals, gain, slant) if final else None,
            self.unknowns,
        )
        solution = solve(samples, self.unknowns + priors, priors, SETTLED if final else ROUGHLY)
        if solution is None:
            return None
        delta = solution.delta[: self.unknowns]
        return _Step(
            delta,
            self._covariance(samples, solution, pairs, sides) if final else solution.covariance,
            float(np.abs(samples.motion(delta)).max()),
            starts,
            np.stack(
                [s.pixels + s.normals * offset[:, None] for s, offset in zip(sides, offsets, strict=True)]
            ),
            offsets,
            pairs.weights_by_camera(solution.weights),
            pairs.by_camera(solution.residuals),
        )

    def _measure(
        self,
        images: tuple[Image, Image],
        sides: tuple[_Side, _Side],
        starts: npt.NDArray[np.int64],
        reach: float,
        params: PlaneFitParams,
        final: bool,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Offsets (2, N), prior weights (2, N), and one sigma (2, K) of each slow displacement."""
        counts = np.diff(starts)
        signs = np.repeat([curve.polarity for curve in self.curves], counts)
        offsets, bases, biases = [], [], []
        for image, seen in zip(images, sides, strict=True):
            widths = WIDTHS_PX if final else START_WIDTHS_PX
            fine = FINE_STEP_PX if final else 1.0
            edges = edges_at_widths(image, seen.pixels, seen.normals, reach, signs, widths, fine)
            chosen = choose_widths(edges, starts, self._slow_changes(seen, starts), params.min_slope)
            if final:
                bend = np.repeat(chosen.blur2_px2, counts) * self._curvature(seen, starts)
                chosen.offset_px[:] += 0.5 * bend
            offsets.append(chosen.offset_px)
            bases.append(chosen.base)
            biases.append(chosen.bias_px)
        base = np.stack(bases)
        few = np.add.reduceat(base > 0, starts[:-1], axis=1) < MIN_SAMPLES
        base[np.repeat(few, counts, axis=1)] = 0.0
        return np.stack(offsets), base, np.stack(biases)

    def _slow_changes(self, seen: _Side, starts: npt.NDArray[np.int64]) -> FloatArray:
        """(N, 5): what tells a slow displacement from scatter; an edge, of one direction, has half waves."""
        waves = slow_waves(seen.normals)
        for k, curve in enumerate(self.curves):
            if not curve.closed:
                waves[starts[k] : starts[k + 1]] = _half_waves(int(starts[k + 1] - starts[k]))
        return waves

    def _curvature(self, seen: _Side, starts: npt.NDArray[np.int64]) -> FloatArray:
        """(N,) of the projected curves, 1 / px: blur draws an edge to the centre of its bend."""
        closed = np.repeat([curve.closed for curve in self.curves], np.diff(starts))
        return np.where(closed, bends(seen.pixels, seen.normals, starts), 0.0)

    def _covariance(
        self, samples: Samples, solution: Solution, pairs: Pairs, sides: tuple[_Side, _Side]
    ) -> FloatArray:
        covariance = solution.covariance[: self.unknowns, : self.unknowns]
        if self.rig.covariance is None:
            return covariance
        left, right = sides
        causes = shifts_by_calibration(self.rig, left.points_mm, left.normals, right.normals)
        gain = propagate(samples, solution, pairs.rows_of(*causes))[: self.unknowns]
        return np.asarray(covariance + gain @ self.rig.covariance @ gain.T)

    def moved(self, delta: FloatArray) -> _State | None:
        """The state after a step; None when it has run away."""
        if not np.isfinite(delta).all() or np.abs(delta[1:3]).max() > 0.5:
            return None
        if abs(delta[0]) > 0.2 * abs(self.face.origin[2]):
            return None
        curves, first = [], PLANE_PARAMETERS
        for curve in self.curves:
            fresh = curve.moved(delta[first : first + curve.free])
            if fresh is None:
                return None
            curves.append(fresh)
            first += curve.free
        return replace(self, face=self.face.moved(delta[:PLANE_PARAMETERS]), curves=tuple(curves))

    def result(self, step: _Step) -> PlaneFit:
        fits = []
        for k, curve in enumerate(self.curves):
            rows = slice(*step.starts[k : k + 2])
            weights = step.weights[:, rows]
            total = max(float(weights.sum()), 1e-9)
            with np.errstate(invalid="ignore"):
                means = np.nansum(step.offsets[:, rows] * weights, axis=1) / weights.sum(axis=1)
            fits.append(
                CurveFit(
                    curve,
                    step.support(k),
                    float(np.sqrt(np.sum(weights * step.residuals[:, rows] ** 2) / total)),
                    float(means[0] - means[1]),
                    step.points[:, rows],
                    weights,
                )
            )
        lifts = [np.eye(PLANE_PARAMETERS), *(curve.lift() for curve in self.curves)]
        lift = _block_diagonal(lifts)
        return PlaneFit(self.face, tuple(fits), np.asarray(lift @ step.covariance @ lift.T))


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


def _widened(seen: Seen, width: int) -> FloatArray:
    return np.pad(seen.design, ((0, 0), (0, width - seen.design.shape[1])))


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
