#!/usr/bin/env python3
"""Cost of setting a cell up over its page: the shell, the live view, a click, and the PLC beside it.

    tools/bench setup [--only shell live clicks plc ...] [--seconds S] [--rounds N]

The cell is the daemon of `edged run` in this process, on 1280x960 pictures that are replayed; browser, viewer
and PLC are other processes. For the PLC, phases without and with all that (a viewer of the status page, a
page of the setup, a calibration being solved in the worker) alternate in one run, so that other load on the
machine affects both: only their ratio counts. Needs Chromium for shell and clicks.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import shutil
import tempfile
import time
from collections.abc import AsyncIterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import aiohttp
import cv2
import numpy as np
from bench_modbus import in_process, read_all
from benchcell import BenchCell
from benching import bench_parser, finish
from helpers.browser import Browser, browser
from helpers.ports import free_port
from helpers.setuppage import log_in, take
from pagecost import viewer

from edged.cell.tasks import cancel_and_await
from edged.domain.arrays import SIDES
from edged.files.images import load_image
from edged.files.statefolder import state_folder
from edged.identity.passwords import hash_password
from edged.identity.users import User, UserFile
from edged.setup.calibration.drafts import Drafts, keep_pair
from edged.sim.cell import demo_rig
from edged.sim.stage import stage_board
from edged.sim.views import calibration_views

PARTS = ("shell", "live", "clicks", "plc")
USER, PASSWORD = "anna", "correct horse"
SIZE = (1280, 900)
SPEC = "chessboard:11x8:4"
BOARD_PAIRS, CLICKS, READERS = 20, 30, 4
STEPS = ("cameras", "light", "calibrate")
COUNTED = """(() => {
  window.shown = window.answered = 0;
  const [send, ask] = [WebSocket.prototype.send, window.fetch];
  WebSocket.prototype.send = function (said) {
    if (typeof said === "string" && said.includes('"seen"')) window.shown += 1;
    return send.call(this, said);
  };
  window.fetch = async (...what) => {
    const got = await ask(...what);
    await got.clone().text();
    window.answered += 1;
    return got;
  };
})()"""
SHELL = """(() => {
  const files = performance.getEntriesByType("resource").filter((one) => one.initiatorType !== "fetch");
  const all = files.concat(performance.getEntriesByType("navigation"));
  return [performance.now(), all.reduce((sum, one) => sum + one.encodedBodySize, 0)]; })()"""
FRAME = "await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));"


class SetupCell:
    """A cell with a user who may set it up. boards : its cameras see a board, not the part."""

    def __init__(self, folder: Path, *, boards: Path | None = None) -> None:
        folder.mkdir()
        self.bench, self.port = BenchCell(folder, mode="free"), free_port()
        hashed = hash_password(PASSWORD)
        with self.bench.config.open("a") as config:
            config.write(f'\n[web]\nport = {self.port}\ncommissioning = true\npassword_hash = "{hashed}"\n')
        self.bench.config.chmod(0o600)
        self.state = state_folder(self.bench.config)
        UserFile(self.state / "users.json").put(User(name=USER, role="engineer", password_hash=hashed))
        if boards is not None:
            shutil.rmtree(folder / "pairs")
            shutil.copytree(boards, folder / "pairs")

    @property
    def origin(self) -> str:
        """Address of its page."""
        return f"http://127.0.0.1:{self.port}"

    @contextlib.asynccontextmanager
    async def person(self) -> AsyncIterator[Person]:
        """Session of a person who has logged in."""
        jar = aiohttp.CookieJar(unsafe=True)  # cookies of an IP address
        async with aiohttp.ClientSession(self.origin, cookie_jar=jar) as session:
            form = {"name": USER, "password": PASSWORD}
            async with session.post(
                "/login", data=form, headers={"Origin": self.origin}, allow_redirects=False
            ) as answer:
                answer.raise_for_status()
            yield Person(session, self.origin)


class Person:
    """A session over the API."""

    def __init__(self, session: aiohttp.ClientSession, origin: str) -> None:
        self.session, self._origin = session, origin

    async def ask(self, method: str, path: str, document: Any = None) -> Any:
        """Send a request; return the answer. Raises RuntimeError for a problem."""
        headers = {"Origin": self._origin}
        async with self.session.request(method, f"/api/v1/{path}", json=document, headers=headers) as answer:
            body = await answer.json() if answer.content_type.endswith("json") else None
            if answer.status >= 400:
                raise RuntimeError(f"{method} {path}: {answer.status} {body}")
            return body

    async def done(self, task: str) -> None:
        """Wait until a task has ended. Raises RuntimeError if it failed."""
        while True:
            state = (await self.ask("GET", f"tasks/{task}"))["state"]
            if state == "done":
                return
            if state != "running":
                raise RuntimeError(f"{task}: {state}")
            await asyncio.sleep(0.2)

    @contextlib.asynccontextmanager
    async def setup(self) -> AsyncIterator[dict[str, str]]:
        """Take the cell for setting up; yields the lease's token, and renews it."""
        token = {"token": (await self.ask("POST", "setup", {"take_over": True}))["token"]}

        async def renew() -> None:
            while True:
                await asyncio.sleep(5.0)
                await self.ask("PUT", "setup/lease", token)

        renewing = asyncio.create_task(renew())
        try:
            yield token
        finally:
            renewing.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await renewing
            await self.ask("DELETE", "setup", token)

    async def listen(self, token: dict[str, str] | None) -> AsyncIterator[aiohttp.WSMessage]:
        """Messages of the page's socket; with a token also live pictures, each of them acknowledged."""
        async with self.session.ws_connect("/api/v1/ws", headers={"Origin": self._origin}) as tab:
            wanted = json.dumps({"live": True, **token}) if token else '{"active": true}'
            await tab.send_str(wanted)
            async for message in tab:
                yield message
                told = json.loads(message.data) if message.type is aiohttp.WSMsgType.TEXT else {}
                if told.get("number"):
                    await tab.send_str(json.dumps({"seen": told["number"], "active": True}))
                if told.get("code") == "unseen":
                    await tab.send_str(wanted)


