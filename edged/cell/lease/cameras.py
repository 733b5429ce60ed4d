"""The cameras during SETUP: open for the holder of the cell, otherwise closed for other programs to use."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping
from typing import Protocol, runtime_checkable

from edged.cell.tasks import cancel_and_await
from edged.config.chosencameras import ChosenCamera
from edged.domain.arrays import Side
from edged.domain.exposure import CameraLimits, CameraValues
from edged.domain.frames import FramePair
from edged.errors import (
    CameraSetupError,
    CaptureError,
    FrameIncomplete,
    FrameTimeout,
    FrameUnpaired,
    StreamStalled,
)
from edged.ports import AdjustableHead, Head

log = logging.getLogger(__name__)

LOOK_S = 1.0
"""Interval at which a wait for an external trigger checks whether the picture is still wanted."""
LISTEN_S = 10.0
"""Longest wait for an externally triggered exposure."""
LOST = FrameTimeout, FrameIncomplete, FrameUnpaired
"""Faults of a single image that was lost or incomplete; the next one usually arrives."""


@runtime_checkable
class _OpenAdjustableHead(Head, AdjustableHead, Protocol):
    pass


class SetupCameras:
    """The configured head, or another one on trial.

    is_wanted : whether someone still waits for the requested picture.
    """

    def __init__(self, is_wanted: Callable[[], bool]) -> None:
        self._is_wanted = is_wanted
        self._draft: Head | None = None
        self._changes: dict[Side, ChosenCamera] = {}
        self._by_head: dict[Side, ChosenCamera] = {}  # changes that define the head on trial
        self._may_be_open = True
        self._are_well = False

    @property
    def are_well(self) -> bool:
        """Whether the last picture was received."""
        return self._are_well

    async def capture(self, configured: Head, *, listens: bool) -> FramePair:
        """Return one exposure; listens : it is triggered externally. Raises `CaptureError`."""
        head = self._draft or configured
        self._may_be_open, self._are_well = True, False
        await head.open()
        pair = await (self._heard(head) if listens else capture_again(head))
        self._are_well = True
        return pair

    @property
    def changes(self) -> Mapping[Side, ChosenCamera]:
        """Changes on trial, by side; SETUP's end drops them."""
        return dict(self._changes)

    async def adjust(self, configured: Head, side: Side, values: CameraValues) -> CameraValues:
        """Set the stated values of one camera until SETUP ends; returns all values as read back.

        Raises `CaptureError`.
        """
        head = self._adjustable(configured, side)
        self._may_be_open = True
        await head.open()
        made = await head.adjust(side, values)
        stated = {
            name: getattr(made, name)
            for name in ("exposure_us", "gain_db")
            if getattr(values, name) is not None
        }
        if stated:
            before = self._changes.get(side, ChosenCamera())
            self._changes[side] = before.model_copy(update=stated)
        return made

    async def limits(self, configured: Head, side: Side) -> CameraLimits:
        """Ranges that a camera can be set to now. Raises `CaptureError`."""
        head = self._adjustable(configured, side)
        self._may_be_open = True
        await head.open()
        return await head.limits(side)

    async def exchange(
        self, configured: Head, draft: Head, changes: Mapping[Side, ChosenCamera] | None = None
    ) -> None:
        """Use another head from now on. changes : define it, if it is to become the configured one.

        Raises `CaptureError` when it cannot be opened; the previous head stays in use then.
        """
        before = self._draft or configured
        self._may_be_open, self._are_well = True, False
        await _restore(before)
        await before.close()
        try:
            await draft.open()
        except CaptureError:
            await draft.close()
            self._changes = dict(self._by_head)
            raise
        self._draft, self._by_head = draft, dict(changes or {})
        self._changes = dict(self._by_head)

    def in_use(self, configured: Head) -> Head:
        """The head that takes pictures."""
        return self._draft or configured

    async def release(self, configured: Head) -> None:
        """Close every camera and return to the configured head."""
        draft, self._draft = self._draft, None
        self._changes, self._by_head = {}, {}
        if self._may_be_open:
            for head in (draft, configured):
                if head is not None:
                    await _restore(head)
                    await head.close()
        self._may_be_open, self._are_well = False, False

    def hand_back(self) -> None:
        """Note that the loop uses the configured head again, so it may be open when SETUP next begins."""
        self._may_be_open, self._are_well = True, False

    def _adjustable(self, configured: Head, side: Side) -> _OpenAdjustableHead:
        head = self._draft or configured
        if not isinstance(head, _OpenAdjustableHead):
            raise CameraSetupError(side, "its exposure cannot be adjusted")
        return head

    async def _heard(self, head: Head) -> FramePair:
        """Return the next externally triggered exposure. Raises `FrameTimeout` if none comes."""
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
        raise FrameTimeout("both", f"no trigger came within {LISTEN_S:g} s")


async def capture_again(head: Head) -> FramePair:
    """Return one exposure, retrying once if an image was lost. Raises `CaptureError`."""
    try:
        return await head.capture()
    except StreamStalled:
        raise
    except LOST as error:
        log.info("%s: exposing once more", error)
    return await head.capture()


async def _restore(head: Head) -> None:
    if isinstance(head, AdjustableHead):
        await head.restore()
