"""Simulated PLCs that run the function blocks for S7 and TwinCAT, each with its maker's Modbus blocks.

MB_CLIENT, FB_MBReadRegs and FB_MBWriteRegs behave as their manuals say, over a real connection.
"""

from __future__ import annotations

import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from typing import Any

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from edged.robots.formats import render, written
from helpers import scl, structured_text

CYCLES_BUSY = 3
DONE, BUSY, ERROR = "DONE", "BUSY", "ERROR"


class Line:
    """The connection to the cell, shared by the blocks. linked : the network is up."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.linked = True
        self.busy: object = None
        self._client: ModbusTcpClient | None = None

    def client(self) -> ModbusTcpClient:
        """Connected client. Raises `OSError` without a link."""
        if not self.linked:
            self.close()
            raise OSError("no link")
        if self._client is None:
            self._client = ModbusTcpClient("127.0.0.1", port=self.port, timeout=2)
            if not self._client.connect():
                raise OSError("not reached")
        return self._client

    def close(self) -> None:
        """Close the connection."""
        if self._client is not None:
            self._client.close()
        self._client = None


class MbClient:
    """MB_CLIENT (S7-1200 System Manual V4.2, 13.5): starts with REQ, its parameters are held until the end.

    A request that does not reach the cell ends with an error, and the connection is made anew.
    """

    def __init__(self, line: Line, buffers: Callable[[], Mapping[str, list[int]]]) -> None:
        self.requests: list[tuple[int, int, int]] = []
        self.fields: dict[str, tuple[Any, str]] = {}
        self._buffers = buffers
        self._line = line
        self._running: dict[str, Any] | None = None
        self._sent: list[int] = []
        self._left = 0
        self._was_requested = False
        self._say()

    def _say(self, raised: str = "", status: int = 0x7000) -> None:
        self.fields = {name: (name == raised, "BOOL") for name in (DONE, BUSY, ERROR)}
        self.fields["STATUS"] = (status, "WORD")

    def call(self, given: Mapping[str, tuple[Any, Any]]) -> None:
        """Run one cycle of the PLC."""
        values = {name: value for name, (value, _) in given.items()}
        self._check(values)
        requested = values.pop("REQ")
        if self._running is None:
            self._say()
            if requested and not self._was_requested:
                self._running, self._left = values, CYCLES_BUSY
                self._sent = list(values["MB_DATA_PTR"])
                self._say(BUSY, 0x7001)
        else:
            assert requested, "REQ was taken down before DONE"
            assert {k: v for k, v in values.items() if k != "MB_DATA_PTR"} == {
                k: v for k, v in self._running.items() if k != "MB_DATA_PTR"
            }, "a parameter changed while BUSY"
            self._left -= 1
            self._say(BUSY, 0x7006)
            if self._left == 0:
                self._finish(values)
        self._was_requested = requested

    def _check(self, values: Mapping[str, Any]) -> None:
        connection = values["CONNECT"]
        assert ([0xC0, 0xA8, 0x0A, 0x14], 0x0B) == (
            connection["RemoteAddress"]["ADDR"][1:],
            connection["ConnectionType"],
        )
        assert connection["ActiveEstablished"] and connection["RemotePort"] == 1502
        assert 1 <= values["MB_DATA_LEN"] <= {103: 125, 116: 123}[values["MB_MODE"]]
        assert values["MB_DATA_LEN"] == len(values["MB_DATA_PTR"])
        assert any(values["MB_DATA_PTR"] is buffer for buffer in self._buffers().values()), "standard access"

    def _finish(self, values: Mapping[str, Any]) -> None:
        self._running = None
        try:
            self._request(values)
        except (ModbusException, OSError):
            self._line.close()
            self._say(ERROR, 0x80C8)  # no answer in the time

    def _request(self, values: Mapping[str, Any]) -> None:
        client = self._line.client()
        mode, address, count = (values[f"MB_{name}"] for name in ("MODE", "DATA_ADDR", "DATA_LEN"))
        self.requests.append((mode, address, count))
        if mode == 103:
            answer = client.read_holding_registers(address, count=count)
            if not answer.isError():
                values["MB_DATA_PTR"][:] = answer.registers
        else:
            assert self._sent == values["MB_DATA_PTR"], "data changed while it was being sent"
            answer = client.write_registers(address, list(values["MB_DATA_PTR"]))
        if answer.isError():
            self._say(ERROR, 0x8380 + answer.exception_code)
        else:
            self._say(DONE, 0)


class S7(structured_text.Driven):
    """A PLC with `FB_EDGED_S7` in its OB1. lost : status of a request without a link."""

    lost = ("wStatus", 0x80C8)

    def __init__(self, port: int) -> None:
        self.line = Line(port)
        source, shared = scl.structured_text_of(render("scl"))
        clients: list[MbClient] = []

        def make_client() -> MbClient:
            clients.append(MbClient(self.line, lambda: self.program.shared["DB_EDGED"]))
            return clients[-1]

        def clock_ms() -> float:
            return time.monotonic() * 1e3

        self.program = structured_text.Program(
            source,
            clock_ms,
            library={"TON_TIME": lambda: structured_text.Timer(clock_ms), "MB_CLIENT": make_client},
            shared=shared,
        )
        self.block = self.program.instance("FB_EDGED_S7")
        self.values = self.block.values
        (self.client,) = clients

    def __enter__(self) -> S7:
        return self

    def __exit__(self, *_: object) -> None:
        self.line.close()


class Request:
    """FB_MBReadRegs, FB_MBWriteRegs (TF6250): starts at the edge of bExecute, bBusy until the end."""

    def __init__(self, line: Line, pointer: str) -> None:
        self.fields: dict[str, tuple[Any, str]] = {}
        self._line = line
        self._pointer = pointer
        self._inputs: dict[str, Any] = {"bExecute": False}
        self._left = 0
        self._sent: list[int] = []
        self._say(busy=False)

    def _say(self, *, busy: bool, error: int = 0) -> None:
        self._line.busy = self if busy else None
        self.fields = {"bBusy": (busy, "BOOL"), "bError": (error > 0, "BOOL"), "nErrId": (error, "UDINT")}

    def call(self, given: Mapping[str, tuple[Any, Any]]) -> None:
        """Run one cycle; inputs that are not given keep their values."""
        was_executed = self._inputs["bExecute"]
        self._inputs |= {name: value for name, (value, _) in given.items()}
        if self._left:
            assert self._inputs["bExecute"], "taken down before its end"
            self._left -= 1
            if not self._left:
                self._finish()
        elif self._inputs["bExecute"] and not was_executed:
            assert self._line.busy is None, "two requests at once"
            assert (1502, 0xFF) == (self._inputs["nTCPPort"], self._inputs["nUnitID"])
            assert "192.168.10.20" == self._inputs["sIPAddr"]
            assert self._inputs["cbLength"] == 2 * self._inputs["nQuantity"]
            self._left, self._sent = CYCLES_BUSY, list(self._inputs[self._pointer])
            self._say(busy=True)

    def _finish(self) -> None:
        buffer, address, count = (self._inputs[name] for name in (self._pointer, "nMBAddr", "nQuantity"))
        try:
            if self._pointer == "pDestAddr":
                buffer[:] = self._line.client().read_holding_registers(address, count=count).registers
            else:
                assert self._sent == buffer, "data changed while it was being sent"
                assert not self._line.client().write_registers(address, list(buffer)).isError()
        except (ModbusException, OSError):
            self._say(busy=False, error=1861)  # ADSERR_CLIENT_SYNCTIMEOUT
        else:
            self._say(busy=False)


def twincat_source() -> str:
    """Structured text of all generated files."""
    parts = []
    for text in written("twincat").values():
        (element,) = ET.fromstring(text)
        parts.append(element.findtext("Declaration") or "")
        if element.tag == "POU":
            keyword = "FUNCTION_BLOCK" if "FUNCTION_BLOCK" in parts[-1] else "FUNCTION"
            parts.append(f"{element.findtext('Implementation/ST')}END_{keyword}\n")
    return "".join(parts)


class TwinCat(structured_text.Driven):
    """A PLC with `FB_EDGED_TC` in its task. lost : status of a request without a link."""

    lost = ("udErrorId", 1861)

    def __init__(self, port: int) -> None:
        self.line = Line(port)
        library = {
            "FB_MBReadRegs": lambda: Request(self.line, "pDestAddr"),
            "FB_MBWriteRegs": lambda: Request(self.line, "pSrcAddr"),
        }
        program = structured_text.Program(twincat_source(), lambda: time.monotonic() * 1e3, library)
        self.block = program.instance("FB_EDGED_TC")
        self.values = self.block.values

    def __enter__(self) -> TwinCat:
        return self

    def __exit__(self, *_: object) -> None:
        self.line.close()
