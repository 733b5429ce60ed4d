"""The job that a draft replaces: what of it stays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.picking import Picking
from edged.files.jobs import SHAPE, TEXT, job_of
from edged.setup.teaching.editing import lying
from edged.vision.geometry.rigid import invert
from edged.vision.part.job import Job


@dataclass(frozen=True, slots=True)
class FormerFiles:
    """A job as its folder has it. is_same_pair : it was learnt from the pair that is before us."""

    text: bytes
    shape: bytes
    folder: Path
    is_same_pair: bool

    def job(self) -> Job:
        """Raises `FileFormatError`."""
        return job_of({TEXT: self.text, SHAPE: self.shape}, self.folder)


def with_tolerances(job: Job, was: Job) -> Job:
    """With those of the job that is replaced, which people may have edited, for the same reference."""
    if was.reference != job.reference:
        return job
    limits = replace(
        job.limits,
        radius_tolerance_mm=was.limits.radius_tolerance_mm,
        form_tolerance_mm=was.limits.form_tolerance_mm,
    )
    return replace(job, limits=limits)


def picking_of(former: FormerFiles, taught: Job, moved: FloatArray | None) -> Picking:
    """As in the job that is replaced; how a tool takes it only where the part lies as it did then."""
    was = former.job()
    was_drawn = bool(np.array_equal(was.rig_from_part[:3, :3], np.eye(3)))
    if not former.is_same_pair or (was_drawn and moved is None):
        return replace(was.picking, grasps=())
    if was_drawn:  # each in the plane of its own face
        there = invert(taught.rig_from_part) @ was.rig_from_part
        there[2, 3] = 0.0
    else:
        there = invert(lying(taught, moved).rig_from_part) @ was.rig_from_part
    grasps = tuple(
        replace(grasp, part_from_tcp=np.round(there @ grasp.part_from_tcp, 9)) for grasp in was.picking.grasps
    )
    return replace(was.picking, grasps=grasps)
