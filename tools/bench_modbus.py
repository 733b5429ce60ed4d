#!/usr/bin/env python3
"""Measure reading the result block: edged's server and plain pymodbus, side by side in one run.

Run it with the project's Python: `.venv/bin/python tools/bench_modbus.py`. The server runs in this
process beside a thread of numba work (what vision does); the clients are one process that reads 48 words
on each of N connections in turn, every 20 ms as a PLC does. Printed: p50 and p99 in ms.
"""

from __future__ import annotations

import argparse
import asyncio
import multiprocessing as mp
import socket
import struct
import sys
import threading
import time
from multiprocessing.queues import Queue
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice
from snapshots import make_snapshot

from edged.adapters.modbus import ModbusPublisher, ModbusSettings

PERIOD_S = 0.02


def read_all(port: int, clients: int, seconds: float, results: Queue[list[float]]) -> None:
    """Read on each connection every 20 ms; report the durations in ms."""
    lines = [socket.create_connection(("127.0.0.1", port)) for _ in range(clients)]
    request = struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 300, 48)
    times_ms: list[float] = []
    end_s = time.perf_counter() + seconds
    while time.perf_counter() < end_s:
        round_s = time.perf_counter()
        for line in lines:
            start_s = time.perf_counter()
            line.sendall(request)
            missing = 9 + 96
            while missing:
                missing -= len(line.recv(missing))
            times_ms.append((time.perf_counter() - start_s) * 1e3)
        time.sleep(max(0.0, PERIOD_S - (time.perf_counter() - round_s)))
    for line in lines:
        line.close()
    results.put(times_ms)


async def measure(port: int, clients: int, seconds: float) -> tuple[float, float]:
    """p50 and p99 in ms."""
    context = mp.get_context("spawn")
    results: Queue[list[float]] = context.Queue()
    process = context.Process(target=read_all, args=(port, clients, seconds, results))
    process.start()
    times_ms = await asyncio.to_thread(results.get, timeout=seconds + 30)
    await asyncio.to_thread(process.join)
    return float(np.percentile(times_ms, 50)), float(np.percentile(times_ms, 99))


def work(stop: threading.Event) -> None:
    """What vision does to the process: long calls that release the GIL, and Python between them."""
    image = np.random.default_rng(0).random((960, 1280))
    while not stop.is_set():
        np.sort(image[:200].ravel())
        sum(range(2000))


async def bench(seconds: float) -> None:
    """Print one line per server and number of clients."""
    edged = ModbusPublisher(ModbusSettings(port=0, max_clients=64), None)
    await edged.start()
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    block = SimData(300, values=[0] * 48, datatype=DataType.REGISTERS)
    plain = ModbusTcpServer(SimDevice(1, simdata=[block]), address=("127.0.0.1", port))
    await plain.serve_forever(background=True)
    stop = threading.Event()
    thread = threading.Thread(target=work, args=(stop,))
    thread.start()

    async def announce() -> None:
        for cycle in range(1, 1_000_000):
            edged.announce(make_snapshot(cycle))
            await asyncio.sleep(0.05)

    announcer = asyncio.create_task(announce())
    try:
        for clients in (1, 8, 32):
            for name, server_port in (("edged", edged.port), ("pymodbus", port)):
                p50, p99 = await measure(server_port, clients, seconds)
                print(f"{name:9} {clients:3} clients   p50 {p50:6.2f} ms   p99 {p99:6.2f} ms", flush=True)
    finally:
        announcer.cancel()
        stop.set()
        thread.join()
        await plain.shutdown()
        await edged.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=3.0, help="for each line")
    asyncio.run(bench(parser.parse_args().seconds))
