"""Drafts of one topic in a running cell: opened on demand, and sent to every page when they change.

A topic (calibrations, registrations, teaching of jobs) has its own type of open drafts, which holds the state
of a draft beyond its files, and defines by `Topic` how that state is computed and sent.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Any, Generic, Protocol, TypeVar, cast

from edged.adapters.web.gate import code_of
from edged.cell.lease.notices import Notices
from edged.cell.tasks import cancel_and_await
from edged.errors import EdgedError, FileFormatError, UserError
from edged.setup.documents import DraftHead, Trouble
from edged.setup.history import DraftFile, DraftFolders, History

S = TypeVar("S", bound=History[Any])
D = TypeVar("D", bound=DraftFile[Any])
S_contra = TypeVar("S_contra", contravariant=True)
D_contra = TypeVar("D_contra", contravariant=True)
R = TypeVar("R")


class OpenDraft(Protocol):
    """An open draft. is_gone : it was discarded.  is_busy : work for it is under way."""

    is_gone: bool

    @property
    def draft(self) -> DraftFile[Any]:
        """Its files."""

    @property
    def is_busy(self) -> bool:
        """Whether work for it is under way."""


O = TypeVar("O", bound=OpenDraft)  # noqa: E741  (an open draft)


class Topic(Protocol[S_contra, D_contra, O]):
    """Operations that differ from topic to topic."""

    def opened(self, draft: D_contra) -> O:
        """Open a draft for work; called in a thread."""

    def refresh(self, opened: O) -> None:
        """Start to recompute results whose inputs have changed."""

    def document(self, opened: O) -> DraftHead:
        """Full document of a draft."""

    def summary(self, state: S_contra) -> Mapping[str, object]:
        """Fields of a draft in a list, besides id, created and author."""

    async def stop(self, opened: O) -> None:
        """Stop all work under way for a draft."""


class StaleDraft(Exception):
    """A draft was changed since it was seen. document : as it is now."""

    def __init__(self, document: DraftHead) -> None:
        self.document = document
        super().__init__("somebody else has changed it since")


class OpenDrafts(Generic[S, D, O]):
    """Open drafts of one topic; used on the event loop only. kind : of notices.  current : the last used."""

    def __init__(
        self, kind: str, notices: Notices, folders: DraftFolders[S, D], topic: Topic[S, D, O]
    ) -> None:
        self.current: str | None = None
        self.open: dict[str, O] = {}
        self._kind = kind
        self._notices = notices
        self._folders = folders
        self._topic = topic
        self._changing = asyncio.Lock()

    async def close(self) -> None:
        """Stop all work under way; drafts are on disc."""
        for opened in list(self.open.values()):
            await self._topic.stop(opened)

    async def summaries(self) -> list[dict[str, object]]:
        """Fields of a `DraftSummary` of each draft, newest first; or why it cannot be read."""
        return [
            {"id": identity, "trouble": str(state)}
            if isinstance(state, FileFormatError)
            else {
                "id": identity,
                "created": state.created,
                "author": state.author,
                **self._topic.summary(state),
            }
            for identity, state in await asyncio.to_thread(self._folders.states)
        ]

    async def get(self, identity: str) -> O:
        """Open a draft. Raises `KeyError`, and `FileFormatError` for one that cannot be read."""
        if identity not in self.open:
            found = await asyncio.to_thread(lambda: self._topic.opened(self._folders.load(identity)))
            self.open.setdefault(identity, found)  # unless opened meanwhile
        opened = self.open[identity]
        self._topic.refresh(opened)
        return opened

    async def document(self, identity: str) -> DraftHead:
        """Full document of a draft. Raises as `get`."""
        opened = await self.get(identity)
        self.current = self.current or identity
        return self._topic.document(opened)

    async def begin(self, create: Callable[[], D]) -> O:
        """Create and open a draft, and close all that are not busy. Raises what `create` raises."""
        async with self._changing:
            opened = await asyncio.to_thread(lambda: self._topic.opened(create()))
        self.current = opened.draft.state.id
        busy = {identity: other for identity, other in self.open.items() if other.is_busy}
        self.open = {**busy, self.current: opened}
        return opened

    async def change(
        self, identity: str, change: Callable[[D], object], revision: int | None = None
    ) -> DraftHead:
        """Change a draft's files. revision : that was seen; None for any.

        Raises what `change` raises, `StaleDraft`, and as `get`.
        """
        opened = await self.get(identity)
        self.current = identity
        async with self.changing(opened, revision):
            await asyncio.to_thread(change, cast(D, opened.draft))
        return self.publish(opened)

    @asynccontextmanager
    async def changing(self, opened: O, revision: int | None = None) -> AsyncIterator[None]:
        """Context for changing a draft's files; no other draft is changed meanwhile. Raises as `check`."""
        async with self._changing:
            self.check(opened, revision)
            yield
        self._topic.refresh(opened)

    def check(self, opened: O, revision: int | None) -> None:
        """Check a draft. Raises `KeyError` if it was discarded, `StaleDraft` for another revision."""
        if opened.is_gone:
            raise KeyError(opened.draft.state.id)
        if revision is not None and revision != opened.draft.state.revision:
            raise StaleDraft(self._topic.document(opened))

    async def remove(self, identity: str, revision: int | None = None) -> None:
        """Discard a draft, and stop all work for it. Raises `KeyError`, `StaleDraft`."""
        opened = self.open.get(identity) if revision is None else await self.get(identity)
        async with self._changing:
            if opened is not None:
                self.check(opened, revision)
            await asyncio.to_thread(self._folders.remove, identity)
            opened = self.open.pop(identity, None)
        if self.current == identity:
            self.current = None
        self._notices.publish(self._kind, {"id": identity, "gone": True})
        if opened is not None:
            opened.is_gone = True
            await self._topic.stop(opened)

    def publish(self, opened: O) -> DraftHead:
        """Send a draft to every page."""
        document = self._topic.document(opened)
        if not opened.is_gone:
            self._notices.publish(self._kind, document.model_dump(mode="json"))
        return document

    async def republish(self, identity: str) -> None:
        """Send a draft after a change outside its files. Raises as `get`."""
        self.publish(await self.get(identity))


