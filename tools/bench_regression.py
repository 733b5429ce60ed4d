"""Cost of recorded cycles: their list, and a changed job tried on all of them beside a cell that measures.

tools/bench regression [--cycles N] [--distinct N]

1280x960 pictures of the flange of the virtual cell. A PLC in its own process reads registers; the worker
process has the rest of the machine, at lower priority.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import socket
import struct
import sys
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
from argon2 import PasswordHasher
from benchcell import BenchCell
from benching import bench_parser, finish
from helpers.ports import free_port

from edged.domain.events import Snapshot
from edged.domain.frames import Frame, FramePair
from edged.files import recording
from edged.files.statefolder import state_folder
from edged.identity.users import User, UserFile
from edged.pipeline import PreparedRig, locate
from edged.setup.cellfiles import read_cell
from edged.sim.cell import SIDES, VirtualCell, demo_part, demo_rig
from edged.sim.exposure import ExposureRequest

PASSWORD = "bench regression"
PERIOD_S, READ_EVERY_S, BEFORE_S = 0.5, 0.01, 20.0


def main() -> None:
    """Print the figures."""
    parser = bench_parser(__doc__)
    parser.add_argument("--cycles", type=int, default=700)
    parser.add_argument("--distinct", type=int, default=12, help="pictures that are rendered")
    parser.add_argument("--read", type=int, help=argparse.SUPPRESS)
    wanted = parser.parse_args()
    if wanted.read is not None:
        read_registers(wanted.read)
        return
    with tempfile.TemporaryDirectory(prefix="edged-bench-") as folder:
        asyncio.run(measure(Path(folder), wanted.cycles, wanted.distinct))
    finish(wanted)


def read_registers(port: int) -> None:
    """Read as a PLC does, until stdin ends; print when each read began, and how long it took, in ms."""
    ask = struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 200, 10)
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while True:
            start_s = time.perf_counter()
            connection.sendall(ask)
            got = b""
            while len(got) < 9 + 20:
                more = connection.recv(256)
                if not more:
                    return
                got += more
            took_ms = 1e3 * (time.perf_counter() - start_s)
            print(f"{time.time():.3f} {took_ms:.3f}", flush=True)
            time.sleep(READ_EVERY_S)


async def measure(folder: Path, cycles: int, distinct: int) -> None:
    """Run the cell, make its recordings, and send the requests."""
    cell = BenchCell(folder, mode="free", period_s=PERIOD_S)
    port = free_port()
    digest = PasswordHasher(time_cost=1, memory_cost=512, parallelism=1).hash(PASSWORD)
    UserFile(state_folder(cell.config) / "users.json").put(
        User(name="bench", role="engineer", password_hash=digest)
    )
    cell.config.write_text(
        f"{cell.config.read_text()}\n[web]\nport = {port}\ncommissioning = true\n"
        '[recorder]\nfolder = "recordings"\nkeep_good = 100000\nkeep_bad = 100000\nmax_mib = 1000000\n'
        "min_free_mib = 0\n"
    )
    record(cell.config, folder / "recordings", cycles, distinct)
    jar = aiohttp.CookieJar(unsafe=True)  # cookies of an IP address
    page = aiohttp.ClientSession(f"http://127.0.0.1:{port}", cookie_jar=jar)
    async with cell.running(), page as session:
        await asked(session, cell, port, cycles)


def record(config: Path, folder: Path, cycles: int, distinct: int) -> None:
    """Make `cycles` recordings from `distinct` different pictures."""
    files, virtual = read_cell(config), VirtualCell(demo_rig(), demo_part())
    rig, job = PreparedRig(files.rig, files.rectification), files.jobs[0]
    recording.save_setup(folder, files.fingerprint, files.contents)
    start = datetime.now(UTC) - timedelta(hours=1)
    originals = []
    for number in range(min(distinct, cycles)):
        at_ns = number * 10**9
        request = ExposureRequest(number + 1, at_ns, at_ns, 2000.0, 0.0, 1280, 960)
        left, right = (Frame(side, number, virtual.exposure(side)(request), at_ns, at_ns) for side in SIDES)
        outcome = locate(FramePair(left, right), job, rig)
        snapshot = Snapshot(
            cycle=number,
            status=outcome.status,
            command=None,
            job=job.name,
            job_number=job.number,
            calibration_id=files.rig.calibration_id,
            fingerprint=files.fingerprint,
            simulated=True,
            exposed_ns=at_ns,
            published_ns=at_ns,
            targets=outcome.targets,
        )
        originals.append(recording.save(folder, number, start, snapshot, FramePair(left, right)).path)
    for number in range(len(originals), cycles):
        original = originals[number % len(originals)]
        os.link(original, original.with_name(f"{number:09d}{original.name[9:]}"))


async def asked(session: aiohttp.ClientSession, cell: BenchCell, port: int, cycles: int) -> None:
    """Request the list and a regression, with a PLC beside it; print the figures."""
    origin = {"Origin": f"http://127.0.0.1:{port}"}

    async def ask(method: str, path: str, body: Any = None) -> Any:
        async with session.request(method, f"/api/v1/{path}", json=body, headers=origin) as answer:
            document = await answer.json()
            if not answer.ok:
                raise SystemExit(f"{method} {path}: {document}")
            return document

    form = {"name": "bench", "password": PASSWORD}
    await session.post("/login", data=form, headers=origin, allow_redirects=False)
    plc = await asyncio.create_subprocess_exec(
        *(sys.executable, __file__, "--read", str(cell.modbus_port)), stdout=asyncio.subprocess.PIPE
    )
    reads: list[tuple[float, float]] = []

    async def listen() -> None:
        assert plc.stdout is not None
        while line := await plc.stdout.readline():
            at_s, took_ms = line.split()
            reads.append((float(at_s), float(took_ms)))

    listening = asyncio.create_task(listen())
    before_s = time.time()
    await asyncio.sleep(BEFORE_S)
    listed_s = [await timed(lambda: ask("GET", "cycles?reason=NO_GRASP&most=200")) for _ in range(2)]
    begun_s = time.time()
    change = {"job": "flange", "limits": {"max_sigma_mm": 0.19}}
    begun = await ask("POST", "regressions", {"change": change})
    # as a page does without a socket
    while (await ask("GET", f"tasks/{begun['task']}"))["state"] == "running":  # noqa: ASYNC110
        await asyncio.sleep(0.5)
    ended_s = time.time()
    result = await ask("GET", f"regressions/{begun['regression']}")
    plc.kill()
    await plc.wait()
    await listening
    shots = [(one.published_ns / 1e9, one.timing_ms["total"]) for one in cell.listener.snapshots]
    print(f"\n{result['cycles']} cycles tried in {ended_s - begun_s:.0f} s, {result['counts']}")
    print(f"list of {cycles}: {1e3 * listed_s[0]:.0f} ms, and again {1e3 * listed_s[1]:.0f} ms\n")
    print("| | register read p50 ms | p99 ms | cycle p50 ms | p99 ms |")
    print("|---|---:|---:|---:|---:|")
    for what, first_s, last_s in (("before", before_s, before_s + BEFORE_S), ("meanwhile", begun_s, ended_s)):
        figures = [
            value
            for series in (reads, shots)
            for value in np.percentile([ms for at_s, ms in series if first_s <= at_s <= last_s], (50, 99))
        ]
        print(f"| {what} | {figures[0]:.2f} | {figures[1]:.2f} | {figures[2]:.0f} | {figures[3]:.0f} |")


async def timed(work: Any) -> float:
    """Duration of a call in seconds."""
    start_s = time.perf_counter()
    await work()
    return time.perf_counter() - start_s


if __name__ == "__main__":
    main()
