"""A data block of a Siemens S7, by python-snap7."""

from __future__ import annotations

import socket

from snap7 import Client
from snap7.error import S7Error

from edged.config.plc import S7Section
from edged.errors import PlcFault
from edged.plc.processimage import FROM_CELL_BYTES, IMAGE_BYTES, TO_CELL_BYTES


class S7Memory:
    """See `exchange.PlcMemory`."""

    is_little = False

    def __init__(self, host: str, section: S7Section, answer_s: float) -> None:
        self._host, self._section, self._answer_s = host, section, answer_s
        self._client = Client()
        self._place = f"DB{section.db}"

    def open(self) -> None:
        """Connect, and check that the block has its 192 bytes."""
        section = self._section
        try:
            self._client.connect(self._host, section.rack, section.slot, section.port)
        except S7Error as error:
            raise PlcFault(
                f"{self._host}:{section.port}, rack {section.rack}, slot {section.slot}: {error}", "connect"
            ) from error
        if (line := self.line) is not None:
            line.settimeout(self._answer_s)
        if self._client.pdu_length < FROM_CELL_BYTES + 35:  # by the manual, the smallest CPU has 240
            raise PlcFault(
                f"{self._host} takes telegrams of {self._client.pdu_length} bytes only", "telegram"
            )
        self._read(IMAGE_BYTES)

    def read(self) -> bytes:
        """Read the image to the cell in one telegram."""
        return self._read(TO_CELL_BYTES)

    def write(self, image: bytes) -> None:
        """Write the image from the cell in one telegram."""
        section = self._section
        try:
            self._client.db_write(section.db, section.offset + TO_CELL_BYTES, bytearray(image))
        except S7Error as error:
            raise PlcFault(f"{self._host}, {self._place} cannot be written: {error}", "write") from error

    def close(self) -> None:
        """Disconnect."""
        self._client.disconnect()

    @property
    def line(self) -> socket.socket | None:
        """The open socket; None if there is none."""
        connection = self._client.connection
        return None if connection is None else connection.socket

    def _read(self, size: int) -> bytes:
        section = self._section
        try:
            data = bytes(self._client.db_read(section.db, section.offset, size))
        except S7Error as error:
            raise PlcFault(
                f"{self._host}, {self._place}, {size} bytes from {section.offset} on: {error} "
                "(expected: the block is that long, its access not optimized, and the CPU permits PUT/GET)",
                "read",
            ) from error
        if len(data) != size:
            raise PlcFault(f"{self._host}, {self._place}: {len(data)} bytes for {size}", "read")
        return data
