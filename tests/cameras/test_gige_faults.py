"""Faults of the virtual camera and quirks of its firmware, by raw datagrams."""

from __future__ import annotations

import re
import struct
import time
from collections.abc import Iterator

import pytest
from helpers.gigeclient import Client, Image, Stream, acquiring

from edged.sim.gige import genicam as g
from edged.sim.gige.camera import GigeCamera, moving_ramp
from edged.sim.gige.faults import CLAMPED_EXPOSURE_US, Quirk
from edged.sim.gige.gvcp import PACKET_RESEND
from edged.sim.gige.registers import ACCESS_DENIED, INVALID_ADDRESS, INVALID_PARAMETER, SUCCESS

ADDRESS, OTHER = "127.0.52.1", "127.0.52.2"
BY_SOFTWARE = {"TRIGGER_MODE": 1, "PACKET_SIZE": 576}
PACKETS = tuple(range(8))  # leader, 6 of 540 bytes for 64 x 48 px, trailer


@pytest.fixture
def camera() -> Iterator[GigeCamera]:
    """A small camera."""
    with GigeCamera(ADDRESS, "EDGED-F1", moving_ramp, size=(64, 48)) as camera:
        yield camera


def shot(stream: Stream) -> Image:
    """One image by software trigger."""
    stream.client.set(TRIGGER_SOFTWARE=1)
    return stream.image()


def test_a_lost_packet_comes_when_it_is_asked_for(camera: GigeCamera) -> None:
    """PACKETRESEND sends the lost packets again, except if the camera ignores it."""
    with acquiring(ADDRESS, **BY_SOFTWARE) as stream:
        whole = shot(stream)
        camera.faults.lost_packets = (2, 3)
        torn = shot(stream)
        assert (whole.numbers, torn.numbers) == (PACKETS, (0, 1, 4, 5, 6, 7))
        stream.client.send(PACKET_RESEND, struct.pack(">HHII", 0, torn.block_id, 2, 3))
        again = [stream.packet() for _ in range(2)]
        assert [(block_id, number) for block_id, _, number, _ in again] == [(2, 2), (2, 3)]
        assert len(torn.data) + sum(len(body) for *_, body in again) == len(whole.data)
        camera.faults.no_resend = True
        stream.client.send(PACKET_RESEND, struct.pack(">HHII", 0, torn.block_id, 2, 3))
        assert stream.silent()


def test_reordered_and_repeated_packets_still_make_the_image(camera: GigeCamera) -> None:
    """Reordered and repeated packets all arrive, and the data are complete."""
    with acquiring(ADDRESS, **BY_SOFTWARE) as stream:
        expected = moving_ramp_bytes(1)
        camera.faults.duplication = 1.0
        stream.client.set(TRIGGER_SOFTWARE=1)
        twice = [stream.packet()[2] for _ in range(2 * len(PACKETS))]
        assert twice == [number for number in PACKETS for _ in range(2)]
        camera.faults.duplication, camera.faults.reordering = 0.0, 0.5
        stream.client.set(TRIGGER_SOFTWARE=1)
        packets = [stream.packet() for _ in PACKETS]
        numbers = [number for _, _, number, _ in packets]
        assert sorted(numbers) == list(PACKETS) != numbers
        data = b"".join(body for _, kind, _, body in sorted(packets, key=lambda p: p[2]) if kind == 3)
        assert data == moving_ramp_bytes(2) != expected


def moving_ramp_bytes(frame_id: int) -> bytes:
    """The image data of a sensor with the moving ramp."""
    return bytes((x + y + frame_id) % 256 for y in range(48) for x in range(64))


def test_missing_frozen_and_repeated_images(camera: GigeCamera) -> None:
    """After drop_next block ids have a gap; frozen gives a new id with old pixels; repeat_id new pixels
    with an old id."""
    with acquiring(ADDRESS, **BY_SOFTWARE) as stream:
        camera.faults.drop_next = 2
        stream.client.set(TRIGGER_SOFTWARE=1)
        stream.client.set(TRIGGER_SOFTWARE=1)
        third = shot(stream)
        assert third.block_id == 3
        camera.faults.frozen = True
        frozen = shot(stream)
        assert (frozen.block_id, frozen.data) == (4, third.data)
        assert frozen.ticks > third.ticks
        camera.faults.frozen, camera.faults.repeat_id = False, True
        assert shot(stream).block_id == 4


