"""Who may look: one password, sessions in memory, and a limit on guessing.

The password is stored as an Argon2 hash (`edged password`). A session is a random cookie; Prometheus may
send the password with each request (HTTP Basic, any user). Everything is forgotten at a restart.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import hashlib
import hmac
import secrets
import time
from collections.abc import Callable

from argon2 import PasswordHasher
from argon2.exceptions import Argon2Error, InvalidHashError

SESSION_S = 12 * 3600.0
MAX_SESSIONS = 64
FREE_ATTEMPTS = 5
LOCKED_S = 30.0
MAX_REMEMBERED = 1024


def hash_password(password: str) -> str:
    """The hash for the configuration."""
    return PasswordHasher().hash(password)


class TooManyAttempts(Exception):
    """Somebody guesses: `wait_s` until the next attempt."""

    def __init__(self, wait_s: float) -> None:
        self.wait_s = wait_s
        super().__init__(f"wait {wait_s:.0f} s")


class Access:
    """Decides for one server. password_hash "" : everybody may look."""

    def __init__(self, password_hash: str, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._hash = password_hash
        self._clock_s = clock_s
        self._sessions: dict[str, float] = {}
        self._failures: dict[str, tuple[int, float]] = {}
        self._known = b""
        self._verifying = asyncio.Lock()

    @property
    def is_open(self) -> bool:
        """No password is asked for."""
        return not self._hash

    def has_session(self, cookie: str) -> bool:
        """Whether the cookie belongs to a session that is still good."""
        return self._sessions.get(_digest(cookie), 0.0) > self._clock_s()

    async def log_in(self, address: str, password: str) -> str | None:
        """A new session's cookie, or None for a wrong password. Raises `TooManyAttempts`."""
        if not await self._is_password(address, password):
            return None
        now_s = self._clock_s()
        self._sessions = {key: end_s for key, end_s in self._sessions.items() if end_s > now_s}
        while len(self._sessions) >= MAX_SESSIONS:
            del self._sessions[next(iter(self._sessions))]
        cookie = secrets.token_urlsafe(32)
        self._sessions[_digest(cookie)] = now_s + SESSION_S
        return cookie

    def log_out(self, cookie: str) -> None:
        """Forget a session."""
        self._sessions.pop(_digest(cookie), None)

    async def has_basic(self, address: str, header: str) -> bool:
        """Whether an Authorization header holds the password. Raises `TooManyAttempts`."""
        scheme, _, value = header.partition(" ")
        if scheme.lower() != "basic":
            return False
        try:
            _, _, password = base64.b64decode(value, validate=True).decode().partition(":")
        except (binascii.Error, UnicodeDecodeError):
            return False
        return await self._is_password(address, password)

    async def _is_password(self, address: str, password: str) -> bool:
        # a scraper comes every few seconds: the slow hash is computed for the first time only
        digest = hashlib.sha256(password.encode()).digest()
        if self._known and hmac.compare_digest(self._known, digest):
            return True
        count, locked_until_s = self._failures.get(address, (0, 0.0))
        if count >= FREE_ATTEMPTS and self._clock_s() < locked_until_s:
            raise TooManyAttempts(locked_until_s - self._clock_s())
        async with self._verifying:  # one at a time: guessing must not cost the cell its cores
            good = await asyncio.to_thread(_verify, self._hash, password)
        if good:
            self._known = digest
            self._failures.pop(address, None)
            return True
        while len(self._failures) >= MAX_REMEMBERED:
            del self._failures[next(iter(self._failures))]
        self._failures[address] = (count + 1, self._clock_s() + LOCKED_S)
        return False


def _verify(password_hash: str, password: str) -> bool:
    try:
        return PasswordHasher().verify(password_hash, password)
    except (Argon2Error, InvalidHashError):
        return False


def _digest(cookie: str) -> str:
    """Sessions are kept by digest: comparing them tells nothing of the cookie."""
    return hashlib.sha256(cookie.encode()).hexdigest()