# --- the page in a browser ------------------------------------------------------------------------


@contextlib.asynccontextmanager
async def opened(cell: SetupCell) -> AsyncIterator[Browser]:
    """Browser in which the user has logged in."""
    async with browser() as page:
        await page.ask("Page.enable")
        await page.ask("Page.addScriptToEvaluateOnNewDocument", source=COUNTED)
        await log_in(page, cell.origin, USER, PASSWORD, "/setup", SIZE)
        yield page


async def shell(cell: SetupCell, rounds: int) -> None:
    """Print when the shell is usable, and its weight, with an empty cache and with a full one."""
    async with opened(cell) as page:
        for cached in (False, True):
            await page.ask("Network.enable")
            await page.ask("Network.setCacheDisabled", cacheDisabled=not cached)
            times_ms, weight = [], 0.0
            for _ in range(rounds):
                await page.open(f"{cell.origin}/setup#/welcome", *SIZE)
                await page.ask("Page.reload")
                await page.until('document.querySelector("main h1") && document.querySelector("#state")')
                now_ms, weight = await page.value(SHELL)
                times_ms.append(now_ms)
            print(
                f"shell {'again' if cached else 'first'}: of use after p50 {np.median(times_ms):.0f} ms, "
                f"at most {max(times_ms):.0f} ms (asked: 1000); {weight / 1e3:.0f} kB as sent (asked: 150)"
            )


