"""Every trigger mode of two cameras, with the real Aravis over real UDP, from a configuration."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.gigecell import (
    LEFT,
    RIGHT,
    Cell,
    Sensor,
    closing,
    gige_camera,
    left_camera,
    opened,
    opens,
    running,
    shoot,
)
from helpers.needs import needs_aravis
from helpers.waiting import LIMIT_S
from pydantic import ValidationError

from edged.adapters.aravis import AravisCamera, LineTrigger, Output
from edged.adapters.aravis.clock import CLOCK_DRIFT
from edged.app.cameras import head_of
from edged.cell.pairing import Pairing
from edged.cell.stereohead import StereoHead
from edged.config.cameras import CamerasSection
from edged.domain.exposure import CameraValues
from edged.domain.frames import Frame, FramePair, TimeBase
from edged.errors import CameraSetupError, CaptureError, FrameIncomplete, FrameTimeout, FrameUnpaired
from edged.sim.gige import genicam as g
from edged.sim.gige.camera import ENCODER_NS
from edged.sim.gige.clock import DeviceClock
from edged.sim.gige.faults import Quirk

pytestmark = needs_aravis()

MS = 1_000_000


@pytest.fixture
def cell() -> Iterator[Cell]:
    """A running cell with different clocks."""
    with running(Cell()) as cell:
        cell.left.clock.drift_ppm, cell.right.clock.drift_ppm = 80.0, -60.0
        cell.left.clock.jump(1000.0)
        yield cell


def head_with(trigger: dict[str, Any], *, external: bool = False, **cameras: Any) -> StereoHead:
    """The head of a configuration with this trigger section.

    The limit of the skew is wide, because a busy machine runs two simulated cameras in turns. The test
    compares the pictures to see whether they are of one exposure.
    """
    section = CamerasSection.model_validate(
        {
            "left": {"device": LEFT},
            "right": {"device": RIGHT},
            "timeout_s": 3.0,
            "max_skew_ms": 400.0,
            "trigger": trigger,
            **cameras,
        }
    )
    return head_of(section, external=external)


def is_one_exposure(cell: Cell, pair: FramePair) -> bool:
    """Whether both pictures have the same number at both sensors."""
    return cell.left_sensor.saw(pair.left.image) == cell.right_sensor.saw(pair.right.image)


async def armed(cell: Cell) -> None:
    """Wait until both cameras take exposures."""
    deadline_s = time.monotonic() + LIMIT_S
    while not all(camera.controlled and camera.registers.acquiring for camera in (cell.left, cell.right)):
        assert time.monotonic() < deadline_s
        await asyncio.sleep(0.005)


def pulse(cell: Cell) -> None:
    """A pulse at Line1 of both cameras."""
    at_ns = time.monotonic_ns()
    for camera in (cell.left, cell.right):
        camera.line("Line1").pulse(at_ns=at_ns)


async def pairs_of(
    cell: Cell, head: StereoHead, count: int, expose: Callable[[Cell], None] | None = None
) -> list[FramePair]:
    """The pairs of this many captures; `expose` is called shortly after each command."""
    pairs = []
    async with closing(head):
        await head.open()
        for _ in range(count):
            capturing = asyncio.create_task(head.capture())
            if expose is not None:
                await asyncio.sleep(0.05)
                expose(cell)
            pairs.append(await capturing)
    return pairs


# --- lines ------------------------------------------------------------------------------------------------


@pytest.mark.slow
async def test_a_pulse_on_both_lines_is_one_exposure(cell: Cell) -> None:
    """Each pulse gives exactly one picture per camera, of the same instant, timed by the cameras' clocks."""
    pairs = await pairs_of(cell, head_with({"mode": "line", "line": "Line1"}), 4, pulse)

    assert (4, 4) == (cell.left.exposures, cell.right.exposures)
    assert g.LINE1 == cell.left.registers.word(g.TRIGGER_SOURCE)
    for pair in pairs:
        assert is_one_exposure(cell, pair)
        assert {TimeBase.CAMERA} == {pair.left.time_base, pair.right.time_base}


