"""The widths of edge breaks: those that a part is searched with, and those that a pair shows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from helpers.drawnparts import images_of, pair, place, rig
from solids import random_design
from solidworld import write_drawing

from edged.commands.teach import read_model
from edged.domain.arrays import FloatArray
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply
from edged.vision.solid import locate
from edged.vision.solid.bestfit import best_fit
from edged.vision.solid.edgemodel import EdgeModel, model_of
from edged.vision.solid.forms import PosedPair, as_shown, with_breaks
from edged.vision.solid.lock import Pyramids
from edged.vision.solid.modes import PartPlace, SearchedPart, find_places
from edged.vision.solid.params import BREAKS
from edged.vision.teaching.cadbody import body_of
from edged.vision.teaching.pair import teach

DESIGN = 3
"""A design whose breaks its teaching pair does not settle."""


@pytest.mark.long
def test_where_narrow_breaks_lead_nowhere_a_part_is_looked_for_by_wide_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A part is searched once with narrow breaks, and again with wide ones if those find nothing."""
    looked: list[float] = []

    def found(
        wanted: SearchedPart, pyramids: Pyramids, before: Sequence[PartPlace] | None = None
    ) -> list[PartPlace]:
        widest = max(float(model.breaks_mm.max()) for model in wanted.models)
        looked.append(widest)
        return find_places(wanted, pyramids, before) if widest in allowed else []

    monkeypatch.setattr(locate, "find_places", found)
    job = teach(*pair(DESIGN, 0.0), rig().rectification, None, "part")
    images = StereoImages.of(rig().rectification, *pair(DESIGN, 10.0))
    allowed = {BREAKS.looked_mm}
    (part,), _, _ = locate.locate_solid(images, job)
    moved = place(10.0) @ np.linalg.inv(place(0.0)) @ job.rig_from_part
    assert np.linalg.norm(part.target.rig_from_part[:3, 3] - apply(moved, job.place_of(job.reference))) < 0.1
    assert looked == [BREAKS.looked_mm]
    allowed = {BREAKS.looked_wide_mm}
    measured, _, _ = locate.locate_solid(images, job)
    assert looked[1:] == [BREAKS.looked_mm, BREAKS.looked_wide_mm]
    assert len(measured) == 1


@pytest.mark.long
@pytest.mark.parametrize("wrong_mm", [-0.08, 0.08])
def test_breaks_taught_with_a_wrong_width_are_measured_as_the_pair_shows_them(
    tmp_path: Path, wrong_mm: float
) -> None:
    """Breaks of 0.25 mm taught too narrow or too wide are found right to 0.02 mm, and the place to 10 µm.

    With the taught widths held, the part is more than 50 µm off.
    """
    design, tilt_deg = 8, 25.0
    true_mm = random_design(design).walls[0].break_mm
    write_drawing(tmp_path, random_design(design))
    drawing, _ = read_model(tmp_path / f"P{design}.step", "-z")
    body = body_of(drawing, np.eye(4))
    assert body is not None
    images = images_of(design, 2, tilt_deg)
    taught = with_breaks(model_of(body), true_mm + wrong_mm)
    view = PosedPair(images, Pyramids(images.rig, images.raw, BREAKS.levels), place(tilt_deg))

    def off_mm(model: EdgeModel, pose: FloatArray) -> float:
        fit = best_fit(model, view.pyramids, images, pose)
        assert fit is not None
        return float(np.linalg.norm(fit.pose[:3, 3] - place(tilt_deg)[:3, 3]))

    shown, there = as_shown(taught, view)
    assert abs(np.median(shown.breaks_mm[shown.breaks_mm > 0]) - true_mm) < 0.02
    assert off_mm(shown, there.pose) < 0.01
    assert off_mm(taught, view.pose) > 0.05
