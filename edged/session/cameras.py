"""The cameras while the cell is set up: used by who has it, and otherwise left to other programs."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from edged.capture.tasks import cancel_and_await
from edged.domain.frames import FramePair
from edged.errors import FrameTimeout
from edged.ports import Head

LOOK_S = 1.0
"""Waiting for others to trigger, look this often whether anybody still wants the picture."""
LISTEN_S = 10.0
"""Wait so long for an exposure that others trigger."""


class SetupCameras:
    """The configured head, or one that is tried instead.

    is_wanted : whether whoever asked for a picture still does.
    """

    def __init__(self, is_wanted: Callable[[], bool]) -> None:
        self._is_wanted = is_wanted
        self._draft: Head | None = None
        self._may_be_open = True
        self._are_well = False

    @property
    def are_well(self) -> bool:
        """Whether the last picture came."""
        return self._are_well

    async def capture(self, configured: Head, *, listens: bool) -> FramePair:
        """One exposure; listens : others trigger it. Raises `CaptureError`."""
        head = self._draft or configured
        self._may_be_open, self._are_well = True, False
        await head.open()
        pair = await (self._heard(head) if listens else head.capture())
        self._are_well = True
        return pair

    async def exchange(self, configured: Head, draft: Head) -> None:
        """Use others from now on. Raises `CaptureError` when they cannot be opened."""
        before, self._draft = self._draft or configured, draft
        self._may_be_open, self._are_well = True, False
        await before.close()
        await draft.open()

    async def put_down(self, configured: Head) -> None:
        """Close whatever may be open; the configured ones count from then on."""
        if self._may_be_open:
            for head in (self._draft, configured):
                if head is not None:
                    await head.close()
        self._draft, self._may_be_open, self._are_well = None, False, False

    def hand_back(self) -> None:
        """The loop uses the configured ones again: they may be open when SETUP begins next."""
        self._may_be_open, self._are_well = True, False

    async def _heard(self, head: Head) -> FramePair:
        """The next exposure that others trigger. Raises `FrameTimeout` when there is none."""
        heard = asyncio.ensure_future(head.listen())
        try:
            for _ in range(round(LISTEN_S / LOOK_S)):
                await asyncio.wait({heard}, timeout=LOOK_S)
                if heard.done():
                    return heard.result()
                if not self._is_wanted():
                    break
        finally:
            await cancel_and_await(heard)
        raise FrameTimeout("both", f"nobody triggered them within {LISTEN_S:g} s")
