#!/usr/bin/env python3
"""Measure from the end of a cycle to a Zenoh subscriber in another process, while vision runs.

Run it with the project's Python: `.venv/bin/python tools/bench_zenoh.py`. Three cases in turn: no other
subscriber; another process receives the previews; that process takes a second for each picture. A coordinate
must arrive as quickly in all three. Milliseconds from `published_ns` to the callback, on one machine's clock.
"""

from __future__ import annotations

import asyncio
import json
import multiprocessing as mp
import os
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import zenoh
from benching import bench_parser, finish

SLOW_S = 1.0


def _session(port: int) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    return zenoh.open(config)


def listen(port: int, pipe: Connection) -> None:
    """Note the age of every result until the pipe says stop; report all ages in ms."""
    ages_ms: list[float] = []

    def heard(sample: zenoh.Sample) -> None:
        now_ns = time.time_ns()
        ages_ms.append((now_ns - json.loads(sample.payload.to_bytes())["published_ns"]) * 1e-6)

    with _session(port) as session:
        session.declare_subscriber("edged/*/target", heard)
        pipe.send("up")
        pipe.recv()
    pipe.send(ages_ms)


def look(port: int, pause_s: float, pipe: Connection) -> None:
    """Take every preview, slowly; report the number received."""
    pictures = 0

    def seen(_sample: zenoh.Sample) -> None:
        nonlocal pictures
        pictures += 1
        time.sleep(pause_s)

    session = _session(port)
    session.declare_subscriber("edged/*/preview/*", seen)
    pipe.send("up")
    pipe.recv()
    pipe.send(pictures)
    pipe.close()
    os._exit(0)  # closing the session would wait for all pictures queued for the slow callback


async def bench(folder: Path, seconds: float) -> None:
    """Print one line for each case."""
    from benchcell import BenchCell  # not in the other processes, which import this file too

    cell = BenchCell(folder, mode="free", period_s=0.1)
    async with cell.running():
        for name, pause_s in (("nobody looks", None), ("previews", 0.0), ("slow previews", SLOW_S)):
            tasks = [(listen, (cell.zenoh_port,))]
            if pause_s is not None:
                tasks.append((look, (cell.zenoh_port, pause_s)))
            ages_ms, *pictures = await asyncio.to_thread(_run, tasks, seconds)
            p50, p99 = np.percentile(ages_ms, (50, 99))
            seen = f", {pictures[0]} pictures" if pictures else ""
            print(f"{name:14} p50 {p50:6.2f}   p99 {p99:6.2f}   ({len(ages_ms)} results{seen})", flush=True)


def _run(tasks: list, seconds: float) -> list:
    context = mp.get_context("spawn")
    started = []
    for target, arguments in tasks:
        ours, theirs = context.Pipe()
        process = context.Process(target=target, args=(*arguments, theirs))
        process.start()
        started.append((process, ours))
    for _, ours in started:
        ours.recv()
    time.sleep(seconds)
    reports = []
    for process, ours in started:
        ours.send("stop")
        reports.append(ours.recv())
        process.join(10)
    return reports


if __name__ == "__main__":
    parser = bench_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="for each line")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        asyncio.run(bench(Path(place), given.seconds))
    finish(given)
