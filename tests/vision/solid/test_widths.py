"""The widths of edge breaks that a part is searched with while no pair has settled them."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.drawnparts import pair, place, rig

from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply
from edged.vision.solid import locate
from edged.vision.solid.lock import Pyramids
from edged.vision.solid.modes import PartPlace, SearchedPart, find_places
from edged.vision.solid.params import BREAKS
from edged.vision.teaching.pair import teach

DESIGN = 4
"""A design with breaks of 0.39 mm, which its teaching pair does not settle."""


@pytest.mark.long
def test_where_narrow_breaks_lead_nowhere_a_part_is_looked_for_by_wide_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A part is searched once with narrow breaks, and again with wide ones if those find nothing."""
    looked: list[float] = []

    def found(wanted: SearchedPart, pyramids: Pyramids) -> list[PartPlace]:
        widest = max(float(model.breaks_mm.max()) for model in wanted.models)
        looked.append(widest)
        return find_places(wanted, pyramids) if widest in allowed else []

    monkeypatch.setattr(locate, "find_places", found)
    job = teach(*pair(DESIGN, 0.0), rig().rectification, None, "part")
    images = StereoImages.of(rig().rectification, *pair(DESIGN, 25.0))
    allowed = {BREAKS.looked_mm}
    (part,), _, _ = locate.locate_solid(images, job)
    moved = place(25.0) @ np.linalg.inv(place(0.0)) @ job.rig_from_part
    assert np.linalg.norm(part.target.rig_from_part[:3, 3] - apply(moved, job.place_of(job.reference))) < 0.1
    assert looked == [BREAKS.looked_mm]
    allowed = {BREAKS.looked_wide_mm}
    measured, _, _ = locate.locate_solid(images, job)
    assert looked[1:] == [BREAKS.looked_mm, BREAKS.looked_wide_mm]
    assert len(measured) == 1
