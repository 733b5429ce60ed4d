"""Recover both edges of each broken rim from the pairs that a part was taught from.

A rim with a chamfer or rounding has two edges. Each camera shows the one that light and view make stronger,
and a break that faces one camera faces away from the other. Where the cameras see opposite edges, a whole
face appears too deep by 1 / (2 tan 12°) times the break's width, with 24° between the cameras. The positions
of the edges do not reveal this; the profiles do. Across a break of 0.2 mm they show a ramp or two steps where
a sharp edge shows one step, and only one geometry explains those of both cameras. So poses, places of the
curves, break widths and size are adjusted together from several candidate forms of the rims, and the form
with the smallest residual of the profiles is compared with sharp edges.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import I64, FloatArray
from edged.vision.geometry.rigid import apply, transform
from edged.vision.kernels.robust import mad_sigma, tukey_weights
from edged.vision.part.job import CircleFeature, EdgeFeature, Job, SlotFeature, known_radius
from edged.vision.solid.curvemodel import UP, curve_model, curve_points
from edged.vision.solid.edgemodel import EdgeModel, chains_of
from edged.vision.solid.forms import PosedPair, weights_of, with_breaks
from edged.vision.solid.lock import scale_at
from edged.vision.solid.params import BREAKS, CURVES, DECISION, PROFILE, PROFILE_RESIDUALS
from edged.vision.solid.profileresiduals import Gain, ProfileResiduals
from edged.vision.solid.profiles import Profiles, profiles_of
from edged.vision.solid.visible import moved, samples_at
from edged.vision.teaching.params import BROKEN


@dataclass(frozen=True, slots=True, eq=False)
class BrokenEdges:
    """Broken rims of a part as found in its pairs.

    model : its curves are the edges in the faces.  poses : of the pairs, each rig_from_part (4, 4).
    features, shown : number of circles, slots and edges of the job, and of those shown broken by profiles.
    gain : reduction of the residual of the profiles against sharp edges.
    """

    model: EdgeModel
    poses: tuple[FloatArray, ...]
    features: int
    shown: int
    gain: Gain

    @property
    def is_certain(self) -> bool:
        """Whether most features, and the profiles as a whole, show broken rims."""
        return self.shown >= max(CURVES.fewest, DECISION.present * self.features) and self.gain.is_certain

    @property
    def width_mm(self) -> float:
        """Median break width over the curves."""
        _, first = np.unique(self.model.chain, return_index=True)
        return float(np.median(self.model.breaks_mm[first]))


@dataclass(frozen=True, slots=True, eq=False)
class _Form:
    """A candidate form of the rims, with the pairs at the poses fitted to it, and the blur of their edges.

    taught : the model with its edges in the faces where the curves were taught.  faces (C,) : number of the
    face in which each curve was taught.
    """

    model: EdgeModel
    taught: EdgeModel
    faces: I64
    views: tuple[PosedPair, ...]
    blur_px: float = BREAKS.blur_px

    def uneven(self) -> FloatArray:
        """(C,) mm by which each curve's edge in the face lies below the median of its face."""
        height, size = np.full(len(self.faces), np.nan), np.zeros(len(self.faces), np.int64)
        numbers, first, count = np.unique(self.model.chain, return_index=True, return_counts=True)
        height[numbers], size[numbers] = self.model.start[first, 2], count
        usual = np.zeros(len(height))
        for face in np.unique(self.faces):
            its = self.faces == face
            usual[its] = np.median(np.repeat(height[its], size[its])) if size[its].any() else 0.0
        return np.nan_to_num(height - usual)


