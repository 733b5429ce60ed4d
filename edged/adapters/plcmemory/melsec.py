"""Word devices of a Mitsubishi MELSEC CPU, by SLMP (binary, TCP) with plc-comm-slmp, which limits waiting."""

from __future__ import annotations

import socket
import struct

from slmp import SlmpClient, SlmpTarget
from slmp.errors import SlmpError

from edged.config.plc import MelsecSection
from edged.errors import PlcFault
from edged.plc.processimage import FROM_CELL_BYTES, IMAGE_BYTES, TO_CELL_BYTES

OWN_STATION = SlmpTarget(network=0, station=0xFF, module_io=0x03FF, multidrop=0)
"""Destination: the connected CPU itself (SH-080956ENG, "SLMP Reference Manual", access destination)."""
TIMER_S = 0.25
"""Unit of the monitoring timer."""


class MelsecMemory:
    """See `exchange.PlcMemory`."""

    is_little = True  # the low word of a value is in the device with the lower number

    def __init__(self, host: str, section: MelsecSection, answer_s: float) -> None:
        self._place = f"{host}:{section.port}"
        self._first, self._second = section.devices(TO_CELL_BYTES // 2)
        self._client = SlmpClient(
            host,
            section.port,
            transport="tcp",
            default_target=OWN_STATION,
            plc_profile=f"melsec:{section.cpu}",
            timeout=answer_s,
            monitoring_timer=round(answer_s / TIMER_S),
        )

    def open(self) -> None:
        """Connect, and check that all devices exist."""
        try:
            self._client.connect()
        except SlmpError as error:
            raise PlcFault(f"{self._place}: {error}", "connect") from error
        self._read(IMAGE_BYTES)

    def read(self) -> bytes:
        """Read the image to the cell in one message."""
        return self._read(TO_CELL_BYTES)

    def write(self, image: bytes) -> None:
        """Write the image from the cell in one message."""
        words = struct.unpack(f"<{FROM_CELL_BYTES // 2}H", image)
        try:
            self._client.write_devices(self._second, words, bit_unit=False)
        except (SlmpError, ValueError) as error:
            raise PlcFault(f"{self._place}, {self._second} cannot be written: {error}", "write") from error

    def close(self) -> None:
        """Disconnect."""
        self._client.close()

    @property
    def line(self) -> socket.socket | None:
        """None, as the library itself keeps to its time-out."""
        return None

    def _read(self, size: int) -> bytes:
        try:
            words = self._client.read_devices(self._first, size // 2, bit_unit=False)
        except (SlmpError, ValueError) as error:
            raise PlcFault(
                f"{self._place}, {size // 2} words from {self._first} on: {error} "
                "(expected: the CPU has them, and the connection is one for SLMP, binary)",
                "read",
            ) from error
        return struct.pack(f"<{size // 2}H", *words)
