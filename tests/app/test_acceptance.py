"""The last acceptance test of a cell: in its state, its registers and its warnings; it stops no cell."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.cells import small_rig
from helpers.snapshots import make_transform

from edged.adapters.modbus.cell import CellRegisters
from edged.adapters.modbus.settings import ModbusSettings
from edged.app.cell import LoadedCell, load_cell, with_registration
from edged.commands.demo import DemoOptions, prepare_cell
from edged.domain.acceptance import NS_PER_DAY, Acceptance, AcceptanceState
from edged.domain.cell import CellPhase, CellState
from edged.files.acceptance import acceptance_file, document_of
from edged.files.rig import load_rig, save_rig
from edged.payload import state_to_json
from edged.plc import registers as reg
from edged.robot.golden import registration_digest
from edged.setup.cellfiles import CellFiles, warnings_for
from edged.setup.releases.archive import make
from edged.sim.cell import VirtualCell, demo_part


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The configuration of a cell."""
    folder = tmp_path_factory.mktemp("cell")
    return prepare_cell(folder, VirtualCell(small_rig(), demo_part(), seed=11), DemoOptions(), gige=False)


def accepted(config: Path, days: int, *, passed: bool = True, calibration: str = "") -> LoadedCell:
    """The cell, tested so that the next test is due in this many days."""
    rig, now_ns = load_rig(config.parent / "rig.json"), time.time_ns()
    found = Acceptance(passed, now_ns - 400 * NS_PER_DAY, now_ns + days * NS_PER_DAY + 10**9)
    document = document_of(found, calibration or rig.calibration_id, registration_digest(rig), {})
    acceptance_file(config.parent / "rig.json").write_bytes(document)
    return load_cell(config)


def said(loaded: LoadedCell) -> list[str]:
    """The warnings about the acceptance."""
    assert isinstance(loaded.cell, CellFiles)
    return [line for line in warnings_for(loaded.cell) if "acceptance" in line]


def test_each_state_of_an_acceptance_is_said(config: Path) -> None:
    """A passed test gives no warning, every other state one with a remedy; a damaged file stops no cell."""
    acceptance_file(config.parent / "rig.json").unlink(missing_ok=True)
    assert load_cell(config).setup.acceptance == Acceptance()
    assert said(load_cell(config)) == []
    assert said(accepted(config, 30)) == []
    (line,) = said(accepted(config, -2))
    assert line.startswith("acceptance.json: OVERDUE: the cell is to be tested again")
    assert "FAILED" in said(accepted(config, 30, passed=False))[0]
    assert "OTHER_RIG" in said(accepted(config, 30, calibration="another"))[0]
    acceptance_file(config.parent / "rig.json").write_text("{}")
    damaged = load_cell(config)
    assert damaged.setup.acceptance.state(1) is AcceptanceState.DAMAGED
    assert "DAMAGED" in said(damaged)[0]


def test_an_acceptance_changes_no_fingerprint(config: Path) -> None:
    """An acceptance does not change the fingerprint."""
    acceptance_file(config.parent / "rig.json").unlink(missing_ok=True)
    before = load_cell(config).setup.fingerprint
    assert "acceptance" not in make(config).backup.left_out
    assert before == accepted(config, 30).setup.fingerprint
    assert "acceptance" in make(config).backup.left_out


def test_a_rig_that_is_registered_anew_was_not_tested(config: Path) -> None:
    """A registered rig counts as not tested, without a further reload."""
    loaded, path = accepted(config, 30), config.parent / "rig.json"
    rig = load_rig(path)
    save_rig(path, replace(rig, robot_from_rig=make_transform((0.0, 0.0, 1.0), (1.0, 2.0, 3.0))))
    registered = with_registration(loaded)
    assert registered.setup.acceptance.state(1) is AcceptanceState.OTHER_RIG
    assert "OTHER_RIG" in said(registered)[0]
    save_rig(path, rig)


def test_registers_and_messages_say_until_when_it_counts(config: Path) -> None:
    """Registers and messages have state, days and date; without a test 0, none and 0; overdue by the clock
    alone."""
    modbus = CellRegisters(ModbusSettings(), None, time.monotonic)

    def words() -> dict[str, float]:
        block = reg.ACCEPTANCE
        return dict(reg.decode(block, modbus.read(block.address, block.words), ModbusSettings().word_order))

    assert words() == {"A_STATE": 0, "A_DAYS": reg.INT32_MIN, "A_DUE": 0}
    for days, state in ((30, AcceptanceState.PASSED), (-3, AcceptanceState.OVERDUE)):
        setup = accepted(config, days).setup
        event = CellState(CellPhase.READY, True, True, "flange", 1, 0, acceptance=setup.acceptance)
        modbus.take(event)
        assert words() == {"A_STATE": state, "A_DAYS": days, "A_DUE": setup.acceptance.due_ns // 10**9}
    assert state_to_json(event)["acceptance"] == {
        "state": "PASSED",
        "made_ns": setup.acceptance.made_ns,
        "due_ns": setup.acceptance.due_ns,
    }
    assert "acceptance" not in state_to_json(CellState(CellPhase.READY, True, True, "flange", 1, 0))
