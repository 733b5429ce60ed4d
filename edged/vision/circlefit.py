"""Circles of one face, fitted in space to the raw edges of both cameras at once.

The paper fits an ellipse in each rectified image and triangulates its centre; but the image of a
circle's centre is not the centre of its ellipse (0.1-0.3 mm at 24° vergence). Here the unknowns
are the circles themselves: one plane, and in it a centre and a radius for each. They are
projected through lens and pose of each camera, edges are measured across the projected curves,
and their offsets along the normals are the residuals of one robust least-squares problem.
Nothing is rectified, no ellipse is formed, no point needs a partner in the other image.

Each curve in each image is a group with a scatter, a correlation along the edge and an operator
width of its own: machining marks displace an edge over many px, alike in both images, and a curve
that scatters more must count less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from edged.domain import Circle3D, FloatArray, Image
from edged.vision.camera import StereoRig
from edged.vision.edges import WIDTHS_PX, EdgeSamples, edges_at_widths
from edged.vision.projection import project_with_jacobians

TUKEY = 4.685
"""Tukey's constant for 95 % efficiency with normal errors; the usual 3 costs 5-9 %."""
MIN_SIGMA_PX = 0.02
"""No edge is better than this in an 8-bit image: floor of the robust scale and of every sigma."""
CLIPPED_WEIGHT = 0.02
"""A saturated plateau hides half of its step and moves the edge by 0.1-0.2 px, where a good edge is known
to 0.02: such points only help where there are no others."""
SIDES = ("left", "right")
BIAS_SHARE = 1.3
"""Texture beside an edge, shading and second edges displace it along whole arcs, more at a wide operator
than at a narrow one. Measured on machined parts (outlines, bolt holes, bores, chamfers; displacements of
0.03 to 0.2 px rms): what remains at the chosen width is 1.2-1.4 times the rms difference between the widths
1.2 and 0.6, for each kind of edge."""
MIN_BIAS_PX = 0.005
MAX_CONDITION = 1e10
MEDIAN_ROUNDS, SPREAD_ROUNDS, MAX_ROUNDS = 3, (4, 6), 20
START_WIDTH = 2  # index into WIDTHS_PX of the operator that finds the edge; the last step chooses for itself
_MIN_POINTS = 12
_CURVE_COLUMNS = 6  # centre (3), tilt about u, tilt about v, radius


@dataclass(frozen=True, slots=True)
class CircleFitParams:
    """How circles are measured.

    reach_px : search range along the normals, one iteration each; the last one is repeated until
    the circles stand still. spacing_px : of the samples along the edge. min_slope : grey values
    per px below which there is no edge.
    """

    reach_px: tuple[float, ...] = (6.0, 4.0, 2.5, 2.0)
    spacing_px: float = 2.0
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
    """Circles measured together in one plane.

    fits : in the order asked for; their normals are equal.  covariance (P, P) of the joint unknowns:
    centre of the first circle (3), tilt about axes u, v (2), radius of the first; then for each further
    circle its centre along u and v from the first, and its radius.
    """

    fits: tuple[CircleFit, ...]
    covariance: FloatArray


def circle_axes(normal: FloatArray) -> FloatArray:
    """Two unit vectors (2, 3) that span the plane with this normal; the first lies across rig x."""
    helper = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    u = np.cross(normal, helper)
    u /= np.linalg.norm(u)
    return np.stack([u, np.cross(normal, u)])


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedCircle:
    """Samples of circles in one raw image.

    pixels (N, 2), normals (N, 2) unit and outwards, jacobian (N, 6): derivative of the curve along its
    normal by (centre, tilt u, tilt v, radius).
    """

    pixels: FloatArray
    normals: FloatArray
    jacobian: FloatArray