def test_chunk_data_lie_behind_the_image(camera: GigeCamera) -> None:
    """Each chunk is its content, id and length, is included in PayloadSize, and is sent only if enabled."""
    with acquiring(ADDRESS, **BY_SOFTWARE) as stream:
        client = stream.client
        client.set(ACQUISITION_STOP=1, CHUNK_MODE=1, EXPOSURE_TIME=123.0)
        for index in (1, 3):
            assert client.write(g.CHUNK_ENABLE + 4 * index, 0) == SUCCESS, "no time stamp and no count"
        client.set(ACQUISITION_START=1)
        image = shot(stream)
        size = client.read(g.PAYLOAD_SIZE)[1]

    assert image.payload_type == 0x4001
    assert len(image.data) == size == 64 * 48 + 8 + 16 + 12
    behind = struct.pack(">IIQIIfII", g.IMAGE_CHUNK_ID, 64 * 48, 1, 0x1001, 8, 123.0, 0x1003, 4)
    assert image.data == moving_ramp_bytes(1) + behind


@pytest.mark.slow
@pytest.mark.parametrize("by_command", [False, True])
def test_after_a_reboot_everything_is_as_it_was_made(camera: GigeCamera, by_command: bool) -> None:
    """After a reboot there is no control, registers and clock are reset, and the camera can be controlled
    again."""
    with acquiring(ADDRESS, **BY_SOFTWARE, WIDTH=32) as stream:
        client = stream.client
        time.sleep(0.3)
        if by_command:
            client.set(DEVICE_RESET=1)
        else:
            camera.reboot(0.3)
        client.socket.settimeout(0.15)
        client.send(0x80, struct.pack(">I", g.VERSION))
        with pytest.raises(TimeoutError):
            client.socket.recv(2048)
        time.sleep(0.5)
        client.socket.settimeout(2.0)
        assert client.write(g.TRIGGER_SOFTWARE, 1) == ACCESS_DENIED
        assert client.read(g.WIDTH) == (SUCCESS, 64)
        assert client.read(g.CONTROL_PRIVILEGE) == client.read(g.STREAM_PORT) == (SUCCESS, 0)
        client.set(CONTROL_PRIVILEGE=2)
        assert 0 < camera.clock.at(time.monotonic_ns()) < 5_000_000_000


def test_stolen_control_is_denied_until_it_is_released(camera: GigeCamera) -> None:
    """While control is stolen the register shows it, and the first client can read but not write."""
    with acquiring(ADDRESS, **BY_SOFTWARE) as stream:
        client = stream.client
        camera.steal_control()
        assert camera.controlled
        assert client.read(g.CONTROL_PRIVILEGE) == (SUCCESS, 2)
        assert client.write(g.TRIGGER_SOFTWARE, 1) == ACCESS_DENIED
        assert client.write(g.CONTROL_PRIVILEGE, 2) == ACCESS_DENIED
        camera.release_control()
        assert not camera.controlled
        assert client.write(g.CONTROL_PRIVILEGE, 2) == SUCCESS


def test_a_moved_camera_answers_at_its_new_address_only(camera: GigeCamera) -> None:
    """A moved camera answers at its new address alone, without a controller; a taken address is an error."""
    with Stream(Client(ADDRESS)) as stream:
        camera.move_to(OTHER)
        with pytest.raises((TimeoutError, ConnectionRefusedError)):
            stream.client.read(g.VERSION)
        elsewhere = Client(OTHER)
        _, body = elsewhere.ask(0x02, b"")
        assert body[g.SERIAL : g.SERIAL + 8] == b"EDGED-F1"
        assert body[g.CURRENT_IP : g.CURRENT_IP + 4] == bytes((127, 0, 52, 2))
        assert elsewhere.write(g.CONTROL_PRIVILEGE, 2) == SUCCESS
        elsewhere.socket.close()


