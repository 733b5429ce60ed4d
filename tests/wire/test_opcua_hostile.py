"""Hostile or broken OPC UA clients: each limit by itself, and all together with the fuzzer."""

from __future__ import annotations

import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from asyncua import ua
from asyncua.crypto.permission_rules import UserRole
from helpers.opcuacell import PASSWORD, PASSWORD_HASH, OpcUaCell, client_of
from helpers.waiting import LIMIT_S

from edged.adapters.opcua import OpcUaSettings, connection
from edged.adapters.opcua.security import FREE_ATTEMPTS, LOCKED_S, Users, first_certificate
from edged.adapters.opcua.session import MAX_NODES, MAX_SUBSCRIPTIONS

FUZZER = Path(__file__).parents[2] / "tools" / "fuzz_opcua.py"
HELLO_URL = b"opc.tcp://cell"
HOSTILE = "127.0.0.2"


@pytest.fixture(scope="module")
def cell() -> Iterator[OpcUaCell]:
    """A cell that anyone may read."""
    with OpcUaCell(OpcUaSettings("cell1", port=0, anonymous=True, max_clients=8)) as running:
        yield running


def connect(cell: OpcUaCell, source: str = HOSTILE) -> socket.socket:
    """A plain TCP connection."""
    line = socket.create_connection(("127.0.0.1", cell.publisher.port), 10, source_address=(source, 0))
    line.settimeout(LIMIT_S)
    return line


def hello(buffers: int = 65535) -> bytes:
    """First message of a client."""
    body = struct.pack("<IIIII", 0, buffers, buffers, 0, 0) + struct.pack("<i", len(HELLO_URL)) + HELLO_URL
    return b"HELF" + struct.pack("<I", len(body) + 8) + body


def answer(line: socket.socket) -> tuple[bytes, int]:
    """Kind of the answer, and the status of an error; (b"", 0) if closed without one."""
    data = line.recv(4096)
    while data and line.recv(4096):
        pass
    return data[:3], struct.unpack_from("<I", data, 8)[0] if data[:3] == b"ERR" else 0


@pytest.mark.slow
def test_ten_thousand_hostile_frames_leave_no_trace() -> None:
    """After 10000 frames nothing has crashed, hung or grown, and a good client got every answer."""
    run = subprocess.run(
        [sys.executable, str(FUZZER), "--frames", "10000"],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )

    assert 0 == run.returncode, run.stdout + run.stderr
    assert "every read was good" in run.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    "sent",
    [
        b"GET / HTTP/1.1\r\n\r\n",
        b"HELF" + struct.pack("<I", 0xFFFFFFFF),
        b"HELF" + struct.pack("<I", 8),
        b"MSGF" + struct.pack("<I", 65536),
        b"MSGF" + struct.pack("<I", 32) + bytes(24),
        hello() + hello(),
    ],
)
def test_what_is_no_opc_ua_is_hung_up_on_at_once(sent: bytes, cell: OpcUaCell) -> None:
    """Invalid data get an error at once, without waiting for the announced length."""
    with closing(connect(cell)) as line:
        line.sendall(sent)
        data = b""
        while chunk := line.recv(4096):
            data += chunk

    assert b"ERRF" == data[-16:-12]
    assert ua.StatusCodes.BadTcpMessageTypeInvalid == struct.unpack_from("<I", data, len(data) - 8)[0]


@pytest.mark.slow
def test_buffers_that_would_cut_answers_into_crumbs_are_refused(cell: OpcUaCell) -> None:
    """Buffers below the specified 8192 bytes are refused: with 60, answers would need a hundred pieces."""
    with closing(connect(cell)) as line:
        line.sendall(hello(60))

        assert (b"ERR", ua.StatusCodes.BadTcpNotEnoughResources) == answer(line)


@pytest.mark.slow
def test_who_says_nothing_has_to_go(cell: OpcUaCell, monkeypatch: pytest.MonkeyPatch) -> None:
    """A silent connection and one that sends an incomplete message are closed."""
    monkeypatch.setattr(connection, "ACTIVATE_S", 0.3)
    with closing(connect(cell)) as silent, closing(connect(cell)) as slow:
        slow.sendall(hello()[:20])

        for line in (silent, slow):
            with pytest.raises(ConnectionError):
                if line.recv(1) == b"":
                    raise ConnectionResetError


@pytest.mark.slow
async def test_a_full_house_of_strangers_leaves_room_for_others(cell: OpcUaCell) -> None:
    """One address gets at most half of the connections, and other clients can connect and stay."""
    async with client_of(cell.url) as first:
        with ExitStack() as lines:
            for _ in range(30):
                lines.enter_context(closing(connect(cell)))
            async with client_of(cell.url) as second:
                for client in (first, second):
                    assert 1 == await client.get_node("ns=3;s=Registers.status.ACTIVE_JOB").read_value()


