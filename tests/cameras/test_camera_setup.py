"""Settings that a camera gets, and refusals, with the real Aravis over real UDP."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from helpers.gigecell import (
    HEIGHT,
    LEFT,
    NOBODY,
    RIGHT,
    WIDTH,
    Cell,
    closing,
    left_camera,
    opened,
    opens,
    running,
    shoot,
)
from helpers.needs import needs_aravis

from edged.adapters.aravis import AravisCamera, AravisSettings, FreeRun
from edged.adapters.aravis.library import library
from edged.app.cameras import camera_facts, camera_figures, head_of
from edged.cell.stereohead import HeadSettings, StereoHead
from edged.config.cameras import CamerasSection
from edged.domain.frames import FramePair, TimeBase
from edged.errors import CameraSetupError, FrameIncomplete, FrameUnpaired, WrongCamera
from edged.sim.gige import genicam as g
from edged.vision.kernels.pixelformats import FORMATS

pytestmark = needs_aravis()


@pytest.fixture
def cell() -> Iterator[Cell]:
    """A running cell."""
    with running(Cell()) as cell:
        yield cell


async def refused(kind: type[CameraSetupError] = CameraSetupError, **settings: Any) -> str:
    """The reason why the camera cannot be opened with these settings."""
    with pytest.raises(kind) as caught:
        await opens(left_camera(**settings))
    return str(caught.value)


def test_format_codes_are_those_that_aravis_knows() -> None:
    """Every format that Aravis names has the same PFNC number there."""
    aravis = library("left").aravis
    known = {
        name.removeprefix("PIXEL_FORMAT_").replace("_", ""): int(getattr(aravis, name))
        for name in dir(aravis)
        if name.startswith("PIXEL_FORMAT_")
    }
    ours = {name.upper(): pixels.code for name, pixels in FORMATS.items() if name.upper() in known}

    assert len(ours) >= 20
    assert {name: known[name] for name in ours} == ours


# --- identity -----------------------------------------------------------------------------------------


@pytest.mark.slow
async def test_another_camera_than_the_expected_is_refused(cell: Cell) -> None:
    """A camera with another serial number is refused with both numbers."""
    reason = await refused(WrongCamera, serial="EDGED-T2")

    assert "camera left: 127.0.40.1 has the serial number 'EDGED-T1', expected 'EDGED-T2'" == reason


@pytest.mark.slow
async def test_the_expected_camera_opens(cell: Cell) -> None:
    """The camera with the expected serial number is opened."""
    await opens(left_camera(serial="EDGED-T1"))


@pytest.mark.long
async def test_a_camera_whose_address_has_changed_is_found_by_its_serial_number(
    cell: Cell, caplog: pytest.LogCaptureFixture
) -> None:
    """If nobody answers at the address, the camera is found by its serial number, and the log has both
    addresses."""
    async with opened(left_camera(NOBODY, serial="EDGED-T1")) as camera:
        frame = await shoot(camera)

    cell.left_sensor.saw(frame.image)
    assert f"{NOBODY} does not answer, but EDGED-T1 does at {LEFT}" in caplog.text


# --- geometry -----------------------------------------------------------------------------------------


@pytest.mark.slow
async def test_a_region_is_put_back_in_its_place(cell: Cell) -> None:
    """A region is placed in the full image, with black around it."""
    region = {"Width": 160, "Height": 100, "OffsetX": 32, "OffsetY": 20}
    async with opened(left_camera(calibrated=(WIDTH, HEIGHT), features=(region,))) as camera:
        frame = await shoot(camera)

    (shown,) = cell.left_sensor.shown.values()
    whole = np.zeros((HEIGHT, WIDTH), np.uint8)
    whole[20:120, 32:192] = shown
    np.testing.assert_array_equal(whole, frame.image)


@pytest.mark.slow
async def test_a_size_that_was_not_calibrated_is_refused(cell: Cell) -> None:
    """An image size other than the calibrated one is refused with both sizes."""
    reason = await refused(calibrated=(1280, 960))

    assert f"its image is {WIDTH}x{HEIGHT} px, the rig was calibrated with 1280x960" in reason


@pytest.mark.slow
async def test_a_region_that_another_program_left_behind_is_refused(cell: Cell) -> None:
    """An offset that another program left is refused unless it is configured."""
    cell.left.registers.put(g.WIDTH, 160)
    cell.left.registers.put(g.OFFSET_X, 32)

    assert "OffsetX is 32: an image that lies otherwise than at calibration" in await refused()
    stated = ({"Width": 160, "OffsetX": 32},)
    await opens(left_camera(features=stated))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["TriggerMode", "TriggerSource", "AcquisitionMode"])
async def test_the_trigger_is_not_set_behind_its_back(cell: Cell, name: str) -> None:
    """Features of the trigger are refused by name."""
    assert f"{name}: belongs to the trigger" in await refused(features=({name: "Off"},))


@pytest.mark.slow
async def test_groups_of_features_are_written_one_after_another(cell: Cell) -> None:
    """The later group of features counts, and an error in it prevents writing the first."""
    await opens(left_camera(features=({"Gain": 3.0}, {"Gain": 5.0})))
    assert 5.0 == cell.left.registers.number(g.GAIN)

    assert "Nonsense: the camera has no such feature" in await refused(
        features=({"Gain": 7.0}, {"Nonsense": 1})
    )
    assert 5.0 == cell.left.registers.number(g.GAIN)


# --- the network ----------------------------------------------------------------------------------------


@pytest.mark.slow
async def test_the_packet_delay_reaches_the_camera(cell: Cell) -> None:
    """The packet delay is in ticks of the camera's clock, and 0 on loopback by default."""
    await opens(left_camera(neighbour=RIGHT))
    assert 0 == cell.left.registers.word(g.PACKET_DELAY)

    await opens(left_camera(packet_delay_us=12.5))
    assert 12_500 == cell.left.registers.word(g.PACKET_DELAY)


