"""States of OPC 40100-1, derived from the registers on each update.

Source: OPC 40100-1, 8.2.6 (VisionStateMachineType) and 8.3.5 (VisionAutomaticModeStateMachineType).
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass

from edged.domain.cell import CellPhase
from edged.domain.events import CommandKind
from edged.plc.registers import Number, StatusBit
from edged.plc.statuswords import STATES


class Top(enum.Enum):
    """States of the VisionStateMachine: state number and the number of the state's node."""

    PREOPERATIONAL = (1, 5028, "Preoperational")
    HALTED = (2, 5029, "Halted")
    ERROR = (3, 5030, "Error")
    OPERATIONAL = (4, 5031, "Operational")


class Automatic(enum.Enum):
    """States of the AutomaticModeStateMachine: state number and the number of the state's node."""

    INITIALIZED = (5, 5056, "Initialized")
    READY = (6, 5057, "Ready")
    SINGLE_EXECUTION = (7, 5058, "SingleExecution")
    CONTINUOUS_EXECUTION = (8, 5059, "ContinuousExecution")


@dataclass(frozen=True, slots=True)
class VisionState:
    """States of both state machines. automatic : None outside Operational."""

    top: Top
    automatic: Automatic | None


def vision_state(values: Mapping[str, Number], *, free_running: bool) -> VisionState:
    """Derive the state from the registers. free_running : the cell measures without commands."""
    state, bits = int(values["STATE"]), int(values["STATUS_BITS"])
    if state in (STATES[CellPhase.STARTING], STATES[CellPhase.SETUP]):  # not yet ready for operation
        return VisionState(Top.PREOPERATIONAL, None)
    if state == STATES[CellPhase.STOPPING]:
        return VisionState(Top.HALTED, None)
    if state == STATES[CellPhase.FAULT] or bits & StatusBit.ERROR:
        return VisionState(Top.ERROR, None)
    if int(values["OPEN_COMMANDS"]) and values["COMMAND"] == CommandKind.CHANGE_JOB:
        automatic = Automatic.INITIALIZED  # no recipe is prepared until it is loaded
    elif int(values["OPEN_COMMANDS"]):
        automatic = Automatic.SINGLE_EXECUTION
    elif free_running:
        automatic = Automatic.CONTINUOUS_EXECUTION
    elif bits & StatusBit.READY:
        automatic = Automatic.READY
    else:
        automatic = Automatic.INITIALIZED
    return VisionState(Top.OPERATIONAL, automatic)
