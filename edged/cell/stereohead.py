"""The stereo head: two cameras that act as one.

Responsible for: opening both, triggering both at once, one deadline for everything, checking
that two frames belong to one exposure, and reopening failed cameras. Not responsible for: how a camera is
reached (`adapters`, `sim`), when it is triggered (`cycle`).

A fault raises `CaptureError` at once and never blocks: cameras are opened by a background task,
and between two attempts the last error is raised again.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from typing import Any, TypeVar

from edged.cell.pairing import Pairing
from edged.cell.side import CameraSide
from edged.cell.tasks import both, cancel_and_await
from edged.domain.arrays import SIDES, Side
from edged.domain.exposure import CameraLimits, CameraValues
from edged.domain.frames import Frame, FramePair
from edged.errors import (
    CameraBusy,
    CameraSetupError,
    CameraUnreachable,
    CaptureError,
    FrameTimeout,
    FrameUnpaired,
    PairingError,
    StreamStalled,
)
from edged.ports import Adjustable, Camera

REOPEN_AFTER = 3
"""Consecutive exposures that one camera failed to deliver before it is closed and reopened.

A single lost frame is the network's fault; a camera that was power-cycled accepts triggers on the
old connection for ever but never sends an image.
"""

LISTEN_AGAIN_S = 0.1
"""Pause before listening again to a camera whose wait timed out; most waits time out only after seconds."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class HeadSettings:
    """How a stereo head triggers, pairs and reopens its cameras.

    timeout_s : from trigger to both images.
    max_skew_s, max_arrival_skew_s : see `Pairing`.
    follower : the camera that exposes when the other one does, and so must be armed before the other is
    triggered.
    free_running : both expose continuously, so after a frame without a partner the next one is tried.
    by_others : triggered externally: it is no fault if neither camera delivers a frame.
    open_timeout_s : for one attempt to open both cameras.
    min_backoff_s, max_backoff_s : pause after a failed attempt, or after a fault that closed a
        camera; doubles each time until a pair has been captured.
    detect_frozen : an image that equals the previous one in every pixel is a fault; False for
        noise-free sources that may repeat an image (a folder with one pair).
    image_sizes : width, height of the left and right images that the rig was calibrated with; None: any.
    """

    timeout_s: float = 1.0
    max_skew_s: float = 0.005
    max_arrival_skew_s: float = 0.05
    follower: str = ""
    free_running: bool = False
    by_others: bool = False
    open_timeout_s: float = 15.0
    min_backoff_s: float = 0.5
    max_backoff_s: float = 5.0
    detect_frozen: bool = True
    image_sizes: tuple[tuple[int, int], tuple[int, int]] | None = None


DEFAULTS = HeadSettings()


