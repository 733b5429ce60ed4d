#!/usr/bin/env python3
"""Try a job on live pairs of the virtual stage, as a page does: the rate, and the effect on a PLC.

    tools/bench trials [--seconds S] [--json FILE]

Pictures of 1280 x 960, taken as fast as they are acknowledged; the worker measures as many as it has time
for. Modbus clients in another process read 48 words every 20 ms before and during the trials. Then the map of
the working volume, and the still test of 30 pictures.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
from bench_modbus import in_process, read_all
from bench_newcomer import Newcomer, stage, teach_job
from bench_predict import calibrated
from benching import bench_parser, finish

from edged.files.rig import save_rig
from edged.sim.world import VirtualWorld

READERS = 4
REST_S = 2.0
"""Time for the worker to start and prepare the rig."""


async def watched(newcomer: Newcomer, seconds: float) -> tuple[list[float], list[dict[str, Any]]]:
    """Times of the live pictures (left ones), and the trials reported."""
    pictures, trials = [], []
    headers = {"Origin": newcomer.origin}
    async with newcomer.session.ws_connect("/api/v1/ws", headers=headers) as socket:
        await socket.send_json({"live": True, **newcomer.token})
        until_s = time.monotonic() + seconds
        async for message in socket:
            now_s = time.monotonic()
            if now_s > until_s:
                break
            if message.type is aiohttp.WSMsgType.BINARY:
                if message.data[0] == 0:
                    pictures.append(now_s)
                await socket.send_json({"seen": int.from_bytes(message.data[1:9], "big")})
            elif (told := json.loads(message.data))["type"] == "trial":
                trials.append({"at_s": now_s, **told})
    return pictures, trials


async def done(newcomer: Newcomer, task: str) -> None:
    """Wait until a task has ended. Raises RuntimeError if it failed."""
    while True:
        now = await newcomer.ask("GET", f"tasks/{task}")
        if now["state"] == "done":
            return
        if now["state"] != "running":
            raise RuntimeError(str(now["problem"]))
        await asyncio.sleep(0.1)


async def tried(folder: Path, seconds: float) -> dict[str, Any]:
    """Run all parts; return figures by name."""
    found: dict[str, Any] = {}
    with VirtualWorld(gige=False, seed=0, staged=True) as world:
        async with stage(folder, world, gige=False) as (newcomer, daemon):
            modbus = tomllib.loads((folder / "cell.toml").read_text())["modbus"]["port"]
            save_rig(folder / "rig.json", calibrated())
            if not await daemon.reload():
                raise RuntimeError("the rig was refused")
            await newcomer.ask("PUT", "stage", {"showing": "part", "still": True})
            await teach_job(newcomer, world)
            job = (await newcomer.ask("GET", "jobs"))["jobs"][0]["name"]

            async def read() -> str:
                readings_ms = await in_process(read_all, modbus, READERS, seconds)
                return " ".join(f"{one:.1f}" for one in np.percentile(readings_ms, (50, 99)))

            live = asyncio.create_task(watched(newcomer, seconds + 1.0))
            found["register read, live alone: p50, p99 ms"] = await read()
            pictures, _ = await live
            found["live pairs a second, alone"] = rate(pictures)

            await newcomer.ask("PUT", "trials", {**newcomer.token, "job": job, "on": True})
            await watched(newcomer, REST_S)
            busy_s = worker_busy_s()
            live = asyncio.create_task(watched(newcomer, seconds + 1.0))
            found["register read, trying: p50, p99 ms"] = await read()
            pictures, trials = await live
            found["the worker's processor time a result, ms"] = round(
                1e3 * (worker_busy_s() - busy_s) / max(len(trials), 1), 1
            )
            found["live pairs a second, trying"] = rate(pictures)
            found["results a second"] = rate([one["at_s"] for one in trials])
            found["of them OK"] = f"{sum(one['status'] == 'OK' for one in trials)} of {len(trials)}"

            begun_s = time.monotonic()
            chart = await newcomer.ask("GET", "trials/map")
            found["map: places, s"] = f"{len(chart['points'])}, {time.monotonic() - begun_s:.2f}"

            await newcomer.ask("PUT", "trials", {**newcomer.token, "on": False})
            begun_s = time.monotonic()
            await done(newcomer, (await newcomer.ask("POST", "trials/still", newcomer.token))["task"])
            last = (await newcomer.ask("GET", "trials/still"))["last"]
            found["still test: s, verdict, χ²"] = (
                f"{time.monotonic() - begun_s:.1f}, {last['verdict']}, {last['chi2']} of {last['expected']}"
            )
            for name in ("scatter", "noise", "edges"):
                found[f"still test, {name}, µm"] = " ".join(
                    f"{one:.2f}" for one in last[f"{name}_um"].values()
                )
    return found


def worker_busy_s() -> float:
    """Processor time of the worker process so far."""
    for task in Path("/proc/self/task").iterdir():
        for child in (task / "children").read_text().split():
            if b"workerprocess" in Path(f"/proc/{child}/cmdline").read_bytes():
                user, system = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[11:13]
                return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
    return 0.0


def rate(times_s: list[float]) -> float:
    """Rate per second."""
    return round((len(times_s) - 1) / (times_s[-1] - times_s[0]), 1) if len(times_s) > 1 else 0.0


def main() -> None:
    """Print the figures."""
    parser = bench_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="edged-trials-") as folder:
        found = asyncio.run(tried(Path(folder), options.seconds))
    finish(options, found)
    for name, value in found.items():
        print(f"{name:44} {value}")


if __name__ == "__main__":
    sys.exit(main())
