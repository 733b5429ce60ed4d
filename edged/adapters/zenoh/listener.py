"""Receives messages of cells over Zenoh, for `edged watch` and others."""

from __future__ import annotations

import re
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import zenoh
import zenoh.ext

from edged.adapters.zenoh.seals import Seal, SessionTracker, Verifier, seal_in
from edged.adapters.zenoh.session import ClientTls, open_session, session_config, with_tls
from edged.cbor import decode_cbor
from edged.domain.numerals import json_of

CELL_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
MAX_MESSAGE_BYTES = 1024 * 1024  # a result is kilobytes
MAX_DOUBTED = 1000
"""Most cells remembered, since any peer can publish under any name."""

Heard = Callable[[str, str, dict[str, Any]], None]
"""Callback with cell, kind and document of a message, on a thread of Zenoh."""


@dataclass(frozen=True, slots=True)
class Listening:
    """State of a running subscription. links : returns the number of connected routers and cells.

    doubts : returns a sentence on each cell whose messages may not all be genuine.
    """

    links: Callable[[], int]
    doubts: Callable[[], list[str]]


class MessageFilter:
    """Admits only genuine messages of cells; thread-safe. key : shared with the cells; None: admits all."""

    def __init__(self, key: bytes | None) -> None:
        self._verifier = None if key is None else Verifier(key)
        self._lock = threading.Lock()
        self._known: set[str] = set()
        self._dropped: Counter[str] = Counter()
        self._speakers: dict[str, SessionTracker] = {}
        self._rivals: dict[str, tuple[str, str]] = {}

    def admits(self, cell: str, kind: str, sample: zenoh.Sample) -> bool:
        """Whether to accept a message; with a key, "alive" counts only after a proven message of the cell."""
        attachment = None if sample.attachment is None else sample.attachment.to_bytes()
        with self._lock:
            if kind == "alive":
                return self._verifier is None or cell in self._known
            if self._verifier is None:
                self._note_speaker(cell, seal_in(attachment))
                return True
            if self._verifier.admits(str(sample.key_expr), sample.payload.to_bytes(), attachment):
                self._known.add(cell)
                return True
            if cell in self._dropped or len(self._dropped) < MAX_DOUBTED:
                self._dropped[cell] += 1
            return False

    def _note_speaker(self, cell: str, seal: Seal | None) -> None:
        if cell in self._speakers or len(self._speakers) < MAX_DOUBTED:
            speakers = self._speakers.setdefault(cell, SessionTracker())
            rivals = speakers.heard("unnamed" if seal is None else seal.session)
            if rivals is not None:
                self._rivals.setdefault(cell, rivals)

    def doubts(self) -> list[str]:
        """A sentence on each cell whose messages may not all be genuine."""
        with self._lock:
            dropped = [
                f"{cell}: {count} message{'s' if count > 1 else ''} dropped: false, repeated, or signed with "
                "another key"
                for cell, count in sorted(self._dropped.items())
            ]
            rivals = [
                f"{cell}: two Zenoh sessions publish for it, {first} and {second}: one of them may be false"
                for cell, (first, second) in sorted(self._rivals.items())
            ]
        return dropped + rivals


@contextmanager
def subscribed(
    connect: Sequence[str],
    cell: str,
    on_message: Heard,
    tls: ClientTls | None = None,
    shared_key: bytes | None = None,
) -> Iterator[Listening]:
    """Receive every message of the kinds "target", "state" and "health", and "alive" with {"alive": bool}.

    connect : endpoints. cell : its name, or "*". shared_key : only messages signed with it are passed on. The
    last target, state and liveliness of each cell come first, however long ago they were published. Raises
    `ConfigError` for invalid endpoints, and `UserError` for unusable certificates.
    """

    message_filter = MessageFilter(shared_key)

    def arrived(sample: zenoh.Sample) -> None:
        message = _read(sample)
        if message is not None and message_filter.admits(message[0], message[1], sample):
            on_message(*message)

    with ExitStack() as stack:
        # a peer, because a client connects to only one endpoint, and gives up if that is not there yet
        config = session_config("peer", [], connect)
        session = open_session(config if tls is None else with_tls(config, tls))
        stack.callback(session.close)
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
        for kind in ("target", "state"):
            subscriber = zenoh.ext.declare_advanced_subscriber(
                session, f"edged/{cell}/{kind}", arrived, history=history
            )
            stack.callback(subscriber.undeclare)
        session.declare_subscriber(f"edged/{cell}/health", arrived)
        session.liveliness().declare_subscriber(f"edged/{cell}/alive", arrived, history=True)
        yield Listening(
            lambda: len(session.info.routers_zid()) + len(session.info.peers_zid()), message_filter.doubts
        )


def _read(sample: zenoh.Sample) -> tuple[str, str, dict[str, Any]] | None:
    """Decode cell, kind and document of a message; None if malformed."""
    parts = str(sample.key_expr).split("/")
    if len(parts) != 3 or not CELL_NAME.fullmatch(parts[1]):
        return None
    _, cell, kind = parts
    if kind == "alive":
        return cell, kind, {"alive": sample.kind == zenoh.SampleKind.PUT}
    if len(sample.payload) > MAX_MESSAGE_BYTES:
        return None
    read = decode_cbor if sample.encoding == zenoh.Encoding.APPLICATION_CBOR else json_of
    try:
        document = read(sample.payload.to_bytes())
    except (ValueError, RecursionError):
        return None
    return (cell, kind, document) if isinstance(document, dict) else None
