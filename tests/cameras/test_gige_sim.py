"""The virtual GigE Vision camera: by raw datagrams here, by the real Aravis in test_aravis.py and below."""

from __future__ import annotations

import asyncio
import random
import socket
import struct
import time
from collections.abc import Iterator

import numpy as np
import pytest
from helpers.gigeclient import Client
from helpers.needs import needs_aravis
from helpers.waiting import LIMIT_S

from edged.adapters.aravis import AravisCamera, AravisSettings, list_cameras
from edged.domain.arrays import Image
from edged.errors import CaptureError, ListenError
from edged.sim.exposure import ExposureRequest
from edged.sim.gige import genicam as g
from edged.sim.gige.camera import Faults, GigeCamera, moving_ramp
from edged.sim.gige.registers import (
    ACCESS_DENIED,
    BAD_ALIGNMENT,
    INVALID_ADDRESS,
    INVALID_PARAMETER,
    NOT_IMPLEMENTED,
    SUCCESS,
    WRITE_PROTECT,
)

ADDRESS, OTHER = "127.0.50.1", "127.0.50.2"
needs_camera = needs_aravis()


class Sensor:
    """Noise images, kept by frame id."""

    def __init__(self) -> None:
        self.seen: list[Image] = []

    def __call__(self, request: ExposureRequest) -> Image:
        rng = np.random.default_rng(request.frame_id)
        self.seen.append(rng.integers(0, 256, (request.height, request.width), dtype=np.uint8))
        return self.seen[-1]


@pytest.fixture
def camera() -> Iterator[GigeCamera]:
    """A small camera with a test pattern."""
    with GigeCamera(ADDRESS, "EDGED-SIM", moving_ramp, size=(64, 48)) as camera:
        yield camera


@pytest.fixture
def client(camera: GigeCamera) -> Iterator[Client]:
    """A client of it."""
    client = Client(ADDRESS)
    yield client
    client.socket.close()


def test_discovery_names_the_camera(client: Client) -> None:
    """The discovery answer has 248 bytes with address, maker, model and serial number."""
    status, body = client.ask(0x02, b"")

    assert (status, len(body)) == (SUCCESS, 248)
    assert body[g.CURRENT_IP : g.CURRENT_IP + 4] == socket.inet_aton(ADDRESS)
    assert body[g.SERIAL : g.SERIAL + 16].rstrip(b"\0") == b"EDGED-SIM"


def test_registers_answer_with_the_status_of_the_standard(client: Client) -> None:
    """Invalid address, bad alignment, write protect, wrong value, unknown command: each has its own code."""
    assert client.read(0x0F00_0000)[0] == INVALID_ADDRESS
    assert client.read(g.VERSION + 1)[0] == BAD_ALIGNMENT
    assert client.write(g.WIDTH, 64) == ACCESS_DENIED, "control comes first"
    assert client.write(g.CONTROL_PRIVILEGE, 2) == SUCCESS
    assert client.write(g.VERSION, 1) == WRITE_PROTECT
    assert client.write(g.PAYLOAD_SIZE, 1) == WRITE_PROTECT
    assert client.write(g.WIDTH, 4096) == INVALID_PARAMETER
    assert client.write(g.TRIGGER_MODE, 9) == INVALID_PARAMETER
    assert client.write(g.WIDTH, 32) == SUCCESS
    assert client.read(g.PAYLOAD_SIZE) == (SUCCESS, 32 * 48)
    assert client.ask(0x00F0, b"")[0] == NOT_IMPLEMENTED


def test_the_description_can_be_read_from_the_address_it_names(client: Client) -> None:
    """The URL register gives the place of the whole XML."""
    _, body = client.ask(0x84, struct.pack(">IHH", g.FIRST_URL, 0, 512))
    name, address, size = body[4:].rstrip(b"\0").decode().removeprefix("Local:").split(";")
    text = b""
    while len(text) < int(size, 16):
        wanted = min(512, int(size, 16) - len(text))
        text += client.ask(0x84, struct.pack(">IHH", int(address, 16) + len(text), 0, wanted))[1][4:]

    assert name.endswith(".xml")
    assert text.rstrip(b"\0").startswith(b"<?xml")
    assert text.rstrip(b"\0").endswith(b"</RegisterDescription>")


