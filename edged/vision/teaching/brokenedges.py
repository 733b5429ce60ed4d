"""Both edges of each broken rim, found again in the pairs that a part was taught from.

A rim with a chamfer or rounding has two edges. Each camera shows that one which light and view make the
stronger, and a break that faces one camera turns from the other: seen at opposite ends, a whole face lies
deeper than it is, by 1 / (2 tan 12°) times the width with 24° between the cameras. The edges' places say
nothing of it; the profiles do. Of a break of 0.2 mm they have a ramp or two steps where a sharp edge has one,
and one geometry alone explains those of both cameras. So from several forms that the rims may have, poses,
places, widths and size are adjusted together, and the form that leaves the profiles least is compared with
sharp edges.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray, IntArray
from edged.vision.edges.subpixel import edge_profiles
from edged.vision.geometry.rigid import apply, invert, transform
from edged.vision.kernels.jit import kernel
from edged.vision.kernels.robust import mad_sigma, tukey_weights
from edged.vision.part.job import CircleFeature, EdgeFeature, Job, SlotFeature, known_radius
from edged.vision.solid.curvemodel import UP, curve_model, curve_points
from edged.vision.solid.edgemodel import EdgeModel, chains_of
from edged.vision.solid.forms import LaidPair, weights_of, with_breaks
from edged.vision.solid.lock import scale_at
from edged.vision.solid.params import BREAKS, CURVES, DECISION, PROFILE
from edged.vision.solid.profiles import Profiles, profiles_of, seen_with_neighbours
from edged.vision.solid.shifts import STEP_PX, fill_steps, misfit
from edged.vision.solid.visible import moved, samples_at
from edged.vision.teaching.params import BROKEN

DIGIT = 1 / 3
"""Square sum of a profile without any noise: four samples rounded to grey values, by 1/12 each."""


@dataclass(frozen=True, slots=True, eq=False)
class BrokenEdges:
    """The rims of a part as pairs show them.

    model : its curves are the edges in the faces.  poses : of the pairs, each rig_from_part (4, 4).
    features, shown : how many circles, slots and edges the job has, and how many the profiles show so.
    gain : mean logarithm of what sharp edges leave of the profiles against what these do.
    sigmas : of the gain, by curves and cameras.
    """

    model: EdgeModel
    poses: tuple[FloatArray, ...]
    features: int
    shown: int
    gain: float
    sigmas: float

    @property
    def is_certain(self) -> bool:
        """Whether the rims are broken: a second step takes half of what one leaves, and not by chance."""
        enough = self.shown >= max(CURVES.fewest, DECISION.present * self.features)
        return enough and self.gain > BROKEN.least_gain and self.sigmas > BROKEN.least_sigmas

    @property
    def width_mm(self) -> float:
        """The width of the breaks of most of its curves."""
        _, first = np.unique(self.model.chain, return_index=True)
        return float(np.median(self.model.breaks_mm[first]))


@dataclass(frozen=True, slots=True, eq=False)
class _Form:
    """A form of the rims, with the pairs at the poses that it has there, and the blur of their edges.

    taught : with the edges in the faces where curves were taught.  faces (C,) : number of the face in which
    each curve was taught.
    """

    model: EdgeModel
    taught: EdgeModel
    faces: IntArray
    views: tuple[LaidPair, ...]
    blur_px: float = BREAKS.blur_px

    def uneven(self) -> FloatArray:
        """(C,) mm by which each curve's edge in the face lies below most others of its face."""
        height, size = np.full(len(self.faces), np.nan), np.zeros(len(self.faces), np.int64)
        numbers, first, count = np.unique(self.model.chain, return_index=True, return_counts=True)
        height[numbers], size[numbers] = self.model.start[first, 2], count
        usual = np.zeros(len(height))
        for face in np.unique(self.faces):
            its = self.faces == face
            usual[its] = np.median(np.repeat(height[its], size[its])) if size[its].any() else 0.0
        return np.nan_to_num(height - usual)


