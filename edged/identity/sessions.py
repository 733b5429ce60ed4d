"""Sessions of the page, in memory: each a random cookie, for a user or for the page's shared password."""

from __future__ import annotations

import hashlib
import secrets
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from edged.connections import network_of
from edged.identity.users import key_of

SESSION_S = 12 * 3600.0
IDLE_S = 600.0
"""Time without activity after which an engineer may only view: the panel stands beside the cell."""
CONFIRMED_S = 300.0
"""Time after entering the password in which a session may change users, and what the cell runs with:
settings, releases, backups."""
OF_A_PERSON = 8
OF_THE_PAGE, OF_AN_ADDRESS = 64, 8
"""Maximum number of sessions with the page's password: in all, and per address. Users' count separately."""


@dataclass(frozen=True, slots=True)
class Session:
    """Session of a visitor. user : name; "" with the page's password alone. address : of the log-in.

    active_s : time of the last activity. confirmed_s : time at which the password was last entered.
    """

    user: str
    address: str
    since_s: float
    active_s: float
    confirmed_s: float


class Sessions:
    """All open sessions. When there are too many, a new one replaces the oldest of its user or address."""

    def __init__(self, clock_s: Callable[[], float]) -> None:
        self._clock_s = clock_s
        self._sessions: dict[str, Session] = {}

    def open(self, user: str, address: str) -> str:
        """Open a session; return its cookie."""
        now_s = self._clock_s()
        self.end([digest for digest in self._sessions if self.get(digest) is None])
        self._displace(user, address)
        cookie = secrets.token_urlsafe(32)
        self._sessions[session_of(cookie)] = Session(user, address, now_s, now_s, now_s)
        return cookie

    def get(self, digest: str) -> Session | None:
        """Session with this cookie digest; None if there is none, or it has expired."""
        found = self._sessions.get(digest)
        return found if found is not None and self._clock_s() < found.since_s + SESSION_S else None

    def note_activity(self, digest: str) -> None:
        """Record activity of a person; a session that was idle too long needs the password instead."""
        found = self.get(digest)
        if found is not None and not self.is_idle(found):
            self._sessions[digest] = replace(found, active_s=self._clock_s())

    def confirm(self, digest: str) -> None:
        """Record that the person entered their password."""
        found = self.get(digest)
        if found is not None:
            now_s = self._clock_s()
            self._sessions[digest] = replace(found, active_s=now_s, confirmed_s=now_s)

    def is_idle(self, session: Session) -> bool:
        """Whether the session has been inactive for too long."""
        return self._clock_s() - session.active_s >= IDLE_S

    def is_confirmed(self, session: Session) -> bool:
        """Whether the password was entered recently."""
        return self._clock_s() - session.confirmed_s < CONFIRMED_S

    def of(self, user: str) -> list[tuple[str, Session]]:
        """Digest and session of each open session of a user, the oldest first."""
        key = key_of(user)
        return [
            (digest, session)
            for digest in tuple(self._sessions)
            if (session := self.get(digest)) is not None and key_of(session.user) == key
        ]

    def end(self, digests: Iterable[str]) -> None:
        """End the sessions with these digests."""
        for digest in digests:
            self._sessions.pop(digest, None)

    def _displace(self, user: str, address: str) -> None:
        own = self.of(user)
        if user:
            self.end(digest for digest, _ in own[: max(0, len(own) - OF_A_PERSON + 1)])
            return
        places = [(network_of(session.address), digest) for digest, session in own]
        of_place = [digest for place, digest in places if place == network_of(address)]
        if len(of_place) >= OF_AN_ADDRESS:
            self.end(of_place[:1])
        elif len(own) >= OF_THE_PAGE:  # end one of the address that has most
            count = Counter(place for place, _ in places)
            self.end([max(places, key=lambda session: count[session[0]])[1]])


def session_of(cookie: str) -> str:
    """Digest of a cookie, as key of its session: comparing digests reveals nothing about the cookie."""
    # a header may hold any bytes, which aiohttp passes on as surrogates
    return hashlib.sha256(cookie.encode("utf-8", "surrogateescape")).hexdigest()
