"""The action command as a datagram, with a peer whose answer the test sets."""

from __future__ import annotations

import errno
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from edged.adapters.aravis import Action
from edged.adapters.aravis.trigger import ACTION_ACK, ACTION_COMMAND, send_action
from edged.errors import FrameTimeout

PEER, OTHER = "127.0.41.1", "127.0.41.2"
ACTION = Action(0xA1B2C3D4, 0x11, 0x10, (PEER,))


@contextmanager
def peer(answer: Callable[[bytes], list[bytes]], address: str = PEER) -> Iterator[list[bytes]]:
    """A device on GigE Vision's port, and the commands it received."""
    heard: list[bytes] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind((address, 3956))

        def serve() -> None:
            while True:
                data, sender = udp.recvfrom(2048)
                if not data:
                    return
                heard.append(data)
                for message in answer(data):
                    udp.sendto(message, sender)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield heard
        finally:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
                end.sendto(b"", (address, 3956))
            thread.join()


def acknowledged(data: bytes, status: int = 0, request: int | None = None) -> list[bytes]:
    """An ACTION_ACK as in the specification."""
    number = struct.unpack(">H", data[6:8])[0] if request is None else request
    return [struct.pack(">HHHH", status, ACTION_ACK, 0, number)]


def test_the_command_is_the_one_of_the_specification() -> None:
    """The command has the fields of GigE Vision 2.0, 16.7: key 0x42, flags, 0x0100, length, id; device
    key, group key, group mask."""
    with peer(acknowledged) as heard:
        send_action("left", ACTION, None, 7)

    assert [bytes.fromhex("4201 0100 000c 0007 a1b2c3d4 00000011 00000010")] == heard


def test_a_scheduled_command_carries_its_time() -> None:
    """A scheduled command has flag 0x80 and 64 bits of time in a body of 20 bytes."""
    with peer(acknowledged) as heard:
        send_action("left", ACTION, 0x1122334455667788, 8)

    (command,) = heard
    assert (0x42, 0x81, ACTION_COMMAND, 20, 8) == struct.unpack(">BBHHH", command[:8])
    assert bytes.fromhex("1122334455667788") == command[-8:]


def test_both_cameras_must_acknowledge() -> None:
    """A camera that does not acknowledge is named; the command is not repeated, because it might expose
    twice."""
    both = Action(1, 1, 1, (PEER, OTHER))
    with (
        peer(acknowledged) as heard,
        peer(lambda _: [], OTHER) as silent,
        pytest.raises(FrameTimeout, match=r"camera left: .* not acknowledged by 127\.0\.41\.2$"),
    ):
        send_action("left", both, None, 9)

    assert 1 == len(heard) == len(silent)


def test_nobody_there_is_a_fault() -> None:
    """Without an answer or with an ICMP refusal the command fails."""
    with pytest.raises(FrameTimeout):
        send_action("left", ACTION, None, 10)


@pytest.mark.parametrize(
    "status, reason",
    [(0x8016, "too late: its lead is too short"), (0x8013, "no PTP time"), (0x8006, "status 0x8006")],
)
def test_a_refusal_is_told_with_its_reason(status: int, reason: str) -> None:
    """A refusal raises FrameTimeout with the reason of its status."""
    with peer(lambda data: acknowledged(data, status)), pytest.raises(FrameTimeout, match=reason):
        send_action("left", ACTION, 5, 11)


def test_answers_to_others_are_passed_over() -> None:
    """Short datagrams, other kinds and other numbers do not count as acknowledgement; the right one does."""

    def answer(data: bytes) -> list[bytes]:
        noise = [b"\x00", struct.pack(">HHHH", 0, 0x83, 0, 12), *acknowledged(data, request=11)]
        return [*noise, *acknowledged(data)]

    with peer(answer):
        send_action("left", ACTION, None, 12)


def test_a_broadcast_waits_for_no_acknowledgement() -> None:
    """A broadcast does not ask for an acknowledgement, and an answer does no harm."""
    with peer(acknowledged) as heard:
        send_action("left", Action(1, 1, 1, (PEER,), broadcast=True), None, 13)

    (command,) = heard
    assert 0 == command[1]


def test_without_a_descriptor_an_action_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a free file descriptor the command raises FrameTimeout."""

    def exhausted(*_: object) -> socket.socket:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(socket, "socket", exhausted)
    with pytest.raises(FrameTimeout, match="Too many open files"):
        send_action("left", ACTION, None, 14)