def broken_edges(job: Job, views: Sequence[PosedPair]) -> BrokenEdges | None:
    """Find the form of a job's rims that the pairs show best; None if only sharp edges explain them.

    views : the pair that it was taught from, then others, at their rig_from_part, good to a pixel or two.
    """
    model = curve_model(job)
    sharp = _adjusted(_Form(model, model, _faces(job), tuple(views)), BROKEN.rounds)
    if sharp is None:
        return None
    leaves = ProfileResiduals.of(sharp.model, sharp.views)
    begun = []
    for start in _starts(job, sharp, leaves):
        form = _adjusted(_with_blur(start, leaves), BROKEN.first_rounds)
        if form is not None:
            form = _with_blur(_by_ends(form, leaves), leaves)
            begun.append((leaves.roughly(form.model, form.views), form))
    begun.sort(key=lambda tried: -tried[0])
    ended = [
        form for _, rough in begun[: BROKEN.kept] if (form := _adjusted(rough, BROKEN.rounds)) is not None
    ]
    ended = [form for form in ended if form.model.breaks_mm.any()]
    if not ended:
        return None
    found = [np.nan_to_num(leaves.gains(form.model, form.views)) for form in ended]
    best = max(range(len(ended)), key=lambda k: float(found[k].mean()))
    form = ended[best]
    shown = leaves.by_curve(found[best]) > PROFILE_RESIDUALS.doubt
    # an edge along the other side of a rim may look like its break, one width off the face
    shown &= np.abs(form.uneven()) < BROKEN.in_face * float(np.median(form.model.breaks_mm))
    poses = tuple(view.pose for view in form.views)
    features = len(job.circles) + len(job.slots) + len(job.edges)
    gain = leaves.gain(form.model, form.views)
    clearly = int(np.count_nonzero((shown & (gain.by_curve > PROFILE_RESIDUALS.least_gain))[:features]))
    return BrokenEdges(_as_its_face(form, shown), poses, features, clearly, gain)


def _faces(job: Job) -> I64:
    """(C,) number of the face in which each curve of a job was taught."""
    level = np.array([points[0, 2] for points in curve_points(job)])
    order = np.argsort(level)
    faces = np.empty(len(level), np.int64)
    faces[order] = np.concatenate([[0], np.cumsum(np.diff(level[order]) > CURVES.level_mm)])
    return faces


# --- forms -----------------------------------------------------------------------------------------


def _starts(job: Job, sharp: _Form, leaves: ProfileResiduals) -> list[_Form]:
    """Starting forms for the adjustment, the one with the largest gain first.

    At teaching, the cameras saw the edge of each rim in the face, the one in the wall, or one of them each.
    In the last case the taught curve lies between both edges, and all are too deep or too near by parallax.
    """
    found: list[tuple[float, float, int, _Form]] = []
    for width in BROKEN.tried_mm:
        model = curve_model(job, width)
        to_upper = model.by_break[:, 0]  # nonzero for a rim one width below a face: its upper edge is known
        known = np.abs(to_upper).max(axis=1, keepdims=True) > 0
        across = np.where(known, -to_upper, model.by_break[:, 1])
        by_break = np.stack([np.zeros_like(across), across], axis=1)
        upper = width * to_upper
        model = replace(model, start=model.start + upper, end=model.end + upper, by_break=by_break)
        for sign in (0, 1, -1):
            form = _by_ends(_nearer(model, sharp, sign * width), leaves)
            found.append((leaves.roughly(form.model, form.views), width, sign, form))
    kept: list[tuple[float, int, _Form]] = []
    for _, width, sign, form in sorted(found, key=lambda tried: -tried[0]):
        if all(abs(width - w) > BROKEN.apart_mm or sign != s for w, s, _ in kept):
            kept.append((width, sign, form))
    return [form for _, _, form in kept[: BROKEN.begun]]


def _nearer(model: EdgeModel, sharp: _Form, width_mm: float) -> _Form:
    """Move a form nearer by the parallax of a width in the first pair, keeping its apparent size."""
    if not width_mm:
        return replace(sharp, model=model, taught=model)
    views = sharp.views
    rig, pose = views[0].images.rig, views[0].pose
    centre = apply(pose, model.centre)
    _, right = rig.eyes_mm
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
    """The model scaled about its centre by 1 + share."""
    start, end = (model.centre + (1 + share) * (ends - model.centre) for ends in (model.start, model.end))
    return replace(model, start=start, end=end)


def _with_blur(form: _Form, leaves: ProfileResiduals) -> _Form:
    """The form with the blur that explains the pairs' edges best."""
    return replace(form, blur_px=leaves.blur_px(form.model, form.views))


def _by_ends(form: _Form, leaves: ProfileResiduals) -> _Form:
    """Move each curve to the end of its break that gains most; not all were taught by the same end."""
    model, taught = form.model, replace(form.taught, breaks_mm=form.model.breaks_mm)
    places = [model, *(_across(taught, way) for way in (0.0, -0.5, -1.0))]
    places += [_across(model, way) for way in (1.0, -1.0)]
    gains = []
    for place in places:
        gain = leaves.gains(place, form.views, PROFILE_RESIDUALS.blurs_px)
        gains.append(leaves.by_curve(np.nan_to_num(gain, nan=-PROFILE_RESIDUALS.doubt)))
    gains[0] = gains[0] + PROFILE_RESIDUALS.doubt
    best = np.argmax(gains, axis=0)[model.chain]
    every = np.arange(len(best))
    start, end = (
        np.stack([getattr(place, end) for place in places])[best, every] for end in ("start", "end")
    )
    return replace(form, model=replace(model, start=start, end=end))


