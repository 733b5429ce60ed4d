"""`edged audit`: the records, and whether the chain holds."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from edged.__main__ import main
from edged.files.statefolder import state_folder
from edged.identity.audit import LINES, AuditEntry, AuditFile


@pytest.mark.slow
def test_the_chain_is_printed_and_verified(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """0 while it holds, also where a crash tore a line; 1 after one changed byte; 2 for what is no file."""
    monkeypatch.setenv("COLUMNS", "300")
    config = tmp_path / "cell.toml"
    lines = state_folder(config) / LINES

    def asked(*options: str) -> tuple[int, str]:
        monkeypatch.setattr("sys.argv", ["edged", "audit", str(config), *options])
        with pytest.raises(SystemExit) as ended:
            main()
        out, err = capsys.readouterr()
        return int(ended.value.code or 0), out + err

    assert (0, True) == ((first := asked())[0], "0 records" in first[1])
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