async def live(cell: SetupCell, seconds: float) -> None:
    """Print pictures a second: to a client that only listens, and in a browser."""
    async with cell.person() as person, person.setup() as token:
        count, begun_s = 0, 0.0
        async for message in person.listen(token):
            if message.type is aiohttp.WSMsgType.BINARY:
                begun_s = begun_s or time.perf_counter()
                count += 1
            if begun_s and time.perf_counter() > begun_s + seconds:
                break
        rate = (count - 1) / 2 / (time.perf_counter() - begun_s)
    print(f"live: {rate:.1f} pairs/s of 1280x960 to one listener (asked: 8)")
    if not shutil.which("chromium"):
        return
    async with opened(cell) as page:
        await take(page)
        await page.value('location.hash = "#/light", 0')
        await page.until("window.shown > 3")
        before, begun_s = await page.value("window.shown"), time.perf_counter()
        await asyncio.sleep(seconds)
        rate = (await page.value("window.shown") - before) / (time.perf_counter() - begun_s)
    print(f"live: {rate:.1f} pairs/s shown by Chromium without a graphics card, on this machine (asked: 8)")


async def clicks(cell: SetupCell) -> None:
    """Print the time from a click until its answer is on the screen, while live pictures arrive."""
    async with cell.person() as person, person.setup() as token:
        draft = await person.ask("POST", "calibrations", {"boards": [SPEC]})
        for _ in range(4):
            await person.ask("POST", f"calibrations/{draft['id']}/views", token)
    async with opened(cell) as page:
        await take(page)
        turned = []
        for number in range(CLICKS):
            step = STEPS[number % len(STEPS)]
            turned.append(await page.value(until_shown(step)))
        await page.value('location.hash = "#/calibrate", 0')
        await page.until('document.querySelector("main .strip")')
        undone = [await page.value(until_answered(number % 2)) for number in range(CLICKS)]
    for what, times_ms in (("another step", turned[len(STEPS) :]), ("undo, redo", undone)):
        p50, p95 = np.percentile(times_ms, (50, 95))
        print(f"click, {what}: p50 {p50:.0f} p95 {p95:.0f} ms (asked: 200)")


def until_shown(step: str) -> str:
    """Script that measures ms from the click on a step until its page is on the screen."""
    return f"""(async () => {{ const begun = performance.now();
      document.querySelector('a[href="#/{step}"]').click();
      const isShown = () => document.querySelector('main[data-page="{step}"] h1');
      while (!isShown()) await new Promise((on) => setTimeout(on, 2));
      {FRAME} return performance.now() - begun; }})()"""


def until_answered(which: int) -> str:
    """Script that measures ms from the click on undo (0) or redo (1) until its answer is on the screen."""
    return f"""(async () => {{
      const button = () => [...document.querySelectorAll("main .strip ~ .actions button")][{which}];
      while (button().disabled) await new Promise((on) => setTimeout(on, 5));
      const [begun, before] = [performance.now(), window.answered];
      button().click();
      while (window.answered === before) await new Promise((on) => setTimeout(on, 2));
      {FRAME} return performance.now() - begun; }})()"""


# --- the PLC --------------------------------------------------------------------------------------


def draft_of(state: Path, pictures: Path) -> str:
    """Make a draft of all pairs, as the page would; return its id."""
    draft = Drafts(state / "drafts").create(USER, (SPEC,), None, "auto", datetime.now(UTC))
    for left in sorted(pictures.glob("*_left.png")):
        pair = [load_image(left), load_image(left.with_name(left.name.replace("left", "right")))]
        _, *seen = keep_pair(draft.folder, draft.next_view, pair[0], pair[1], draft.state.board_models)
        draft.add(draft.next_view, *seen)
    return draft.state.id


