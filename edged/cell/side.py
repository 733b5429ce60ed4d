"""One camera of the stereo head: its last frames, the frame that is awaited, and its slow closing."""

from __future__ import annotations

import asyncio

import numpy as np

from edged.cell.tasks import cancel_and_await
from edged.domain.arrays import Image
from edged.domain.frames import Frame
from edged.errors import FrameFrozen, FrameRepeated, FrameTimeout, PairingError
from edged.ports import Camera


class CameraSide:
    """One camera of the head, and its state.

    frame_id, paired_id : of the last frame and pair since it was opened. image : the last one ever, so that a
    reopened camera that still shows the same picture is caught. coming : task that waits for the next frame,
    since since_s; heard_s : when the last frame came (time of the event loop). suspect : it gave no
    image, and is to be checked.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.open = False
        self.faults = 0
        self.frame_id: int | None = None
        self.image: Image | None = None
        self.paired_id: int | None = None
        self.coming: asyncio.Task[Frame] | None = None
        self.since_s = self.heard_s = 0.0
        self.suspect = False
        self.closing: asyncio.Task[None] | None = None

    @property
    def name(self) -> str:
        """ "left" or "right"."""
        return self.camera.name

    def close_soon(self) -> None:
        """Begin to close the camera; a camera that does not answer must not hold up the cycle."""
        self.open = False
        self.faults = 0
        self.frame_id = self.paired_id = None
        self.suspect = False
        if self.coming is not None:
            self.coming.cancel()
        if self.closing is None:
            self.closing = asyncio.create_task(self._close(), name=f"close {self.name}")

    async def _close(self) -> None:
        coming, self.coming = self.coming, None
        if coming is not None:
            await cancel_and_await(coming)
        await self.camera.close()

    def has_given_up(self) -> bool:
        """Whether nothing came within the camera's own limit."""
        coming = self.coming
        return coming is not None and coming.done() and isinstance(coming.exception(), FrameTimeout)

    def listen(self) -> asyncio.Task[Frame]:
        """The task that waits for the next frame; cancelling who awaits it does not end it."""
        if self.coming is None:
            self.since_s = asyncio.get_running_loop().time()
            self.coming = asyncio.create_task(self._hear(), name=f"listen {self.name}")
        return self.coming

    def listen_again(self) -> None:
        """Wait on after it gave up, with the same start time."""
        since_s, self.coming = self.since_s, None
        self.listen()
        self.since_s = since_s

    async def _hear(self) -> Frame:
        frame = await self.camera.frame()
        self.heard_s = asyncio.get_running_loop().time()
        return frame

    async def closed(self) -> None:
        """Wait for the end of what `close_soon` began."""
        if self.closing is not None:
            closing = self.closing
            await asyncio.shield(closing)
            if self.closing is closing:
                self.closing = None

    def look_at(self, frame: Frame, *, detect_frozen: bool) -> PairingError | None:
        """Remember a frame; returns what is wrong with it after the previous one, or None."""
        last_id, last_image = self.frame_id, self.image
        self.frame_id, self.image = frame.frame_id, frame.image
        if last_id is not None and frame.frame_id <= last_id:
            return FrameRepeated(
                self.name, f"frame {frame.frame_id} came after frame {last_id}: not a new image"
            )
        # a dark or saturated image has no pixel to tell it from the previous one
        if (
            detect_frozen
            and last_image is not None
            and np.array_equal(frame.image, last_image)
            and np.ptp(frame.image) > 0
        ):
            return FrameFrozen(
                self.name, f"frozen: frame {frame.frame_id} equals the one before in every pixel"
            )
        return None
