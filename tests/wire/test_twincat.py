"""The files for TwinCAT, put together again and executed cycle by cycle against a running cell.

FB_MBReadRegs and FB_MBWriteRegs are played by blocks that do what their manual says, over a real connection.
"""

from __future__ import annotations

import time
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import Any

from helpers import structured_text
from helpers.livecell import LiveCell
from helpers.snapshots import make_target
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from edged.adapters.modbus import ModbusSettings
from edged.robot.orientations import Convention
from edged.robots.formats import written

CYCLES_BUSY = 3


class Line:
    """The way to the cell, shared by the blocks. linked : it can be reached."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.linked = True
        self.busy: object = None
        self._client: ModbusTcpClient | None = None

    def client(self) -> ModbusTcpClient:
        """Connected, or OSError."""
        if not self.linked:
            self.close()
            raise OSError("no link")
        if self._client is None:
            self._client = ModbusTcpClient("127.0.0.1", port=self.port, timeout=2)
            assert self._client.connect()
        return self._client

    def close(self) -> None:
        """The connection ends."""
        if self._client is not None:
            self._client.close()
        self._client = None


class Request:
    """FB_MBReadRegs, FB_MBWriteRegs (TF6250): begins with the edge of bExecute, bBusy until the end."""

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
        """One cycle; inputs that are not given keep their values."""
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


def source() -> str:
    """Structured text of all files."""
    parts = []
    for text in written("twincat").values():
        (element,) = ET.fromstring(text)
        parts.append(element.findtext("Declaration") or "")
        if element.tag == "POU":
            keyword = "FUNCTION_BLOCK" if "FUNCTION_BLOCK" in parts[-1] else "FUNCTION"
            parts.append(f"{element.findtext('Implementation/ST')}END_{keyword}\n")
    return "".join(parts)


class TwinCat(structured_text.Driven):
    """A PLC with `FB_EDGED_TC` in its task."""

    def __init__(self, port: int) -> None:
        self.line = Line(port)
        library = {
            "FB_MBReadRegs": lambda: Request(self.line, "pDestAddr"),
            "FB_MBWriteRegs": lambda: Request(self.line, "pSrcAddr"),
        }
        program = structured_text.Program(source(), lambda: time.monotonic() * 1e3, library)
        self.block = program.instance("FB_EDGED_TC")
        self.values = self.block.values

    def __enter__(self) -> TwinCat:
        return self

    def __exit__(self, *_: object) -> None:
        self.line.close()


def test_twincat_locates_a_part() -> None:
    """One request after the other: two parts, then an unknown job."""
    with LiveCell() as cell, TwinCat(cell.port) as plc:
        for x_mm in (10.0, -12.5):
            cell.targets = (make_target(x_mm=x_mm),)
            plc.until("xReady")
            plc.run()
            result = plc.values["stResult"]
            assert (True, True) == (plc.values["xDone"], result["xValid"])
            assert (round(x_mm * 1000), 20_000, 200_000) == tuple(result[f"di{axis}"] for axis in "XYZ")
            plc.release()
            assert not plc.values["stResult"]["xValid"]
        plc.until("xReady")
        plc.run(uiJob=99)
        assert (True, 2) == (plc.values["xError"], plc.values["uiError"])
        assert 2 == cell.head.captures


def test_twincat_commands_no_cell_whose_angles_mean_something_else() -> None:
    """uiError 104, no picture; with the convention of the cell the part is given."""
    settings = ModbusSettings(port=0, validity_s=30.0, convention=Convention.KUKA_ABC)
    with LiveCell(settings) as cell, TwinCat(cell.port) as plc:
        for expected, outcome in ((1, (False, 104, 0)), (2, (True, 0, 1))):
            plc.until("xReady")
            plc.values |= {"uiConvention": expected, "xExecute": True}
            plc.block.scan()
            plc.until("xBusy", False)
            values = plc.values
            assert outcome == (values["stResult"]["xValid"], values["uiError"], cell.head.captures)
            plc.release()


def test_twincat_takes_a_command_back_when_the_link_is_down() -> None:
    """uiError 101, the request's error; nothing runs when the link returns, and the next command does."""
    with LiveCell() as cell, TwinCat(cell.port) as plc:
        plc.until("xReady")
        plc.line.linked = False
        plc.run()
        assert (True, 101, 1861) == tuple(plc.values[name] for name in ("xError", "uiError", "udErrorId"))
        plc.line.linked = True
        plc.until("xLinkOk")
        for _ in range(60):
            plc.block.scan()
        assert 0 == cell.head.captures
        plc.release()
        plc.until("xReady")
        plc.run()
        assert (True, 1) == (plc.values["stResult"]["xValid"], cell.head.captures)
