"""Values of the status block from the handshake and the state of the cell."""

from __future__ import annotations

from edged.domain.cell import CalibrationHealth, CellPhase, CellState, SetupSource
from edged.plc import handshake as hs
from edged.plc import registers as reg
from edged.plc.answers import AckState, ResultVerdict

STATES = {
    CellPhase.STARTING: 0,
    CellPhase.READY: 1,
    CellPhase.BUSY: 2,
    CellPhase.FAULT: 3,
    CellPhase.STOPPING: 4,
    CellPhase.SETUP: 5,
}


def status_values(
    state: hs.Handshake[reg.RegisterResult],
    cell: CellState | None,
    now_s: float,
    *,
    valid: bool,
    simulated: bool,
) -> dict[str, reg.Number]:
    """Values of the status block by name, except those of the server: CLIENTS, START_EPOCH, CONVENTION.

    cell : None before its first state. valid : the coordinates on display may be used. simulated : the last
    result came from a virtual cell.
    """
    return {
        "STATE": STATES[cell.state] if cell is not None else 0,
        "STATUS_BITS": _status_bits(state, cell, now_s, valid, simulated),
        "CMD_SEQ_ECHO": state.command_sequence,
        "HEARTBEAT": int(now_s * 10) & reg.UINT16_MAX,
        "ERROR": _error(cell),
        "WARNING": _warnings(state),
        "ACTIVE_JOB": min(cell.job_number, reg.UINT16_MAX) if cell is not None else 0,
        "RESULT_AGE": _age_ms(state, now_s),
        "MISSED_TRIGGERS": min(cell.missed_triggers, reg.UINT16_MAX) if cell is not None else 0,
        "DONE_SEQ": state.done_sequence,
        "OPEN_COMMANDS": len(state.open),
        "NACK_REASON": state.reason,
        "WRITE_OWNER": int(state.owner is not None),
        "LAST_SEQ": state.ticket & hs.SEQUENCE_MASK,
        "SETUP_SOURCE": cell.setup if cell is not None else SetupSource.NONE,
    }


def _age_ms(state: hs.Handshake[reg.RegisterResult], now_s: float) -> int:
    if state.result is None:
        return reg.UINT32_MAX
    return min(max(round((now_s - state.result.exposed_s) * 1000), 0), reg.UINT32_MAX - 1)


def _error(cell: CellState | None) -> int:
    if cell is None or not (cell.error or cell.error_code):
        return 0
    return (cell.error_code or 1) & reg.UINT16_MAX


def _warnings(state: hs.Handshake[reg.RegisterResult]) -> int:
    raised = [
        (reg.Warn.CLIENT_LOST, state.client_lost),
        (reg.Warn.SETUP, state.suspended),
        (reg.Warn.UNSYNCHRONISED, state.synchronised is None),
    ]
    return sum(bit for bit, is_up in raised if is_up)


def _status_bits(
    state: hs.Handshake[reg.RegisterResult],
    cell: CellState | None,
    now_s: float,
    valid: bool,
    simulated: bool,
) -> int:
    verdict = state.result.verdict if state.result is not None else None
    passed = verdict is ResultVerdict.PASSED and hs.is_fresh(state, now_s)
    raised = [
        (reg.StatusBit.ACK, state.answer is AckState.ACK),
        (reg.StatusBit.NACK, state.answer is AckState.NACK),
        (reg.StatusBit.BUSY, bool(state.open) or (cell is not None and cell.state is CellPhase.BUSY)),
        (reg.StatusBit.EXPOSURE_DONE, state.exposure_done),
        (reg.StatusBit.RESULT_VALID, valid),
        (reg.StatusBit.OK, valid or passed),
        (reg.StatusBit.NOK, verdict in (ResultVerdict.BAD, ResultVerdict.FAULT)),
        (reg.StatusBit.OVERRUN, state.overrun),
        (reg.StatusBit.SIMULATED, simulated),
    ]
    if cell is not None:
        is_fault = cell.state is CellPhase.FAULT
        raised += [
            (reg.StatusBit.READY, cell.ready and len(state.open) < state.limits.queue),
            (reg.StatusBit.ERROR, is_fault or bool(cell.error)),
            (reg.StatusBit.DRIFT_WARN, cell.calibrated is not CalibrationHealth.HOLDS),
            (reg.StatusBit.CAL_INVALID, cell.calibrated is CalibrationHealth.INVALID),
            (reg.StatusBit.CAM_FAULT, is_fault and not cell.cameras_ok),
        ]
    return sum(bit for bit, is_up in raised if is_up)
