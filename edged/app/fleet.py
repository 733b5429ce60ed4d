"""What every cell says that this machine can reach."""

from __future__ import annotations

import queue
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from edged.adapters.zenoh.listener import CELL_NAME, listening

INBOX_LENGTH = 10_000  # a reader that is stopped for long loses news, never memory

Document = dict[str, Any]


@dataclass(frozen=True, slots=True)
class News:
    """One message of one cell. kind : "target", "state", "health", or "alive" (document: {"alive": bool})."""

    cell: str
    kind: str
    document: Document


def is_cell_name(text: str) -> bool:
    """Whether a cell can have this name."""
    return CELL_NAME.fullmatch(text) is not None


@contextmanager
def news_of_cells(connect: Sequence[str], cell: str | None) -> Iterator[queue.Queue[News]]:
    """A queue that fills with what the cells say; cell : only the one with this name.

    Raises `ConfigError` for endpoints that cannot be.
    """
    inbox: queue.Queue[News] = queue.Queue(INBOX_LENGTH)

    def heard(name: str, kind: str, document: Document) -> None:
        if not inbox.full():
            inbox.put_nowait(News(name, kind, document))

    with listening(connect, cell or "*", heard):
        yield inbox
