"""Register a taught part with its CAD model: which curves correspond, and by how much they differ.

Teaching shows which edges the cameras see, and of what sign. The model says where they should be. An edge
break that the model does not have displaces a curve into the material and down; a curve that lies elsewhere
belongs to another revision; a part that fits only as a mirror image is a different part.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.errors import TeachError
from edged.vision.geometry.rigid import about_z, transform, unit
from edged.vision.part.job import CircleFeature, EdgeFeature
from edged.vision.teaching.cadmodel import ModelCurves
from edged.vision.teaching.params import CAD


@dataclass(frozen=True, slots=True, eq=False)
class Partner:
    """A taught curve and the model's curve that it corresponds to. All in mm, taught minus model.

    index : of the model's circle or edge.  aside : distance of centres; of an edge, half the difference of
    the offsets of its ends.  wider : as an edge break displaces a curve: larger radius of a hole, smaller one
    of a boss; of an edge, into the material.  deeper : along z of the part frame.
    """

    name: str
    kind: str
    index: int
    aside: float
    wider: float
    deeper: float


@dataclass(frozen=True, slots=True, eq=False)
class ModelRegistration:
    """The pose of a model, part_from_model (4, 4), and its curves that were taught.

    partners : of the taught curves.  missing : names of the taught curves without one.
    """

    part_from_model: FloatArray
    partners: tuple[Partner, ...]
    missing: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Curves:
    """Circles (N, 4): x, y, z, radius.  edges (M, 2, 3)."""

    circles: FloatArray
    edges: FloatArray

    @property
    def count(self) -> int:
        return len(self.circles) + len(self.edges)


def register(
    circles: Sequence[CircleFeature],
    edges: Sequence[EdgeFeature],
    model: ModelCurves,
    what: str,
    tell: Callable[[Sequence[FloatArray]], int | None] = lambda _poses: None,
) -> ModelRegistration:
    """Find the pose of a model in the part frame of taught circles and edges.

    The model's up is taken to be the part's -z.  what : the model's name, for messages.
    tell : chooses between several part_from_model (4, 4) where the curves alone do not; None: unknown.
    Raises `TeachError` if it does not fit, fits in more than one way, or fits only as a mirror image.
    """
    if not model.circles and not model.edges:
        raise TeachError(
            f"{what}: no circle and no straight edge looks to the cameras: expected another up axis, the one "
            "of the file that points to them"
        )
    turned = levelled(model.up)
    taught = _Curves(
        np.array([[*circle.centre_mm, circle.radius_mm] for circle in circles]).reshape(-1, 4),
        np.array([[edge.start_mm, edge.end_mm] for edge in edges]).reshape(-1, 2, 3),
    )
    drawn = _drawn(model, turned)
    found = _laid(taught, drawn)
    flipped = np.diag([-1.0, 1.0, 1.0])
    mirrored = _laid(taught, _mapped(drawn, flipped))
    best, mirror = (0.0 if not fits else fits[0][0] for fits in (found, mirrored))
    needed = max(CAD.min_matched * taught.count, CAD.min_curves if taught.count > 1 else 1) * 0.5
    if mirror > max(best + 0.5, needed):
        raise TeachError(
            f"{what}: fits the part only as seen in a mirror: expected the model of this part, not of its "
            "counterpart, and its up axis as the part lies"
        )
    if not found:
        raise TeachError(_no_fit(what, 0, taught.count), "no_fit")
    rivals = _rivals(found, drawn)
    which = tell([rival @ transform(turned, np.zeros(3)) for rival in rivals]) if len(rivals) > 1 else 0
    if which is None:
        turn = round(abs(math.degrees(_turn_of(np.linalg.inv(rivals[0]) @ rivals[1]))))
        otherwise = f"turned by {turn}°" if turn else "at another of its holes"
        raise TeachError(
            f"{what}: fits the part {otherwise} as well: expected a pair that shows what tells its rotation",
            "open_turn",
        )
    pose, partners = _refined(circles, edges, taught, model, drawn, rivals[which])
    if len(partners) < max(CAD.min_matched * taught.count, min(CAD.min_curves, taught.count)):
        raise TeachError(_no_fit(what, len(partners), taught.count), "no_fit")
    names = {partner.name for partner in partners}
    taught_names = [*(feature.name for feature in circles), *(feature.name for feature in edges)]
    missing = tuple(name for name in taught_names if name not in names)
    return ModelRegistration(pose @ transform(turned, np.zeros(3)), partners, missing)


def _no_fit(what: str, matched: int, count: int) -> str:
    return (
        f"{what}: fits {matched} of the {count} curves that the pair shows: expected the model of this part, "
        "and as its up axis the one that points to the cameras"
    )


def levelled(up: FloatArray) -> FloatArray:
    """(3, 3) rotation that turns up (3,) to -z."""
    z = -unit(up)
    aside = np.eye(3)[int(np.abs(z).argmin())]
    x = unit(aside - (aside @ z) * z)
    return np.stack([x, np.cross(z, x), z])


def _drawn(model: ModelCurves, turned: FloatArray) -> _Curves:
    circles = np.array([[*(turned @ circle.centre_mm), circle.radius_mm] for circle in model.circles])
    edges = np.array([[turned @ edge.start_mm, turned @ edge.end_mm] for edge in model.edges])
    return _Curves(circles.reshape(-1, 4), edges.reshape(-1, 2, 3))


def _mapped(curves: _Curves, rotation: FloatArray, shift: FloatArray | None = None) -> _Curves:
    by = np.zeros(3) if shift is None else shift
    circles = np.column_stack([curves.circles[:, :3] @ rotation.T + by, curves.circles[:, 3:]])
    return _Curves(circles, curves.edges @ rotation.T + by)


# --- hypotheses ----------------------------------------------------------------------------------------


def _laid(taught: _Curves, drawn: _Curves) -> list[tuple[float, FloatArray]]:
    """Candidate poses of a model on the part: score and pose (4, 4), best first, without near duplicates."""
    starts = _starts(taught, drawn)
    if not len(starts):
        return []
    scores = np.concatenate(
        [_scores(taught, drawn, starts[k : k + CAD.chunk]) for k in range(0, len(starts), CAD.chunk)]
    )
    kept: list[tuple[float, FloatArray]] = []
    seen: list[FloatArray] = []
    for k in np.argsort(-scores, kind="stable")[:2000]:
        turn, *shift = starts[k]
        if scores[k] <= 0 or len(kept) >= 30:
            break
        if any(
            abs(math.remainder(turn - other[0], math.tau)) < 2 * CAD.same_turn_rad
            and float(np.abs(other[1:] - shift).max()) < 2 * CAD.near_mm
            for other in seen
        ):
            continue
        seen.append(starts[k])
        kept.append((float(scores[k]), transform(about_z(turn), np.array(shift))))
    return kept


def _starts(taught: _Curves, drawn: _Curves) -> FloatArray:
    """Hypotheses (K, 4), turn about z and shift, from pairs of circles and from parallel edges."""
    starts = _by_circles(taught, drawn)
    turns = _turns_of_edges(taught, drawn)
    for turn, pairs in turns:
        rotation = about_z(turn)
        turned = _mapped(drawn, rotation)
        for c, d in itertools.product(range(len(taught.circles)), range(len(drawn.circles))):
            if abs(taught.circles[c, 3] - drawn.circles[d, 3]) < CAD.break_mm:
                starts.append([turn, *(taught.circles[c, :3] - turned.circles[d, :3])])
        starts += _by_edges(taught, turned, turn, pairs)
        if len(starts) > CAD.max_starts:
            break
    if len(taught.circles) and not len(taught.edges) and not starts:  # a single circle, or concentric ones
        for c, d in itertools.product(range(len(taught.circles)), range(len(drawn.circles))):
            if abs(taught.circles[c, 3] - drawn.circles[d, 3]) < CAD.break_mm:
                starts.append([0.0, *(taught.circles[c, :3] - drawn.circles[d, :3])])
    return np.array(starts[: CAD.max_starts]).reshape(-1, 4)


def _by_circles(taught: _Curves, drawn: _Curves) -> list[list[float]]:
    starts: list[list[float]] = []
    gaps = drawn.circles[None, :, :3] - drawn.circles[:, None, :3]
    length = np.linalg.norm(gaps[..., :2], axis=2)
    wide = drawn.circles[:, 3]
    for first, second in itertools.combinations(taught.circles, 2):
        arm = second[:3] - first[:3]
        size = float(np.linalg.norm(arm[:2]))
        if size < CAD.min_arm_mm:
            continue
        like = (np.abs(length - size) < CAD.near_mm) & (np.abs(gaps[..., 2] - arm[2]) < CAD.break_mm)
        fits = [np.abs(wide - circle[3]) < CAD.break_mm for circle in (first, second)]
        like &= fits[0][:, None] & fits[1][None]
        np.fill_diagonal(like, val=False)
        for a, b in np.argwhere(like):
            turn = math.atan2(arm[1], arm[0]) - math.atan2(gaps[a, b, 1], gaps[a, b, 0])
            middle = about_z(turn) @ (0.5 * (drawn.circles[a, :3] + drawn.circles[b, :3]))
            starts.append([turn, *(0.5 * (first[:3] + second[:3]) - middle)])
            if len(starts) > CAD.max_starts // 2:
                return starts
    return starts


def _turns_of_edges(taught: _Curves, drawn: _Curves) -> list[tuple[float, list[tuple[int, int]]]]:
    """Rotations that make edges parallel, each with the pairs of edges; the greatest total length first."""
    if not len(taught.edges) or not len(drawn.edges):
        return []
    along = taught.edges[:, 1] - taught.edges[:, 0]
    size = np.linalg.norm(along, axis=1)
    run = drawn.edges[:, 1] - drawn.edges[:, 0]
    gaps = np.arctan2(along[:, 1], along[:, 0])[:, None] - np.arctan2(run[:, 1], run[:, 0])[None]
    fits = np.linalg.norm(run, axis=1)[None] > 0.6 * size[:, None]
    bins: dict[int, list[tuple[int, int]]] = {}
    for e, f in np.argwhere(fits):
        bins.setdefault(
            round((gaps[e, f] % math.pi) / CAD.turn_bin_rad) % round(math.pi / CAD.turn_bin_rad), []
        ).append((e, f))
    longest = set(np.argsort(-size)[: CAD.longest].tolist())
    order = sorted(bins, key=lambda step: -sum(size[e] for e in {e for e, _ in bins[step]}))
    found = []
    for step in order[: CAD.max_turns]:
        pairs = [(int(e), int(f)) for e, f in bins[step]]
        offset = np.array([math.remainder(gaps[e, f] - step * CAD.turn_bin_rad, math.pi) for e, f in pairs])
        turn = step * CAD.turn_bin_rad + float(np.median(offset))
        chosen = [(e, f) for e, f in pairs if e in longest]
        found += [(turn, chosen), (turn + math.pi, chosen)]
    return found


def _by_edges(
    taught: _Curves, turned: _Curves, turn: float, pairs: Sequence[tuple[int, int]]
) -> list[list[float]]:
    """Turn and shifts that lay two edges that are not parallel on two of the model."""
    starts: list[list[float]] = []
    for (e, f), (g, h) in itertools.combinations(pairs, 2):
        rows, values = [], []
        for mine, yours in ((e, f), (g, h)):
            along = unit(taught.edges[mine, 1] - taught.edges[mine, 0])
            normal = np.array([-along[1], along[0]])
            rows.append(normal)
            values.append(normal @ (taught.edges[mine].mean(axis=0) - turned.edges[yours].mean(axis=0))[:2])
        if e == g or abs(float(np.linalg.det(np.array(rows)))) < 0.3:
            continue
        shift = np.linalg.solve(np.array(rows), np.array(values))
        down = taught.edges[[e, g], 0, 2] - turned.edges[[f, h], 0, 2]
        if abs(down[0] - down[1]) < CAD.break_mm:
            starts.append([turn, *shift, float(down.mean())])
    return starts


def _scores(taught: _Curves, drawn: _Curves, starts: FloatArray) -> FloatArray:
    """(K,) number of taught curves with a partner, each weighted by how well it fits."""
    cosine, sine = np.cos(starts[:, 0]), np.sin(starts[:, 0])
    zero, one = np.zeros_like(cosine), np.ones_like(cosine)
    rotations = np.stack([cosine, -sine, zero, sine, cosine, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
    total = np.zeros(len(starts))
    if len(taught.circles) and len(drawn.circles):
        centres = np.einsum("kij,nj->kni", rotations, drawn.circles[:, :3]) + starts[:, None, 1:]
        wide = np.abs(taught.circles[:, 3][:, None] - drawn.circles[:, 3][None]) / CAD.break_mm
        for k, circle in enumerate(taught.circles):
            gap = centres - circle[:3]
            total += _worth(
                np.linalg.norm(gap[..., :2], axis=2) / CAD.near_mm,
                np.abs(gap[..., 2]) / CAD.break_mm,
                wide[k][None],
            )
    if len(taught.edges) and len(drawn.edges):
        ends = np.einsum("kij,nej->knei", rotations, drawn.edges) + starts[:, None, None, 1:]
        along = ends[:, :, 1] - ends[:, :, 0]
        size = np.linalg.norm(along, axis=2)
        along = along / size[..., None]
        for edge in taught.edges:
            reach = edge[None, None] - ends[:, :, :1]
            across = reach[..., 1] * along[:, :, None, 0] - reach[..., 0] * along[:, :, None, 1]
            middle = np.einsum("knei,kni->kne", reach, along).mean(axis=2)
            worth_of = np.abs(across).max(axis=2) / CAD.break_mm
            within = (middle > -CAD.break_mm) & (middle < size + CAD.break_mm)
            total += _worth(
                np.where(within, worth_of, 2.0), np.abs(reach[..., 0, 2]) / CAD.break_mm, np.zeros((1, 1))
            )
    return total


def _worth(aside: FloatArray, deeper: FloatArray, wide: FloatArray) -> FloatArray:
    """(K,) weight of the best partner: 1 where all differences are 0, 0 where one of them is out of reach."""
    ratio = np.maximum(np.maximum(aside, deeper), np.broadcast_to(wide, aside.shape))
    worth = 1.0 - 0.25 * aside - 0.15 * deeper - 0.15 * np.broadcast_to(wide, aside.shape)
    return np.asarray(np.where(ratio < 1.0, worth, 0.0).max(axis=1))


def _rivals(found: list[tuple[float, FloatArray]], drawn: _Curves) -> list[FloatArray]:
    """The best pose, and others that score as well without being a symmetry of the model."""
    score, pose = found[0]
    itself = _scores(drawn, drawn, np.zeros((1, 4)))[0]
    rivals = [pose]
    for other, there in found[1:]:
        if other < score * (1 - CAD.rival):
            break
        motion = np.linalg.inv(pose) @ there
        if _scores(drawn, drawn, np.array([[_turn_of(motion), *motion[:3, 3]]]))[0] < 0.95 * itself:
            rivals.append(there)
    return rivals


def _turn_of(motion: FloatArray) -> float:
    return math.atan2(motion[1, 0], motion[0, 0])


# --- refinement -----------------------------------------------------------------------------------------


def _refined(
    circles: Sequence[CircleFeature],
    edges: Sequence[EdgeFeature],
    taught: _Curves,
    model: ModelCurves,
    drawn: _Curves,
    pose: FloatArray,
) -> tuple[FloatArray, tuple[Partner, ...]]:
    """Refine a pose (4, 4) to least absolute differences; also the resulting partners."""
    turn, shift = math.atan2(pose[1, 0], pose[0, 0]), pose[:3, 3].copy()
    partners: list[Partner] = []
    for _ in range(CAD.refined):
        laid = _mapped(drawn, about_z(turn), shift)
        partners = _partners(circles, edges, taught, model, laid)
        rows, values, weights, down = [], [], [], []
        for partner in partners:
            if partner.kind == "circle":
                k = next(k for k, c in enumerate(circles) if c.name == partner.name)
                gap = taught.circles[k, :3] - laid.circles[partner.index, :3]
                x, y = laid.circles[partner.index, :2] - shift[:2]
                weight = 1.0 / max(float(np.hypot(*gap[:2])), CAD.floor_mm)
                rows += [[1.0, 0.0, -y], [0.0, 1.0, x]]
                values += list(gap[:2])
                weights += [weight, weight]
            else:
                k = next(k for k, e in enumerate(edges) if e.name == partner.name)
                along = unit(laid.edges[partner.index, 1] - laid.edges[partner.index, 0])
                for end in taught.edges[k]:
                    normal = np.array([-along[1], along[0]])
                    off = float(normal @ (end - laid.edges[partner.index, 0])[:2])
                    x, y = end[:2] - shift[:2]
                    rows.append([normal[0], normal[1], normal[1] * x - normal[0] * y])
                    values.append(off)
                    weights.append((CAD.edge_weight if circles else 1.0) / max(abs(off), CAD.floor_mm))
            down.append(partner.deeper)
        if not rows:
            break
        root = np.sqrt(np.array(weights))[:, None]
        step = np.linalg.lstsq(root * np.array(rows), root[:, 0] * np.array(values), rcond=None)[0]
        shift[:2] += step[:2]
        turn += float(step[2])
        shift[2] += float(np.median(down))
    laid = _mapped(drawn, about_z(turn), shift)
    return transform(about_z(turn), shift), tuple(_partners(circles, edges, taught, model, laid))


def _partners(
    circles: Sequence[CircleFeature],
    edges: Sequence[EdgeFeature],
    taught: _Curves,
    model: ModelCurves,
    laid: _Curves,
) -> list[Partner]:
    """Match each taught curve with the nearest curve of the laid model, if one is within reach."""
    found: list[Partner] = []
    for k, circle in enumerate(circles):
        if not len(laid.circles):
            break
        gap = taught.circles[k, :3] - laid.circles[:, :3]
        aside = np.linalg.norm(gap[:, :2], axis=1)
        wider = taught.circles[k, 3] - laid.circles[:, 3]
        off = np.hypot(np.hypot(aside, wider), gap[:, 2])
        at = int(off.argmin())
        if aside[at] < CAD.near_mm and abs(wider[at]) < CAD.break_mm and abs(gap[at, 2]) < CAD.break_mm:
            outwards = 1.0 if model.circles[at].hole else -1.0
            values = float(aside[at]), outwards * float(wider[at]), float(gap[at, 2])
            found.append(Partner(circle.name, "circle", at, *values))
    for k, edge in enumerate(edges):
        near = _nearest_edge(taught.edges[k], model, laid)
        if near is not None:
            found.append(Partner(edge.name, "edge", *near))
    return found


def _nearest_edge(
    ends: FloatArray, model: ModelCurves, laid: _Curves
) -> tuple[int, float, float, float] | None:
    best: tuple[float, int, float, float, float] | None = None
    for at, line in enumerate(laid.edges):
        size = float(np.linalg.norm(line[1] - line[0]))
        along = (line[1] - line[0]) / size
        reach = ends - line[0]
        middle = float(reach.mean(axis=0) @ along)
        across = reach[:, 1] * along[0] - reach[:, 0] * along[1]
        deeper = float(reach[:, 2].mean())
        angle = math.atan2(abs(float(across[1] - across[0])), float(np.linalg.norm(ends[1] - ends[0])))
        if not -CAD.break_mm < middle < size + CAD.break_mm or angle > CAD.same_turn_rad:
            continue
        offset = float(across.mean())
        off = math.hypot(offset, deeper)
        if abs(offset) < CAD.break_mm and abs(deeper) < CAD.break_mm and (best is None or off < best[0]):
            best = off, at, abs(float(across[1] - across[0])) / 2, -offset * _side(model, at), deeper
    return None if best is None else best[1:]


def _side(model: ModelCurves, at: int) -> float:
    """+1 if the outside of the material lies 90° from the edge's direction, turned from x to y, else -1."""
    edge = model.edges[at]
    left = np.cross(-model.up, edge.end_mm - edge.start_mm)
    return 1.0 if float(left @ edge.away) > 0 else -1.0
