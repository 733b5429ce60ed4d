"""The thread that exchanges data with a PLC: writes during a read, and more images than can be written."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable

import pytest
from helpers.waiting import LIMIT_S, wait_until

from edged.adapters.plcmemory.exchange import ExchangeThread
from edged.errors import PlcFault
from edged.plc.processimage import NO_IMAGE, TO_CELL_BYTES

FLANGE_X, CONTROL = 12, 42


class Memory:
    """A PLC whose program goes on between two words of one answer.

    meanwhile : what the program does there; the words before `torn_at` are old, the others new.
    """

    is_little = False
    line = None

    def __init__(self) -> None:
        self.image = bytearray(TO_CELL_BYTES)
        self.meanwhile: Callable[[], None] | None = None
        self.torn_at = CONTROL
        self.written: list[bytes] = []
        self.may_write = threading.Event()
        self.may_write.set()
        self.fault: Exception | None = None
        self.opened = 0

    def open(self) -> None:
        self.opened += 1
        if self.fault is not None:
            raise self.fault

    def read(self) -> bytes:
        before, work = bytes(self.image[: self.torn_at]), self.meanwhile
        if work is not None:
            self.meanwhile = None
            work()
        return before + bytes(self.image[self.torn_at :])

    def write(self, image: bytes) -> None:
        assert self.may_write.wait(LIMIT_S)
        self.written.append(image)

    def close(self) -> None:
        pass


class Taker:
    """A cell that keeps what it gets."""

    def __init__(self, memory: Memory) -> None:
        self.images: list[bytes] = []
        self.faults: list[PlcFault] = []
        self.thread = ExchangeThread(lambda: memory, 0.002, self.images.append, self.faults.append)

    def __enter__(self) -> Taker:
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        assert self.thread.stop(LIMIT_S)


def test_a_command_comes_with_all_that_was_written_before_it() -> None:
    """If START comes with an older FLANGE, the flange is read again, so the command has the new one."""
    memory = Memory()

    def command() -> None:
        struct.pack_into(">i", memory.image, FLANGE_X, 1234)
        struct.pack_into(">H", memory.image, CONTROL, 1)

    with Taker(memory) as taker:
        wait_until(lambda: taker.images)
        memory.meanwhile = command
        wait_until(lambda: len(taker.images) > 1)
    first = next(image for image in taker.images if image[CONTROL + 1])
    assert (1234,) == struct.unpack_from(">i", first, FLANGE_X)


def test_an_image_is_handed_on_once_and_the_newest_is_written() -> None:
    """Each image is taken once, only the newest one is written, and the last one says that there is no
    cell."""
    memory = Memory()
    with Taker(memory) as taker:
        wait_until(lambda: memory.written and taker.images)
        memory.may_write.clear()
        for number in range(1, 100):
            taker.thread.post(bytes([number]) * 128)
        memory.may_write.set()
        wait_until(lambda: memory.written[-1] == bytes([99]) * 128)
    assert 1 == len(taker.images)
    assert len(memory.written) <= 5
    assert NO_IMAGE == memory.written[-1]


@pytest.mark.parametrize("error", [PlcFault("no such block", "read"), IndexError("pop"), struct.error("8")])
def test_whatever_a_library_raises_is_said_and_tried_again(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Any exception of a library is reported and the exchange is tried again until it works."""
    for name in ("FIRST_RETRY_S", "LAST_RETRY_S"):
        monkeypatch.setattr(f"edged.adapters.plcmemory.exchange.{name}", 0.01)
    memory = Memory()
    memory.fault = error
    with Taker(memory) as taker:
        wait_until(lambda: memory.opened > 3)
        assert str(error) in str(taker.faults[0])
        memory.fault = None
        wait_until(lambda: taker.images)
