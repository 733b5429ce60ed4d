"""Drafts of calibrations: they survive kills, reject hostile files, and every step can be undone."""

from __future__ import annotations

import json
import random
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.boardpairs import BOARD, SPEC, pairs
from helpers.powercuts import Record, cut

from edged.errors import CalibrationError, FileFormatError
from edged.setup.calibration import drafts as drafts_module
from edged.setup.calibration.drafts import Draft, Drafts, Solution, keep_pair, look_again
from edged.setup.calibration.shown import Seen

NOW = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)
SEEN = Seen(np.array([[1.0, 2.0], [9.0, 2.0], [9.0, 8.0], [1.0, 8.0]]), "", "", clipped=True)
NOTHING = Seen(None, "not_found", "no board", clipped=False)


def begin(folder: Path, boards: Sequence[str] = (SPEC,)) -> Draft:
    """A new draft."""
    return Drafts(folder).create("Anna", boards, 5.0, "division", NOW)


def add(draft: Draft, left: Seen = SEEN) -> str:
    """Add a view with arbitrary pictures."""
    name = draft.next_view
    for side in ("left", "right"):
        (draft.pictures / f"{name}_{side}.png").write_bytes(b"png")
    draft.add(name, left, SEEN)
    return name


def again(folder: Path, draft: Draft) -> Draft:
    """The same draft, loaded as by another process."""
    return Drafts(folder).load(draft.state.id)


def test_a_draft_is_on_disc_after_each_step(tmp_path: Path) -> None:
    """After each step another process loads the same state and revision."""
    draft = begin(tmp_path)
    steps = [
        lambda: add(draft),
        lambda: add(draft, NOTHING),
        lambda: draft.remove("view_001"),
        lambda: draft.set_goal(3.0),
        draft.undo,
        draft.undo,
        draft.redo,
        lambda: draft.solve(Solution("id", b"{}", b"<html>", {"rms": 0.1, "list": [1, None]})),
    ]
    for revision, step in enumerate(steps, 1):
        step()
        assert revision == draft.state.revision
        assert draft.state == again(tmp_path, draft).state
    assert (("view_001", "view_002"), ("view_001", "view_002")) == (draft.state.taken, draft.state.used)
    assert (b"{}", b"<html>") == (again(tmp_path, draft).rig(), again(tmp_path, draft).report())
    outline = draft.state.views["view_001"].left.outline
    assert outline is not None
    assert np.array_equal(SEEN.outline, outline)
    assert ("no board", None) == (
        draft.state.views["view_002"].left.reason,
        draft.state.views["view_002"].left.outline,
    )


def test_every_step_can_be_undone_and_done_again(tmp_path: Path) -> None:
    """Undo and redo work until another change, and names of undone views are not reused."""
    draft = begin(tmp_path)
    first, second = add(draft), add(draft)
    draft.remove(first)
    assert ((first, second), (second,)) == (draft.state.taken, draft.state.used)
    draft.undo()
    assert (first, second) == draft.state.used
    draft.undo()
    assert (first,) == draft.state.taken
    draft.redo()
    draft.undo()
    third = add(draft)
    assert third not in (first, second)
    assert (first, third) == draft.state.used
    with pytest.raises(CalibrationError, match="nothing to do again"):
        draft.redo()
    with pytest.raises(KeyError):
        draft.remove(second)
    draft.undo()
    draft.undo()
    with pytest.raises(CalibrationError, match="nothing to undo"):
        draft.undo()


def test_a_solution_is_of_the_views_it_was_made_of(tmp_path: Path) -> None:
    """A solution is dropped when its views change, but not when the goal does."""
    draft = begin(tmp_path)
    add(draft)
    draft.solve(Solution("first", b"old", b"", {}))
    draft.solve(Solution("second", b"rig", b"", {}))
    assert 2 == len([*draft.folder.glob("rig-*"), *draft.folder.glob("report-*")])
    draft.set_goal(1.0)
    assert b"rig" == draft.rig()
    for file in draft.folder.glob("rig-*"):
        file.write_bytes(b"gir")
    with pytest.raises(FileFormatError, match="not the solution that was kept"):
        draft.rig()
    draft.remove("view_001")
    with pytest.raises(CalibrationError, match="solve it first"):
        draft.report()


def test_a_board_is_stated_before_the_first_view(tmp_path: Path) -> None:
    """The board cannot be changed after the first view, and an invalid one is refused."""
    draft = begin(tmp_path, [])
    assert () == draft.state.board_models
    with pytest.raises(CalibrationError, match="is not a kind of board"):
        draft.set_boards(["carpet:3x4:1"])
    draft.set_boards([SPEC])
    assert (BOARD,) == again(tmp_path, draft).state.board_models
    add(draft)
    with pytest.raises(CalibrationError, match="another draft"):
        draft.set_boards(["chessboard:8x6:7"])


