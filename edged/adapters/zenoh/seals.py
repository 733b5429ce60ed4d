"""Authentication of messages: each names its session, and with a shared key proves that a cell sent it.

Any peer that Zenoh admits may publish under a cell's key. So each payload has an attachment, in JSON:

    {"session": "1b41...", "counter": 1769904000123456789, "mac": "9f86..."}

session : Zenoh's id of the cell's session. counter : time of sending, UTC ns, but strictly increasing: a
message whose counter is not above the last one of its key is a repetition. mac : only with a shared key,
HMAC-SHA256 (RFC 2104) in hex digits over

    edged/1 LF key expression LF session LF counter LF number of bytes of parameters LF parameters LF payload

parameters : of the query that is answered, as received, so that no earlier answer fits a query with a new
nonce; empty for published messages. All text is UTF-8, LF is one byte.
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
"""Longest attachment that is accepted; ours have 200 bytes."""
MAX_COUNTER = 1 << 63
"""Upper bound of the counter: the year 2262."""
KNOWN_SESSIONS = 8
"""Number of sessions remembered of a cell; each restart is a new session."""


@dataclass(frozen=True, slots=True)
class Seal:
    """Content of an attachment. mac : b"" without a shared key."""

    session: str
    counter: int
    mac: bytes


def mac_of(key: bytes, key_expr: str, seal: Seal, parameters: str, payload: bytes) -> bytes:
    """HMAC-SHA256, 32 bytes, over a message and its seal, except the seal's own mac."""
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
    """Makes the attachments of a session; thread-safe. key : shared key, or None."""

    def __init__(self, session: str, key: bytes | None, utc_ns: Callable[[], int]) -> None:
        self.session = session
        self._key = key
        self._utc_ns = utc_ns
        self._counter = 0
        self._lock = threading.Lock()

    def attachment(self, key_expr: str, payload: bytes, parameters: str = "") -> bytes:
        """Attachment for a payload. parameters : of the query that it answers."""
        with self._lock:
            self._counter = max(self._counter + 1, self._utc_ns())
            seal = Seal(self.session, self._counter, b"")
        document: dict[str, str | int] = {"session": seal.session, "counter": seal.counter}
        if self._key is not None:
            document["mac"] = mac_of(self._key, key_expr, seal, parameters, payload).hex()
        return encode(document)


class Verifier:
    """Checks by a shared key that a cell sent a message, and that it is not a repetition."""

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._newest: dict[str, int] = {}

    def admits(self, key_expr: str, payload: bytes, attachment: bytes | None) -> bool:
        """Whether a published message is from a cell, and newer than all earlier ones of its key."""
        seal = seal_in(attachment)
        if seal is None or not hmac.compare_digest(mac_of(self._key, key_expr, seal, "", payload), seal.mac):
            return False
        if seal.counter <= self._newest.get(key_expr, 0):
            return False
        self._newest[key_expr] = seal.counter
        return True


class SessionTracker:
    """Tracks the sessions that claim to be a cell, to find two at a time; a restart is a new session."""

    def __init__(self) -> None:
        self._sessions: list[str] = []

    def heard(self, session: str) -> tuple[str, str] | None:
        """Note a message of a session; return two sessions that are active at the same time, else None."""
        if not self._sessions or session not in self._sessions:
            self._sessions = [*self._sessions[1 - KNOWN_SESSIONS :], session]
        elif session != self._sessions[-1]:
            return session, self._sessions[-1]
        return None
