"""Live pictures: one exposure after another while the holder of the cell watches.

Each goes to every listener: pages, and the judges of board, light and focus.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass

from edged.cell.lease.notices import Listeners, Notices
from edged.cell.tasks import cancel_and_await
from edged.domain.frames import FramePair
from edged.errors import CaptureError, LinkError, SetupRefused
from edged.ports import Commissioner

PERIOD_S = 0.05
"""Shortest time between exposures: fast enough for the eye, and it leaves time for other requests."""
REST_S = 1.0
"""Pause after a camera fault."""
UNSEEN_S = 10.0
"""A page that shows no picture for this long is dropped: a sleeping tablet must not keep the cell taken."""


@dataclass(frozen=True, slots=True)
class _Want:
    """One page's request for pictures under a token; until_s : extended whenever it has shown a picture."""

    token: str
    until_s: float


class LivePictures(Listeners[int, FramePair]):
    """Live pictures, sent as number and pair; a busy listener drops pairs, and no exposure waits for it.

    notices : gets "live" at the start, at the end, and when the cameras fail.
    """

    def __init__(
        self,
        commissioner: Commissioner,
        notices: Notices,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self._commissioner = commissioner
        self._notices = notices
        self._clock_s = clock_s
        self._wants: dict[Hashable, _Want] = {}
        self._task: asyncio.Task[None] | None = None
        self._number = 0
        self._fault = ""

    @property
    def is_on(self) -> bool:
        """Whether pictures are being taken."""
        return self._task is not None

    async def want(self, who: Hashable, token: str) -> None:
        """Start taking pictures for the holder of this token. Raises `SetupRefused`."""
        await self._commissioner.renew_setup(token)
        self._wants[who] = _Want(token, self._clock_s() + UNSEEN_S)
        if self._task is None:
            self._fault = ""
            self._tell(on=True)
            self._task = asyncio.create_task(self._run(), name="live")

    def seen(self, who: Hashable) -> None:
        """Note that a page has shown a picture."""
        if who in self._wants:
            self._wants[who] = _Want(self._wants[who].token, self._clock_s() + UNSEEN_S)

    def unwant(self, who: Hashable) -> None:
        """Stop taking pictures for a page; an unknown page is ignored."""
        self._wants.pop(who, None)

    async def close(self) -> None:
        """Stop taking pictures."""
        self._wants.clear()
        if self._task is not None:
            await cancel_and_await(self._task)

    async def _run(self) -> None:
        code, detail = "", ""
        try:
            while self._wants:
                want = next(reversed(self._wants.values()))
                token, begun_s = want.token, self._clock_s()
                if begun_s >= want.until_s:
                    self._forget(token)
                    code, detail = "unseen", f"nobody has looked for {UNSEEN_S:g} s"
                    continue
                try:
                    pair = await self._commissioner.capture(token)
                except SetupRefused as error:
                    self._forget(token)
                    code, detail = "setup_refused", str(error)
                    continue
                except LinkError:  # the cell has stopped, and so will this page
                    return
                except CaptureError as error:
                    self._tell_fault(error)
                    await asyncio.sleep(REST_S)
                    continue
                self._fault = ""
                self._number += 1
                self.tell(self._number, pair)
                await asyncio.sleep(max(0.0, PERIOD_S - (self._clock_s() - begun_s)))
        finally:
            self._task = None
            self._tell(on=False, code=code, detail=detail)

    def _forget(self, token: str) -> None:
        self._wants = {who: want for who, want in self._wants.items() if want.token != token}

    def _tell_fault(self, error: CaptureError) -> None:
        """Report a fault once, not at every retry."""
        if self._fault != str(error):
            self._fault = str(error)
            self._tell(on=True, code=f"camera_{error.code}", detail=self._fault)

    def _tell(self, *, on: bool, code: str = "", detail: str = "") -> None:
        self._notices.publish("live", {"on": on, "code": code or None, "detail": detail or None})
