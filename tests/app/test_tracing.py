"""A trace of the daemon: the functions of each thread in each cycle, as spans for trace viewers."""

from __future__ import annotations

import asyncio
import importlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest
from helpers.smallcell import DaemonProcess, SmallCell
from helpers.waiting import wait_until
from pymodbus.client import ModbusTcpClient

from edged.app.tracing import TRACED, Trace, traced
from edged.cell.announcements import Announcements
from edged.domain.events import Basis
from edged.logs import cycle_number
from edged.plc.registers import RESULT

Span = dict[str, Any]


def place_of(name: str) -> Callable[..., Any]:
    """The traced function of this name."""
    module, _, inside = name.partition(":")
    found: Any = importlib.import_module(module)
    for part in inside.split("."):
        found = getattr(found, part)
    assert callable(found)
    return cast(Callable[..., Any], found)


@pytest.mark.parametrize("name", TRACED)
def test_what_is_traced_is_there(name: str) -> None:
    """Every traced function exists."""
    assert place_of(name).__module__.startswith("edged.")


def test_who_is_not_traced_runs_the_functions_themselves(tmp_path: Path) -> None:
    """Without a trace, and before and after one, no function is wrapped."""
    before = {name: place_of(name) for name in TRACED if name.partition(":")[0] in sys.modules}
    with traced(None):
        assert before == {name: place_of(name) for name in before}
    with traced(tmp_path / "trace.json"):
        assert all(place_of(name) is not function for name, function in before.items())
    assert before == {name: place_of(name) for name in before}


def test_a_span_has_its_thread_its_cycle_and_what_ran_inside(tmp_path: Path) -> None:
    """A span has thread, cycle and inner spans, also if the function raises; awaited functions have tracks
    of their own."""
    trace, number = Trace(), cycle_number.set(7)

    def failing() -> None:
        raise ValueError

    async def waiting() -> None:
        await asyncio.sleep(0.01)

    inner = trace.wrapped(failing, "inner", "")
    with pytest.raises(ValueError, match=r"^$"):
        trace.wrapped(lambda: inner(), "outer", "")()
    asyncio.run(trace.wrapped(waiting, "long", "cell")())
    cycle_number.reset(number)
    outer, within, long = [event for event in trace.events() if event["ph"] == "X"]
    names = {
        event["tid"]: event["args"]["name"]
        for event in trace.events()
        if "tid" in event and event["ph"] == "M"
    }
    assert ["outer", "inner", "long"] == [outer["name"], within["name"], long["name"]]
    assert outer["ts"] <= within["ts"]
    assert within["ts"] + within["dur"] <= outer["ts"] + outer["dur"]
    assert outer["tid"] == within["tid"] != long["tid"]
    assert ("MainThread", "waits: cell") == (names[outer["tid"]], names[long["tid"]])
    assert {"cycle": 7} == long["args"]
    assert long["dur"] >= 1e4
    path = tmp_path / "trace.json"
    with traced(path):
        Announcements(Basis(0, "", "")).announce(Basis(1, "", ""))
    (announced,) = [event for event in json.loads(path.read_text())["traceEvents"] if event["ph"] == "X"]
    assert "announce" == announced["name"]


def within(inner: Span, outer: Span) -> bool:
    """Whether a span lies within the time of another one."""
    return bool(outer["ts"] <= inner["ts"] and inner["ts"] + inner["dur"] <= outer["ts"] + outer["dur"])


@pytest.mark.long
def test_a_cycle_is_seen_from_trigger_to_the_wire(tmp_path: Path) -> None:
    """The trace of a cycle has frames, rectification, find, measure with its fits, the answer, and the
    read of it."""
    small, path = SmallCell(tmp_path), tmp_path / "trace.json"
    daemon = DaemonProcess(small.config, options=["--trace", str(path)])
    daemon.wait_ready()
    plc = ModbusTcpClient("127.0.0.1", port=small.modbus_port, timeout=5)
    wait_until(plc.connect)
    seen = set[int]()  # SEQ_HEAD of a cell that runs free is the cycle's number
    wait_until(
        lambda: seen.add(plc.read_holding_registers(RESULT.address, count=1).registers[0]) or len(seen) > 3
    )
    plc.close()
    daemon.stop()
    events = json.loads(path.read_text())["traceEvents"]
    spans = [event for event in events if event["ph"] == "X"]
    tracks = {event["tid"]: event["args"]["name"] for event in events if event["name"] == "thread_name"}
    assert {event["tid"] for event in spans} == tracks.keys()
    for track in tracks:  # spans of one track lie beside or within each other
        above: list[Span] = []
        for span in (span for span in spans if span["tid"] == track):
            while above and above[-1]["ts"] + above[-1]["dur"] <= span["ts"]:
                above.pop()
            assert not above or within(span, above[-1]), (span, above[-1])
            above.append(span)
    located = next(span for span in spans if span["name"] == "locate")
    cycle = next(span for span in spans if span["name"] == "cycle" and within(located, span))
    inside = [span for span in spans if within(span, cycle)]
    named = {name: [span for span in inside if span["name"] == name] for name in {s["name"] for s in inside}}
    assert {"left", "right"} == {tracks[span["tid"]].removeprefix("waits: ") for span in named["frame"]}
    (frames,), (asked,), (measured,) = (named[name] for name in ("frames", "vision", "measure"))
    assert all(within(span, frames) for name in ("trigger", "frame") for span in named[name])
    assert tracks[located["tid"]].startswith("vision")
    assert within(located, asked)
    for name in ("rectification, left", "find", "measure"):
        assert all(within(span, located) for span in named[name])
    assert named["fit"]
    assert all(within(span, measured) for span in named["fit"])
    answer = named["answer into registers"][-1]
    for announced in named["announce"]:
        told = [
            span["name"] for span in inside if within(span, announced) and span["tid"] == announced["tid"]
        ]
        assert ["announce", "ModbusPublisher"] == told[:2], "the PLC first"
    reads = [
        span for span in spans if span["name"] == "Modbus request to answer" and span["ts"] > answer["ts"]
    ]
    assert any(within(span, reads[0]) for span in spans if span["name"] == "registers read")
