"""The audit's chain: changes are found, crashes are survived, and both are reported."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.waiting import LIMIT_S

from edged.identity import audit as audit_module
from edged.identity.audit import HEAD, LINES, AuditEntry, AuditFile

DEED = AuditEntry("Anna", "engineer", "10.0.0.7", "POST", "setup", "ok", reason="Jörg „hat“ sie\n")


def kept(folder: Path, count: int = 5) -> AuditFile:
    """A chain with this many records."""
    audit = AuditFile(folder, lambda: 1_800_000_000.5)
    for number in range(1, count + 1):
        audit.add(replace(DEED, object=f"setup {number}"))
    return audit


def test_deeds_are_there_in_their_order(tmp_path: Path) -> None:
    """Records are in order with time, person, deed and reason, in files that only their owner reads."""
    audit = kept(tmp_path / "state")
    verdict = audit.verify()
    assert ("", 0) == (verdict.problem, verdict.torn_bytes)
    assert [f"setup {number}" for number in range(1, 6)] == [record["object"] for record in verdict.records]
    first = verdict.records[0]
    assert ("2027-01-15T08:00:00.500+00:00", "Anna", DEED.reason) == (
        first["time"],
        first["user"],
        first["reason"],
    )
    assert [0o600, 0o600] == [(tmp_path / "state" / name).stat().st_mode & 0o777 for name in (LINES, HEAD)]
    assert ("", ()) == ((none := AuditFile(tmp_path).verify()).problem, none.records)


def test_one_changed_byte_breaks_the_chain(tmp_path: Path) -> None:
    """Any changed byte of any line breaks the chain; the lines before it still count."""
    audit = kept(tmp_path, 3)
    data = (tmp_path / LINES).read_bytes()
    for place in range(0, len(data), 7):
        changed = bytearray(data)
        changed[place] ^= 1
        (tmp_path / LINES).write_bytes(changed)
        assert audit.verify().problem, place
    (tmp_path / LINES).write_bytes(data)
    assert "" == audit.verify().problem


def without(*numbers: int) -> Callable[[list[bytes]], list[bytes]]:
    """All lines except these."""
    return lambda lines: [line for number, line in enumerate(lines, 1) if number not in numbers]


@pytest.mark.parametrize(
    "change, problem",
    [
        (without(1), "records 1 to 1 are missing"),
        (without(2, 3), "records 2 to 3 are missing"),
        (without(5), "cut off: the last 1 of 5 records are missing"),
        (without(1, 2, 3, 4, 5), "cut off: the last 5 of 5 records are missing"),
        (lambda lines: [*lines, lines[-1]], "record 6 was changed"),
        (lambda lines: [lines[0], lines[2], lines[1], *lines[3:]], "records 2 to 2 are missing"),
        (lambda lines: [*lines[:2], b"\n", *lines[2:]], "record 3 cannot be read"),
        (lambda lines: [*lines[:4], lines[4][:40]], "cut off: the last 1 of 5 records are missing"),
    ],
)
def test_lines_that_are_gone_or_elsewhere_are_named(
    change: Callable[[list[bytes]], list[bytes]], problem: str, tmp_path: Path
) -> None:
    """Missing and exchanged lines are named, also if more are added afterwards."""
    audit = kept(tmp_path)
    lines = (tmp_path / LINES).read_bytes().splitlines(keepends=True)
    (tmp_path / LINES).write_bytes(b"".join(change(lines)))
    assert problem in audit.verify().problem
    audit.add(DEED)
    assert audit.verify().problem


def test_a_line_that_a_crash_tore_is_no_crime(tmp_path: Path) -> None:
    """A line that a crash tore is reported as torn, and the next record repairs it and says so."""
    audit = kept(tmp_path, 2)
    with (tmp_path / LINES).open("ab") as file:
        file.write(b'{"number":3,"time":')
    verdict = audit.verify()
    assert ("", 19, 2) == (verdict.problem, verdict.torn_bytes, len(verdict.records))
    audit.add(DEED)
    verdict = audit.verify()
    assert ("", 0) == (verdict.problem, verdict.torn_bytes)
    assert ["POST", "POST", "mend", "POST"] == [record["verb"] for record in verdict.records]
    assert "19 bytes" in verdict.records[2]["reason"]


def test_a_crash_between_line_and_head_is_none_either(tmp_path: Path) -> None:
    """A crash between line and head loses nothing and is no problem."""
    audit = kept(tmp_path, 2)
    head = (tmp_path / HEAD).read_bytes()
    audit.add(DEED)
    (tmp_path / HEAD).write_bytes(head)
    assert ("", 3) == ((verdict := audit.verify()).problem, len(verdict.records))
    audit.add(DEED)
    assert ("", 4) == ((verdict := audit.verify()).problem, len(verdict.records))


@pytest.mark.parametrize(
    "change, problem",
    [
        (lambda folder: (folder / HEAD).unlink(), f"{HEAD} is missing"),
        (lambda folder: (folder / HEAD).write_text("{}"), f"{HEAD} cannot be read"),
        (lambda folder: (folder / LINES).unlink(), f"{LINES} is missing, with 5 records"),
        (lambda folder: (folder / HEAD).write_text('{"number": 2, "hash": "0"}'), "record 2 is not the one"),
    ],
)
def test_a_head_that_does_not_fit_is_told(
    change: Callable[[Path], object], problem: str, tmp_path: Path
) -> None:
    """A head that does not fit its lines is reported."""
    audit = kept(tmp_path)
    change(tmp_path)
    assert problem in audit.verify().problem


def test_a_rewritten_history_is_another(tmp_path: Path) -> None:
    """A rewritten chain is valid but has another hash than the journal."""
    kept(tmp_path / "one")
    told = json.loads((tmp_path / "one" / HEAD).read_text())["hash"]
    other = AuditFile(tmp_path / "other", lambda: 1_800_000_000.5)
    for number in range(1, 6):
        other.add(replace(DEED, object=f"setup {number}", user="Ben" if number == 3 else "Anna"))
    assert "" == other.verify().problem
    assert told != json.loads((tmp_path / "other" / HEAD).read_text())["hash"]


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make files full with two records."""
    monkeypatch.setattr(audit_module, "FULL_BYTES", 600)


