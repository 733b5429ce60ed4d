"""`edged watch` with real cells, and with hostile publishers."""

from __future__ import annotations

import asyncio
import io
import itertools
import json
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers.certificates import make_certificates
from helpers.ports import free_port
from helpers.snapshots import make_snapshot, make_transform
from helpers.waiting import LIMIT_S
from helpers.zenohcell import READY, Cell
from rich.console import Console, ConsoleDimensions

from edged.adapters.zenoh import open_session, session_config
from edged.app.fleet import ClientTls, News
from edged.cbor import decode_cbor
from edged.commands.fleetview import CellView, fleet_view
from edged.commands.watch import WatchOptions, watch
from edged.domain.cell import CalibrationHealth, DriftState
from edged.domain.events import Event
from edged.domain.measurement import Status
from edged.errors import UserError


async def watching(cell: Cell, events: Sequence[Event], **options: Any) -> str:
    """The output of `watch` while a cell announces these events repeatedly until it has enough."""
    file = io.StringIO()
    console = Console(file=file, width=120, force_terminal=options.pop("terminal", None))
    only = options.pop("only", None)
    ports = (cell.port, *options.pop("more_ports", ()))
    endpoints = tuple(f"tcp/127.0.0.1:{port}" for port in ports)
    wanted = WatchOptions(endpoints, only, **options)
    codes: list[int] = []
    # daemonic: a watch that never has enough fails this test and hangs nothing
    thread = threading.Thread(target=lambda: codes.append(watch(wanted, console)), daemon=True)
    thread.start()
    deadline_s = time.monotonic() + LIMIT_S
    for event in itertools.cycle(events):
        cell.publisher.announce(event)
        await asyncio.sleep(0.03)
        if not thread.is_alive():
            break
        assert time.monotonic() < deadline_s, file.getvalue()
    assert [0] == codes
    return file.getvalue()


def run(events: Sequence[Event], **options: Any) -> str:
    """`watching` with a cell of its own."""

    async def main() -> str:
        async with Cell() as cell:
            cell.publisher.announce(READY)
            return await watching(cell, events, **options)

    return asyncio.run(main())


def test_json_is_the_message_itself_one_a_line(capsys):
    """Every line is one result as it was published, once and in order."""
    run([make_snapshot(7)], as_json=True, count=3)
    documents = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    first = documents[0]["sequence"]
    assert [first, first + 1, first + 2] == [document["sequence"] for document in documents]
    assert [7, 7, 7] == [document["cycle"] for document in documents]
    assert {"edged/target/1"} == {document["schema"] for document in documents}


async def test_cbor_is_read_as_well(capsys):
    """A cell that publishes CBOR gives the same object, and answers queries in CBOR."""
    async with Cell(encoding="cbor") as cell:
        await watching(cell, [make_snapshot(7)], as_json=True, count=2)
        session = open_session(session_config("peer", [], [f"tcp/127.0.0.1:{cell.port}"]))
        try:
            (reply,) = await asyncio.to_thread(lambda: list(session.get("edged/cell1/last")))
        finally:
            session.close()
    assert "application/cbor" == str(reply.ok.encoding)
    assert 7 == decode_cbor(reply.ok.payload.to_bytes())["cycle"]
    documents = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [make_snapshot().targets[0].position_mm.tolist()] * 2 == [
        d["targets"][0]["position_mm"] for d in documents
    ]


def test_lines_show_position_in_the_robots_frame_when_it_is_known():
    """Off a terminal there is one line per result, in the robot's frame, and a fault has its reason."""
    robot_from_rig = make_transform((0.0, 0.0, 0.0), (100.0, 0.0, 0.0))
    lines = run(
        [make_snapshot(1, robot_from_rig=robot_from_rig), make_snapshot(2, Status.CAPTURE_FAULT)], count=2
    )
    by_status = {line.split()[3]: line for line in lines.splitlines()}
    assert "110.000    20.000   200.000 mm (robot)" in by_status["OK"]
    assert "camera left: unplugged" in by_status["CAPTURE_FAULT"]


