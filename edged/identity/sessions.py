"""Sessions of the page, in memory: each a random cookie, of a user or of whoever has the page's password."""

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
"""After this long without a sign of them an engineer may only look: the panel stands beside the cell."""
CONFIRMED_S = 300.0
"""For so long after their password a session may change users and what the cell runs by."""
OF_A_PERSON = 8
OF_THE_PAGE, OF_AN_ADDRESS = 64, 8
"""Sessions with the page's password alone: of all, and of one address. Users have theirs beside them."""


@dataclass(frozen=True, slots=True)
class Session:
    """user : name; "" with the page's password alone. address : where they logged in.

    active_s : when a person did something last. confirmed_s : when they gave their password last.
    """

    user: str
    address: str
    since_s: float
    active_s: float
    confirmed_s: float


class Sessions:
    """All that are open. A new one takes the place of the user's own oldest, or of the address's."""

    def __init__(self, clock_s: Callable[[], float]) -> None:
        self._clock_s = clock_s
        self._sessions: dict[str, Session] = {}

    def open(self, user: str, address: str) -> str:
        """Open a session; its cookie."""
        now_s = self._clock_s()
        self.end([digest for digest in self._sessions if self.get(digest) is None])
        self._displace(user, address)
        cookie = secrets.token_urlsafe(32)
        self._sessions[session_of(cookie)] = Session(user, address, now_s, now_s, now_s)
        return cookie

    def get(self, digest: str) -> Session | None:
        """The session of a cookie's digest; None where there is none, or no longer."""
        found = self._sessions.get(digest)
        return found if found is not None and self._clock_s() < found.since_s + SESSION_S else None

    def note_activity(self, digest: str) -> None:
        """Note that a person did something; a session that was idle too long needs the password instead."""
        found = self.get(digest)
        if found is not None and not self.is_idle(found):
            self._sessions[digest] = replace(found, active_s=self._clock_s())

    def confirm(self, digest: str) -> None:
        """Note that a person gave their password."""
        found = self.get(digest)
        if found is not None:
            now_s = self._clock_s()
            self._sessions[digest] = replace(found, active_s=now_s, confirmed_s=now_s)

    def is_idle(self, session: Session) -> bool:
        """Whether there was no sign of a person for too long."""
        return self._clock_s() - session.active_s >= IDLE_S

    def is_confirmed(self, session: Session) -> bool:
        """Whether they gave their password just now."""
        return self._clock_s() - session.confirmed_s < CONFIRMED_S

    def of(self, user: str) -> list[tuple[str, Session]]:
        """Digest and session of each that a user has open, the oldest first."""
        key = key_of(user)
        return [
            (digest, session)
            for digest in tuple(self._sessions)
            if (session := self.get(digest)) is not None and key_of(session.user) == key
        ]

    def end(self, digests: Iterable[str]) -> None:
        """End sessions."""
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
        elif len(own) >= OF_THE_PAGE:  # of the address that has most
            count = Counter(place for place, _ in places)
            self.end([max(places, key=lambda session: count[session[0]])[1]])


def session_of(cookie: str) -> str:
    """The digest of a cookie, by which its session is kept: comparing them tells nothing of the cookie."""
    # a header may hold any bytes, which aiohttp hands on as surrogates
    return hashlib.sha256(cookie.encode("utf-8", "surrogateescape")).hexdigest()