class StereoHead:
    """Two cameras triggered together. clock : monotonic seconds, for the backoff."""

    def __init__(
        self,
        left: Camera,
        right: Camera,
        settings: HeadSettings = DEFAULTS,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._sides = (CameraSide(left), CameraSide(right))
        self._settings = settings
        self._timeout_s = settings.timeout_s
        self._pairing = Pairing(settings.max_skew_s, settings.max_arrival_skew_s)
        self._clock = clock
        self._backoff_s = settings.min_backoff_s
        self._retry_at_s = 0.0
        self._missed = 0
        self._error: CaptureError | None = None
        self._attempt: asyncio.Task[None] | None = None

    @property
    def cameras(self) -> tuple[Camera, Camera]:
        """Left and right."""
        left, right = self._sides
        return left.camera, right.camera

    async def open(self) -> None:
        """Connect closed cameras and check open ones.

        Raises the `CaptureError` that keeps a camera closed. Normally waits for the attempt to end;
        during a known fault, for at most one capture time-out, while the attempt goes on.
        """
        await self._ready(look=True)

    async def capture(self) -> FramePair:
        """Return one exposure of both cameras. Raises `CaptureError`.

        Takes at most one time-out while both are open, and one more if they have to be opened.
        """
        await self._ready(look=any(side.suspect for side in self._sides))
        listening = [side.coming for side in self._sides if side.coming is not None]
        self._taken("left", "right")
        await cancel_and_await(*listening)
        return await self._judged(self._expose())

    async def listen(self) -> FramePair:
        """Return the next externally triggered exposure of both cameras. Raises `CaptureError`.

        Waits without limit; may be cancelled and called again without losing a frame.
        """
        await self._ready(look=any(side.suspect for side in self._sides))
        pair = await self._judged(self._receive_pair())
        return FramePair(pair.left, pair.right, missed=self._missed)

    async def _judged(self, frames: Coroutine[Any, Any, FramePair]) -> FramePair:
        """Return the frames if they are a new pair. Raises `CaptureError`, after noting the fault."""
        try:
            pair = await frames
            self._check_pair(pair)
        except CaptureError as error:
            raise self._note(error) from None
        steps = []
        for side, frame in zip(self._sides, (pair.left, pair.right), strict=True):
            steps.append(frame.frame_id - side.paired_id if side.paired_id is not None else 1)
            side.paired_id, side.faults = frame.frame_id, 0
        self._missed = min(steps) - 1
        self._pairing.accept(pair.left, pair.right)
        self._backoff_s = self._settings.min_backoff_s
        return pair

    # --- exposure and gain on trial ----------------------------------------------------------

    async def adjust(self, side: Side, values: CameraValues) -> CameraValues:
        """Set the stated values of one camera until `restore`; return all values in force.

        Raises `CameraSetupError` for a refused value, and the `CaptureError` that keeps a camera closed.
        """
        return await self._asked(side, lambda camera: camera.adjust(values))

    async def limits(self, side: Side) -> CameraLimits:
        """Ranges that one camera can be set to now. Raises `CaptureError`."""
        return await self._asked(side, lambda camera: camera.limits())

    async def restore(self) -> None:
        """Undo `adjust`; a camera that does not answer is closed, and is configured afresh when reopened."""
        for side in self._sides:
            if isinstance(side.camera, Adjustable):
                try:
                    await side.camera.restore()
                except CaptureError:
                    side.close_soon()

    async def _asked(self, name: Side, question: Callable[[Adjustable], Awaitable[T]]) -> T:
        await self._ready(look=False)
        camera = self.cameras[SIDES.index(name)]
        if not isinstance(camera, Adjustable):
            raise CameraSetupError(name, "its exposure cannot be adjusted")
        try:
            return await question(camera)
        except CameraSetupError:
            raise  # the camera refused a value but works
        except CaptureError as error:
            raise self._note(error) from None

    async def close(self) -> None:
        """Release both cameras and cancel any attempt to open them; safe to call twice."""
        attempt, self._attempt = self._attempt, None
        if attempt is not None:
            await cancel_and_await(attempt)
        self._error, self._retry_at_s = None, 0.0
        for side in self._sides:
            side.close_soon()
        for side in self._sides:
            await side.closed()

    # --- opening -----------------------------------------------------------------------------

    async def _ready(self, *, look: bool) -> None:
        """Return when both cameras are open, or raise the `CaptureError` that prevents it.

        look : check open cameras as well (`Camera.open` on an open camera checks that it is alive).
        """
        if self._attempt is None:
            if not look and all(side.open for side in self._sides):
                return
            if self._error is not None and self._clock() < self._retry_at_s:
                raise self._error.with_traceback(None)  # otherwise the traceback would grow with every raise
            self._attempt = asyncio.create_task(self._open_both(), name="open cameras")
        attempt = self._attempt
        wait_s = self._settings.open_timeout_s + 1.0 if self._error is None else self._timeout_s
        await asyncio.wait({attempt}, timeout=wait_s)
        if not attempt.done():
            error = self._error or CameraUnreachable("both", "still being opened")
            raise error.with_traceback(None)
        if self._attempt is attempt:
            self._attempt = None
        attempt.result()  # a bug in an adapter is not a fault of the camera
        if self._error is not None:
            raise self._error.with_traceback(None)

    async def _open_both(self) -> None:
        """Try once to open both cameras, with the outcome in `_error`; a working camera stays open."""
        left, right = self._sides
        limit_s = self._settings.open_timeout_s + 5.0  # never reached, as each side has its own limit
        errors = [e for e in await both(self._open(left), self._open(right), limit_s) if e is not None]
        if errors:
            self._fail(_merge(errors))
        else:
            self._error = None

    async def _open(self, side: CameraSide) -> CaptureError | None:
        try:
            async with asyncio.timeout(self._settings.open_timeout_s):
                await side.closed()
                await side.camera.open()
        except TimeoutError:
            error: CaptureError = CameraUnreachable(
                side.name, f"not open after {self._settings.open_timeout_s:g} s"
            )
        except CaptureError as refused:
            error = refused
        else:
            side.open, side.suspect = True, False
            return None
        side.close_soon()
        return error

    def _fail(self, error: CaptureError) -> None:
        """Note the error; no camera is touched until the backoff has passed."""
        self._error = error
        self._retry_at_s = self._clock() + self._backoff_s
        self._backoff_s = min(2 * self._backoff_s, self._settings.max_backoff_s)

    # --- one exposure ------------------------------------------------------------------------

    async def _expose(self) -> FramePair:
        """Trigger both and fetch both frames within `timeout_s`.

        Without a follower, both triggers are sent in one turn of the event loop.
        """
        waiting = [side.name for side in self._sides]
        armed = asyncio.Event()
        deadline_s = asyncio.get_running_loop().time() + self._timeout_s

        async def shoot(camera: Camera) -> Frame:
            if self._settings.follower and camera.name != self._settings.follower:
                await armed.wait()
            await camera.trigger()
            armed.set()
            frame = await camera.frame()
            waiting.remove(camera.name)
            return frame

        left, right = (side.camera for side in self._sides)
        try:
            pair = FramePair(*await both(shoot(left), shoot(right), self._timeout_s))
            async with asyncio.timeout_at(deadline_s):
                return await self._nearest(pair) if self._settings.free_running else pair
        except TimeoutError:
            if not waiting:
                raise FrameUnpaired("both", f"no two frames match within {self._timeout_s:g} s") from None
            name = waiting[0] if len(waiting) == 1 else "both"
            if self._settings.by_others and name == "both":
                raise FrameTimeout(name, f"no trigger came within {self._timeout_s:g} s") from None
            raise FrameTimeout(name, f"no image within {self._timeout_s:g} s of the trigger") from None

    async def _nearest(self, pair: FramePair) -> FramePair:
        """Replace the older frame with that camera's next one until the two match."""
        while not (skew := self._pairing.skew(pair.left, pair.right)).is_one_exposure:
            left, right = (side.camera for side in self._sides)
            if skew.ns < 0:
                pair = FramePair(await left.frame(), pair.right)
            else:
                pair = FramePair(pair.left, await right.frame())
        return pair

    async def _receive_pair(self) -> FramePair:
        """Wait for two externally triggered frames. Raises `FrameUnpaired` for a frame without a partner."""
        while True:
            tasks = [side.listen() for side in self._sides]
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            given_up = [side for side in self._sides if side.has_given_up()]
            if not given_up:
                break
            await asyncio.sleep(LISTEN_AGAIN_S)
            for side in given_up:
                if side.has_given_up():
                    side.listen_again()
        # this may be cancelled and called again while a camera is silent: the time-out counts from when the
        # first frame had arrived and both cameras were being listened to
        now_s = asyncio.get_running_loop().time()
        frames_s = (side.heard_s for side, task in zip(self._sides, tasks, strict=True) if _has_frame(task))
        first_s = min(frames_s, default=now_s)
        due_s = max(first_s, *(side.since_s for side in self._sides)) + self._timeout_s
        await asyncio.wait(tasks, timeout=max(0.0, due_s - now_s))
        came = {side.name: side.coming for side in self._sides if side.coming and side.coming.done()}
        frames = {name: task.result() for name, task in came.items() if task.exception() is None}
        if len(frames) == 2:
            pair = FramePair(frames["left"], frames["right"])
            skew = self._pairing.skew(pair.left, pair.right)
            if skew.is_one_exposure:
                self._taken("left", "right")
                return pair
            # the later frame may be the first of the next exposure: only the older one is without a partner
            older, newer = ("left", "right") if skew.ns < 0 else ("right", "left")
            self._taken(older)
            raise FrameUnpaired(newer, f"no partner for frame {frames[older].frame_id} of {older}: {skew}")
        self._taken(*came)
        for task in came.values():
            task.result()  # raises the fault of a camera that delivered no frame
        (name,) = {"left", "right"} - frames.keys()
        (other,) = frames.values()
        raise FrameUnpaired(
            name,
            f"no partner for frame {other.frame_id} of {other.camera} within {self._timeout_s:g} s",
        )

    def _taken(self, *names: str) -> None:
        for side in self._sides:
            if side.name in names:
                side.coming = None

    def _check_pair(self, pair: FramePair) -> None:
        """Raise `PairingError` unless both frames are new and show the same instant.

        Raises `CameraSetupError` if an image does not have the calibrated size.
        """
        for frame, size in zip((pair.left, pair.right), self._settings.image_sizes or (), strict=False):
            height, width = frame.image.shape
            if (width, height) != size:
                wanted = f"{size[0]}x{size[1]}"
                raise CameraSetupError(
                    frame.camera, f"its image is {width}x{height} px, the rig was calibrated with {wanted}"
                )
        errors = [
            side.check_frame(frame, detect_frozen=self._settings.detect_frozen)
            for side, frame in zip(self._sides, (pair.left, pair.right), strict=True)
        ]
        for error in errors:
            if error is not None:
                raise error
        if problem := self._pairing.problem(pair.left, pair.right):
            raise PairingError("both", problem)

    def _note(self, error: CaptureError) -> CaptureError:
        """Close cameras that are gone or have failed too often; return the error to raise."""
        at_fault = [side for side in self._sides if error.camera in (side.name, "both")]
        if self._settings.by_others and isinstance(error, FrameTimeout) and len(at_fault) == 2:
            return error
        for side in at_fault:
            side.faults += 1
            side.suspect = isinstance(error, FrameTimeout)
        gone = isinstance(error, CameraUnreachable | CameraBusy | CameraSetupError)
        broken = [side for side in at_fault if gone or side.faults >= REOPEN_AFTER]
        if broken:
            if isinstance(error, FrameTimeout):
                # the camera was checked after each failure, and answered
                error = StreamStalled(
                    error.camera, f"no image of {REOPEN_AFTER} exposures, though it answers: opened again"
                )
            self._fail(error)
            self._pairing.forget()
            for side in broken:
                side.close_soon()
        return error


def _has_frame(task: asyncio.Task[Frame]) -> bool:
    return task.done() and not task.cancelled() and task.exception() is None


def _merge(errors: list[CaptureError]) -> CaptureError:
    """Merge the errors into one for both cameras, of the left camera's type."""
    if len(errors) == 1:
        return errors[0]
    return type(errors[0])("both", "; ".join(str(error).removeprefix("camera ") for error in errors))
