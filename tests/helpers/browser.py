"""A real browser for tests: headless Chromium over its DevTools protocol."""

from __future__ import annotations

import atexit
import base64
import contextlib
import json
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from functools import cache
from pathlib import Path
from typing import Any

import aiohttp

from helpers.waiting import LIMIT_S, bounded, until

AXE = Path(__file__).parents[1] / "data" / "axe" / "axe.min.js"
REST_MS = 40
GUARD = """(at) => {
  window.aim = { at, missed: false, clicked: false };
  const check = (event) => {
    if (event.target === aim.at || aim.clicked) return void (aim.clicked ||= event.type === "click");
    aim.missed = true;
    event.preventDefault();
    event.stopImmediatePropagation();
  };
  aim.end = () => EVENTS.forEach((type) => removeEventListener(type, check, true));
  EVENTS.forEach((type) => addEventListener(type, check, true));
}""".replace("EVENTS", '["pointerdown", "mousedown", "pointerup", "mouseup", "click"]')
"""Until `aim.end()`, only the targeted element receives a press, as the page may move it away meanwhile."""
MISSED = """(() => {
  if (!window.aim) return false;  // the press led to another page
  const { at, missed, clicked, end } = aim;
  end();
  return missed || (!clicked && !at.isConnected);
})()"""


def keys_of(text: str) -> dict[str, Any]:
    """What WebDriver does to type a text."""
    keys = [{"type": kind, "value": key} for key in text for kind in ("keyDown", "keyUp")]
    return {"type": "key", "id": "keys", "actions": keys}


def pointer_of(event: dict[str, Any]) -> dict[str, Any]:
    """What WebDriver does for a mouse event of Chromium's protocol."""
    at = {"type": "pointerMove", "x": round(event["x"]), "y": round(event["y"])}
    press = {"mousePressed": "pointerDown", "mouseReleased": "pointerUp"}[event["type"]]
    return {"type": "pointer", "id": "mouse", "actions": [at, {"type": press, "button": 0}]}


class Gone(Exception):
    """The request belonged to a page that has been left meanwhile."""


