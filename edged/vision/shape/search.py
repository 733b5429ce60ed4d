"""Find taught shapes in an image (paper, eq. 6 and 7).

The top of the pyramid is searched exhaustively (`scan`); then each of the few best poses goes straight to
robust least squares on sub-pixel edges (`refine`), level by level. Rivals are dropped as soon as the score
decides.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from edged.domain.arrays import B8, FloatArray, Image
from edged.errors import ImageError
from edged.vision.geometry.rigid import angle_between, middle_turn
from edged.vision.shape import ambiguity as rivals
from edged.vision.shape import localsearch as nearby
from edged.vision.shape import refine
from edged.vision.shape.candidates import (
    Candidates,
    Hypothesis,
    PlacedMatch,
    ShapeMatch,
    ShapeViews,
    disc_overlap,
    scan_top,
    without_overlap,
)
from edged.vision.shape.model import ShapeModel, reach_px
from edged.vision.shape.params import CLIMB, EACH_EDGE_ITSELF, SCAN, SearchParams
from edged.vision.shape.workspace import Workspace

__all__ = ["SearchParams", "ShapeMatch", "Workspace", "find_shapes"]

FREEDOM = {
    "none": 0,
    "rigid": refine.RIGID,
    "similarity": refine.SIMILARITY,
    "stretch": refine.STRETCH,
    "affine": refine.AFFINE,
    "projective": refine.PROJECTIVE,
}
"""Number of unknowns of the refinement."""
STEEP_STEPS = tuple((reach, refine.PROJECTIVE) for reach in CLIMB.steep_reach_px)

DEFAULTS = SearchParams()


def find_shapes(
    image: Image,
    models: ShapeModel | Sequence[ShapeModel],
    params: SearchParams = DEFAULTS,
    valid: Image | None = None,
    workspace: Workspace | None = None,
    views: ShapeViews | None = None,
) -> list[ShapeMatch]:
    """Find models in a rectified image (H, W) uint8, best first; the best one wins at each place.

    valid : (H, W) uint8, 0 where the image has no content or nothing is to be looked for; its border is
    no edge.  workspace : buffers to reuse, one per thread.  views : how the models may look, tilted; None: as
    taught, which finds a face that is tilted by up to about 30° against the taught one.
    The order is deterministic, and equal input gives bit-equal output. An image too small for the model
    has no match. Raises `ImageError` for another kind of array.
    """
    if image.dtype != np.uint8 or image.ndim != 2:
        raise ImageError(
            f"the search needs an 8-bit grey image, got {image.dtype} of the shape {image.shape}"
        )
    if valid is not None and (valid.shape != image.shape or valid.dtype != np.uint8):
        raise ImageError(f"the valid mask is {valid.dtype} {valid.shape}, the image is uint8 {image.shape}")
    if min(image.shape) < SCAN.min_level_px:
        return []
    listed = [models] if isinstance(models, ShapeModel) else list(models)
    work = workspace or Workspace()
    work.load(image, max((len(model.levels) for model in listed), default=1))
    matches: list[PlacedMatch] = []
    for index, model in enumerate(listed):
        matches += [
            PlacedMatch(match, model)
            for match in _Search(work, model, params, views, _fixed(model, params, views)).run(index, valid)
        ]
    return without_overlap(matches, params)


@dataclass(frozen=True, slots=True, eq=False)
class _Fixed:
    """Quantities of a search that do not depend on the image.

    stretches : sizes along the model's x and y are looked for separately.  steps : of `refine.settle` on a
    coarse level, by whether it is the first one, and whether it is above the next to finest.  finest,
    finest_inverted : for the taught contrast and the opposite one.
    """

    stretches: bool
    steps: Mapping[tuple[bool, bool], FloatArray]
    ranges: refine.Ranges
    finest: refine.Finest
    finest_inverted: refine.Finest


@lru_cache(maxsize=16)  # a job has a few models, which stay the same from image to image
def _fixed(model: ShapeModel, params: SearchParams, views: ShapeViews | None) -> _Fixed:
    stretches, free = params.scale_y_min is not None, params.polarity in EACH_EDGE_ITSELF
    freedom = FREEDOM[params.sub_pixel]  # and the unknowns that the search sampled
    if freedom and stretches:
        freedom = max(freedom, refine.STRETCH)
    elif freedom and params.scale_max > params.scale_min:
        freedom = max(freedom, refine.SIMILARITY)
    ranges = refine.Ranges(
        params.scale_min,
        params.scale_max,
        math.nan if params.scale_y_min is None else params.scale_y_min,
        math.nan if params.scale_y_max is None else params.scale_y_max,
        math.nan if views is None else views.max_stretch,
        params.angle_start_rad,
        params.angle_extent_rad,
    )
    finest, inverted = (
        refine.Finest(
            sign=0 if free else sign,
            min_contrast=params.min_contrast,
            cell_px=model.radius_px / CLIMB.stretches if params.polarity == "local" else 0.0,
            freedom=freedom,
            tilt_prior=(CLIMB.tilt_prior if views is None else CLIMB.steep_prior) / model.radius_px,
            min_score=CLIMB.coarse_share * params.min_score,
            ranges=ranges,
        )
        for sign in (1, -1)
    )
    limit = freedom or refine.SIMILARITY
    start, steps = min(limit, refine.STRETCH if stretches else refine.SIMILARITY), {}
    for coarser in (False, True):
        # few points do not determine a tilt
        most = min(limit, refine.AFFINE if coarser else refine.PROJECTIVE)
        steps[True, coarser] = np.array([(2.0, start), (2.0, most)] if views is None else STEEP_STEPS)
        steps[False, coarser] = np.array([(2.0, most), (1.5, most)] if views is None else STEEP_STEPS[:2])
    return _Fixed(stretches, steps, ranges, finest, inverted)


@dataclass(frozen=True, slots=True)
class _Search:
    """One model in one loaded image."""

    work: Workspace
    model: ShapeModel
    params: SearchParams
    views: ShapeViews | None
    fixed: _Fixed

    def run(self, index: int, valid: Image | None) -> list[ShapeMatch]:
        top = min(len(self.model.levels), len(self.work.images)) - 1
        candidates = scan_top(self.work, self.model, top, self.params, valid, self.views)
        found: list[Hypothesis] = []
        needed = -math.inf
        settled = np.zeros(len(candidates.scores), np.bool_)
        for number, score in enumerate(candidates.scores):
            # candidates come in order: even a perfect refinement makes none of the rest better
            if score + CLIMB.refinement_gain < needed:
                break
            if settled[number]:
                continue
            finest = self._climb(candidates.hypothesis(number), top, found)
            if finest is not None:
                better = self._decided(self._with_odds(finest, found), top > 0)
                found.append(better)
                settled |= self._settled(better, candidates, top)
                good = sorted([h.score for h in found if h.score >= self.params.min_score], reverse=True)
                if len(good) >= self.params.max_matches:
                    needed = good[self.params.max_matches - 1]
        matches = [h for h in self._prune(found) if h.score >= self.params.min_score]
        return [match for h in self._one_of_each_place(matches) if (match := self._to_match(h, index))]

    def _climb(self, candidate: Hypothesis, top: int, found: list[Hypothesis]) -> Hypothesis | None:
        """Refine one candidate down the pyramid; None as soon as it fails or a better one is in its place."""
        hypothesis: Hypothesis | None = candidate
        for level in range(top, 0, -1):
            if hypothesis is None:
                return None
            if level < top:
                hypothesis = hypothesis.at(refine.one_level_finer(hypothesis.pose))
            hypothesis = self._on_level(hypothesis, level, level == top)
            if (
                hypothesis is not None
                and level in CLIMB.nearby_levels
                and hypothesis.score < CLIMB.clear_score
            ):
                hypothesis = self._best_nearby(hypothesis, level)
            if hypothesis is None or self._hopeless(hypothesis, level, found):
                return None
        return None if hypothesis is None else self._finest(hypothesis, top > 0)

    # --- one level ---------------------------------------------------------------------------------

    def _sign(self, hypothesis: Hypothesis) -> int:
        return 0 if self.params.polarity in EACH_EDGE_ITSELF else hypothesis.sign

    def _gradient(self, hypothesis: Hypothesis, level: int) -> refine.Gradient:
        minimum = float(8 * self.params.min_contrast)
        return refine.Gradient(*self.work.gradient(level), self._sign(hypothesis), minimum)

    def _on_level(self, hypothesis: Hypothesis, level: int, first: bool) -> Hypothesis | None:
        """Robust steps on the gradient of a coarse level."""
        points, normals = self.model.levels[level].points, self.model.levels[level].normals
        fixed = self.fixed
        pose, result = hypothesis.pose.copy(), self.work.step
        gradient, prior = self._gradient(hypothesis, level), fixed.finest.tilt_prior * 2.0**level
        steps = fixed.steps[first, level > 1]
        if not refine.settle(points, normals, gradient, steps, prior, pose, result):
            return None
        score = float(result.summary[0])
        share = CLIMB.coarse_share if first or level > 1 else CLIMB.near_finest_share
        if score < share * self.params.min_score or not refine.is_within(
            pose, self.fixed.ranges, CLIMB.coarse_slack
        ):
            return None
        return hypothesis.at(pose, score)

    def _best_nearby(self, hypothesis: Hypothesis, level: int) -> Hypothesis:
        """Look for a better pose near one that explains a coarse level badly; the better of both."""
        shape = self.model.levels[level]
        place = nearby.best_nearby(
            self._gradient(hypothesis, level),
            shape.points,
            shape.normals,
            hypothesis.pose,
            self.fixed.stretches,
            None if self.views is None else self.views.on_level(hypothesis.view, level),
        )
        other = self._on_level(hypothesis.at(place), level, first=True)
        return hypothesis if other is None or other.score < hypothesis.score else other

    def _finest(self, hypothesis: Hypothesis, climbed: bool) -> Hypothesis | None:
        """Robust steps on edges measured in the image itself, with the operator that measured the model."""
        level, fixed, result = self.model.levels[0], self.fixed, self.work.step
        pose = refine.one_level_finer(hypothesis.pose) if climbed else hypothesis.pose.copy()
        finest = fixed.finest if hypothesis.sign > 0 else fixed.finest_inverted
        agreeing = np.empty(len(level.points))
        image = self.work.images[0]
        score = refine.settle_finest(image, level.points, level.normals, finest, pose, agreeing, result)
        # a match stays where the search found it: a far move is a slide along clutter
        if not score or not refine.is_within(pose, fixed.ranges, CLIMB.finest_slack):
            return None
        sigma = float(result.summary[2]) * math.sqrt(self.model.repetition)
        covariance = refine.covariance(result.matrix, finest.freedom, sigma, pose)
        return Hypothesis(
            pose,
            hypothesis.sign,
            score,
            covariance,
            hypothesis.scanned,
            agreeing,
            hypothesis.ambiguous,
            hypothesis.view,
            hypothesis.odds,
        )

    # --- rivals ------------------------------------------------------------------------------------

    def _middle(self, pose: FloatArray, level: int) -> tuple[Any, Any]:
        """Place of the point about which the shape could be turned, px of the finest level; or (N,) places.

        pose (8,) or (N, 8) : px of a level.
        """
        shrink, (x, y) = 2.0**level, self.model.centre_px
        u, v, a, b, c, d = pose[..., :6].T
        return (u + 0.5) * shrink - 0.5 + a * x + b * y, (v + 0.5) * shrink - 0.5 + c * x + d * y

    def _same_place(self, h: Hypothesis, level: int, other: Hypothesis) -> bool:
        """Whether a hypothesis on a level and a finished one belong to one part, at any rotation."""
        apart = math.dist(self._middle(h.pose, level), self._middle(other.pose, 0))
        return apart < CLIMB.same_place * reach_px(self.model)

    def _settled(self, better: Hypothesis, candidates: Candidates, top: int) -> B8:
        """(N,) candidates at the place of a finished hypothesis that it makes superfluous."""
        if better.ambiguous or better.score < self.params.min_score:
            return np.zeros(len(candidates.scores), np.bool_)
        (x, y), (u, v) = self._middle(candidates.poses, top), self._middle(better.pose, 0)
        near = np.hypot(x - u, y - v) < CLIMB.same_place * reach_px(self.model)
        clear = better.score >= CLIMB.clear_score
        return np.asarray(near & (clear | (candidates.scores < better.scanned - CLIMB.scan_error)))

    def _hopeless(self, h: Hypothesis, level: int, found: list[Hypothesis]) -> bool:
        """Whether a hypothesis repeats a finished one or a variant of it, or is much worse at its place."""
        if not found:
            return False
        shrink = 2.0**level
        radius = self.model.radius_px
        origin = [(place + 0.5) * shrink - 0.5 for place in h.origin]
        margin = CLIMB.rival_margin[min(level, 2)]
        for better in found:
            distance = math.dist(origin, better.origin)
            if h.score > better.score + 0.02:
                continue
            turned = radius * angle_between(h.angle, better.angle)
            near = h.sign == better.sign and distance + turned < 0.1 * radius + 1.5 * shrink
            if near or (level and self._covered(h, better, distance)):
                return True
            # on coarse levels the right one of two rotations may look worse: little of what decides is left
            if level and better.ambiguous and self._same_place(h, level, better):
                continue
            if h.score < better.score - margin and disc_overlap(distance, radius) > self.params.max_overlap:
                return True
        return False

    def _covered(self, h: Hypothesis, better: Hypothesis, distance: float) -> bool:
        """Whether h is a symmetric variant of a better one, which is tried anyway."""
        if h.sign != better.sign or distance > CLIMB.same_place * self.model.radius_px:
            return False
        turn = h.angle - better.angle
        return self.model.round or any(
            angle_between(turn, float(angle)) < 0.12 for angle in self.model.symmetries[:, 2]
        )

    def _prune(self, hypotheses: list[Hypothesis]) -> list[Hypothesis]:
        """Sort hypotheses, best first, and drop those that a better one at their place makes hopeless."""
        if len(hypotheses) < 2:
            return hypotheses
        hypotheses.sort(key=lambda h: (-h.score, h.pose[0], h.pose[1], h.angle, h.sign))
        kept: list[Hypothesis] = []
        for h in hypotheses:
            if not self._hopeless(h, 0, kept):
                kept.append(h)
        return kept

    def _one_of_each_place(self, hypotheses: list[Hypothesis]) -> list[Hypothesis]:
        """Keep at each place the rotation that the image favours, or else the best, marked ambiguous."""
        kept: list[Hypothesis] = []
        for h in hypotheses:
            index = next((k for k, known in enumerate(kept) if self._same_place(h, 0, known)), None)
            if index is None:
                kept.append(h)
            elif self._is_another(h, kept[index]) and not self._beats(kept[index], h):
                better = h if self._beats(h, kept[index]) else replace(kept[index], ambiguous=True)
                kept[index] = better
        return [self._canonical(h) for h in kept]

    def _is_another(self, first: Hypothesis, second: Hypothesis) -> bool:
        """Whether two poses at one place are distinguishable rotations of the shape."""
        turn = first.angle - second.angle
        same = self.model.round or any(angle_between(turn, float(row[2])) < 0.1 for row in self._equal())
        return angle_between(first.angle, second.angle) > 0.1 and not same

    def _equal(self) -> list[FloatArray]:
        """Motions after which the shape looks the same."""
        return list(self.model.equal_motions)

    def _with_odds(self, hypothesis: Hypothesis, found: list[Hypothesis]) -> Hypothesis:
        """Add to a hypothesis its odds of chance, from an equally good one at its place, or measured."""
        if self.model.round or hypothesis.slopes is None or hypothesis.score < self.params.min_score:
            return hypothesis
        for known in found:
            as_good = known.score > hypothesis.score - CLIMB.rival_margin[0]
            if known.odds is not None and as_good and self._same_place(hypothesis, 0, known):
                return hypothesis.at(hypothesis.pose, odds=known.odds)
        image, contrast, sign = self.work.images[0], self.params.min_contrast, self._sign(hypothesis)
        odds = rivals.odds_on_face(
            image, self.model, hypothesis.pose, sign, contrast, np.abs(hypothesis.slopes)
        )
        return hypothesis.at(hypothesis.pose, odds=odds)

    def _decided(self, hypothesis: Hypothesis, climbed: bool) -> Hypothesis:
        """Choose between the rotations that the search could accept; ambiguous if the image does not decide.

        The edges of the hypothesis rule out most of them; the others are tried and compared with it.
        """
        odds = hypothesis.odds
        if odds is None:
            return hypothesis
        image, contrast = self.work.images[0], self.params.min_contrast
        equal = self._equal()
        motions = rivals.turns(self.model).motions
        best = hypothesis
        for _ in range(CLIMB.max_changes):
            slopes = np.zeros(len(self.model.levels[0].points)) if best.slopes is None else best.slopes
            left = rivals.unresolved_rotations(
                image, self.model, best.pose, self._sign(best), contrast, slopes, odds
            )
            left = [
                k
                for k in left
                if all(angle_between(float(row[2]), float(motions[k, 2])) > 0.1 for row in equal)
            ]
            winner, doubt = None, len(left) > CLIMB.max_rivals
            for k in left[: CLIMB.max_rivals]:
                other = self._variant(best, motions[k], climbed)
                if other is None or not self._is_another(other, best):
                    continue
                if self._beats(other, best):
                    winner = other
                    break
                doubt = doubt or not self._beats(best, other)
            if winner is None:
                return best if best.ambiguous == doubt else replace(best, ambiguous=doubt)
            best = winner
        return replace(best, ambiguous=True)

    def _beats(self, first: Hypothesis, second: Hypothesis) -> bool:
        """Whether the image favours the first of two rotations at one place."""
        if abs(first.score - second.score) > CLIMB.rival_margin[1]:
            return first.score > second.score
        image = self.work.images[0]
        poses, signs = (first.pose, second.pose), (self._sign(first), self._sign(second))
        odds = first.odds or second.odds
        if odds is None:
            raise ValueError("rotations of a part whose face was not looked at")
        verdict = rivals.decides(image, self.model, poses, signs, self.params.min_contrast, odds)
        if verdict is None:  # they hardly differ: only all edges together can decide
            return first.score - second.score >= CLIMB.decided_share * self._loss(first, second) * first.score
        return verdict

    def _loss(self, first: Hypothesis, second: Hypothesis) -> float:
        """Share of the score that the wrong one of two rotations loses, as measured at teaching."""
        turn = first.angle - second.angle
        known = [1 - row[3] for row in self.model.symmetries if angle_between(turn, float(row[2])) < 0.1]
        return max(*known, CLIMB.min_loss) if known else CLIMB.min_loss

    def _variant(self, hypothesis: Hypothesis, motion: FloatArray, climbed: bool) -> Hypothesis | None:
        """The pose after a motion of the model in its own plane, refined like a candidate."""
        moved = hypothesis.at(rivals.turned(hypothesis.pose, motion))
        if not climbed:
            return self._finest(moved, climbed=False)
        pose = moved.pose.copy()
        pose[:2] = (pose[:2] + 0.5) / 2 - 0.5
        pose[6:] *= 2
        coarse = self._on_level(moved.at(pose), 1, first=False)
        return None if coarse is None else self._finest(coarse, climbed=True)

    def _canonical(self, hypothesis: Hypothesis) -> Hypothesis:
        """Turn a hypothesis to where the shape looks the same, nearest to the middle of the wanted range."""
        middle = middle_turn(self.params.angle_start_rad, self.params.angle_extent_rad)
        if self.model.round:
            back = rivals.about(self.model.centre_px, middle - hypothesis.angle)
            return hypothesis.at(rivals.turned(hypothesis.pose, back))
        best = hypothesis
        for motion in self._equal():
            other = hypothesis.at(rivals.turned(hypothesis.pose, motion))
            if angle_between(other.angle, middle) < angle_between(best.angle, middle) - 1e-6:
                best = other
        return best

    def _to_match(self, h: Hypothesis, index: int) -> ShapeMatch | None:
        if h.score < self.params.min_score or not refine.is_within(
            h.pose, self.fixed.ranges, CLIMB.finest_slack
        ):
            return None
        linear = h.pose[2:6].reshape(2, 2).copy()
        scale_x, scale_y = np.sqrt(linear[0] ** 2 + linear[1] ** 2)
        match = ShapeMatch(
            float(h.pose[0]),
            float(h.pose[1]),
            h.angle,
            float(scale_x),
            float(scale_y),
            h.score,
            linear,
            h.pose[6:].copy(),
            h.sign < 0,
            h.ambiguous,
            index,
            bool(self._equal()) or self.model.round,
            np.full((5, 5), np.nan) if h.covariance is None else h.covariance,
        )
        if not self.params.allow_partial:
            height, width = self.work.images[0].shape
            points = match.apply(self.model.levels[0].points)
            if (points < 0).any() or (points > (width - 1, height - 1)).any():
                return None
        return match
