"""Deviations of real cameras from the standard, imitated, with the real Aravis over real UDP."""

from __future__ import annotations

import asyncio
import io
import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.gigecell import LEFT, RIGHT, Cell, left_camera, opened, opens, running, settles, shoot
from helpers.needs import needs_aravis
from helpers.scriptedhead import Head
from helpers.waiting import LIMIT_S
from rich.console import Console

from edged.adapters.aravis import FreeRun, Output, Software, library, link
from edged.app.camerareport import together
from edged.commands.cameras import report
from edged.domain.exposure import CameraValues
from edged.domain.frames import Frame, FramePair
from edged.errors import CameraSetupError, CameraUnreachable, FrameIncomplete, FrameTimeout, UserError
from edged.sim.gige import genicam as g
from edged.sim.gige.camera import GigeCamera, Make
from edged.sim.gige.faults import BLOCKS_TO_RESTART, Quirk
from edged.sim.gige.genicam import GenicamNode

pytestmark = needs_aravis()


@contextmanager
def habit(*quirks: Quirk) -> Iterator[Cell]:
    """A running cell whose left camera has these quirks."""
    with running(Cell(quirks=quirks)) as cell:
        yield cell


@pytest.mark.slow
async def test_a_picture_after_an_adjustment_has_the_new_exposure_and_one_after_restore_the_old() -> None:
    """With firmware that applies values one exposure late, the first exposure after a change is discarded."""
    with habit(Quirk.LATE_EXPOSURE) as cell:

        def exposure_of(frame: Frame) -> float:
            number = cell.left_sensor.saw(frame.image)
            return cell.left_sensor.requests[number - 1].exposure_us

        async with opened(left_camera(exposure_us=3000.0)) as camera:
            await shoot(camera)
            await camera.adjust(CameraValues(exposure_us=700.0))
            assert 700.0 == exposure_of(await shoot(camera))
            await camera.restore()
            assert 3000.0 == exposure_of(await shoot(camera))


@pytest.mark.slow
@pytest.mark.parametrize("quirk", [Quirk.BUSY_DROPS, Quirk.BUSY_REFUSES])
async def test_a_trigger_during_an_abandoned_exposure_is_exposed_all_the_same(quirk: Quirk) -> None:
    """After an abandoned exposure acquisition begins anew, and the picture is of the new trigger."""
    with habit(quirk) as cell:
        async with opened(left_camera()) as camera:
            await shoot(camera)
            cell.left.faults.delay_s = 0.4
            await camera.trigger()
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.05):
                    await camera.frame()
            cell.left.faults.delay_s = 0.0
            frame = await shoot(camera)
            assert 3 <= cell.left.exposures
            assert cell.left_sensor.saw(frame.image) is not None


@pytest.mark.slow
async def test_a_refused_trigger_is_a_frame_that_did_not_come_and_no_lost_camera() -> None:
    """A trigger refused as busy is a FrameTimeout, and the next one is exposed without a new connection."""
    with habit(Quirk.BUSY_REFUSES) as cell:
        async with opened(left_camera()) as camera:
            await shoot(camera)
            cell.left._triggers.exposing = True  # noqa: SLF001  (as after an unknown pulse)
            with pytest.raises(FrameTimeout, match="still busy with an exposure"):
                await camera.trigger()
            cell.left._triggers.exposing = False  # noqa: SLF001  (and it is over)
            await shoot(camera)


@pytest.mark.slow
async def test_pictures_are_new_though_the_camera_counts_from_one_again() -> None:
    """If the camera's counter falls, ids still rise, and no picture counts as a repeated one."""
    with habit(Quirk.COUNTER_RESTARTS):
        async with opened(left_camera(trigger=FreeRun(100.0))) as camera:
            ids = [(await camera.frame()).frame_id for _ in range(BLOCKS_TO_RESTART + 20)]
        assert np.all(np.diff(ids) > 0)


@pytest.mark.slow
@pytest.mark.parametrize("quirk", [Quirk.BLOCK_ID_ZERO, Quirk.EXTENDED_IDS])
async def test_pictures_come_whatever_their_block_ids_are(quirk: Quirk) -> None:
    """With block ids from 0 or of 64 bits each picture is the sensor's, with resent packets, too."""
    with habit(quirk) as cell:
        async with opened(left_camera(packet_size=1500)) as camera:
            frames = [await settles(camera, lambda: shoot(camera), LIMIT_S)]
            cell.left.faults.lost_packets = (2,)
            frames += [await settles(camera, lambda: shoot(camera), LIMIT_S) for _ in range(2)]
            saw = [cell.left_sensor.saw(frame.image) for frame in frames]
            assert np.all(np.diff(saw) > 0)
            assert np.all(np.diff([frame.frame_id for frame in frames]) > 0)


@pytest.mark.slow
async def test_a_payload_that_is_no_image_is_named() -> None:
    """A JPEG payload is a fault that names it."""
    with habit(Quirk.JPEG_PAYLOAD):
        async with opened(left_camera()) as camera:
            with pytest.raises(FrameIncomplete, match="it carries jpeg"):
                await shoot(camera)