def test_the_temperature_is_what_it_is_set_to(camera: GigeCamera) -> None:
    """The temperature is the set one, also after a reboot."""
    client = Client(ADDRESS)
    camera.temperature_c = 71.5
    assert client.float(g.TEMPERATURE) == 71.5
    camera.reboot(0.0)
    assert client.float(g.TEMPERATURE) == 71.5
    client.socket.close()


def test_a_lost_answer_does_not_mean_that_nothing_was_done(camera: GigeCamera) -> None:
    """A command with a lost answer is done once, and asked again gets the same answer."""
    with acquiring(ADDRESS, **BY_SOFTWARE) as stream:
        client = stream.client
        camera.faults.answer_loss = 1.0
        client.send(0x82, struct.pack(">II", g.TRIGGER_SOFTWARE, 1))
        assert stream.image().block_id == 1
        camera.faults.answer_loss = 0.0
        assert client.ask(0x82, struct.pack(">II", g.TRIGGER_SOFTWARE, 1), client.request)[0] == SUCCESS
        assert stream.silent()
        assert camera.exposures == 1


@pytest.fixture
def quirky(request: pytest.FixtureRequest) -> Iterator[Client]:
    """The controlling client of a camera with a quirk."""
    with (
        GigeCamera(ADDRESS, "EDGED-Q1", moving_ramp, size=(64, 48), quirks=[request.param]),
        Stream(Client(ADDRESS)) as stream,
    ):
        yield stream.client


@pytest.mark.parametrize("quirky", [Quirk.MODE_BEFORE_SOURCE], indirect=True)
def test_a_source_that_is_set_before_the_mode_is_forgotten(quirky: Client) -> None:
    """The source is acknowledged but not kept if it is written before the mode."""
    quirky.set(TRIGGER_SOURCE=g.LINE1)
    assert quirky.read(g.TRIGGER_SOURCE)[1] == g.SOFTWARE
    quirky.set(TRIGGER_MODE=1, TRIGGER_SOURCE=g.LINE1)
    assert quirky.read(g.TRIGGER_SOURCE)[1] == g.LINE1


@pytest.mark.parametrize("quirky", [Quirk.SOURCE_CLEARS_MODE], indirect=True)
def test_writing_the_source_switches_the_mode_off(quirky: Client) -> None:
    """Writing the source switches the trigger mode off."""
    quirky.set(TRIGGER_MODE=1, TRIGGER_SOURCE=g.LINE1)
    assert quirky.read(g.TRIGGER_MODE)[1] == 0


@pytest.mark.parametrize("quirky", [Quirk.CLAMPED_EXPOSURE], indirect=True)
def test_long_exposures_are_cut_without_a_word(quirky: Client) -> None:
    """A long exposure is cut and read back as cut; beyond the limits it is refused."""
    quirky.set(EXPOSURE_TIME=50_000.0)
    assert quirky.float(g.EXPOSURE_TIME) == CLAMPED_EXPOSURE_US
    too_long = int.from_bytes(struct.pack(">f", 2e6), "big")
    assert quirky.write(g.EXPOSURE_TIME, too_long) == INVALID_PARAMETER


@pytest.mark.parametrize("quirky", [Quirk.EXPOSURE_TIME_ABS, Quirk.FEW_NODES], indirect=True)
def test_the_description_has_the_nodes_of_that_firmware(quirky: Client) -> None:
    """The description has the quirk's nodes: an old name, or few nodes without registers behind the
    others."""
    text = b""
    _, body = quirky.ask(0x84, struct.pack(">IHH", g.FIRST_URL, 0, 512))
    address, size = (int(part, 16) for part in body[4:].rstrip(b"\0").decode().split(";")[1:])
    while len(text) < size:
        wanted = min(512, size - len(text))
        text += quirky.ask(0x84, struct.pack(">IHH", address + len(text), 0, wanted))[1][4:]
    names = set(re.findall(r'<(?:Float|Boolean) Name="(\w+)"', text.decode()))
    few = "PtpEnable" not in names
    assert few == (quirky.read(g.PTP_ENABLE)[0] == INVALID_ADDRESS)
    assert {"ExposureTime", "ExposureTimeAbs"} & names == {"ExposureTime" if few else "ExposureTimeAbs"}
