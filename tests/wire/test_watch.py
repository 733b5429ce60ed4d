"""`edged watch` against real cells; hostile neighbours included."""

from __future__ import annotations

import asyncio
import io
import itertools
import json
import threading
import time
from dataclasses import replace
from typing import Any

import pytest
from rich.console import Console
from snapshots import make_snapshot, make_transform
from zenohcell import READY, WAIT_S, Cell, free_port

from edged.adapters.zenoh import open_session, session_config
from edged.adapters.zenoh.cbor import decode_cbor
from edged.app.fleet import News
from edged.commands.watch import CellView, watch
from edged.domain import Calibrated, DriftState, Snapshot, Status
from edged.errors import ConfigError, UserError


async def watching(cell: Cell, snapshots: list[Snapshot], **options: Any) -> str:
    """What `watch` prints while a cell announces these snapshots, over and over, until it has enough."""
    file = io.StringIO()
    console = Console(file=file, width=120, force_terminal=options.pop("terminal", None))
    only = options.pop("only", None)
    ports = (cell.port, *options.pop("more_ports", ()))
    endpoints = [f"tcp/127.0.0.1:{port}" for port in ports]
    arguments = {"as_json": False, **options}
    codes: list[int] = []
    # daemonic: a watch that never has enough fails this test and hangs nothing
    thread = threading.Thread(
        target=lambda: codes.append(watch(endpoints, only, console=console, **arguments)), daemon=True
    )
    thread.start()
    deadline_s = time.monotonic() + WAIT_S
    for snapshot in itertools.cycle(snapshots):
        cell.publisher.announce(snapshot)
        await asyncio.sleep(0.03)
        if not thread.is_alive():
            break
        assert time.monotonic() < deadline_s, file.getvalue()
    assert [0] == codes
    return file.getvalue()


def run(snapshots, **options) -> str:
    """`watching` with a cell of its own."""

    async def main() -> str:
        async with Cell() as cell:
            cell.publisher.announce(READY)
            return await watching(cell, snapshots, **options)

    return asyncio.run(main())


def test_json_is_the_message_itself_one_a_line(capsys):
    """Every line is a JSON object as it was published, each result once and in order."""
    run([make_snapshot(7)], as_json=True, count=3)
    documents = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    first = documents[0]["sequence"]
    assert [first, first + 1, first + 2] == [document["sequence"] for document in documents]
    assert [7, 7, 7] == [document["cycle"] for document in documents]
    assert {"edged/target/1"} == {document["schema"] for document in documents}


def test_cbor_is_read_as_well(capsys):
    """A cell that is configured for CBOR prints the same object; its queries answer in CBOR too."""

    async def main() -> None:
        async with Cell(encoding="cbor") as cell:
            await watching(cell, [make_snapshot(7)], as_json=True, count=2)
            session = open_session(session_config("peer", [], [f"tcp/127.0.0.1:{cell.port}"]))
            try:
                (reply,) = await asyncio.to_thread(lambda: list(session.get("edged/cell1/last")))
            finally:
                session.close()
        assert "application/cbor" == str(reply.ok.encoding)
        assert 7 == decode_cbor(reply.ok.payload.to_bytes())["cycle"]

    asyncio.run(main())
    documents = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [make_snapshot().targets[0].position_mm.tolist()] * 2 == [
        d["targets"][0]["position_mm"] for d in documents
    ]


def test_lines_show_position_in_the_robots_frame_when_it_is_known():
    """Off a terminal: one line per result, in the frame that a robot uses; a fault says why."""
    robot_from_rig = make_transform((0.0, 0.0, 0.0), (100.0, 0.0, 0.0))
    lines = run(
        [make_snapshot(1, robot_from_rig=robot_from_rig), make_snapshot(2, Status.CAPTURE_FAULT)], count=2
    )
    by_status = {line.split()[3]: line for line in lines.splitlines()}
    assert "110.000    20.000   200.000 mm (robot)" in by_status["OK"]
    assert "camera left: unplugged" in by_status["CAPTURE_FAULT"]


def test_the_table_shows_state_and_result_of_each_cell():
    """On a terminal: a row with state, job, position."""
    text = run([make_snapshot(cycle) for cycle in range(1, 4)], count=2, terminal=True)
    for word in ("cell1", "READY", "flange", "10.000 20.000 200.000 rig", "sim"):
        assert word in text, word


