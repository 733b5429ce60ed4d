"""Interfaces of the core to the outside, implemented in `adapters` and `sim`."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from edged.domain.arrays import Side
from edged.domain.events import Command, Event
from edged.domain.exposure import CameraLimits, CameraValues
from edged.domain.frames import Frame, FramePair


class Camera(Protocol):
    """One triggered camera.

    Every method is bounded in time by its implementation and raises only `CaptureError`s.
    """

    @property
    def name(self) -> str:
        """ "left" or "right"."""

    async def open(self) -> None:
        """Connect and arm; may be called again after `close` or after a fault."""

    async def trigger(self) -> None:
        """Start one exposure; frames that were not fetched before are dropped."""

    async def frame(self) -> Frame:
        """Return the image of the last trigger, or raise `FrameTimeout` / `FrameIncomplete`."""

    async def close(self) -> None:
        """Release everything; safe to call twice and on a camera that never opened."""


@runtime_checkable
class Adjustable(Protocol):
    """A camera whose exposure can be adjusted on trial. Bounded in time; raises only `CaptureError`s."""

    async def adjust(self, values: CameraValues) -> CameraValues:
        """Set the given values until `restore`; return all values as read back.

        Raises `CameraSetupError` for a value that the camera lacks or rejects; then nothing is changed.
        """

    async def limits(self) -> CameraLimits:
        """Ranges of the values that it can be set to now."""

    async def restore(self) -> None:
        """Undo `adjust`; even if this fails, the adjusted values do not survive into a later connection."""


class Head(Protocol):
    """Two cameras that act as one."""

    async def open(self) -> None:
        """Connect cameras that are not connected, or are faulty."""

    async def capture(self) -> FramePair:
        """Make one exposure with both cameras, bounded in time; raises `CaptureError`."""

    async def listen(self) -> FramePair:
        """Wait for the next externally triggered exposure; may be cancelled and repeated without loss."""

    async def close(self) -> None:
        """Release both cameras."""


@runtime_checkable
class AdjustableHead(Protocol):
    """A head whose cameras' exposure can be adjusted on trial; see `Adjustable`."""

    async def adjust(self, side: Side, values: CameraValues) -> CameraValues:
        """Set the given values; `CameraValues()` only reads."""

    async def limits(self, side: Side) -> CameraLimits:
        """Ranges of the values that a camera can be set to now."""

    async def restore(self) -> None:
        """Undo all adjustments."""


class Publisher(Protocol):
    """A receiver of the cell's events."""

    async def start(self) -> None:
        """Open sockets. Raises `ListenError`."""

    def announce(self, event: Event) -> None:
        """Accept an event, on the event loop; must not block or raise."""

    async def close(self) -> None:
        """Stop, and release all resources."""


class Commander(Protocol):
    """Receiver of commands from clients of publishers."""

    def submit(self, command: Command) -> None:
        """Accept a command for the cycle, or raise `CommandRefused`.

        Every accepted command ends in exactly one event that carries it: a `Snapshot`,
        a `JobChanged` or a `CommandFailed`.
        """

    def lock_setup(self, locked: bool) -> None:
        """Forbid SETUP and end it; or allow it again."""


class Commissioner(Protocol):
    """Receiver of people's requests for SETUP. Every method raises `SetupRefused` when refused."""

    async def enter_setup(self, name: str, *, take_over: bool = False) -> str:
        """Take the cell after the running cycle (take_over : even from its holder); return a lease token."""

    async def renew_setup(self, token: str) -> None:
        """Extend the lease, at least once a minute."""

    async def leave_setup(self, token: str) -> None:
        """End the lease."""

    async def end_setup(self, name: str) -> None:
        """End SETUP for any holder, even with a lapsed lease. name : of the person who requests it."""

    async def capture(self, token: str) -> FramePair:
        """Make one exposure, which is not announced. Also raises `CaptureError`."""
