"""A browser's HTTP session with a cell: it logs in and makes requests."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

import aiohttp
from yarl import URL

from edged.app.daemon import Daemon

PASSWORD = "correct horse"
"""Password of every user in the tests."""
POLL_S = 0.02


def browsing(origin: str) -> aiohttp.ClientSession:
    """HTTP session that also keeps cookies of an IP address."""
    return aiohttp.ClientSession(origin, cookie_jar=aiohttp.CookieJar(unsafe=True))


class BrowserSession:
    """A browser session that logs in and makes requests."""

    def __init__(self, session: aiohttp.ClientSession) -> None:
        self.session = session
        self.origin = str(session._base_url).rstrip("/")  # noqa: SLF001  (what the browser would send)

    async def ask(self, method: str, path: str, document: Any = None, **headers: str) -> tuple[int, Any]:
        """Status and answer of a request made as the page makes it: parsed JSON, bytes, or None if empty."""
        sent = {"Origin": self.origin, **headers}
        async with self.session.request(method, path, json=document, headers=sent) as answer:
            is_json = answer.content_type.endswith("json")
            return answer.status, await answer.json() if is_json else await answer.read() or None

    async def log_in(self, name: str = "Anna") -> None:
        """Log in with the form; name "" uses the page's password alone, which grants the viewer role."""
        assert await self.comes_in(name)

    async def comes_in(self, name: str, password: str = PASSWORD) -> bool:
        """Whether logging in with this name and password succeeds."""
        form = {"name": name, "password": password}
        async with self.session.post(
            "/login", data=form, headers={"Origin": self.origin}, allow_redirects=False
        ) as answer:
            return answer.headers.get("Location") == "/"

    async def log_in_once_it_listens(self, name: str, password: str, is_running: Callable[[], bool]) -> None:
        """Log in to a cell that is starting. is_running : false once it has ended instead."""
        while True:
            try:
                assert await self.comes_in(name, password)
                return
            except aiohttp.ClientConnectionError:
                assert is_running(), "it ended before it listened"
                await asyncio.sleep(POLL_S)

    async def reload(self, daemon: Daemon) -> None:
        """Make the daemon reload its configuration, and wait until its page shows the new one."""
        assert await daemon.reload()
        while True:
            _, told = await self.ask("GET", "/status.json")
            if told["facts"]["Software"]["configuration"] == daemon.loaded.setup.fingerprint:
                return
            await asyncio.sleep(POLL_S)

    def cookies(self) -> dict[str, str]:
        """Cookies of the current session."""
        return {cookie.key: cookie.value for cookie in self.session.cookie_jar}

    async def log_in_anew(self, name: str) -> dict[str, str]:
        """Start another session for a user and switch to it; returns its cookies."""
        self.session.cookie_jar.clear()
        await self.log_in(name)
        return self.cookies()

    def use(self, cookies: Mapping[str, str]) -> None:
        """Switch to the session with these cookies."""
        self.session.cookie_jar.clear()
        self.session.cookie_jar.update_cookies(cookies, URL(self.origin))


class Visitor:
    """A user who sets up a cell, with checked request outcomes. token : of the current lease."""

    def __init__(self, browser: BrowserSession) -> None:
        self.browser, self.session, self.origin = browser, browser.session, browser.origin
        self.token: dict[str, str] = {}

    async def ask(self, method: str, path: str, document: Any = None, expected: int = 200) -> Any:
        """Make a request below /api/v1/, check its status and return the answer."""
        status, body = await self.browser.ask(method, f"/api/v1/{path}", document)
        assert expected == status, body
        return body

    async def until(self, path: str, condition: Callable[[Any], object]) -> Any:
        """Poll until the answer fulfils the condition, and return it."""
        while True:
            document = await self.ask("GET", path)
            if condition(document):
                return document
            await asyncio.sleep(POLL_S)

    async def take(self) -> None:
        """Take over the cell, whoever holds it."""
        self.token = await self.ask("POST", "setup", {"take_over": True}, 201)
