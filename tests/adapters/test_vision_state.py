"""States of OPC 40100-1 from the cell's state."""

from __future__ import annotations

import pytest

from edged.adapters.opcua.state import Top, vision_state
from edged.domain.cell import CellPhase
from edged.plc.registers import Number
from edged.plc.statuswords import STATES


@pytest.mark.parametrize("free_running", [False, True])
def test_every_state_of_the_cell_has_one_of_the_machine(free_running: bool) -> None:
    """Every state of the cell has one of the machine; SETUP is Preoperational, as at the start."""
    expected = {
        CellPhase.STARTING: Top.PREOPERATIONAL,
        CellPhase.SETUP: Top.PREOPERATIONAL,
        CellPhase.READY: Top.OPERATIONAL,
        CellPhase.BUSY: Top.OPERATIONAL,
        CellPhase.FAULT: Top.ERROR,
        CellPhase.STOPPING: Top.HALTED,
    }
    assert set(CellPhase) == set(expected)
    for phase, top in expected.items():
        values: dict[str, Number] = {"STATE": STATES[phase], "STATUS_BITS": 0, "OPEN_COMMANDS": 0}
        found = vision_state(values, free_running=free_running)
        assert (top, top is not Top.OPERATIONAL) == (found.top, found.automatic is None)
