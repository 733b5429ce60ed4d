"""Who said it: each message names the session it comes from, and proves by a shared key that a cell sent it.

Whoever is let in by Zenoh may publish under a cell's key. So beside each payload stands an attachment, JSON:

    {"session": "1b41...", "counter": 1769904000123456789, "mac": "9f86..."}

session : Zenoh's id of the cell's session. counter : when it was sent, UTC ns, but always more than before:
what is not newer than the last one of its key was there already. mac : with a shared key alone, HMAC-SHA256
(RFC 2104) in hex digits over

    edged/1 LF key expression LF session LF counter LF number of bytes of parameters LF parameters LF payload

parameters : of the query that is answered, as it was asked, so that a nonce in it makes every former answer a
wrong one; empty for what is published. All text is UTF-8, LF one byte.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import threading
from collections.abc import Callable
from dataclasses import dataclass

from edged.payload import encode

LAYOUT = "edged/1"
MAX_ATTACHMENT_BYTES = 1024
"""Ours are 200."""
MAX_COUNTER = 1 << 63
"""Of ns, in the year 2262."""
KNOWN_SESSIONS = 8
"""Of a cell, that spoke for it before; a restart is one more."""


@dataclass(frozen=True, slots=True)
class Seal:
    """What an attachment says. mac : b"" where the cell has no shared key."""

    session: str
    counter: int
    mac: bytes


def mac_of(key: bytes, key_expr: str, seal: Seal, parameters: str, payload: bytes) -> bytes:
    """HMAC-SHA256, 32 bytes; the seal's own is not looked at."""
    asked = parameters.encode()
    head = f"{LAYOUT}\n{key_expr}\n{seal.session}\n{seal.counter}\n{len(asked)}\n".encode()
    return hmac.digest(key, head + asked + b"\n" + payload, hashlib.sha256)


def seal_in(attachment: bytes | None) -> Seal | None:
    """What an attachment says; None for what is none of ours."""
    if attachment is None or len(attachment) > MAX_ATTACHMENT_BYTES:
        return None
    try:
        document = json.loads(attachment)
        seal = Seal(document["session"], document["counter"], bytes.fromhex(document.get("mac", "")))
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
    is_session = isinstance(seal.session, str) and seal.session.isalnum()
    return seal if is_session and type(seal.counter) is int and 0 < seal.counter < MAX_COUNTER else None


class Sealer:
    """Makes the attachments of a session; from any thread. key : shared; None: there is none."""

    def __init__(self, session: str, key: bytes | None, utc_ns: Callable[[], int]) -> None:
        self.session = session
        self._key = key
        self._utc_ns = utc_ns
        self._counter = 0
        self._lock = threading.Lock()

    def attachment(self, key_expr: str, payload: bytes, parameters: str = "") -> bytes:
        """Beside a payload. parameters : of the query that it answers."""
        with self._lock:
            self._counter = max(self._counter + 1, self._utc_ns())
            seal = Seal(self.session, self._counter, b"")
        document: dict[str, str | int] = {"session": seal.session, "counter": seal.counter}
        if self._key is not None:
            document["mac"] = mac_of(self._key, key_expr, seal, parameters, payload).hex()
        return encode(document)


class Verifier:
    """Knows by a shared key what a cell has sent, once."""

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._newest: dict[str, int] = {}

    def admits(self, key_expr: str, payload: bytes, attachment: bytes | None) -> bool:
        """Whether a published message is a cell's, and newer than every one of its key so far."""
        seal = seal_in(attachment)
        if seal is None or not hmac.compare_digest(mac_of(self._key, key_expr, seal, "", payload), seal.mac):
            return False
        if seal.counter <= self._newest.get(key_expr, 0):
            return False
        self._newest[key_expr] = seal.counter
        return True


class Speakers:
    """Which sessions speak for a cell, by what they say themselves: a restart is another one, once."""

    def __init__(self) -> None:
        self._sessions: list[str] = []

    def heard(self, session: str) -> tuple[str, str] | None:
        """Take note of a message; two sessions that both speak, where there are."""
        if not self._sessions or session not in self._sessions:
            self._sessions = [*self._sessions[1 - KNOWN_SESSIONS :], session]
        elif session != self._sessions[-1]:
            return session, self._sessions[-1]
        return None
