"""`edged web`: a code for a cell that can be set up on its page."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.commandline import exit_code

from edged.files.statefolder import state_folder
from edged.identity.invite import Invite

CELL = "[cell]\nname = 'c'\nrig = 'rig.json'\njobs = 'jobs'\njob = 'a'\n[cameras]\nsource = 'virtual'\n"


def invited(config: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and output."""
    code, (out, err) = exit_code("web", "invite", config, "Anna"), capsys.readouterr()
    return code, out + err


def test_a_code_is_printed_that_the_daemon_knows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The daemon accepts the code, and the page's address is printed with it."""
    config = tmp_path / "cell.toml"
    config.write_text(CELL + "[web]\nport = 8081\ncommissioning = true\n")
    code, said = invited(config, capsys)
    assert 0 == code
    assert "http://127.0.0.1:8081/invite" in said
    assert Invite(state_folder(config)).take(said.split()[0], "Anna", is_new=True)


def test_a_cell_that_nobody_sets_up_on_its_page_has_no_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The error names the option that is off."""
    config = tmp_path / "cell.toml"
    config.write_text(CELL + "[web]\n")
    code, said = invited(config, capsys)
    assert (2, True) == (code, "web.commissioning" in said)