def _as_its_face(form: _Form, shown: npt.NDArray[np.bool_]) -> EdgeModel:
    """The model of a form, with curves that are not shown (C,) at the same ends of breaks as most of their
    face."""
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
    """Shift all edges across their breaks, in units of the width; +1 leads to the edges in the walls."""
    shift = (way * model.breaks_mm)[:, None] * model.by_break[:, 1]
    return replace(model, start=model.start + shift, end=model.end + shift)


# --- adjustment ------------------------------------------------------------------------------------


def _adjusted(form: _Form, rounds: int) -> _Form | None:
    """Fit poses, size, and each curve's place and break width to the profiles of all pairs.

    None if a pair shows too few profiles, or they do not determine the unknowns.
    """
    so_far: FloatArray | None = None
    level, has_breaks = form.uneven(), bool(form.model.breaks_mm.any())
    for number in range(rounds):
        model, views = form.model, form.views
        curves = int(model.chain.max()) + 1
        size = 6 * len(views)  # then: growth; outwards, up, of each curve; common width, each curve's
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
    model: EdgeModel, view: PosedPair, profiles: Profiles, count: int, own: int, common: int, has_breaks: bool
) -> tuple[FloatArray, FloatArray]:
    """Design (M, count), px by each unknown in the order of `_adjusted`, and weights (M,) of the profiles.

    own : index of the first unknown of the pair's pose.  common : index of the first one after all poses.
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


# --- a job -----------------------------------------------------------------------------------------


def with_edges(job: Job, found: BrokenEdges) -> Job:
    """Move a job's features to the edges in the faces, at the pose of the first pair.

    The reference keeps its coordinates.
    """
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
    """Points of a job's curves as a model has them."""

    def __init__(self, job: Job, found: BrokenEdges) -> None:
        model, taught = found.model, curve_points(job)
        self._job = job
        self._points: dict[int, FloatArray] = {}
        for k in np.unique(model.chain).tolist():
            its = model.chain == k
            self._points[k] = np.concatenate([model.start[its], model.end[its][-1:]])
        # the model lacks lower edges whose upper edge was taught too: they move by the median shift
        shift = np.median([points[0] - taught[k][0] for k, points in self._points.items()], axis=0)
        for k, points in enumerate(taught):
            self._points.setdefault(k, points + shift)

    def job(self, origin_mm: FloatArray) -> Job:
        """The job with its curves at these points, relative to an origin (3,)."""
        job = self._job
        points = iter([self._points[k] for k in range(len(self._points))])  # in the order of `curve_points`
        return replace(
            job,
            circles=tuple(_circle(circle, next(points), origin_mm) for circle in job.circles),
            slots=tuple(_slot(slot, next(points), origin_mm) for slot in job.slots),
            edges=tuple(_edge(edge, next(points) - origin_mm) for edge in job.edges),
            traced=tuple(replace(curve, points_mm=next(points) - origin_mm) for curve in job.traced),
        )


def _circle(circle: CircleFeature, points: FloatArray, origin_mm: FloatArray) -> CircleFeature:
    """The circle through points (N, 3), the last of which repeats the first."""
    around = points[:-1]
    centre = around.mean(axis=0)
    radius = float(np.linalg.norm(around - centre, axis=1).mean())
    return replace(circle, centre_mm=centre - origin_mm, radius_mm=radius)


def _slot(slot: SlotFeature, points: FloatArray, origin_mm: FloatArray) -> SlotFeature:
    """The slot through points (N, 3), the last repeating the first; they start at a straight edge's end."""
    around = points[:-1]
    centre = around.mean(axis=0)
    along = np.array([math.cos(slot.angle_rad), math.sin(slot.angle_rad), 0.0])
    reach = (around - centre) @ along
    radius = float(np.linalg.norm(around[0] - centre - reach[0] * along))
    return replace(slot, centre_mm=centre - origin_mm, width_mm=2 * radius, length_mm=float(np.ptp(reach)))


def _edge(edge: EdgeFeature, points: FloatArray) -> EdgeFeature:
    return replace(edge, start_mm=points[0], end_mm=points[-1])