def project_circle(
    rig: StereoRig,
    side: str,
    centre: FloatArray,
    normal: FloatArray,
    radius: float | FloatArray,
    phase: FloatArray,
) -> ProjectedCircle:
    """Project the points at angles `phase` (N,) of a circle of the rig frame into a raw image.

    centre (3,) or (N, 3), radius a number or (N,): one circle, or one for each point, in one plane.
    """
    u, v = circle_axes(normal)
    cosine, sine = np.cos(phase)[:, None], np.sin(phase)[:, None]
    radial = cosine * u + sine * v
    radii = np.broadcast_to(np.asarray(radius, dtype=np.float64), phase.shape)
    points = centre + radii[:, None] * radial
    if side == "left":
        pixels, by_point, _ = project_with_jacobians(rig.left, points)
    else:
        rotation = rig.right_from_left[:3, :3]
        pixels, by_point, _ = project_with_jacobians(
            rig.right, points @ rotation.T + rig.right_from_left[:3, 3]
        )
        by_point = by_point @ rotation
    tangent = np.einsum("nij,nj->ni", by_point, cosine * v - sine * u)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normals = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    outward = np.einsum("nij,nj->ni", by_point, radial)
    normals *= np.where(np.sum(normals * outward, axis=1) < 0, -1.0, 1.0)[:, None]
    along = np.einsum("ni,nij->nj", normals, by_point)
    up = (along @ normal) * radii
    jacobian = np.column_stack([along, up * sine[:, 0], up * cosine[:, 0], np.sum(along * radial, axis=1)])
    return ProjectedCircle(pixels, normals, jacobian)


def fit_circle(
    rig: StereoRig,
    left: Image,
    right: Image,
    guess: CircleGuess,
    normal: FloatArray,
    params: CircleFitParams = CircleFitParams(),
    *,
    fixed_normal: bool = False,
) -> CircleFit | None:
    """Measure one circle near a first guess; None when the images do not show one.

    left, right : raw images (H, W) uint8.
    fixed_normal : the plane's direction is known better from elsewhere (a small hole in a large face).
    """
    face = fit_face(rig, left, right, [guess], normal, params, fixed_normal=fixed_normal)
    return None if face is None else face.fits[0]


