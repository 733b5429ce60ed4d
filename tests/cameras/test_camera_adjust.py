"""Exposure and gain while images are taken, with the real Aravis over real UDP: adjusted, and restored."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator

import pytest
from helpers.gigecell import Cell, left_camera, opened, running, shoot
from helpers.needs import needs_aravis
from helpers.scriptedhead import Ear, make_setup
from helpers.waiting import until

from edged.adapters.aravis import AravisCamera, AravisSettings
from edged.cell.cycle import Cycle
from edged.cell.stereohead import StereoHead
from edged.config.chosencameras import ChosenCamera
from edged.domain.cell import CellPhase
from edged.domain.exposure import CameraLimits, CameraValues
from edged.errors import CameraSetupError, CaptureError
from edged.sim.gige import genicam as g
from edged.sim.gige.faults import Quirk

pytestmark = needs_aravis()


@pytest.fixture
def cell() -> Iterator[Cell]:
    """A running cell."""
    with running(Cell()) as cell:
        yield cell


def held(cell: Cell) -> tuple[float, float]:
    """The left camera's registers: exposure time in us, gain in dB."""
    registers = cell.left.registers
    return registers.number(g.EXPOSURE_TIME), registers.number(g.GAIN)


@pytest.mark.slow
async def test_the_next_picture_is_exposed_as_adjusted(cell: Cell) -> None:
    """The next picture has the adjusted values without a new connection, others stay, and the limits are
    the camera's."""
    async with opened(left_camera()) as camera:
        assert CameraLimits((10.0, 1e6), (0.0, 24.0)) == await camera.limits()
        await shoot(camera)
        assert CameraValues(750.0, 0.0) == await camera.adjust(CameraValues(exposure_us=750.0))
        assert CameraValues(750.0, 3.5) == await camera.adjust(CameraValues(gain_db=3.5))
        await shoot(camera)
        assert CameraValues(750.0, 3.5) == await camera.adjust(CameraValues())
        requests = [(request.exposure_us, request.gain_db) for request in cell.left_sensor.requests]
        assert [(2000.0, 0.0), (750.0, 3.5)] == [requests[0], requests[-1]]
        assert [*range(1, 5)] == [request.frame_id for request in cell.left_sensor.requests][:4]


@pytest.mark.slow
async def test_what_the_camera_does_not_take_changes_nothing(cell: Cell) -> None:
    """A value out of range is refused with its limits before anything is written, and the camera goes on."""
    async with opened(left_camera()) as camera:
        with pytest.raises(CameraSetupError, match="left: exposure_us: 5 is outside 10 to 1e\\+06"):
            await camera.adjust(CameraValues(exposure_us=5.0, gain_db=2.0))
        assert (2000.0, 0.0) == held(cell)
        await shoot(camera)


@pytest.mark.slow
@pytest.mark.parametrize("configured", [None, 3000.0])
async def test_what_was_there_before_is_written_back(cell: Cell, configured: float | None) -> None:
    """`restore` writes the configured value, or the one that the camera had when it was opened."""
    cell.left.registers.put(g.EXPOSURE_TIME, 1234.0)
    async with opened(left_camera(exposure_us=configured)) as camera:
        await camera.adjust(CameraValues(500.0, 6.0))
        assert (500.0, 6.0) == held(cell)
        await camera.restore()
        assert (configured or 1234.0, 0.0) == held(cell)
        await camera.restore()
        await shoot(camera)


@pytest.mark.slow
async def test_a_lost_connection_keeps_what_is_tried_and_a_lost_camera_gets_back_what_was(cell: Cell) -> None:
    """After a lost connection adjusted values are kept; if the camera is lost at `restore`, it is restored
    later."""
    async with opened(left_camera()) as camera:
        await camera.adjust(CameraValues(exposure_us=500.0))
        await camera.close()
        await camera.open()
        assert (500.0, 0.0) == held(cell)
        cell.left.steal_control()
        with pytest.raises(CaptureError):
            await camera.restore()
        cell.left.release_control()
        assert (500.0, 0.0) == held(cell)
        await camera.open()
        assert (2000.0, 0.0) == held(cell)


@pytest.mark.slow
@pytest.mark.parametrize("clamped", [False, True])
async def test_firmware_that_locks_its_settings_is_opened_anew(
    clamped: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """A camera that locks its settings is opened anew with the value, which is logged; a value that it
    clamps is refused."""
    quirks = (Quirk.LOCKED_EXPOSURE, *([Quirk.CLAMPED_EXPOSURE] if clamped else []))
    caplog.set_level(logging.INFO)
    with running(Cell(quirks=quirks)) as cell:
        async with opened(left_camera()) as camera:
            if clamped:
                with pytest.raises(CameraSetupError, match=r"the camera made 10000\.0 of 20000"):
                    await camera.adjust(CameraValues(exposure_us=20_000.0))
            else:
                assert CameraValues(20_000.0, 0.0) == await camera.adjust(CameraValues(exposure_us=20_000.0))
                await shoot(camera)
                assert 20_000.0 == cell.left_sensor.requests[-1].exposure_us
                assert "reopened" in caplog.text
                with pytest.raises(CameraSetupError):
                    await camera.restore()
                await camera.open()
            await shoot(camera)
            assert 2000.0 == cell.left_sensor.requests[-1].exposure_us


@pytest.mark.slow
async def test_each_picture_may_prove_the_exposure_that_is_tried(cell: Cell) -> None:
    """With chunk data a picture is compared with the adjusted value, not the configured one."""
    async with opened(left_camera(chunks=True, exposure_us=3000.0)) as camera:
        await camera.adjust(CameraValues(exposure_us=500.0))
        await shoot(camera)
        await camera.restore()
        await shoot(camera)
        assert [500.0, 500.0, 3000.0, 3000.0] == [  # each adjustment throws one away
            request.exposure_us for request in cell.left_sensor.requests
        ]


@pytest.mark.slow
async def test_setup_tries_and_ready_has_what_is_configured(cell: Cell) -> None:
    """In SETUP a camera is adjusted through the head, reported as a change, and restored before READY."""
    head = StereoHead(left_camera(exposure_us=3000.0), AravisCamera("right", AravisSettings("127.0.40.2")))
    ear, cycle = Ear(), Cycle(head, make_setup())
    cycle.set_publishers([ear])
    task = asyncio.create_task(cycle.run())
    try:
        await until(lambda: ear.state() is CellPhase.READY)
        token = await cycle.session.enter_setup("Anna")
        assert CameraValues(700.0, 0.0) == await cycle.session.adjust(token, "left", CameraValues(700.0))
        assert CameraLimits((10.0, 1e6), (0.0, 24.0)) == await cycle.session.limits(token, "right")
        await cycle.session.capture(token)
        assert {"left": ChosenCamera(exposure_us=700.0)} == cycle.session.camera_changes
        with pytest.raises(CameraSetupError):
            await cycle.session.adjust(token, "right", CameraValues(gain_db=99.0))
        await cycle.session.leave_setup(token)
        await until(lambda: ear.state() is CellPhase.READY)
        assert {} == cycle.session.camera_changes
        requests = [request.exposure_us for request in cell.left_sensor.requests]
        assert [700.0, 700.0, 3000.0] == requests[:3]  # each adjustment throws one away
    finally:
        cycle.stop()
        await task