@pytest.mark.parametrize("terminal", [False, True])
def test_a_calibration_that_drifts_is_shown_with_its_figures(terminal):
    """The verdict, the rows and the known length: what to look at before the cell stops by itself."""
    drifting = replace(make_snapshot(1), drift=DriftState(Calibrated.DRIFTS, 0.31, -0.24))
    text = run([drifting] * 3, count=2, terminal=terminal)
    assert "calibration drifts: rows 0.31 px, known length -0.24 %" in " ".join(text.split())


def test_only_the_cell_that_was_named():
    """`--cell` leaves the others out."""

    async def main() -> str:
        async with Cell() as cell, Cell(cell="cell2", connect=(f"tcp/127.0.0.1:{cell.port}",)) as other:
            other.publisher.announce(make_snapshot(66))
            return await watching(cell, [make_snapshot(1), make_snapshot(2)], count=2, only="cell1")

    text = asyncio.run(main())
    assert ["cell1", "cell1"] == [line.split()[0] for line in text.splitlines()]


@pytest.mark.slow
def test_what_strangers_publish_under_our_keys_is_no_reason_to_stop():
    """Junk, deep nesting, wrong types and escape codes under edged/** are left out or shown harmlessly."""
    junk = [
        b"\xff\xfe",
        b"[" * 100_000,
        b"[]",
        b"null",
        b'{"targets": 3}',
        b'{"targets": [{"position_mm": "x"}]}',
    ]
    bad = json.dumps(
        {"status": "\x1b[5;41m", "cycle": [], "targets": [{"sigma_mm": [None, 1, {}]}], "sequence": "1"}
    )

    async def main() -> str:
        async with Cell() as cell:
            port = free_port()
            stranger = open_session(session_config("peer", [f"tcp/127.0.0.1:{port}"], []))
            snapshots = [make_snapshot(cycle) for cycle in range(40)]
            watcher = asyncio.create_task(
                watching(cell, snapshots, more_ports=[port], count=150, terminal=True)
            )
            while not watcher.done():
                for payload in (*junk, bad.encode()):
                    for kind in ("target", "state", "health"):
                        stranger.put(f"edged/evil/{kind}", payload)
                await asyncio.wait({watcher}, timeout=0.05)
            stranger.close()
            return await watcher

    text = asyncio.run(main())
    assert "cell1" in text
    assert "evil" in text
    assert "\x1b[5;41m" not in text


@pytest.mark.parametrize("name", ["a/b", "*", "", "x" * 65, "$*"])
def test_a_cell_name_that_cannot_be_is_refused(name):
    """A name with key syntax in it would listen to something else."""
    with pytest.raises(UserError, match="--cell"):
        watch([f"tcp/127.0.0.1:{free_port()}"], name, True, 1, Console(file=io.StringIO()))


def test_an_endpoint_that_cannot_be_is_refused():
    """A mistyped endpoint is told, not waited for."""
    with pytest.raises(ConfigError, match="nonsense"):
        watch(["nonsense"], None, True, 1, Console(file=io.StringIO()))


def test_lost_results_are_counted_and_a_restart_is_not_a_loss():
    """A gap in the sequence is that many lost results; another start of the daemon begins anew."""
    view = CellView()
    for started_ns, sequence in [(1, 1), (1, 2), (1, 5), (2, 1), (2, 2), (2, 4)]:
        document = {"started_ns": started_ns, "sequence": sequence}
        view.take(News("cell1", "target", document), now_s=1.0, utc_ns=0)
    assert 3 == view.lost


def test_age_of_a_first_result_counts_from_its_exposure():
    """A result from the cache is as old as it is; later ones age from their arrival."""
    view = CellView()
    view.take(News("cell1", "target", {"exposed_ns": 1_000_000_000}), now_s=5.0, utc_ns=61_000_000_000)
    assert 62.0 == view.age_s(7.0)
    view.take(News("cell1", "target", {"exposed_ns": 2_000_000_000}), now_s=8.0, utc_ns=61_000_000_000)
    assert 1.0 == view.age_s(9.0)


def test_a_cell_that_is_gone_is_shown_as_gone():
    """When the liveliness token goes the state says so, and a return begins anew."""
    view = CellView()
    view.take(News("cell1", "state", {"state": "READY"}), 0.0, 0)
    view.take(News("cell1", "alive", {"alive": False}), 0.0, 0)
    assert "GONE" == view.state
    view.take(News("cell1", "alive", {"alive": True}), 0.0, 0)
    assert "?" == view.state
