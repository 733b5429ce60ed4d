"""Fit forms of the edge breaks to pairs: widths in turn with the poses, and the misfit that is left.

Profiles distinguish forms, since they show both edges of a break apart or together: on a part tilted by ten
degrees, a wrong form has several times the misfit of the right one. Seen face-on, several forms may explain a
pair equally well: then the differences between their poses belong to the sigma.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import B8, I64, FloatArray
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply, rotation_vector
from edged.vision.kernels.jit import for_each
from edged.vision.kernels.robust import mad_sigma, tukey_weights
from edged.vision.solid.arcs import arc_shifts
from edged.vision.solid.edgemodel import EdgeModel, are_unbroken, chains_of
from edged.vision.solid.lock import FINE_STEPS, Pyramids, lay, scale_at
from edged.vision.solid.params import BREAKS, DECISION, PROFILE
from edged.vision.solid.profiles import Profiles, adjusted, adjusted_to, profiles_of


@dataclass(frozen=True, slots=True, eq=False)
class PosedPair:
    """A pair that shows the part at a pose rig_from_part (4, 4)."""

    images: StereoImages
    pyramids: Pyramids
    pose: FloatArray

    def profiles(self, model: EdgeModel) -> Profiles:
        """Profiles of the pictures along the edges of the model at the pose."""
        return profiles_of(model, self.pyramids, self.images, self.pose, BREAKS.blur_px)

    def fitted(self, model: EdgeModel) -> PosedPair | None:
        """The pair at the pose fitted to the profiles of a model; None if they show too little."""
        fit = adjusted(model, self.pyramids, self.images, self.pose, BREAKS.blur_px)
        return None if fit is None else replace(self, pose=fit.pose)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """A pair at a fitted pose, the profiles of that fit, and what it leaves (M,) px of their shifts."""

    view: PosedPair
    profiles: Profiles
    left_px: FloatArray

    @classmethod
    def of(
        cls, model: EdgeModel, view: PosedPair, number: int, held: FloatArray | None, *, alike: bool
    ) -> _Fit | None:
        """The fit of one round, counted from 0, to profiles at a view's pose; None if too little shows."""
        profiles = view.profiles(model)
        first_sigma_px = PROFILE.first_sigmas_px[min(number, 1)]
        fit = adjusted_to(model, view.pose, profiles, first_sigma_px, held, alike)
        if fit is None:
            return None
        twist = twist_between(model, view.pose, fit.pose)
        left_px = profiles.shift_px - profiles.seen.design @ twist
        return cls(replace(view, pose=fit.pose), profiles, left_px)


@dataclass(frozen=True, slots=True, eq=False)
class RefinedForm:
    """A model with fitted breaks, and the pairs at the fitted poses.

    sigma_mm : of each curve's width.  sigma_common_mm : of all together.
    squares : for each pair, (M,) square misfits of the profiles, px², at most 1, which a profile that shows
    nothing has.  contradicts : mean over profiles that show something.  cost : mean over all, where one that
    shows nothing of an edge of a break counts half: light shows each edge only about half of the time.
    """

    model: EdgeModel
    views: tuple[PosedPair, ...]
    sigma_mm: float
    sigma_common_mm: float
    squares: tuple[FloatArray, ...]
    contradicts: float
    cost: float

    @property
    def misfit(self) -> float:
        """Mean square of all profiles, px²."""
        return float(np.concatenate(self.squares).mean())

    def sigmas_behind(self, better: RefinedForm, k: int | None = None) -> float:
        """Sigmas by which the misfit exceeds that of another form; profiles with a common error count once.

        k : of this pair alone; None: of all.
        """
        mine, others = (
            np.concatenate(form.squares) if k is None else form.squares[k] for form in (self, better)
        )
        return sigmas_behind(mine, others)


def sigmas_behind(mine: FloatArray, others: FloatArray) -> float:
    """Sigmas by which the mean of misfits (N,) exceeds that of others (M,)."""
    variance = sum(float(each.var()) / (len(each) / BREAKS.correlated) for each in (mine, others))
    return float(mine.mean() - others.mean()) / max(math.sqrt(variance), 1e-12)