def broken_edges(job: Job, views: Sequence[LaidPair]) -> BrokenEdges | None:
    """The form of a job's rims that pairs show best; None where none but sharp edges explains them.

    views : the pair that it was taught from, and others, at their rig_from_part, good to a pixel or two.
    """
    model = curve_model(job)
    sharp = _adjusted(_Form(model, model, _faces(job), tuple(views)), BROKEN.rounds)
    if sharp is None:
        return None
    leaves = _Leavings.of(sharp)
    begun = []
    for start in _starts(job, leaves):
        form = _adjusted(leaves.with_blur(start), BROKEN.first_rounds)
        if form is not None:
            form = leaves.with_blur(_by_ends(form, leaves))
            begun.append((leaves.roughly(form), form))
    begun.sort(key=lambda one: -one[0])
    ended = [
        form for _, rough in begun[: BROKEN.kept] if (form := _adjusted(rough, BROKEN.rounds)) is not None
    ]
    ended = [form for form in ended if form.model.breaks_mm.any()]
    if not ended:
        return None
    found = [np.nan_to_num(leaves.gains(form)) for form in ended]
    best = max(range(len(ended)), key=lambda k: float(found[k].mean()))
    form = ended[best]
    shown = leaves.by_curve(found[best]) > BROKEN.doubt
    # what runs beside an edge on its other side may look like its break, a width off the face
    shown &= np.abs(form.uneven()) < BROKEN.in_face * float(np.median(form.model.breaks_mm))
    poses = tuple(view.pose for view in form.views)
    features = len(job.circles) + len(job.slots) + len(job.edges)
    gain, sigmas, by_curve = _gain(leaves, form)
    clearly = int(np.count_nonzero((shown & (by_curve > BROKEN.least_gain))[:features]))
    return BrokenEdges(_as_its_face(form, shown), poses, features, clearly, gain, sigmas)


def _faces(job: Job) -> IntArray:
    """(C,) number of the face in which each curve of a job was taught."""
    level = np.array([points[0, 2] for points in curve_points(job)])
    order = np.argsort(level)
    faces = np.empty(len(level), np.int64)
    faces[order] = np.concatenate([[0], np.cumsum(np.diff(level[order]) > CURVES.level_mm)])
    return faces


# --- forms -----------------------------------------------------------------------------------------


def _starts(job: Job, sharp: _Leavings) -> list[_Form]:
    """Forms from which the right one is near, those first that gain most.

    Of each rim the edge in the face was taught, or that in the wall, or one of both by either camera: then it
    lies between them, and all are deeper or nearer by parallax.
    """
    found: list[tuple[float, float, int, _Form]] = []
    for width in BROKEN.tried_mm:
        model = curve_model(job, width)
        to_upper = model.by_break[:, 0]  # of a rim that lies a width below a face: its upper edge is known
        known = np.abs(to_upper).max(axis=1, keepdims=True) > 0
        across = np.where(known, -to_upper, model.by_break[:, 1])
        by_break = np.stack([np.zeros_like(across), across], axis=1)
        upper = width * to_upper
        model = replace(model, start=model.start + upper, end=model.end + upper, by_break=by_break)
        for sign in (0, 1, -1):
            form = _by_ends(_nearer(model, sharp.form, sign * width), sharp)
            found.append((sharp.roughly(form), width, sign, form))
    kept: list[tuple[float, int, _Form]] = []
    for _, width, sign, form in sorted(found, key=lambda one: -one[0]):
        if all(abs(width - w) > BROKEN.apart_mm or sign != s for w, s, _ in kept):
            kept.append((width, sign, form))
    return [form for _, _, form in kept[: BROKEN.begun]]


