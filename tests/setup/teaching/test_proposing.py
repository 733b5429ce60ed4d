"""What a pair teaches, compared with the truth: every feature is measured, and edits are kept."""

from __future__ import annotations

import functools
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.blockpart import block
from helpers.cells import pictures, pose, scene, small_rig
from helpers.flatparts import DISC, PLATE

from edged.errors import TeachError
from edged.files.rig import rig_text
from edged.setup.inuse import RigInUse
from edged.setup.teaching.drafts import KeptPair, TeachingDraft, TeachingDrafts
from edged.setup.teaching.model import Content
from edged.setup.teaching.proposal import WantedJob, propose_from_pair
from edged.setup.teaching.proposing import JobSeen, LearningOrder, propose_region, see
from edged.sim.render.scene import Part, Scene
from edged.vision.geometry.rectification import make_rectification

NOW = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)
WHERE = pose()


@functools.cache
def rig() -> bytes:
    """The rig's file."""
    return rig_text(small_rig())


def drafted(folder: Path, part: Part) -> TeachingDraft:
    """A draft of a part with its proposed region."""
    return draft_of(folder, scene((part, WHERE)))


def draft_of(folder: Path, world: Scene) -> TeachingDraft:
    """A draft of what a scene shows, with its proposed region."""
    pair = KeptPair(*pictures(small_rig(), world))
    draft = TeachingDrafts(folder).create("Anna", Content(name="part", number=1), pair, NOW)
    corners = propose_region(draft.folder / "pictures")
    assert corners is not None
    draft.propose([{"kind": "polygon", "points": [[x, y] for x, y in corners]}])
    return draft


def seen(draft: TeachingDraft) -> JobSeen:
    """What the draft teaches."""
    return see(LearningOrder(draft.pictures, draft.state.content, RigInUse("cal", rig(), Path("rig.json"))))


def kept(one: JobSeen, name: str) -> Any:
    """A feature's place, as the page's backend stores it."""
    return one.marks[name].model_dump(mode="json")


def left_px(x: float, y: float) -> np.ndarray:
    """True place of a point of the part's face in the left picture."""
    place = WHERE[:3, :3] @ (x, y, 0.0) + WHERE[:3, 3]
    return small_rig().left.project(place[None])[0]


@pytest.mark.slow
def test_every_feature_is_measured_also_where_circles_say_everything(tmp_path: Path) -> None:
    """Slots beside circles have sizes and sigmas that agree with the truth."""
    draft = drafted(tmp_path, DISC)
    first = seen(draft)
    found = {one.key: one for one in first.features}
    truth = {"c0": {"diameter_mm": 26.0}, "c1": {"diameter_mm": 6.0}, "c2": {"diameter_mm": 3.0}}
    truth["s0"] = {"length_mm": 9.0, "width_mm": 4.0}
    assert truth.keys() == found.keys()
    for name, sizes in truth.items():
        one = found[name]
        assert (None, sizes.keys()) == (one.why, one.size.keys())
        for key, value in sizes.items():
            assert value == pytest.approx(one.size[key], abs=5e-3 * one.sigma_um + 0.02), (name, key)
    assert ["radius_c0"] == [size.key for size in first.sizes], "the job was asked for more than people want"

    draft.operate("about", {"reference": kept(first, "s0")})
    moved = seen(draft)
    assert "s0" == moved.job.reference
    assert np.abs(np.array(moved.reference.left) - left_px(4, -4)).max() < 0.3
    assert np.abs(moved.job.place_of("s0")).max() < 1e-9
    draft.operate("features", {"left_out": [kept(first, "s0"), kept(first, "c0")]})
    without = seen(draft)
    assert ("c1", ["c1", "c2"]) == (without.job.reference, [one.name for one in without.job.circles])
    assert without.predicted is not None
    assert min(without.predicted.sigma_um.model_dump().values()) > 0
    draft.operate("features", {"left_out": [kept(first, name) for name in found]})
    with pytest.raises(TeachError, match="a job needs a circle, a slot or two edges"):
        seen(draft)


@pytest.mark.slow
def test_a_part_of_edges_alone_has_corners_for_a_reference(tmp_path: Path) -> None:
    """Corners can be the reference; they go with their edge, and another corner becomes the reference."""
    draft = drafted(tmp_path, PLATE)
    first = seen(draft)
    kinds = [one.kind for one in first.features]
    assert (5, 5) == (kinds.count("edge"), kinds.count("corner"))
    names = {one.key: one.outline.left[0] for one in first.features if one.kind == "corner"}
    tips = [left_px(x, y) for x, y in PLATE.outline.points_mm]
    for name, place in names.items():
        assert min(np.linalg.norm(tip - place) for tip in tips) < 0.5, name
    corner = next(one for one in first.taught.corners if one.name == first.job.reference)
    draft.operate("features", {"left_out": [kept(first, corner.edges[0])]})
    fewer = seen(draft)
    assert (4, 3) == (len(fewer.job.edges), len(fewer.job.corners))
    assert first.job.reference != fewer.job.reference
    assert fewer.job.kind_of(fewer.job.reference) == "corner"


@pytest.mark.long
def test_what_one_pair_leaves_open_of_a_part_of_several_heights_is_said() -> None:
    """For a part of several heights the ambiguity from the cameras' angle is reported, for a flat one not."""
    images = make_rectification(small_rig())
    thick, flat = (
        propose_from_pair(*pictures(small_rig(), shown), images, WantedJob("p", 1)).inspection
        for shown in (block(pose()), scene((DISC, WHERE)))
    )
    said = dict(zip(thick.codes, thick.warnings, strict=True))
    assert "up to 2.0 times their width" in said["one_pair"]
    assert "one_pair" not in flat.codes


@pytest.mark.long
def test_the_page_warns_of_what_one_pair_leaves_open(tmp_path: Path) -> None:
    """The page shows the doubts that the console shows."""
    warnings = {warning.code: warning.at for warning in seen(draft_of(tmp_path, block(pose()))).warnings}
    assert warnings["one_pair"] is None
