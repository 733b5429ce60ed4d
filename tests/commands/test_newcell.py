"""A new cell: `edged run` writes its configuration, and a person logs in by a code."""

from __future__ import annotations

import asyncio
import re
import sys
from pathlib import Path

import pytest
from helpers.browsersession import PASSWORD, BrowserSession, browsing
from helpers.ports import free_port

from edged.adapters.aravis import CameraInfo
from edged.commands import newcell
from edged.commands.newcell import config_in, new_cell
from edged.config.reading import load
from edged.errors import ConfigError, UserError
from edged.setup.cellfiles import read_any_cell

CODE = re.compile(r"with the code ([a-z2-9]{4}-[a-z2-9]{4}-[a-z2-9]{4})")


def camera(serial: str) -> CameraInfo:
    """A camera that answered."""
    return CameraInfo(f"maker-{serial}", "maker", "model", serial, "10.0.0.1", "GigEVision", "", "free")


@pytest.mark.parametrize("serials", [[], ["1"], ["1", "2"], ["1", "2", "3"], ["1", 'x"\ny'], ["1", ""]])
def test_an_empty_folder_becomes_a_cell_that_can_be_set_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, serials: list[str]
) -> None:
    """For any number and naming of cameras the configuration is valid, allows setting up, and is kept."""
    monkeypatch.setattr(newcell, "aravis_missing", lambda: "")
    monkeypatch.setattr(newcell, "list_cameras", lambda: [camera(serial) for serial in serials])

    path = config_in(tmp_path)
    written = path.read_bytes()

    config = load(path)
    assert (tmp_path / "cell.toml", 0o600) == (path, path.stat().st_mode & 0o777)
    assert config.web is not None
    assert config.web.commissioning
    assert (serials == ["1", "2"]) == (config.cameras.left.device == "1")
    assert read_any_cell(path).config == config
    monkeypatch.setattr(newcell, "list_cameras", list)
    assert (path, written) == (config_in(tmp_path), path.read_bytes())


def test_a_file_that_is_missing_is_no_new_cell(tmp_path: Path) -> None:
    """A missing file is an error, not a new cell."""
    assert tmp_path / "cel.toml" == config_in(tmp_path / "cel.toml")
    assert [] == list(tmp_path.iterdir())
    with pytest.raises(ConfigError, match=r"cel\.toml"):
        load(tmp_path / "cel.toml")


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error gives the reason."""

    def refuse(path: Path, _data: bytes) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(newcell, "aravis_missing", lambda: "no Aravis")
    monkeypatch.setattr(newcell, "write_private", refuse)
    with pytest.raises(UserError, match=r"cell\.toml: cannot be written: Permission denied"):
        config_in(tmp_path)


@pytest.mark.long
async def test_the_first_engineer_comes_in_by_the_code_of_the_console(tmp_path: Path) -> None:
    """The code from the console makes an engineer who can take the cell."""
    web, modbus = free_port(), free_port()
    text = new_cell([]).replace("port = 1502", f"port = {modbus}").replace("[web]", f"[web]\nport = {web}")
    (tmp_path / "cell.toml").write_text(text)

    async def come_in(code: str) -> None:
        form = {"code": code, "name": "Anna", "password": PASSWORD, "again": PASSWORD}
        async with browsing(f"http://127.0.0.1:{web}") as session:
            browser = BrowserSession(session)
            async with session.post("/invite", data=form, headers={"Origin": browser.origin}) as answer:
                assert answer.status == 200
            assert (200, "engineer") == ((got := await browser.ask("GET", "/api/v1/me"))[0], got[1]["role"])
            assert (201, True) == (
                (got := await browser.ask("POST", "/api/v1/setup", {}))[0],
                "token" in got[1],
            )

    running = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "edged", "run", str(tmp_path)), stderr=asyncio.subprocess.PIPE
    )
    try:
        assert running.stderr is not None
        while not (found := CODE.search((await running.stderr.readline()).decode())):
            assert not running.stderr.at_eof(), "it ended before it said the code"
        await come_in(found[1])
    finally:
        running.terminate()
        await running.communicate()
