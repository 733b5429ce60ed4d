"""Packets of the GigE Vision stream protocol (GVSP, specification 2.0, chapter 23)."""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass

from edged.sim.genicam import MONO8

LEADER, TRAILER, PAYLOAD = 1, 2, 3
IMAGE = 1
BURST_BYTES = 96 * 1024
"""Half of Linux's default receive buffer of 208 KiB: a receiver without privileges keeps up."""
BURST_PAUSE_S = 0.0003


@dataclass(frozen=True, slots=True)
class Block:
    """One image on its way. packet_bytes : image bytes in each packet."""

    block_id: int
    device_ns: int
    width: int
    height: int
    offset: tuple[int, int]
    data: bytes
    packet_bytes: int

    @property
    def packets(self) -> int:
        """Payload packets; they are numbered from 1, the leader is 0, the trailer the next one."""
        return -(-len(self.data) // self.packet_bytes)


def _header(block: Block, kind: int, number: int) -> bytes:
    return struct.pack(">HHI", 0, block.block_id, kind << 24 | number)


def leader(block: Block) -> bytes:
    """What comes: payload type, time stamp, pixel format and region."""
    image = (MONO8, block.width, block.height, *block.offset, 0, 0)
    time_stamp = (block.device_ns >> 32 & 0xFFFFFFFF, block.device_ns & 0xFFFFFFFF)
    return _header(block, LEADER, 0) + struct.pack(">HHIIIIIIIHH", 0, IMAGE, *time_stamp, *image)


def payload_packet(block: Block, number: int) -> tuple[bytes, memoryview]:
    """Header and data of the payload packet with this number, from 1."""
    start = (number - 1) * block.packet_bytes
    return _header(block, PAYLOAD, number), memoryview(block.data)[start : start + block.packet_bytes]


def trailer(block: Block) -> bytes:
    """That was all: the number of lines."""
    return _header(block, TRAILER, block.packets + 1) + struct.pack(">HHI", 0, IMAGE, block.height)


class Pacing:
    """Keeps a sender from overrunning receivers: pauses after bursts, and the packet delay it was told."""

    def __init__(self, burst_bytes: int = BURST_BYTES, pause_s: float = BURST_PAUSE_S) -> None:
        self._burst_bytes, self._pause_s = burst_bytes, pause_s
        self._sent = 0

    def begin(self) -> None:
        """A new block."""
        self._sent = 0

    def wait(self, sent_bytes: int, delay_s: float) -> None:
        """After a packet of so many bytes."""
        if delay_s > 0:
            time.sleep(delay_s)
        self._sent += sent_bytes
        if self._sent >= self._burst_bytes:
            self._sent = 0
            time.sleep(self._pause_s)