@pytest.mark.slow
async def test_a_camera_with_a_short_heartbeat_stays_ours_while_idle() -> None:
    """A heartbeat time-out of half a second is set to three, so an idle camera stays controlled."""
    with habit(Quirk.SHORT_HEARTBEAT) as cell:
        async with opened(left_camera()) as camera:
            assert 3000 == cell.left.registers.word(g.HEARTBEAT_MS)
            began_s = time.monotonic()
            while time.monotonic() - began_s < 2.0:
                await asyncio.sleep(0.05)
                assert cell.left.controlled
            await shoot(camera)


# --- features under other names ---------------------------------------------------------------------------


def node(
    name: str, kind: Any, address: int, start: float = 0, high: float = 2**31 - 1, **more: Any
) -> GenicamNode:
    """A feature of an imitated camera."""
    return GenicamNode(name, "Camera", address, kind, start, 0, high, **more)


def made(*extra: GenicamNode, without: tuple[str, ...] = ()) -> Make:
    """A camera with additional features, and without some of the virtual camera's."""
    own = tuple(feature for feature in g.features(320, 240) if feature.name not in without)
    return Make("Somebody", "Other", (*own, *extra))


@pytest.mark.slow
async def test_what_changes_pictures_is_switched_off_unless_it_is_configured() -> None:
    """Sharpening, noise reduction, a look-up table and a test pattern are switched off unless configured."""
    make = made(
        node("SharpeningEnable", "boolean", 0x20000, 1),
        node("NoiseReductionAbs", "float", 0x20100, 0.7, 1.0),
        node("LUTEnable", "boolean", 0x20200, 1),
        node("TestPattern", "enumeration", 0x20300, 1, choices={"Off": 0, "Ramp": 1}),
        node("ExposureMode", "enumeration", 0x20400, 1, choices={"Timed": 0, "TriggerWidth": 1}),
    )

    def left(camera: GigeCamera) -> list[int]:
        return [camera.registers.word(address) for address in range(0x20000, 0x20500, 0x100)]

    with running(Cell(make=make)) as cell:
        await opens(left_camera(exposure_us=2000.0, features=({"LUTEnable": True},)))
        assert [0, 0, 1, 0, 0] == left(cell.left)


@pytest.mark.slow
async def test_a_limit_of_the_frame_rate_does_not_hold_triggers_back() -> None:
    """A limit of the frame rate is switched off unless it is configured."""
    with running(Cell()) as cell:
        await opens(left_camera())
        assert 0 == cell.left.registers.word(g.FRAME_RATE_ENABLE)
        await opens(left_camera(features=({"AcquisitionFrameRateEnable": True},)))
        assert 1 == cell.left.registers.word(g.FRAME_RATE_ENABLE)


@pytest.mark.slow
async def test_a_gain_in_steps_that_nobody_explains_is_refused_in_the_words_of_the_menu() -> None:
    """A gain in unknown steps is refused with the name of the menu; the lacks of the camera are listed."""
    raw = node("GainRaw", "integer", g.GAIN, 100, 1023, menu="Gain (Raw)")
    make = made(raw, without=("Gain", "PtpEnable"))
    with running(Cell(make=make)) as cell:
        with pytest.raises(CameraSetupError, match=r'gain_db: "Gain \(Raw\)" \(GainRaw\) counts in steps'):
            await opens(left_camera(gain_db=6.0))
        async with opened(left_camera(features=({"GainRaw": 200},))) as camera:
            assert camera.health is not None
            lacks = [str(lack) for lack in camera.health.lacks]
        assert ['gain in dB ("Gain (Raw)" (GainRaw) in steps of its own)', "PTP"] == lacks
        assert 200 == cell.left.registers.word(g.GAIN)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vendor", "model", "raw"),
    [("Prosilica", "GC655C", 6), ("Basler", "acA1300-30gm", 167), ("Basler", "acA2000-50gm", 64)],
)
async def test_a_gain_in_steps_is_set_in_db_where_the_manual_says_how(
    vendor: str, model: str, raw: int
) -> None:
    """Raw gain is set from dB by the least step and its size, or by amplification."""
    high = 1023 if vendor == "Basler" else 24
    make = made(node("GainRaw", "integer", g.GAIN, 20 if vendor == "Basler" else 1, high), without=("Gain",))
    with running(Cell(make=Make(vendor, model, make.features))) as cell:
        async with opened(left_camera()) as camera:
            values = await camera.adjust(CameraValues(gain_db=6.0))
        assert raw == cell.left.registers.word(g.GAIN)
        assert values.gain_db == pytest.approx(6.0, abs=0.05)


