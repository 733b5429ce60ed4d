"""Drafts of one topic in a running cell: opened when they are asked for, sent to every page when they change.

A topic (calibrations, registrations, jobs to teach) has an open-draft type of its own, which holds what is
known of a draft beyond its files, and says by `Topic` how that is computed and sent.
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
    """A draft that is worked on. is_gone : it was discarded.  is_busy : something is under way for it."""

    is_gone: bool

    @property
    def draft(self) -> DraftFile[Any]:
        """Its files."""

    @property
    def is_busy(self) -> bool:
        """Described above."""


O = TypeVar("O", bound=OpenDraft)  # noqa: E741  (an open draft)


class Topic(Protocol[S_contra, D_contra, O]):
    """What is different from topic to topic."""

    def opened(self, draft: D_contra) -> O:
        """Work on a draft; called in a thread."""

    def refresh(self, opened: O) -> None:
        """Compute again what depends on what has changed."""

    def document(self, opened: O) -> DraftHead:
        """All that is known of a draft."""

    def summary(self, state: S_contra) -> Mapping[str, object]:
        """Fields of a draft in a list, besides id, created and author."""

    async def stop(self, opened: O) -> None:
        """End what is under way for a draft."""


class StaleDraft(Exception):
    """A draft was changed since it was seen. document : as it is now."""

    def __init__(self, document: DraftHead) -> None:
        self.document = document
        super().__init__("somebody else has changed it since")


class OpenDrafts(Generic[S, D, O]):
    """Used on the event loop only. kind : of the notices.  current : the draft that was worked on last."""

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
        """End what is under way; drafts are on disc."""
        for opened in list(self.open.values()):
            await self._topic.stop(opened)

    async def summaries(self) -> list[dict[str, object]]:
        """All drafts, the youngest first, as `DraftSummary` has them; or why one cannot be read."""
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
            self.open.setdefault(identity, found)  # unless somebody was quicker
        opened = self.open[identity]
        self._topic.refresh(opened)
        return opened

    async def document(self, identity: str) -> DraftHead:
        """All that is known of a draft. Raises as `get`."""
        opened = await self.get(identity)
        self.current = self.current or identity
        return self._topic.document(opened)

    async def begin(self, create: Callable[[], D]) -> O:
        """Open a new draft; those for which nothing is under way are closed. Raises what `create` raises."""
        async with self._changing:
            opened = await asyncio.to_thread(lambda: self._topic.opened(create()))
        self.current = opened.draft.state.id
        busy = {identity: other for identity, other in self.open.items() if other.is_busy}
        self.open = {**busy, self.current: opened}
        return opened

    async def change(
        self, identity: str, change: Callable[[D], object], revision: int | None = None
    ) -> DraftHead:
        """Change a draft's files. revision : that was seen; None: any.

        Raises what `change` raises, `StaleDraft`, and as `get`.
        """
        opened = await self.get(identity)
        self.current = identity
        async with self.changing(opened, revision):
            await asyncio.to_thread(change, cast(D, opened.draft))
        return self.tell(opened)

    @asynccontextmanager
    async def changing(self, opened: O, revision: int | None = None) -> AsyncIterator[None]:
        """While files of a draft change: nobody else changes any. Raises as `check`."""
        async with self._changing:
            self.check(opened, revision)
            yield
        self._topic.refresh(opened)

    def check(self, opened: O, revision: int | None) -> None:
        """Raises `KeyError` for a draft that was discarded, `StaleDraft` for another revision."""
        if opened.is_gone:
            raise KeyError(opened.draft.state.id)
        if revision is not None and revision != opened.draft.state.revision:
            raise StaleDraft(self._topic.document(opened))

    async def remove(self, identity: str, revision: int | None = None) -> None:
        """Discard a draft, and end what is under way for it. Raises `KeyError`, `StaleDraft`."""
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

    def tell(self, opened: O) -> DraftHead:
        """Send a draft to every page."""
        document = self._topic.document(opened)
        if not opened.is_gone:
            self._notices.publish(self._kind, document.model_dump(mode="json"))
        return document

    async def tell_again(self, identity: str) -> None:
        """Send a draft of which something has changed that its files do not tell. Raises as `get`."""
        self.tell(await self.get(identity))


class Latest(Generic[R]):
    """A result that is computed in the background, and again while its inputs have changed meanwhile.

    inputs : what it depends on, compared by ==.  compute : raises nothing.  ended : called after.
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
        """Whether the result is that of the inputs as they are."""
        return self._made_of == self._inputs()

    def set(self, value: R) -> None:
        """Let this be the result for the inputs as they are."""
        self.value, self._made_of = value, self._inputs()

    def refresh(self) -> None:
        """Compute it again if it is not current."""
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
        """Compute it if it is not current, and wait for that."""
        self.refresh()
        if self._running is not None:
            await asyncio.shield(self._running)

    async def stop(self) -> None:
        """Compute it no more."""
        if self._running is not None:
            await cancel_and_await(self._running)


def trouble_in(error: Exception | None) -> Trouble | None:
    """The document of an error; without a code where it is not one of edged's."""
    if error is None:
        return None
    params = dict(error.params) if isinstance(error, UserError) else {}
    return Trouble(
        code=code_of(error) if isinstance(error, EdgedError) else "", text=str(error), params=params
    )
