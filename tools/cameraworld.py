"""Two virtual GigE Vision cameras in a process of their own, whose pictures tell when they were exposed.

For `tools/bench_cameras.py`: the cameras' work is not in the figures of who receives, and a picture that is
torn, old, or not of the same exposure as the other one is caught, whatever the receiver believes.
"""

from __future__ import annotations

import logging
import multiprocessing as mp
import struct
import threading
import time
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

import numpy as np

from edged.domain.arrays import Image
from edged.sim.exposure import ExposureRequest
from edged.sim.gige.camera import GigeCamera

ADDRESSES = {"left": "127.0.60.1", "right": "127.0.60.2"}
WIDTH, HEIGHT = 1280, 960
GREYS = 251
"""Steps of the pattern; a prime, so that no packet size divides it."""
STAMP = struct.Struct(">qB")

_Y, _X = np.mgrid[: HEIGHT + GREYS, :WIDTH]
_PATTERN: Image = ((_X + _Y) % GREYS).astype(np.uint8)


def stamped(side: str, exposed_ns: int) -> Image:
    """(HEIGHT, WIDTH): a pattern that each time begins elsewhere; time and side in its first row."""
    start = exposed_ns // 1000 % GREYS
    image = _PATTERN[start : start + HEIGHT].copy()
    image[0, : STAMP.size] = np.frombuffer(STAMP.pack(exposed_ns, side == "left"), np.uint8)
    return image


def exposed_ns_of(side: str, image: Image) -> int | None:
    """When a picture was truly exposed, host UTC ns; None unless every pixel of it is that exposure's."""
    exposed_ns, is_left = STAMP.unpack(image[0, : STAMP.size].tobytes())
    whole = is_left == (side == "left") and np.array_equal(image, stamped(side, exposed_ns))
    return int(exposed_ns) if whole else None


class CameraWorld:
    """The process; a context manager. Commands return when they have been carried out."""

    def __init__(self) -> None:
        context = mp.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,), daemon=True)

    def __enter__(self) -> CameraWorld:
        self._process.start()
        self._pipe.recv()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pipe.send(("stop",))
        self._process.join(10)
        if self._process.is_alive():
            self._process.kill()

    def fault(self, side: str, name: str, value: Any) -> None:
        """Set a field of the camera's `Faults`."""
        self._tell("fault", side, name, value)

    def switch_off(self, side: str) -> None:
        """Power off."""
        self._tell("off", side)

    def switch_on(self, side: str, serial: str = "") -> None:
        """Power on: a camera that knows nobody. serial : of another camera that was put there."""
        self._tell("on", side, serial)

    def take(self, side: str) -> None:
        """Another program takes control of a camera."""
        self._tell("take", side)

    def release(self, side: str) -> None:
        """And gives it back."""
        self._tell("release", side)

    def pulse(self) -> None:
        """A sensor's pulse, on Line1 of both cameras."""
        self._tell("pulse")

    def _tell(self, *command: object) -> None:
        self._pipe.send(command)
        answer = self._pipe.recv()
        if answer != "done":
            raise RuntimeError(answer)


class _Cameras:
    """What the process does."""

    def __init__(self) -> None:
        self._cameras: dict[str, GigeCamera] = {}
        for side in ADDRESSES:
            self.on(side, "")
        # what the left one shows, the right one hears: for the trigger mode "chain"
        self._cameras["left"].line("Line2").feeds(self._cameras["right"].line("Line1"))

    def fault(self, side: str, name: str, value: Any) -> None:
        setattr(self._cameras[side].faults, name, value)

    def off(self, side: str) -> None:
        self._cameras[side].stop()

    def on(self, side: str, serial: str) -> None:
        def exposure(request: ExposureRequest) -> Image:
            return stamped(side, request.exposed_ns)

        camera = GigeCamera(ADDRESSES[side], serial or f"BENCH-{side}", exposure, size=(WIDTH, HEIGHT))
        camera.start()
        self._cameras[side] = camera

    def take(self, side: str) -> None:
        self._cameras[side].steal_control()

    def release(self, side: str) -> None:
        self._cameras[side].release_control()

    def pulse(self) -> None:
        at_ns = time.monotonic_ns()
        for camera in self._cameras.values():
            camera.line("Line1").pulse(at_ns=at_ns)

    def stop(self) -> None:
        for camera in self._cameras.values():
            camera.stop()


def _serve(pipe: Connection) -> None:
    logging.disable(logging.WARNING)
    threading.current_thread().name = "cameras"
    cameras = _Cameras()
    pipe.send("done")
    while True:
        what, *arguments = pipe.recv()
        if what == "stop":
            cameras.stop()
            return
        try:
            getattr(cameras, what)(*arguments)
            pipe.send("done")
        except Exception as error:  # noqa: BLE001  (told to who asked)
            pipe.send(f"{what}: {error!r}")