def files(folder: Path) -> list[Path]:
    """All files with records, the oldest first."""
    return [*sorted(folder.glob("audit.0*.jsonl")), folder / LINES]


@pytest.mark.usefixtures("small")
def test_the_chain_goes_on_in_the_next_file(tmp_path: Path) -> None:
    """The chain continues over several files, and a changed byte in a full file, or a missing file, is
    found."""
    audit = kept(tmp_path, 7)
    full = files(tmp_path)
    assert ["audit.000000002.jsonl", "audit.000000004.jsonl", "audit.000000006.jsonl", LINES] == [
        file.name for file in full
    ]
    assert {0o600} == {file.stat().st_mode & 0o777 for file in full}
    verdict = audit.verify()
    assert ("", 1, 7) == (verdict.problem, verdict.first, verdict.count)
    assert list(range(1, 8)) == [record["number"] for record in verdict.records]
    assert verdict.hash == verdict.records[-1]["hash"]
    for file in full:
        data = file.read_bytes()
        for place in range(0, len(data), 31):
            changed = bytearray(data)
            changed[place] ^= 1
            file.write_bytes(changed)
            assert audit.verify().problem, (file.name, place)
        file.write_bytes(data)
    assert "" == audit.verify().problem
    for file, problem in zip(
        full,
        ("records 1 to 2 are", "records 3 to 4 are", "records 5 to 6 are", "with 1 records"),
        strict=True,
    ):
        file.rename(tmp_path / "elsewhere")
        assert problem in audit.verify().problem
        (tmp_path / "elsewhere").rename(file)
    full[1].write_bytes(full[0].read_bytes())
    assert "record 3 was changed" in audit.verify().problem


