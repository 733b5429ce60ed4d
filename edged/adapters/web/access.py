"""Who may look: one password, sessions in memory, and a limit on guessing.

The password is stored as a hash (`edged.passwords`). A session is a random cookie; Prometheus may
send the password with each request (HTTP Basic, any user). Everything is forgotten at a restart.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import math
import secrets
import time
from collections.abc import Callable

from edged.passwords import is_password

SESSION_S = 12 * 3600.0
MAX_SESSIONS = 64
FREE_ATTEMPTS = 5
LOCKED_S = 30.0
MAX_REMEMBERED = 1024
BUSY_S = 1.0
"""When to come again while another password is checked, which takes a few tenths of it."""


class TooManyAttempts(Exception):
    """Somebody guesses, or another password is being checked: `wait_s` until the next attempt."""

    def __init__(self, why: str, wait_s: float) -> None:
        self.wait_s = wait_s
        super().__init__(f"{why}, wait {math.ceil(wait_s)} s")


class Access:
    """Decides for one server. password_hash "" : everybody may look."""

    def __init__(self, password_hash: str, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._hash = password_hash
        self._clock_s = clock_s
        self._sessions: dict[str, float] = {}
        self._failures: dict[str, tuple[int, float]] = {}
        self._known = b""
        self._check: asyncio.Future[bool] | None = None

    @property
    def is_open(self) -> bool:
        """No password is asked for."""
        return not self._hash

    def has_session(self, cookie: str) -> bool:
        """Whether the cookie belongs to a session that is still good."""
        return self._sessions.get(session_of(cookie), 0.0) > self._clock_s()

    async def log_in(self, address: str, password: str) -> str | None:
        """A new session's cookie, or None for a wrong password. Raises `TooManyAttempts`."""
        if not await self._is_password(address, password):
            return None
        now_s = self._clock_s()
        self._sessions = {key: end_s for key, end_s in self._sessions.items() if end_s > now_s}
        while len(self._sessions) >= MAX_SESSIONS:
            del self._sessions[next(iter(self._sessions))]
        cookie = secrets.token_urlsafe(32)
        self._sessions[session_of(cookie)] = now_s + SESSION_S
        return cookie

    def log_out(self, cookie: str) -> None:
        """Forget a session."""
        self._sessions.pop(session_of(cookie), None)

    async def has_basic(self, address: str, header: str) -> bool:
        """Whether an Authorization header holds the password. Raises `TooManyAttempts`."""
        scheme, _, value = header.partition(" ")
        if scheme.lower() != "basic":
            return False
        try:
            _, _, password = base64.b64decode(value, validate=True).decode().partition(":")
        except ValueError:  # no ASCII, no base64, no UTF-8
            return False
        return await self._is_password(address, password)

    async def _is_password(self, address: str, password: str) -> bool:
        # a scraper comes every few seconds: the slow hash is computed for the first time only
        digest = hashlib.sha256(password.encode()).digest()
        if self._known and hmac.compare_digest(self._known, digest):
            return True
        count, locked_until_s = self._failures.get(address, (0, 0.0))
        if count >= FREE_ATTEMPTS and self._clock_s() < locked_until_s:
            raise TooManyAttempts("too many wrong passwords", locked_until_s - self._clock_s())
        # one at a time, and nobody queues: guessing must not cost the cell its cores, or its memory
        if self._check is not None and not self._check.done():
            raise TooManyAttempts("another password is being checked", BUSY_S)
        self._note_failure(address, count + 1)  # before the check: who breaks it off has had it
        self._check = asyncio.get_running_loop().run_in_executor(None, is_password, self._hash, password)
        # its thread cannot be stopped: whoever hangs up, it is under way until it ends
        if not await asyncio.shield(self._check):
            return False
        self._known = digest
        self._failures.pop(address, None)
        return True

    def _note_failure(self, address: str, count: int) -> None:
        while len(self._failures) >= MAX_REMEMBERED and address not in self._failures:
            del self._failures[next(iter(self._failures))]
        self._failures[address] = (count, self._clock_s() + LOCKED_S)


def session_of(cookie: str) -> str:
    """The digest of a cookie, by which its session is kept: comparing them tells nothing of the cookie."""
    # a header may hold any bytes, which aiohttp hands on as surrogates
    return hashlib.sha256(cookie.encode("utf-8", "surrogateescape")).hexdigest()