@pytest.mark.slow
async def test_a_request_is_bounded(cell: OpcUaCell) -> None:
    """A read accepts the stated number of nodes and no more, and a request calls one method only."""
    async with client_of(cell.url) as client:
        said = client.get_node(ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead)
        assert MAX_NODES == await said.read_value()
        one = ua.ReadValueId(NodeId=ua.NodeId(2258), AttributeId=ua.AttributeIds.Value)
        await client.uaclient.read(ua.ReadParameters(NodesToRead=[one] * MAX_NODES))
        with pytest.raises(ua.uaerrors.BadTooManyOperations):
            await client.uaclient.read(ua.ReadParameters(NodesToRead=[one] * (MAX_NODES + 1)))
        call = ua.CallMethodRequest(ua.NodeId("Handshake", 3), ua.NodeId("Handshake.Release", 3))
        with pytest.raises(ua.uaerrors.BadTooManyOperations):
            await client.uaclient.call([call, call])


@pytest.mark.long
async def test_a_session_holds_a_share_and_no_more(cell: OpcUaCell) -> None:
    """A session has a limited number of subscriptions and monitored items, which end with it."""

    class Notes:
        def datachange_notification(self, node: object, value: object, data: object) -> None:
            """Ignore it."""

    for _ in range(3):
        async with client_of(cell.url) as client:
            for _ in range(MAX_SUBSCRIPTIONS):
                subscription = await client.create_subscription(0, Notes())
            with pytest.raises(ua.uaerrors.BadTooManySubscriptions):
                await client.create_subscription(0, Notes())
            node = client.get_node("ns=3;s=Registers.status.HEARTBEAT")
            with pytest.raises(ua.uaerrors.BadTooManyMonitoredItems):
                for _ in range(5):
                    await subscription.subscribe_data_change([node] * 900)


# --- passwords -------------------------------------------------------------------------------------


class Clock:
    """A clock that is set by hand."""

    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def users(clock: Clock, *, anonymous: bool = False) -> Users:
    """Users of one server, with a client on an encrypted channel."""
    found = Users(OpcUaSettings("c", password_hash=PASSWORD_HASH, anonymous=anonymous), clock)
    found.peer, found.is_encrypted = "10.0.0.1", True
    return found


@pytest.mark.slow
def test_a_user_with_a_name_may_command_and_nobody_else() -> None:
    """Only the right name and password give a user; without a password a client is anonymous if allowed."""
    found = users(Clock(), anonymous=True).get_user(None, "operator", PASSWORD)
    assert found is not None
    assert ("operator", UserRole.User) == (found.name, found.role)
    assert users(Clock()).get_user(None, "operator", "wrong") is None
    assert users(Clock()).get_user(None, "root", PASSWORD) is None
    assert users(Clock()).get_user(None) is None
    anonymous = users(Clock(), anonymous=True).get_user(None)
    assert anonymous is not None and anonymous.name is None


@pytest.mark.slow
def test_no_password_is_looked_at_that_came_unencrypted() -> None:
    """On an unencrypted channel even the right password is refused."""
    some = users(Clock(), anonymous=True)
    some.is_encrypted = False

    assert some.get_user(None, "operator", PASSWORD) is None


@pytest.mark.slow
def test_who_guesses_has_to_wait_and_others_need_not() -> None:
    """After five wrong passwords even the right one is refused for half a minute, but not from elsewhere."""
    clock = Clock()
    some = users(clock)
    for _ in range(FREE_ATTEMPTS):
        clock.now_s += 1.0  # within the rate at which hashes are made
        assert some.get_user(None, "operator", "wrong") is None
    clock.now_s += 1.0
    assert some.get_user(None, "operator", PASSWORD) is None
    clock.now_s += LOCKED_S + 1
    assert some.get_user(None, "operator", PASSWORD) is not None

    other = users(clock)
    for _ in range(FREE_ATTEMPTS):
        clock.now_s += 1.0
        assert other.get_user(None, "operator", "wrong") is None
    clock.now_s += 1.0
    other.peer = "10.0.0.2"
    assert other.get_user(None, "operator", PASSWORD) is not None


@pytest.mark.slow
def test_the_first_of_a_chain_of_certificates_is_the_clients() -> None:
    """The first certificate of a chain is cut by its length, and other data are returned unchanged."""
    short, long = b"0\x03abc", b"0\x82\x01\x00" + bytes(256)

    assert short == first_certificate(short + long)
    assert long == first_certificate(long + short)
    assert b"noise" == first_certificate(b"noise")
