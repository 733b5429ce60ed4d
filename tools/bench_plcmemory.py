#!/usr/bin/env python3
"""Measure a cell in the memory of an S7: from START to DONE, and what the PLC costs the cycle.

Run it with the project's Python: `.venv/bin/python tools/bench_plcmemory.py`. The daemon measures in this
process; the PLC, snap7's server with a program that polls its memory twice a millisecond, is another one.
It prints START to DONE, with and without the duration of the cycle itself: images read and written every 20
ms, then every 5 ms. Then the cycles of an untriggered cell, in turn: without a PLC, beside one that answers,
beside one that accepts everything and answers nothing. In ms.
"""

from __future__ import annotations

import asyncio
import multiprocessing as mp
import socket
import tempfile
import time
from multiprocessing.queues import Queue
from pathlib import Path

import numpy as np
import snap7
from benchcell import BenchCell
from benching import bench_parser, finish
from helpers.ports import free_port
from snap7.type import SrvArea

DB, CONTROL, BITS = 1, 43, 64 + 7
"""The data block, and the low bytes of both words."""
READY, DONE = 1, 8
KINDS = ("none", "answers", "hangs")
SPAWN = mp.get_context("spawn")


def plc(port: int, count: int, results: Queue[list[float]]) -> None:
    """Command `count` times as a PLC, and report START to DONE in ms; 0: only answer, for ever."""
    server = snap7.Server(log=False)
    server.register_area(SrvArea.DB, DB, bytearray(192))
    (memory,) = server.memory_areas.values()
    server.start_to("127.0.0.1", port)

    def until(bit: int) -> None:
        while not memory[BITS] & bit:
            time.sleep(0.0005)

    times_ms = []
    for number in range(count):
        until(READY)
        time.sleep(0.01 + 0.02 * (number % 20) / 20)  # at any phase of the period
        begun_s = time.perf_counter()
        memory[CONTROL] = 5  # with ALLOW_SIMULATED
        until(DONE)
        times_ms.append((time.perf_counter() - begun_s) * 1e3)
        memory[CONTROL] = 0
    results.put(times_ms)
    while not count:
        time.sleep(1.0)


def with_plc(cell: BenchCell, port: int, period_ms: int) -> None:
    """Write the configuration section."""
    with cell.config.open("a") as config:
        config.write(f'\n[plc]\nhost = "127.0.0.1"\nperiod_ms = {period_ms}\n')
        config.write(f"[plc.s7]\nport = {port}\ndb = {DB}\n")


async def bench_command(folder: Path, period_ms: int, count: int) -> None:
    """Print the time from START to DONE, and the same without the cycle."""
    cell, port = BenchCell(folder, mode="command"), free_port()
    with_plc(cell, port, period_ms)
    results: Queue[list[float]] = SPAWN.Queue()
    process = SPAWN.Process(target=plc, args=(port, count, results))
    process.start()
    async with cell.running():
        times_ms = np.array(await asyncio.to_thread(results.get, True, 600))
    process.join()
    total_ms = np.array([snapshot.timing_ms["total"] for snapshot in cell.listener.snapshots])
    for name, values in (("START to DONE", times_ms), ("without the cycle", times_ms - total_ms)):
        p50, p99 = np.percentile(values, (50, 99))
        line = f"{name:18} period {period_ms:2}   p50 {p50:6.2f}   p99 {p99:6.2f}"
        print(f"{line}   ({len(values)} commands)", flush=True)


async def cycles_ms(folder: Path, kind: str, seconds: float) -> list[float]:
    """Durations of an untriggered cell's cycles, without the capture. kind : of PLC."""
    cell = BenchCell(folder, mode="free")
    hanging = socket.create_server(("127.0.0.1", 0))  # accepts connections, but never reads
    port, nothing = free_port(), SPAWN.Queue()
    process = SPAWN.Process(target=plc, args=(port, 0, nothing))
    process.start()
    await asyncio.to_thread(nothing.get)
    if kind != "none":
        with_plc(cell, port if kind == "answers" else int(hanging.getsockname()[1]), 20)
    async with cell.running():
        first = len(cell.listener.snapshots)
        await asyncio.sleep(seconds)
        timings = [snapshot.timing_ms for snapshot in cell.listener.snapshots[first:]]
    hanging.close()
    process.kill()
    process.join()
    return [timing["total"] - timing["capture"] for timing in timings]


async def bench_cycles(folder: Path, seconds: float, turns: int) -> None:
    """Print one line per kind of PLC."""
    found: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for turn in range(turns):
        for kind in KINDS:
            found[kind] += await cycles_ms(folder / f"{turn}{kind}", kind, seconds)
    bare = np.percentile(found["none"], (50, 99))
    for kind in KINDS:
        p50, p99 = np.percentile(found[kind], (50, 99))
        ratios = f"ratio {p50 / bare[0]:.2f}, {p99 / bare[1]:.2f}"
        cycles = f"({len(found[kind])} cycles)"
        print(f"PLC {kind:8} cycle p50 {p50:6.2f}   p99 {p99:6.2f}   {ratios}   {cycles}", flush=True)


if __name__ == "__main__":
    parser = bench_parser(__doc__)
    parser.add_argument("--commands", type=int, default=300)
    parser.add_argument("--seconds", type=float, default=5.0, help="for each kind of PLC and turn")
    parser.add_argument("--turns", type=int, default=6)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        for period in (20, 5):
            asyncio.run(bench_command(Path(place) / f"command{period}", period, given.commands))
        asyncio.run(bench_cycles(Path(place), given.seconds, given.turns))
    finish(given)
