"""What cells say over Zenoh, for whoever watches them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import zenoh
import zenoh.ext

from edged.adapters.zenoh.cbor import decode_cbor
from edged.adapters.zenoh.session import ClientTls, open_session, session_config, with_tls

CELL_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
MAX_MESSAGE_BYTES = 1024 * 1024  # a result is kilobytes

Heard = Callable[[str, str, dict[str, Any]], None]
"""Takes cell, kind and document of a message, on a thread of Zenoh's."""


@contextmanager
def listening(
    connect: Sequence[str], cell: str, heard: Heard, tls: ClientTls | None = None
) -> Iterator[Callable[[], int]]:
    """Hear every message of the kinds "target", "state" and "health", and "alive" with {"alive": bool}.

    Gives a function: how many routers and cells are connected now.
    connect : endpoints. cell : its name, or "*". The last target, state and life sign of each cell come
    first, however long ago they were published. Raises `ConfigError` for endpoints that cannot be, and
    `UserError` for certificates.
    """

    def arrived(sample: zenoh.Sample) -> None:
        message = _read(sample)
        if message is not None:
            heard(*message)

    with ExitStack() as stack:
        # a peer, because a client connects to one endpoint only and gives up when nobody is there yet
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
        yield lambda: len(session.info.routers_zid()) + len(session.info.peers_zid())


def _read(sample: zenoh.Sample) -> tuple[str, str, dict[str, Any]] | None:
    """Cell, kind and document, or None for what is no message: anybody can publish anything."""
    parts = str(sample.key_expr).split("/")
    if len(parts) != 3 or not CELL_NAME.fullmatch(parts[1]):
        return None
    _, cell, kind = parts
    if kind == "alive":
        return cell, kind, {"alive": sample.kind == zenoh.SampleKind.PUT}
    if len(sample.payload) > MAX_MESSAGE_BYTES:
        return None
    read = decode_cbor if sample.encoding == zenoh.Encoding.APPLICATION_CBOR else json.loads
    try:
        document = read(sample.payload.to_bytes())
    except (ValueError, RecursionError):
        return None
    return (cell, kind, document) if isinstance(document, dict) else None
