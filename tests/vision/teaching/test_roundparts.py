"""Thick parts that are round: the wall in a bore and shadows turn with the camera, and tell no turn."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.cells import frame_pair
from helpers.drawnparts import place, rig
from solids import Design, Wall, box, circle
from solidworld import drawn, write_drawing

from edged.commands.teach import read_model
from edged.domain.arrays import Image
from edged.domain.frames import FramePair
from edged.domain.measurement import Reject
from edged.errors import TeachError
from edged.pipeline import locate
from edged.vision.teaching import cadpair
from edged.vision.teaching.pair import WantedJob, teach, view_of

TUBE = (
    Wall("base", circle(0.0, 0.0, 8.0), -1, True, 0.0, 14.0),
    Wall("bore", circle(0.0, 0.0, 2.75), 0, False, 0.0, 14.0),
)
MARK = Wall("mark", box(5.3, 0.0, 2.6, 2.6, 0.3), 0, False, 0.0, 14.0)


def seen(design: Design, seed: int, tilt_deg: float = 0.0) -> tuple[Image, Image]:
    """A pair of a part, with walls and light of their own; a tilt of 0 is the pose it is taught in."""
    rng = np.random.default_rng((81, seed, round(tilt_deg)))
    return drawn(design, place(tilt_deg), rng, teaching=tilt_deg == 0.0)[0]


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_a_tube_is_taught_round_and_no_turn_of_it_is_stated(seed: int) -> None:
    """Whatever is seen in its bore: its axis is free, wherever it lies."""
    tube = Design("tube", TUBE)
    job = teach(*seen(tube, seed), rig().rectification, None, "tube")
    assert job.shape.round
    pair: FramePair = frame_pair(*seen(tube, seed, 12.0))
    outcome = locate(pair, replace(job, tilt_rad=math.radians(30.0)), rig())
    accepted = [target for target in outcome.targets if target.reject is Reject.NONE]
    assert all(target.free_axis is not None for target in accepted)


def test_a_hole_beside_its_axis_tells_how_a_tube_is_turned() -> None:
    """A square hole is no accident of the light."""
    job = teach(*seen(Design("tube", (*TUBE, MARK)), 1), rig().rectification, None, "tube")
    assert not job.shape.round


@pytest.mark.long
def test_a_tube_that_its_pair_does_not_teach_is_found_with_its_file(tmp_path: Path) -> None:
    """No turn of it is a rival of how it lies, when it is looked for by all its edges."""
    tube = Design("tube", TUBE)
    pair = seen(tube, 2)
    with pytest.raises(TeachError):
        teach(*pair, rig().rectification, None, "tube")
    write_drawing(tmp_path, tube)
    _, shown = read_model(tmp_path / "tube.step", "-z")
    view = view_of(*pair, rig().rectification, None)
    settled = cadpair.teach_with_model(view, shown.curves, "tube", WantedJob("tube", 1))
    assert "looked for by all its edges" in settled.remarks[0]
    job = settled.job
    assert job.part_from_model is not None
    axis = (job.rig_from_part @ job.part_from_model)[:3, 2]
    assert math.degrees(math.acos(min(abs(float(axis @ place(0.0)[:3, 2])), 1.0))) < 0.2
