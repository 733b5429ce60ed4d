"""The Aravis adapter, with the real Aravis, against GigE Vision cameras over real UDP."""

from __future__ import annotations

import asyncio
import errno
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.gigecell import (
    HEIGHT,
    LEFT,
    NOBODY,
    RIGHT,
    Cell,
    Sensor,
    closing,
    gige_camera,
    left_camera,
    opened,
    running,
    settles,
    shoot,
)
from helpers.needs import needs_aravis
from helpers.waiting import LIMIT_S, WHOLE_S
from hypothesis import given
from hypothesis import strategies as st

from edged.adapters.aravis import AravisCamera, AravisSettings, list_cameras
from edged.adapters.aravis.features import Features
from edged.adapters.aravis.library import DEVICE_ERRORS, library, translate, translated
from edged.adapters.aravis.stream import BLOCK_IDS, Decoder, FrameCounter, pump
from edged.cell.stereohead import HeadSettings, StereoHead
from edged.errors import CameraBusy, CameraSetupError, CameraUnreachable, CaptureError, FrameTimeout

pytestmark = needs_aravis()


@pytest.fixture
def cell() -> Iterator[Cell]:
    """A running cell."""
    with running(Cell()) as cell:
        yield cell


def test_what_the_system_refuses_is_a_fault_of_the_camera() -> None:
    """Without a free file descriptor for a socket the camera is unreachable."""
    with (
        pytest.raises(CameraUnreachable, match="setting up: Too many open files"),
        translated("left", "setting up"),
    ):
        raise OSError(errno.EMFILE, "Too many open files")


def count(folder: str) -> int:
    """Entries of a folder of /proc: threads, Aravis' own included, or open files."""
    return len(list(Path("/proc/self", folder).iterdir()))


# --- errors -----------------------------------------------------------------------------------------


def test_every_aravis_device_error_is_translated() -> None:
    """The table has exactly the codes of this Aravis, and each becomes its exception."""
    aravis, glib = library("left")
    codes = {
        name: int(getattr(aravis.DeviceError, name)) for name in dir(aravis.DeviceError) if name.isupper()
    }

    assert set(codes) == set(DEVICE_ERRORS)
    for name, code in codes.items():
        error = glib.Error.new_literal(aravis.device_error_quark(), "it says no", code)
        translated = translate("left", "asking", error)
        assert DEVICE_ERRORS[name] is type(translated)
        assert "camera left: asking: it says no" == str(translated)


def test_every_genicam_error_is_a_setting_that_does_not_fit() -> None:
    """All of `Aravis.GcError` become `CameraSetupError`."""
    aravis, glib = library("left")
    for code in (int(getattr(aravis.GcError, name)) for name in dir(aravis.GcError) if name.isupper()):
        error = glib.Error.new_literal(aravis.gc_error_quark(), "no such entry", code)
        assert CameraSetupError is type(translate("left", "setting", error))


def test_errors_of_other_domains_and_unknown_codes_are_faults_too() -> None:
    """A socket error or an unknown code becomes CameraUnreachable."""
    aravis, glib = library("left")
    for quark, code in ((glib.quark_from_string("g-io-error-quark"), 38), (aravis.device_error_quark(), 999)):
        error = glib.Error.new_literal(quark, "host unreachable", code)
        assert CameraUnreachable is type(translate("left", "sending", error))


