"""The cameras while the cell is set up: used by who has it, and otherwise left to other programs."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Protocol, runtime_checkable

from edged.cell.tasks import cancel_and_await
from edged.domain.arrays import Side
from edged.domain.exposure import CameraLimits, CameraValues
from edged.domain.frames import FramePair
from edged.errors import CameraSetupError, CaptureError, FrameTimeout
from edged.ports import AdjustableHead, Head

LOOK_S = 1.0
"""Waiting for others to trigger, look this often whether anybody still wants the picture."""
LISTEN_S = 10.0
"""Wait so long for an exposure that others trigger."""


@dataclass(frozen=True, slots=True)
class CameraChanges:
    """How one camera is to be other than configured. None: as it is configured.

    device : serial number or address; serial : that is expected there.
    """

    device: str | None = None
    serial: str | None = None
    exposure_us: float | None = None
    gain_db: float | None = None

    def stated(self) -> dict[str, str | float]:
        """What is other, by the names of the configuration."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@runtime_checkable
class _OpenAdjustableHead(Head, AdjustableHead, Protocol):
    pass


class SetupCameras:
    """The configured head, or one that is tried instead.

    is_wanted : whether whoever asked for a picture still does.
    """

    def __init__(self, is_wanted: Callable[[], bool]) -> None:
        self._is_wanted = is_wanted
        self._draft: Head | None = None
        self._changes: dict[Side, CameraChanges] = {}
        self._by_head: dict[Side, CameraChanges] = {}  # those that the other head is
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

    @property
    def changes(self) -> Mapping[Side, CameraChanges]:
        """What is tried, by side; nothing of it outlives SETUP by itself."""
        return dict(self._changes)

    async def adjust(self, configured: Head, side: Side, values: CameraValues) -> CameraValues:
        """Set what is stated of one camera until SETUP ends; returns what is in force, as read back.

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
            before = self._changes.get(side, CameraChanges())
            self._changes[side] = replace(before, **stated)
        return made

    async def limits(self, configured: Head, side: Side) -> CameraLimits:
        """What a camera can be set to now. Raises `CaptureError`."""
        head = self._adjustable(configured, side)
        self._may_be_open = True
        await head.open()
        return await head.limits(side)

    async def exchange(
        self, configured: Head, draft: Head, changes: Mapping[Side, CameraChanges] | None = None
    ) -> None:
        """Use others from now on. changes : what they are, if they are to become the configured ones.

        Raises `CaptureError` when they cannot be opened; those from before are used then.
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

    async def put_down(self, configured: Head) -> None:
        """Close whatever may be open; the configured ones count from then on."""
        draft, self._draft = self._draft, None
        self._changes, self._by_head = {}, {}
        if self._may_be_open:
            for head in (draft, configured):
                if head is not None:
                    await _restore(head)
                    await head.close()
        self._may_be_open, self._are_well = False, False

    def hand_back(self) -> None:
        """The loop uses the configured ones again: they may be open when SETUP begins next."""
        self._may_be_open, self._are_well = True, False

    def _adjustable(self, configured: Head, side: Side) -> _OpenAdjustableHead:
        head = self._draft or configured
        if not isinstance(head, _OpenAdjustableHead):
            raise CameraSetupError(side, "its exposure cannot be adjusted")
        return head

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


async def _restore(head: Head) -> None:
    if isinstance(head, AdjustableHead):
        await head.restore()