def _nearer(model: EdgeModel, sharp: _Form, width_mm: float) -> _Form:
    """A form that looks as large as before, nearer to the cameras by the parallax of a width in the first
    pair."""
    if not width_mm:
        return replace(sharp, model=model, taught=model)
    views = sharp.views
    rig, pose = views[0].images.rig, views[0].pose
    centre = apply(pose, model.centre)
    right = invert(rig.right_from_left)[:3, 3]
    away, beside = centre / np.linalg.norm(centre), (centre - right) / np.linalg.norm(centre - right)
    between = math.acos(min(float(away @ beside), 1.0))
    back = 0.5 * right - centre
    distance = float(np.linalg.norm(back))
    nearer = width_mm / (2 * math.tan(0.5 * between))
    moved_by = transform(np.eye(3), pose[:3, :3].T @ (nearer * back / distance))
    poses = [view.pose @ moved_by for view in views]
    grown = _grown(model, -nearer / distance)
    laid = tuple(replace(view, pose=pose) for view, pose in zip(views, poses, strict=True))
    return replace(sharp, model=grown, taught=grown, views=laid)


def _grown(model: EdgeModel, share: float) -> EdgeModel:
    """The model with all places farther from its centre by a share."""
    start, end = (model.centre + (1 + share) * (ends - model.centre) for ends in (model.start, model.end))
    return replace(model, start=start, end=end)


def _by_ends(form: _Form, sharp: _Leavings) -> _Form:
    """A form with each curve where it gains most: not all need be taught by the same end of their breaks."""
    model, taught = form.model, replace(form.taught, breaks_mm=form.model.breaks_mm)
    places = [model, *(_across(taught, way) for way in (0.0, -0.5, -1.0))]
    places += [_across(model, way) for way in (1.0, -1.0)]
    gains = []
    for place in places:
        gain = sharp.gains(replace(form, model=place), BROKEN.blurs_px)
        gains.append(sharp.by_curve(np.nan_to_num(gain, nan=-BROKEN.doubt)))
    gains[0] = gains[0] + BROKEN.doubt
    best = np.argmax(gains, axis=0)[model.chain]
    every = np.arange(len(best))
    start, end = (
        np.stack([getattr(place, end) for place in places])[best, every] for end in ("start", "end")
    )
    return replace(form, model=replace(model, start=start, end=end))


def _as_its_face(form: _Form, shown: npt.NDArray[np.bool_]) -> EdgeModel:
    """The edges of a form; those that are not shown (C,) taught by the same ends as most of their face."""
    model, taught = form.model, replace(form.taught, breaks_mm=form.model.breaks_mm)
    raised = (model.start - taught.start)[:, 2] < -0.5 * model.breaks_mm
    start, end, face = model.start.copy(), model.end.copy(), form.faces[model.chain]
    for number in np.unique(face):
        its = face == number
        seen = its & shown[model.chain]
        place = _across(taught, -1.0 if np.mean(raised[seen if seen.any() else its]) > 0.5 else 0.0)
        rest = its & ~seen
        start[rest], end[rest] = place.start[rest], place.end[rest]
    return replace(model, start=start, end=end)


def _across(model: EdgeModel, way: float) -> EdgeModel:
    """The model with its edges moved to where the others of their breaks are, by +1 into the walls."""
    shift = (way * model.breaks_mm)[:, None] * model.by_break[:, 1]
    return replace(model, start=model.start + shift, end=model.end + shift)


# --- adjustment ------------------------------------------------------------------------------------


