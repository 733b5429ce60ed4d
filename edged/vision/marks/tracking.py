"""Tracking of both cameras from exposure to exposure: a small Kalman filter on the reference marks.

The state is the displacement of both cameras since the marks were taught (14, see `geometry.correction`). It
follows a random walk at the rate of temperature effects; each exposure updates it with the dots seen. Errors
common to all exposures do not average out, and the filter takes this into account: the taught positions of
the dots in the pictures (2, N, 2) with the plate's expansion, and their biases from the pixel grid (as many),
are never updated, but their correlation with the state is propagated (S. F. Schmidt, "Application of
state-space methods to navigation problems", Advances in Control Systems 3, 1966: the consider filter).

Before an update all dots together must agree with the prediction (chi² at 1e-6). If they do not, either some
marks are wrong and most of the others agree, or the cameras were moved and at least six marks agree on the
movement; otherwise the exposure is rejected. Pure and without a clock: the same state and pictures give
bitwise the same result.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import I64, SIDES, FloatArray, Image, Side
from edged.domain.marks import MarksReport, MarksState, MarksTrack
from edged.vision.geometry.correction import (
    DISPLACEMENT,
    OF_CAMERA,
    RigCorrection,
    of_side,
    seen_with_slopes,
)
from edged.vision.geometry.rigid import rotation_matrix, skew
from edged.vision.marks.measuring import SeenDots, measure_marks, rough_dots, search_marks
from edged.vision.marks.observing import DotsInPair, ObservedDots, chance_limit, expected_dots
from edged.vision.marks.params import EXPANSION_PER_K, MARKS
from edged.vision.marks.taught import TaughtMarks

_FOCAL = [OF_CAMERA * index + 6 for index in range(2)]
"""Indices of the focal lengths in a displacement."""
_STEPS = 5
"""Gauss-Newton steps for a knock of some mm; convergence is quadratic, and three steps reach 1e-9 px."""


@dataclass(frozen=True, slots=True)
class MarksSettings:
    """A cell's settings for its marks.

    material : of the plate. range_k : largest temperature difference from the teaching.
    heals : whether results resume after a knock without another teaching.
    """

    material: str = "steel"
    range_k: float = 10.0  # chosen: a hall by day and night; more makes sigma larger, less too small
    heals: bool = True


class MarksFilter:
    """The filter for one teaching; immutable."""

    def __init__(self, taught: TaughtMarks, settings: MarksSettings | None = None) -> None:
        self.taught, self.settings = taught, settings or MarksSettings()
        self.considered = np.diag(np.repeat(taught.sigma_px.reshape(-1) ** 2, 2))
        grown = taught.by_growth().reshape(-1)
        # the whole range counts as one sigma: at the warmest hour of a day the plate is off by that much
        growth = EXPANSION_PER_K[self.settings.material] * self.settings.range_k
        self.considered += growth**2 * np.outer(grown, grown)
        self._weather = _by_camera(MARKS.shift_mm_per_k, MARKS.turn_rad_per_k, MARKS.focal_per_k) ** 2

    def begin(self) -> MarksTrack:
        """Initial track before the first exposure: any effect of temperature since the teaching, no knock."""
        prior = np.diag(self._weather * self.settings.range_k**2)
        nothing = np.zeros(DISPLACEMENT)
        return MarksTrack(nothing, prior, np.zeros((DISPLACEMENT, 2 * len(self.considered))), nothing)

    # --- one exposure --------------------------------------------------------------------------------------

    def step(
        self, track: MarksTrack, left: Image, right: Image, exposed_ns: int
    ) -> tuple[MarksTrack, MarksReport]:
        """Process one pair of linear raw images (H, W) uint8; `exposed_ns` UTC."""
        track = self.predicted(track, exposed_ns)
        dots, track = self.look(track, left, right)
        track, report = self.updated(track, dots)
        if _moved_px(self.taught, track.displacement - track.maps) > MARKS.maps_px:
            track = replace(track, maps=track.displacement)
        return track, report

    def predicted(self, track: MarksTrack, exposed_ns: int) -> MarksTrack:
        """Predict the track at a later time. A clock set back adds nothing; a jump ahead at most a day."""
        if not track.exposed_ns:
            return replace(track, exposed_ns=exposed_ns)
        hours = min(max((exposed_ns - track.exposed_ns) / 3.6e12, 0.0), MARKS.longest_h)
        swing = self._weather * self.settings.range_k**2
        walked = swing * MARKS.daily**2 * hours
        # the marks hardly determine focal lengths: an unbounded walk would lose them, but temperature returns
        share = math.exp(-0.5 * MARKS.daily**2 * hours)
        kept = np.ones(DISPLACEMENT)
        kept[_FOCAL] = share
        walked[_FOCAL] = (1.0 - share**2) * swing[_FOCAL]
        return replace(
            track,
            exposed_ns=exposed_ns,
            displacement=kept * track.displacement,
            covariance=kept[:, None] * track.covariance * kept + np.diag(walked),
            cross=kept[:, None] * track.cross,
        )

    def updated(self, track: MarksTrack, dots: DotsInPair) -> tuple[MarksTrack, MarksReport]:
        """Update a predicted track with dots, testing for wrong marks and knocks."""
        seen = np.isfinite(dots.pixels).all(axis=2)
        marks = np.flatnonzero(seen.any(axis=0))
        if not len(marks):
            return self._coasting(track, dots, None, marks)
        every = self._observed(track, dots, marks)
        if every.misfit <= chance_limit(every.count):
            return self._agreed(track, dots, every, marks, ())
        few, kept = self._without_wrong(track, dots, marks)
        for hit in (SIDES[:1], SIDES[1:], SIDES):
            moved, agreeing = self._moved(track, dots, marks, hit)
            if moved is not None and len(agreeing) > len(kept) + 1:
                return self._knocked(track, dots, moved, marks, agreeing, hit)
        excluded = self._codes(np.setdiff1d(marks, kept))
        if few is not None and len(kept) >= MARKS.min_of_camera and 2 * len(kept) > len(marks):
            return self._agreed(track, dots, few, kept, excluded)
        why = "the marks contradict each other: was one moved, covered in part, or the plate exchanged?"
        if len(marks) < MARKS.min_agreeing:
            why = f"{len(marks)} marks are elsewhere than expected, too few to tell where the cameras are"
        report = self._report(track, MarksState.CONTRADICTED, marks, every.misfit / every.count, why)
        codes = self._codes(marks)
        return replace(track, wait=self._waiting(track)), replace(report, valid=False, excluded=codes)

    # --- outcomes ------------------------------------------------------------------------------------------

    def _agreed(
        self,
        track: MarksTrack,
        dots: DotsInPair,
        observed: ObservedDots,
        marks: I64,
        excluded: tuple[int, ...],
    ) -> tuple[MarksTrack, MarksReport]:
        updated = observed.applied(track)
        enough = bool(
            (np.isfinite(dots.pixels[:, marks]).all(axis=2).sum(axis=1) >= MARKS.min_of_camera).all()
        )
        fit = observed.misfit / observed.count
        if updated.knocked:
            wait = updated.wait
            if enough and not excluded:
                wait = max(0, wait - 1)
            healed = self.settings.heals and not wait
            updated = replace(updated, wait=wait, knocked=not healed)
            if not healed:
                why = "knocked: results come again when the marks have agreed for a few exposures"
                if not self.settings.heals:
                    why = "knocked: on_knock is refuse: teach the marks anew when all is well"
                report = self._report(updated, MarksState.KNOCKED, marks, fit, why)
                return updated, replace(report, valid=False, excluded=excluded)
        if excluded:
            why = f"marks {', '.join(map(str, excluded))} disagree with the others and are left out"
            report = self._report(updated, MarksState.CONTRADICTED, marks, fit, why)
            return updated, replace(report, excluded=excluded)
        if not enough:
            return self._coasting(updated, dots, fit, marks)
        return updated, self._report(updated, MarksState.CORRECTED, marks, fit, "")

    def _coasting(
        self, track: MarksTrack, dots: DotsInPair, fit: float | None, marks: I64
    ) -> tuple[MarksTrack, MarksReport]:
        """Outcome if too few marks are seen; codes of another plate make it a contradiction."""
        if not len(marks) and (dots.strange or len(dots.unlike) >= MARKS.min_of_camera):
            shown = ", ".join(map(str, (dots.strange or dots.unlike)[:8]))
            why = f"another plate: codes {shown} were not taught here"
            if not dots.strange:
                why = f"another plate, or covered dots: at codes {shown} there is none of the taught size"
            return track, replace(self._report(track, MarksState.CONTRADICTED, marks, fit, why), valid=False)
        state, why = MarksState.COASTING, f"{len(marks)} of {len(self.taught.codes)} marks are seen"
        report = self._report(track, MarksState.KNOCKED if track.knocked else state, marks, fit, why)
        return track, replace(report, valid=not track.knocked)

    def _knocked(
        self,
        track: MarksTrack,
        dots: DotsInPair,
        moved: MarksTrack,
        marks: I64,
        agreeing: I64,
        hit: Sequence[Side],
    ) -> tuple[MarksTrack, MarksReport]:
        excluded = self._codes(np.setdiff1d(marks, agreeing))
        observed = self._observed(moved, dots, agreeing)
        fit = observed.misfit / observed.count
        whole = self._fit_moved_plate(track, dots, agreeing) if len(hit) > 1 else None
        why = _refused(self.taught, moved, whole)
        if why:
            report = self._report(track, MarksState.CONTRADICTED, marks, fit, why)
            return replace(track, wait=self._waiting(track)), replace(
                report, valid=False, excluded=self._codes(marks)
            )
        found = replace(moved, knocked=True, wait=MARKS.consistent)
        why = f"the {hit[0]} camera was moved" if len(hit) == 1 else "both cameras were moved"
        if whole is not None:
            why = "the rig as a whole, or the plate of the marks, was moved"
        report = self._report(found, MarksState.KNOCKED, agreeing, fit, why)
        return found, replace(report, valid=False, excluded=excluded)

    def _fit_moved_plate(self, track: MarksTrack, dots: DotsInPair, marks: I64) -> tuple[float, float] | None:
        """Relative growth of the plate, and its sigma, if only the plate changed; None otherwise.

        The plate may have moved (as it seems to when the rig was moved) and be of another size.
        """
        taught = self.taught
        observed = self._observed(track, dots, marks)
        middle = taught.world_from_marks[:3, 3]
        arms, shift, turned = taught.placed.places_mm - middle, np.zeros(3), np.eye(3)
        growth, weights = 0.0, observed.root.T @ observed.root
        for _ in range(_STEPS):
            moved = (1.0 + growth) * arms @ turned.T
            difference, rows = [], []
            for index, side in enumerate(SIDES):
                pixels, _, by_place = seen_with_slopes(
                    taught.rig, track.displacement, side, middle + shift + moved
                )
                difference.append(dots.pixels[index] - pixels - taught.residual_px[index])
                by_motion = np.concatenate([by_place @ -skew(moved), by_place], axis=2)
                rows.append(np.concatenate([by_motion, by_place @ moved[:, :, None]], axis=2))
            slopes = np.stack(rows).reshape(-1, 7)[observed.rows]
            left_over = np.stack(difference).reshape(-1)[observed.rows]
            inverse = np.linalg.inv(slopes.T @ weights @ slopes)
            step = inverse @ (slopes.T @ weights @ left_over)
            turned, shift = rotation_matrix(step[:3]) @ turned, shift + step[3:6]
            growth += float(step[6])
        left_over = left_over - slopes @ step
        if float(left_over @ weights @ left_over) > chance_limit(observed.count):
            return None
        return growth, math.sqrt(inverse[6, 6])

    def _observed(
        self, track: MarksTrack, dots: DotsInPair, marks: I64, at: FloatArray | None = None
    ) -> ObservedDots:
        return ObservedDots.observe(self.taught, self.considered, track, dots, marks, at)

    def _waiting(self, track: MarksTrack) -> int:
        return MARKS.consistent if track.knocked else track.wait

    def _report(
        self, track: MarksTrack, state: MarksState, marks: I64, fit: float | None, why: str
    ) -> MarksReport:
        left_mm, right_mm = (float(np.linalg.norm(track.displacement[of_side(side)][3:6])) for side in SIDES)
        return MarksReport(state, True, len(marks), len(self.taught.codes), (), fit, left_mm, right_mm, why)

    def _codes(self, marks: I64) -> tuple[int, ...]:
        return tuple(self.taught.codes[index] for index in marks)

    # --- hypotheses ----------------------------------------------------------------------------------------

    def _without_wrong(
        self, track: MarksTrack, dots: DotsInPair, marks: I64
    ) -> tuple[ObservedDots | None, I64]:
        """Remove the worst mark repeatedly until the others agree; None if they never do."""
        kept = marks
        while len(kept) > MARKS.min_of_camera:
            kept = np.delete(kept, self._observed(track, dots, kept).worst(kept))
            observed = self._observed(track, dots, kept)
            if observed.misfit <= chance_limit(observed.count):
                return observed, kept
        return None, kept[:0]

    def _moved(
        self, track: MarksTrack, dots: DotsInPair, marks: I64, hit: Sequence[Side]
    ) -> tuple[MarksTrack | None, I64]:
        """Estimate the poses of the cameras hit from the marks alone; lenses keep their prior, poses do not.

        Also returns the marks that agree, at least `min_agreeing`; None and no marks if there are fewer.
        """
        known = np.ones(DISPLACEMENT)
        for side in hit:
            known[of_side(side)][:6] = 0.0
        wide = known[:, None] * track.covariance * known
        wide += np.diag((1.0 - known) * _by_camera(MARKS.knock_mm, MARKS.knock_rad, 0.0) ** 2)
        cross = known[:, None] * track.cross
        prior = replace(track, covariance=wide, cross=cross)
        kept = marks
        while len(kept) >= MARKS.min_agreeing:
            at = prior
            for _ in range(_STEPS):
                observed = self._observed(prior, dots, kept, at.displacement)
                at = observed.applied(prior)
            if observed.misfit <= chance_limit(observed.count):
                return at, kept
            kept = np.delete(kept, observed.worst(kept))
        return None, kept[:0]

    # --- pictures ------------------------------------------------------------------------------------------

    def look(self, track: MarksTrack, left: Image, right: Image) -> tuple[DotsInPair, MarksTrack]:
        """Measure all dots; if fewer than half are at their expected positions, search the whole pictures."""
        images, taught = (left, right), self.taught
        expected = self.expected_px(track.displacement)
        seen = [
            measure_marks(image, look, at)
            for image, look, at in zip(images, taught.looks, expected, strict=True)
        ]
        found = min(int(np.isfinite(dots.sigma_px).sum()) for dots in seen)
        if 2 * found >= len(taught.codes):
            return _both(seen), replace(track, searched=0, blank=0)
        if track.searched > 0:
            return _both(seen), replace(track, searched=track.searched - 1)
        dots = self._searched(images, seen)
        again = min(int(np.isfinite(pixels).all(axis=1).sum()) for pixels in dots.pixels)
        if again > found or dots.strange or dots.unlike:  # another plate must be reported each time
            return dots, replace(track, searched=0, blank=0)
        blank = min(2 * track.blank + 1, MARKS.farthest_search)
        return dots, replace(track, searched=blank, blank=blank)

    def _searched(self, images: tuple[Image, Image], seen: list[SeenDots]) -> DotsInPair:
        """Dots with those not seen replaced by dots found anywhere in the pictures."""
        codes, both = self.taught.codes, []
        strange, unlike = set[int](), set[int]()
        for image, look, dots in zip(images, self.taught.looks, seen, strict=True):
            found = search_marks(image)
            strange |= set(found.codes) - set(codes)
            near = np.full((len(codes), 2), np.nan)
            for code, centre in zip(found.codes, found.centres_px, strict=True):
                if code in codes:
                    near[codes.index(code)] = centre
            near[np.isfinite(dots.sigma_px)] = np.nan
            more = measure_marks(image, look, rough_dots(image, look, near))
            is_new = np.isfinite(more.sigma_px)
            lost = np.isfinite(near).all(axis=1) & ~is_new
            unlike |= {codes[index] for index in np.flatnonzero(lost)}
            both.append(
                SeenDots(
                    np.where(is_new[:, None], more.pixels, dots.pixels),
                    np.where(is_new, more.sigma_px, dots.sigma_px),
                )
            )
        return replace(
            _both(both),
            strange=tuple(sorted(strange)),
            unlike=tuple(sorted(unlike)),
        )

    def expected_px(self, displacement: FloatArray) -> FloatArray:
        """Expected positions (2, N, 2) of the dots."""
        return expected_dots(self.taught, displacement)[0]


def _moved_px(taught: TaughtMarks, displacement: FloatArray) -> float:
    """Upper bound of the image shift that a small displacement causes, px."""
    depth_mm = float(taught.placed.places_mm[:, 2].min())
    most = 0.0
    for side in SIDES:
        turn, shift = np.linalg.norm(displacement[of_side(side)][:6].reshape(2, 3), axis=1)
        camera, grown = taught.rig.camera(side), abs(float(displacement[of_side(side)][6]))
        moved = camera.fx * float(turn + shift / depth_mm) + 0.5 * grown * camera.width
        most = max(most, moved)
    return most


def correction_of(track: MarksTrack) -> RigCorrection:
    """Correction of the rig by a track."""
    return RigCorrection(track.displacement, track.covariance)


def _both(seen: list[SeenDots]) -> DotsInPair:
    return DotsInPair(np.stack([dots.pixels for dots in seen]), np.stack([dots.sigma_px for dots in seen]))


def _by_camera(mm: float, rad: float, focal: float) -> FloatArray:
    """Displacement vector (14,) with the same values for both cameras."""
    return np.tile([rad, rad, rad, mm, mm, mm, focal], 2)


def _refused(taught: TaughtMarks, moved: MarksTrack, whole: tuple[float, float] | None) -> str:
    """Why a knock cannot be accepted; "" if it can.

    whole : growth of the plate and its sigma, if a moved plate explains the pictures.

    A camera that moves along the baseline looks the same as a plate that grew and moved away accordingly; so
    another plate is assumed only if a movement of one camera does not explain the pictures.
    """
    far_mm, far_rad = _relative(taught, moved.displacement)
    if far_mm > MARKS.largest_mm or far_rad > MARKS.largest_rad:
        return (
            f"the cameras were moved against each other by {far_mm:.1f} mm and {1e3 * far_rad:.1f} mrad, "
            "or this is another plate: calibrate or teach anew"
        )
    if whole is not None and abs(whole[0]) > MARKS.other_size * whole[1]:
        return f"the plate is {100 * whole[0]:+.2f} % larger than the one that was taught: teach anew"
    return ""


def _relative(taught: TaughtMarks, displacement: FloatArray) -> tuple[float, float]:
    """Change of the baseline (mm) and relative rotation (rad) of the cameras to each other."""
    rig = taught.rig
    now = RigCorrection(displacement, np.empty((0, 0))).applied(rig).right_from_left
    turn = now[:3, :3] @ rig.right_from_left[:3, :3].T
    angle = math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(turn)) - 1.0))))
    return abs(float(np.linalg.norm(now[:3, 3])) - rig.baseline_mm), angle
