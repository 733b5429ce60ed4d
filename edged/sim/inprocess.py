"""A camera in this process, with the same interface as a real one.

For unit tests, and for a virtual cell on a machine without Aravis: no sockets, no driver. It yields to
the event loop and renders in a thread, so that the loop stays free as with a real camera.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import Image
from edged.domain.exposure import CameraLimits, CameraValues
from edged.domain.frames import Frame
from edged.errors import CameraSetupError, CameraUnreachable, CaptureError, FrameIncomplete, FrameTimeout
from edged.sim.exposure import ExposureRequest

LIMITS = CameraLimits((10.0, 1_000_000.0), (0.0, 24.0))
"""The same as those of the virtual GigE Vision cameras."""


@dataclass(slots=True)
class InProcessFaults:
    """Injected faults; a test may change them at any time.

    open_error, trigger_error : raised by every `open` or `trigger` while set.
    fail_next_trigger : raised once.
    stall : triggers are accepted but no image ever comes.
    drop_next : number of following exposures that give no image.
    incomplete_next : number of following exposures whose image arrives damaged.
    delay_s : delay of the image, but not of the exposure.
    skew_s : delay of the exposure itself, in host and device time.
    frozen : the image (not the frame id) of the last exposure is sent again.
    repeat_id : the frame counter does not change.
    """

    open_error: CaptureError | None = None
    trigger_error: CaptureError | None = None
    fail_next_trigger: CaptureError | None = None
    stall: bool = False
    drop_next: int = 0
    incomplete_next: int = 0
    delay_s: float = 0.0
    skew_s: float = 0.0
    frozen: bool = False
    repeat_id: bool = False


class InProcessCamera:
    """A camera whose images are computed when it is triggered.

    exposure : called in a worker thread; returns the (height, width) uint8 image. count : returns the count
    of a belt's encoder, delivered with the image.
    opened, closed : numbers of openings and closings, for tests.
    """

    def __init__(
        self,
        name: str,
        exposure: Callable[[ExposureRequest], Image],
        *,
        width: int = 1280,
        height: int = 960,
        exposure_us: float = 2000.0,
        gain_db: float = 0.0,
        frame_timeout_s: float = 5.0,
        count: Callable[[ExposureRequest], int] | None = None,
    ) -> None:
        self._name = name
        self._exposure, self._count = exposure, count
        self._width, self._height = width, height
        self._configured = self._values = CameraValues(exposure_us, gain_db)
        self._frame_timeout_s = frame_timeout_s
        self._started_ns = 0
        self._frame_id = 0
        self._last_image: Image | None = None
        self._pending: asyncio.Task[Frame | None] | None = None
        self.faults = InProcessFaults()
        self.is_open = False
        self.opened = self.closed = 0

    @property
    def name(self) -> str:
        """ "left" or "right"."""
        return self._name

    async def open(self) -> None:
        """Open the camera and reset frame counter and device time; for an open camera only a check."""
        await asyncio.sleep(0)
        if self.faults.open_error is not None:
            raise self.faults.open_error
        if self.is_open:
            return
        self.is_open = True
        self.opened += 1
        self._frame_id = 0
        self._started_ns = time.time_ns()

    async def trigger(self) -> None:
        """Expose now; the image is rendered in a thread."""
        await asyncio.sleep(0)
        if not self.is_open:
            raise CameraUnreachable(self._name, "not open")
        fault, self.faults.fail_next_trigger = self.faults.fail_next_trigger, None
        fault = fault or self.faults.trigger_error
        if fault is not None:
            raise fault
        await self._drop_pending()
        if not self.faults.repeat_id or self._frame_id == 0:
            self._frame_id += 1
        exposed_ns = time.time_ns() + round(self.faults.skew_s * 1e9)
        request = ExposureRequest(
            frame_id=self._frame_id,
            exposed_ns=exposed_ns,
            device_ns=exposed_ns - self._started_ns,
            exposure_us=self._values.exposure_us or 0.0,
            gain_db=self._values.gain_db or 0.0,
            width=self._width,
            height=self._height,
        )
        self._pending = asyncio.create_task(self._expose(request), name=f"expose {self._name}")

    async def frame(self) -> Frame:
        """Return the image of the last trigger, or raise `FrameTimeout` / `FrameIncomplete`."""
        if self._pending is None:
            raise FrameTimeout(self._name, "no exposure was triggered")
        try:
            async with asyncio.timeout(self._frame_timeout_s):
                frame = await asyncio.shield(self._pending)
        except TimeoutError:
            raise FrameTimeout(self._name, f"no image within {self._frame_timeout_s:g} s") from None
        self._pending = None
        if frame is None:
            raise FrameIncomplete(self._name, "the image arrived with packets missing")
        return frame

    async def adjust(self, values: CameraValues) -> CameraValues:
        """Set exposure time and gain until `restore`. Raises `CameraSetupError`."""
        if not self.is_open:
            raise CameraUnreachable(self._name, "not open")
        if problem := LIMITS.problem(values):
            raise CameraSetupError(self._name, problem)
        self._values = values.over(self._values)
        return self._values

    async def limits(self) -> CameraLimits:
        """Limits of exposure time and gain."""
        return LIMITS

    async def restore(self) -> None:
        """Restore the configured exposure time and gain."""
        self._values = self._configured

    async def close(self) -> None:
        """Cancel a pending exposure and close; safe to call twice and on a camera that never opened."""
        await self._drop_pending()
        self.closed += self.is_open
        self.is_open = False

    async def _expose(self, request: ExposureRequest) -> Frame | None:
        """Render the image; None for one that arrives damaged."""
        faults = self.faults
        if faults.stall or faults.drop_next > 0:
            faults.drop_next = max(0, faults.drop_next - 1)
            await asyncio.Event().wait()
        if faults.frozen and self._last_image is not None:
            image = self._last_image
        else:
            image = self._last_image = await asyncio.to_thread(self._exposure, request)
        if (request.height, request.width) != image.shape or image.dtype != np.uint8:
            raise ValueError(
                f"exposure() of camera {self._name} gave {image.shape} {image.dtype}, "
                f"expected ({request.height}, {request.width}) uint8"
            )
        if faults.delay_s > 0:
            await asyncio.sleep(faults.delay_s)
        if faults.incomplete_next > 0:
            faults.incomplete_next -= 1
            return None
        count = None if self._count is None else self._count(request)
        return Frame(
            self._name, request.frame_id, image.copy(), request.device_ns, request.exposed_ns, count=count
        )

    async def _drop_pending(self) -> None:
        pending, self._pending = self._pending, None
        if pending is not None:
            pending.cancel()
            await asyncio.wait({pending})
            if not pending.cancelled():
                pending.exception()  # retrieve it, so that asyncio does not report it as never retrieved
