"""Holes whose walls are as bright as the face: a second plate as far below as the walls are lit."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.cells import frame_pair, pictures, pose, scene
from helpers.flatparts import METAL

from edged.domain.arrays import Image
from edged.domain.measurement import Reject
from edged.files.jobs import load_job, save_job
from edged.pipeline import locate, prepare
from edged.setup.teaching.proposal import propose_from_pair
from edged.sim.cell import demo_rig
from edged.sim.render.scene import Disc, Hole, Part, Surface
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply, invert
from edged.vision.part.job import Job
from edged.vision.part.params import MEASURING
from edged.vision.teaching.brightwalls import bright_walls_mm
from edged.vision.teaching.pair import WantedJob, teach

RIG = demo_rig()
RADIUS_MM = {"bore": 4.0, "pin": 2.5, "odd": 3.0}
HOLES = (("bore", -5.0, 3.0), ("pin", 6.0, 4.0), ("odd", 2.0, -7.0))
DARK = Surface(albedo=0.04)


def pair(lit_mm: float, wall: float = METAL.albedo) -> tuple[Image, Image]:
    """A disc with holes whose walls are so bright down to this depth, and dark below."""
    where = pose()
    lower = where.copy()
    lower[:3, 3] += lit_mm * where[:3, 2]
    shapes = [(name, Disc(x, y, RADIUS_MM[name])) for name, x, y in HOLES]
    face = Part("face", Disc(0, 0, 13), METAL, tuple(Hole(name, shape, 1.0) for name, shape in shapes))
    dark = tuple(Hole(name, shape, 0.02) for name, shape in shapes)
    walls = Part("walls", Disc(0, 0, 12.9), replace(METAL, albedo=wall), dark)
    return pictures(RIG, scene((walls, lower), (face, where), table=DARK))


def walls_of(seen: tuple[Image, Image]) -> tuple[Job, dict[str, float]]:
    """The job that a pair teaches, and its circles with bright walls."""
    rectification = prepare(RIG).rectification
    job = teach(*seen, rectification, None, "disc")
    return job, bright_walls_mm(StereoImages.of(rectification, *seen), job)


def test_holes_with_bright_walls_are_named_with_what_they_are_off_by() -> None:
    """The side of a rim that hides the wall lies nearer by what the whole was taught too deep."""
    job, walls = walls_of(pair(0.5))
    face_from_part = invert(pose()) @ job.rig_from_part
    too_deep = {circle.name: float(apply(face_from_part, circle.centre_mm)[2]) for circle in job.circles}
    assert len(too_deep) == len(HOLES)
    assert min(too_deep.values()) > 0.15
    assert walls == pytest.approx(too_deep, abs=0.07)
    assert MEASURING.across * job.sigma_mm == pytest.approx(max(walls.values()), abs=1e-3)


def test_results_of_such_a_job_are_as_uncertain(tmp_path: Path) -> None:
    """The sigma across the face contains what the circles may be off by, also of a job from its files."""
    seen, rig = pair(0.5), prepare(RIG)
    save_job(tmp_path / "disc", propose_from_pair(*seen, rig.rectification, WantedJob("disc", 1)).job)
    taught = load_job(tmp_path / "disc")
    job = replace(teach(*seen, rig.rectification, None, "disc"), limits=taught.limits)
    assert job.sigma_mm == taught.sigma_mm > 0.07
    for other in (job, replace(job, sigma_mm=0.0)):
        target = locate(frame_pair(*seen), other, rig).targets[0]
        assert (target.sigma_mm[2] > MEASURING.across * job.sigma_mm) == bool(other.sigma_mm)
        assert bool(target.reject & Reject.SIGMA_LIMIT) == bool(other.sigma_mm)


@pytest.mark.parametrize("wall", [0.05, 0.3])
def test_dark_walls_are_not_named(wall: float) -> None:
    """A wall half as bright as the face shows the rim."""
    job, walls = walls_of(pair(0.5, wall))
    assert not walls
    assert job.sigma_mm == 0.0


def test_a_proposal_says_so() -> None:
    """Whoever teaches reads what is wrong, by how much, and what helps."""
    rectification = prepare(RIG).rectification
    inspection = propose_from_pair(*pair(0.5), rectification, WantedJob("disc", 1)).inspection
    bright = [
        text
        for code, text in zip(inspection.codes, inspection.warnings, strict=True)
        if code == "bright_walls"
    ]
    assert len(bright) == 1
    assert re.match(r"c0, c1, c2: .* 0\.\d\d to 0\.\d\d mm nearer", bright[0])