@pytest.mark.usefixtures("small")
def test_some_of_the_records_are_asked_for_and_all_are_verified(tmp_path: Path) -> None:
    """The last records, or matching ones, are returned after all were verified; with a changed byte there
    are none."""
    audit = kept(tmp_path, 7)
    assert [6, 7] == [record["number"] for record in audit.verify(last=2).records]
    some = audit.verify(lambda record: record["number"] in (2, 3))
    assert ([2, 3], 7) == ([record["number"] for record in some.records], some.count)
    first = files(tmp_path)[0]
    first.write_bytes(first.read_bytes().replace(b"Anna", b"Anne", 1))
    assert ("record 1 was changed: its hash does not fit", ()) == (
        (found := audit.verify(last=2)).problem,
        found.records,
    )


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("count", [3, 40])
@pytest.mark.parametrize("head", [None, b"{}"], ids=["missing", "damaged"])
def test_a_lost_head_stays_on_record(
    head: bytes | None, count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next record follows one that says so, also after old files were deleted; the chain holds again."""
    monkeypatch.setattr(audit_module, "KEPT", 2)
    audit = kept(tmp_path, count)
    before = audit.verify()
    (tmp_path / HEAD).unlink() if head is None else (tmp_path / HEAD).write_bytes(head)
    assert audit.verify().problem
    audit.add(DEED)
    after = audit.verify()
    assert "" == after.problem
    lost = next(record for record in after.records if record["number"] == before.count + 1)
    assert ("mend", HEAD) == (lost["verb"], lost["object"])


@pytest.mark.usefixtures("small")
def test_a_head_that_cannot_be_read_is_an_error_and_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disc that fails while the head is read adds nothing, and later records follow as before."""
    audit = kept(tmp_path, 12)

    def failing(_folder: int) -> bytes:
        """A bad sector."""
        raise OSError("input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(audit_module, "_read_head", failing)
        with pytest.raises(OSError, match="input/output"):
            audit.add(DEED)
    audit.add(DEED)
    assert ("", 13) == ((verdict := audit.verify()).problem, verdict.count)


@pytest.mark.usefixtures("small")
def test_a_crash_while_the_next_file_is_begun_loses_nothing(tmp_path: Path) -> None:
    """A crash between the full file's new name and the next file's first line loses nothing, also with an
    older head."""
    audit = kept(tmp_path, 1)
    head = (tmp_path / HEAD).read_bytes()
    audit.add(DEED)
    (tmp_path / HEAD).write_bytes(head)
    real = audit_module.turn_over

    def broken(folder: int, number: int) -> None:
        """A disc that is gone as soon as the file has its new name."""
        real(folder, number)
        raise OSError("power cut")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(audit_module, "turn_over", broken)
        with pytest.raises(OSError, match="power cut"):
            audit.add(DEED)
    assert ["audit.000000002.jsonl"] == [file.name for file in files(tmp_path) if file.exists()]
    assert ("", 2) == ((verdict := audit.verify()).problem, verdict.count)
    audit.add(DEED)
    assert ("", 3) == ((verdict := audit.verify()).problem, verdict.count)


@pytest.mark.usefixtures("small")
def test_the_oldest_are_let_go_and_that_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest files are removed, a record and the head say so, further missing files are found, and
    after a crash the next record completes the removal.
    """
    monkeypatch.setattr(audit_module, "KEPT", 2)
    audit = kept(tmp_path, 40)
    verdict = audit.verify()
    assert "" == verdict.problem
    assert verdict.count - 6 <= verdict.first <= verdict.count - 4
    assert [verdict.first, verdict.count] == [verdict.records[at]["number"] for at in (0, -1)]
    told = [one["reason"] for one in verdict.records if one["verb"] == "let go"]
    assert f" to {verdict.first - 1}: " in told[-1]
    oldest, *others = files(tmp_path)
    assert 2 == len(others)
    oldest.rename(tmp_path / "elsewhere")
    assert "are missing" in audit.verify().problem
    (tmp_path / "elsewhere").rename(oldest)

    crashed = tmp_path / "audit.000000002.jsonl"
    crashed.write_bytes(b"of a crash")
    assert "" == audit.verify().problem
    audit.add(DEED)
    assert not crashed.exists()
    assert "" == audit.verify().problem
    assert sum(file.stat().st_size for file in files(tmp_path)) < 4 * 1000


def test_processes_that_add_at_once_make_one_chain(tmp_path: Path) -> None:
    """Processes that add records at the same time make one chain."""
    work = (
        "import sys; from pathlib import Path; from edged.identity import audit\n"
        "from edged.identity.audit import AuditFile, AuditEntry; audit.FULL_BYTES = 2000\n"
        "for _ in range(20): AuditFile(Path(sys.argv[1])).add(AuditEntry('root', '', '', 'make', 'x', 'ok'))"
    )
    others = [subprocess.Popen([sys.executable, "-c", work, str(tmp_path)]) for _ in range(2)]
    assert [0, 0] == [other.wait(LIMIT_S) for other in others]
    assert ("", 40) == ((verdict := AuditFile(tmp_path).verify()).problem, len(verdict.records))
