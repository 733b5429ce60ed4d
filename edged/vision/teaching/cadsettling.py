"""Combine a job taught from a pair with the part's CAD model.

Where a taught curve agrees with the model, the model's numbers are better than any picture's and replace it.
Where an edge break displaces it, the picture is right: the break is reported, and the curve stays as seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.errors import TeachError
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply, unit
from edged.vision.part.job import CircleFeature, EdgeFeature, Job, ResultLimits
from edged.vision.part.params import MEASURING
from edged.vision.solid.breaks import FittedBody, lay_with_breaks, likeliest
from edged.vision.solid.edgemodel import model_of, widths_of
from edged.vision.solid.evidence import sigmas_of
from edged.vision.solid.params import BREAKS, DECISION
from edged.vision.solid.symmetry import equal_turns
from edged.vision.teaching.cadbody import body_of
from edged.vision.teaching.cadmatch import ModelRegistration, Partner, register
from edged.vision.teaching.cadmodel import ModelCircle, ModelCurves
from edged.vision.teaching.cadrevision import another_revision
from edged.vision.teaching.params import CAD


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """A job registered with its model, and remarks for the user."""

    job: Job
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Reach:
    """Tolerances within which a taught curve agrees with the model: in the face, and along z."""

    aside_mm: float
    depth_mm: float


def settle(job: Job, model: ModelCurves, images: StereoImages, what: str) -> Settled:
    """Give a job the model's numbers, as far as the pair agrees with them, and the model's frame.

    images : the pair that the job was taught from.  what : the model's name, for messages.
    Raises `TeachError` for the model of another part, of its mirror image or of another revision.
    """
    rectification = images.rectification

    def tell(poses: Sequence[FloatArray]) -> int | None:
        """Choose the pose of the model by all its edges in the pictures, beyond the taught curves."""
        drawn = body_of(model.model, np.eye(4))
        if drawn is None:
            return None
        return likeliest(images, model_of(drawn), [job.rig_from_part @ pose for pose in poses])

    found = register(job.circles, job.edges, model, what, tell)
    depth_mm = float(job.rig_from_part[2, 3])
    aside_mm = MEASURING.displaced_px * depth_mm / rectification.focal_px
    reach = _Reach(aside_mm, aside_mm * max(1.0, depth_mm / rectification.baseline_mm))
    partners = {partner.name: partner for partner in found.partners}
    _check_revision(job, model, found, reach, what)
    settled = [name for name, partner in partners.items() if _agrees(job, partner, reach, model)]
    part_from_model = found.part_from_model
    body = body_of(model.model, part_from_model)
    laid, measured = laid_on_pair(replace(job, part_from_model=part_from_model, body=body), images, what)
    circles = tuple(
        replace(
            circle,
            centre_mm=_snapped(apply(part_from_model, model.circles[partners[circle.name].index].centre_mm)),
            radius_mm=_radius_mm(circle, model.circles[partners[circle.name].index]),
        )
        if circle.name in settled
        else circle
        for circle in job.circles
    )
    faceted = {circle.name: model.circles[partners[circle.name].index].sigma_mm for circle in job.circles
               if circle.name in settled}  # fmt: skip
    used = [sigma_mm for sigma_mm in faceted.values() if sigma_mm <= CAD.fine_mm]
    edges = tuple(
        _on_model(edge, model, partners[edge.name], part_from_model) if edge.name in settled else edge
        for edge in job.edges
    )
    taken = replace(
        laid,
        circles=circles,
        edges=edges,
        sigma_mm=round(
            math.hypot(
                laid.sigma_mm, max(used, default=0.0), max(_contradicting(found, settled), default=0.0)
            ),
            6,
        ),
    )
    remarks = _summary(settled, found, what), *_breaks(found.partners, settled), *_others(found)
    return Settled(taken, (*remarks, *_coarse(faceted), *measured, *same_after_turns(taken)))


def same_after_turns(job: Job) -> tuple[str, ...]:
    """A remark on a part whose surface is the same after a turn; none on others."""
    turns = equal_turns(job.body)
    if turns.order == 1:
        return ()
    if turns.is_round:
        return ("round: the same after any turn about its axis, and results leave that open",)
    step = f"{360 / turns.order:g}°"
    return (f"the same after each turn of {step}: results have the one nearest to the taught turn",)


def laid_on_pair(job: Job, images: StereoImages, what: str) -> tuple[Job, list[str]]:
    """Fit the job's body, with edge breaks that the file lacks, to the pair; also remarks for the user.

    Raises `TeachError` for a pair that does not show it there.
    """
    if job.body is None:
        return job, []
    laid = lay_with_breaks(images, model_of(job.body), job.rig_from_part)
    if laid is None or sigmas_of(laid.evidence.log_ratio()) < DECISION.certain:
        raise TeachError(
            f"{what}: the pair shows too few of the model's edges where its curves say it lies: expected "
            "the model of this part, and a pair that shows it whole",
            "not_shown",
        )
    hidden_mm = laid.sigma_hidden_mm
    # by more than a model alone is good to; of a part that looks sharp, edges that do not fit have to say so
    is_in_doubt = laid.is_certain or laid.contradicts > 0.5 * BREAKS.most_misfit
    if is_in_doubt and hidden_mm > CAD.sigma_mm:
        limits = _wider(replace(job.limits, max_sigma_mm=CAD.max_sigma_mm), 3 * CAD.sigma_mm)
        hidden = f"edge breaks: this pair may hide some ({hidden_mm:.2f} mm): each picture is to show them"
        return replace(job, break_mm=None, rig_from_part=laid.fit.pose, limits=limits), [hidden]
    taken, remarks = with_own_breaks(job, laid)
    taken = replace(taken, rig_from_part=laid.fit.pose)
    if laid.is_certain or not laid.model.breaks_mm.any():
        return taken, remarks
    # breaks by which the part fits better, and that may be others or none
    limits = replace(taken.limits, max_sigma_mm=CAD.max_sigma_mm)
    unsure = f"this pair shows them with little certainty: results state {hidden_mm:.2f} mm more"
    sigma_mm = round(math.hypot(job.sigma_mm, hidden_mm / MEASURING.across), 6)
    return replace(taken, limits=limits, sigma_mm=sigma_mm), [*remarks, unsure]


def with_own_breaks(job: Job, laid: FittedBody) -> tuple[Job, list[str]]:
    """The job with the edge breaks of its body as fitted to a pair; also a remark, if there are any."""
    assert job.body is not None
    widths = widths_of(job.body.lines[:, :2], laid.model.sides, laid.model.breaks_mm)
    sigma_mm, merged_mm = laid.sigma_break_mm, laid.merged_mm
    body = replace(job.body, breaks_mm=widths, sigma_break_mm=sigma_mm, merged_mm=merged_mm)
    limits = _wider(job.limits, float(widths.max(initial=0.0)))
    return replace(job, body=body, break_mm=None, limits=limits), _said(widths)


def _wider(limits: ResultLimits, by_mm: float) -> ResultLimits:
    """Limits with a wider tolerance of radii: other light may show the other edge of a rim's break."""
    if limits.radius_tolerance_mm is None:
        return limits
    return replace(limits, radius_tolerance_mm=round(limits.radius_tolerance_mm + by_mm, 4))


