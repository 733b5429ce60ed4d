"""A body laid on the pair that its part was taught from, and the edge breaks that its file does not have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.tilted import lying
from solids import random_design
from solidworld import drawn, world_rig, write_drawing

from edged.files.step import read_step
from edged.pipeline import prepare
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import invert, transform
from edged.vision.solid.breaks import lay_with_breaks
from edged.vision.solid.edgemodel import model_of
from edged.vision.teaching.cadbody import body_of

DESIGN, BREAK_MM = 4, 0.394


@pytest.mark.slow
def test_a_part_taught_by_the_lower_edges_of_its_breaks_is_laid_where_it_is(tmp_path: Path) -> None:
    """Those have the radii of the file, a break below its face: laid there, the model is right but for z."""
    design = random_design(DESIGN)
    write_drawing(tmp_path, design)
    body = body_of(read_step(tmp_path / f"P{DESIGN}.step"), np.eye(4))
    assert body is not None
    true = lying(world_rig(), 0.0, 70.0, 0.0)
    left, right = drawn(design, true, np.random.default_rng((5, DESIGN, 0)), teaching=True)[0]
    images = StereoImages.of(prepare(world_rig()).rectification, left, right)
    lower = true @ transform(np.eye(3), np.array([0.0, 0.0, BREAK_MM]))
    laid = lay_with_breaks(images, model_of(body), lower)
    assert laid is not None
    assert (invert(true) @ laid.fit.pose)[2, 3] == pytest.approx(0.0, abs=0.05)
    assert np.median(laid.model.breaks_mm[laid.model.breaks_mm > 0]) == pytest.approx(BREAK_MM, abs=0.03)