def likely_by(behind: FloatArray) -> FloatArray:
    """(K,) probabilities of forms or poses whose misfits are so many sigmas (K,) behind the chosen one's."""
    likely = np.exp(-0.5 * np.square(np.maximum(behind, 0.0)))
    return np.asarray(likely / likely.sum())


def spread_of(twists: FloatArray, likely: FloatArray) -> FloatArray:
    """(6, 6) covariance by others (K) that may be true: their twists (K, 6) from the chosen one, by (K,)."""
    return np.asarray((likely[:, None] * twists).T @ twists)


def refined(
    model: EdgeModel,
    views: Sequence[PosedPair],
    held: FloatArray | None = None,
    rounds: int = BREAKS.rounds,
    *,
    needed: bool = True,
) -> RefinedForm | None:
    """Fit poses and breaks in turn, from breaks of one width; None if the pairs show too little.

    held : as in `adjusted`.  needed : drop the breaks that a sharp edge explains as well.
    """
    sigma = common = 0.0
    now: Sequence[PosedPair] = views
    for number in range(1 + (rounds if model.breaks_mm.any() else 1)):
        fits = [fit for view in now if (fit := _Fit.of(model, view, number, held, alike=True)) is not None]
        if not fits:
            return None
        now = [fit.view for fit in fits]
        if number and model.breaks_mm.any():  # the first motion is of a pixel or two, and no width's
            widths, sigma, common = _widths_by(model, fits)
            model = with_breaks(model, widths)
    if needed and model.breaks_mm.any():
        model = _without_needless(model, now)
    found = [misfits_of(model, [view]) for view in now]
    squares = tuple(square for _, square, _ in found)
    shown = [square[good] for _, square, good in found]
    if not all(len(each) for each in shown):
        return None
    contradicts = float(np.concatenate(shown).mean())
    costs = [np.where(good | are_unbroken(edge), square, 0.5 * square) for edge, square, good in found]
    cost = float(np.concatenate(costs).mean())
    return RefinedForm(model, tuple(now), sigma, common, squares, contradicts, cost)


def contradiction(model: EdgeModel, view: PosedPair) -> float:
    """`RefinedForm.contradicts` of a model at its pose, with free places of its edges on arcs of breaks.

    0 if no profile shows anything.
    """
    profiles = view.profiles(model)
    arcs = arc_shifts(profiles.seen, profiles.camera, profiles.across_px)
    left, good = arcs.free(weights_of(profiles), profiles.shift_px), profiles.weight > BREAKS.min_weight
    return float(np.minimum(left[good] ** 2, 1.0).mean()) if good.any() else 0.0


def misfits_of(model: EdgeModel, views: Sequence[PosedPair]) -> tuple[I64, FloatArray, B8]:
    """Edge, square misfit px², at most 1, of each profile (M,), and whether it shows anything."""
    found = [view.profiles(model) for view in views]
    edge = np.concatenate([profiles.seen.curve for profiles in found])
    weight = np.concatenate([profiles.weight for profiles in found])
    shift = np.concatenate([profiles.shift_px for profiles in found])
    good = weight > BREAKS.min_weight
    return edge, np.where(good, np.minimum(shift**2, 1.0), 1.0), good


def _without_needless(model: EdgeModel, views: Sequence[PosedPair]) -> EdgeModel:
    """The model without the breaks of curves that a sharp edge explains as well."""
    sharp = with_breaks(model, 0.0)
    with_own, without = (mean_misfits(variant, views) for variant in (model, sharp))
    return with_breaks(model, np.where(are_needed(with_own, without)[model.chain], model.breaks_mm, 0.0))


def are_needed(with_own: FloatArray, without: FloatArray) -> B8:
    """(C,) which curves need their breaks: two edges can imitate one, so they must be clearly better."""
    return np.asarray(with_own < without * (1 - BREAKS.better))