def fit_face(
    rig: StereoRig,
    left: Image,
    right: Image,
    guesses: Sequence[CircleGuess],
    normal: FloatArray,
    params: CircleFitParams = CircleFitParams(),
    *,
    fixed_normal: bool = False,
) -> FaceFit | None:
    """Measure circles of one plane together; None when the images do not show them.

    The guesses' centres may lie off the plane through the first one: that distance is kept.
    """
    problem = _Problem.start(rig, guesses, normal, params)
    if problem is None:
        return None
    images = {"left": left, "right": right}
    solved: _Solution | None = None
    free = np.ones(problem.unknowns, dtype=bool)
    free[3:5] = not fixed_normal
    reaches = [*params.reach_px, *[params.reach_px[-1]] * params.repeats]
    for step, reach in enumerate(reaches):
        final = step >= len(params.reach_px)
        if step == 1:  # far away there is one dominant edge; from here on each circle keeps its sign
            problem = problem.with_polarity(images, reach, params)
        solved = problem.solve(images, reach, params, free, choose_width=final)
        if solved is None:
            return None
        moved = problem.moved(solved.delta)
        if moved is None:
            return None
        still = float(np.abs(solved.delta).max()) < 1e-5
        problem = moved
        if final and still:
            break
    return None if solved is None else problem.result(solved)


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """One step of the joint problem: unknowns, and per side the samples it stands on."""

    delta: FloatArray
    covariance: FloatArray
    curves: dict[str, ProjectedCircle]
    offsets: dict[str, FloatArray]
    weights: dict[str, FloatArray]
    residuals: dict[str, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """State of the joint problem, and where along the curves it is sampled.

    origin (3,) centre of the first circle; places (K, 3): centres along u, v and the normal from there.
    index, phase (N,) : circle and angle of each sample.  polarity (K,).
    """

    rig: StereoRig
    names: tuple[str, ...]
    origin: FloatArray
    normal: FloatArray
    places: FloatArray
    radii: FloatArray
    polarity: npt.NDArray[np.int64]
    index: npt.NDArray[np.int64]
    phase: FloatArray

    @staticmethod
    def start(
        rig: StereoRig, guesses: Sequence[CircleGuess], normal: FloatArray, params: CircleFitParams
    ) -> _Problem | None:
        normal = np.array(normal, np.float64)
        u, v = circle_axes(normal)
        centres = np.array([guess.centre_mm for guess in guesses], dtype=np.float64)
        radii = np.array([guess.radius_mm for guess in guesses], dtype=np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            sizes = np.linalg.norm(
                rig.left.project(centres + radii[:, None] * u) - rig.left.project(centres), axis=1
            )
        if (
            not np.isfinite(sizes).all()
            or (sizes < 3).any()
            or (sizes > 1e5).any()
            or (centres[:, 2] <= 0).any()
        ):
            return None
        counts = np.clip(2 * np.pi * sizes / params.spacing_px, 48, 720).astype(np.int64)
        return _Problem(
            rig,
            tuple(guess.name for guess in guesses),
            centres[0],
            normal,
            (centres - centres[0]) @ np.stack([u, v, normal]).T,
            radii,
            np.array([guess.polarity for guess in guesses], dtype=np.int64),
            np.repeat(np.arange(len(guesses)), counts),
            np.concatenate([np.arange(count) * (2 * np.pi / count) for count in counts]),
        )

    @property
    def unknowns(self) -> int:
        return _CURVE_COLUMNS + 3 * (len(self.names) - 1)

    def frame(self) -> FloatArray:
        """Rows u, v, normal."""
        return np.vstack([circle_axes(self.normal), self.normal])

    def project(self, side: str) -> ProjectedCircle:
        centres = self.origin + self.places @ self.frame()
        return project_circle(
            self.rig, side, centres[self.index], self.normal, self.radii[self.index], self.phase
        )

    def design(self, curve: ProjectedCircle) -> FloatArray:
        """(N, P): derivative of each sample's curve along its normal by the joint unknowns."""
        u, v, n = self.frame()
        x, y, z = self.places[self.index].T
        by_centre, (by_u, by_v, by_n) = (
            curve.jacobian[:, :3],
            (curve.jacobian[:, :3] @ axis for axis in (u, v, n)),
        )
        design = np.zeros((len(x), self.unknowns))
        design[:, :3] = by_centre
        design[:, 3] = curve.jacobian[:, 3] + by_n * y - by_v * z
        design[:, 4] = curve.jacobian[:, 4] + by_n * x - by_u * z
        first = self.index == 0
        design[first, 5] = curve.jacobian[first, 5]
        rows = np.nonzero(~first)[0]
        columns = _CURVE_COLUMNS + 3 * (self.index[rows] - 1)
        design[rows, columns], design[rows, columns + 1] = by_u[rows], by_v[rows]
        design[rows, columns + 2] = curve.jacobian[rows, 5]
        return design

    def with_polarity(self, images: dict[str, Image], reach: float, params: CircleFitParams) -> _Problem:
        """Give circles of unknown polarity the sign of most of their contrast."""
        if (self.polarity != 0).all():
            return self
        total = np.zeros(len(self.names))
        for side, image in images.items():
            curve = self.project(side)
            seen = edges_at_widths(
                image, curve.pixels, curve.normals, reach, 0, WIDTHS_PX[START_WIDTH : START_WIDTH + 1]
            )
            slope = np.nan_to_num(seen.slope[0])
            total += np.bincount(
                self.index, np.where(np.abs(slope) >= params.min_slope, slope, 0.0), len(total)
            )
        sign = np.where(total < 0, -1, 1)
        return replace(self, polarity=np.where(self.polarity == 0, sign, self.polarity))

    def solve(
        self,
        images: dict[str, Image],
        reach: float,
        params: CircleFitParams,
        free: npt.NDArray[np.bool_],
        *,
        choose_width: bool,
    ) -> _Solution | None:
        """Measure the edges at the present curves and solve for the step that fits them best."""
        curves = {side: self.project(side) for side in SIDES}
        designs = {side: self.design(curve)[:, free] for side, curve in curves.items()}
        widths = WIDTHS_PX if choose_width else WIDTHS_PX[START_WIDTH : START_WIDTH + 1]
        seen = {
            side: edges_at_widths(
                images[side], curve.pixels, curve.normals, reach, self.polarity[self.index], widths
            )
            for side, curve in curves.items()
        }
        groups: list[_Group] = []
        for side in SIDES:
            for k in range(len(self.names)):
                rows = np.nonzero(self.index == k)[0]
                waves = _slow_waves(curves[side].normals[rows])
                kind = (side, int(self.polarity[k]))
                groups.append(_Group.choose(kind, rows, waves, seen[side], params.min_slope))
        solution = _solve(groups, designs)
        if solution is None:
            return None
        delta, covariance = np.zeros(self.unknowns), np.zeros((self.unknowns, self.unknowns))
        delta[free], covariance[np.ix_(free, free)] = solution
        offsets, weights, residuals = (
            {side: np.full(len(self.index), np.nan) for side in SIDES} for _ in range(3)
        )
        for group in groups:
            side = group.kind[0]
            offsets[side][group.rows] = group.offsets
            weights[side][group.rows] = group.weights
            residuals[side][group.rows] = group.residuals
        return _Solution(delta, covariance, curves, offsets, weights, residuals)

    def moved(self, delta: FloatArray) -> _Problem | None:
        """The state after a step; None when it has run away."""
        if not np.isfinite(delta).all() or np.abs(delta[:3]).max() > 0.2 * self.origin[2]:
            return None
        u, v, n = self.frame()
        turned = np.cross(u + delta[4] * n, v + delta[3] * n)
        turned = turned / np.linalg.norm(turned) * np.sign(turned @ n)
        places, radii = self.places.copy(), self.radii.copy()
        radii[0] += delta[5]
        further = delta[_CURVE_COLUMNS:].reshape(-1, 3)
        places[1:, :2] += further[:, :2]
        radii[1:] += further[:, 2]
        origin = self.origin + delta[:3]
        if (radii <= 0).any() or origin[2] <= 0:
            return None
        # the new axes differ from the tilted old ones by a turn about the normal: keep the centres in space
        fresh = circle_axes(turned)
        tilted = np.stack([u + delta[4] * n, v + delta[3] * n])
        tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
        places[:, :2] = places[:, :2] @ tilted @ fresh.T
        return replace(self, origin=origin, normal=turned, places=places, radii=radii)

    def result(self, solved: _Solution) -> FaceFit | None:
        fits = []
        for k in range(len(self.names)):
            fit = self._circle(k, solved)
            if fit is None:
                return None
            fits.append(fit)
        return FaceFit(tuple(fits), solved.covariance)

    def _circle(self, k: int, solved: _Solution) -> CircleFit | None:
        rows = self.index == k
        weights = {side: np.nan_to_num(solved.weights[side][rows]) for side in SIDES}
        total = sum(float(w.sum()) for w in weights.values())
        if total < _MIN_POINTS:
            return None
        squares = sum(
            float(np.sum(weights[side] * np.nan_to_num(solved.residuals[side][rows]) ** 2)) for side in SIDES
        )
        u, v, n = self.frame()
        x, y, z = self.places[k]
        to_curve = np.zeros((_CURVE_COLUMNS, self.unknowns))  # the circle's own six by the joint unknowns
        to_curve[:3, :3] = np.eye(3)
        to_curve[:3, 3], to_curve[:3, 4] = y * n - z * v, x * n - z * u
        to_curve[3, 3] = to_curve[4, 4] = 1.0
        if k == 0:
            to_curve[5, 5] = 1.0
        else:
            column = _CURVE_COLUMNS + 3 * (k - 1)
            to_curve[:3, column], to_curve[:3, column + 1], to_curve[5, column + 2] = u, v, 1.0
        covariance = to_curve @ solved.covariance @ to_curve.T
        facing = -1.0 if n[2] > 0 else 1.0
        centre = self.origin + self.places[k] @ self.frame()
        circle = Circle3D(
            self.names[k],
            centre,
            n * facing,
            float(self.radii[k]),
            covariance[np.ix_([0, 1, 2, 5], [0, 1, 2, 5])],
        )
        points = {
            side: (curve.pixels + curve.normals * solved.offsets[side][:, None])[rows]
            for side, curve in solved.curves.items()
        }
        return CircleFit(
            circle,
            covariance,
            np.stack([u, v]),
            float((weights["left"] > 0).mean()),
            float((weights["right"] > 0).mean()),
            float(np.sqrt(squares / total)),
            points["left"],
            points["right"],
            weights["left"],
            weights["right"],
            int(self.polarity[k]),
        )


class _Group:
    """The samples of one curve in one image while the joint problem is solved.

    kind : side and polarity.  rows : their places among the samples.  waves (N, 5) : see `_slow_waves`.
    offsets (N,) px, NaN where there is no edge; base (N,) prior weights.  bias_px : how far edges may be
    displaced along whole arcs, one sigma of each of the slow waves.  weights, residuals (N,), scale and
    spread : as the robust solution leaves them.
    """

    def __init__(
        self,
        kind: tuple[str, int],
        rows: npt.NDArray[np.int64],
        waves: FloatArray,
        offsets: FloatArray,
        base: FloatArray,
    ) -> None:
        self.kind = kind
        self.rows = rows
        self.waves = waves
        self.bias_px = 0.0
        self.offsets = offsets
        self.base = base
        self.values = np.nan_to_num(offsets)
        self.weights = base
        self.residuals = self.values
        self.scale = 1.0
        self.spread = 1.0

    @staticmethod
    def choose(
        kind: tuple[str, int],
        rows: npt.NDArray[np.int64],
        waves: FloatArray,
        seen: EdgeSamples,
        min_slope: float,
    ) -> _Group:
        """Of the widths that were measured, the one whose edges place the curve best.

        Best is the smallest variance plus squared bias. A second edge close by (a chamfer, the wall of a
        disc) pulls a wide operator more than a narrow one, and along a whole arc: what a width says
        otherwise than the narrowest one, slowly changing around the circle, is its bias.
        """
        candidates: list[_Group] = []
        for offsets, slopes in zip(seen.offset_px[:, rows], seen.slope[:, rows], strict=True):
            known = np.isfinite(offsets) & (np.abs(np.nan_to_num(slopes)) >= min_slope)
            base = np.where(known, np.where(seen.clipped[rows], CLIPPED_WEIGHT, 1.0), 0.0)
            candidates.append(_Group(kind, rows, waves, np.where(known, offsets, np.nan), base))
        if len(candidates) == 1:
            return candidates[0]
        narrow = candidates[0]
        merits, squares = [], []
        for candidate in candidates:
            variance = _variance_of_mean(candidate.values, candidate.base, waves)[0]
            both = np.minimum(candidate.base, narrow.base)
            doubt, slow = _variance_of_mean(candidate.values - narrow.values, both, waves)
            squares.append(max(slow - 5 * doubt, 0.0) if np.isfinite(doubt) else 0.0)
            merits.append(variance + squares[-1])
        chosen = candidates[int(np.argmin(merits))]
        waves_in_square = 3.0  # the mean square of waves of equal amplitude: 1 + 4 / 2
        chosen.bias_px = max(BIAS_SHARE * np.sqrt(squares[START_WIDTH] / waves_in_square), MIN_BIAS_PX)
        return chosen

    def add_to(self, matrix: FloatArray, right_side: FloatArray, design: FloatArray) -> None:
        """Add this group to the normal equations, its slow displacement eliminated."""
        precision = self.weights / (self.scale**2 * self.spread)
        weighted = design * precision[:, None]
        matrix += weighted.T @ design
        right_side += weighted.T @ self.values
        if self.bias_px > 0:
            mixed, by_wave, inner = self._bias_terms(precision, design)
            gain = np.linalg.solve(inner, np.column_stack([mixed.T, by_wave]))
            matrix -= mixed @ gain[:, :-1]
            right_side -= mixed @ gain[:, -1]

    def _bias_terms(
        self, precision: FloatArray, design: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        waves = self.waves * precision[:, None]
        inner = waves.T @ self.waves + np.eye(self.waves.shape[1]) / (0.5 * self.bias_px**2)
        return design.T @ waves, waves.T @ self.values, inner

    def reweigh(self, design: FloatArray, delta: FloatArray, round_: int) -> None:
        """Residuals, scale and weights for a step; in the first rounds like the median, then Tukey's."""
        residuals = self.values - design @ delta
        if self.bias_px > 0:
            precision = self.weights / (self.scale**2 * self.spread)
            mixed, by_wave, inner = self._bias_terms(precision, design)
            residuals = residuals - self.waves @ np.linalg.solve(inner, by_wave - mixed.T @ delta)
        self.residuals = residuals
        known = self.base > 0
        if not known.any():
            return
        scale = max(1.4826 * float(np.median(np.abs(residuals[known]))), MIN_SIGMA_PX)
        if round_ < MEDIAN_ROUNDS:
            self.weights = self.base * np.minimum(1.0, scale / np.maximum(np.abs(residuals), 1e-9))
            self.scale = scale
            return
        self.weights = self.base * _tukey(residuals / scale)
        total = float(self.weights.sum())
        if total <= 0:
            return
        # the variance of what agrees; Tukey's weights shrink its root by 1.06 for normal errors
        variance = float(np.sum(self.weights * residuals**2)) / total
        self.scale = max(float(np.sqrt(variance)) * 1.06, MIN_SIGMA_PX)
        if round_ in SPREAD_ROUNDS:  # then it stays: an estimate that changes in every round never settles
            self.spread = _correlation_length(residuals, self.weights)


def _slow_waves(normals: FloatArray) -> FloatArray:
    """(N, 5): up to two waves around a curve by the direction of its normals (N, 2) in the image.

    What a wrong circle looks like, and a bias: light and view have one direction in the image.
    """
    angle = np.arctan2(normals[:, 1], normals[:, 0])
    return np.column_stack([np.ones(len(angle)), *(f(m * angle) for m in (1, 2) for f in (np.cos, np.sin))])


def _variance_of_mean(values: FloatArray, base: FloatArray, waves: FloatArray) -> tuple[float, float]:
    """Variance of the mean of samples around a circle, and the mean square of their slow changes."""
    known = base > 0
    if known.sum() < _MIN_POINTS:
        return np.inf, 0.0
    weights = base
    slow = residuals = values
    for _ in range(4):
        root = np.sqrt(weights)
        slow = waves @ np.linalg.lstsq(waves * root[:, None], values * root, rcond=None)[0]
        residuals = values - slow
        scale = max(1.4826 * float(np.median(np.abs(residuals[known]))), 1e-3)
        weights = base * _tukey(residuals / scale)
    total = float(weights.sum())
    if total <= 0:
        return np.inf, 0.0
    variance = max(float(np.sum(weights * residuals**2)) / total, MIN_SIGMA_PX**2)
    mean_square = float(np.sum(weights * slow**2)) / total
    return variance * _correlation_length(residuals, weights) / total, mean_square


def _tukey(ratio: FloatArray) -> FloatArray:
    scaled = ratio / TUKEY
    return np.where(np.abs(scaled) < 1, (1 - scaled**2) ** 2, 0.0)


def _solve(groups: list[_Group], designs: dict[str, FloatArray]) -> tuple[FloatArray, FloatArray] | None:
    """Iteratively reweighted least squares: (delta, covariance); leaves weights and residuals in the groups.

    The first rounds weigh like the median (1 / |residual|), which a third of wrong edges does not move;
    then Tukey's biweight. Half of the variance of the slow displacements is each curve's own, half is shared
    by the curves of one kind: five holes in one light are not five independent witnesses.
    """
    unknowns = designs["left"].shape[1]
    kinds = sorted({group.kind for group in groups if group.bias_px > 0})
    parts = [(group, _with_shared_bias(group, designs[group.kind[0]][group.rows], kinds)) for group in groups]
    if sum(int((group.base > 0).sum()) for group in groups) < 2 * _MIN_POINTS:
        return None
    width = parts[0][1].shape[1]
    prior = np.zeros((width, width))
    prior[range(unknowns, width), range(unknowns, width)] = 1.0  # in units of their sigma
    delta: FloatArray = np.zeros(width)
    matrix: FloatArray = prior
    for round_ in range(MAX_ROUNDS):
        matrix, right_side, previous = prior.copy(), np.zeros(width), delta
        for group, design in parts:
            group.add_to(matrix, right_side, design)
        size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        if np.linalg.cond(matrix / np.outer(size, size)) > MAX_CONDITION:
            return None
        delta = np.asarray(np.linalg.solve(matrix, right_side), dtype=np.float64)
        for group, design in parts:
            group.reweigh(design, delta, round_)
        if round_ > SPREAD_ROUNDS[-1] and np.abs(delta - previous).max() < 1e-7:
            break
    if sum(float(group.weights.sum()) for group in groups) < 2 * _MIN_POINTS:
        return None
    covariance = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    return delta[:unknowns], covariance[:unknowns, :unknowns]


def _with_shared_bias(group: _Group, design: FloatArray, kinds: list[tuple[str, int]]) -> FloatArray:
    """The design (N, P) with five more columns for the displacement that each kind of curve shares."""
    shared = np.zeros((len(design), group.waves.shape[1] * len(kinds)))
    if group.bias_px > 0:
        first = group.waves.shape[1] * kinds.index(group.kind)
        shared[:, first : first + group.waves.shape[1]] = group.waves * (np.sqrt(0.5) * group.bias_px)
    return np.hstack([design, shared])


def _correlation_length(residuals: FloatArray, weights: FloatArray) -> float:
    """How many neighbouring samples say the same thing: 1 + 2 sum of the autocorrelation.

    Texture and machining marks displace an edge over several px along its length; taking such samples
    for independent would state a sigma that is too small. Sum up to the first lag that is not positive.
    """
    good = weights > 0.05
    masked = np.where(good, residuals, 0.0)
    power = float(np.sum(masked**2)) / max(int(good.sum()), 1)
    if power <= 0:
        return 1.0
    total = 1.0
    for lag in range(1, max(2, min(24, len(masked) // 8))):
        pairs = int((good & np.roll(good, lag)).sum())
        if pairs < 8:
            break
        correlation = float(np.sum(masked * np.roll(masked, lag))) / pairs / power
        if correlation <= 2 / np.sqrt(pairs):  # no more than chance
            break
        total += 2 * correlation
    return total