def _said(widths_mm: FloatArray) -> list[str]:
    """Remark on the edge breaks, if there are any."""
    broken = widths_mm[widths_mm > 0]
    if not len(broken):
        return []
    low, high = np.percentile(broken, (5, 95))
    return [f"edge breaks of {low:.2f} to {high:.2f} mm that the model does not have, by the pair"]


def _radius_mm(seen: CircleFeature, drawn: ModelCircle) -> float:
    return drawn.radius_mm if drawn.sigma_mm <= CAD.fine_mm else seen.radius_mm


def _coarse(faceted: Mapping[str, float]) -> list[str]:
    """Remark on circles whose chords in the file determine the radius less well than the pair does."""
    coarse = {name: sigma_mm for name, sigma_mm in faceted.items() if sigma_mm > CAD.fine_mm}
    if not coarse:
        return []
    return [
        f"radius as seen, for its chords in the file leave {max(coarse.values()):.3f} mm open: "
        f"{', '.join(coarse)}"
    ]


def _snapped(point: FloatArray) -> FloatArray:
    """Round to 1e-9 mm, without the rounding errors of the motion."""
    return np.round(point, 9) + 0.0


def _agrees(job: Job, partner: Partner, reach: _Reach, model: ModelCurves) -> bool:
    sigma_mm = 3 * model.circles[partner.index].sigma_mm if partner.kind == "circle" else 0.0
    return (
        partner.aside <= _aside_limit(job, partner.name, reach)
        and abs(partner.wider) <= _aside_limit(job, partner.name, reach) + sigma_mm
        and abs(partner.deeper) <= reach.depth_mm
    )