class Latest(Generic[R]):
    """A result that is computed in the background, and again if its inputs have changed meanwhile.

    inputs : returns what it depends on, compared by ==.  compute : raises nothing.  ended : called
    afterwards.
    """

    def __init__(
        self,
        first: R,
        inputs: Callable[[], object],
        compute: Callable[[], Awaitable[R]],
        ended: Callable[[], object],
    ) -> None:
        self.value = first
        self._inputs = inputs
        self._compute = compute
        self._ended = ended
        self._made_of: object = None
        self._running: asyncio.Task[None] | None = None

    @property
    def is_running(self) -> bool:
        """Whether a newer result is being computed."""
        return self._running is not None

    @property
    def is_current(self) -> bool:
        """Whether the result is of the present inputs."""
        return self._made_of == self._inputs()

    def set(self, value: R) -> None:
        """Set the result for the present inputs."""
        self.value, self._made_of = value, self._inputs()

    def refresh(self) -> None:
        """Start to compute it again if it is not current."""
        if self._running is None and not self.is_current:
            self._running = asyncio.create_task(self._run(), name="refresh")

    async def _run(self) -> None:
        try:
            while self._made_of != (inputs := self._inputs()):
                self.value = await self._compute()
                self._made_of = inputs
        finally:
            self._running = None
            self._ended()

    async def wait(self) -> None:
        """Compute it if it is not current, and wait for the result."""
        self.refresh()
        if self._running is not None:
            await asyncio.shield(self._running)

    async def stop(self) -> None:
        """Stop computing."""
        if self._running is not None:
            await cancel_and_await(self._running)


def trouble_in(error: Exception | None) -> Trouble | None:
    """Document of an error, None without one; the code is "" if it is not an `EdgedError`."""
    if error is None:
        return None
    params = dict(error.params) if isinstance(error, UserError) else {}
    return Trouble(
        code=code_of(error) if isinstance(error, EdgedError) else "", text=str(error), params=params
    )
