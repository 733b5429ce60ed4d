"""Messages of all cells that this machine can reach."""

from __future__ import annotations

import queue
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from edged.adapters.zenoh.listener import CELL_NAME, subscribed
from edged.adapters.zenoh.session import ClientTls

__all__ = ["ClientTls", "Document", "Fleet", "News", "is_cell_name", "is_name_pattern", "news_of_cells"]

INBOX_LENGTH = 10_000  # bounds memory: a reader that is stopped for long loses messages

Document = dict[str, Any]


@dataclass(frozen=True, slots=True)
class News:
    """One message of one cell. kind : "target", "state", "health", or "alive" (document: {"alive": bool})."""

    cell: str
    kind: str
    document: Document


@dataclass(frozen=True, slots=True)
class Fleet:
    """Messages received from the cells.

    inbox : queue of their messages. links : present number of connections to routers and cells.
    doubts : a sentence on each cell whose messages may not all be its own.
    """

    inbox: queue.Queue[News]
    links: Callable[[], int]
    doubts: Callable[[], list[str]]


def is_cell_name(text: str) -> bool:
    """Whether this is a valid cell name."""
    return CELL_NAME.fullmatch(text) is not None


def is_name_pattern(text: str) -> bool:
    """Whether this is a valid pattern of cell names with the wildcards * and ?."""
    return re.fullmatch(r"[A-Za-z0-9_.*?-]{1,64}", text) is not None and "**" not in text


@contextmanager
def news_of_cells(
    connect: Sequence[str], cell: str | None, tls: ClientTls | None = None, shared_key: bytes | None = None
) -> Iterator[Fleet]:
    """Receive messages of cells while open.

    cell : only from the cell with this name. shared_key : only messages signed with it.
    Raises `ConfigError` for invalid endpoints, `UserError` for certificates.
    """
    inbox: queue.Queue[News] = queue.Queue(INBOX_LENGTH)

    def heard(name: str, kind: str, document: Document) -> None:
        if not inbox.full():
            inbox.put_nowait(News(name, kind, document))

    with subscribed(connect, cell or "*", heard, tls, shared_key) as listened:
        yield Fleet(inbox, listened.links, listened.doubts)