def _adjusted(form: _Form, rounds: int) -> _Form | None:
    """Poses, size, and each curve's place and width that the profiles of all pairs give; None where they
    show too little."""
    so_far: FloatArray | None = None
    level, has_breaks = form.uneven(), bool(form.model.breaks_mm.any())
    for number in range(rounds):
        model, views = form.model, form.views
        curves = int(model.chain.max()) + 1
        size = 6 * len(views)  # growth; outwards, and up, of each curve; common width, and each curve's
        prior = np.concatenate(
            [
                np.zeros(size), [BROKEN.growth_sigma**-2], np.full(curves, BROKEN.place_mm**-2),
                np.full(curves, BROKEN.level_mm**-2),
                [BREAKS.alike_mm**-2, *np.full(curves, BROKEN.width_mm**-2)] if has_breaks else [],
            ]
        )  # fmt: skip
        normal, pull = np.diag(BREAKS.correlated * prior), np.zeros(len(prior))
        for v, view in enumerate(views):
            profiles = profiles_of(model, view.pyramids, view.images, view.pose, form.blur_px)
            rows, weight = _rows(model, view, profiles, len(prior), 6 * v, size, has_breaks)
            good = profiles.weight > BREAKS.min_weight
            if good.sum() < PROFILE.fewest:
                return None
            if number:
                sigma = max(mad_sigma(profiles.shift_px[good]), BREAKS.min_sigma_px)
                weight = weight * tukey_weights(profiles.shift_px, sigma)
            normal += rows.T @ (weight[:, None] * rows)
            pull += rows.T @ (weight * profiles.shift_px)
        if not np.linalg.cond(normal) < BROKEN.max_condition:
            return None
        if so_far is None:
            so_far = np.zeros(len(prior))
            so_far[size + 1 + curves :][:curves] = -level[:curves]
        found: FloatArray = np.linalg.solve(normal, pull - BREAKS.correlated * prior * so_far).astype(
            np.float64
        )
        so_far += found
        model, taught = (_grown(each, float(found[size])) for each in (model, form.taught))
        outwards, up = found[size + 1 :][:curves], found[size + 1 + curves :][:curves]
        shift = outwards[model.chain][:, None] * model.normals[:, 1] + up[model.chain][:, None] * UP
        model = replace(model, start=model.start + shift, end=model.end + shift)
        if has_breaks:
            widths = found[size + 1 + 2 * curves] + found[size + 2 + 2 * curves :][model.chain]
            model = with_breaks(model, model.breaks_mm + widths)
        poses = [moved(form.model, view.pose, found[6 * v :][:6]) for v, view in enumerate(views)]
        laid = tuple(replace(view, pose=pose) for view, pose in zip(views, poses, strict=True))
        form = replace(form, model=model, taught=taught, views=laid)
    return form


def _rows(
    model: EdgeModel, view: LaidPair, profiles: Profiles, count: int, own: int, common: int, has_breaks: bool
) -> tuple[FloatArray, FloatArray]:
    """(M, count) px by each unknown, in the order of `_adjusted`, and (M,) weights of the profiles.

    own : first unknown of the pair's pose.  common : first one after all poses.
    """
    seen = profiles.seen
    samples = samples_at(model, scale_at(view.images.rig, view.pose, model), PROFILE.drawn_px)
    curve, every, curves = chains_of(seen.curve), np.arange(len(seen.row)), int(model.chain.max()) + 1
    shift = seen.design[:, 3:]
    rows = np.zeros((len(every), count))
    rows[:, own : own + 6] = seen.design
    rows[:, common] = np.einsum("mj,mj->m", shift, profiles.points - model.centre)
    rows[every, common + 1 + curve] = np.einsum("mj,mj->m", shift, samples.normals[seen.row, 3:])
    rows[every, common + 1 + curves + curve] = shift @ UP
    if has_breaks:
        rows[:, common + 1 + 2 * curves] = profiles.by_width
        rows[every, common + 2 + 2 * curves + curve] = profiles.by_width
    return rows, weights_of(profiles)