@pytest.mark.slow
def test_without_aravis_the_message_says_what_to_install() -> None:
    """On a machine without PyGObject the package imports, and a camera fails with the apt command."""
    program = """
import sys
sys.modules["gi"] = None
import asyncio
from edged.adapters.aravis import AravisCamera, AravisSettings, aravis_missing
from edged.errors import CameraSetupError
assert "apt install gir1.2-aravis-0.8 python3-gi" in aravis_missing()
camera = AravisCamera("left", AravisSettings("127.0.40.9"))
async def main():
    try:
        await camera.open()
    except CameraSetupError as error:
        assert "apt install" in str(error), error
    else:
        raise SystemExit("no error")
    await camera.close()
asyncio.run(main())
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=WHOLE_S)


# --- frame ids --------------------------------------------------------------------------------------


@given(
    st.lists(st.integers(1, 3), min_size=1, max_size=200), st.integers(1, BLOCK_IDS), st.integers(0, 2**40)
)
def test_frame_ids_rise_through_the_wrap_of_a_16_bit_counter(
    steps: list[int], start: int, first: int
) -> None:
    """Ids continue over the wrap of a counter from 1 to 65535, with the same gaps."""
    counter = FrameCounter(first)
    true_count = np.cumsum([start, *steps])

    ids = [counter.count(int((count - 1) % BLOCK_IDS) + 1) for count in true_count]

    np.testing.assert_array_equal(np.diff(true_count), np.diff(ids))
    assert first + 1 == ids[0]


@given(st.integers(1, 2**63), st.integers(1, 1000))
def test_frame_ids_of_64_bits_do_not_wrap(start: int, step: int) -> None:
    """64-bit ids, as of GigE Vision 2 and USB, do not wrap."""
    counter = FrameCounter(0)
    assert step == -counter.count(start) + counter.count(start + step)


def test_a_repeated_frame_keeps_its_id_and_a_restart_counts_on() -> None:
    """A duplicate keeps its id, and after a restart ids rise wherever the camera begins."""
    counter = FrameCounter(10)
    assert [11, 12, 12, 11] == [counter.count(raw) for raw in (5, 6, 6, 5)]
    counter.restart()
    assert [13, 14] == [counter.count(raw) for raw in (1, 2)]
    counter.restart()
    assert [15] == [counter.count(raw) for raw in (7,)]


def test_a_buffer_without_a_packet_of_an_image_is_no_image() -> None:
    """A buffer without image data, from a foreign packet, is given back, and the next image is the
    first."""
    aravis = library("left").aravis
    stop, given_back, delivered = threading.Event(), [], []
    stranger = aravis.Buffer.new_allocate(16)
    assert aravis.BufferStatus.CLEARED == stranger.get_status()

    class Stream:
        def timeout_pop_buffer(self, _timeout_us: int) -> Any:
            stop.set()
            return stranger

        push_buffer = staticmethod(given_back.append)

    pump(Decoder(aravis, FrameCounter(0), None, None), Stream(), stop, delivered.append)
    assert [stranger] == given_back
    assert [] == delivered


# --- features ---------------------------------------------------------------------------------------


@pytest.fixture
def device() -> Any:
    """Aravis' own device in memory."""
    return library("left").aravis.FakeDevice.new("TEST")


def test_every_misfit_is_named_before_anything_is_written(device: Any) -> None:
    """Names, types and choices are checked for all settings at once."""
    features = Features("left", device)
    before = device.get_integer_feature_value("Width")

    with pytest.raises(CameraSetupError) as caught:
        features.require(
            {
                "Width": 64,
                "Shutter": 3,
                "TriggerMode": "Perhaps",
                "ExposureTimeAbs": True,
                "GainRaw": 2.5,
                "TestBoolean": 1,
                "AcquisitionStart": 0,
                "DeviceUserName": 7,
            }
        )

    message = str(caught.value)
    for part in (
        "Shutter: the camera has no such feature",
        "TriggerMode: 'Perhaps' is none of Off, On",
        "ExposureTimeAbs: expected a number, got True",
        "GainRaw: expected a whole number, got 2.5",
        "TestBoolean: expected true or false, got 1",
        "AcquisitionStart: a command; expected true, got 0",
        "DeviceUserName: the camera has no such feature",
    ):
        assert part in message
    assert before == device.get_integer_feature_value("Width")


