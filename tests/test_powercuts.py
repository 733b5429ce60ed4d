"""Power cuts while jobs, rigs, backups and recordings are written leave the old state or the new."""

from __future__ import annotations

import os
import random
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from helpers import statewriters
from helpers.powercuts import Call, Changed, Disk, Record, Synced, cut

from edged.files import atomic


@pytest.mark.long
def test_300_power_cuts_leave_the_old_state_or_the_new(template: Path, tmp_path: Path) -> None:
    """After a power cut at any call the cell is readable, unmixed, and has everything that was completed."""
    assert [] == statewriters.survive(template / "cell.toml", tmp_path, 300, seed=1)


@pytest.mark.long
@pytest.mark.parametrize("of_files", [True, False], ids=["files", "folders"])
def test_writers_that_bring_nothing_to_the_disk_are_caught(
    template: Path, tmp_path: Path, of_files: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the fsync of files, or of folders, the cuts find mixed states."""

    def careless(calls: Sequence[Call], dice: random.Random) -> Disk:
        files = {call.thing for call in calls if isinstance(call, Changed) and call.content is not None}
        return cut(
            [call for call in calls if not isinstance(call, Synced) or (call.thing in files) != of_files],
            dice,
        )

    monkeypatch.setattr(statewriters, "cut", careless)
    assert statewriters.survive(template / "cell.toml", tmp_path, 40, seed=1)


Tree = tuple[tuple[str, bytes | None], ...]


def left_by(root: Path, write: Callable[[], None], cuts: int = 200) -> set[Tree]:
    """What cuts leave of one writer, by path, without temporary files."""
    root.mkdir()
    record = Record(root)
    with record.watching():
        write()
    dice = random.Random(1)
    trees = (cut(record.calls[: dice.randint(0, len(record.calls))], dice).tree() for _ in range(cuts))
    return {
        tuple(sorted((path, content) for path, (_, content) in tree.items() if not path.startswith(".")))
        for tree in trees
    }


def test_a_disk_may_keep_a_name_without_its_content(tmp_path: Path) -> None:
    """A file that was written in place may be missing, empty, cut or whole."""
    file = tmp_path / "disk" / "a"

    def carelessly() -> None:
        handle = os.open(file, os.O_CREAT | os.O_WRONLY)
        os.write(handle, b"12")
        os.close(handle)

    whole = [(), (("a", b""),), (("a", b"1"),), (("a", b"12"),)]
    assert set(whole) == left_by(tmp_path / "disk", carelessly)


def test_an_atomic_file_is_there_or_not(tmp_path: Path) -> None:
    """A file that was written atomically is whole or missing."""
    file = tmp_path / "disk" / "a"
    assert {(), (("a", b"12"),)} == left_by(tmp_path / "disk", lambda: atomic.write_atomically(file, b"12"))


def test_two_names_are_kept_in_any_order(tmp_path: Path) -> None:
    """Without an fsync between them either of two names may be there alone."""

    def both() -> None:
        for name in "ab":
            os.mkdir(tmp_path / "disk" / name)  # noqa: PTH102  (the call that is watched)

    one, other = ("a", None), ("b", None)
    assert {(), (one,), (other,), (one, other)} == left_by(tmp_path / "disk", both)
