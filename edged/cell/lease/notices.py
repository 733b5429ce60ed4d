"""What open pages are told at once: drafts, tasks, live pictures. Whoever changes one publishes it here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Listener = Callable[[str, Mapping[str, Any]], None]


class Notices:
    """Used on the event loop only; nobody hears what was published before they listened."""

    def __init__(self) -> None:
        self._listeners: dict[object, Listener] = {}

    def publish(self, kind: str, document: Mapping[str, Any]) -> None:
        """Tell every listener the newest state of a thing.

        kind : "draft", "task", … document : JSON; of the same kind and `id` the newest counts, and one before
        it may never be told to who is slow.
        """
        for listener in tuple(self._listeners.values()):
            listener(kind, document)

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Hear of everything from now on; the listener must neither block nor raise. Returns what ends it."""
        key = object()
        self._listeners[key] = listener

        def stop() -> None:
            self._listeners.pop(key, None)

        return stop