def test_what_the_camera_cannot_do_is_named_with_its_limits(device: Any) -> None:
    """Settings that are out of range or read-only are refused with the reason, and the others are set."""
    problems = Features("left", device).apply(
        {"ExposureTimeAbs": 5e9, "GainRaw": 99, "SensorWidth": 3, "DeviceVendorName": "me", "Width": 128}
    )

    text = "; ".join(problems)
    assert "ExposureTimeAbs: 5000000000.0 is outside 10 to 1e+07" in text
    assert "GainRaw: 99 is outside 0 to 10" in text
    assert "SensorWidth: can only be read" in text
    assert "DeviceVendorName: can only be read" in text
    assert 4 == len(problems)
    assert 128 == device.get_integer_feature_value("Width")
    assert "Aravis" == device.get_string_feature_value("DeviceVendorName")


def test_settings_are_applied_whatever_the_order_they_are_written_in(device: Any) -> None:
    """A region is set in the order that the camera allows, size before offset."""
    features = Features("left", device)
    assert [] == features.apply({"Width": 100, "Height": 50, "OffsetX": 1900, "OffsetY": 1900})
    assert [] == features.apply({"OffsetX": 8, "Width": 2000, "TriggerMode": "On", "ExposureTimeAbs": 1234})

    values = [device.get_integer_feature_value(name) for name in ("Width", "OffsetX", "OffsetY")]
    assert [2000, 8, 0] == values
    assert "On" == device.get_string_feature_value("TriggerMode")


# --- against Aravis' own camera -----------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("user_socket", [False, True], ids=["packet-socket", "user-socket"])
async def test_images_of_aravis_own_camera_arrive_whole(user_socket: bool) -> None:
    """Pictures of Aravis' own camera at 10 ms, x + y + frame modulo 255, are right in every pixel."""
    fake = library("left").aravis.GvFakeCamera.new("127.0.0.1", "EDGED-FAKE")
    if not fake.is_running():
        pytest.skip("port 3956 of 127.0.0.1 is taken")
    fake.get_fake_camera().set_trigger_frequency(250)  # or it looks for triggers only ten times a second
    size: dict[str, Any] = {"features": ({"Width": 1280, "Height": 960},)}
    async with closing(
        left_camera("127.0.0.1", user_socket=user_socket, exposure_us=10000.0, **size)
    ) as camera:
        await camera.open()
        # this device cannot send packets again: a frame may be a fault, never a wrong picture
        frames = [await settles(camera, lambda: shoot(camera), 20) for _ in range(6)]

    y, x = np.mgrid[:960, :1280]
    starts = []
    for frame in frames:
        start = int(frame.image[0, 0])
        np.testing.assert_array_equal((x + y + start) % 255, frame.image)
        starts.append(start)
    ids = [frame.frame_id for frame in frames]
    assert (np.diff(ids) >= 1).all()
    np.testing.assert_array_equal(np.diff(ids), np.diff(starts) % 255)


# --- images -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("user_socket", [False, True], ids=["packet-socket", "user-socket"])
@pytest.mark.parametrize("packet_size", [None, 1500], ids=["negotiated", "1500"])
async def test_images_arrive_byte_for_byte(cell: Cell, user_socket: bool, packet_size: int | None) -> None:
    """Twenty exposures are the sensor's pictures, in order, each with a writable image of its own."""
    async with opened(left_camera(user_socket=user_socket, packet_size=packet_size)) as camera:
        frames = [await shoot(camera) for _ in range(20)]

    for frame, request in zip(frames, cell.left_sensor.requests, strict=True):
        np.testing.assert_array_equal(cell.left_sensor.shown[request.frame_id], frame.image)
        assert frame.image.flags.owndata
        assert frame.image.flags.writeable
        assert request.device_ns == frame.device_ns
        assert abs(request.exposed_ns - frame.exposed_ns) < 50e6
    assert (np.diff([frame.frame_id for frame in frames]) == 1).all()


@pytest.mark.slow
async def test_a_camera_is_found_by_its_serial_number(cell: Cell) -> None:
    """Both cameras are listed, and each is opened by its serial number."""
    listed = {info.serial: info.address for info in list_cameras()}
    async with opened(AravisCamera("right", AravisSettings("EDGED-T2"))) as camera:
        frame = await shoot(camera)

    assert (LEFT, RIGHT) == (listed["EDGED-T1"], listed["EDGED-T2"])
    assert 1 == cell.right_sensor.saw(frame.image)