@pytest.mark.slow
async def test_edge_delay_and_debounce_reach_the_camera(cell: Cell) -> None:
    """The registers of the configured line have the configured edge, delay and debounce time."""
    trigger = {"mode": "line", "line": "Line3", "edge": "falling", "delay_us": 150, "debounce_us": 40}
    await opens(head_with(trigger))

    assert (g.LINE3, g.FALLING) == (
        cell.left.registers.word(g.TRIGGER_SOURCE),
        cell.left.registers.word(g.TRIGGER_ACTIVATION),
    )
    assert 150.0 == cell.left.registers.number(g.TRIGGER_DELAY)
    assert 40.0 == cell.left.registers.number(g.LINE_DEBOUNCER + 4 * g.LINES["Line3"])
    assert 0 == cell.left.registers.word(g.LINE_MODE + 4 * g.LINES["Line3"])


@pytest.mark.slow
async def test_a_pulse_before_the_command_is_not_its_exposure(cell: Cell) -> None:
    """A picture from before the command is not used."""
    async with opened(head_with({"mode": "line"})) as head:
        await armed(cell)
        pulse(cell)
        await asyncio.sleep(0.1)
        capturing = asyncio.create_task(head.capture())
        await asyncio.sleep(0.05)
        pulse(cell)
        pair = await capturing

    assert 2 == cell.left_sensor.saw(pair.left.image) == cell.right_sensor.saw(pair.right.image)


@pytest.mark.slow
async def test_no_pulse_is_a_time_out(cell: Cell) -> None:
    """Without a pulse, the fault names both cameras."""
    async with closing(head_with({"mode": "line"}, timeout_s=0.3)) as head:
        with pytest.raises(FrameTimeout, match=r"both cameras: no trigger came within 0\.3 s"):
            await head.capture()


@pytest.mark.slow
async def test_each_pulse_from_outside_is_heard_in_order(cell: Cell) -> None:
    """With an external trigger five pulses 100 ms apart give five pairs, in order."""
    async with opened(head_with({"mode": "line"}, external=True)) as head:
        await armed(cell)
        loop = asyncio.get_running_loop()
        for number_ in range(5):
            loop.call_later(0.1 * number_, pulse, cell)
        pairs = [await head.listen() for _ in range(5)]

    assert [1, 2, 3, 4, 5] == [cell.left_sensor.saw(pair.left.image) for pair in pairs]
    assert all(is_one_exposure(cell, pair) for pair in pairs)
    assert 0 == sum(pair.missed for pair in pairs)


@pytest.mark.slow
async def test_a_pulse_that_one_camera_did_not_get_is_a_fault_and_the_next_a_pair(cell: Cell) -> None:
    """A pulse that one camera misses is a fault, and the next pulse gives a pair of its own."""
    async with opened(head_with({"mode": "line"}, external=True, timeout_s=1.0)) as head:
        await armed(cell)
        cell.left.line("Line1").pulse()
        with pytest.raises(FrameUnpaired, match="camera right: no partner for frame 1 of left"):
            await head.listen()
        pulse(cell)
        pair = await head.listen()

    assert (2, 1) == (cell.left_sensor.saw(pair.left.image), cell.right_sensor.saw(pair.right.image))


# --- chain ------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("first", ["left", "right"])
async def test_one_camera_triggers_the_other(cell: Cell, first: str) -> None:
    """The first camera's exposure-active output triggers the other one: one instant, one software command."""
    leader, follower = (cell.left, cell.right) if first == "left" else (cell.right, cell.left)
    leader.line("Line2").feeds(follower.line("Line1"))

    pairs = await pairs_of(cell, head_with({"mode": "chain", "first": first}), 4)

    assert all(is_one_exposure(cell, pair) for pair in pairs)
    assert (4, 4) == (cell.left.exposures, cell.right.exposures)
    assert g.EXPOSURE_ACTIVE == leader.registers.word(g.LINE_SOURCE + 4 * g.LINES["Line2"])
    assert (g.SOFTWARE, g.LINE1) == (
        leader.registers.word(g.TRIGGER_SOURCE),
        follower.registers.word(g.TRIGGER_SOURCE),
    )


