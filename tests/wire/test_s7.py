"""The SCL source for S7-1200 and S7-1500, executed cycle by cycle against a running cell.

MB_CLIENT is played by one that does what its manual says, over a real connection.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from typing import Any

import pytest
from helpers import scl, structured_text
from helpers.livecell import LiveCell
from helpers.snapshots import make_target
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from edged.adapters.modbus import ModbusSettings
from edged.robot.orientations import Convention
from edged.robots.formats import render

CYCLES_BUSY = 3
DONE, BUSY, ERROR = "DONE", "BUSY", "ERROR"


class MbClient:
    """MB_CLIENT (S7-1200 System Manual V4.2, 13.5): begins with REQ, its parameters stay until the end.

    linked : the cell can be reached; else a request ends with an error, and the connection is made anew.
    """

    def __init__(self, port: int, buffers: Callable[[], Mapping[str, list[int]]]) -> None:
        self.port = port
        self.linked = True
        self.requests: list[tuple[int, int, int]] = []
        self.fields: dict[str, tuple[Any, str]] = {}
        self._buffers = buffers
        self._client: ModbusTcpClient | None = None
        self._running: dict[str, Any] | None = None
        self._sent: list[int] = []
        self._left = 0
        self._was_requested = False
        self._say()

    def _say(self, raised: str = "", status: int = 0x7000) -> None:
        self.fields = {name: (name == raised, "BOOL") for name in (DONE, BUSY, ERROR)}
        self.fields["STATUS"] = (status, "WORD")

    def call(self, given: Mapping[str, tuple[Any, Any]]) -> None:
        """One cycle of the PLC."""
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
            if self._client is not None:
                self._client.close()
            self._client = None
            self._say(ERROR, 0x80C8)  # no answer in the time

    def _request(self, values: Mapping[str, Any]) -> None:
        if not self.linked:
            raise OSError("no link")
        if self._client is None:
            self._client = ModbusTcpClient("127.0.0.1", port=self.port, timeout=2)
            if not self._client.connect():
                raise OSError("not reached")
        mode, address, count = (values[f"MB_{name}"] for name in ("MODE", "DATA_ADDR", "DATA_LEN"))
        self.requests.append((mode, address, count))
        if mode == 103:
            answer = self._client.read_holding_registers(address, count=count)
            if not answer.isError():
                values["MB_DATA_PTR"][:] = answer.registers
        else:
            assert self._sent == values["MB_DATA_PTR"], "data changed while it was being sent"
            answer = self._client.write_registers(address, list(values["MB_DATA_PTR"]))
        if answer.isError():
            self._say(ERROR, 0x8380 + answer.exception_code)
        else:
            self._say(DONE, 0)

    def close(self) -> None:
        """The connection ends."""
        if self._client is not None:
            self._client.close()


class S7(structured_text.Driven):
    """A PLC with `FB_EDGED_S7` in its OB1."""

    def __init__(self, port: int) -> None:
        source, shared = scl.structured_text_of(render("scl"))
        clients: list[MbClient] = []

        def make_client() -> MbClient:
            clients.append(MbClient(port, lambda: self.program.shared["DB_EDGED"]))
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
        self.client.close()


@pytest.mark.slow
def test_scl_locates_a_part() -> None:
    """Four requests in turn, each within MB_CLIENT's limits; two parts, a job change, an unknown job."""
    with LiveCell(ModbusSettings(port=0, validity_s=30.0)) as cell, S7(cell.port) as plc:
        plc.until("xReady")
        for x_mm in (10.0, -12.5):
            cell.targets = (make_target(x_mm=x_mm),)
            plc.run()
            result = plc.values["stResult"]
            assert (True, False, True) == (plc.values["xDone"], plc.values["xError"], result["xValid"])
            assert (round(x_mm * 1000), 20_000, 200_000) == tuple(result[f"di{axis}"] for axis in "XYZ")
            plc.release()
            assert not plc.values["stResult"]["xValid"]
            plc.until("xReady")
        plc.run(uiCommand=2, uiJob=2)
        assert plc.values["xDone"]
        plc.release()
        plc.until("xReady")
        plc.run(uiCommand=1, uiJob=99)
        assert (True, 2) == (plc.values["xError"], plc.values["uiError"])
        assert [(103, 200, 20), (103, 300, 48), (103, 540, 35), (116, 100, 19)] == plc.client.requests[:4]
        assert 2 == cell.head.captures


def test_scl_takes_a_command_back_when_the_link_is_down() -> None:
    """uiError 101, MB_CLIENT's status; nothing runs when the link returns, and the next command does."""
    with LiveCell() as cell, S7(cell.port) as plc:
        plc.until("xReady")
        plc.client.linked = False
        plc.run()
        assert (True, 101, 0x80C8, False) == tuple(
            plc.values[name] for name in ("xError", "uiError", "wStatus", "xLinkOk")
        )
        plc.client.linked = True
        plc.until("xLinkOk")
        for _ in range(60):
            plc.block.scan()
        assert 0 == cell.head.captures
        plc.release()
        plc.until("xReady")
        plc.run()
        assert (True, 1) == (plc.values["stResult"]["xValid"], cell.head.captures)


def test_scl_commands_no_cell_whose_angles_mean_something_else() -> None:
    """uiError 104, no picture; with the convention of the cell the part is given."""
    settings = ModbusSettings(port=0, validity_s=30.0, convention=Convention.KUKA_ABC)
    with LiveCell(settings) as cell, S7(cell.port) as plc:
        for expected, outcome in ((1, (False, 104, 0)), (2, (True, 0, 1))):
            plc.until("xReady")
            plc.values |= {"uiConvention": expected, "xExecute": True}
            plc.block.scan()
            plc.until("xBusy", False)
            values = plc.values
            assert outcome == (values["stResult"]["xValid"], values["uiError"], cell.head.captures)
            plc.release()


def test_scl_does_not_move_a_robot_by_a_simulation() -> None:
    """xValid stays FALSE, though the cell says VALID, unless the program allows it."""
    cell = LiveCell()
    cell.setup = dataclasses.replace(cell.setup, simulated=True)
    with cell, S7(cell.port) as plc:
        for allowed in (False, True):
            plc.until("xReady")
            plc.run(xAllowSimulated=allowed)
            assert (True, allowed) == (plc.values["xDone"], plc.values["stResult"]["xValid"])
            plc.release()


def test_scl_names_what_tia_would_not_compile() -> None:
    """The reader of these tests refuses a name without its mark, and a block that is not there."""
    source = render("scl")
    for good, bad, message in (
        ("#xSame := ", "xSame := ", "xSame is neither"),
        ('"F_EDGED_NEXT"(', '"F_EDGED_NEX"(', "does not exist"),
        ("#wBits := #awStatus", "#wBitz := #awStatus", "wBitz is not declared"),
        ("um: INT32_MIN", "µm: INT32_MIN", "ANSI"),
    ):
        assert good in source
        with pytest.raises(AssertionError, match=message):
            scl.structured_text_of(source.replace(good, bad))
