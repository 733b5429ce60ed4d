"""Origin of messages: each names its session, and proves by a shared key that a cell sent it.

Any peer that Zenoh admits may publish under a cell's key. So each payload has an attachment, JSON:

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
import threading
from collections.abc import Callable
from dataclasses import dataclass

from edged.domain.numerals import json_of
from edged.payload import encode

LAYOUT = "edged/1"
MAX_ATTACHMENT_BYTES = 1024
"""Longest attachment that is read; ours have 200 bytes."""
MAX_COUNTER = 1 << 63
"""Largest time stamp: the year 2262."""
KNOWN_SESSIONS = 8
"""Remembered former sessions of a cell; each restart is another session."""


@dataclass(frozen=True, slots=True)
class Seal:
    """Content of an attachment. mac : b"" without a shared key."""

    session: str
    counter: int
    mac: bytes


def mac_of(key: bytes, key_expr: str, seal: Seal, parameters: str, payload: bytes) -> bytes:
    """HMAC-SHA256, 32 bytes, of the seal without its mac."""
    asked = parameters.encode()
    head = f"{LAYOUT}\n{key_expr}\n{seal.session}\n{seal.counter}\n{len(asked)}\n".encode()
    return hmac.digest(key, head + asked + b"\n" + payload, hashlib.sha256)


def seal_in(attachment: bytes | None) -> Seal | None:
    """Decode an attachment; None if it is not an edged one."""
    if attachment is None or len(attachment) > MAX_ATTACHMENT_BYTES:
        return None
    try:
        document = json_of(attachment)
        seal = Seal(document["session"], document["counter"], bytes.fromhex(document.get("mac", "")))
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
    is_session = isinstance(seal.session, str) and seal.session.isalnum()
    return seal if is_session and type(seal.counter) is int and 0 < seal.counter < MAX_COUNTER else None


class Sealer:
    """Makes the attachments of a session; from any thread. key : shared, or None."""

    def __init__(self, session: str, key: bytes | None, utc_ns: Callable[[], int]) -> None:
        self.session = session
        self._key = key
        self._utc_ns = utc_ns
        self._counter = 0
        self._lock = threading.Lock()

    def attachment(self, key_expr: str, payload: bytes, parameters: str = "") -> bytes:
        """The attachment for a payload. parameters : of the query that it answers."""
        with self._lock:
            self._counter = max(self._counter + 1, self._utc_ns())
            seal = Seal(self.session, self._counter, b"")
        document: dict[str, str | int] = {"session": seal.session, "counter": seal.counter}
        if self._key is not None:
            document["mac"] = mac_of(self._key, key_expr, seal, parameters, payload).hex()
        return encode(document)


class Verifier:
    """Checks by a shared key that a cell has sent a message, and that it is not a repetition."""

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
    """The sessions that claim to be a cell; a restart is a new session."""

    def __init__(self) -> None:
        self._sessions: list[str] = []

    def heard(self, session: str) -> tuple[str, str] | None:
        """Note a message; returns two sessions that are active at once, else None."""
        if not self._sessions or session not in self._sessions:
            self._sessions = [*self._sessions[1 - KNOWN_SESSIONS :], session]
        elif session != self._sessions[-1]:
            return session, self._sessions[-1]
        return None