# --- what a form leaves ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """Profiles across the taught curves in one camera, wide enough for both edges of each break.

    curve (M,) : number in `EdgeModel.chain`.  piece (M,) : number in the curve, and share (M,) of it.
    pixels, normals (M, 2) raw px.  grey (M, S) : without those that show another curve, too.
    """

    view: int
    camera: int
    curve: IntArray
    piece: IntArray
    share: FloatArray
    pixels: FloatArray
    normals: FloatArray
    grey: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Leavings:
    """What sharp edges leave of all windows, to compare forms with: left (M,) of each; curve, block (M,)."""

    form: _Form
    windows: tuple[_Windows, ...]
    left: FloatArray
    curve: IntArray
    block: IntArray

    @classmethod
    def of(cls, form: _Form) -> _Leavings:
        """What a sharp form leaves."""
        windows = _windows(form.model, form.views)
        curve = np.concatenate([window.curve for window in windows])
        place = np.repeat(np.arange(len(windows)), [len(window.curve) for window in windows])
        left, _ = _left(windows, form, PROFILE.blurs_px)
        return cls(form, tuple(windows), left, curve, len(windows) * curve + place)

    def gains(self, form: _Form, blurs_px: Sequence[float] = PROFILE.blurs_px) -> FloatArray:
        """(M,) what a form leaves less; NaN where it does not lie in the window."""
        return np.asarray(self.left - _left(self.windows, form, blurs_px)[0])

    def roughly(self, form: _Form) -> float:
        """Mean of what a form leaves less, by the blurs that starts are compared with."""
        return float(np.nan_to_num(self.gains(form, BROKEN.blurs_px)).mean())

    def with_blur(self, form: _Form) -> _Form:
        """A form with the blur of the pairs' edges."""
        return replace(form, blur_px=_left(self.windows, form, PROFILE.blurs_px)[1])

    def by_curve(self, gains: FloatArray) -> FloatArray:
        """(C,) means of each curve."""
        count = int(self.form.model.chain.max()) + 1
        many = np.bincount(self.curve, minlength=count)
        return np.asarray(np.bincount(self.curve, gains, minlength=count) / np.maximum(many, 1))


def _windows(model: EdgeModel, views: Sequence[LaidPair]) -> list[_Windows]:
    """Windows about a sharp model, in all pairs and both cameras."""
    return [_windows_of(model, view, v, k) for v, view in enumerate(views) for k in (0, 1)]


def _windows_of(model: EdgeModel, view: LaidPair, number: int, camera: int) -> _Windows:
    samples = samples_at(model, scale_at(view.images.rig, view.pose, model), PROFILE.drawn_px)
    reach = BROKEN.half_px
    dense, near = seen_with_neighbours(model, samples, view.pyramids, view.pose, camera, reach)
    alone = np.flatnonzero(~np.isfinite(near).any(axis=1))[:: PROFILE.every]
    pixels, normals = (np.ascontiguousarray(each[alone]) for each in (dense.pixels, dense.normals))
    grey, _ = edge_profiles(view.images.raw[camera], pixels, normals, BROKEN.half_px, PROFILE.step_px)
    curve = chains_of(dense.curve[alone])
    piece, share = _places(model, curve, samples.points[dense.row[alone]])
    return _Windows(number, camera, curve, piece, share, pixels, normals, grey)


def _places(model: EdgeModel, curve: IntArray, points: FloatArray) -> tuple[IntArray, FloatArray]:
    """(N,) pieces of their curves (N,) that points (N, 3) lie on, and the share of each before them."""
    pieces, shares = np.empty(len(points), np.int64), np.empty(len(points))
    for number in np.unique(curve):
        mine, its = curve == number, model.chain == number
        start, along = model.start[its], (model.end - model.start)[its]
        gaps = points[mine][:, None] - start
        share = np.clip(np.einsum("nej,ej->ne", gaps, along) / np.sum(along**2, axis=1), 0.0, 1.0)
        nearest = np.linalg.norm(gaps - share[..., None] * along, axis=2).argmin(axis=1)
        pieces[mine], shares[mine] = nearest, share[np.arange(len(nearest)), nearest]
    return pieces, shares


def _left(
    windows: Sequence[_Windows], form: _Form, blurs_px: Sequence[float], *, slopes: bool = False
) -> tuple[FloatArray, float]:
    """(M,) of all windows, the logarithm of the square sum that a form leaves, and the blur with the least.

    NaN where its edges lie outside, or its curve is none of the form's.
    """
    edges = [_edges_in(window, form) for window in windows]
    found = []
    for blur in blurs_px:
        left = [np.full(len(window.curve), np.nan) for window in windows]
        for window, both, logs in zip(windows, edges, left, strict=True):
            reach = BROKEN.half_px - 1
            find_left(window.grey, window.curve, both, blur, PROFILE.together, reach, slopes, logs)
        found.append((np.concatenate(left), blur))
    means = [float(left[np.isfinite(left)].mean()) if np.isfinite(left).any() else 0.0 for left, _ in found]
    return found[int(np.argmin(means))]


