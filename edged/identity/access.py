"""Who may look and who may do more: passwords, sessions in memory, and a limit on guessing.

Passwords are stored as hashes (`edged.identity.passwords`): one for the page, with which one may look; and
those of users, each with a role. A session is a random cookie; Prometheus may send the page's password with
each request (HTTP Basic, any user). Sessions are forgotten at a restart.
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
from dataclasses import dataclass, replace
from functools import cache, partial

from edged.errors import FileFormatError
from edged.identity.invite import Invite
from edged.identity.passwords import hash_password, is_password
from edged.identity.users import User, UserFile
from edged.identity.visitors import Role, Visitor

SESSION_S = 12 * 3600.0
IDLE_S = 600.0
"""Without a sign of them for so long an engineer may only look: the panel stands beside the cell."""
MAX_SESSIONS = 64
FREE_ATTEMPTS = 5
LOCKED_S = 30.0
MAX_REMEMBERED = 1024
BUSY_S = 1.0
"""Retry after this while another password is checked, which takes a few tenths of it."""


class TooManyAttempts(Exception):
    """Somebody guesses, or another password is being checked: `wait_s` until the next attempt."""

    def __init__(self, why: str, wait_s: float) -> None:
        self.wait_s = wait_s
        super().__init__(f"{why}, wait {math.ceil(wait_s)} s")


@dataclass(frozen=True, slots=True)
class _Session:
    """user : "" with the page's password alone. active_s : when a person did something last."""

    user: str
    until_s: float
    active_s: float