async def plc(cell: SetupCell, draft: str, seconds: float, rounds: int) -> None:
    """Print p99 of reading a result and of the cycle, alone and beside everything else, in turns."""
    reads: dict[str, list[float]] = {"alone": [], "beside": []}
    cycles: dict[str, list[float]] = {"alone": [], "beside": []}
    ratios, solves_s = [], list[float]()
    async with cell.bench.running(), cell.person() as person:
        for _ in range(rounds):
            now = {}
            for name in ("alone", "beside"):
                async with busy(cell, person, draft, solves_s) if name == "beside" else nothing():
                    first = len(cell.bench.listener.snapshots)
                    times_ms = await in_process(read_all, cell.bench.modbus_port, READERS, seconds)
                    shots = cell.bench.listener.snapshots[first:]
                totals_ms = [shot.timing_ms["total"] for shot in shots]
                reads[name] += times_ms
                cycles[name] += totals_ms
                now[name] = np.array([np.percentile(times_ms, 99), np.percentile(totals_ms, 99)])
            ratios.append(now["beside"] / now["alone"])
    print("| | alone p50, p99 ms | beside p50, p99 ms | ratio of p99, median of rounds |")
    print("|---|---:|---:|---:|")
    for index, (what, times) in enumerate((("register read", reads), ("cycle", cycles))):
        cells = [f"{p50:.2f}, {p99:.2f}" for p50, p99 in (np.percentile(times[n], (50, 99)) for n in times)]
        print(f"| {what} | {' | '.join(cells)} | {np.median([one[index] for one in ratios]):.2f} |")
    if solves_s:
        each_s = f"{np.median(solves_s):.0f} s each (asked: 45)"
        print(f"{len(solves_s)} solves of {BOARD_PAIRS} pairs meanwhile, {each_s}")


@contextlib.asynccontextmanager
async def nothing() -> AsyncIterator[None]:
    """No load beside the cell."""
    yield


@contextlib.asynccontextmanager
async def busy(cell: SetupCell, person: Person, draft: str, solves_s: list[float]) -> AsyncIterator[None]:
    """Run a viewer of the status page, a page of the setup, and one solution after another in the worker."""

    tasks = list[str]()

    async def solve() -> None:
        while True:
            begun_s = time.perf_counter()
            tasks.append((await person.ask("POST", f"calibrations/{draft}/solve", {}))["task"])
            await person.done(tasks[-1])
            solves_s.append(time.perf_counter() - begun_s)

    async def hear() -> None:
        async for _ in person.listen(None):
            pass

    async with viewer(cell.port, USER, PASSWORD):
        both = asyncio.create_task(solve()), asyncio.create_task(hear())
        await asyncio.sleep(1.0)
        try:
            yield
        finally:
            await cancel_and_await(*both)
            with contextlib.suppress(RuntimeError):  # it may just have ended
                await person.ask("DELETE", f"tasks/{tasks[-1]}", {})


# --- all of it ------------------------------------------------------------------------------------


def board_pairs(folder: Path) -> Path:
    """Pictures as a careful person takes them, drawn once."""
    folder.mkdir()
    for number, view in enumerate(calibration_views(demo_rig(), stage_board(), BOARD_PAIRS, seed=3), 1):
        for side, image in zip(SIDES, (view.left, view.right), strict=True):
            cv2.imwrite(str(folder / f"{number:02}_{side}.png"), image)
    return folder


async def measured(folder: Path, options: argparse.Namespace) -> None:
    """Run the requested parts."""
    pictures = board_pairs(folder / "pictures")
    has_browser = shutil.which("chromium") is not None
    if set(options.only) - {"plc"}:
        at_boards = SetupCell(folder / "boards", boards=pictures)
        async with at_boards.bench.running():
            if "shell" in options.only and has_browser:
                await shell(at_boards, options.rounds)
            if "live" in options.only:
                await live(at_boards, options.seconds)
            if "clicks" in options.only and has_browser:
                await clicks(at_boards)
    if "plc" in options.only:
        at_parts = SetupCell(folder / "parts")
        draft = draft_of(at_parts.state, pictures)
        await plc(at_parts, draft, options.seconds, options.rounds)


def main() -> None:
    """Print the figures."""
    parser = bench_parser(__doc__)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--seconds", type=float, default=15.0, help="of each measurement, and of each turn")
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="edged-setup-") as place:
        asyncio.run(measured(Path(place), options))
    finish(options)


if __name__ == "__main__":
    main()
