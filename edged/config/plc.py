"""Section for a PLC whose own memory the cell reads and writes."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from edged.config.fields import Host, Port, Section


class S7Section(Section):
    """Siemens S7-300, 400, 1200, 1500: a data block with standard access, by PUT/GET."""

    port: Port = Field(102, description="TCP port")
    rack: int = Field(0, ge=0, le=7, description="of the CPU")
    slot: int = Field(1, ge=0, le=31, description="of the CPU: 1 of S7-1200 and 1500, 2 of S7-300")
    db: int = Field(ge=1, le=65_535, description="number of the data block")
    offset: int = Field(0, ge=0, le=65_000, multiple_of=2, description="first byte of the 192 in the block")


_TAG = re.compile(r"(Program:)?[A-Za-z_]\w{0,39}(\.[A-Za-z_]\w{0,39}){0,3}", re.ASCII)


def _tag_name(value: str) -> str:
    if not _TAG.fullmatch(value):
        raise ValueError('expected a tag, for example "Edged" or "Program:MainProgram.Edged"')
    return value


TagName = Annotated[str, AfterValidator(_tag_name)]


class LogixSection(Section):
    """Rockwell ControlLogix, CompactLogix, Micro800: a structured tag, over EtherNet/IP."""

    port: Port = Field(44818, description="TCP port")
    slot: int | None = Field(
        None,
        ge=0,
        le=16,
        description="of the controller, in the chassis of an Ethernet module; left out: it is asked itself",
    )
    tag: TagName = Field(
        "Edged", description="with the members ToCell and FromCell; of a program: Program:NAME.TAG"
    )


_DEVICE = re.compile(r"(D|R|ZR)([0-9]{1,7})|(W)([0-9A-F]{1,6})")


def _device_name(value: str) -> str:
    if not _DEVICE.fullmatch(value):
        raise ValueError('expected a word device, for example "D1000", "W1A0" (hexadecimal), "R0" or "ZR0"')
    return value


DeviceName = Annotated[str, AfterValidator(_device_name)]


class MelsecSection(Section):
    """Mitsubishi MELSEC: 96 word devices, by SLMP in binary code over TCP."""

    port: Port = Field(description="of an SLMP connection in the CPU's parameters")
    cpu: Literal["iq-r", "iq-f", "iq-l", "qnu", "qnudv", "lcpu"] = Field(description="its series")
    device: DeviceName = Field(
        "D1000", description="the first of them: D, R, ZR, or W with its hexadecimal number"
    )

    def devices(self, words: int) -> tuple[str, str]:
        """Names of the first device, and of the one that many words after it."""
        kind, number, _, link = _DEVICE.fullmatch(self.device).groups()  # type: ignore[union-attr]  # validated
        behind = f"W{int(link, 16) + words:X}" if link else f"{kind}{int(number) + words}"
        return self.device, behind


FAMILIES = ("s7", "logix", "melsec")
"""Tables of `[plc]`, of which exactly one must be present."""


class PlcSection(Section):
    """A PLC whose own memory the cell reads and writes: registers and handshake of Modbus. Left out: none."""

    host: Host = Field(description="address of the PLC")
    handshake: Literal["start-bit", "sequence"] = Field(
        "start-bit", description="what begins a command: START in CONTROL, or another CMD_SEQ"
    )
    period_ms: int = Field(20, ge=5, le=1000, description="from one reading to the next")
    s7: S7Section | None = Field(None, description="of Siemens")
    logix: LogixSection | None = Field(None, description="of Rockwell")
    melsec: MelsecSection | None = Field(None, description="of Mitsubishi")

    @model_validator(mode="after")
    def _has_a_family(self) -> PlcSection:
        named = [name for name in FAMILIES if getattr(self, name) is not None]
        if len(named) != 1:
            expected = ", ".join(f"[plc.{name}]" for name in FAMILIES)
            raise ValueError(f"expected one of {expected}, got {' and '.join(named) or 'none'}")
        return self

    @property
    def family(self) -> str:
        """Name of the configured PLC family, one of `FAMILIES`."""
        return next(name for name in FAMILIES if getattr(self, name) is not None)

    @property
    def port(self) -> int:
        """TCP port of the PLC."""
        return int(getattr(self, self.family).port)

    @property
    def place(self) -> str:
        """Address and port, for messages."""
        return f"{self.host}:{self.port}"