@pytest.mark.slow
async def test_two_cameras_behind_a_stereo_head(cell: Cell) -> None:
    """The head gives pairs of one instant."""
    head = StereoHead(
        left_camera(),
        AravisCamera("right", AravisSettings(RIGHT)),
        HeadSettings(timeout_s=5, max_skew_s=0.05),
    )
    async with closing(head):
        pairs = [await head.capture() for _ in range(10)]
        assert [0] * 10 == (
            [
                cell.left_sensor.saw(pair.left.image) - cell.right_sensor.saw(pair.right.image)
                for pair in pairs
            ]
        )


# --- set-up -----------------------------------------------------------------------------------------


@pytest.mark.slow
async def test_exposure_and_gain_reach_the_sensor(cell: Cell) -> None:
    """The configured exposure, gain and features reach the camera, with automatic modes off."""
    camera = left_camera(exposure_us=1234.0, gain_db=6.0, features=({"Width": 160, "OffsetX": 32},))
    async with closing(camera):
        await camera.open()
        frame = await shoot(camera)

    request = cell.left_sensor.requests[-1]
    assert 1234.0 == pytest.approx(request.exposure_us, rel=0.01)
    assert 6.0 == pytest.approx(request.gain_db, abs=0.1)
    assert (HEIGHT, 160) == frame.image.shape


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings, reason",
    [
        ({"features": ({"Nonsense": 1},)}, "Nonsense: the camera has no such feature"),
        (
            {"features": ({"PixelFormat": "RGB8"},)},
            "PixelFormat: 'RGB8' is not understood, only Mono8, Mono10",
        ),
        ({"features": ({"PixelFormat": "Mono14"},)}, "PixelFormat: 'Mono14' is none of Mono8"),
        ({"exposure_us": 1e9}, "ExposureTime: 1000000000.0 is outside"),
        ({"gain_db": 59.0}, "Gain: 59.0 is outside"),
        ({"features": ({"DeviceVendorName": "me"},)}, "DeviceVendorName: can only be read"),
    ],
)
async def test_a_setting_that_does_not_fit_is_named_and_leaves_nothing_open(
    cell: Cell, settings: dict[str, Any], reason: str
) -> None:
    """The error names the setting and the reason, and another program can open the camera while the object
    exists."""
    async with closing(left_camera(**settings)) as wrong, closing(left_camera()) as right:
        with pytest.raises(CameraSetupError) as caught:
            await wrong.open()
        await right.open()
        await shoot(right)
        assert reason in str(caught.value)


# --- faults -----------------------------------------------------------------------------------------


@pytest.mark.long
async def test_a_camera_that_is_not_there_is_unreachable_in_bounded_time() -> None:
    """An unknown address and an unknown serial number fail within a bounded time."""
    async with (
        closing(left_camera(NOBODY)) as by_address,
        closing(left_camera("NO-SUCH-SERIAL")) as by_serial,
    ):
        with pytest.raises(CameraUnreachable, match=NOBODY):
            await asyncio.wait_for(by_address.open(), 8)
        with pytest.raises(CameraUnreachable, match="no camera with serial number 'NO-SUCH-SERIAL'"):
            await asyncio.wait_for(by_serial.open(), 8)


@pytest.mark.slow
async def test_a_second_controller_is_refused_and_the_first_goes_on(cell: Cell) -> None:
    """The second controller gets `CameraBusy`, and succeeds once the first has closed."""
    async with closing(left_camera()) as first, closing(left_camera()) as second:
        await first.open()
        with pytest.raises(CameraBusy, match="controlled by another"):
            await second.open()
        await second.close()
        await shoot(first)
        await first.close()
        await second.open()
        await shoot(second)