@pytest.mark.slow
async def test_health_tells_temperature_clock_and_counts(cell: Cell) -> None:
    """After five images health has the sensor's temperature, five complete, none failed, and the clock's
    bound."""
    async with closing(left_camera()) as camera:
        assert camera.health is None
        await camera.open()
        for _ in range(5):
            await shoot(camera)
        health = camera.health
        assert health is not None
        assert (41.5, 5, 0) == (health.temperature_c, health.complete, health.failed)
        assert (0, 0) == (health.resent, health.lost)
        assert health.clock_bound_ns is not None
        assert 0 < health.clock_bound_ns < 10_000_000


def texts_of(head: StereoHead) -> dict[str, list[str]]:
    """The English text for each camera."""
    return {camera: [part["text"] for part in parts] for camera, parts in camera_facts(head).items()}


@pytest.mark.slow
async def test_the_status_page_and_the_metrics_show_how_cameras_are(cell: Cell) -> None:
    """Closed cameras are shown as not connected; open ones with temperature, clock, images and packets."""
    section = CamerasSection.model_validate({"left": {"device": LEFT}, "right": {"device": RIGHT}})
    async with closing(head_of(section)) as head:
        assert {"left": ["not connected"], "right": ["not connected"]} == texts_of(head)
        assert {} == camera_figures(head)
        await head.open()
        facts, figures = texts_of(head), camera_figures(head)
        assert {"left", "right"} == set(facts)
        assert "41.5 °C" == facts["left"][0]
        assert facts["left"][1].startswith("clock: free-running, ±")
        assert 41.5 == figures["camera_right_temperature_celsius"][1]
        assert 0.0 < figures["camera_left_clock_bound_seconds"][1] < 0.1
        assert 0 == figures["camera_left_images"][1]


# --- time ---------------------------------------------------------------------------------------------


@pytest.mark.slow
async def test_the_time_of_an_exposure_is_within_its_stated_bound(cell: Cell) -> None:
    """The time from the camera's stamp is within its stated bound of the simulator's truth."""
    async with opened(left_camera()) as camera:
        frames = [await shoot(camera) for _ in range(10)]

    for frame, request in zip(frames, cell.left_sensor.requests, strict=True):
        assert TimeBase.CAMERA is frame.time_base
        assert frame.exposed_bound_ns is not None
        # both clocks of the sensor are read one after the other: a busy machine may come between
        assert abs(frame.exposed_ns - request.exposed_ns) <= frame.exposed_bound_ns + 5_000_000


# --- free run -------------------------------------------------------------------------------------------


@pytest.mark.slow
async def test_free_running_cameras_give_pairs_exposed_after_the_request(cell: Cell) -> None:
    """Each capture is a new pair of one moment, exposed after the request."""
    head = StereoHead(
        left_camera(trigger=FreeRun(20.0)),
        AravisCamera("right", AravisSettings(RIGHT, trigger=FreeRun(20.0))),
        HeadSettings(timeout_s=5, max_skew_s=0.03, free_running=True),
    )
    async with closing(head):
        pairs = []
        for _ in range(5):
            await asyncio.sleep(0.12)  # two exposures without a request
            pairs.append(await head.capture())

    assert 20.0 == cell.left.registers.number(g.FRAME_RATE)
    steps = np.diff([pair.left.frame_id for pair in pairs])
    assert (steps >= 2).all()
    for pair in pairs:
        assert abs(pair.left.exposed_ns - pair.right.exposed_ns) <= 30_000_000
        cell.left_sensor.saw(pair.left.image)
        cell.right_sensor.saw(pair.right.image)


@pytest.mark.slow
async def test_what_a_free_running_camera_exposed_just_before_the_request_is_old(cell: Cell) -> None:
    """With an exposure every 10 ms no frame from before the request is used."""
    camera, since_ms = left_camera(trigger=FreeRun(100.0)), []
    await camera.open()
    try:
        for number in range(40):
            await asyncio.sleep(0.0203)  # another phase of the camera's period each time
            asked_ns = time.time_ns()
            await camera.trigger()
            shown = cell.left_sensor.saw((await camera.frame()).image)
            if number > 0:  # of the first connection's clock nothing is known
                exposed_ns = next(r.exposed_ns for r in cell.left_sensor.requests if r.frame_id == shown)
                since_ms.append((exposed_ns - asked_ns) * 1e-6)
    finally:
        await camera.close()
    assert min(since_ms) > 0


@pytest.mark.slow
async def test_free_running_cameras_can_only_be_listened_to(cell: Cell) -> None:
    """Listening gives each exposure in order and none twice."""
    head = StereoHead(
        left_camera(trigger=FreeRun(20.0)),
        AravisCamera("right", AravisSettings(RIGHT, trigger=FreeRun(20.0))),
        HeadSettings(timeout_s=5, max_skew_s=0.1),
    )
    async with closing(head):
        pairs: list[FramePair] = []
        while len(pairs) < 8:
            # a camera that a busy machine holds up skips exposures: those of the other have no partner
            with contextlib.suppress(FrameUnpaired, FrameIncomplete):
                pairs.append(await head.listen())

    for side in ("left", "right"):
        assert (np.diff([getattr(pair, side).frame_id for pair in pairs]) >= 1).all()
