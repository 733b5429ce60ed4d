#!/usr/bin/env python3
"""Set up the virtual stage as a newcomer does, over its API: what it takes, and how accurate the cell is
then.

    tools/bench newcomer [--goal UM] [--parts N] [--lens MODEL] [--seed N] [--browser | --second [--losses]]
                         [--engine NAME] [--json FILE]

It starts with an empty folder, and a hand that trembles and misses. The hand brings the board to the outline
that the cell draws, and pictures are taken when it is still; when the goal is reached the calibration is
solved and activated. Then a job is taught from one pair, and a part is laid at N places: each result beside
the exact truth. Needs Aravis.
With --browser all of it is done on the page (--engine: chromium, firefox, webkit), by clicks and digits
alone, and clicks are counted (also those of the stage's hands): left and right by a wave, light, the
calibration by the drawn outline, a check, a job, a trial, the robot by touch, until a PLC reads a VALID
result; without Aravis.
With --second the same page then goes on, on virtual GigE cameras and without a restart: another camera,
board and part, a robot of another brand by hand-eye, VALID, back to the first release, VALID, and forward
again; with --losses every second picture of one camera is lost in all of that. Actions and waits are reported
on standard error.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import socket
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, get_args

import aiohttp
import numpy as np
from benching import bench_parser, finish
from helpers.browser import Browser
from helpers.engines import ENGINES
from helpers.waiting import bounded
from newcomerclicks import Clicks, set_up
from secondclicks import bench, second_pass

from edged.app.cell import load_any_cell
from edged.app.daemon import Daemon
from edged.commands.stage import USER, write_cell
from edged.domain.arrays import SIDES, FloatArray
from edged.files.rig import load_rig
from edged.setup.stage.routes import StageRoutes
from edged.sim.showing import Thing
from edged.sim.world import VirtualWorld
from edged.vision.calibration.lenschoice import LensWish
from edged.vision.geometry.triangulation import triangulate_raw

PASSWORD = "correct horse"
ASK_AGAIN_S = 4.0
"""Interval after which a board that is still not in place is moved again."""
LIMIT_S = 900.0
TRIED = 5
"""Number of places of the part on the page before its job is used."""
X_MM, Y_MM, Z_MM = (-15.0, 8.0, 30.0), (-15.0, 0.0, 15.0), (200.0, 205.0, 210.0)
"""Points throughout the volume where parts may lie."""


class Newcomer:
    """A browser's session with the stage."""

    def __init__(self, session: aiohttp.ClientSession, origin: str) -> None:
        self.session, self.origin = session, origin
        self.token: dict[str, str] = {}

    async def ask(self, method: str, path: str, document: Any = None) -> Any:
        """Send a request; return the answer. Raises RuntimeError for a problem."""
        headers = {"Origin": self.origin}
        async with self.session.request(method, f"/api/v1/{path}", json=document, headers=headers) as answer:
            body = await answer.json() if answer.content_type.endswith("json") else None
            if answer.status < 400:
                return body
        if body is None or body.get("code") != "idle":
            raise RuntimeError(f"{method} {path}: {answer.status} {body}")
        # on a busy machine the page takes longer than the ten minutes after which a session locks itself
        await self.ask("POST", "me/wake", {"password": PASSWORD})
        return await self.ask(method, path, document)

    async def take(self) -> None:
        """Log in and take the cell for setting up."""
        form = {"name": USER, "password": PASSWORD}
        headers = {"Origin": self.origin}
        async with self.session.post("/login", data=form, headers=headers, allow_redirects=False) as answer:
            answer.raise_for_status()
        self.token = await self.ask("POST", "setup", {})


