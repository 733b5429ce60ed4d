#!/usr/bin/env python3
"""Measure the lines of text for robots: from sending LOCATE to the pose, beside eight clients that read.

Run it with the project's Python: `.venv/bin/python tools/bench_socket.py`. The daemon measures in this
process; a robot in another one sends LOCATE on a connection that stays, and waits for the whole line. Eight
Modbus clients read 48 words every 20 ms meanwhile. What is not the cycle is what the line costs. Exit code 1
beyond 2 ms (p99).
"""

from __future__ import annotations

import asyncio
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

LIMIT_MS = 2.0
"""Limit of the 99th percentile, beside the cycle."""


def locate_all(port: int, count: int, results: Queue[list[float]]) -> None:
    """One LOCATE after the other; report from the request to its whole answer, in ms."""
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
    """Print the times; returns the 99th percentile of what is not the cycle, in ms."""
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


if __name__ == "__main__":
    parser = bench_parser(__doc__)
    parser.add_argument("--commands", type=int, default=300)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        asyncio.run(bench(Path(place) / "alone", given.commands, 0))
        beyond_ms = asyncio.run(bench(Path(place) / "among", given.commands, READERS))
    finish(given)
    sys.exit(int(beyond_ms > LIMIT_MS))
