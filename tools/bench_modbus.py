#!/usr/bin/env python3
"""Measure the Modbus server while vision runs: reading the result, and from a trigger to its result.

Run it with the project's Python: `.venv/bin/python tools/bench_modbus.py`. The daemon measures in this
process as fast as it can; clients are another process. Reading: N connections, each reads 48 words every
20 ms as a PLC does; edged and a plain pymodbus server, in the same process and run. Trigger: from writing
CMD_SEQ to reading RESULT_VALID, polled every millisecond, without the duration of the cycle itself; then
again with everything that a cell may have beside it: a recorder, a page with a viewer, eight reading clients.
In ms.
"""

from __future__ import annotations

import asyncio
import heapq
import logging
import multiprocessing as mp
import selectors
import socket
import struct
import tempfile
import time
from multiprocessing.queues import Queue
from pathlib import Path

import numpy as np
import numpy.typing as npt
from benchcell import BenchCell
from benching import bench_parser, finish
from helpers.ports import free_port
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from edged.plc.registers import ADDRESS, Flag

PERIOD_S = 0.02
READERS = 8
READ_RESULT = struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 300, 48)
ANSWER_BYTES = 9 + 96


def read_all(port: int, clients: int, seconds: float, results: Queue[list[float]]) -> None:
    """Read on each connection every 20 ms, each at its own phase; report the durations in ms."""
    ready = selectors.DefaultSelector()
    lines = [socket.create_connection(("127.0.0.1", port)) for _ in range(clients)]
    for number, line in enumerate(lines):
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        ready.register(line, selectors.EVENT_READ, number)
    begin_s = time.perf_counter()
    due = [(begin_s + PERIOD_S * number / clients, number) for number in range(clients)]
    sent_s, missing = [0.0] * clients, [0] * clients
    times_ms: list[float] = []
    while (now_s := time.perf_counter()) < begin_s + seconds:
        while due and due[0][0] <= now_s:
            _, number = heapq.heappop(due)
            sent_s[number], missing[number] = time.perf_counter(), ANSWER_BYTES
            lines[number].sendall(READ_RESULT)
        for key, _ in ready.select(max(0.0, due[0][0] - now_s) if due else 1.0):
            number = key.data
            missing[number] -= len(lines[number].recv(missing[number]))
            if missing[number] == 0:
                done_s = time.perf_counter()
                times_ms.append((done_s - sent_s[number]) * 1e3)
                heapq.heappush(due, (max(sent_s[number] + PERIOD_S, done_s), number))
    for line in lines:
        line.close()
    results.put(times_ms)


def trigger_all(port: int, count: int, results: Queue[list[float]]) -> None:
    """Trigger and poll; report the times from the write to the VALID answer, in ms."""
    line = socket.create_connection(("127.0.0.1", port))
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def ask(pdu: bytes, size: int) -> bytes:
        line.sendall(struct.pack(">HHHB", 1, 0, len(pdu) + 1, 1) + pdu)
        answer = b""
        while len(answer) < size:
            answer += line.recv(size - len(answer))
        return answer

    times_ms = []
    ask(struct.pack(">BHH", 6, ADDRESS["CMD_SEQ"], 0), 12)  # a connection's first one triggers nothing
    for sequence in range(1, count + 1):
        time.sleep(0.02)
        start_s = time.perf_counter()
        ask(struct.pack(">BHHB3H", 16, ADDRESS["COMMAND"], 3, 6, 1, 0, sequence), 12)
        while True:
            words = struct.unpack(">48H", ask(READ_RESULT[7:], ANSWER_BYTES)[9:])
            if words[0] == sequence and words[7] & Flag.VALID:
                break
            time.sleep(0.001)
        times_ms.append((time.perf_counter() - start_s) * 1e3)
    line.close()
    results.put(times_ms)