def test_the_table_shows_state_and_result_of_each_cell():
    """On a terminal each cell has a row with state, job and position."""
    # the state between two results: asked for, it may come after them on a busy PC
    text = run([READY, make_snapshot()], count=2, terminal=True)
    for word in ("cell1", "READY", "flange", "10.000 20.000 200.000 rig", "sim"):
        assert word in text, word


@pytest.mark.parametrize("terminal", [False, True])
def test_a_calibration_that_drifts_is_shown_with_its_figures(terminal):
    """A drifting calibration is shown with rows and known length."""
    drifting = replace(make_snapshot(1), drift=DriftState(CalibrationHealth.DRIFTS, 0.31, -0.24))
    text = run([drifting] * 3, count=2, terminal=terminal)
    assert "calibration drifts: rows 0.31 px, known length -0.24 %" in " ".join(text.split())


async def test_only_the_cell_that_was_named():
    """`--cell` shows the named cell alone."""
    async with Cell() as cell, Cell(cell="cell2", connect=(f"tcp/127.0.0.1:{cell.port}",)) as other:
        other.publisher.announce(make_snapshot(66))
        text = await watching(cell, [make_snapshot(1), make_snapshot(2)], count=2, only="cell1")
    assert ["cell1", "cell1"] == [line.split()[0] for line in text.splitlines()]


@pytest.mark.slow
async def test_what_strangers_publish_under_our_keys_is_no_reason_to_stop():
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
    async with Cell() as cell:
        port = free_port()
        stranger = open_session(session_config("peer", [f"tcp/127.0.0.1:{port}"], []))
        snapshots = [make_snapshot(cycle) for cycle in range(40)]
        watcher = asyncio.create_task(watching(cell, snapshots, more_ports=[port], count=150, terminal=True))
        while not watcher.done():
            for payload in (*junk, bad.encode()):
                for kind in ("target", "state", "health"):
                    stranger.put(f"edged/evil/{kind}", payload)
            await asyncio.wait({watcher}, timeout=0.05)
        stranger.close()
        text = await watcher
    assert "cell1" in text
    assert "evil" in text
    assert "\x1b[5;41m" not in text


@pytest.mark.parametrize("name", ["a/b", "**", "", "x" * 65, "$*"])
def test_a_cell_name_that_cannot_be_is_refused(name):
    """A cell name with key syntax is refused."""
    with pytest.raises(UserError, match="--cell"):
        watch(WatchOptions((f"tcp/127.0.0.1:{free_port()}",), name), Console(file=io.StringIO()))


async def test_a_part_of_the_names():
    """`--cell 'cell?'` shows the cells that match, and no others."""
    async with Cell() as cell, Cell(cell="other", connect=(f"tcp/127.0.0.1:{cell.port}",)) as other:
        other.publisher.announce(make_snapshot(66))
        text = await watching(cell, [make_snapshot(1), make_snapshot(2)], count=2, only="cell?")
    assert ["cell1", "cell1"] == [line.split()[0] for line in text.splitlines()]


@pytest.mark.long
def test_a_script_waits_no_longer_than_it_says(capsys):
    """With nobody publishing `--count 1 --timeout` gives exit status 1 and a hint."""
    options = WatchOptions((f"tcp/127.0.0.1:{free_port()}",), count=1, timeout_s=4.5)

    assert 1 == watch(options, Console(file=io.StringIO()))
    assert "does a cell or router run and listen there?" in capsys.readouterr().err