@contextlib.asynccontextmanager
async def stage(
    folder: Path, world: VirtualWorld, *, gige: bool = True
) -> AsyncIterator[tuple[Newcomer, Daemon]]:
    """The running stage, and a session with it."""
    if world.stage is None:
        raise ValueError("no stage")
    ports = free_port(), free_port(), free_port()
    path = write_cell(folder, PASSWORD, ports=ports, period_s=0.2, gige=gige)
    routes = StageRoutes(world.stage)
    daemon = Daemon(
        path,
        load_any_cell(path),
        observers=[routes],
        world=world,
        routes=[routes, routes.robot],
    )
    running = asyncio.create_task(daemon.run())
    origin = f"http://127.0.0.1:{ports[0]}"
    try:
        async with aiohttp.ClientSession(origin, cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
            newcomer = Newcomer(session, origin)
            async with bounded("the page answers"):
                while not running.done():
                    with contextlib.suppress(aiohttp.ClientConnectorError):
                        await newcomer.take()
                        break
                    await asyncio.sleep(0.05)
            yield newcomer, daemon
    finally:
        daemon.stop()
        await running


def free_port() -> int:
    """A TCP port that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


async def calibrate(newcomer: Newcomer, goal_um: float, lens: LensWish) -> dict[str, Any]:
    """Follow the outlines until the goal is reached, solve and activate."""
    begun_s = time.monotonic()
    await newcomer.ask("PUT", "stage", {"showing": "board"})
    wanted = {"recognise": True, "mm": 4.0, "goal_um": goal_um, "lens": lens}
    draft = await newcomer.ask("POST", "calibrations", wanted)
    place = f"calibrations/{draft['id']}"
    await newcomer.ask("PUT", f"{place}/auto", {**newcomer.token, "on": True})
    async with newcomer.session.ws_connect("/api/v1/ws", headers={"Origin": newcomer.origin}) as tab:
        await tab.send_str(json.dumps({"live": True, **newcomer.token}))
        last, asked_s = "", 0.0
        async for message in tab:
            told = json.loads(message.data) if message.type is aiohttp.WSMsgType.TEXT else {}
            if told.get("number"):
                await tab.send_str(json.dumps({"seen": told["number"], "active": True}))
            if told.get("code") == "unseen":  # this process was busy for too long
                await tab.send_str(json.dumps({"live": True, **newcomer.token}))
            if told.get("type") == "draft":
                if len(told["views"]) != len(draft["views"]):
                    text = f"view {len(told['views'])} after {time.monotonic() - begun_s:.0f} s"
                    print(f"{text}: {told['sigma_um']}", file=sys.stderr)
                draft = told
            if draft["more_views"] == 0 or time.monotonic() - begun_s > LIMIT_S:
                break
            # a draft is sent when it changes, but a board out of view must be moved even so
            drawn = draft["suggestion"]
            due = drawn is not None and time.monotonic() - asked_s > ASK_AGAIN_S
            is_new = drawn is not None and json.dumps(drawn["left"]) != last
            if (due or is_new) and not (await newcomer.ask("GET", "stage"))["moving"]:
                last, asked_s = json.dumps(drawn["left"]), time.monotonic()
                await newcomer.ask("PUT", "stage/hand", {side: drawn[side] for side in SIDES})
    views_s = time.monotonic() - begun_s
    task = (await newcomer.ask("POST", f"{place}/solve", {}))["task"]
    while (now := await newcomer.ask("GET", f"tasks/{task}"))["state"] == "running":
        await newcomer.ask("PUT", "setup/lease", newcomer.token)
        await asyncio.sleep(0.5)
    if now["state"] != "done":
        raise RuntimeError(f"solve: {now}")
    solved = (await newcomer.ask("GET", place))["solved"]
    await newcomer.ask("POST", f"{place}/activate", {"note": "first", **newcomer.token})
    return {
        "views": len(draft["views"]),
        "views_s": round(views_s, 1),
        "whole_s": round(time.monotonic() - begun_s, 1),
        "lens": solved["figures"]["lens"],
        "verdict": solved["verdict"],
        "sigma_um": solved["sigma_um"],
    }


def true_error_um(rig_file: Path, world: VirtualWorld) -> FloatArray:
    """Calibrated minus true position (N, 3) of points throughout the volume."""
    points = np.array([(x, y, z) for x in X_MM for y in Y_MM for z in Z_MM])
    left, right = (world.cell.view(side).project(points) for side in SIDES)
    return (triangulate_raw(load_rig(rig_file), left, right) - points) * 1e3


async def teach_job(newcomer: Newcomer, world: VirtualWorld) -> dict[str, Any]:
    """Teach from a pair of the part, square to the left camera; activate the proposal unchanged."""
    pose = np.eye(4)
    pose[:3, 3] = world.cell.middle_mm
    world.cell.show(Thing.PART, pose)
    begun_s = time.monotonic()
    draft = await newcomer.ask("POST", "teachings", newcomer.token)
    while draft["proposing"] is not None:
        await asyncio.sleep(0.05)
        draft = await newcomer.ask("GET", f"teachings/{draft['id']}")
    proposal_s = time.monotonic() - begun_s
    if draft["trouble"] is not None:
        raise RuntimeError(f"teach: {draft['trouble']}")
    await newcomer.ask("POST", f"teachings/{draft['id']}/activate", {"note": "part", **newcomer.token})
    return {"features": len(draft["features"]), "proposal_s": round(proposal_s, 1)}


async def measure(newcomer: Newcomer, parts: int) -> tuple[FloatArray, FloatArray, int]:
    """Errors (N, 3) and sigmas (N, 3) in mm of parts laid anywhere, and the number of misses."""
    errors, sigmas, missed = [], [], 0
    for _ in range(parts):
        await newcomer.ask("POST", "stage/lay", {})
        laid_ns = time.time_ns()
        async with bounded("the part that was laid is measured"):
            while True:
                now = await newcomer.ask("GET", "stage/truth")
                if (now["at_ns"] or 0) > laid_ns:
                    break
                await asyncio.sleep(0.05)
        if now["error_mm"] is None:
            missed += 1
            continue
        errors.append(now["error_mm"])
        sigmas.append(now["sigma_mm"])
    return np.array(errors).reshape(-1, 3), np.array(sigmas).reshape(-1, 3), missed


async def newcomer_of(options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Set the cell up and measure; return figures by name."""
    is_clicked = options.browser or options.second
    gige = not options.browser
    with (
        VirtualWorld(gige=gige, seed=options.seed, staged=True) as world,
        bench(world, loses=options.losses) if options.second else contextlib.nullcontext() as beside,
    ):
        async with stage(folder, world, gige=gige) as (newcomer, _daemon):
            if is_clicked:
                await newcomer.ask("DELETE", "setup", newcomer.token)  # the page takes the cell itself
                port = (await newcomer.ask("GET", "plc"))["port"]
                user, film = (USER, PASSWORD), getattr(options, "film", None)

                async def again(page: Browser, clicks: Clicks) -> dict[str, Any]:
                    return await second_pass(page, clicks, beside, port, PASSWORD, options.goal, TRIED)

                then = again if options.second else None
                opened = ENGINES[options.engine]
                found = await set_up(newcomer.origin, user, port, options.goal, TRIED, opened, film, then)
            else:
                found = await calibrate(newcomer, options.goal, options.lens)
            error_um = true_error_um(folder / "rig.json", world)
            found["rig_offset_um"] = error_um.mean(axis=0).round(1).tolist()
            found["rig_most_um"] = np.abs(error_um).max(axis=0).round(1).tolist()
            if not is_clicked:
                found |= await teach_job(newcomer, world)
                await newcomer.ask("DELETE", "setup", newcomer.token)
            errors, sigmas, missed = await measure(newcomer, options.parts)
    found["parts"], found["missed"] = len(errors), missed
    if len(errors):
        found["part_most_um"] = (1e3 * np.abs(errors).max(axis=0)).round(1).tolist()
        found["part_median_um"] = round(1e3 * float(np.median(np.linalg.norm(errors, axis=1))), 1)
        found["chi2_per_dof"] = round(float(np.mean((errors / sigmas) ** 2)), 2)
    return found


def newcomer_parser() -> argparse.ArgumentParser:
    """The arguments that `newcomer_of` reads."""
    parser = bench_parser(__doc__)
    parser.add_argument("--goal", type=float, default=8.0, help="µm: none of the sigmas of X, Y, Z beyond it")
    parser.add_argument("--parts", type=int, default=50)
    parser.add_argument("--lens", choices=get_args(LensWish), default="auto")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--browser", action="store_true", help="on the page, by clicks")
    parser.add_argument("--second", action="store_true", help="by clicks, and then all of it a second time")
    parser.add_argument("--losses", action="store_true", help="with --second: pictures are lost")
    parser.add_argument(
        "--engine", choices=ENGINES, default="chromium", help="of the browser that is clicked in"
    )
    return parser


def main() -> None:
    """Print the figures."""
    options = newcomer_parser().parse_args()
    with tempfile.TemporaryDirectory(prefix="edged-newcomer-") as folder:
        found = asyncio.run(newcomer_of(options, Path(folder)))
    finish(options, found)
    for name, value in found.items():
        print(f"{name:16} {value}")


if __name__ == "__main__":
    sys.exit(main())