def mean_misfits(model: EdgeModel, views: Sequence[PosedPair]) -> FloatArray:
    """(C,) mean square misfit of each curve's profiles, px²; 1 for a curve without any."""
    edge, square, _ = misfits_of(model, views)
    curve, count = chains_of(edge), int(model.chain.max()) + 1
    many = np.bincount(curve, minlength=count)
    return np.where(many > 0, np.bincount(curve, square, minlength=count) / np.maximum(many, 1), 1.0)


def with_breaks(model: EdgeModel, widths_mm: FloatArray | float) -> EdgeModel:
    """The model with edge breaks of widths (E,), or of one width, at its sharp outer edges."""
    widths = np.where(model.breakable, np.clip(widths_mm, 0.0, BREAKS.most_mm), 0.0)
    return replace(model, breaks_mm=np.where(widths < BREAKS.least_mm, 0.0, widths))


def weights_of(profiles: Profiles) -> FloatArray:
    """(M,) weights, 1 / px², of the profiles' shifts against a model; 0 where a profile shows nothing."""
    base = profiles.weight
    return np.where(base > BREAKS.min_weight, 1 / (1 / np.maximum(base, 1e-9) + BREAKS.model_px**2), 0.0)


def as_shown(
    model: EdgeModel, view: PosedPair, held: FloatArray | None = None
) -> tuple[EdgeModel, PosedPair]:
    """Fit the widths of known breaks to a pair, in turn with its pose.

    Light and view decide where on a break an edge shows: with the widths of another pair, each curve is off
    by its own amount, and shifts and tilts the part. By how much curves moved, rms, each may still be wrong.
    held : as in `adjusted`.
    """
    known_mm = model.breaks_mm
    for number in range(BREAKS.rounds if known_mm.any() else 0):
        fit = _Fit.of(model, view, number, held, alike=False)
        if fit is None:
            break
        model, view = with_breaks(model, _widths_by(model, [fit])[0]), fit.view
    _, each = np.unique(np.where(known_mm > 0, model.chain, -1), return_index=True)
    apart_mm = (model.breaks_mm - known_mm)[each][known_mm[each] > 0]
    own_mm = math.sqrt(float(np.mean(apart_mm**2))) if len(apart_mm) else 0.0
    return replace(model, sigma_own_mm=own_mm), view


def widths_by_profiles(model: EdgeModel, views: Sequence[PosedPair]) -> tuple[FloatArray, float, float]:
    """Widths (E,) of the breaks by the profiles of pairs, each curve's own; their sigma, and that of all."""
    found = [(view, view.profiles(model)) for view in views]
    return _widths_by(model, [_Fit(view, profiles, profiles.shift_px) for view, profiles in found])


def _widths_by(model: EdgeModel, fits: Sequence[_Fit]) -> tuple[FloatArray, float, float]:
    """`widths_by_profiles` from what fits leave of the shifts of their profiles."""
    count = int(model.chain.max()) + 1
    power, pull = np.zeros(count), np.zeros(count)
    for fit in fits:
        profiles, shift = fit.profiles, fit.left_px
        curve, by_break = chains_of(profiles.seen.curve), profiles.by_width
        weight = np.where(np.abs(by_break) > 0, weights_of(profiles), 0.0)
        used = weight > 0
        if used.any():
            weight *= tukey_weights(shift, max(mad_sigma(shift[used]), BREAKS.min_sigma_px))
        power += np.bincount(curve, weight * by_break**2, minlength=count) / BREAKS.correlated
        pull += np.bincount(curve, weight * by_break * shift, minlength=count) / BREAKS.correlated
    # breaks of a part are mostly alike
    common = float(pull.sum() / max(power.sum(), 1e-9))
    own = (pull + common * BREAKS.alike_mm**-2) / (power + BREAKS.alike_mm**-2)
    widths = model.breaks_mm + np.where(model.breaks_mm > 0, own[model.chain], 0.0)
    seen = power[power > 0]
    if not len(seen):
        return widths, BREAKS.alike_mm, BREAKS.alike_mm
    sigma = float(np.median(1 / np.sqrt(seen + BREAKS.alike_mm**-2)))
    return widths, sigma, 1 / math.sqrt(float(seen.sum()))


