"""Predicted precision of a part's measurement at any pose.

It has the terms of a measured target, from the same equations, but without pictures: the edges are where the
pose puts them, and as clear as they were when the job was last measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Match, Reject, Target
from edged.vision.curves.foresight import ExpectedLight, predict_fit, scatter_in
from edged.vision.curves.outlines import Curve, Face
from edged.vision.curves.params import FIT
from edged.vision.curves.planefit import CurveFit, PlaneFit, Scatter
from edged.vision.geometry.rectification import Rectification
from edged.vision.geometry.rigid import apply
from edged.vision.part.circles import placed
from edged.vision.part.consistency import vaguest_mm
from edged.vision.part.job import Job
from edged.vision.part.measure import all_curves, completed, needs_all, published, target_from, with_free_axis
from edged.vision.part.pose import circle_curve, edge_curve, find_motion, slot_curve
from edged.vision.part.solid import curves_of, target_of, taught_sigma_mm

GOOD_LIGHT = ExpectedLight(contrast=80.0, noise=2.0, blur_px=0.8)
"""Chosen: that of a good picture; predictions by it hold in such light."""
USUAL = scatter_in(GOOD_LIGHT, FIT.doubt_px)
"""Scatter assumed for a job that was never measured."""

Scatters = Mapping[str, Scatter]
"""Edge scatter by feature name."""
Noises = Mapping[str, tuple[float, float]]
"""Edge noise by feature name, as `edge_noise` returns it."""


def scatters_of(fits: Sequence[CurveFit]) -> Scatters:
    """Scatter of the features of a measured part: how well each could be seen."""
    return {fit.name: fit.scatter for fit in fits}


def expected_target(
    rectification: Rectification,
    job: Job,
    rig_from_part: FloatArray,
    scatters: Scatters,
    noises: Noises | None = None,
) -> Target | None:
    """The target that a job would give of a part at a pose, with its covariance and its terms.

    rig_from_part (4, 4) : as in `Target`, of the reference point.  scatters : of features that were measured;
    for the others the median of these is taken, or `USUAL`.  Its sizes are the taught ones.
    noises : if given, the covariance is that of these alone: the scatter of a part that lies still.
    None where the two pictures do not contain enough of the part.
    """
    own = rig_from_part @ job.reference_from_part
    x, y = rectification.rig.left.project(rig_from_part[None, :3, 3])[0]
    sight = _Sight(rectification, job, own, Match(float(x), float(y), 0.0, 1.0, 1.0, 1.0), scatters, noises)
    if job.solid:
        target = sight.whole()
    elif job.circles:
        target = sight.circles()
    else:
        target = sight.edges()
    if target is None:
        return None
    vaguest = vaguest_mm(job, target)
    target = published(job, target)
    sigma_mm = max(vaguest, *(float(pose.sigma_mm.max()) for pose in (target, target.as_reported)))
    vague = not sigma_mm <= job.limits.max_sigma_mm
    return replace(target, reject=Reject.SIGMA_LIMIT if vague else Reject.NONE)


@dataclass(frozen=True, slots=True, eq=False)
class _Sight:
    """A job's part at a pose.  rig_from_own (4, 4) : of the frame that the job's features are in."""

    rectification: Rectification
    job: Job
    rig_from_own: FloatArray
    match: Match
    scatters: Scatters
    noises: Noises | None

    def whole(self) -> Target | None:
        """A part of several heights, as one rigid whole."""
        rig_mm = taught_sigma_mm(self.rectification.rig, self.rig_from_own)
        fit = self._fit(self._face(np.zeros(3)), curves_of(self.job), rig_mm)
        return None if fit is None else with_free_axis(self.job, target_of(self.job, self.match, fit))

    def circles(self) -> Target | None:
        """A part of one face with circles: first these together, then what they leave undetermined."""
        main = self.job.reference_circle
        job = replace(self.job, reference=main.name)
        face, curves = self._face(main.centre_mm), []
        for circle in job.circles:
            x, y, height = circle.centre_mm - main.centre_mm
            curve = circle_curve(circle, free_polarity=False)
            curves.append(
                replace(curve, parameters=np.array([x, y, circle.radius_mm]), height_mm=float(height))
            )
        fit = self._fit(face, curves)
        if fit is None or fit.fit_of(main.name) is None:
            return None
        _, target = placed(job, self.match, fit, self.rig_from_own[:3, :3])
        beside = None
        if needs_all(self.job, target):
            polarity = {circle.name: circle.polarity for circle in job.circles}
            beside = self._fit(*all_curves(self.job, target, polarity))
        return completed(self.job, target, beside)

    def edges(self) -> Target | None:
        """A part of edges and slots."""
        curves = [edge_curve(edge, free_polarity=False) for edge in self.job.edges]
        curves += [slot_curve(slot, free_polarity=False) for slot in self.job.slots]
        fit = self._fit(self._face(np.zeros(3)), curves)
        motion = None if fit is None else find_motion(self.job, fit)
        if fit is None or motion is None:
            return None
        return target_from(self.rectification, self.job, self.match, fit, motion)

    def _face(self, origin_mm: FloatArray) -> Face:
        return Face(apply(self.rig_from_own, origin_mm), self.rig_from_own[:3, :3].T)

    def _fit(self, face: Face, curves: Sequence[Curve], rigid_mm: float | None = None) -> PlaneFit | None:
        known = sorted(self.scatters.values(), key=lambda scatter: float(scatter.information[0]))
        usual = known[len(known) // 2] if known else USUAL
        scatters = [self.scatters.get(curve.name, usual) for curve in curves]
        noises = None
        if self.noises is not None:
            middle = tuple(np.median(list(self.noises.values()), axis=0).tolist())
            noises = [self.noises.get(curve.name, middle) for curve in curves]
        return predict_fit(self.rectification.rig, face, curves, scatters, rigid_mm=rigid_mm, noises=noises)
