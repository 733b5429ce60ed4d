"""Trace of where a cycle's time goes: what runs on each thread, and what the loop waits for.

There is no overhead without a trace: functions are wrapped when a trace begins and unwrapped when
it ends. The file is JSON in the Trace Event Format, for https://ui.perfetto.dev or chrome://tracing.
Source: N. Duca and D. Sinclair, "Trace Event Format", 2016.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from inspect import iscoroutinefunction
from pathlib import Path
from typing import Any

from edged.files.atomic import write_file
from edged.logs import cycle_number

KEPT = 200_000
"""Number of newest spans kept in memory: half an hour of a cell that measures twice a second."""
OWN_THREAD = ""
"""Track of a function that runs without interruption on its thread."""
CELL = "cell"
"""Track of what the loop awaits in sequence; the thread does other things meanwhile."""
CAMERA = "camera"
"""Tracks of what is awaited from each camera, both in parallel."""
PUBLISHERS = (
    "edged.adapters.modbus.publisher:ModbusPublisher",
    "edged.adapters.opcua.publisher:OpcUaPublisher",
    "edged.adapters.zenoh.publisher:ZenohPublisher",
    "edged.adapters.recorder:Recorder",
    "edged.adapters.history:CycleHistory",
    "edged.adapters.metrics:MetricsPublisher",
    "edged.adapters.systemd:SystemdNotifier",
    "edged.adapters.terminal:DemoView",
    "edged.app.pageserver:PageServer",
)
CAMERAS = (
    "edged.adapters.aravis.camera:AravisCamera",
    "edged.adapters.replay:ReplayCamera",
    "edged.sim.inprocess:InProcessCamera",
)
TRACED = {
    "edged.cell.cycle:Cycle._serve": ("cycle", CELL),
    "edged.cell.stereohead:StereoHead.capture": ("frames", CELL),
    "edged.cell.context:CellContext.on_vision_thread": ("vision", CELL),
    **{f"{camera}.trigger": ("trigger", CAMERA) for camera in CAMERAS},
    **{f"{camera}.frame": ("frame", CAMERA) for camera in CAMERAS},
    "edged.app.cell:locate": ("locate", OWN_THREAD),
    "edged.vision.geometry.rectification:Rectification.left_image": ("rectification, left", OWN_THREAD),
    "edged.vision.geometry.rectification:Rectification.right_image": ("rectification, right", OWN_THREAD),
    "edged.pipeline:_found": ("find", OWN_THREAD),
    "edged.pipeline:measure_part": ("measure", OWN_THREAD),
    "edged.vision.curves.planestate:State.fitted": ("fit", OWN_THREAD),
    "edged.cell.announcements:Announcements.announce": ("announce", OWN_THREAD),
    **{f"{publisher}.announce": ("", OWN_THREAD) for publisher in PUBLISHERS},
    "edged.adapters.modbus.tcp:ModbusConnection.data_received": ("Modbus request to answer", OWN_THREAD),
    "edged.adapters.modbus.cell:CellRegisters.write": ("registers written", OWN_THREAD),
    "edged.adapters.modbus.cell:CellRegisters.take": ("answer into registers", OWN_THREAD),
    "edged.adapters.modbus.cell:CellRegisters.read": ("registers read", OWN_THREAD),
}
"""Traced functions: module and name, with the name of the span ("" : of the class) and its track."""


class Trace:
    """Spans of this process, kept in memory so that nothing is written while a cycle runs."""

    def __init__(self) -> None:
        self._spans: deque[tuple[str, str | int, int, int, int | None]] = deque(maxlen=KEPT)
        self._threads: dict[int, str] = {}

    def wrapped(self, function: Callable[..., Any], name: str, track: str) -> Callable[..., Any]:
        """Return the function wrapped so that each call is recorded as a span."""
        clock_ns, note = time.perf_counter_ns, self._note

        @wraps(function)
        def called(*arguments: Any, **named: Any) -> Any:
            begun_ns = clock_ns()
            try:
                return function(*arguments, **named)
            finally:
                note(name, "", begun_ns)

        @wraps(function)
        async def awaited(*arguments: Any, **named: Any) -> Any:
            begun_ns, own = clock_ns(), arguments[0].name if track == CAMERA else track
            try:
                return await function(*arguments, **named)
            finally:
                note(name, own, begun_ns)

        return awaited if iscoroutinefunction(function) else called

    def _note(self, name: str, track: str, begun_ns: int) -> None:
        thread = threading.get_native_id()
        if not track and thread not in self._threads:
            self._threads[thread] = threading.current_thread().name
        now_ns = time.perf_counter_ns()
        self._spans.append((name, track or thread, begun_ns, now_ns - begun_ns, cycle_number.get()))

    def events(self) -> list[dict[str, Any]]:
        """Return the trace events; tracks that are not threads have small numbers."""
        process, spans = os.getpid(), list(self._spans)
        tracks = sorted({track for _, track, *_ in spans if isinstance(track, str)})
        numbers: dict[str | int, int] = {track: number for number, track in enumerate(tracks, 1)}
        named = [(number, f"waits: {track}") for track, number in numbers.items()]
        events: list[dict[str, Any]] = [
            {"ph": "M", "name": "thread_name", "pid": process, "tid": number, "args": {"name": name}}
            for number, name in (*named, *self._threads.items())
        ]
        events.append({"ph": "M", "name": "process_name", "pid": process, "args": {"name": "edged run"}})
        for name, track, begun_ns, lasted_ns, cycle in sorted(spans, key=lambda span: span[2]):
            events.append(
                {
                    "ph": "X",
                    "name": name,
                    "pid": process,
                    "tid": numbers.get(track, track),
                    "ts": begun_ns / 1e3,
                    "dur": lasted_ns / 1e3,
                    "args": {} if cycle is None else {"cycle": cycle},
                }
            )
        return events


@contextmanager
def traced(path: Path | None) -> Iterator[None]:
    """Trace this process and write the file at the end; None: do nothing.

    Modules not imported by now are not traced. Raises `FileFormatError` if the file cannot be written.
    """
    if path is None:
        yield
        return
    trace, kept = Trace(), list[tuple[Any, str, Any]]()
    for place, (name, track) in TRACED.items():
        module, _, inside = place.partition(":")
        if module not in sys.modules:
            continue
        owner: Any = sys.modules[module]
        *above, function = inside.split(".")
        for part in above:
            owner = getattr(owner, part)
        kept.append((owner, function, getattr(owner, function)))
        setattr(owner, function, trace.wrapped(kept[-1][2], name or above[0], track))
    try:
        yield
    finally:
        for owner, function, before in kept:
            setattr(owner, function, before)
        write_file(path, json.dumps({"traceEvents": trace.events()}).encode())
