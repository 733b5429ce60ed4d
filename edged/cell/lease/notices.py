"""Notices to open pages: changed drafts, tasks and live pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Listener = Callable[[str, Mapping[str, Any]], None]


class Notices:
    """Used on the event loop only; a listener gets what is published after it was added."""

    def __init__(self) -> None:
        self._listeners: dict[object, Listener] = {}

    def publish(self, kind: str, document: Mapping[str, Any]) -> None:
        """Pass a new state to every listener.

        kind : "draft", "task", … document : JSON. A slow page may get only the newest document of a
        kind and `id`.
        """
        for listener in tuple(self._listeners.values()):
            listener(kind, document)

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Add a listener, which must neither block nor raise. Returns a function that removes it."""
        key = object()
        self._listeners[key] = listener

        def stop() -> None:
            self._listeners.pop(key, None)

        return stop