@pytest.mark.long
def test_a_router_that_goes_is_said(capsys):
    """The loss of the router is printed, and its return, too."""
    port, codes = free_port(), []
    endpoint = f"tcp/127.0.0.1:{port}"
    said, deadline_s = "", time.monotonic() + LIMIT_S
    thread = threading.Thread(
        target=lambda: codes.append(watch(WatchOptions((endpoint,), count=1), Console(file=io.StringIO()))),
        daemon=True,
    )
    router = open_session(session_config("router", [endpoint], []))
    thread.start()
    time.sleep(2.5)  # a watch looks once a second whether it is connected
    router.close()
    while "is gone: nothing new is seen" not in said:
        assert time.monotonic() < deadline_s, said
        time.sleep(0.1)
        said += capsys.readouterr().err
    router = open_session(session_config("router", [endpoint], []))
    while f"connected to {endpoint}" not in said.partition("is gone")[2]:
        assert time.monotonic() < deadline_s, said
        router.put("edged/cell1/health", b"{}")
        time.sleep(0.1)
        said += capsys.readouterr().err
    while thread.is_alive():
        assert time.monotonic() < deadline_s, said
        router.put("edged/cell1/target", b'{"status": "OK"}')
        time.sleep(0.1)
    router.close()

    assert [0] == codes


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"certificate": "a.pem"}, "--certificate and --key belong together"),
        ({"authority": "a.pem"}, "expected tls/HOST:PORT"),
        ({"connect": ("tls/localhost:1",), "authority": "a.pem"}, "a.pem: No such file"),
    ],
)
def test_certificates_that_cannot_be_are_refused(tmp_path, monkeypatch, options, message):
    """Half of a certificate pair, certificates without TLS and missing files are refused."""
    monkeypatch.chdir(tmp_path)
    connect = options.get("connect", ("tcp/127.0.0.1:7447",))
    tls = ClientTls(**{name: Path(value) for name, value in options.items() if name != "connect"})

    with pytest.raises(UserError, match=message):
        watch(WatchOptions(connect, tls=tls), Console(file=io.StringIO()))


@pytest.mark.long
def test_a_router_with_mtls_lets_a_certificate_in(tmp_path):
    """With certificate, key and authority `watch` gets results over mTLS, without them none."""
    make_certificates(tmp_path)
    pem = {
        name: tmp_path / name for name in ("ca.pem", "server.pem", "server.key", "viewer.pem", "viewer.key")
    }
    port = free_port()
    config = session_config("router", [f"tls/127.0.0.1:{port}"], [])
    tls = {
        "root_ca_certificate": pem["ca.pem"],
        "listen_certificate": pem["server.pem"],
        "listen_private_key": pem["server.key"],
        "enable_mtls": True,
    }
    config.insert_json5("transport/link/tls", json.dumps(tls, default=str))
    router = open_session(config)
    endpoints = (f"tls/127.0.0.1:{port}",)
    known = ClientTls(pem["viewer.pem"], pem["viewer.key"], pem["ca.pem"])
    codes: list[int] = []
    silent = Console(file=io.StringIO())
    thread = threading.Thread(
        target=lambda: codes.extend(
            watch(WatchOptions(endpoints, count=1, timeout_s=limit_s, tls=tls), silent)
            for limit_s, tls in ((3.0, ClientTls(authority=pem["ca.pem"])), (LIMIT_S, known))
        ),
        daemon=True,
    )
    thread.start()
    while thread.is_alive():
        router.put("edged/cell1/target", b'{"status": "OK"}')
        time.sleep(0.05)
    router.close()

    assert [1, 0] == codes


def many_cells(count: int) -> dict[str, CellView]:
    """Many cells: every 50th in fault, one gone and one without a target, all others fine."""
    cells = {}
    for number in range(count):
        view = cells[f"press-{number:03}"] = CellView()
        fault = number % 50 == 49
        error = "camera left: EDGED-1 does not answer at 192.168.7.10: cable, power?" if fault else ""
        state = {"state": "FAULT" if fault else "READY", "error": error}
        status = "NO_TARGET" if number == 11 else "OK"
        target = {
            "status": status,
            "job": "flange",
            "targets": [{"position_mm": [1, 2, 3], "sigma_mm": [0] * 3}],
        }
        for kind, document in (("state", state), ("target", target), ("health", {"rate_hz": 2.0})):
            view.take(News("", kind, document), 0.0, 0)
    if count > 150:
        cells["press-150"].take(News("", "alive", {"alive": False}), 0.0, 0)
    return cells