class Browser:
    """One page.

    complaints : console errors and security policy violations so far. clicks : made so far.
    on_click : called before each click with its place in the window.
    """

    def __init__(self, devtools: aiohttp.ClientWebSocketResponse) -> None:
        self._devtools = devtools
        self._number = 0
        self.complaints: list[str] = []
        self.clicks = 0
        self.on_click: Callable[[float, float], Awaitable[None]] | None = None

    async def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send one command of the protocol and return its result. Raises TimeoutError if none arrives."""
        async with bounded(f"{method} {parameters}"):
            return await self._ask(method, parameters)

    async def _ask(self, method: str, parameters: dict[str, Any]) -> dict[str, Any]:
        self._number += 1
        await self._devtools.send_json({"id": self._number, "method": method, "params": parameters})
        while True:
            message = json.loads((await self._devtools.receive()).data)
            if message.get("method") == "Log.entryAdded":
                entry = message["params"]["entry"]
                self.complaints.append(f"{entry['text']} {entry.get('url', '')}")
            elif message.get("method") == "Runtime.exceptionThrown":
                self.complaints.append(json.dumps(message["params"]))
            elif message.get("id") == self._number:
                if "error" in message:
                    raise Gone(message["error"]["message"])
                return dict(message["result"])

    async def resize(self, width: int, height: int, zoom: float = 1.0) -> None:
        """Set the window's size, in CSS pixels at this zoom."""
        await self.ask(
            "Emulation.setDeviceMetricsOverride",
            width=round(width / zoom),
            height=round(height / zoom),
            deviceScaleFactor=zoom,
            mobile=False,
        )

    async def open(self, url: str, width: int, height: int) -> None:
        """Go to a page, in a window of this size."""
        await self.ask("Log.enable")
        await self.ask("Runtime.enable")
        await self.ask("Page.enable")
        await self.resize(width, height)
        await self.ask("Page.navigate", url=url)

    async def value(self, expression: str) -> Any:
        """Evaluate an expression in the page; promises are awaited."""
        if expression.startswith("import("):  # or its promise may be collected before the module has loaded
            expression = f"globalThis.awaited = {expression}"
        answer = await self.ask(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    async def until(self, expression: str) -> None:
        """Wait until an expression is true in this page, or in the one that it leads to."""
        while True:
            with contextlib.suppress(Gone):
                await self.value(
                    f"""new Promise((done, failed) => {{
                      const shown = () => document.body.innerText;
                      const late = () => failed(new Error("never true: " + shown()));
                      const timer = setTimeout(late, {1e3 * LIMIT_S});
                      const look = () => {{
                        if (!({expression})) return setTimeout(look, 20);
                        clearTimeout(timer);
                        done();
                      }};
                      look(); }})"""
                )
                return

    async def press(self, key: str) -> None:
        """Press and release a key, as a person would."""
        text = {"text": key} if len(key) == 1 else {}
        await self.ask("Input.dispatchKeyEvent", type="keyDown", key=key, **text)
        await self.ask("Input.dispatchKeyEvent", type="keyUp", key=key)

    async def click(self, selector: str) -> None:
        """Click the middle of an element, as a person would: whatever covers it receives the click."""
        await self.click_on(f"document.querySelector({json.dumps(selector)})")

    async def click_on(self, element: str) -> None:
        """Click an element given as an expression; repeated if the page moved it away under the pointer."""
        self.clicks += 1
        if self.on_click is not None:
            await self.on_click(*await self._middle(element))
        async with bounded(f"a click on {element}"):
            while True:
                x, y = await self._middle(element)
                await self.value(f"({GUARD})(document.elementFromPoint({x}, {y}))")
                for kind in ("mousePressed", "mouseReleased"):
                    await self.ask(
                        "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1
                    )
                try:
                    if not await self.value(MISSED):
                        return
                except Gone:
                    return

    async def tap(self, selector: str) -> None:
        """Tap the middle of an element with one finger."""
        x, y = await self.middle(selector)
        await self.ask("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
        await self.ask("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    async def wheel(self, selector: str, delta: float) -> None:
        """Turn the wheel over the middle of an element; negative: away from the person."""
        x, y = await self.middle(selector)
        await self.ask("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=delta)

    async def pinch(self, selector: str, apart_px: tuple[float, float]) -> None:
        """Pinch with two fingers around the middle of an element, from one distance to another."""
        x, y = await self.middle(selector)
        await self.ask("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
        for kind, apart in (("touchStart", apart_px[0]), ("touchMove", apart_px[1])):
            points = [{"x": x + sign * apart / 2, "y": y, "id": n} for n, sign in enumerate((-1, 1))]
            await self.ask("Input.dispatchTouchEvent", type=kind, touchPoints=points)
        await self.ask("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        await self.ask("Emulation.setTouchEmulationEnabled", enabled=False)

    async def middle(self, selector: str) -> tuple[float, float]:
        """Middle of an element, scrolled into view, once the layout around it has come to rest."""
        return await self._middle(f"document.querySelector({json.dumps(selector)})")

    async def _middle(self, element: str) -> tuple[float, float]:
        await self.until(element)
        x, y = await self.value(
            f"""(async () => {{
              let e = null;
              const middle = () => {{
                e = {element} ?? e;
                e.scrollIntoView({{block: "center", inline: "center"}});
                const b = e.getBoundingClientRect();
                return [b.x + b.width / 2, b.y + b.height / 2];
              }};
              for (let now = middle(), last = null; ; [last, now] = [now, middle()]) {{
                if (last && last.every((value, i) => value === now[i])) return now;
                await new Promise((done) => setTimeout(done, {REST_MS}));
              }}
            }})()"""
        )
        return float(x), float(y)

    async def type(self, selector: str, text: str) -> None:
        """Type into a field, as a person would, and leave it."""
        await self.click(selector)
        await self.value(f"document.querySelector({json.dumps(selector)}).select()")
        await self.ask("Input.insertText", text=text)
        await self.value(f"document.querySelector({json.dumps(selector)}).blur()")

    async def choose(self, selector: str, value: str) -> None:
        """Choose an entry of a list, as a click would."""
        await self.value(
            f"""{{ const list = document.querySelector({json.dumps(selector)});
            list.value = {json.dumps(value)};
            list.dispatchEvent(new Event("change", {{ bubbles: true }})); }}"""
        )

    async def violations(self) -> list[str]:
        """Accessibility violations that axe-core finds: rule and place of each."""
        if not await self.value("Boolean(window.axe)"):
            await self.ask("Runtime.evaluate", expression=AXE.read_text())
        return list(
            await self.value(
                "axe.run({rules: {'label-content-name-mismatch': {enabled: true}}}).then(("
                "{violations}) => violations.flatMap(({id, nodes}) => "
                "nodes.map(({target, failureSummary}) => `${id} ${target}: ${failureSummary}`)))"
            )
        )

    async def picture(self) -> bytes:
        """Screenshot, PNG."""
        return base64.b64decode((await self.ask("Page.captureScreenshot", format="png"))["data"])


@cache
def _chromium() -> Path:
    """Start one Chromium for all tests of a process, ended with it; returns the file with its address."""
    profile = Path(tempfile.mkdtemp(prefix="edged-chromium-"))
    process = subprocess.Popen(
        [
            *("chromium", "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0"),
            *(f"--user-data-dir={profile}", "about:blank"),
        ],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )

    def end() -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        shutil.rmtree(profile, ignore_errors=True)

    atexit.register(end)
    return profile / "DevToolsActivePort"


@asynccontextmanager
async def browser() -> AsyncIterator[Browser]:
    """An empty page with its own cookies, storage and cache, which are discarded at the end."""
    told = _chromium()
    await until(lambda: told.exists() and len(told.read_text().split()) == 2)
    port, path = told.read_text().split()
    origin = f"ws://127.0.0.1:{port}"
    async with aiohttp.ClientSession() as session, session.ws_connect(origin + path) as all_pages:
        chromium = Browser(all_pages)
        person = await chromium.ask("Target.createBrowserContext", disposeOnDetach=True)
        size = {"width": 1280, "height": 900, "newWindow": True}
        target = (await chromium.ask("Target.createTarget", url="about:blank", **size, **person))["targetId"]
        async with session.ws_connect(f"{origin}/devtools/page/{target}", max_msg_size=0) as devtools:
            page = Browser(devtools)
            await page.ask("Emulation.setFocusEmulationEnabled", enabled=True)  # if several pages
            yield page
        await chromium.ask("Target.disposeBrowserContext", **person)
