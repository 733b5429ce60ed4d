"""Notices to open pages: changed drafts, tasks and live pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Generic, ParamSpec

Noticed = ParamSpec("Noticed")


class Listeners(Generic[Noticed]):
    """Set of callbacks, used on the event loop only; a listener gets the notices sent after it was added."""

    def __init__(self) -> None:
        self._listeners: dict[object, Callable[Noticed, None]] = {}

    def listen(self, listener: Callable[Noticed, None]) -> Callable[[], None]:
        """Add a listener, which must neither block nor raise. Returns a function that removes it."""
        key = object()
        self._listeners[key] = listener

        def stop() -> None:
            self._listeners.pop(key, None)

        return stop

    def tell(self, *what: Noticed.args, **named: Noticed.kwargs) -> None:
        """Call every listener with these arguments."""
        for listener in tuple(self._listeners.values()):
            listener(*what, **named)


class Notices(Listeners[str, Mapping[str, Any]]):
    """Notices made up of a kind and a document."""

    def publish(self, kind: str, document: Mapping[str, Any]) -> None:
        """Pass a new state to every listener.

        kind : "draft", "task", … document : JSON. A slow page may get only the newest document of a
        kind and `id`.
        """
        self.tell(kind, document)
