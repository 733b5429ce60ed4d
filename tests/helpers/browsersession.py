"""A browser's session with a cell over HTTP: it logs in, and asks."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

import aiohttp
from yarl import URL

from edged.app.daemon import Daemon

PASSWORD = "correct horse"
"""Of everybody in the tests."""
POLL_S = 0.02


def browsing(origin: str) -> aiohttp.ClientSession:
    """A session that keeps cookies of an IP address."""
    return aiohttp.ClientSession(origin, cookie_jar=aiohttp.CookieJar(unsafe=True))


class BrowserSession:
    """A browser that logs in and asks."""

    def __init__(self, session: aiohttp.ClientSession) -> None:
        self.session = session
        self.origin = str(session._base_url).rstrip("/")  # noqa: SLF001  (what the browser would send)

    async def ask(self, method: str, path: str, document: Any = None, **headers: str) -> tuple[int, Any]:
        """Status and answer, as the page asks: of JSON, else bytes; None of nothing."""
        sent = {"Origin": self.origin, **headers}
        async with self.session.request(method, path, json=document, headers=sent) as answer:
            is_json = answer.content_type.endswith("json")
            return answer.status, await answer.json() if is_json else await answer.read() or None

    async def log_in(self, name: str = "Anna") -> None:
        """With the form; "" with the page's password alone, which makes a viewer."""
        assert await self.comes_in(name)

    async def comes_in(self, name: str, password: str = PASSWORD) -> bool:
        """Whether somebody can log in."""
        form = {"name": name, "password": password}
        async with self.session.post(
            "/login", data=form, headers={"Origin": self.origin}, allow_redirects=False
        ) as answer:
            return answer.headers.get("Location") == "/"

    async def log_in_once_it_listens(self, name: str, password: str, is_running: Callable[[], bool]) -> None:
        """To a cell that is starting. is_running : false once it has ended instead."""
        while True:
            try:
                assert await self.comes_in(name, password)
                return
            except aiohttp.ClientConnectionError:
                assert is_running(), "it ended before it listened"
                await asyncio.sleep(POLL_S)

    async def reload(self, daemon: Daemon) -> None:
        """Let a daemon read its configuration again, and wait until its page has heard of it."""
        assert await daemon.reload()
        while True:
            _, told = await self.ask("GET", "/status.json")
            if told["facts"]["Software"]["configuration"] == daemon.loaded.setup.fingerprint:
                return
            await asyncio.sleep(POLL_S)

    def cookies(self) -> dict[str, str]:
        """Of the session that is used now."""
        return {cookie.key: cookie.value for cookie in self.session.cookie_jar}

    async def log_in_anew(self, name: str) -> dict[str, str]:
        """Another session of somebody, which is used from now on; its cookies."""
        self.session.cookie_jar.clear()
        await self.log_in(name)
        return self.cookies()

    def use(self, cookies: Mapping[str, str]) -> None:
        """Another session from now on."""
        self.session.cookie_jar.clear()
        self.session.cookie_jar.update_cookies(cookies, URL(self.origin))


class Visitor:
    """Somebody who sets a cell up, and whose requests are taken as they say. token : of who has the cell."""

    def __init__(self, browser: BrowserSession) -> None:
        self.browser, self.session, self.origin = browser, browser.session, browser.origin
        self.token: dict[str, str] = {}

    async def ask(self, method: str, path: str, document: Any = None, expected: int = 200) -> Any:
        """The answer below /api/v1/."""
        status, body = await self.browser.ask(method, f"/api/v1/{path}", document)
        assert expected == status, body
        return body

    async def until(self, path: str, condition: Callable[[Any], object]) -> Any:
        """The first answer that fulfils a condition."""
        while True:
            document = await self.ask("GET", path)
            if condition(document):
                return document
            await asyncio.sleep(POLL_S)

    async def take(self) -> None:
        """The cell, whoever had it before."""
        self.token = await self.ask("POST", "setup", {"take_over": True}, 201)
