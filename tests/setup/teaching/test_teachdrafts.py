"""Drafts of jobs: they survive a kill, refuse damaged files, and keep what was set for a feature."""

from __future__ import annotations

import errno
import json
import os
import random
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.powercuts import Record, cut

from edged.errors import FileFormatError, TeachError
from edged.files.images import load_image
from edged.setup import pairs as pairfiles
from edged.setup.teaching.drafts import KeptPair, TeachingDraft, TeachingDrafts, kept_pair
from edged.setup.teaching.model import Brush, Content, Mark, Rectangle, nearest, region_of
from edged.vision.teaching.region import Region, painted_region

NOW = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)
PAIR = tuple(np.random.default_rng(side).integers(0, 255, (60, 80), np.uint8) for side in (0, 1))
START = Content(name="flange", number=3)
BOX = {"kind": "rectangle", "add": True, "x": 10.0, "y": 12.0, "width": 40.0, "height": 30.0}
C3 = Mark(kind="circle", x=40.0, y=30.0, size=9.0)


def begin(folder: Path) -> TeachingDraft:
    """Create a draft."""
    return TeachingDrafts(folder).create("Anna", START, KeptPair(*PAIR), NOW)


def pair_of(draft: TeachingDraft) -> list[np.ndarray]:
    """The two pictures of a draft as they are on disc."""
    return [load_image(draft.picture(side)) for side in ("left", "right")]


def steps(draft: TeachingDraft) -> None:
    """Change the draft in several ways."""
    draft.propose([BOX])
    draft.operate("features", {"left_out": [C3.model_dump(mode="json")]})
    draft.operate("about", {"name": "ring", "tilt_deg": 12.0})
    draft.undo()
    draft.operate("region", {"shapes": []})


def test_a_draft_is_on_disc_after_each_step(tmp_path: Path) -> None:
    """After each step another process reads the same state and the same grey values from disc."""
    draft = begin(tmp_path)
    steps(draft)
    again = TeachingDrafts(tmp_path).load(draft.state.id)
    assert draft.state == again.state
    assert all(np.array_equal(*images) for images in zip(PAIR, pair_of(again), strict=True))
    content = again.state.content
    assert ("flange", (), (C3,), None) == (content.name, content.shapes, content.left_out, content.tilt_deg)
    again.undo()
    again.undo()
    assert ((Rectangle(**BOX),), ()) == (again.state.content.shapes, again.state.content.left_out)
    with pytest.raises(TeachError, match="nothing to undo"):
        again.undo()


def test_what_the_cell_proposes_is_nobody_elses_change(tmp_path: Path) -> None:
    """A proposal does not raise the revision, so a user's simultaneous change is not refused."""
    draft = begin(tmp_path)
    draft.propose([BOX])
    assert (0, (Rectangle(**BOX),)) == (draft.state.revision, draft.state.content.shapes)
    assert draft.state == TeachingDrafts(tmp_path).load(draft.state.id).state


def test_power_cuts_leave_a_whole_draft(tmp_path: Path) -> None:
    """After a power cut at any call the draft has one of its states and both pictures, or does not exist
    yet."""
    root = tmp_path / "real"
    root.mkdir()
    record, seen = Record(root), []
    with record.watching():
        draft = begin(root)
        seen.append(draft.state)
        draft.propose([BOX])
        seen.append(draft.state)
        draft.operate("about", {"number": 4})
        seen.append(draft.state)
    dice, found = random.Random(2), set()
    for number in range(40):
        disk = tmp_path / f"cut{number}"
        cut(record.calls[: dice.randint(0, len(record.calls))], dice).write(disk)
        drafts = TeachingDrafts(disk)
        for name in drafts.names():
            draft = drafts.load(name)
            assert draft.state in seen
            assert all(np.array_equal(*images) for images in zip(PAIR, pair_of(draft), strict=True))
            found.add(seen.index(draft.state))
    assert {0, 1, 2} == found


def test_what_was_cut_off_while_it_began_goes(tmp_path: Path) -> None:
    """An old draft that was cut off while it was created is removed; fresh ones and other folders stay."""
    cut_off, fresh, other = (
        tmp_path / name for name in ("20260101-000000-abcd", "20260102-000000-abcd", "x")
    )
    for folder in (cut_off, fresh, other):
        folder.mkdir()
    for folder in (cut_off, other):
        os.utime(folder, (0, 0))
    draft = begin(tmp_path)
    assert {fresh, other, draft.folder} == set(tmp_path.iterdir())


