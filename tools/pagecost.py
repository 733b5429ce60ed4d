"""Cost of the status page: the cycle with and without a viewer, its weight, and its time in a browser."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import shutil
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
from benchcell import BenchCell
from helpers.ports import free_port
from pageviewer import fetch_pictures

from edged.adapters.web.assets import read_assets, run_modules

ROUNDS = 3
"""Rounds without and with a viewer, alternating, so that other load affects both."""
FILES = (
    *("/", "/static/run/run.css", "/static/icon.svg", "/static/setup/en.ftl", "/static/run/run.en.ftl"),
    *(f"/static/{name}" for name in run_modules(read_assets())),
)
BROWSER_S = 30.0
LOOK = """JSON.stringify({
  load_ms: performance.getEntriesByType("navigation")[0].loadEventEnd,
  shown: !!document.querySelector("#left image[href]") && !!document.querySelector("#right image[href]"),
  now_ms: performance.now(),
  bytes: performance.getEntriesByType("resource").concat(performance.getEntriesByType("navigation"))
    .reduce((sum, entry) => sum + entry.transferSize, 0)})"""


@dataclass(slots=True)
class Phases:
    """Cycles in ms, processor time and wall time, of all rounds of one kind."""

    cycles_ms: list[float] = field(default_factory=list)
    busy_s: float = 0.0


def page_cost(folder: Path, seconds: float) -> None:
    """Print the figures. seconds : of each round with or without a viewer."""
    cell = BenchCell(folder, mode="free")
    port = free_port()
    cell.config.write_text(cell.config.read_text() + f"\n[web]\nport = {port}\n")
    asyncio.run(_measure(cell, port, seconds))


async def _measure(cell: BenchCell, port: int, seconds: float) -> None:
    phases = {name: Phases() for name in ("nobody looks", "one viewer")}
    async with cell.running():
        for name in ROUNDS * tuple(phases):
            async with viewer(port) if name == "one viewer" else contextlib.nullcontext():
                first, busy_s = len(cell.listener.snapshots), time.process_time()
                await asyncio.sleep(seconds)
                phases[name].busy_s += time.process_time() - busy_s
                phases[name].cycles_ms += [
                    shot.timing_ms["total"] for shot in cell.listener.snapshots[first:]
                ]
        weight = await _weight(port)
        seen = await _in_chromium(f"http://127.0.0.1:{port}/") if shutil.which("chromium") else None
    print("\n| cycle of 1280x960 at full speed | cycles | p50 ms | p99 ms | processor ms a cycle |")
    print("|---|---:|---:|---:|---:|")
    for name, phase in phases.items():
        p50, p99 = np.percentile(phase.cycles_ms, (50, 99))
        count = len(phase.cycles_ms)
        print(f"| {name} | {count} | {p50:.0f} | {p99:.0f} | {phase.busy_s * 1e3 / count:.1f} |")
    print("\n| weight | bytes |\n|---|---:|")
    for what, size in weight.items():
        print(f"| {what} | {size} |")
    if seen is not None:
        print(
            f"\nHeadless Chromium: load event after {seen['load_ms']:.0f} ms, both pictures shown after "
            f"{seen['now_ms']:.0f} ms, {seen['bytes']} bytes."
        )


# --- what it brings -------------------------------------------------------------------------------


@contextlib.asynccontextmanager
async def viewer(port: int, *who: str) -> AsyncIterator[None]:
    """Run a viewer in a process of its own. who : name and password, if the page asks for them."""
    script = Path(__file__).with_name("pageviewer.py")
    process = await asyncio.create_subprocess_exec(
        sys.executable, str(script), str(port), *who, stdout=asyncio.subprocess.PIPE
    )
    try:
        assert process.stdout is not None
        async with asyncio.timeout(60):
            if await process.stdout.readline() != b"looking\n":
                raise RuntimeError("the viewer sees no pictures")
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.communicate()


async def _weight(port: int) -> dict[str, int]:
    """Number of bytes that a viewer downloads."""
    async with aiohttp.ClientSession(f"http://127.0.0.1:{port}") as session:
        files = 0
        for path in FILES:
            async with session.get(path) as answer:
                files += len(await answer.read())
        sizes, pictures = [], 0
        async with session.get("/events") as events:
            async for line in events.content:
                if line.startswith(b"data: "):
                    sizes.append(len(line))
                    pictures = pictures or await fetch_pictures(session, json.loads(line[6:]))
                if len(sizes) == 2:
                    break
    return {
        "page, script, style, icon": files,
        "first event, with the trends so far": sizes[0],
        "each further event, at most five a second": sizes[1],
        "pictures and thumbnail of a cycle": pictures,
    }


# --- a browser ------------------------------------------------------------------------------------


async def _in_chromium(url: str) -> dict[str, Any] | None:
    """Load the page over the DevTools protocol; None if it never shows its pictures."""
    with tempfile.TemporaryDirectory(prefix="edged-chromium-", ignore_cleanup_errors=True) as profile:
        browser = await asyncio.create_subprocess_exec(
            *("chromium", "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0"),
            *(f"--user-data-dir={profile}", "about:blank"),
            stderr=asyncio.subprocess.PIPE,
        )
        try:
            async with asyncio.timeout(BROWSER_S):
                return await _load(browser, url)
        except TimeoutError:
            return None
        finally:
            with contextlib.suppress(ProcessLookupError):
                browser.kill()
            await browser.communicate()


async def _load(browser: asyncio.subprocess.Process, url: str) -> dict[str, Any]:
    assert browser.stderr is not None
    while not (found := re.search(rb"ws://([^/]+)/", await browser.stderr.readline())):
        pass
    async with aiohttp.ClientSession() as session:
        async with session.get(f"http://{found[1].decode()}/json/list") as answer:
            pages = json.loads(await answer.read())
        address = next(page["webSocketDebuggerUrl"] for page in pages if page["type"] == "page")
        async with session.ws_connect(address) as devtools:
            await _ask(devtools, "Page.navigate", {"url": url})
            while True:
                answer_ = await _ask(devtools, "Runtime.evaluate", {"expression": LOOK})
                seen: dict[str, Any] = json.loads(answer_["result"].get("value", '{"shown": false}'))
                if seen["shown"] and seen["load_ms"] > 0:
                    return seen
                await asyncio.sleep(0.02)


async def _ask(
    devtools: aiohttp.ClientWebSocketResponse, method: str, parameters: dict[str, Any]
) -> dict[str, Any]:
    await devtools.send_json({"id": 1, "method": method, "params": parameters})
    while True:
        message = json.loads((await devtools.receive()).data)
        if message.get("id") == 1:
            return dict(message["result"])
