"""What the core asks of the world: small protocols, implemented in `adapters` and `sim`."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from edged.domain.arrays import Side
from edged.domain.events import Command, Event
from edged.domain.exposure import CameraLimits, CameraValues
from edged.domain.frames import Frame, FramePair


class Camera(Protocol):
    """One camera that takes a picture when told.

    Every method is bounded in time by its implementation and raises only `CaptureError`s.
    """

    @property
    def name(self) -> str:
        """ "left" or "right"."""
        ...

    async def open(self) -> None:
        """Connect and arm; may be called again after `close` or after a fault."""
        ...

    async def trigger(self) -> None:
        """Start one exposure; frames that were not fetched before are dropped."""
        ...

    async def frame(self) -> Frame:
        """Return the image of the last trigger, or raise `FrameTimeout` / `FrameIncomplete`."""
        ...

    async def close(self) -> None:
        """Release everything; safe to call twice and on a camera that never opened."""
        ...


@runtime_checkable
class Adjustable(Protocol):
    """A camera whose exposure can be tried. Bounded in time; raises only `CaptureError`s."""

    async def adjust(self, values: CameraValues) -> CameraValues:
        """Set what is stated, until `restore`; returns all that is in force, as read back.

        Raises `CameraSetupError` for what the camera does not have or take; then nothing has changed.
        """
        ...

    async def limits(self) -> CameraLimits:
        """What it can be set to now."""
        ...

    async def restore(self) -> None:
        """Undo what was adjusted. When it fails, too, no later connection has what was adjusted."""
        ...


class Head(Protocol):
    """Two cameras that answer as one: what the loop needs of them."""

    async def open(self) -> None:
        """Connect both cameras; nothing to do for those that are connected and well."""
        ...

    async def capture(self) -> FramePair:
        """One exposure of both cameras, bounded in time; raises `CaptureError`."""
        ...

    async def listen(self) -> FramePair:
        """The next exposure that others trigger; may be cancelled and called again, and none is lost."""
        ...

    async def close(self) -> None:
        """Release both cameras."""
        ...


@runtime_checkable
class AdjustableHead(Protocol):
    """A head whose cameras' exposure can be tried; as `Adjustable`."""

    async def adjust(self, side: Side, values: CameraValues) -> CameraValues:
        """Set what is stated; `CameraValues()` only reads."""
        ...

    async def limits(self, side: Side) -> CameraLimits:
        """What a camera can be set to now."""
        ...

    async def restore(self) -> None:
        """Undo what was adjusted."""
        ...


class Publisher(Protocol):
    """Somewhere results go."""

    async def start(self) -> None:
        """Open sockets. Raises `ListenError`."""
        ...

    def announce(self, event: Event) -> None:
        """Take note of an event on the event loop; must not block or raise."""
        ...

    async def close(self) -> None:
        """Stop and leave nothing behind."""
        ...


class Commander(Protocol):
    """Where publishers that also take commands hand them in."""

    def submit(self, command: Command) -> None:
        """Accept a command for the cycle, or raise `CommandRefused`.

        Every accepted command ends in exactly one event that carries it: a `Snapshot`,
        a `JobChanged` or a `CommandFailed`.
        """
        ...

    def lock_setup(self, locked: bool) -> None:
        """Forbid that people take the cell for SETUP, and end it where one has; or allow it again."""
        ...


class Commissioner(Protocol):
    """Where people take the cell for SETUP. Every method raises `SetupRefused` for what cannot be now."""

    async def enter_setup(self, name: str, *, take_over: bool = False) -> str:
        """Take the cell after the running cycle, also from whoever has it; returns the token of a lease."""
        ...

    def renew_setup(self, token: str) -> None:
        """Say once a minute at least that somebody still looks after the cell."""
        ...

    def leave_setup(self, token: str) -> None:
        """Give the cell back."""
        ...

    def end_setup(self, name: str) -> None:
        """End it for whoever has the cell, or had it and never gave it back."""
        ...

    async def capture(self, token: str) -> FramePair:
        """One exposure, of which nobody else hears. Raises `CaptureError`, too."""
        ...
