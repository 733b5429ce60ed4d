"""Access control of one server: passwords, sessions, invitations.

Passwords are stored as hashes (`edged.identity.passwords`): one for the page, which grants viewing only; one,
the token, for the metrics alone; and those of users, each with a role. Prometheus sends the token with each
request (Bearer), or the page's password (HTTP Basic, any user). Sessions are lost at a restart.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import secrets
import time
from collections.abc import Callable
from functools import cache, partial

from edged.errors import FileFormatError
from edged.identity.attempts import Attempts
from edged.identity.invite import Invite
from edged.identity.passwords import hash_password, is_password
from edged.identity.sessions import Session, Sessions, session_of
from edged.identity.users import User, UserFile, key_of
from edged.identity.visitors import Role, Visitor

PAGE, METRICS = "page", "metrics"
"""Accounts with a shared password, that belong to no user."""
INVITATION = ""
"""Account of invitation codes, never locked: nobody guesses 59 bits, and nobody may keep others out."""


class Access:
    """Log-in, sessions and password checks of one server.

    cookie : name of the session cookie.
    password_hash : of the page; "" : everybody may view it. metrics_hash : of the token for the metrics; "" :
    there is none. users, invite : None: there are none.
    """

    def __init__(
        self,
        password_hash: str,
        clock_s: Callable[[], float] = time.monotonic,
        *,
        cookie: str = "edged",
        metrics_hash: str = "",
        users: UserFile | None = None,
        invite: Invite | None = None,
    ) -> None:
        self.cookie = cookie
        self._hashes = {PAGE: password_hash, METRICS: metrics_hash}
        self._clock_s = clock_s
        self._users = users
        self._invite = invite
        self._sessions = Sessions(clock_s)
        self._attempts = Attempts(clock_s)
        self._known: dict[str, bytes] = {}

    @property
    def is_open(self) -> bool:
        """Whether the page can be viewed without a password."""
        return not self._hashes[PAGE]

    # --- sessions ----------------------------------------------------------------------------

    def visitor(self, cookie: str, address: str) -> Visitor | None:
        """Visitor with the session of a cookie; None if the session is invalid or has ended."""
        digest = session_of(cookie)
        session = self._sessions.get(digest)
        if session is None:
            return None
        if not session.user:
            return Visitor("", Role.VIEWER, address, digest)
        user = self._user(session.user)
        if user is None:  # removed meanwhile
            return None
        role = Role[user.role.upper()]
        is_idle = role is Role.ENGINEER and self._sessions.is_idle(session)
        return Visitor(
            user.name,
            Role.VIEWER if is_idle else role,
            address,
            digest,
            user.language,
            is_idle,
            self._sessions.is_confirmed(session),
        )

    def note_activity(self, session: str) -> None:
        """Record activity of a person; a session that was idle too long needs the password instead."""
        self._sessions.note_activity(session)

    async def log_in(self, address: str, password: str, name: str = "") -> str | None:
        """Open a session; return its cookie, or None for a wrong password. Raises `TooManyAttempts`.

        name : of a user; "" with the page's password.
        """
        if name:
            known = await self.is_user(address, name, password)
        else:
            known = await self._is_shared(PAGE, address, password)
        return self._sessions.open(name, address) if known else None

    async def is_user(self, address: str, name: str, password: str) -> bool:
        """Whether the password is that user's. Raises `TooManyAttempts`."""
        user = self._user(name)
        stored = user.password_hash if user is not None else None
        # an unknown user takes as long and is locked like others, so that names cannot be probed
        return await self._attempts.check(
            address,
            f"user {key_of(name)}",
            lambda: is_password(stored or _nobodys(), password) and stored is not None,
        )

    async def confirm(self, address: str, visitor: Visitor, password: str) -> bool:
        """Confirm a session by its user's password, also after they were idle; False for a wrong password.

        Raises `TooManyAttempts`.
        """
        session = self._sessions.get(visitor.session)
        if session is None or not await self.is_user(address, session.user, password):
            return False
        self._sessions.confirm(visitor.session)
        return True

    async def redeem(self, address: str, code: str, name: str, password: str) -> str | None:
        """Create an engineer with an invitation code; return their session's cookie.

        None for a wrong code or one for another name. Raises `TooManyAttempts`, `FileFormatError`, `OSError`.
        """
        users, invite = self._users, self._invite
        if users is None or invite is None:
            return None
        if users.problem:  # before the code is used up
            raise FileFormatError(users.problem)
        other = users.like(name)
        is_new = users.get(name) is None and other is None
        take = partial(invite.take, code, name, is_new=is_new)
        if not await self._attempts.check(address, INVITATION, lambda: other is None and take()):
            return None
        user = User(name=name, role="engineer", password_hash=await self.hash(address, password))
        await asyncio.to_thread(users.put, user)
        self.end_sessions(name)
        return self._sessions.open(name, address)

    def log_out(self, cookie: str) -> None:
        """End the session of a cookie."""
        self._sessions.end([session_of(cookie)])

    def now_s(self) -> float:
        """Current time on the clock of the sessions."""
        return self._clock_s()

    def sessions(self, name: str) -> list[tuple[str, Session]]:
        """Digest and session of each open session of a user, the oldest first."""
        return self._sessions.of(name)

    def end_sessions(self, name: str, but: str = "") -> None:
        """End the sessions of a user, for example after a new password; but : digest of one to keep."""
        self._sessions.end(digest for digest, _ in self._sessions.of(name) if digest != but)

    async def has_basic(self, address: str, header: str) -> bool:
        """Whether an Authorization header holds the page's password. Raises `TooManyAttempts`."""
        scheme, _, value = header.partition(" ")
        if scheme.lower() != "basic":
            return False
        try:
            _, _, password = base64.b64decode(value, validate=True).decode().partition(":")
        except ValueError:  # not ASCII, not base64, or not UTF-8
            return False
        return await self._is_shared(PAGE, address, password)

    async def may_read_metrics(self, address: str, header: str) -> bool:
        """Whether an Authorization header holds the token of the metrics. Raises `TooManyAttempts`."""
        scheme, _, token = header.partition(" ")
        return (
            scheme.lower() == "bearer"
            and token.isascii()
            and await self._is_shared(METRICS, address, token.strip())
        )

    # --- passwords ---------------------------------------------------------------------------

    async def hash(self, address: str, password: str) -> str:
        """Hash a password, which waits its turn among the checks, as it is slow. Raises `TooManyAttempts`.

        address : of the request, by which the turn is given.
        """
        return await self._attempts.run(address, partial(hash_password, password))

    async def _is_shared(self, account: str, address: str, password: str) -> bool:
        """Whether the password is that of a shared account."""
        stored = self._hashes[account]
        if not stored:
            return False
        # a scraper comes every few seconds: compute the slow hash only the first time
        digest = hashlib.sha256(password.encode("utf-8", "surrogateescape")).digest()
        if account in self._known and hmac.compare_digest(self._known[account], digest):
            return True
        if not await self._attempts.check(address, account, partial(is_password, stored, password)):
            return False
        self._known[account] = digest
        return True

    def _user(self, name: str) -> User | None:
        return None if self._users is None else self._users.get(name)


@cache
def _nobodys() -> str:
    """Hash of a random password that nobody has."""
    return hash_password(secrets.token_urlsafe(32))