@pytest.mark.slow
async def test_two_cameras_that_pace_themselves_share_the_link(monkeypatch: pytest.MonkeyPatch) -> None:
    """For Allied Vision, whose rate is in bytes per second, each of two cameras gets half of the link."""
    monkeypatch.setattr(link, "cameras_on_link", lambda _device, _neighbour: 2)
    monkeypatch.setattr(link, "host_bps", lambda _device: 1e9)
    make = made(node("StreamBytesPerSecond", "integer", 0x20000, 115_000_000, 124_000_000))
    with running(Cell(make=make)) as cell:
        async with opened(left_camera(packet_size=1500)) as camera:
            delay_us = camera.health.packet_delay_us if camera.health is not None else None
        assert 62_500_000 == cell.left.registers.word(0x20000)
        assert delay_us == pytest.approx(8 * 1538 / 1e9 * 1e6, rel=1e-3)


@pytest.mark.slow
async def test_lines_that_are_called_otherwise_show_the_exposure() -> None:
    """Allied Vision's SyncOut selector, source and polarity show the exposure."""
    above, sources, polarity = "SyncOutSelector", {"GPO": 0, "Exposing": 5}, {"Normal": 0, "Invert": 1}
    make = made(
        node(above, "enumeration", 0x20000, choices={"SyncOut1": 0, "SyncOut2": 1}),
        node("SyncOutSource", "enumeration", 0x20100, choices=sources, selector=above),
        node("SyncOutPolarity", "enumeration", 0x20200, choices=polarity, selector=above),
        without=("LineSelector", "LineMode", "LineInverter", "LineSource", "LineStatus", "LineDebouncerTime"),
    )
    with running(Cell(make=make)) as cell:
        await opens(left_camera(outputs=(Output("SyncOut2", inverted=True),)))
        assert [5, 1] == [cell.left.registers.word(bank + 4) for bank in (0x20100, 0x20200)]


@pytest.mark.slow
async def test_a_camera_without_a_trigger_runs_freely_and_says_so() -> None:
    """A camera without a trigger is refused with free-run as the way out, and then runs freely."""
    make = made(without=("TriggerMode", "TriggerSelector", "TriggerSource", "TriggerSoftware"))
    with running(Cell(make=make)):
        with pytest.raises(CameraSetupError, match=r'trigger\.mode = "free-run"'):
            await opens(left_camera(trigger=Software()))
        async with opened(left_camera(trigger=FreeRun())) as camera:
            await camera.frame()


@pytest.mark.long
def test_two_cameras_are_reported_on(tmp_path: Path) -> None:
    """The report has both cameras and their exposures together, and no name of a camera."""
    file, told = tmp_path / "report.json", io.StringIO()
    with running(Cell()):
        assert 0 == report(file, [LEFT, RIGHT], 0.05, Console(file=told, width=200))

    seen = json.loads(file.read_text())
    assert ["edged", "edged"] == [camera["vendor"] for camera in seen["cameras"]]
    assert "ExposureTime" in {feature["name"] for feature in seen["cameras"][0]["features"]}
    assert seen["together"]["pairs"] > 0
    assert [41.5, 41.5] == seen["together"]["temperature_c"]
    assert all(camera["complete"] > 0 for camera in seen["full_rate"]["cameras"])
    assert not {"EDGED-T1", "EDGED-T2", LEFT, RIGHT} & set(file.read_text().split('"'))
    assert "skew of both exposures" in told.getvalue()


def test_a_fault_that_lasts_is_one_in_a_report_and_is_waited_for() -> None:
    """A lasting fault counts once in a report, and cameras are opened again rather than asked without
    pause."""

    class Gone(Head):
        tries = 0
        cameras = ()
        fault = CameraUnreachable("left", "gone")

        async def capture(self) -> FramePair:
            self.tries += 1
            if self.tries == 1:
                raise FrameTimeout("left", "no image")
            raise self.fault

    head = Gone()
    seen = asyncio.run(together(head, 0.45))
    assert {"FrameTimeout": 1, "CameraUnreachable": 1} == seen["faults"]
    assert head.tries <= 6
    assert (0, []) == (seen["pairs"], seen["skew_us"])


def test_a_report_needs_two_cameras(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With fewer than two answering cameras the report is refused with how to name them."""
    monkeypatch.setattr("edged.commands.cameras.list_cameras", list)
    with pytest.raises(UserError, match="--report needs two cameras, and 0 answer"):
        report(tmp_path / "report.json", [], 1.0, Console(file=io.StringIO()))


def test_two_descriptions_are_never_read_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two cameras that are opened together read their descriptions one after the other."""
    reading, most = [0], [0]

    def new(_device: str) -> str:
        reading[0] += 1
        most[0] = max(most[0], reading[0])
        time.sleep(0.02)
        reading[0] -= 1
        return "opened"

    class Untranslated(Exception):
        """An error that GLib does not know."""

    fake = SimpleNamespace(
        aravis=SimpleNamespace(Camera=SimpleNamespace(new=new)), glib=SimpleNamespace(Error=Untranslated)
    )
    monkeypatch.setattr(library, "library", lambda _camera: fake)
    threads = [threading.Thread(target=library.connect, args=("left", f"127.0.40.{n}")) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [1] == most
