"""Two virtual GigE Vision cameras in a process of their own, whose pictures contain their time of exposure.

For `tools/bench_cameras.py`: the cameras' work is not in the receiver's figures, and a picture that is torn,
old, or not of the same exposure as the other one is detected, whatever the receiver reports.
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
"""Number of grey values of the pattern; a prime, so that it divides no packet size."""
STAMP = struct.Struct(">qB")

_Y, _X = np.mgrid[: HEIGHT + GREYS, :WIDTH]
_PATTERN: Image = ((_X + _Y) % GREYS).astype(np.uint8)


def stamped(side: str, exposed_ns: int) -> Image:
    """Picture (HEIGHT, WIDTH): a pattern that starts elsewhere each time; time and side in its first row."""
    start = exposed_ns // 1000 % GREYS
    image = _PATTERN[start : start + HEIGHT].copy()
    image[0, : STAMP.size] = np.frombuffer(STAMP.pack(exposed_ns, side == "left"), np.uint8)
    return image


def exposed_ns_of(side: str, image: Image) -> int | None:
    """True time of a picture's exposure, host UTC ns; None unless all its pixels belong to that exposure."""
    exposed_ns, is_left = STAMP.unpack(image[0, : STAMP.size].tobytes())
    whole = is_left == (side == "left") and np.array_equal(image, stamped(side, exposed_ns))
    return int(exposed_ns) if whole else None


class CameraWorld:
    """The cameras' process; a context manager. Commands return once they have been carried out."""

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
        """Switch the power off."""
        self._tell("off", side)

    def switch_on(self, side: str, serial: str = "") -> None:
        """Switch the power on: the camera has lost its state. serial : of another camera in its place."""
        self._tell("on", side, serial)

    def take(self, side: str) -> None:
        """Let another program take control of a camera."""
        self._tell("take", side)

    def release(self, side: str) -> None:
        """Release the control taken by `take`."""
        self._tell("release", side)

    def pulse(self) -> None:
        """Send a sensor's pulse to Line1 of both cameras."""
        self._tell("pulse")

    def _tell(self, *command: object) -> None:
        self._pipe.send(command)
        answer = self._pipe.recv()
        if answer != "done":
            raise RuntimeError(answer)


class _Cameras:
    """The cameras, in their process."""

    def __init__(self) -> None:
        self._cameras: dict[str, GigeCamera] = {}
        for side in ADDRESSES:
            self.on(side, "")
        # the left camera's output drives the right one's input: for the trigger mode "chain"
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
        except Exception as error:  # noqa: BLE001  (reported to the caller)
            pipe.send(f"{what}: {error!r}")
