"""A reload that cannot be carried out: refused, whatever went wrong, and systemd hears that it is over."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from edged.app import daemon as module
from edged.app.cell import LoadedCell, load_cell
from edged.app.daemon import Daemon
from edged.commands.demo import DemoOptions, prepare_cell
from edged.errors import ConfigError
from edged.sim.cell import VirtualCell, demo_part, demo_rig
from edged.sim.world import VirtualWorld


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, LoadedCell]:
    """A cell's configuration and what it becomes."""
    path = prepare_cell(
        tmp_path_factory.mktemp("cell"), VirtualCell(demo_rig(), demo_part()), DemoOptions(), gige=False
    )
    return path, load_cell(path)


class Notes:
    """What systemd is told."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def reloading(self) -> None:
        self.told.append("RELOADING")

    def reloaded(self, refused: str = "") -> None:
        self.told.append(f"READY {refused}")


def reloaded(cell: tuple[Path, LoadedCell], error: Exception, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What systemd hears of a reload during which this error comes."""

    def fail(path: Path) -> LoadedCell:
        raise error

    notes = Notes()

    async def main() -> None:
        with VirtualWorld(gige=False) as world:
            daemon = Daemon(*cell, world=world)
            monkeypatch.setattr(daemon, "_notifier", notes)
            monkeypatch.setattr(module, "load_cell", fail)
            assert not await daemon.reload()

    asyncio.run(main())
    return notes.told


@pytest.mark.parametrize(
    "error",
    [
        ConfigError("cell.toml", ["cycle.period: unknown key"]),
        OSError(5, "Input/output error"),
        PermissionError(13, "Permission denied"),
        RuntimeError("Could not determine home directory."),
        RecursionError("maximum recursion depth exceeded"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_whatever_cannot_be_read_is_a_refused_reload(
    cell: tuple[Path, LoadedCell], error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    """RELOADING is followed by READY, with the reason; the daemon goes on."""
    begun, ended = reloaded(cell, error, monkeypatch)
    assert "RELOADING" == begun
    assert str(error) in ended


def test_a_bug_in_a_reload_shows_and_systemd_hears_that_it_is_over(
    cell: tuple[Path, LoadedCell], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is raised for the log, and the unit does not stay "reloading" until it is killed."""
    told: list[str] = []
    monkeypatch.setattr(Notes, "reloaded", lambda _, refused="": told.append(refused))
    with pytest.raises(ZeroDivisionError):
        reloaded(cell, ZeroDivisionError("a bug"), monkeypatch)
    assert ["a bug, see the log"] == told


@pytest.mark.parametrize(
    ("file", "content", "problem"),
    [
        ("cell.toml", '[cell]\nrig = "~nobody-of-this-name/rig.json"\n', "cell.rig"),
        ("rig.json", "[" * 100_000, "not JSON"),
    ],
)
def test_a_file_that_breaks_its_reader_is_a_mistake_in_it(
    tmp_path: Path, file: str, content: str, problem: str
) -> None:
    """A home directory that nobody has, a file of nothing but brackets: named like any other mistake."""
    path = prepare_cell(tmp_path, VirtualCell(demo_rig(), demo_part()), DemoOptions(), gige=False)
    (tmp_path / file).write_text(content)
    with pytest.raises(ConfigError, match=problem):
        load_cell(path)
