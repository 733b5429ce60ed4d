#!/usr/bin/env python3
"""Measure the lines of text for robots: from sending LOCATE to the pose, beside eight clients that read.

Run it with the project's Python: `.venv/bin/python tools/bench_socket.py`. The daemon measures in this
process; a robot in another one sends LOCATE on a permanent connection, and waits for the whole line. Eight
Modbus clients read 48 words every 20 ms meanwhile. The time outside the cycle is the cost of the line.
--stages: its parts on the thread of the loop, in wall-clock and processor time. Exit code 1 beyond 2 ms
(p99).
"""

from __future__ import annotations

import asyncio
import itertools
import socket
import sys
import tempfile
import time
from multiprocessing.queues import Queue
from pathlib import Path

import numpy as np
from bench_modbus import READERS, in_process, read_all, show_triggers
from benchcell import BenchCell
from benching import bench_parser, finish
from helpers.ports import free_port

from edged.adapters.modbus.lines import Robot
from edged.cell.announcements import Announcements
from edged.cell.measurement import CycleRun
from edged.domain.events import Event, Snapshot

STAGES = ("asked", "begun", "announcing", "announced", "answered")
"""Moments of a command: its line was read, the cycle begins, its result goes to the publishers, all have it,
the answer is ready to be sent."""
LIMIT_MS = 2.0
"""Limit of the 99th percentile, without the cycle."""


def locate_all(port: int, count: int, results: Queue[list[float]]) -> None:
    """Send one LOCATE after the other; report the time from each request to its whole answer, in ms."""
    times_ms = []
    with socket.create_connection(("127.0.0.1", port)) as line, line.makefile("rb") as answers:
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for sequence in range(1, count + 1):
            time.sleep(0.02)
            start_s = time.perf_counter()
            line.sendall(b"%d,LOCATE,0\n" % sequence)
            answer = answers.readline()
            times_ms.append((time.perf_counter() - start_s) * 1e3)
            if not answer.startswith(b"%d,0," % sequence):
                raise RuntimeError(f"no pose: {answer!r}")
    results.put(times_ms)


async def bench(folder: Path, count: int, readers: int) -> float:
    """Print the times; return the 99th percentile of the time outside the cycle, in ms."""
    cell, port = BenchCell(folder, mode="command"), free_port()
    with cell.config.open("a") as config:
        config.write(f'\n[modbus.socket]\nport = {port}\nbrand = "kuka"\nallow_simulated = true\n')
    async with cell.running():
        beside = asyncio.create_task(in_process(read_all, cell.modbus_port, readers, count * 0.1 + 5.0))
        times_ms = np.array(await in_process(locate_all, port, count))
        readings_ms = await beside
    show_triggers(f" ({readers} clients)", times_ms, cell, "LOCATE to pose")
    if readers:
        p50, p99 = np.percentile(readings_ms, (50, 99))
        print(f"beside it: {readers} clients, p50 {p50:.2f} p99 {p99:.2f}")
    total_ms = np.array([snapshot.timing_ms["total"] for snapshot in cell.listener.snapshots])
    return float(np.percentile(times_ms - total_ms, 99))


def note_stages() -> list[dict[str, tuple[float, float]]]:
    """Wrap the functions of the stages; return the list for clock and processor times of each command."""
    commands: list[dict[str, tuple[float, float]]] = []
    answer, announce, cycle = Robot.answer, Announcements.announce, CycleRun.__init__

    def note(stage: str) -> None:
        if commands:
            commands[-1][stage] = time.perf_counter(), time.thread_time()

    async def answering(self: Robot, message: bytes) -> object:
        commands.append({})
        note("asked")
        found = await answer(self, message)
        note("answered")
        return found

    def announcing(self: Announcements, event: Event) -> None:
        if isinstance(event, Snapshot):
            note("announcing")
        announce(self, event)
        if isinstance(event, Snapshot):
            note("announced")

    def beginning(self: CycleRun, *given: object) -> None:
        note("begun")
        # all its arguments
        cycle(self, *given)  # type: ignore[arg-type]

    for kind, name, wrapped in (
        (Robot, "answer", answering),
        (Announcements, "announce", announcing),
        (CycleRun, "__init__", beginning),
    ):
        setattr(kind, name, wrapped)
    return commands


def show_stages(commands: list[dict[str, tuple[float, float]]]) -> None:
    """Print all stages except the cycle itself, ms."""
    for first, second in itertools.pairwise(STAGES):
        rows = [command for command in commands if first in command and second in command]
        took_ms = 1e3 * np.array([np.subtract(command[second], command[first]) for command in rows])
        (clock, cpu), (clock_99, cpu_99) = np.percentile(took_ms, (50, 99), axis=0)
        name = f"{first} to {second}"
        print(f"{name:26} clock p50 {clock:7.2f} p99 {clock_99:7.2f}   processor {cpu:6.2f} {cpu_99:6.2f}")


if __name__ == "__main__":
    parser = bench_parser(__doc__)
    parser.add_argument("--commands", type=int, default=300)
    parser.add_argument("--stages", action="store_true", help="say of what it is made")
    given = parser.parse_args()
    noted = note_stages() if given.stages else []
    with tempfile.TemporaryDirectory() as place:
        asyncio.run(bench(Path(place) / "alone", given.commands, 0))
        noted.clear()
        beyond_ms = asyncio.run(bench(Path(place) / "among", given.commands, READERS))
    if noted:
        show_stages(noted)
    finish(given)
    sys.exit(int(beyond_ms > LIMIT_MS))
