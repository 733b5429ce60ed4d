"""Stream channel of a virtual camera: sends blocks as packets through a socket, with injected faults."""

from __future__ import annotations

import logging
import random
import socket
import time
from collections import OrderedDict

from edged.sim.gige.faults import Faults
from edged.sim.gige.gvsp import ImageBlock, packet

log = logging.getLogger(__name__)

KEPT_BLOCKS = 4  # frames whose packets can be resent
BURST_BYTES = 96 * 1024
"""Half of Linux's default receive buffer of 208 KiB, so that a receiver without privileges keeps up."""
BURST_PAUSE_S = 0.0003
SEND_BUFFER_BYTES = 4 * 1024 * 1024


class Pacing:
    """Keeps a sender from overrunning receivers by pauses after bursts and the configured packet delay."""

    def __init__(self) -> None:
        self._sent = 0

    def begin(self) -> None:
        """Start a new block."""
        self._sent = 0

    def wait(self, sent_bytes: int, delay_s: float) -> None:
        """Pause as needed after a packet of this size."""
        if delay_s > 0:
            time.sleep(delay_s)
        self._sent += sent_bytes
        if self._sent >= BURST_BYTES:
            self._sent = 0
            time.sleep(BURST_PAUSE_S)


class StreamChannel:
    """Sends blocks, and keeps the last few for resend requests."""

    def __init__(self, address: str, faults: Faults, chance: random.Random) -> None:
        self._address, self._faults, self._pacing, self._chance = address, faults, Pacing(), chance
        self._socket: socket.socket | None = None
        self._destination: tuple[str, int] | None = None
        self._blocks: OrderedDict[int, ImageBlock] = OrderedDict()

    def open(self) -> int:
        """Open the socket; returns its source port. Raises `OSError`."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((self._address, 0))
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        return int(self._socket.getsockname()[1])

    def close(self) -> None:
        """Close the socket; safe to call twice."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def forget(self) -> None:
        """Discard all kept blocks."""
        self._blocks.clear()

    def send(self, block: ImageBlock, destination: tuple[str, int], delay_s: float) -> None:
        """Send all packets of a block, `delay_s` apart."""
        self._blocks[block.block_id] = block
        while len(self._blocks) > KEPT_BLOCKS:
            self._blocks.popitem(last=False)
        self._destination = destination
        self._pacing.begin()
        for number in self._order(block.packets + 2):
            if number not in self._faults.lost_packets:
                self._send(packet(block, number))
            self._pacing.wait(block.packet_bytes, delay_s)

    def resend(self, block_id: int, first: int, last: int) -> None:
        """Send these packets again, if the block is still kept."""
        block = self._blocks.get(block_id)
        if block is None or self._faults.no_resend:
            return
        for number in range(first, min(last, block.packets + 1) + 1):
            self._send(packet(block, number))

    def send_test(self, size: int, destination: tuple[str, int]) -> None:
        """Send one test packet of this size."""
        self._destination = destination
        self._send((b"\0" * size,))

    def _order(self, count: int) -> list[int]:
        """Packet numbers in sending order, with injected reordering and duplication."""
        faults, chance = self._faults, self._chance
        order = list(range(count))
        if faults.reordering > 0:
            for place in range(count - 1):
                if chance.random() < faults.reordering:
                    order[place], order[place + 1] = order[place + 1], order[place]
        if faults.duplication > 0:
            order = [n for number in order for n in [number] * (1 + (chance.random() < faults.duplication))]
        return order

    def _send(self, parts: tuple[bytes, ...]) -> None:
        if self._socket is None or self._destination is None or self._destination[1] == 0:
            return
        if self._faults.unplugged:
            return
        if self._faults.packet_loss > 0 and self._chance.random() < self._faults.packet_loss:
            return
        try:
            self._socket.sendmsg(parts, [], 0, self._destination)
        except OSError as error:  # no listener any more, or the datagram exceeds the path's MTU
            log.debug("virtual camera %s: packet not sent: %s", self._address, error)