@pytest.mark.slow
async def test_a_camera_that_is_closed_or_not_triggered_says_so(cell: Cell) -> None:
    """`trigger` and `frame` without an open camera, and `frame` without a trigger, fail at once."""
    async with closing(left_camera()) as camera:
        for call in (camera.trigger, camera.frame):
            with pytest.raises(CameraUnreachable, match="not open"):
                await call()
        await camera.close()
        await camera.open()
        with pytest.raises(FrameTimeout, match="no exposure"):
            await camera.frame()
        await camera.close()
        await camera.close()


class Process:
    """A camera in a process of its own, which a test can kill."""

    def __init__(self, address: str, serial: str) -> None:
        self._command = [sys.executable, "-m", "edged.sim.gige.camera", address, serial]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        self._process = subprocess.Popen(self._command, stdout=subprocess.DEVNULL)

    def kill(self) -> None:
        if self._process is not None:
            self._process.send_signal(signal.SIGKILL)
            self._process.wait(LIMIT_S)
            self._process = None


@pytest.fixture
def process() -> Iterator[Process]:
    """A camera process at LEFT."""
    process = Process(LEFT, "EDGED-T1")
    process.start()
    yield process
    process.kill()


@pytest.mark.long
async def test_a_killed_camera_is_a_fault_until_it_returns_and_then_heals(process: Process) -> None:
    """After kill -9 there are only `CaptureError`s, and good images again once the camera is back."""
    head = StereoHead(
        left_camera(),
        AravisCamera("right", AravisSettings(RIGHT)),
        HeadSettings(timeout_s=0.5, max_skew_s=0.1, max_backoff_s=0.5, detect_frozen=False),
    )
    with gige_camera(RIGHT, "EDGED-T2", Sensor(2), width=1280, height=960):
        async with closing(head):
            await settles(head, head.capture, 20)
            process.kill()
            faults = []
            gone_until_s = time.monotonic() + 4.0
            while time.monotonic() < gone_until_s:
                with pytest.raises(CaptureError) as caught:
                    await asyncio.wait_for(head.capture(), 3.0)
                faults.append(caught.value.camera)
                await asyncio.sleep(0.05)
            assert {"left"} == set(faults)
            process.start()
            pair = await settles(head, head.capture, 25)
            assert "left" == pair.left.camera
            for _ in range(3):
                await settles(head, head.capture, 5)


@pytest.mark.slow
async def test_a_camera_that_restarts_between_two_commands_is_noticed_while_idle(process: Process) -> None:
    """A check of the idle camera finds that it restarted, and opens it again."""
    with gige_camera(RIGHT, "EDGED-T2", Sensor(2)):
        async with closing(
            StereoHead(
                left_camera(), AravisCamera("right", AravisSettings(RIGHT)), HeadSettings(max_backoff_s=0.5)
            )
        ) as head:
            await settles(head, head.open, 20)
            process.kill()
            process.start()
            deadline_s = time.monotonic() + LIMIT_S
            with pytest.raises(CaptureError):
                while time.monotonic() < deadline_s:
                    await head.open()
                    await asyncio.sleep(0.1)
            await settles(head, head.open, 20)
            await settles(head, head.capture, 10)


@pytest.mark.slow
async def test_connections_leave_nothing_behind(cell: Cell) -> None:
    """After each connection threads and open files return to their numbers after the first."""

    async def connect(camera: AravisCamera) -> None:
        await camera.open()
        await shoot(camera)
        await camera.close()

    async def falls_back_to(tasks: int, files: int) -> None:
        """Wait until ended threads are gone and their files closed."""
        deadline_s = time.monotonic() + LIMIT_S
        while True:
            used = (count("task"), count("fd"))
            if used[0] <= tasks and used[1] <= files:
                return
            assert time.monotonic() < deadline_s, f"{used} threads and files, {(tasks, files)} before"
            await asyncio.sleep(0.002)

    async with closing(left_camera()) as camera:
        await connect(camera)  # GLib makes threads and files of its own once, and keeps them
        await asyncio.sleep(0.5)
        tasks, files = count("task"), count("fd")
        for _ in range(8):
            await connect(camera)
            await falls_back_to(tasks, files)
        assert not [thread for thread in threading.enumerate() if thread.name.endswith(" left")]