def test_a_repeated_request_is_answered_again_but_not_done_again(client: Client) -> None:
    """A repeated request is answered again but exposes only once."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stream:
        stream.bind(("127.0.0.1", 0))
        stream.settimeout(2.0)
        client.write(g.CONTROL_PRIVILEGE, 2)
        client.write(g.STREAM_DESTINATION, int.from_bytes(socket.inet_aton("127.0.0.1"), "big"))
        client.write(g.STREAM_PORT, stream.getsockname()[1])
        client.write(g.TRIGGER_MODE, 1)
        client.write(g.ACQUISITION_START, 1)
        number = client.request + 1
        for _ in range(3):
            assert client.ask(0x82, struct.pack(">II", g.TRIGGER_SOFTWARE, 1), number)[0] == SUCCESS
        leaders = []
        stream.settimeout(0.3)
        with pytest.raises(TimeoutError):
            while True:
                packet = stream.recv(2048)
                if packet[4] == 1:
                    leaders.append(packet)
        assert len(leaders) == 1


def test_one_controller_at_a_time_and_a_silent_one_loses_control(client: Client) -> None:
    """A second client is denied control until the first one's heartbeat is missing."""
    second = Client(ADDRESS)
    try:
        assert client.write(g.CONTROL_PRIVILEGE, 2) == SUCCESS
        assert client.write(g.HEARTBEAT_MS, 500) == SUCCESS
        assert second.write(g.CONTROL_PRIVILEGE, 2) == ACCESS_DENIED
        deadline_s = time.monotonic() + LIMIT_S
        while second.write(g.CONTROL_PRIVILEGE, 2) != SUCCESS:
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
        assert client.write(g.WIDTH, 32) == ACCESS_DENIED
    finally:
        second.socket.close()


def test_hostile_datagrams_do_not_stop_it(client: Client) -> None:
    """After random bytes, changed commands and wrong lengths the next good request is answered."""
    rng = random.Random(3)
    for _ in range(3000):
        size = rng.randrange(0, 64)
        if rng.random() < 0.5:
            client.socket.send(rng.randbytes(size))
        else:
            command = rng.choice((0x02, 0x40, 0x80, 0x82, 0x84, 0x86, 0x100))
            length = size if rng.random() < 0.7 else rng.randrange(0, 0x10000)
            head = struct.pack(">BBHHH", 0x42, 0, command, length, rng.randrange(0x10000))
            client.socket.send(head + rng.randbytes(size))
    client.socket.settimeout(0.3)
    try:
        while True:
            client.socket.recv(2048)
    except TimeoutError:
        client.socket.settimeout(2.0)
    client.request = 0x4000
    assert client.read(g.VERSION) == (SUCCESS, 0x0002_0000)


def test_an_unplugged_camera_says_nothing(camera: GigeCamera, client: Client) -> None:
    """An unplugged camera does not answer, and does again once it is plugged in."""
    camera.faults.unplugged = True
    client.socket.settimeout(0.3)
    client.send(0x80, struct.pack(">I", g.VERSION))
    with pytest.raises(TimeoutError):
        client.socket.recv(2048)
    camera.faults.unplugged = False
    assert client.read(g.VERSION)[0] == SUCCESS


def test_a_taken_port_is_a_clear_error(camera: GigeCamera) -> None:
    """A taken address is an error that names it."""
    with pytest.raises(ListenError, match=ADDRESS):
        GigeCamera(ADDRESS, "TWIN", moving_ramp).start()


def test_stopping_leaves_nothing_behind() -> None:
    """A camera can be started and stopped repeatedly at one address."""
    for _ in range(5):
        with GigeCamera(ADDRESS, "AGAIN", moving_ramp, size=(64, 48)):
            pass


@pytest.mark.slow
@needs_camera
def test_aravis_finds_two_cameras_of_one_process() -> None:
    """Both cameras answer a broadcast discovery."""
    with (
        GigeCamera(ADDRESS, "EDGED-D1", moving_ramp, size=(64, 48)),
        GigeCamera(OTHER, "EDGED-D2", moving_ramp, size=(64, 48)),
    ):
        found = {camera.serial: camera.address for camera in list_cameras()}

    assert {"EDGED-D1": ADDRESS, "EDGED-D2": OTHER}.items() <= found.items()


@pytest.mark.slow
@needs_camera
@pytest.mark.parametrize("user_socket", [False, True])
def test_lost_packets_are_sent_again_and_every_image_is_whole(user_socket: bool) -> None:
    """With 2 % of all packets lost Aravis asks for them again, and images equal what was exposed."""
    sensor = Sensor()

    async def shoot(count: int) -> int:
        settings = AravisSettings(ADDRESS, packet_size=1500, user_socket=user_socket)
        camera = AravisCamera("left", settings)
        whole = 0
        try:
            await camera.open()
            for _ in range(count):
                before = len(sensor.seen)
                await camera.trigger()
                try:
                    async with asyncio.timeout(3):
                        frame = await camera.frame()
                except (CaptureError, TimeoutError):
                    continue  # a resent packet may be lost, too: then there is no image, never a wrong one
                assert np.array_equal(frame.image, sensor.seen[-1])
                assert len(sensor.seen) == before + 1
                whole += 1
        finally:
            await camera.close()
        return whole

    with GigeCamera(ADDRESS, "EDGED-LOSS", sensor, size=(640, 480), faults=Faults(packet_loss=0.02)):
        assert asyncio.run(shoot(10)) >= 8
