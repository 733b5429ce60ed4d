"""A folder is replaced as a whole: whenever the process dies, the former or the new one is there."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from edged.errors import FileFormatError
from edged.files import atomic
from edged.files.atomic import next_generation, read_folder, replace_folder

KILLED = """
import ctypes, errno, os, sys
from pathlib import Path
from edged.files.atomic import replace_folder

if sys.argv[2] == "refused":
    class Refusing:
        def renameat2(self, *_):
            ctypes.set_errno(errno.EINVAL)
            return -1
    ctypes.CDLL = lambda *_, **__: Refusing()

OLD, NEW = {"a": b"old", "b/c": b"old"}, {"a": b"new", "b/c": b"new"}

def die_before(step):
    count = 0
    def hook(event, _):
        nonlocal count
        count += event.startswith(("os.", "open", "shutil.", "tempfile.", "ctypes."))
        if count == step:
            os._exit(9)
    sys.addaudithook(hook)

def state(folder):
    files = (file for file in folder.rglob("*") if file.is_file())
    found = {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}
    return {(): "none", tuple(OLD.items()): "old", tuple(NEW.items()): "new"}.get(
        tuple(sorted(found.items())), "broken"
    )

code, step = 9, 0
while code == 9:
    step += 1
    cell = Path(sys.argv[1], str(step))
    replace_folder(cell / "job", OLD)
    child = os.fork()
    if not child:
        die_before(step)
        replace_folder(cell / "job", NEW, cell / "kept")
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    seen = state(cell / "job")
    replace_folder(cell / "job", NEW, cell / "kept")
    print(seen, state(cell / "job"))
"""


def _killed_at_every_step(folder: Path, exchange: str) -> list[tuple[str, str]]:
    """The contents of a folder after its replacement died before each of its steps, and after another try."""
    run = subprocess.run(
        [sys.executable, "-c", KILLED, folder, exchange], capture_output=True, text=True, check=True
    )
    return [(line.split()[0], line.split()[1]) for line in run.stdout.splitlines()]


def _names(folder: Path) -> set[str]:
    return {file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file()}


@pytest.mark.slow
def test_a_death_leaves_the_former_folder_or_the_new_one(tmp_path: Path) -> None:
    """After a death before any step the former or the new folder is there, unmixed, and another try
    succeeds."""
    seen = _killed_at_every_step(tmp_path, "granted")
    states = [after for after, _ in seen]
    assert len(states) > 20
    assert ["old"] * states.count("old") + ["new"] * states.count("new") == states
    assert 0 < states.count("old") < len(states) - 1
    assert {"new"} == {again for _, again in seen}


@pytest.mark.slow
def test_where_names_cannot_be_exchanged_one_death_leaves_none(tmp_path: Path) -> None:
    """If the file system cannot exchange names, one death leaves no folder, and the former one lies beside
    it."""
    seen = _killed_at_every_step(tmp_path, "refused")
    states = [after for after, _ in seen]
    assert {"old", "none", "new"} == set(states)
    assert 1 == states.count("none")
    (aside,) = (tmp_path / str(states.index("none") + 1)).glob(".job.*-")
    assert b"old" == (aside / "a").read_bytes()
    assert {"new"} == {again for _, again in seen}


def test_the_former_folder_is_kept_where_it_was_asked_for(tmp_path: Path) -> None:
    """The former folder is kept under the given name, then numbered ones; an unchanged one is not
    replaced."""
    cell, first = tmp_path / "cell", tmp_path / "cell.old"
    cell.mkdir()
    kept = [replace_folder(cell, {"a/b": bytes([n])}, first) for n in range(4)]
    assert [None, first, tmp_path / "cell.2.old", tmp_path / "cell.3.old"] == kept
    assert b"\3" == (cell / "a/b").read_bytes()
    assert [b"\0", b"\1", b"\2"] == [(place / "a/b").read_bytes() for place in kept if place]

    assert None is replace_folder(cell, {"c": b""})
    names = {"cell/c", "cell.old/a/b", "cell.2.old/a/b", "cell.3.old/a/b"}
    assert names == _names(tmp_path)
    assert None is replace_folder(cell, {"c": b""}, first)  # as it is already
    assert names == _names(tmp_path)


def test_the_next_generation_is_later_than_each_that_is_there(tmp_path: Path) -> None:
    """The next generation follows the highest number, whatever was removed; other names do not count."""
    first = tmp_path / "rig.cal-1.json"
    assert first == next_generation(first)
    for name in ("rig.cal-1.3.json", "rig.cal-2.7.json", "rig.cal-1.x.json", f"rig.cal-1.{'9' * 30}.json"):
        (tmp_path / name).touch()
    assert tmp_path / "rig.cal-1.4.json" == next_generation(first)


def test_a_replacement_that_fails_changes_nothing(tmp_path: Path) -> None:
    """A replacement that fails to write a file, or to keep the former folder, changes nothing."""
    cell, kept = tmp_path / "cell", tmp_path / "none" / "kept"
    replace_folder(cell, {"a": b"1"})
    with pytest.raises(OSError, match="none"):
        replace_folder(cell, {"a": b"2"}, kept)
    with pytest.raises(OSError, match="a"):
        replace_folder(cell, {"a": b"2", "a/b": b"3"})
    assert b"1" == (cell / "a").read_bytes()
    assert {"cell/a"} == _names(tmp_path)


@pytest.mark.parametrize(("replacements", "seen"), [(0, b"0"), (1, b"0"), (2, b"2")])
def test_a_folder_is_read_as_one_value(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, replacements: int, seen: bytes
) -> None:
    """A folder that is replaced while it is read gives the former files or the new ones, unmixed."""
    folder, kept = tmp_path / "job", tmp_path / "kept"
    replace_folder(folder, {"a": b"0", "b": b"0"})
    numbers = iter(range(1, replacements + 1))
    read = atomic._read  # noqa: SLF001  (between two files: nothing else stands there)

    def replacing(path: Path, what: str, opened: int | None) -> bytes:
        data = read(path, what, opened)
        for number in numbers:
            shutil.rmtree(kept, ignore_errors=True)
            replace_folder(folder, dict.fromkeys("ab", b"%d" % number), kept)
        return data

    monkeypatch.setattr(atomic, "_read", replacing)

    assert {"a": seen, "b": seen} == read_folder(folder, ("a", "b"), "a job")


def test_a_file_that_is_missing_is_named(tmp_path: Path) -> None:
    """A missing file or folder is named at once."""
    replace_folder(tmp_path / "job", {"a": b"0"})
    with pytest.raises(FileFormatError, match=r"job/b: cannot read a job: No such file"):
        read_folder(tmp_path / "job", ("a", "b"), "a job")
    with pytest.raises(FileFormatError, match=r"nothing: cannot read a job: No such file"):
        read_folder(tmp_path / "nothing", ("a",), "a job")
