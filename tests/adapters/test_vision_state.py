"""States of OPC 40100-1 as the registers show them."""

from __future__ import annotations

import pytest

from edged.adapters.opcua.state import Top, vision_state
from edged.domain.cell import CellPhase
from edged.plc.registers import Number
from edged.plc.statuswords import STATES


@pytest.mark.parametrize("free_running", [False, True])
def test_every_state_of_the_cell_has_one_of_the_machine(free_running: bool) -> None:
    """A cell in SETUP is Preoperational, as one that starts: people have to do something first."""
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
