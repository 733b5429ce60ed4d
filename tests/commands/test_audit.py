"""`edged audit`: the records, and whether the chain holds."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.commandline import exit_code
from helpers.journaledcell import DEEDS, JOURNALD
from helpers.waiting import LIMIT_S

from edged.files.statefolder import state_folder
from edged.identity.audit import LINES, AuditEntry, AuditFile


@pytest.mark.slow
def test_the_chain_is_printed_and_verified(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The exit code is 0 while the chain holds, also after a torn line, 1 after a changed byte, 2 for no
    file, be it the records or the configuration."""
    monkeypatch.setenv("COLUMNS", "300")
    config = tmp_path / "cell.toml"
    lines = state_folder(config) / LINES

    def asked(*options: str) -> tuple[int, str]:
        code, (out, err) = exit_code("audit", config, *options), capsys.readouterr()
        return code, out + err

    assert (2, True) == ((mistyped := asked())[0], "cell.toml: 1 problem\n  cannot be read" in mistyped[1])
    config.touch()
    assert (0, True) == ((first := asked())[0], "no record is kept" in first[1])
    config.unlink()  # the records of a cell that is gone can be read
    for outcome in ("role", "ok"):
        AuditFile(lines.parent).add(
            AuditEntry("[red]Anna\x1b[2J", "engineer", "10.0.0.7", "POST", "setup", outcome, reason="a board")
        )
    code, said = asked()
    assert 0 == code
    assert "\x1b" not in said
    assert "[red]Anna�[2J engineer at 10.0.0.7  POST setup: role (a board)" in said
    assert "2 records, the chain holds" in said
    code, said = asked("--json", "--last", "1")
    document = json.loads(said)
    assert (0, [2], 2, None) == (
        code,
        [record["number"] for record in document["records"]],
        document["count"],
        document["problem"],
    )
    data = lines.read_bytes()
    lines.write_bytes(data + b"{")
    assert (0, True) == ((torn := asked())[0], "a crash tore" in torn[1])
    lines.write_bytes(data.replace(b"Anna", b"Anne", 1))
    assert (1, True) == ((changed := asked())[0], "record 1 was changed" in changed[1])
    assert 1 == asked("--json")[0]
    lines.unlink()
    lines.mkdir()
    assert (2, True) == ((gone := asked())[0], "cannot read the audit" in gone[1])


@pytest.fixture(scope="module")
def against_journal(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str]]:
    """Outcome of the command with a journald, for each change of the files."""
    ran = subprocess.run(
        [
            "unshare",
            "--mount",
            sys.executable,
            "-m",
            "helpers.journaledcell",
            str(tmp_path_factory.mktemp("c")),
        ],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    return {step: (code, said) for step, (code, said) in json.loads(ran.stdout).items()}


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0 or not JOURNALD.exists(), reason="no journald of our own can be run")
@pytest.mark.parametrize(
    ("step", "code", "expected"),
    [
        ("as it is", 0, f"the journal has record {DEEDS}, and none that is another one here"),
        ("deleted", 1, "record 1, which the journal has, is missing"),
        ("deleted with its folder", 1, "record 1, which the journal has, is missing"),
        ("another history", 1, "record 1 is not the one in the journal"),
        ("one more in the files", 0, "the 1 after it are in the files alone"),
        ("a stranger's entries", 0, f"the journal has record {DEEDS}, and none that is another one here"),
        ("a full disc", 0, "2 records before this may be missing: No space left on device"),
    ],
)
def test_the_journal_shows_what_the_files_alone_cannot(
    against_journal: dict[str, tuple[int, str]], step: str, code: int, expected: str
) -> None:
    """The journal reveals deleted or rewritten records, and a forged entry of another user is ignored."""
    found, said = against_journal[step]
    assert expected in said
    assert code == found