def _aside_limit(job: Job, name: str, reach: _Reach) -> float:
    arm = job.place_of(name) - job.place_of(job.reference)
    return reach.aside_mm + CAD.scale_share * float(np.linalg.norm(arm[:2]))


def _on_model(
    edge: EdgeFeature, model: ModelCurves, partner: Partner, part_from_model: FloatArray
) -> EdgeFeature:
    """Project the edge that the pair shows onto the model's line."""
    line = model.edges[partner.index]
    start, end = (apply(part_from_model, point) for point in (line.start_mm, line.end_mm))
    along = unit(end - start)
    ends = [
        _snapped(start + float((point - start) @ along) * along) for point in (edge.start_mm, edge.end_mm)
    ]
    return replace(edge, start_mm=ends[0], end_mm=ends[1])


def _check_revision(job: Job, model: ModelCurves, found: ModelRegistration, reach: _Reach, what: str) -> None:
    """Raise `TeachError` if a circle is off as no edge break explains: aside, narrower or higher."""
    worst: tuple[float, str] = (1.0, "")
    for partner in found.partners:
        if partner.kind != "circle":
            continue
        circle = model.circles[partner.index]
        limit = _aside_limit(job, partner.name, reach)
        whose = f"{partner.name} is {circle.words}"
        if partner.aside / limit > worst[0]:
            worst = partner.aside / limit, f"{whose} and lies {partner.aside:.3f} mm aside"
        narrow = -partner.wider / (limit + 3 * circle.sigma_mm)
        if narrow > worst[0]:
            sense = "smaller" if circle.hole else "larger"
            worst = narrow, f"{whose} and its radius is {-partner.wider:.3f} mm {sense}"
        if -partner.deeper / reach.depth_mm > worst[0]:
            worst = -partner.deeper / reach.depth_mm, f"{whose} and lies {-partner.deeper:.3f} mm higher"
    if worst[1]:
        raise another_revision(what, worst[1])


def _summary(settled: Sequence[str], found: ModelRegistration, what: str) -> str:
    return (
        f"{what}: {len(settled)} of {len(found.partners) + len(found.missing)} curves lie where it has them"
    )


def _breaks(partners: Sequence[Partner], settled: Sequence[str]) -> list[str]:
    """Remarks on what displaces the unsettled curves, one for each cause."""
    remarks = []
    others = [partner for partner in partners if partner.name not in settled]
    broken = [partner for partner in others if max(partner.wider, partner.deeper) > CAD.min_break_mm]
    for which, seen in (
        ("upper", {partner.name: partner.wider for partner in broken if partner.wider >= partner.deeper}),
        ("lower", {partner.name: partner.deeper for partner in broken if partner.wider < partner.deeper}),
    ):
        if seen:
            low, high = f"{min(seen.values()):.3f}", f"{max(seen.values()):.3f}"
            size = low if low == high else f"{low} to {high}"
            remarks.append(
                f"an edge break of {size} mm that the model does not show, seen by its {which} edge: "
                f"{', '.join(seen)}: kept as seen"
            )
    odd = {partner.name: _off(partner) for partner in others if partner not in broken}
    if odd:
        remarks.append(
            f"up to {max(odd.values()):.3f} mm off the model, which no edge break explains: "
            f"{', '.join(odd)}: the others may be seen by the lower edges of breaks; results state so much "
            "as their sigma"
        )
    return remarks


def _off(partner: Partner) -> float:
    return max(partner.aside, abs(partner.wider), abs(partner.deeper))


def _contradicting(found: ModelRegistration, settled: Sequence[str]) -> list[float]:
    """Deviations of curves from the model that no edge break explains: they cast doubt on the settled ones.

    A hole with a broken edge has the model's radius at the lower edge of the break. If most holes are seen by
    that edge, the part stands higher by the break than it appears, and correctly seen curves do not fit.
    """
    left = [partner for partner in found.partners if partner.name not in settled]
    return [_off(partner) for partner in left if max(partner.wider, partner.deeper) <= CAD.min_break_mm]


def _others(found: ModelRegistration) -> list[str]:
    if not found.missing:
        return []
    return [f"not in the model, kept as seen: {', '.join(found.missing)}"]
