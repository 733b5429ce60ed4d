"""Circles of one face, fitted in space to the raw edges of both cameras at once.

The paper fits an ellipse in each rectified image and triangulates its centre; but the image of a
circle's centre is not the centre of its ellipse (0.1-0.3 mm at 24° vergence). Here the unknowns
are the circles themselves: one plane, and in it a centre and a radius for each. They are
projected through lens and pose of each camera, edges are measured across the projected curves,
and their offsets along the normals are the residuals of one robust least-squares problem.
Nothing is rectified, no ellipse is formed, no point needs a partner in the other image.

What both cameras say in common and what they say against each other are different witnesses (see
`commonmode`), each with a scatter and a correlation along the edge of its own. Half of the variance of the
slow displacements is each curve's own, half is shared by the curves of one kind: five holes in one light
are not five independent witnesses (see `systematic`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from edged.domain import SIDES, Circle3D, FloatArray, Image
from edged.vision.curves.adjustment import ROUGHLY, SETTLED, propagate, solve
from edged.vision.curves.circle import CircleFit, CircleFitParams, CircleGuess, FaceFit
from edged.vision.curves.circleprojection import ProjectedCircle, bends, circle_axes, project_circles
from edged.vision.curves.commonmode import pair, samples_of
from edged.vision.curves.operatorwidth import START_WIDTH, ChosenEdges, choose_widths
from edged.vision.curves.systematic import displacements, slants, slow_waves
from edged.vision.edges.subpixel import FINE_STEP_PX, WIDTHS_PX, edges_at_widths
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.projection import shifts_by_calibration
from edged.vision.geometry.rigid import cross, unit
from edged.vision.kernels.parallel import for_both
from edged.vision.kernels.robust import MIN_SAMPLES

AGREE_PX = 0.5
"""An edge that scatters more is another one, whatever the others do."""
MIN_RADIUS_PX, MAX_RADIUS_PX = 3.0, 1e5
MIN_SPOKES, MAX_SPOKES = 48, 2000
COARSE_SPACING_PX = 3.0  # while the circles still move
STILL_PX = 0.2  # edges measured anew at curves that moved by less come out the same, to 0.003 px
DEFAULT_PARAMS = CircleFitParams()
START_WIDTHS_PX = WIDTHS_PX[START_WIDTH : START_WIDTH + 1]
_FIRST = 6  # unknowns of the first circle: centre (3), tilt about u, tilt about v, radius
_CENTRE_AND_RADIUS = np.ix_([0, 1, 2, 5], [0, 1, 2, 5])


def fit_circle(
    rig: StereoRig,
    left: Image,
    right: Image,
    guess: CircleGuess,
    normal: FloatArray,
    params: CircleFitParams = DEFAULT_PARAMS,
    *,
    fixed_normal: bool = False,
    fixed_radius: bool = False,
) -> CircleFit | None:
    """Measure one circle near a first guess; None when the images do not show one.

    left, right : raw images (H, W) uint8.
    fixed_normal : the plane's direction is known better from elsewhere (a small hole in a large face).
    fixed_radius : the guess's radius is kept; rivals beside the rim then do not fit.
    """
    face = fit_face(
        rig, left, right, [guess], normal, params, fixed_normal=fixed_normal, fixed_radius=fixed_radius
    )
    return None if face is None else face.first


def fit_face(
    rig: StereoRig,
    left: Image,
    right: Image,
    guesses: Sequence[CircleGuess],
    normal: FloatArray,
    params: CircleFitParams = DEFAULT_PARAMS,
    *,
    fixed_normal: bool = False,
    fixed_radius: bool = False,
) -> FaceFit | None:
    """Measure circles of one plane together; None when the images do not show them.

    The guesses' centres may lie off the plane through the first one: that distance is kept. A circle but the
    first of which too few edges are seen has no fit.
    """
    face = _Face.start(rig, guesses, normal, fixed_normal, fixed_radius)
    if face is None:
        return None
    images = (left, right)
    face = face.sampled(max(params.spacing_px, COARSE_SPACING_PX))
    step: _Step | None = None
    for number, reach in enumerate(params.reach_px[:-1] if params.repeats else params.reach_px):
        if number == 1:  # far away there is one dominant edge; from here on each circle keeps its sign
            face = face.with_polarity(images, reach, params)
        step = face.step(images, reach, params, final=False)
        moved = None if step is None else face.moved(step.delta)
        if step is None or moved is None:
            return None
        face = moved
        if number > 0 and step.moved_px < STILL_PX:
            break
    if params.repeats:
        face = face.with_polarity(images, params.reach_px[-1], params).sampled(params.spacing_px)
    for _ in range(params.repeats):
        step = face.step(images, params.reach_px[-1], params, final=True)
        moved = None if step is None else face.moved(step.delta)
        if step is None or moved is None:
            return None
        face = moved
        if step.moved_px < STILL_PX:
            break
    return None if step is None else face.result(step)


@dataclass(frozen=True, slots=True, eq=False)
class _Edges:
    """What the circles show in both images.

    offset_px (2, N), NaN where is no edge; base (2, N) prior weights, 0 for circles of which one image shows
    too little; bias_px (2, K) the sigma to expect of slow displacements.
    """

    offset_px: FloatArray
    base: FloatArray
    bias_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """One step of the joint problem, and the samples it stands on.

    moved_px : farthest that a curve moves.  points (2, N, 2) px; weights, residuals (2, N): left and right.
    """

    delta: FloatArray
    covariance: FloatArray
    moved_px: float
    points: FloatArray
    weights: FloatArray
    residuals: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Face:
    """State of the joint problem, and where along the curves it is sampled.

    origin (3,) : centre of the first circle; frame (3, 3) : rows u, v, normal of the plane; places (K, 3) :
    centres along those, from the origin.  radii (K,).
    index, phase (N,) : circle and angle of each sample; starts (K + 1,): where each circle's begin.
    polarity (K,).  fixed_normal, fixed_radius : what is not to be changed.
    """

    rig: StereoRig
    names: tuple[str, ...]
    origin: FloatArray
    frame: FloatArray
    places: FloatArray
    radii: FloatArray
    polarity: npt.NDArray[np.int64]
    index: npt.NDArray[np.int64]
    phase: FloatArray
    starts: npt.NDArray[np.int64]
    fixed_normal: bool
    fixed_radius: bool

    @staticmethod
    def start(
        rig: StereoRig,
        guesses: Sequence[CircleGuess],
        normal: FloatArray,
        fixed_normal: bool,
        fixed_radius: bool,
    ) -> _Face | None:
        """The guessed state, not yet sampled; None where the left camera cannot see such circles."""
        frame = np.vstack([circle_axes(normal), normal])
        centres = np.array([guess.centre_mm for guess in guesses], dtype=np.float64)
        nothing = np.zeros(0, np.int64)
        face = _Face(
            rig,
            tuple(guess.name for guess in guesses),
            centres[0],
            frame,
            (centres - centres[0]) @ frame.T,
            np.array([guess.radius_mm for guess in guesses], dtype=np.float64),
            np.array([guess.polarity for guess in guesses], dtype=np.int64),
            nothing,
            np.zeros(0),
            nothing,
            fixed_normal,
            fixed_radius,
        )
        sizes = face.sizes_px()
        usable = (sizes >= MIN_RADIUS_PX) & (sizes <= MAX_RADIUS_PX) & (centres[:, 2] > 0)  # False for NaN
        return face if usable.all() else None

    def sizes_px(self) -> FloatArray:
        """(K,) radii in the left image, along u."""
        centres = self.centres
        with np.errstate(invalid="ignore", divide="ignore"):
            rims = self.rig.left.project(centres + self.radii[:, None] * self.frame[0])
            return np.asarray(np.linalg.norm(rims - self.rig.left.project(centres), axis=1))

    def sampled(self, spacing_px: float) -> _Face:
        """The same state, sampled at this spacing along the edges."""
        counts = np.clip(2 * np.pi * self.sizes_px() / spacing_px, MIN_SPOKES, MAX_SPOKES).astype(np.int64)
        return replace(
            self,
            index=np.repeat(np.arange(len(counts)), counts),
            phase=np.concatenate([np.arange(count) * (2 * np.pi / count) for count in counts]),
            starts=np.concatenate([[0], np.cumsum(counts)]),
        )

    @property
    def unknowns(self) -> int:
        return _FIRST + 3 * (len(self.names) - 1)

    @property
    def centres(self) -> FloatArray:
        """(K, 3) in the rig frame."""
        return np.asarray(self.origin + self.places @ self.frame)

    def project(self, side: str) -> ProjectedCircle:
        return project_circles(self.rig, side, self.frame, self.centres, self.radii, self.index, self.phase)

    def lifts(self) -> FloatArray:
        """(K, 6, 8): centre, tilts about u and v and radius of each circle by the unknowns it depends on.

        Those are the origin (3), the tilts about u and v, the circle's place along u and v, its radius.
        """
        u, v, n = self.frame
        x, y, z = self.places.T[..., None]
        lifts = np.zeros((len(self.names), _FIRST, 8))
        lifts[:, :3, :3] = np.eye(3)
        lifts[:, :3, 3], lifts[:, :3, 4] = y * n - z * v, x * n - z * u
        lifts[:, 3, 3] = lifts[:, 4, 4] = lifts[:, 5, 7] = 1.0
        lifts[:, :3, 5], lifts[:, :3, 6] = u, v
        return lifts

    def design(self, curves: tuple[ProjectedCircle, ...]) -> FloatArray:
        """(2, N, 8): derivative of each curve along its normal by the unknowns it depends on."""
        lifts = self.lifts()
        design = np.empty((2, len(self.index), 8))
        for side, curve in enumerate(curves):
            for k, lift in enumerate(lifts):
                rows = slice(*self.starts[k : k + 2])
                np.matmul(curve.jacobian[rows], lift, out=design[side, rows])
        return design

    def columns(self, seen: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
        """(K, 8): which unknown each column of `design` is, -1 for those that are held.

        seen (K,) : of the others nothing is known.
        """
        columns = np.tile(np.array([0, 1, 2, 3, 4, -1, -1, 5]), (len(self.names), 1))
        for k in range(1, len(self.names)):
            columns[k, 5:] = _FIRST + 3 * (k - 1) + np.arange(3)
        if self.fixed_normal:
            columns[:, 3:5] = -1
        if self.fixed_radius:
            columns[:, 7] = -1
        columns[~seen] = -1
        return columns

    def with_polarity(self, images: tuple[Image, Image], reach: float, params: CircleFitParams) -> _Face:
        """Give circles of unknown polarity the sign of most of their contrast."""
        if (self.polarity != 0).all():
            return self
        total = np.zeros(len(self.names))
        for side, image in zip(SIDES, images, strict=True):
            curve = self.project(side)
            slope = edges_at_widths(image, curve.pixels, curve.normals, reach, 0, START_WIDTHS_PX).slope[0]
            strong = np.abs(np.nan_to_num(slope)) >= params.min_slope
            total += np.bincount(self.index, np.where(strong, slope, 0.0), len(total))
        sign = np.where(total < 0, -1, 1)
        return replace(self, polarity=np.where(self.polarity == 0, sign, self.polarity))

    def step(
        self,
        images: tuple[Image, Image],
        reach: float,
        params: CircleFitParams,
        *,
        final: bool,
    ) -> _Step | None:
        """Measure the edges at the present curves and solve for the step that fits them best.

        final : each curve chooses its width, and slow displacements are reckoned with.
        """
        curves, measured = self._measure(images, reach, params, final)
        gain = np.stack([curve.jacobian[:, -1] for curve in curves])
        pairs = pair(measured.offset_px, measured.base, gain, self.starts, together=final)
        seen = np.diff(pairs.parts) > 0
        if not seen[0]:
            return None
        columns = self.columns(seen)
        samples, priors = samples_of(
            pairs,
            self.design(curves),
            columns,
            measured.offset_px,
            measured.bias_px,
            self.polarity,
            self._displacements(curves, gain) if final else None,
            self.unknowns,
        )
        # unknowns that are held leave no gap: the solver would find them undetermined
        used = np.unique(columns[columns >= 0])
        free = len(used)
        dense = replace(
            samples,
            columns=np.where(columns < 0, -1, np.searchsorted(used, columns)),
            shared=np.where(samples.shared < 0, -1, samples.shared - self.unknowns + free),
        )
        solution = solve(dense, free + priors, priors, SETTLED if final else ROUGHLY)
        if solution is None:
            return None
        delta, covariance = np.zeros(self.unknowns), np.zeros((self.unknowns, self.unknowns))
        delta[used] = solution.delta[:free]
        inverse = solution.covariance[:free, :free]
        if final and self.rig.covariance is not None:
            normals = (curve.normals for curve in curves)
            causes = pairs.rows_of(*shifts_by_calibration(self.rig, self._points(), *normals))
            gains = propagate(dense, solution, causes)[:free]
            inverse = inverse + gains @ self.rig.covariance @ gains.T
        covariance[np.ix_(used, used)] = inverse
        found = [
            curve.pixels + curve.normals * offset[:, None]
            for curve, offset in zip(curves, measured.offset_px, strict=True)
        ]
        return _Step(
            delta,
            covariance,
            float(np.abs(samples.motion(delta)).max()),
            np.stack(found),
            pairs.weights_by_camera(solution.weights),
            pairs.by_camera(solution.residuals),
        )

    def _measure(
        self,
        images: tuple[Image, Image],
        reach: float,
        params: CircleFitParams,
        final: bool,
    ) -> tuple[tuple[ProjectedCircle, ...], _Edges]:
        """The present curves in both images, and the edges across them."""
        widths = WIDTHS_PX if final else START_WIDTHS_PX
        signs, nothing = self.polarity[self.index], np.zeros((len(self.index), 0))

        def side(number: int) -> tuple[ProjectedCircle, ChosenEdges]:
            image, curve = images[number], self.project(SIDES[number])
            seen = edges_at_widths(
                image, curve.pixels, curve.normals, reach, signs, widths, FINE_STEP_PX if final else 1.0
            )
            slow = slow_waves(curve.normals) if final else nothing
            chosen = choose_widths(seen, self.starts, slow, params.min_slope)
            if final:
                # blur averages over a disc: where the edge is bent, the extremum of the slope lies nearer to
                # the centre of the bend by blur² x curvature / 2
                blur2 = np.repeat(chosen.blur2_px2, np.diff(self.starts))
                chosen.offset_px[:] += 0.5 * blur2 * bends(curve.pixels, curve.normals, self.starts)
            return curve, chosen

        both = for_both(side)
        curves, sides = tuple(curve for curve, _ in both), [chosen for _, chosen in both]
        base = np.stack([chosen.base for chosen in sides])
        counts = np.add.reduceat(base > 0, self.starts[:-1], axis=1)
        enough = np.all(counts >= MIN_SAMPLES, axis=0)
        return curves, _Edges(
            np.stack([chosen.offset_px for chosen in sides]),
            base * np.repeat(enough, np.diff(self.starts)),
            np.stack([chosen.bias_px for chosen in sides]),
        )

    def _displacements(
        self, curves: tuple[ProjectedCircle, ...], gain: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(N, A) each: the shapes of slow displacements in both images."""
        points, radial = self._points(), self._radial()
        poses = (np.eye(4), self.rig.right_from_left)
        slant = np.stack([slants(points, radial, self.frame[2], pose) for pose in poses])
        return displacements(curves[0].normals, gain, slant)

    def _radial(self) -> FloatArray:
        """(N, 3): direction of each sample from its circle's centre."""
        u, v, _ = self.frame
        return np.asarray(np.cos(self.phase)[:, None] * u + np.sin(self.phase)[:, None] * v)

    def _points(self) -> FloatArray:
        """(N, 3): the samples in space."""
        return np.asarray(self.centres[self.index] + self.radii[self.index, None] * self._radial())

    def moved(self, delta: FloatArray) -> _Face | None:
        """The state after a step; None when it has run away."""
        if not np.isfinite(delta).all() or np.abs(delta[:3]).max() > 0.2 * self.origin[2]:
            return None
        # the axes tilted, and the new ones: those differ by a turn about the normal
        u, v, n = self.frame
        tilted = np.stack([unit(u + delta[4] * n), unit(v + delta[3] * n)])
        turned = unit(cross(tilted[0], tilted[1]))
        fresh = circle_axes(turned)
        places, radii = self.places.copy(), self.radii.copy()
        radii[0] += delta[5]
        further = delta[_FIRST:].reshape(-1, 3)
        # a small circle that runs away must not take the others with it
        further = np.where(np.abs(further).max(axis=1, keepdims=True) < 0.5 * radii[1:, None], further, 0.0)
        places[1:, :2] += further[:, :2]
        radii[1:] += further[:, 2]
        origin = self.origin + delta[:3]
        if (radii <= 0).any() or origin[2] <= 0:
            return None
        places[:, :2] = places[:, :2] @ tilted @ fresh.T  # the centres stay in space
        return replace(self, origin=origin, frame=np.vstack([fresh, turned]), places=places, radii=radii)

    def result(self, step: _Step) -> FaceFit | None:
        columns, lifts = self.columns(np.ones(len(self.names), bool)), self.lifts()
        fits = []
        for k, (own, lift) in enumerate(zip(columns, lifts, strict=True)):
            known = own >= 0
            inner = step.covariance[np.ix_(own[known], own[known])]
            fits.append(self._circle(k, step, lift[:, known] @ inner @ lift[:, known].T))
        return None if fits[0] is None else FaceFit(fits[0], tuple(fits[1:]), step.covariance)

    def _circle(self, k: int, step: _Step, covariance: FloatArray) -> CircleFit | None:
        rows = slice(*self.starts[k : k + 2])
        weights, residuals = step.weights[:, rows], step.residuals[:, rows]
        total = float(weights.sum())
        if total < MIN_SAMPLES:
            return None
        support = np.mean((weights > 0) & (np.abs(residuals) < AGREE_PX), axis=1)
        normal = self.frame[2]
        circle = Circle3D(
            self.names[k],
            self.centres[k],
            normal if normal[2] < 0 else -normal,
            float(self.radii[k]),
            covariance[_CENTRE_AND_RADIUS],
        )
        return CircleFit(
            circle,
            covariance,
            self.frame[:2],
            float(support[0]),
            float(support[1]),
            math.sqrt(float(np.sum(weights * residuals**2)) / total),
            step.points[0, rows],
            step.points[1, rows],
            weights[0],
            weights[1],
            int(self.polarity[k]),
        )
