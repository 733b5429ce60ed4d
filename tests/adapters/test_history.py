"""Each cycle of a daemon becomes a row, also after a kill; a full disc stops nothing."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from cameras.test_daemon import Cell
from helpers.snapshots import make_snapshot
from helpers.waiting import wait_until

from edged.adapters.history import CycleHistory
from edged.config.cell import HistorySection
from edged.files.history.packing import FILE, pack
from edged.files.history.query import ask
from edged.files.history.rows import FULL, spool_folder


def run_cycles(folder: Path, cycles: range, packer: Sequence[str] = ("true",), **limits: int) -> CycleHistory:
    """Run a history over cycles."""
    section = HistorySection(folder=folder, **{"min_free_mib": 0, **limits})

    async def live() -> CycleHistory:
        history = CycleHistory(section, "left", (packer, {}), pack_s=0.0)
        await history.start()
        for cycle in cycles:
            history.announce(make_snapshot(cycle))
        await history.close()
        return history

    return asyncio.run(live())


def test_what_waits_is_written_at_the_end(tmp_path: Path) -> None:
    """Waiting rows are written at the end and packed by the next one; another start's numbers are other
    cycles."""
    for _ in range(2):
        assert 20 == run_cycles(tmp_path, range(20)).figures.written
    assert 40 == pack(tmp_path, "north", "left", 400, 2000)
    assert [(40, 20)] == ask([tmp_path], "SELECT count(*), count(DISTINCT cycle) FROM cycles")[1]


@pytest.mark.slow
async def test_another_process_packs_while_the_cell_runs(tmp_path: Path) -> None:
    """A process packs at each interval while the cell runs, and all rows are there once."""
    section = HistorySection(folder=tmp_path, min_free_mib=0)
    program = (sys.executable, "-m", "edged.files.history.packing", str(tmp_path), "north", "left", "9", "9")
    history = CycleHistory(section, "left", (program, dict(os.environ)), pack_s=0.5)
    await history.start()
    for cycle in range(100):
        history.announce(make_snapshot(cycle))
        if cycle == 50:
            await asyncio.to_thread(wait_until, lambda: [*tmp_path.rglob(FILE)] or None)
    await history.close()
    pack(tmp_path, "north", "left", 9, 9)
    assert [(100, 100)] == ask([tmp_path], "SELECT count(*), count(DISTINCT cycle) FROM cycles")[1]


def test_without_room_the_cell_goes_on(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A too full disc, or a folder that cannot be made, is reported, and rows are counted as left out."""
    history = run_cycles(tmp_path, range(5), min_free_mib=100_000_000)
    assert (0, 5) == (history.figures.written, history.figures.left_out)
    assert "MiB are free" in history.figures.problem
    (tmp_path / "file").write_text("")
    assert 5 == run_cycles(tmp_path / "file", range(5)).figures.left_out
    assert 2 == len([record for record in caplog.records if record.message.startswith("no history")])


def test_a_spool_that_nobody_packs_is_bounded(tmp_path: Path) -> None:
    """The oldest rows of a spool without a packer are removed."""
    spool = spool_folder(tmp_path, "left")
    spool.mkdir(parents=True)
    for number in range(3):
        (spool / f"0-00000{number}{FULL}").write_bytes(b"\n" * 700_000)
    history = CycleHistory(HistorySection(folder=tmp_path, max_mib=1), "left", (("true",), {}))
    history._drop_oldest()  # noqa: SLF001  (an hour passes before it does)
    assert [f"0-000002{FULL}"] == sorted(path.name for path in spool.iterdir())


@pytest.mark.long
def test_a_daemon_that_is_killed_loses_a_second_at_most(tmp_path: Path) -> None:
    """After kill -9 of a daemon the next one packs what it left, and each row is there once."""
    cell = Cell(tmp_path, 'source = "virtual-inprocess"')
    more = '\n[history]\nfolder = "history"\nplant = "north"\nmin_free_mib = 0\n'
    cell.config.write_text(cell.config.read_text() + more)
    folder = cell.config.parent / "history"

    def spooled() -> int:
        return sum(path.read_bytes().count(b"\n") for path in (folder / "spool").glob("*/*.open"))

    try:
        cell.start()
        count = wait_until(lambda: found if (found := spooled()) >= 5 else None)
        assert cell.process is not None
        cell.process.kill()
        cell.process.wait()
        cell.start()
        wait_until(lambda: list(folder.glob(f"plant=north/day=*/cell=*/{FILE}")) or None)
    finally:
        cell.stop()
    first = "(SELECT min(started_ns) FROM cycles)"
    found = ask([folder], f"SELECT started_ns, cycle FROM cycles WHERE started_ns = {first}")[1]
    assert len(found) >= count
    assert len(found) == len(set(found))