@pytest.mark.slow
async def test_a_broken_wire_of_the_chain_names_the_camera_that_saw_nothing(cell: Cell) -> None:
    """If the wire of the chain is broken, the fault names the second camera."""
    async with closing(head_with({"mode": "chain"}, timeout_s=1.0)) as head:
        with pytest.raises(FrameTimeout, match=r"camera right: no image within 1 s"):
            await head.capture()


# --- action commands --------------------------------------------------------------------------------------


KEYS = {"mode": "action", "device_key": 0xCAFE, "group_key": 2, "group_mask": 4}


@pytest.mark.slow
@pytest.mark.parametrize("broadcast", ["", "127.255.255.255"], ids=["unicast", "broadcast"])
async def test_one_action_command_exposes_both(cell: Cell, broadcast: str) -> None:
    """One action command, to each camera or by broadcast, exposes both."""
    trigger = {**KEYS, "broadcast": broadcast} if broadcast else KEYS
    pairs = await pairs_of(cell, head_with(trigger), 4)

    assert all(is_one_exposure(cell, pair) for pair in pairs)
    assert (4, 4) == (cell.left.exposures, cell.right.exposures)
    assert 0xCAFE == cell.left.registers.word(g.ACTION_DEVICE_KEY)


@pytest.mark.slow
async def test_a_scheduled_action_exposes_both_at_the_same_ptp_time(cell: Cell) -> None:
    """With a scheduled action both time stamps are equal up to the clocks' error."""
    trigger = {**KEYS, "lead_ms": 400}
    head = head_with(trigger, ptp=True, max_skew_ms=0.2)
    pairs = await pairs_of(cell, head, 3)

    for pair in pairs:
        assert is_one_exposure(cell, pair)
        assert {TimeBase.PTP} == {pair.left.time_base, pair.right.time_base}
        skew = Pairing(0.0002, 0.05).skew(pair.left, pair.right)
        assert ("exposures by PTP", True) == (skew.what, abs(skew.ns) < 100_000)


@pytest.mark.slow
async def test_a_schedule_without_ptp_is_refused_with_the_reason(cell: Cell) -> None:
    """A schedule without PTP is refused with the reason."""
    async with closing(head_with({**KEYS, "lead_ms": 50})) as head:
        with pytest.raises(FrameTimeout, match="a scheduled action needs PTP, and its clock is not locked"):
            await head.capture()


@pytest.mark.slow
async def test_a_schedule_that_is_too_short_is_told(cell: Cell) -> None:
    """A lead of a tenth of a microsecond is refused as too short."""
    async with closing(head_with({**KEYS, "lead_ms": 0.0001}, ptp=True)) as head:
        with pytest.raises(FrameTimeout, match="too late: its lead is too short"):
            await head.capture()


# --- strobe, formats, quirks, time ------------------------------------------------------------------------


@pytest.mark.slow
async def test_the_strobe_line_shows_the_exposure(cell: Cell) -> None:
    """The strobe line is high exactly during the exposure."""
    edges: list[tuple[bool, int]] = []
    cell.left.line("Line2").listen(lambda level, at_ns: edges.append((level, at_ns)))
    async with opened(left_camera(exposure_us=3000.0, outputs=(Output("Line2"),))) as camera:
        await shoot(camera)

    (up, up_ns), (down, down_ns) = edges
    assert (True, False) == (up, down)
    assert 3 * MS == down_ns - up_ns


@pytest.mark.slow
@pytest.mark.parametrize("name", g.PIXEL_FORMATS)
async def test_every_format_arrives_as_the_sensor_saw_it(cell: Cell, name: str) -> None:
    """Every format gives the same grey values; a mosaic has the brightness of the picture."""
    async with opened(left_camera(features=({"PixelFormat": name},))) as camera:
        frame = await shoot(camera)

    (shown,) = cell.left_sensor.shown.values()
    if name.startswith("Bayer"):
        assert abs(float(frame.image.mean()) - float(shown.mean())) < 1.0
    else:
        np.testing.assert_array_equal(shown, frame.image)


