"""One camera of the stereo head: its last frames, the awaited frame, and closing in the background."""

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

    frame_id, paired_id : of the last frame and the last pair since it was opened. image : the last image,
    kept across a reopen so that a camera that still sends the same picture is caught. coming : task waiting
    for the next frame, started at since_s; heard_s : when the last frame arrived (event loop time). suspect :
    it gave no image and must be checked. faults : consecutive failed exposures.
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
        """Start closing the camera in the background; if it does not answer, it must not delay the cycle."""
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
        """Whether waiting for a frame ended with the camera's own time-out."""
        coming = self.coming
        return coming is not None and coming.done() and isinstance(coming.exception(), FrameTimeout)

    def listen(self) -> asyncio.Task[Frame]:
        """Return the task that waits for the next frame; it survives the cancellation of its awaiter."""
        if self.coming is None:
            self.since_s = asyncio.get_running_loop().time()
            self.coming = asyncio.create_task(self._hear(), name=f"listen {self.name}")
        return self.coming

    def listen_again(self) -> None:
        """Resume waiting after a time-out, keeping the original start time."""
        since_s, self.coming = self.since_s, None
        self.listen()
        self.since_s = since_s

    async def _hear(self) -> Frame:
        frame = await self.camera.frame()
        self.heard_s = asyncio.get_running_loop().time()
        return frame

    async def closed(self) -> None:
        """Wait until the closing begun by `close_soon` is complete."""
        if self.closing is not None:
            closing = self.closing
            await asyncio.shield(closing)
            if self.closing is closing:
                self.closing = None

    def check_frame(self, frame: Frame, *, detect_frozen: bool) -> PairingError | None:
        """Remember a frame; return what is wrong with it as the successor of the previous one, or None."""
        last_id, last_image = self.frame_id, self.image
        self.frame_id, self.image = frame.frame_id, frame.image
        if last_id is not None and frame.frame_id <= last_id:
            return FrameRepeated(
                self.name, f"frame {frame.frame_id} came after frame {last_id}: not a new image"
            )
        # uniformly dark or saturated images are equal without being frozen
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