def _edges_in(window: _Windows, form: _Form) -> FloatArray:
    """(M, 2) px along the normals to both edges of each break; the second NaN of a sharp one."""
    model, view = form.model, form.views[window.view]
    first = np.full(int(max(model.chain.max(), window.curve.max())) + 1, -1)
    numbers, starts = np.unique(model.chain, return_index=True)
    first[numbers] = starts
    row = first[window.curve]
    edges = np.full((len(row), 2), np.nan)
    some = row >= 0
    at = row[some] + window.piece[some]
    place = model.start[at] + window.share[some, None] * (model.end - model.start)[at]
    rig, widths = view.images.rig, model.breaks_mm[at]
    for k in (0, 1):
        there = apply(view.pose, place + widths[:, None] * model.by_break[at, k])
        pixels = (
            rig.left.project(there)
            if window.camera == 0
            else rig.right.project(apply(rig.right_from_left, there))
        )
        edges[some, k] = np.einsum("mj,mj->m", pixels - window.pixels[some], window.normals[some])
    edges[some, 1] = np.where(widths > 0, edges[some, 1], np.nan)
    return edges


@kernel("void(f8[:, ::1], i8[::1], f8[:, ::1], f8, i8, f8, b1, f8[::1])")
def find_left(
    profiles: FloatArray, curve: IntArray, edges: FloatArray, blur: float, together: int, reach: float,
    slopes: bool, left: FloatArray,
) -> None:  # fmt: skip
    """Fill left (M,) with logarithms of square sums of grey values that steps leave of profiles (M, S).

    edges (M, 2) : offsets of the steps, the second NaN where there is one; their heights are free.
    slopes : so are slopes of the grey values beyond the steps.
    together : profiles on either side along the same curve that are averaged.  reach : of the first step.
    left keeps what it has where that lies farther off, or the profile leaves the image.
    """
    count, size = profiles.shape
    grey, steps = np.empty(size), np.empty(2)
    terms, normal, heights = np.ones((5, size)), np.empty((5, 5)), np.empty(5)
    for m in range(count):
        if not abs(edges[m, 0]) < reach:
            continue
        first, last = m, m
        while first > 0 and m - first < together and curve[first - 1] == curve[m]:
            first -= 1
        while last < count - 1 and last - m < together and curve[last + 1] == curve[m]:
            last += 1
        square, mean = 0.0, 0.0
        for s in range(size):
            total = 0.0
            for n in range(first, last + 1):
                total += profiles[n, s]
            grey[s] = total / (last - first + 1)
            mean += grey[s] / size
        for s in range(size):
            grey[s] -= mean
            square += grey[s] * grey[s]
        if not np.isfinite(square):
            continue
        many = 1
        steps[0] = edges[m, 0]
        if np.isfinite(edges[m, 1]):
            steps[1] = edges[m, 1]
            many = 2
        fill_steps(steps, many, 0.0, blur, terms)
        low, high = min(steps[0], steps[many - 1]), max(steps[0], steps[many - 1])
        for s in range(size):
            place = STEP_PX * (s - size // 2)
            terms[many + 1, s] = min(place - low, 0.0) / reach
            terms[many + 2, s] = max(place - high, 0.0) / reach
        rows = many + 2 if slopes else many
        left[m] = math.log(misfit(grey, square, terms, rows, 0, normal, heights) + DIGIT)


def _gain(sharp: _Leavings, form: _Form) -> tuple[float, float, FloatArray]:
    """Mean of what a form leaves less, how many of its sigmas that is, by curves and cameras, and the means
    of each curve (C,).

    With slopes beyond the edges: those of a wall or of its shadow are no second edge, and would gain as one.
    """
    own, _ = _left(sharp.windows, sharp.form, PROFILE.blurs_px, slopes=True)
    others, _ = _left(sharp.windows, form, PROFILE.blurs_px, slopes=True)
    less = own - others
    by_curve = sharp.by_curve(np.nan_to_num(less))
    good = np.isfinite(less)
    if good.sum() < PROFILE.fewest:
        return 0.0, 0.0, by_curve
    _, number = np.unique(sharp.block[good], return_inverse=True)
    mean = float(less[good].mean())
    # of a mean over clusters of unequal size
    sigma = math.sqrt(float(np.sum(np.bincount(number, less[good] - mean) ** 2))) / good.sum()
    return mean, mean / max(sigma, 1e-9) if number.max() > 0 else 0.0, by_curve


# --- a job -----------------------------------------------------------------------------------------


def with_edges(job: Job, found: BrokenEdges) -> Job:
    """A job whose features are the edges in the faces, at the pose of the first pair, its reference as
    before."""
    places = _Places(job, found)
    origin = places.job(np.zeros(3)).place_of(job.reference) - job.place_of(job.reference)
    settled = places.job(origin)
    sizes, witness = known_radius(settled.circles, job.reference, is_broken=True)
    return replace(
        settled,
        rig_from_part=found.poses[0] @ transform(np.eye(3), origin),
        break_mm=round(found.width_mm, 4),
        break_end="face",
        measurements=sizes,
        witness=witness,
    )


class _Places:
    """Where a model has the curves of a job."""

    def __init__(self, job: Job, found: BrokenEdges) -> None:
        model, taught = found.model, curve_points(job)
        self._job = job
        self._points: dict[int, FloatArray] = {}
        for k in np.unique(model.chain).tolist():
            its = model.chain == k
            self._points[k] = np.concatenate([model.start[its], model.end[its][-1:]])
        # the lower edges of others have no part in it: they move with most
        shift = np.median([points[0] - taught[k][0] for k, points in self._points.items()], axis=0)
        for k, points in enumerate(taught):
            self._points.setdefault(k, points + shift)

    def job(self, origin_mm: FloatArray) -> Job:
        """The job with its curves there, their places counted from an origin (3,)."""
        job = self._job
        points = iter([self._points[k] for k in range(len(self._points))])  # as `curve_points` has them
        return replace(
            job,
            circles=tuple(_circle(circle, next(points), origin_mm) for circle in job.circles),
            slots=tuple(_slot(slot, next(points), origin_mm) for slot in job.slots),
            edges=tuple(_edge(edge, next(points) - origin_mm) for edge in job.edges),
            traced=tuple(replace(curve, points_mm=next(points) - origin_mm) for curve in job.traced),
        )


def _circle(circle: CircleFeature, points: FloatArray, origin_mm: FloatArray) -> CircleFeature:
    """A circle where its points (N, 3) are, the last one of which is the first."""
    around = points[:-1]
    centre = around.mean(axis=0)
    radius = float(np.linalg.norm(around - centre, axis=1).mean())
    return replace(circle, centre_mm=centre - origin_mm, radius_mm=radius)


def _slot(slot: SlotFeature, points: FloatArray, origin_mm: FloatArray) -> SlotFeature:
    """A slot where its points are, as of a circle: they begin where a straight edge ends."""
    around = points[:-1]
    centre = around.mean(axis=0)
    along = np.array([math.cos(slot.angle_rad), math.sin(slot.angle_rad), 0.0])
    reach = (around - centre) @ along
    radius = float(np.linalg.norm(around[0] - centre - reach[0] * along))
    return replace(slot, centre_mm=centre - origin_mm, width_mm=2 * radius, length_mm=float(np.ptp(reach)))


def _edge(edge: EdgeFeature, points: FloatArray) -> EdgeFeature:
    return replace(edge, start_mm=points[0], end_mm=points[-1])
