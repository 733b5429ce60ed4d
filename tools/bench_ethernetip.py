#!/usr/bin/env python3
"""Measure a cell as an EtherNet/IP adapter: from START to DONE, and how evenly its inputs arrive.

Run it with the project's Python: `.venv/bin/python tools/bench_ethernetip.py`. The daemon measures in this
process; the controller, a scanner by other authors, is another one. It prints START to DONE, with and without
the duration of the cycle itself, at each requested packet interval (RPI); then the time between two inputs
while the cell measures, untriggered, as fast as it can. In ms.
"""

from __future__ import annotations

import asyncio
import multiprocessing as mp
import struct
import tempfile
import time
from multiprocessing.queues import Queue
from pathlib import Path

import numpy as np
from benchcell import BenchCell
from benching import bench_parser, finish
from helpers import plcmemories as at
from helpers.enipcell import (
    CONFIGURATION,
    HEARTBEAT,
    INPUTS,
    Scanner,
    originator_at,
    own_address,
)

READER = bytes((0x20, 4, 0x24, CONFIGURATION, 0x2C, HEARTBEAT, 0x2C, INPUTS))
START_SIMULATED = 5
SPAWN = mp.get_context("spawn")
INTERVALS_MS = (50, 20, 10)


def commands(host: str, rpi_ms: int, count: int, results: Queue[list[float]]) -> None:
    """Command `count` times as a controller, and report the times from START to DONE in ms."""
    scanner, times_ms = Scanner(host, rpi_ms), list[float]()
    program = scanner.run()
    for number in range(count):
        program.until(lambda bits: bits & at.READY)
        time.sleep(0.01 + rpi_ms / 1000 * (number % 20) / 20)  # at any phase of the interval
        begun_s = time.perf_counter()
        program.write(at.CONTROL, START_SIMULATED)
        program.until(lambda bits: bits & at.DONE)
        times_ms.append((time.perf_counter() - begun_s) * 1e3)
        program.write(at.CONTROL, 0)
        program.until(lambda bits: not bits & at.DONE)
    scanner.stop()
    results.put(times_ms)


def arrivals(host: str, rpi_ms: int, seconds: float, results: Queue[list[float]]) -> None:
    """Only read, as a scanner, and report when inputs came, in ms."""
    times_ms, end_s, sequence = list[float](), time.monotonic() + seconds, 0
    with originator_at(host) as raw:
        status, _, data = raw.forward_open(READER, (2, 130), rpi_us=1000 * rpi_ms, multiplier=6)
        assert status == 0
        (number,) = struct.unpack_from("<I", data)
        while time.monotonic() < end_s:
            raw.data.recv(1024)
            times_ms.append(time.perf_counter() * 1e3)
            sequence += 1
            raw.outputs(number, sequence, struct.pack("<H", sequence & 0xFFFF))
    results.put(times_ms)


async def bench(folder: Path, rpi_ms: int, count: int, seconds: float) -> None:
    """Print three lines for one interval."""
    for mode in ("command", "free"):
        cell, host = BenchCell(folder / mode, mode=mode), own_address()
        with cell.config.open("a") as config:
            config.write(f'\n[ethernetip]\nhost = "{host}"\n')
        results: Queue[list[float]] = SPAWN.Queue()
        async with cell.running():
            work = (commands, count) if mode == "command" else (arrivals, seconds)
            process = SPAWN.Process(target=work[0], args=(host, rpi_ms, work[1], results))
            process.start()
            times_ms = np.array(await asyncio.to_thread(results.get, True, 600))
            process.join()
        if mode == "command":
            cycle_ms = np.array([snapshot.timing_ms["total"] for snapshot in cell.listener.snapshots])
            say("START to DONE", rpi_ms, times_ms)
            say("without the cycle", rpi_ms, times_ms - cycle_ms)
        else:
            say("between two inputs", rpi_ms, np.diff(times_ms))


def say(name: str, rpi_ms: int, values: np.ndarray) -> None:
    """One line."""
    p50, p99 = np.percentile(values, (50, 99))
    line = f"{name:18} RPI {rpi_ms:2}   p50 {p50:6.2f}   p99 {p99:6.2f}   worst {values.max():6.2f}"
    print(f"{line}   ({len(values)})", flush=True)


if __name__ == "__main__":
    parser = bench_parser(__doc__)
    parser.add_argument("--commands", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=20.0, help="of a cell that nobody triggers")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        for rpi_ms in INTERVALS_MS:
            asyncio.run(bench(Path(place) / str(rpi_ms), rpi_ms, given.commands, given.seconds))
    finish(given)