@pytest.mark.parametrize(("height", "width"), [(24, 80), (60, 160)])
@pytest.mark.parametrize("count", [1, 20, 200])
def test_a_fleet_is_read_on_one_screen(height, width, count):
    """A fleet fits on one screen of any size, with faulty cells first."""
    file = io.StringIO()
    console = Console(file=file, width=width, height=height)
    size = ConsoleDimensions(width, height)
    console.print(fleet_view(many_cells(count), count, "", 1.0, size))
    lines = file.getvalue().splitlines()

    assert len(lines) < height
    assert max(map(len, lines)) <= width
    if count == 200:
        text = " ".join(file.getvalue().split())
        assert "200 cells: 4 FAULT 1 GONE 195 READY last results: 199 OK 1 NO_TARGET" in text
        first = [line.split()[0] for line in lines if line.startswith(" press-")]
        bad = ["press-049", "press-099", "press-149", "press-150", "press-199", "press-011"]
        assert [*bad, "press-000"] == first[:7]
        assert any("press-049: camera left" in line for line in lines)
        assert any(line.startswith("and 1") and "more" in line for line in lines)


def test_a_state_that_cannot_be_is_refused():
    """An unknown state is refused with the known ones."""
    with pytest.raises(UserError, match="--state 'FALT': expected one of FAULT, GONE"):
        watch(WatchOptions(states=("FALT",)), Console(file=io.StringIO()))


def test_an_endpoint_that_cannot_be_is_refused():
    """A mistyped endpoint is refused at once."""
    with pytest.raises(UserError, match="--connect 'nonsense': expected PROTOCOL/ADDRESS"):
        watch(WatchOptions(("nonsense",)), Console(file=io.StringIO()))


def test_lost_results_are_counted_and_a_restart_is_not_a_loss():
    """A gap in the sequence counts as lost results; a restart of the daemon does not."""
    view = CellView()
    for started_ns, sequence in [(1, 1), (1, 2), (1, 5), (2, 1), (2, 2), (2, 4)]:
        document = {"started_ns": started_ns, "sequence": sequence}
        view.take(News("cell1", "target", document), now_s=1.0, utc_ns=0)
    assert 3 == view.lost


def test_misses_that_repeat_are_counted():
    """The number of equal misses in a row is shown; a good result and another status begin anew."""
    view, shown = CellView(), []
    for status in ("OK", "NO_TARGET", "NO_TARGET", "NO_TARGET", "CAPTURE_FAULT", "OK", "OK"):
        view.take(News("cell1", "target", {"status": status}), 0.0, 0)
        console = Console(file=io.StringIO(), width=80)
        console.print(fleet_view({"cell1": view}, 1, "", 1.0, ConsoleDimensions(80, 24)))
        text = console.file.getvalue()
        shown.append(text[: text.index(" in a row")].split()[-1] if "in a row" in text else "")
    assert ["", "", "2", "3", "", "", ""] == shown


def test_age_of_a_first_result_counts_from_its_exposure():
    """A result from the cache is as old as its exposure; later ones age from their arrival."""
    view = CellView()
    view.take(News("cell1", "target", {"exposed_ns": 1_000_000_000}), now_s=5.0, utc_ns=61_000_000_000)
    assert 62.0 == view.age_s(7.0)
    view.take(News("cell1", "target", {"exposed_ns": 2_000_000_000}), now_s=8.0, utc_ns=61_000_000_000)
    assert 1.0 == view.age_s(9.0)


def test_a_cell_that_is_gone_is_shown_as_gone():
    """A lost liveliness token shows GONE, and a return begins anew."""
    view = CellView()
    view.take(News("cell1", "state", {"state": "READY"}), 0.0, 0)
    view.take(News("cell1", "alive", {"alive": False}), 0.0, 0)
    assert "GONE" == view.state
    view.take(News("cell1", "alive", {"alive": True}), 0.0, 0)
    assert "?" == view.state