@dataclass(frozen=True, slots=True, eq=False)
class FormChoice:
    """The form of the breaks that pairs show best.

    forms : those that were tried, None where a pair shows too little of it.  likely : probability of each.
    between : for each pair (6, 6), covariance of the twist by other forms that explain the pairs nearly as
    well; as in `ProfileFit`.
    """

    form: RefinedForm
    forms: tuple[RefinedForm | None, ...]
    likely: FloatArray
    between: tuple[FloatArray, ...]

    @property
    def others(self) -> list[RefinedForm]:
        """Forms that are far less likely."""
        return [
            form
            for form, share in zip(self.forms, self.likely, strict=True)
            if form is not None and share < DECISION.likely
        ]


def likeliest_form(
    models: Sequence[EdgeModel], views: Sequence[PosedPair], held: FloatArray | None = None
) -> FormChoice | None:
    """Choose the one of a part's models that pairs show, and fit its break widths; None if too little shows.

    Others count by the likelihood that their misfit is worse by chance. Source: J. A. Hoeting et al.,
    "Bayesian model averaging: a tutorial", Statistical Science 14, 1999.

    views : pairs at poses good to a pixel or two.  held : as in `adjusted`.
    """

    def once_refined(model: EdgeModel) -> RefinedForm | None:
        """A form after one round; None if a pair shows too little of it."""
        laid = [there for view in views if (there := _laid(model, view)) is not None]
        form = refined(model, laid, held, 1, needed=False) if len(laid) == len(views) else None
        return form if form is not None and len(form.views) == len(views) else None

    forms = for_each(once_refined, models)
    if not any(forms):
        return None
    roughly = min((form for form in forms if form is not None), key=lambda form: form.misfit)

    def again_if_likely(form: RefinedForm | None) -> RefinedForm | None:
        """A form that is not far behind the best, after more rounds."""
        if form is None or form.sigmas_behind(roughly) >= BREAKS.in_question:
            return form
        return refined(form.model, form.views, held, BREAKS.rounds_of_choice) or form

    forms = for_each(again_if_likely, forms)
    known = [form for form in forms if form is not None]
    best = min(known, key=lambda form: form.misfit)
    behind = [math.inf if form is None else form.sigmas_behind(best) for form in forms]
    likely = likely_by(np.array(behind))
    between: list[FloatArray] = []
    for k, view in enumerate(best.views):
        twists = np.array(
            [
                np.zeros(6) if form is None else twist_between(best.model, view.pose, form.views[k].pose)
                for form in forms
            ]
        )
        between.append(spread_of(twists, likely))
    by_light_mm = PROFILE.light_px / min(scale_at(v.images.rig, v.pose, best.model) for v in best.views)
    # all breaks get the median width: a curve's own width absorbs whatever else is wrong there
    broken = best.model.breaks_mm[best.model.breaks_mm > 0]
    model = best.model
    if len(broken):
        common = np.where(model.breaks_mm > 0, float(np.median(broken)), 0.0)
        model = replace(
            with_breaks(model, common),
            sigma_break_mm=math.hypot(best.sigma_common_mm, 2 * by_light_mm),
        )
    return FormChoice(replace(best, model=model), tuple(forms), likely, tuple(between))


def _laid(model: EdgeModel, view: PosedPair) -> PosedPair | None:
    laid = lay(model, view.pyramids, view.pose, FINE_STEPS)
    return None if laid is None else replace(view, pose=laid.pose)


def twist_between(model: EdgeModel, pose: FloatArray, other: FloatArray) -> FloatArray:
    """Twist (6,) from one pose to another, as `moved` takes it."""
    inward = pose[:3, :3].T
    shift = inward @ (apply(other, model.centre) - apply(pose, model.centre))
    return np.concatenate([rotation_vector(inward @ other[:3, :3]), shift])
