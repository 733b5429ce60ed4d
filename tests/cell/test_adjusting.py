"""Exposure and gain through the stereo head: set, refused, undone; with in-process cameras."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.scriptedhead import Head

from edged.cell.lease.cameras import SetupCameras
from edged.cell.stereohead import HeadSettings, StereoHead
from edged.config.chosencameras import ChosenCamera
from edged.domain.arrays import Image
from edged.domain.exposure import CameraLimits, CameraValues
from edged.domain.frames import Frame, FramePair
from edged.errors import (
    CameraBusy,
    CameraSetupError,
    CameraUnreachable,
    CaptureError,
    FrameFrozen,
    FrameIncomplete,
    FrameTimeout,
    FrameUnpaired,
    StreamStalled,
)
from edged.sim.exposure import ExposureRequest
from edged.sim.inprocess import InProcessCamera


class Film:
    """Records the exposure and gain of each picture."""

    def __init__(self) -> None:
        self.exposed: list[tuple[float, float]] = []

    def __call__(self, request: ExposureRequest) -> Image:
        self.exposed.append((request.exposure_us, request.gain_db))
        return np.full((request.height, request.width), len(self.exposed), np.uint8)


def head_with(
    film: Film, backoff_s: float = 0.5
) -> tuple[StereoHead, tuple[InProcessCamera, InProcessCamera]]:
    """Two cameras, of which the left one's exposures are recorded."""
    size = {"width": 8, "height": 4}
    left = InProcessCamera("left", film, **size)
    right = InProcessCamera("right", Film(), **size)
    return StereoHead(left, right, HeadSettings(max_skew_s=0.05, min_backoff_s=backoff_s)), (left, right)


async def test_what_is_adjusted_counts_until_it_is_undone() -> None:
    """Adjusted values apply from the next picture on, and refused values change nothing."""
    film = Film()
    head, cameras = head_with(film)
    assert CameraLimits((10.0, 1e6), (0.0, 24.0)) == await head.limits("left")
    assert CameraValues(500.0, 0.0) == await head.adjust("left", CameraValues(500.0))
    assert CameraValues(2000.0, 0.0) == await head.adjust("right", CameraValues())
    with pytest.raises(CameraSetupError, match="gain_db: 25 is outside 0 to 24"):
        await head.adjust("left", CameraValues(700.0, 25.0))
    await head.capture()
    await head.restore()
    await head.capture()
    await head.close()
    assert [(500.0, 0.0), (2000.0, 0.0)] == film.exposed
    assert [1, 1] == [camera.opened for camera in cameras]


async def test_a_camera_that_is_gone_is_opened_again() -> None:
    """A camera that was closed fails once and is then opened again."""
    film = Film()
    head, (left, _) = head_with(film, backoff_s=0.0)
    await head.open()
    await left.close()
    with pytest.raises(CameraUnreachable):
        await head.adjust("left", CameraValues(500.0))
    assert CameraValues(500.0, 0.0) == await head.adjust("left", CameraValues(500.0))
    await head.close()
    assert 2 == left.opened


async def test_a_camera_that_has_no_exposure_says_so() -> None:
    """A source of pictures without exposure raises an error that says so."""

    class Picture:
        def __init__(self, name: str) -> None:
            self.name = name

        async def open(self) -> None: ...

        async def trigger(self) -> None: ...

        async def frame(self) -> Frame:
            return Frame(self.name, 1, np.zeros((4, 4), np.uint8), 0, 0)

        async def close(self) -> None: ...

    head = StereoHead(Picture("left"), Picture("right"))
    with pytest.raises(CameraSetupError, match="camera right: its exposure cannot be adjusted"):
        await head.limits("right")
    await head.restore()
    await head.close()


async def test_cameras_that_cannot_be_opened_leave_those_from_before() -> None:
    """If trial cameras cannot be opened, the earlier ones are used again, with all adjustments undone."""
    film = Film()
    head, _ = head_with(film)
    broken, (left, _) = head_with(Film())
    left.faults.open_error = CameraUnreachable("left", "cable")
    cameras = SetupCameras(lambda: True)
    await cameras.adjust(head, "left", CameraValues(500.0))
    assert {"left": ChosenCamera(exposure_us=500.0)} == cameras.changes
    with pytest.raises(CameraUnreachable):
        await cameras.exchange(head, broken, {"left": ChosenCamera(device="X")})
    assert {} == cameras.changes
    await cameras.capture(head, listens=False)
    await cameras.adjust(head, "left", CameraValues(gain_db=6.0))
    await cameras.release(head)
    await cameras.capture(head, listens=False)
    await cameras.release(head)
    assert [(2000.0, 0.0), (2000.0, 0.0)] == film.exposed


class Losing(Head):
    """A head whose first captures fail with these errors."""

    def __init__(self, *errors: CaptureError) -> None:
        super().__init__()
        self.errors = list(errors)

    async def capture(self) -> FramePair:
        if self.errors:
            raise self.errors.pop(0)
        return await super().capture()


@pytest.mark.parametrize("error", [FrameTimeout, FrameIncomplete, FrameUnpaired])
async def test_one_lost_image_is_exposed_again(error: type[CaptureError]) -> None:
    """A single lost image is captured again without an error; two in a row are a fault."""
    once, twice = Losing(error("left", "lost")), Losing(error("left", "lost"), error("left", "lost"))
    cameras = SetupCameras(lambda: True)
    pair = await cameras.capture(once, listens=False)
    assert 1 == pair.left.frame_id
    with pytest.raises(error):
        await cameras.capture(twice, listens=False)


@pytest.mark.parametrize("error", [CameraUnreachable, CameraBusy, StreamStalled, FrameFrozen])
async def test_a_fault_that_stays_is_said_at_once(error: type[CaptureError]) -> None:
    """A lasting fault is raised at once, without another exposure."""
    head = Losing(error("left", "cable"))
    with pytest.raises(error):
        await SetupCameras(lambda: True).capture(head, listens=False)
    assert 0 == head.captures
