"""Triggers of the virtual camera: lines, action commands, a frame rate; by raw datagrams."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator

import pytest
from helpers.gigeclient import Client, Stream, acquiring

from edged.sim.gige import genicam as g
from edged.sim.gige.camera import GigeCamera, moving_ramp
from edged.sim.gige.clock import DeviceClock
from edged.sim.gige.gvcp import ACTION, GVCP_PORT
from edged.sim.gige.registers import ACTION_LATE, INVALID_PARAMETER, NO_REFERENCE_TIME, SUCCESS
from edged.vision.kernels.pixelformats import FORMATS

ADDRESS, OTHER = "127.0.51.1", "127.0.51.2"
KEYS = {"ACTION_DEVICE_KEY": 7, "ACTION_GROUP_KEY": 3, "ACTION_GROUP_MASK": 0b0110}
ON_ACTION = {"TRIGGER_MODE": 1, "TRIGGER_SOURCE": g.ACTION1, **KEYS}
ON_LINE1 = {"TRIGGER_MODE": 1, "TRIGGER_SOURCE": g.LINE1}
PERIOD_NS = 20_000_000
OUTPUT = g.LINE_MODE + 4 * g.LINES["Line2"]


def small(address: str = ADDRESS, **options: object) -> GigeCamera:
    """A camera with small images."""
    return GigeCamera(address, f"S{address[-1]}", moving_ramp, size=(64, 48), **options)


@pytest.fixture
def camera() -> Iterator[GigeCamera]:
    """One camera."""
    with small() as camera:
        yield camera


def action(
    address: str, mask: int, at_ticks: int | None = None, keys: tuple[int, int] = (7, 3)
) -> int | None:
    """Send an action command that asks for an acknowledgement; its status, None without one."""
    body = struct.pack(">III", *keys, mask) + (b"" if at_ticks is None else struct.pack(">Q", at_ticks))
    flags = 0x01 if at_ticks is None else 0x81
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        udp.settimeout(0.3)
        udp.sendto(struct.pack(">BBHHH", 0x42, flags, ACTION, len(body), 1) + body, (address, GVCP_PORT))
        try:
            return int(struct.unpack(">HHHH", udp.recv(64)[:8])[0])
        except TimeoutError:
            return None


@pytest.mark.parametrize(
    ("activation", "expected"), [(g.RISING, [0]), (g.FALLING, [5_000_000]), (g.ANY, [0, 5_000_000])]
)
def test_a_pulse_triggers_at_the_edges_that_count(
    camera: GigeCamera, activation: int, expected: list[int]
) -> None:
    """With a pulse of 5 ms the exposure begins at the active edge to the nanosecond, plus TriggerDelay."""
    with acquiring(ADDRESS, **ON_LINE1, TRIGGER_ACTIVATION=activation, TRIGGER_DELAY=250.0) as stream:
        at_ns = time.monotonic_ns()
        camera.line("Line1").pulse(0.005, at_ns)
        began = [stream.image().ticks - camera.clock.at(at_ns) - 250_000 for _ in expected]

        assert began == expected
        assert stream.silent(0.05)


def test_a_disturbance_shorter_than_the_debouncer_is_no_trigger(camera: GigeCamera) -> None:
    """With 1 ms of debouncing 0.9 ms is no pulse, and 1.1 ms is one, seen 1 ms late."""
    with acquiring(ADDRESS, **ON_LINE1, LINE_DEBOUNCER=1000.0) as stream:
        camera.line("Line1").pulse(0.0009)
        time.sleep(0.01)
        at_ns = time.monotonic_ns()
        camera.line("Line1").pulse(0.0011, at_ns)

        assert stream.image().ticks == camera.clock.at(at_ns) + 1_000_000
        assert camera.exposures == 1


def test_bouncing_contacts_make_one_exposure(camera: GigeCamera) -> None:
    """Five bounces of 0.1 ms make one exposure, and none at their end."""
    with acquiring(ADDRESS, **ON_LINE1, LINE_DEBOUNCER=500.0) as stream:
        start_ns = time.monotonic_ns()
        wire = camera.line("Line1")
        for bounce in range(11):
            wire.drive(bounce % 2 == 0, start_ns + bounce * 100_000)
        last_ns = start_ns + 1_000_000

        assert stream.image().ticks == camera.clock.at(last_ns) + 500_000
        assert stream.silent(0.05)


def test_an_inverted_input_triggers_when_the_wire_falls(camera: GigeCamera) -> None:
    """With LineInverter the camera triggers on the falling edge of the wire."""
    with acquiring(ADDRESS, **ON_LINE1, LINE_INVERTER=1) as stream:
        at_ns = time.monotonic_ns()
        camera.line("Line1").pulse(0.004, at_ns)

        assert stream.image().ticks == camera.clock.at(at_ns) + 4_000_000


def test_only_the_chosen_source_triggers(camera: GigeCamera) -> None:
    """With Line1 as source neither Line3, software nor an action command exposes."""
    with acquiring(ADDRESS, **ON_LINE1, **KEYS) as stream:
        camera.line("Line3").pulse()
        stream.client.set(TRIGGER_SOFTWARE=1)
        assert action(ADDRESS, 0b0100) == SUCCESS
        assert stream.silent(0.1)
        camera.line("Line1").pulse()
        assert stream.image().block_id == 1


def test_the_exposure_of_one_camera_triggers_the_other(camera: GigeCamera) -> None:
    """With Line2 (ExposureActive) wired to Line1 the other camera exposes at the start or end of the
    exposure."""
    with small(OTHER) as other:
        camera.line("Line2").feeds(other.line("Line1"))
        with (
            acquiring(ADDRESS, TRIGGER_MODE=1, EXPOSURE_TIME=3000.0) as first,
            acquiring(OTHER, **ON_LINE1) as second,
        ):
            assert first.client.write(g.LINE_SOURCE + 4 * g.LINES["Line2"], g.EXPOSURE_ACTIVE) == SUCCESS
            for edge, expected_ns in ((g.RISING, 0), (g.FALLING, 3_000_000)):
                second.client.set(TRIGGER_ACTIVATION=edge)
                first.client.set(TRIGGER_SOFTWARE=1)
                between_clocks_ns = other.clock.at(0) - camera.clock.at(0)
                skew_ns = second.image().ticks - between_clocks_ns - first.image().ticks
                assert skew_ns == expected_ns


def test_a_line_is_wired_one_way(camera: GigeCamera) -> None:
    """Line1 cannot become an output nor Line2 an input, Line3 can be either; LineStatus shows the level."""
    with Stream(Client(ADDRESS)) as stream:
        client = stream.client
        assert client.write(g.LINE_MODE, 1) == INVALID_PARAMETER
        assert client.write(OUTPUT, 0) == INVALID_PARAMETER
        assert client.write(g.LINE_MODE + 4 * g.LINES["Line3"], 1) == SUCCESS
        camera.line("Line1").drive(True)
        assert client.read(g.LINE_STATUS) == (SUCCESS, 1)
        assert client.write(g.LINE_INVERTER + 4 * g.LINES["Line2"], 1) == SUCCESS
        assert client.read(g.LINE_STATUS_ALL) == (SUCCESS, 0b001)
        assert camera.line("Line2").level(time.monotonic_ns()), "an inverted output rests high"


@pytest.mark.slow
def test_an_action_needs_both_keys_and_a_common_bit(camera: GigeCamera) -> None:
    """An action of another device, group or mask is neither done nor acknowledged (GigE Vision 2.0, 14.3)."""
    with acquiring(ADDRESS, **ON_ACTION) as stream:
        assert action(ADDRESS, 0b0110, keys=(8, 3)) is None
        assert action(ADDRESS, 0b0110, keys=(7, 4)) is None
        assert action(ADDRESS, 0b1001) is None
        assert camera.exposures == 0
        assert action(ADDRESS, 0b0100) == SUCCESS
        assert stream.image().block_id == 1


def test_a_broadcast_action_exposes_every_camera_of_the_group() -> None:
    """One broadcast datagram exposes both cameras."""
    with (
        small(),
        small(OTHER),
        acquiring(ADDRESS, **ON_ACTION) as first,
        acquiring(OTHER, **ON_ACTION) as second,
    ):
        assert action("127.255.255.255", 0b0010) == SUCCESS
        assert (first.image().block_id, second.image().block_id) == (1, 1)


def test_a_scheduled_action_waits_for_its_time_on_the_common_clock(camera: GigeCamera) -> None:
    """A scheduled action needs PTP, exposes on its tick, and is refused if it is late."""
    with acquiring(ADDRESS, **ON_ACTION) as stream:
        assert action(ADDRESS, 0b0010, time.time_ns() + 10**8) == NO_REFERENCE_TIME
        stream.client.set(PTP_ENABLE=1)
        at_ns = time.time_ns() + 400_000_000
        assert action(ADDRESS, 0b0010, at_ns) == SUCCESS
        assert abs(stream.image().ticks - at_ns) < 50_000  # host clocks are read one after the other
        assert time.time_ns() >= at_ns
        assert action(ADDRESS, 0b0010, at_ns) == ACTION_LATE
        assert stream.image().block_id == 2


def test_free_run_keeps_its_rate(camera: GigeCamera) -> None:
    """At 50 Hz time stamps are multiples of 20 ms apart."""
    with acquiring(ADDRESS, TRIGGER_MODE=0, FRAME_RATE=50.0) as stream:
        ticks, steps = stream.image().ticks, list[int]()
        while steps.count(PERIOD_NS) < 4:
            assert len(steps) < 100, steps
            before, ticks = ticks, stream.image().ticks
            steps.append(ticks - before)

    assert {0} == {step % PERIOD_NS for step in steps}


def test_a_drifting_clock_with_an_offset_shows_in_time_stamps() -> None:
    """A clock 1000 s ahead, 500 ppm fast and with 125 MHz shows so in registers and images."""
    clock = DeviceClock(offset_s=1000.0, drift_ppm=500.0, tick_hz=125_000_000)
    with small(clock=clock) as camera, acquiring(ADDRESS, **ON_LINE1) as stream:
        assert stream.client.long(g.TICKS_HIGH) == 125_000_000
        start_ns = time.monotonic_ns()
        camera.line("Line1").pulse(0.0001, start_ns)
        camera.line("Line1").pulse(0.0001, start_ns + 100_000_000)
        first, second = stream.image().ticks, stream.image().ticks
        assert second - first == pytest.approx(12_500_000 * 1.0005, abs=2)
        assert 1000.0 < first / 125e6 < 1030.0
        stream.client.set(TIMESTAMP_CONTROL=2)
        assert second < stream.client.long(g.TIMESTAMP_HIGH) < second + 2 * 125_000_000
        stream.client.set(LATCH=1)
        latched_ns = stream.client.long(g.LATCH_VALUE)
        assert abs(latched_ns - clock.at(time.monotonic_ns())) < 1_000_000_000


def test_ptp_makes_the_clock_the_masters_until_it_is_switched_off() -> None:
    """With PTP the clock is uncalibrated, then Slave with the stated error, and runs on when it is off."""
    clock = DeviceClock(offset_s=5.0, ptp_error_ns=300, ptp_settle_s=0.2)
    with small(clock=clock), Stream(Client(ADDRESS)) as stream:
        client = stream.client
        client.set(PTP_ENABLE=1)
        assert client.read(g.PTP_STATUS)[1] == 6
        time.sleep(0.25)
        assert client.read(g.PTP_STATUS)[1] == 8
        client.set(PTP_LATCH=1)
        assert client.long(g.PTP_OFFSET) == pytest.approx(300, abs=20_000)
        client.set(PTP_ENABLE=0)
        assert abs(clock.at(time.monotonic_ns()) - time.time_ns()) < 10_000_000


def test_changing_the_drift_makes_no_step() -> None:
    """A changed drift makes no step in the clock."""
    clock = DeviceClock(drift_ppm=0.0)
    before_ns, monotonic_ns = clock.at(time.monotonic_ns()), time.monotonic_ns()
    clock.drift_ppm = 900.0

    assert 0 <= clock.at(time.monotonic_ns()) - before_ns < 2 * (time.monotonic_ns() - monotonic_ns) + 10_000
    clock.jump(2.0)
    assert 2.0 <= (clock.at(time.monotonic_ns()) - before_ns) * 1e-9 < 3.0


@pytest.mark.parametrize("name", g.PIXEL_FORMATS)
def test_payload_and_leader_follow_the_pixel_format(camera: GigeCamera, name: str) -> None:
    """PayloadSize is the size that is sent, and the leader has the PFNC code."""
    with acquiring(ADDRESS, TRIGGER_MODE=1, PIXEL_FORMAT=FORMATS[name].code) as stream:
        size = stream.client.read(g.PAYLOAD_SIZE)[1]
        stream.client.set(TRIGGER_SOFTWARE=1)
        image = stream.image()

    assert image.pixel_format == FORMATS[name].code
    assert len(image.data) == size == FORMATS[name].size(64 * 48)