def view(port: int, seconds: float, results: Queue[list[float]]) -> None:
    """Watch the page; report the time of each update, in ms."""
    with socket.create_connection(("127.0.0.1", port)) as line:
        line.sendall(f"GET /events HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
        begin_s, came_ms = time.perf_counter(), list[float]()
        line.settimeout(1.0)
        while (now_s := time.perf_counter()) < begin_s + seconds:
            try:
                came_ms += [(now_s - begin_s) * 1e3] * line.recv(65536).count(b"event: ")
            except TimeoutError:
                continue
    results.put(came_ms)


async def in_process(target: object, *arguments: object) -> list[float]:
    """Run a client in another process."""
    context = mp.get_context("spawn")
    results: Queue[list[float]] = context.Queue()
    process = context.Process(target=target, args=(*arguments, results))
    process.start()
    times_ms = await asyncio.to_thread(results.get, timeout=120)
    await asyncio.to_thread(process.join)
    return times_ms


async def bench_reading(folder: Path, seconds: float) -> None:
    """Print one line per server and number of clients."""
    cell, port = BenchCell(folder, mode="free"), free_port()
    block = SimData(300, values=[0] * 48, datatype=DataType.REGISTERS)
    plain = ModbusTcpServer(SimDevice(1, simdata=[block]), address=("127.0.0.1", port))
    await plain.serve_forever(background=True)
    try:
        async with cell.running():
            for clients in (1, 8, 32):
                for name, server_port in (("edged", cell.modbus_port), ("pymodbus", port)):
                    before = len(cell.listener.snapshots)
                    times_ms = await in_process(read_all, server_port, clients, seconds)
                    rate_hz = (len(cell.listener.snapshots) - before) / seconds
                    p50, p99 = np.percentile(times_ms, (50, 99))
                    print(
                        f"{name:9} {clients:3} clients   p50 {p50:6.2f}   p99 {p99:6.2f}   "
                        f"{len(times_ms) / seconds:6.0f} reads/s, {rate_hz:.0f} cycles/s beside",
                        flush=True,
                    )
    finally:
        await plain.shutdown()


async def bench_trigger(folder: Path, count: int) -> None:
    """Print the time from trigger to result, and its share outside the cycle."""
    cell = BenchCell(folder, mode="command")
    async with cell.running():
        times_ms = np.array(await in_process(trigger_all, cell.modbus_port, count))
    show_triggers("", times_ms, cell)


async def bench_most_clients(folder: Path, count: int) -> None:
    """Print the times beside a recorder, a viewer of the page, and eight clients that read all the time."""
    cell, web_port = BenchCell(folder, mode="command"), free_port()
    with cell.config.open("a") as config:
        config.write(f'\n[recorder]\nfolder = "recordings"\nmin_free_mib = 0\n\n[web]\nport = {web_port}\n')
    async with cell.running():
        seconds = count * 0.1 + 5.0
        readers = asyncio.create_task(in_process(read_all, cell.modbus_port, READERS, seconds))
        viewer = asyncio.create_task(in_process(view, web_port, seconds))
        times_ms = np.array(await in_process(trigger_all, cell.modbus_port, count))
        readings_ms, updates = await readers, await viewer
    show_triggers(" among all", times_ms, cell)
    p50, p99 = np.percentile(readings_ms, (50, 99))
    print(
        f"beside it: {READERS} clients, p50 {p50:.2f} p99 {p99:.2f}; the page was sent {len(updates)} times"
    )


def show_triggers(
    where: str, times_ms: npt.NDArray[np.float64], cell: BenchCell, what: str = "trigger to RESULT_VALID"
) -> None:
    """Print times of all triggers, those of the cycles, and the remainder without cycle and capture."""
    timings = [snapshot.timing_ms for snapshot in cell.listener.snapshots]
    total_ms, capture_ms = (np.array([one[stage] for one in timings]) for stage in ("total", "capture"))
    for name, values in (
        (what, times_ms),
        ("... minus the capture", times_ms - capture_ms),
        ("cycle without capture", total_ms - capture_ms),
        ("without the cycle", times_ms - total_ms),
    ):
        p50, p99 = np.percentile(values, (50, 99))
        print(f"{name + where:34} p50 {p50:6.2f}   p99 {p99:6.2f}   ({len(values)} triggers)", flush=True)


if __name__ == "__main__":
    parser = bench_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=5.0, help="for each line")
    parser.add_argument("--triggers", type=int, default=300)
    parser.add_argument("--only-triggers", action="store_true")
    given = parser.parse_args()
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # it logs its traffic when a client disconnects
    with tempfile.TemporaryDirectory() as place:
        if not given.only_triggers:
            asyncio.run(bench_reading(Path(place) / "free", given.seconds))
        asyncio.run(bench_trigger(Path(place) / "command", given.triggers))
        asyncio.run(bench_most_clients(Path(place) / "full", given.triggers))
    finish(given)