def test_old_drafts_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the newest drafts are kept, listed newest first."""
    monkeypatch.setattr(drafts_module, "KEPT", 2)
    made = [
        Drafts(tmp_path).create("Anna", [SPEC], None, "division", NOW.replace(second=second)).state.id
        for second in range(4)
    ]
    assert made[:1:-1] == Drafts(tmp_path).names()
    with pytest.raises(KeyError):
        Drafts(tmp_path).load(made[0])
    with pytest.raises(KeyError):
        Drafts(tmp_path).load("../drafts")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"views": {"../../etc/x": {}}}, "views"),
        ({"views": {}}, "operations on views that are not there: view_001"),
        (
            {"operations": [{"what": "exec", "view": "view_001"}]},
            "operations.0.what: expected 'add' or 'remove'",
        ),
        ({"done": 7}, "more operations done than there are"),
        ({"done": -1}, "done: expected at least 0"),
        ({"boards": ["carpet:1x1:1"]}, "is not a kind of board"),
        ({"revision": "9"}, "revision: expected a whole number"),
        ({"goal_um": 0}, "goal_um: expected more than 0"),
        ({"version": 2}, "version: expected 1"),
        ({"extra": 1}, "extra: unknown key"),
        ({"id": "20260101-000000-0000"}, "the folder's name"),
        ({"author": "x" * 3000}, "author"),
    ],
)
def test_what_is_no_draft_is_refused_by_place(tmp_path: Path, change: dict[str, Any], expected: str) -> None:
    """The error names file, field and expected value."""
    draft = begin(tmp_path)
    add(draft)
    file = draft.folder / "state.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), **change}))

    with pytest.raises(FileFormatError, match=rf"state\.json: .*{expected}"):
        again(tmp_path, draft)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff", b"[" * 100_000, b'{"done": NaN}'])
def test_garbage_is_refused(tmp_path: Path, content: bytes) -> None:
    """An invalid state file is refused by name."""
    draft = begin(tmp_path)
    (draft.folder / "state.json").write_bytes(content)
    with pytest.raises(FileFormatError, match=r"state\.json"):
        again(tmp_path, draft)


def test_pictures_are_files_of_the_draft(tmp_path: Path) -> None:
    """A missing picture, or a link to elsewhere, is refused."""
    draft = begin(tmp_path)
    name = add(draft)
    picture = draft.pictures / f"{name}_left.png"
    picture.unlink()
    with pytest.raises(FileFormatError, match=r"view_001_left\.png: a picture of the draft is missing"):
        again(tmp_path, draft)
    picture.symlink_to("/etc/hostname")
    with pytest.raises(FileFormatError, match="missing"):
        again(tmp_path, draft)


@pytest.mark.slow
def test_a_kept_pair_is_found_again(tmp_path: Path) -> None:
    """Looking again at a kept pair gives the same results as when it was written."""
    draft = begin(tmp_path)
    (left, right), seen_left, _ = keep_pair(draft.folder, "view_001", *pairs(1)[0], [BOARD])
    found = look_again(draft.pictures, ["view_001"], [BOARD])["view_001"]

    assert (left.digest, right.digest) == (found[0].digest, found[1].digest)
    assert np.array_equal(left.results[0].pixels, found[0].results[0].pixels)
    assert seen_left.outline is not None
    assert draft.small("view_001", "left").is_file()


def test_a_disc_that_refuses_costs_the_pair_alone(tmp_path: Path) -> None:
    """If the disk refuses a pair, an error says so and the draft is unchanged."""
    draft = begin(tmp_path)
    (draft.folder / "small").rmdir()
    with pytest.raises(CalibrationError, match="the pair cannot be kept: No such file"):
        keep_pair(draft.folder, "view_001", *pairs(1)[0], [BOARD])
    assert draft.state == again(tmp_path, draft).state


@pytest.mark.slow
def test_power_cuts_leave_the_draft_of_before_or_after_a_step(tmp_path: Path) -> None:
    """After a power cut at any call, the loaded draft has one of its earlier states."""
    root = tmp_path / "real"
    root.mkdir()
    record, states = Record(root), []

    def noted(step: object) -> None:
        states.append(draft.state)

    with record.watching():
        draft = begin(root)
        noted(None)
        for name in ("view_001", "view_002"):
            keep_pair(draft.folder, name, *pairs(1)[0], [BOARD])
            noted(draft.add(name, SEEN, SEEN))
        noted(draft.solve(Solution("id", b"rig", b"page", {})))
        noted(draft.remove("view_001"))
        noted(draft.undo())
    dice, found = random.Random(1), set()
    for number in range(60):
        disk = tmp_path / f"cut{number}"
        cut(record.calls[: dice.randint(0, len(record.calls))], dice).write(disk)
        for name in Drafts(disk).names():
            left = Drafts(disk).load(name)
            assert left.state in states
            found.add(left.state.revision)
            if left.state.solved is not None:
                assert (b"rig", b"page") == (left.rig(), left.report())
            for view in left.state.used:
                assert look_again(left.pictures, [view], [])[view][0].size == (640, 480)
    assert len(found) > 3
