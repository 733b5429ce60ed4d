"""Firefox for tests, over WebDriver BiDi: it accepts the commands of Chromium's protocol that tests send."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import aiohttp

from helpers.browser import Browser, Gone, keys_of, pointer_of
from helpers.waiting import WHOLE_S

PROGRAM = "firefox-esr"
LEFT = re.compile(r"The connection to \S+ was interrupted while the page was loading\.")
"""Firefox's message for a socket or event stream that ends with its page: not an error of the page."""
AT = re.compile(rb"WebDriver BiDi listening on (ws://\S+)")


class Firefox(Browser):
    """One Firefox page."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        super().__init__(socket)
        self._socket, self._count, self._context = socket, 0, ""

    async def begin(self) -> None:
        """Open a session and subscribe to its console."""
        await self._command("session.new", capabilities={})
        tree = await self._command("browsingContext.getTree")
        self._context = tree["contexts"][0]["context"]
        await self._command("session.subscribe", events=["log.entryAdded"])

    async def _ask(self, method: str, parameters: dict[str, Any]) -> dict[str, Any]:
        """Translate a command of Chromium's protocol to BiDi. Raises `KeyError` for any other."""
        context = {"context": self._context}
        match method:
            case "Log.enable" | "Runtime.enable" | "Page.enable":
                return {}
            case "Page.navigate":
                return await self._command("browsingContext.navigate", **context, **parameters)
            case "Emulation.setDeviceMetricsOverride":
                size = {name: parameters[name] for name in ("width", "height")}
                return await self._command("browsingContext.setViewport", **context, viewport=size)
            case "Page.captureScreenshot":
                return await self._command("browsingContext.captureScreenshot", **context)
            case "Runtime.evaluate":
                return await self._evaluate(parameters["expression"])
            case "Input.insertText":
                return await self._act(keys_of(parameters["text"]))
            case "Input.dispatchMouseEvent":
                return await self._act(pointer_of(parameters))
        raise KeyError(method)

    async def _act(self, source: dict[str, Any]) -> dict[str, Any]:
        return await self._command("input.performActions", context=self._context, actions=[source])

    async def _evaluate(self, expression: str) -> dict[str, Any]:
        answer = await self._command(
            "script.evaluate",
            expression=expression,
            target={"context": self._context},
            awaitPromise=True,
            serializationOptions={"maxObjectDepth": 9},
        )
        if answer["type"] == "exception":
            return {"exceptionDetails": answer["exceptionDetails"]["text"]}
        return {"result": {"value": _plain(answer["result"])}}

    async def _command(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._count += 1
        await self._socket.send_json({"id": self._count, "method": method, "params": parameters})
        while True:
            message = json.loads((await self._socket.receive()).data)
            if message.get("method") == "log.entryAdded" and message["params"]["level"] == "error":
                text = str(message["params"]["text"])
                self.complaints += [] if LEFT.fullmatch(text) else [text]
            elif message.get("id") == self._count:
                if message["type"] == "error":
                    raise Gone(f"{method}: {message['message']}")
                return dict(message["result"])


def _plain(told: dict[str, Any]) -> Any:
    """A value of the page as JSON; None if JSON cannot express it."""
    match told["type"]:
        case "array":
            return [_plain(item) for item in told["value"]]
        case "object":
            return {name: _plain(item) for name, item in told["value"]}
        case "string" | "number" | "boolean":
            return told["value"]
    return None


@asynccontextmanager
async def firefox() -> AsyncIterator[Firefox]:
    """An empty page of a new Firefox."""
    with tempfile.TemporaryDirectory(prefix="edged-firefox-", ignore_cleanup_errors=True) as profile:
        process = await asyncio.create_subprocess_exec(
            *(PROGRAM, "--headless", "--remote-debugging-port=0", "--profile", profile, "about:blank"),
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
        )
        try:
            async with asyncio.timeout(WHOLE_S):
                assert process.stderr is not None
                while not (found := AT.search(await process.stderr.readline())):
                    assert not process.stderr.at_eof(), "firefox ended"
            address = f"{found[1].decode()}/session"
            async with (
                aiohttp.ClientSession() as session,
                session.ws_connect(address, max_msg_size=0) as socket,
            ):
                page = Firefox(socket)
                await page.begin()
                yield page
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.communicate()