@pytest.mark.slow
@pytest.mark.parametrize(
    "quirk", [Quirk.MODE_BEFORE_SOURCE, Quirk.SOURCE_CLEARS_MODE, Quirk.EXPOSURE_TIME_ABS]
)
async def test_firmware_with_habits_is_triggered_all_the_same(quirk: Quirk) -> None:
    """Firmware with quirks is set up and triggered."""
    with running(Cell(quirks=(quirk,))) as cell:
        async with opened(left_camera(exposure_us=1500.0)) as camera:
            await shoot(camera)
        assert [1500.0] == [request.exposure_us for request in cell.left_sensor.requests]


@pytest.mark.slow
async def test_a_clamped_exposure_is_named() -> None:
    """An exposure that the camera clamps is an error with both values."""
    with running(Cell(quirks=(Quirk.CLAMPED_EXPOSURE,))):
        async with closing(left_camera(exposure_us=20000.0)) as camera:
            with pytest.raises(CameraSetupError, match=r"ExposureTime: the camera made 10000\.0 of 20000\.0"):
                await camera.open()


@pytest.mark.slow
async def test_a_camera_with_few_nodes_is_triggered_by_software() -> None:
    """A camera without lines, chunks, PTP and temperature is triggered by software."""
    with running(Cell(quirks=(Quirk.FEW_NODES,))) as cell:
        async with opened(left_camera(exposure_us=1500.0, gain_db=1.0)) as camera:
            frame = await shoot(camera)
        assert 1 == cell.left_sensor.saw(frame.image)


@pytest.mark.slow
async def test_an_exposure_that_changed_behind_our_back_is_a_fault(cell: Cell) -> None:
    """With chunk data, another exposure time than the set one is a fault."""
    async with opened(left_camera(exposure_us=2000.0, chunks=True)) as camera:
        await shoot(camera)
        cell.left.registers.put(g.EXPOSURE_TIME, 900.0)
        with pytest.raises(FrameIncomplete, match="exposed for 900 us, not 2000 us"):
            await shoot(camera)


@pytest.mark.slow
@pytest.mark.parametrize("chunks", [True, False])
async def test_an_encoders_count_comes_with_the_image_of_its_exposure(cell: Cell, chunks: bool) -> None:
    """The count is that of its exposure, with or without the chunk of the exposure time, and becomes the
    pair's."""
    sides = {"left": {"device": LEFT, "count": "EncoderValue"}, "right": {"device": RIGHT}}
    timing = {"timeout_s": 5.0, "max_skew_ms": 1000.0, "chunks": chunks}
    async with closing(
        head_of(CamerasSection.model_validate({"source": "aravis", **timing, **sides}))
    ) as head:
        pairs = [await head.capture() for _ in range(3)]

    assert [request.device_ns // ENCODER_NS for request in cell.left_sensor.requests] == [
        pair.count for pair in pairs
    ]
    assert [None] * 3 == [pair.right.count for pair in pairs]


@pytest.mark.parametrize(
    ("cameras", "trouble"),
    [
        ({"right": {"device": RIGHT, "count": "EncoderValue"}}, "count: of one camera only"),
        ({"source": "replay", "folder": Path("pairs")}, "count: needs cameras, not source 'replay'"),
        (
            {
                "exposure_ratio": 8,
                "left": {"device": LEFT, "exposure_us": 1, "count": "CounterValue"},
                "right": {"device": RIGHT, "exposure_us": 1},
            },
            "count: not with exposure_ratio",
        ),
        ({"left": {"device": LEFT, "count": "FrameID"}}, "Input should be"),
    ],
)
def test_a_count_is_of_one_camera_and_one_exposure(cameras: dict[str, Any], trouble: str) -> None:
    """A count of both cameras, of a replay, with two exposures or by an unknown name is refused."""
    left = {"device": LEFT, "count": "EncoderValue"}
    with pytest.raises(ValidationError, match=trouble):
        CamerasSection.model_validate({"left": left, "right": {"device": RIGHT}, **cameras})


