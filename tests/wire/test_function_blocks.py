"""The SCL source for S7 and the files for TwinCAT, executed cycle by cycle against a running cell."""

from __future__ import annotations

import dataclasses

import pytest
from helpers import scl
from helpers.functionblocks import S7, TwinCat
from helpers.livecell import LiveCell
from helpers.snapshots import make_target

from edged.adapters.modbus import ModbusSettings
from edged.robot.orientations import Convention
from edged.robots.formats import render

makers = pytest.mark.parametrize("make", [S7, TwinCat])


@pytest.mark.long
@makers
def test_a_function_block_locates_a_part(make: type[S7 | TwinCat]) -> None:
    """Two parts, a job change and an unknown job, one command after the other, end as documented."""
    with LiveCell(ModbusSettings(port=0, validity_s=30.0)) as cell, make(cell.port) as plc:
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
        plc.run(uiCommand=2, uiJob=2, uiBox=0, xAutoLock=True)
        values = cell.call(lambda: {register.name: value for register, value in cell.server.values()})
        assert (1, 0) == (values["AUTO_LOCK"], values["BOX"])
        assert plc.values["xDone"]
        plc.release()
        plc.until("xReady")
        plc.run(uiCommand=1, uiJob=0, uiBox=1)
        assert (True, 2) == (plc.values["xError"], plc.values["uiError"]), "there is no box"
        plc.release()
        plc.until("xReady")
        plc.run(uiCommand=1, uiJob=99, uiBox=0)
        assert (True, 2) == (plc.values["xError"], plc.values["uiError"])
        assert 2 == cell.head.captures
        if isinstance(plc, S7):
            expected = [(103, 200, 20), (103, 300, 48), (103, 540, 35), (103, 1410, 67), (116, 100, 21)]
            assert expected == plc.client.requests[:5]


@makers
@pytest.mark.slow
def test_a_function_block_takes_a_command_back_when_the_link_is_down(make: type[S7 | TwinCat]) -> None:
    """uiError is 101 with the request's error, nothing runs when the link returns, and the next one works."""
    with LiveCell() as cell, make(cell.port) as plc:
        name, error = make.lost
        plc.until("xReady")
        plc.line.linked = False
        plc.run()
        outcome = tuple(plc.values[output] for output in ("xError", "uiError", name, "xLinkOk"))
        assert (True, 101, error, False) == outcome
        plc.line.linked = True
        plc.until("xLinkOk")
        for _ in range(60):
            plc.scan()
        assert 0 == cell.head.captures
        plc.release()
        plc.until("xReady")
        plc.run()
        assert (True, 1) == (plc.values["stResult"]["xValid"], cell.head.captures)


@pytest.mark.slow
@makers
def test_a_function_block_commands_no_cell_whose_angles_mean_something_else(make: type[S7 | TwinCat]) -> None:
    """Another convention gives uiError 104 and no picture; with the cell's convention the part is given."""
    settings = ModbusSettings(port=0, validity_s=30.0, convention=Convention.KUKA_ABC)
    with LiveCell(settings) as cell, make(cell.port) as plc:
        for convention, outcome in ((1, (False, 104, 0)), (2, (True, 0, 1))):
            plc.until("xReady")
            plc.values |= {"uiConvention": convention, "xExecute": True}
            plc.scan()
            plc.until("xBusy", False)
            values = plc.values
            assert outcome == (values["stResult"]["xValid"], values["uiError"], cell.head.captures)
            plc.release()


@pytest.mark.slow
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


@pytest.mark.slow
def test_scl_names_what_tia_would_not_compile() -> None:
    """A name without its mark, an unknown block or variable, and non-ASCII text are refused."""
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