def test_a_disc_that_is_full_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a full disc no draft and no picture is left behind, and a refused step does not change the draft."""
    draft = begin(tmp_path / "there")

    def full(path: Path, data: bytes, **_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(pairfiles, "write_atomically", full)
    with pytest.raises(OSError, match="No space"):
        begin(tmp_path)
    assert ["there"] == [entry.name for entry in tmp_path.iterdir()]
    monkeypatch.setattr("edged.setup.history.write_atomically", full)
    before = draft.state
    with pytest.raises(OSError, match="No space"):
        draft.operate("about", {"number": 4})
    assert before == draft.state == TeachingDrafts(tmp_path / "there").load(draft.state.id).state


HOSTILE: dict[str, dict[str, Any]] = {
    "a name that leads elsewhere": {"name": "../etc"},
    "a name that is hidden": {"name": ".job"},
    "no name": {"name": ""},
    "a number that no PLC has": {"number": 70_000},
    "a key that is not known": {"colour": 1},
    "a shape of no kind": {"shapes": [{**BOX, "kind": "star"}]},
    "too many shapes": {"shapes": [BOX] * 201},
    "no number": {"shapes": [{**BOX, "x": float("nan")}]},
    "a tilt that no camera sees": {"tilt_deg": 80.0},
}


@pytest.mark.parametrize("sets", HOSTILE.values(), ids=HOSTILE)
def test_what_cannot_be_is_refused(tmp_path: Path, sets: dict[str, Any]) -> None:
    """An impossible value is refused as a step, and in a state file that somebody else wrote."""
    draft = begin(tmp_path)
    with pytest.raises(TeachError):
        draft.operate("about", sets)
    assert 0 == draft.state.revision
    file = draft.folder / "state.json"
    state = json.loads(file.read_text())
    file.write_text(json.dumps({**state, "done": 1, "operations": [{"what": "about", "sets": sets}]}))
    with pytest.raises(FileFormatError, match=r"state\.json"):
        TeachingDrafts(tmp_path).load(draft.state.id)


def test_a_picture_that_is_gone_or_elsewhere_is_missed(tmp_path: Path) -> None:
    """A missing picture is named; a link instead of a picture counts as missing."""
    draft = begin(tmp_path)
    draft.picture("left").rename(tmp_path / "left.png")
    draft.picture("left").symlink_to(tmp_path / "left.png")
    with pytest.raises(FileFormatError, match=r"left\.png: a picture of the draft is missing"):
        TeachingDrafts(tmp_path).load(draft.state.id)
    with pytest.raises(KeyError):
        TeachingDrafts(tmp_path).load("../there")


def test_the_pair_stays_with_the_job(tmp_path: Path) -> None:
    """The job keeps its pairs, and is edited from the same grey values; a job without a pair is refused."""
    draft = begin(tmp_path / "drafts")
    steps(draft)
    other = draft.put_further(KeptPair(PAIR[1], PAIR[0]))
    draft.operate("further", {"further": [other]})
    with pytest.raises(TeachError, match="another size"):
        draft.put_further(KeptPair(PAIR[0][:10], PAIR[1][:10]))
    job = tmp_path / "jobs" / "flange"
    (job / "taught").mkdir(parents=True)
    with pytest.raises(TeachError, match="flange does not keep the pair"):
        kept_pair(job)
    for name, data in draft.kept().items():
        (job / name).write_bytes(data)
    pair = kept_pair(job)
    assert all(np.array_equal(*images) for images in zip(PAIR, (pair.left, pair.right), strict=True))
    assert draft.state.content == pair.content
    assert [other] == list(pair.further)
    assert all(np.array_equal(*images) for images in zip(PAIR[::-1], pair.further[other], strict=True))
    again = TeachingDrafts(tmp_path / "again").create("Anna", pair.content or START, pair, NOW)
    assert again.picture("right", pair=other).is_file()
    (job / "taught" / "content.json").write_text("{}")
    with pytest.raises(FileFormatError, match=r"content\.json"):
        kept_pair(job)


def test_a_feature_is_known_by_its_place() -> None:
    """A feature is recognised by its place, not its name; one elsewhere or of another size is another
    feature."""
    marks = {
        "c0": C3.model_copy(update={"size": 30.0}),
        "c1": C3,
        "s0": C3.model_copy(update={"kind": "slot"}),
    }
    assert "c1" == nearest(C3.model_copy(update={"x": 41.0, "size": 9.5}), marks)
    assert None is nearest(C3.model_copy(update={"x": 45.0}), marks)
    assert None is nearest(C3, {})


def test_shapes_lie_over_each_other() -> None:
    """An erased area may be added again; one shape with erased areas becomes region and exclude as in
    `edged teach`."""
    box, hole = Rectangle(**BOX), Rectangle(**{**BOX, "add": False, "x": 20.0, "width": 20.0})
    region, exclude = region_of([box, hole], 80, 60)
    assert (Region(10.0, 12.0, 40.0, 30.0), 1) == (region, len(exclude))
    region, exclude = region_of([box, hole, box.model_copy(update={"x": 30.0})], 80, 60)
    assert [] == exclude
    assert region is not None
    row = painted_region(region, exclude, 80, 60)[20]
    assert (255, 0, 255, 0) == (row[15], row[25], row[35], row[75])
    assert (None, []) == region_of([], 80, 60)
    brush = Brush(kind="brush", points=((20.0, 5.0), (20.0, 55.0), (20.0, 5.0)), radius=4.0)
    region, exclude = region_of([box, brush], 80, 60)
    assert region is not None
    row = painted_region(region, exclude, 80, 60)[20]
    assert (255, 0, 0, 255) == (row[14], row[17], row[23], row[26]), "a stroke crosses itself and erases"
    assert 1 == len(region_of([hole], 80, 60)[1])