class Access:
    """Log-in, sessions and password checks of one server.

    password_hash : of the page; "" : everybody may look. users, invite : None: there are none.
    """

    def __init__(
        self,
        password_hash: str,
        clock_s: Callable[[], float] = time.monotonic,
        *,
        users: UserFile | None = None,
        invite: Invite | None = None,
    ) -> None:
        self._hash = password_hash
        self._clock_s = clock_s
        self._users = users
        self._invite = invite
        self._sessions: dict[str, _Session] = {}
        self._failures: dict[str, tuple[int, float]] = {}
        self._known = b""
        self._check: asyncio.Future[bool] | asyncio.Future[str] | None = None

    @property
    def is_open(self) -> bool:
        """No password is asked for to look."""
        return not self._hash

    # --- sessions ----------------------------------------------------------------------------

    def visitor(self, cookie: str, address: str) -> Visitor | None:
        """The session of a cookie; None where it is invalid or has ended."""
        digest = session_of(cookie)
        session, now_s = self._sessions.get(digest), self._clock_s()
        if session is None or session.until_s <= now_s:
            return None
        if not session.user:
            return Visitor("", Role.VIEWER, address, digest)
        user = self._user(session.user)
        if user is None:  # taken out meanwhile
            return None
        role = Role[user.role.upper()]
        is_idle = role is Role.ENGINEER and now_s - session.active_s >= IDLE_S
        return Visitor(user.name, Role.VIEWER if is_idle else role, address, digest, user.language, is_idle)

    def note_activity(self, session: str) -> None:
        """Note that a person did something; a session that was idle too long needs the password instead."""
        found, now_s = self._sessions.get(session), self._clock_s()
        if found is not None and now_s - found.active_s < IDLE_S:
            self._sessions[session] = replace(found, active_s=now_s)

    async def log_in(self, address: str, password: str, name: str = "") -> str | None:
        """A new session's cookie, or None for a wrong password. Raises `TooManyAttempts`.

        name : of a user; "" with the page's password.
        """
        if name:
            known = await self.is_user(address, name, password)
        else:
            known = bool(self._hash) and await self._is_password(address, password)
        return self._open(name) if known else None

    async def is_user(self, address: str, name: str, password: str) -> bool:
        """Whether it is that user's password. Raises `TooManyAttempts`."""
        user = self._user(name)
        stored = user.password_hash if user is not None else None
        # who is not there takes as long: names are not to be guessed by the clock
        return await self._guarded(
            address, lambda: is_password(stored or _nobodys(), password) and stored is not None
        )

    async def wake(self, address: str, visitor: Visitor, password: str) -> bool:
        """Give a session that was idle its rights again; False for a wrong password."""
        session = self._sessions.get(visitor.session)
        if session is None or not await self.is_user(address, session.user, password):
            return False
        self._sessions[visitor.session] = replace(session, active_s=self._clock_s())
        return True

    async def redeem(self, address: str, code: str, name: str, password: str) -> str | None:
        """Make an engineer by a code; their session's cookie, or None for a wrong one.

        Raises `TooManyAttempts`, `FileFormatError`, `OSError`.
        """
        users, invite = self._users, self._invite
        if users is None or invite is None:
            return None
        if users.problem:  # before the code is used up
            raise FileFormatError(users.problem)
        if not await self._guarded(address, partial(invite.take, code)):
            return None
        user = User(name=name, role="engineer", password_hash=await self.hash(password))
        await asyncio.to_thread(users.put, user)
        self.end_sessions(name)
        return self._open(name)

    def log_out(self, cookie: str) -> None:
        """Forget a session."""
        self._sessions.pop(session_of(cookie), None)

    def end_sessions(self, name: str, but: str = "") -> None:
        """End the sessions of a user, after a new password for example; but : except this one."""
        self._sessions = {
            digest: session
            for digest, session in self._sessions.items()
            if session.user.casefold() != name.casefold() or digest == but
        }

    async def has_basic(self, address: str, header: str) -> bool:
        """Whether an Authorization header holds the page's password. Raises `TooManyAttempts`."""
        scheme, _, value = header.partition(" ")
        if scheme.lower() != "basic":
            return False
        try:
            _, _, password = base64.b64decode(value, validate=True).decode().partition(":")
        except ValueError:  # no ASCII, no base64, no UTF-8
            return False
        return await self._is_password(address, password)

    # --- passwords ---------------------------------------------------------------------------

    async def hash(self, password: str) -> str:
        """Hash of a user's password. Raises `TooManyAttempts` while another password is being hashed."""
        self._check_is_free()
        check = asyncio.get_running_loop().run_in_executor(None, hash_password, password)
        self._check = check
        return await asyncio.shield(check)

    async def _is_password(self, address: str, password: str) -> bool:
        # a scraper comes every few seconds: the slow hash is computed for the first time only
        digest = hashlib.sha256(password.encode()).digest()
        if self._known and hmac.compare_digest(self._known, digest):
            return True
        if not await self._guarded(address, partial(is_password, self._hash, password)):
            return False
        self._known = digest
        return True

    async def _guarded(self, address: str, is_right: Callable[[], bool]) -> bool:
        """Check a password in a thread, unless this address guesses. Raises `TooManyAttempts`."""
        count, locked_until_s = self._failures.get(address, (0, 0.0))
        if count >= FREE_ATTEMPTS and self._clock_s() < locked_until_s:
            raise TooManyAttempts("too many wrong passwords", locked_until_s - self._clock_s())
        self._check_is_free()
        self._note_failure(address, count + 1)  # before the check: who breaks it off has had it
        check = asyncio.get_running_loop().run_in_executor(None, is_right)
        self._check = check
        # its thread cannot be stopped: after a disconnect, too, it is under way until it ends
        if not await asyncio.shield(check):
            return False
        self._failures.pop(address, None)
        return True

    def _check_is_free(self) -> None:
        # one at a time, and nobody queues: guessing must not cost the cell its cores, or its memory
        if self._check is not None and not self._check.done():
            raise TooManyAttempts("another password is being checked", BUSY_S)

    def _note_failure(self, address: str, count: int) -> None:
        while len(self._failures) >= MAX_REMEMBERED and address not in self._failures:
            del self._failures[next(iter(self._failures))]
        self._failures[address] = (count, self._clock_s() + LOCKED_S)

    def _user(self, name: str) -> User | None:
        return None if self._users is None else self._users.get(name)

    def _open(self, name: str) -> str:
        now_s = self._clock_s()
        self._sessions = {key: session for key, session in self._sessions.items() if session.until_s > now_s}
        while len(self._sessions) >= MAX_SESSIONS:
            del self._sessions[next(iter(self._sessions))]
        cookie = secrets.token_urlsafe(32)
        self._sessions[session_of(cookie)] = _Session(name, now_s + SESSION_S, now_s)
        return cookie


@cache
def _nobodys() -> str:
    """The hash of a password that nobody has."""
    return hash_password(secrets.token_urlsafe(32))


def session_of(cookie: str) -> str:
    """The digest of a cookie, by which its session is kept: comparing them tells nothing of the cookie."""
    # a header may hold any bytes, which aiohttp hands on as surrogates
    return hashlib.sha256(cookie.encode("utf-8", "surrogateescape")).hexdigest()
