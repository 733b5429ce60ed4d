"""WebKit for tests, the engine of every iPad: WebKitGTK's browser over WebDriver, on a display of its own.

It accepts the commands of Chromium's protocol that tests send. It tells nothing of a page's console.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp

from helpers.browser import Browser, Gone, keys_of, pointer_of
from helpers.ports import answers, free_port
from helpers.waiting import until

DRIVER, DISPLAY = "WebKitWebDriver", "xvfb-run"
PAGES = sorted(Path("/usr/lib").glob("*/webkit*gtk-*/MiniBrowser"))
IS_HERE = bool(shutil.which(DRIVER) and shutil.which(DISPLAY) and PAGES)
LEFT = {"no such frame", "no such window", "stale element reference"}
"""Errors of a command whose page was left meanwhile, among others."""


class WebKit(Browser):
    """One page of WebKit. session : address of its WebDriver session."""

    def __init__(self, client: aiohttp.ClientSession, session: str) -> None:
        super().__init__(None)  # type: ignore[arg-type]  # there is no socket
        self._client, self._session = client, session

    async def _ask(self, method: str, parameters: dict[str, Any]) -> dict[str, Any]:
        """Translate a command of Chromium's protocol to WebDriver. Raises `KeyError` for any other."""
        match method:
            case "Log.enable" | "Runtime.enable" | "Page.enable":
                return {}
            case "Page.navigate":
                await self._command("url", url=parameters["url"])
                return {}
            case "Emulation.setDeviceMetricsOverride":
                await self._resize(parameters["width"], parameters["height"])
                return {}
            case "Page.captureScreenshot":
                return {"data": await self._command("screenshot")}
            case "Runtime.evaluate":
                return await self._evaluate(parameters["expression"])
            case "Input.insertText":
                return await self._act(keys_of(parameters["text"]))
            case "Input.dispatchMouseEvent":
                return await self._act(pointer_of(parameters))
        raise KeyError(method)

    async def _resize(self, width: int, height: int) -> None:
        """Give the page itself this size: the window has a bar, too."""
        wide, high = await self._value("[innerWidth, innerHeight]")
        rect = await self._command("window/rect")
        await self._command(
            "window/rect", width=rect["width"] - wide + width, height=rect["height"] - high + height
        )

    async def _act(self, source: dict[str, Any]) -> dict[str, Any]:
        await self._command("actions", actions=[source])
        return {}

    async def _evaluate(self, expression: str) -> dict[str, Any]:
        if expression.startswith("{") or expression.endswith(";"):  # statements, without a value
            expression = f"(() => {{{expression}}})()"
        script = f"""
          const done = arguments[arguments.length - 1];
          (async () => ({expression}))().then(
            (value) => done({{ value: value === undefined ? null : value }}),
            (error) => done({{ error: String(error) }}));"""
        answer = await self._command("execute/async", script=script, args=[])
        if "error" in answer:
            return {"exceptionDetails": answer["error"]}
        return {"result": answer}

    async def _value(self, expression: str) -> Any:
        return (await self._evaluate(expression))["result"]["value"]

    async def _command(self, path: str, **parameters: Any) -> Any:
        is_asked = not parameters and path in ("screenshot", "window/rect")
        asking = self._client.get if is_asked else self._client.post
        async with asking(f"{self._session}/{path}", **({} if is_asked else {"json": parameters})) as answer:
            value = (await answer.json())["value"]
        if answer.status != 200:
            raise (Gone if value["error"] in LEFT else RuntimeError)(
                f"{path}: {value['error']} {value['message']}"
            )
        return value


@asynccontextmanager
async def webkit() -> AsyncIterator[WebKit]:
    """An empty page of a new WebKit."""
    port = free_port()
    process = await asyncio.create_subprocess_exec(
        *(DISPLAY, "-a", "-s", "-screen 0 1600x1400x24", DRIVER, f"--port={port}"),
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        await until(lambda: answers(port))
        options = {"binary": str(PAGES[0]), "args": ["--automation"]}
        wanted = {"capabilities": {"alwaysMatch": {"webkitgtk:browserOptions": options}}}
        async with aiohttp.ClientSession(f"http://127.0.0.1:{port}") as client:
            async with client.post("/session", json=wanted) as answer:
                session = (await answer.json())["value"]["sessionId"]
            try:
                yield WebKit(client, f"/session/{session}")
            finally:
                async with client.delete(f"/session/{session}"):
                    pass
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)  # xvfb-run, the display, and what runs on it
        await process.wait()
