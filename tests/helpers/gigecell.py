"""Simulated GigE Vision cameras for tests of the camera adapter, and helpers that drive it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any, Protocol, TypeVar

import numpy as np

from edged.adapters.aravis import AravisCamera, AravisSettings
from edged.cell.stereohead import StereoHead
from edged.domain.arrays import Image
from edged.domain.frames import Frame
from edged.errors import CaptureError
from edged.sim.exposure import ExposureRequest
from edged.sim.gige.camera import GigeCamera

WIDTH, HEIGHT = 320, 240
LEFT, RIGHT = "127.0.40.1", "127.0.40.2"
NOBODY = "127.0.40.9"


class Sensor:
    """Renders noise and remembers every picture by its frame id."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self.shown: dict[int, Image] = {}
        self.requests: list[ExposureRequest] = []

    def __call__(self, request: ExposureRequest) -> Image:
        image = self._random.integers(0, 256, (request.height, request.width), dtype=np.uint8)
        self.shown[request.frame_id] = image
        self.requests.append(request)
        return image

    def saw(self, image: Image) -> int:
        """Frame id of a picture; fails if it was never shown."""
        known = list(self.shown.items())  # a free-running camera goes on exposing meanwhile
        return next(number for number, shown in known if np.array_equal(shown, image))


def gige_camera(
    address: str, serial: str, sensor: Sensor, width: int = WIDTH, height: int = HEIGHT, **options: Any
) -> GigeCamera:
    """A simulated GigE Vision camera, to be entered as a context."""
    return GigeCamera(address, serial, sensor, size=(width, height), **options)


class Cell:
    """Two simulated cameras. options : of the left one."""

    def __init__(self, **options: Any) -> None:
        self.left_sensor, self.right_sensor = Sensor(1), Sensor(2)
        self.left = gige_camera(LEFT, "EDGED-T1", self.left_sensor, **options)
        self.right = gige_camera(RIGHT, "EDGED-T2", self.right_sensor)


@contextmanager
def running(cell: Cell) -> Iterator[Cell]:
    """The cell with both cameras switched on."""
    with cell.left, cell.right:
        yield cell


def left_camera(device: str = LEFT, **settings: Any) -> AravisCamera:
    """The adapter under test."""
    return AravisCamera("left", AravisSettings(device, **settings))


class Closes(Protocol):
    """Anything that opens and closes: a camera or a head."""

    async def open(self) -> None:
        """Connect."""

    async def close(self) -> None:
        """Release it."""


C = TypeVar("C", bound=Closes)


@asynccontextmanager
async def closing(camera: C) -> AsyncIterator[C]:
    """A camera (or head) that is closed afterwards."""
    try:
        yield camera
    finally:
        await camera.close()


@asynccontextmanager
async def opened(camera: C) -> AsyncIterator[C]:
    """An open camera (or head) that is closed afterwards."""
    async with closing(camera):
        await camera.open()
        yield camera


async def opens(camera: Closes) -> None:
    """Open it and close it again."""
    async with opened(camera):
        pass


async def shoot(camera: AravisCamera) -> Frame:
    """Trigger one exposure and return its frame."""
    await camera.trigger()
    return await camera.frame()


async def settles(
    camera: AravisCamera | StereoHead, action: Callable[[], Awaitable[Any]], limit_s: float
) -> Any:
    """First result without a `CaptureError`; any other exception fails the test."""
    deadline_s = time.monotonic() + limit_s
    while True:
        try:
            return await action()
        except CaptureError:
            assert time.monotonic() < deadline_s, "did not recover in time"
            await asyncio.sleep(0.05)