@pytest.mark.slow
async def test_a_count_that_a_camera_cannot_send_is_refused_by_name(cell: Cell) -> None:
    """A count that the camera's chunk data cannot give is refused with the reason."""

    async def refused(trouble: str, count: str) -> None:
        async with closing(left_camera(count=count)) as camera:
            with pytest.raises(CaptureError, match=trouble):
                await camera.open()
                await shoot(camera)

    offers = "ChunkSelector offers FrameID, Timestamp, ExposureTime, EncoderValue"
    await refused(f"count: it cannot send CounterValue with an image: {offers}", count="CounterValue")
    for quirk, trouble in (
        (Quirk.FEW_NODES, "it has no ChunkSelector"),
        (Quirk.OLD_CHUNKS, "leave out count for this"),
    ):
        cell.left.stop()
        with gige_camera(LEFT, "EDGED-T3", Sensor(1), quirks=(quirk,)):
            await refused(trouble, count="EncoderValue")
        cell.left.start()


@pytest.mark.slow
@pytest.mark.parametrize("configured", [True, False])
async def test_an_exposure_of_a_pulse_is_timed_by_the_camera_however_long_it_is(
    cell: Cell, configured: bool
) -> None:
    """With an exposure of 0.4 s the time stamp of a pulse is right within its bound, also after an
    adjustment."""

    async def shot(camera: AravisCamera) -> Frame:
        await camera.trigger()
        cell.left.line("Line1").pulse()
        return await camera.frame()

    exposure = {"exposure_us": 1000.0} if configured else {}
    async with opened(left_camera(trigger=LineTrigger("Line1"), **exposure)) as camera:
        if configured:
            await shot(camera)
        await camera.adjust(CameraValues(exposure_us=400_000.0))
        cell.left.faults.delay_s = 0.4
        frames = [await shot(camera) for _ in range(2)]
    for frame, request in zip(frames, cell.left_sensor.requests[-2:], strict=True):
        assert frame.time_base is TimeBase.CAMERA
        assert frame.exposed_bound_ns is not None
        assert abs(frame.exposed_ns - request.exposed_ns) <= frame.exposed_bound_ns + 5 * MS
        assert frame.exposed_bound_ns < 100 * MS


@pytest.mark.slow
@pytest.mark.parametrize("tick_hz", [125_000_000, 1_000])
async def test_coarse_clocks_are_mapped_within_their_bound(tick_hz: int) -> None:
    """With clock ticks of 8 ns or a millisecond the truth is within the stated bound."""
    with running(Cell(clock=DeviceClock(offset_s=5000.0, drift_ppm=90.0, tick_hz=tick_hz))) as cell:
        async with opened(left_camera()) as camera:
            frames = [await shoot(camera) for _ in range(6)]
        for frame, request in zip(frames, cell.left_sensor.requests, strict=True):
            assert frame.exposed_bound_ns is not None
            assert abs(frame.exposed_ns - request.exposed_ns) <= frame.exposed_bound_ns + 5 * MS
            assert frame.exposed_bound_ns >= 10**9 / tick_hz / 2


@pytest.mark.slow
async def test_a_clock_that_runs_too_fast_is_one_line_of_the_log(caplog: pytest.LogCaptureFixture) -> None:
    """A clock that runs ten times too fast is mapped anew with each reading, and logged once."""
    with running(Cell(clock=DeviceClock(drift_ppm=2e7 * CLOCK_DRIFT, tick_hz=10**9))) as cell:
        frames = []
        async with opened(left_camera()) as camera:
            for _ in range(6):
                await asyncio.sleep(0.1)  # so far that the readings contradict each other
                frames.append(await shoot(camera))
        for frame, request in zip(frames, cell.left_sensor.requests, strict=True):
            assert abs(frame.exposed_ns - request.exposed_ns) < 50 * MS

    (line,) = (line for line in caplog.messages if "clock has jumped" in line)
    assert "more than 200 ppm off" in line


@pytest.mark.slow
async def test_a_clock_that_jumps_is_mapped_anew(cell: Cell) -> None:
    """After the clock was set back by 500 s images are timed within 50 ms, by the camera's clock again."""
    async with opened(left_camera()) as camera:
        frames = [await shoot(camera)]
        cell.left.clock.jump(-500.0)
        frames += [await shoot(camera) for _ in range(3)]

    for frame, request in zip(frames, cell.left_sensor.requests, strict=True):
        assert abs(frame.exposed_ns - request.exposed_ns) < 50 * MS
    assert TimeBase.CAMERA is frames[-1].time_base
