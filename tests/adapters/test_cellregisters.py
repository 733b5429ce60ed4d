"""The registers of a cell over a reload: what one asked for, the next does not answer."""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
from helpers.snapshots import make_snapshot, make_target, make_transform

from edged.adapters.modbus.cell import CellRegisters
from edged.adapters.modbus.settings import ModbusSettings
from edged.domain.cell import CellPhase, CellState, SetupSource
from edged.domain.events import (
    Basis,
    Command,
    CommandFailed,
    CommandKind,
    ExposureDone,
    JobChanged,
    Registered,
)
from edged.domain.measurement import Target
from edged.domain.picking import GraspPose
from edged.domain.registration import Method, Registration
from edged.errors import BeingSetUp
from edged.plc import registers as reg
from edged.plc.answers import NackReason


class Queue:
    """A commander that accepts everything."""

    def __init__(self) -> None:
        self.commands: list[Command] = []
        self.locks: list[bool] = []

    def lock_setup(self, locked: bool) -> None:
        self.locks.append(locked)

    def submit(self, command: Command) -> None:
        self.commands.append(command)


def registers(queue: Queue) -> CellRegisters:
    """The registers of a start or a reload, with a PLC that has begun to write."""
    cell = CellRegisters(ModbusSettings(), queue, lambda: 1000.0)
    cell.write(1, reg.ADDRESS["CMD_SEQ"], [0])
    return cell


def status(cell: CellRegisters) -> dict[str, reg.Number]:
    """The status block by name."""
    return reg.decode(reg.STATUS, cell.read(reg.STATUS.address, reg.STATUS.words))


def shown(cell: CellRegisters) -> tuple[reg.Number, reg.Number]:
    """SEQ_HEAD and X of the result."""
    result = reg.decode(reg.RESULT, cell.read(reg.RESULT.address, reg.RESULT.words))
    return result["SEQ_HEAD"], result["X"]


def test_what_is_in_flight_over_a_reload_does_not_answer_the_next_command_of_that_number() -> None:
    """LOCATE 1 from before a reload does not answer LOCATE 1 after it; only the new exposure counts."""
    queue = Queue()
    registers(queue).write(1, reg.ADDRESS["COMMAND"], [CommandKind.LOCATE, 0, 1])
    cell = registers(queue)
    cell.write(1, reg.ADDRESS["COMMAND"], [CommandKind.LOCATE, 0, 1])
    before, after = queue.commands
    assert before == after, "only the object tells them apart"

    cell.take(ExposureDone(1, before))
    assert not int(status(cell)["STATUS_BITS"]) & reg.StatusBit.EXPOSURE_DONE
    for event in (
        make_snapshot(1, command=before),
        JobChanged(1, "flange", before),
        CommandFailed(before, ""),
    ):
        cell.take(event)
        assert (0, 1) == tuple(status(cell)[name] for name in ("DONE_SEQ", "OPEN_COMMANDS"))
        assert (0, reg.INT32_MIN) == shown(cell)

    cell.take(make_snapshot(2, command=after))
    assert (1, 10_000) == shown(cell)


def test_blocks_read_in_a_row_come_from_one_image_until_something_happens_or_expires() -> None:
    """Blocks stay the same within half a millisecond, until a write, or until a result expires."""
    now_s = [1000.0998]
    cell = CellRegisters(ModbusSettings(), Queue(), lambda: now_s[0])
    cell.write(1, reg.ADDRESS["CMD_SEQ"], [0])
    cell.take(make_snapshot(2))
    assert 10_000 == status(cell)["HEARTBEAT"]
    now_s[0] = 1000.1001
    assert 10_000 == status(cell)["HEARTBEAT"]
    cell.write(1, reg.ADDRESS["BOX"], [0])
    assert 10_001 == status(cell)["HEARTBEAT"]
    ends_s = cell.valid_until_s
    now_s[0] = ends_s - 0.0001
    assert 10_000 == shown(cell)[1]
    now_s[0] = ends_s + 1e-5
    assert reg.INT32_MIN == shown(cell)[1]


def test_a_box_is_said_with_each_command_and_stays() -> None:
    """A written box applies to every command until it is written again."""
    queue = Queue()
    cell = registers(queue)
    cell.write(1, reg.ADDRESS["COMMAND"], [CommandKind.LOCATE, 0, 1])
    cell.write(1, reg.ADDRESS["BOX"], [2])
    for sequence in (2, 3):
        cell.write(1, reg.ADDRESS["COMMAND"], [CommandKind.LOCATE, 0, sequence])
    assert [0, 2, 2] == [command.box for command in queue.commands]
    assert 2 == cell.read(reg.ADDRESS["BOX"], 1)[0]


def test_what_others_ask_is_not_shown_to_the_plc() -> None:
    """A part located over Zenoh is not shown to the PLC; a free-running cycle is."""
    cell = registers(Queue())
    cell.take(make_snapshot(1, command=Command(CommandKind.LOCATE, "zenoh", 1)))
    assert (0, reg.INT32_MIN) == shown(cell)
    cell.take(make_snapshot(2))
    assert (2, 10_000) == shown(cell)


def test_what_comes_after_the_time_out_is_not_shown_as_a_free_running_cycle_either() -> None:
    """After the time-out of a command its late result is not shown."""
    queue, now_s = Queue(), 1000.0
    cell = CellRegisters(ModbusSettings(), queue, lambda: now_s)
    cell.write(1, reg.ADDRESS["CMD_SEQ"], [0])
    cell.write(1, reg.ADDRESS["TIMEOUT"], [100])
    cell.write(1, reg.ADDRESS["COMMAND"], [CommandKind.LOCATE, 0, 1])
    now_s += 1.0
    cell.write(1, reg.ADDRESS["CMD_SEQ"], [0])
    cell.take(make_snapshot(1, command=queue.commands[0]))
    assert (0, reg.INT32_MIN) == shown(cell)


def test_auto_lock_is_told_when_it_changes_and_falls_with_its_connection() -> None:
    """AUTO_LOCK is reported when it changes, and is off when its own connection ends."""
    queue = Queue()
    cell = registers(queue)
    for _ in range(3):
        cell.write(1, reg.ADDRESS["AUTO_LOCK"], [1, 0, 0])
    cell.client_disconnected(2)
    assert [True] == queue.locks
    cell.client_disconnected(1)
    assert [True, False] == queue.locks
    words = cell.read(reg.COMMAND.address, reg.COMMAND.words)
    assert 0 == reg.decode(reg.COMMAND, words)["AUTO_LOCK"]
    for value in (0, 7, 0):
        cell.write(1, reg.ADDRESS["AUTO_LOCK"], [value])
    assert [True, False, True, False] == queue.locks


def test_a_command_that_the_cell_refuses_for_setup_says_so() -> None:
    """A command that the cell refuses for SETUP is NACK with that reason, also before the first event."""

    class Busy(Queue):
        def submit(self, command: Command) -> None:
            raise BeingSetUp("the cell is being set up")

    cell = registers(Busy())
    cell.write(1, reg.ADDRESS["COMMAND"], [CommandKind.LOCATE, 0, 1])
    assert (1, NackReason.SETUP) == tuple(status(cell)[name] for name in ("DONE_SEQ", "NACK_REASON"))


def test_a_stop_in_setup_makes_nothing_ready() -> None:
    """A stop in SETUP gives STOPPING, and a command is still refused for SETUP."""
    queue = Queue()
    cell = registers(queue)
    setup = CellState(CellPhase.SETUP, False, True, "flange", 1, 0, setup=SetupSource.PERSON)
    cell.take(setup)
    cell.take(replace(setup, state=CellPhase.STOPPING, setup=SetupSource.NONE))
    cell.write(1, reg.ADDRESS["COMMAND"], [CommandKind.LOCATE, 0, 1])
    assert [] == queue.commands
    assert (4, NackReason.SETUP) == tuple(status(cell)[name] for name in ("STATE", "NACK_REASON"))


# --- the basis of a result ------------------------------------------------------------------------

RESULTS = {
    "result": (reg.RESULT, ""),
    "ur": (reg.UR, "UR_"),
    "ur grasp": (reg.UR_GRASP, "UG_"),
    "float": (reg.FLOAT, "F_"),
    "grasp": (reg.GRASP, "G_"),
    "targets": (reg.TABLE_END, "TABLE_"),
}
"""Blocks with a result, or its rows, and the prefix of their registers' names."""


def block(cell: CellRegisters, of: reg.Block) -> dict[str, reg.Number]:
    """One block by name."""
    return reg.decode(of, cell.read(of.address, of.words))


def located(cell: CellRegisters, queue: Queue, sequence: int, cycle: int = 1) -> None:
    """Send a command that gets a good part with a grasp."""
    cell.write(1, reg.ADDRESS["COMMAND"], [CommandKind.LOCATE, 0, sequence])
    cell.take(ExposureDone(cycle, queue.commands[-1]))
    cell.take(replace(make_snapshot(cycle, command=queue.commands[-1]), targets=(with_grasp(),)))


def with_grasp() -> Target:
    """A part with a grasp."""
    place = make_target().rig_from_part
    return replace(make_target(), grasp=GraspPose("face", 1, 0.0, place, np.eye(6), 50.0, 50.0))


@pytest.mark.parametrize("change", ["reload", "job"])
def test_a_valid_result_falls_at_once_when_what_it_stands_on_is_exchanged(change: str) -> None:
    """A reload makes a valid result RELOADED, with no coordinates and tails of 0 in every block; ACK
    stays, EXPOSURE_DONE does not."""
    queue = Queue()
    cell = registers(queue)
    located(cell, queue, 7)
    assert int(status(cell)["STATUS_BITS"]) & reg.StatusBit.RESULT_VALID
    cell.take(Basis(1, "cal2", "beef") if change == "reload" else JobChanged(2, "other", None))
    bits = reg.StatusBit(int(status(cell)["STATUS_BITS"]))
    fallen = reg.StatusBit.RESULT_VALID | reg.StatusBit.OK | reg.StatusBit.NOK | reg.StatusBit.EXPOSURE_DONE
    assert not bits & fallen
    assert bits & reg.StatusBit.ACK
    assert (7, 7) == (status(cell)["CMD_SEQ_ECHO"], status(cell)["DONE_SEQ"])
    for of, prefix in RESULTS.values():
        values = block(cell, of)
        assert (7, 0) == (values[f"{prefix}SEQ_HEAD"], values[f"{prefix}SEQ_TAIL"])
        places = [values[f"{prefix}{axis}"] for axis in "XYZ"] if f"{prefix}X" in values else []
        assert all(place == reg.INT32_MIN or math.isnan(place) for place in places)
    assert (reg.ResultCode.RELOADED, 0) == (
        block(cell, reg.RESULT)["RESULT"],
        block(cell, reg.RESULT)["COUNT"],
    )
    assert 0 == block(cell, reg.TABLE[0])["T0_SEQ"]


def test_start_epoch_config_crc_and_calibration_change_with_what_results_stand_on() -> None:
    """START_EPOCH, CONFIG_CRC and calibration change at once in every block if something was exchanged,
    and else not."""
    queue = Queue()
    cell = registers(queue)
    cell.take(Basis(0, "cal1", "0000f00d"))
    epochs = [status(cell)["START_EPOCH"]]
    assert 0xF00D == block(cell, reg.CONSTANTS)["CONFIG_CRC"]
    located(cell, queue, 7)
    for basis in (Basis(0, "cal1", "0000f00d"), Basis(1, "cal2", "0000beef")):
        cell.take(basis)
        epochs.append(status(cell)["START_EPOCH"])
        of_blocks = {block(cell, of)[f"{prefix}START_EPOCH"] for of, prefix in RESULTS.values()}
        assert {epochs[-1]} == of_blocks | {block(cell, reg.REGISTRATION)["H_START_EPOCH"]}
    assert epochs[0] == epochs[1] != epochs[2]
    constants = block(cell, reg.CONSTANTS)
    assert (0xBEEF, zlib.crc32(b"cal2")) == (constants["CONFIG_CRC"], constants["CALIBRATION"])


def test_a_command_in_flight_over_a_reload_ends_in_a_reason_of_its_own() -> None:
    """A command during a reload ends in NACK, RELOADED; its later result is not shown, and its failure is
    no second answer."""
    queue = Queue()
    cell = registers(queue)
    cell.write(1, reg.ADDRESS["COMMAND"], [CommandKind.LOCATE, 0, 7])
    cell.take(Basis(1, "cal2", "beef"))
    assert (7, 0, NackReason.RELOADED) == tuple(
        status(cell)[name] for name in ("DONE_SEQ", "OPEN_COMMANDS", "NACK_REASON")
    )
    cell.take(CommandFailed(queue.commands[0], "the configuration was reloaded while it waited"))
    cell.take(make_snapshot(1, command=queue.commands[0]))
    assert (0, reg.INT32_MIN) == shown(cell)
    assert NackReason.RELOADED == status(cell)["NACK_REASON"]


def test_the_robot_that_registers_the_rig_keeps_its_epoch() -> None:
    """REGISTER_SOLVE, which exchanges the registration, is acknowledged in the epoch in which it began."""
    queue = Queue()
    cell = registers(queue)
    cell.take(CellState(CellPhase.SETUP, False, True, "flange", 1, 0, setup=SetupSource.ROBOT))
    cell.write(1, reg.ADDRESS["COMMAND"], [CommandKind.REGISTER_SOLVE, 0, 7])
    epoch = status(cell)["START_EPOCH"]
    cell.take(Basis(1, "cal1", "beef"))
    cell.take(Registered(queue.commands[0], Registration(Method.TOUCH, 4)))
    assert (epoch, 7, 0) == tuple(status(cell)[name] for name in ("START_EPOCH", "DONE_SEQ", "NACK_REASON"))
    assert (epoch, 7) == tuple(block(cell, reg.REGISTRATION)[name] for name in ("H_START_EPOCH", "H_SEQ"))


def words_of_result(cell: CellRegisters, of: reg.Block) -> tuple[int, ...]:
    """The words of a block, for the table with all its rows."""
    start = reg.TABLE[0].address if of is reg.TABLE_END else of.address
    return tuple(
        word
        for first in range(start, of.address + of.words, 16)
        for word in cell.read(first, min(16, of.address + of.words - first))
    )


@pytest.mark.parametrize("name", RESULTS)
@pytest.mark.parametrize(
    "change", ["acknowledged", "too old", "reload", "next command", "the number again on a new connection"]
)
def test_a_block_that_changes_between_two_requests_is_told_by_its_crc_and_mostly_by_its_tail(
    name: str, change: str
) -> None:
    """A mixture of an old and a new block has a wrong CRC, and another tail.

    If the sequence number is the same in both, only the CRC shows it.
    """
    of, prefix = RESULTS[name]
    now_s = 1000.0
    queue = Queue()
    cell = CellRegisters(ModbusSettings(), queue, lambda: now_s)
    cell.write(1, reg.ADDRESS["CMD_SEQ"], [0])
    located(cell, queue, 7)
    before = words_of_result(cell, of)
    if change == "acknowledged":
        cell.write(1, reg.ADDRESS["ACK_SEQ"], [7])
    elif change == "too old":
        now_s += 10.0
    elif change == "reload":
        cell.take(Basis(1, "cal2", "beef"))
    else:
        cell.client_disconnected(1)
        cell.write(2, reg.ADDRESS["CMD_SEQ"], [0])
        cell.write(2, reg.ADDRESS["COMMAND"], [CommandKind.LOCATE, 0, 8 if change == "next command" else 7])
        moved = replace(with_grasp(), rig_from_part=make_transform((0.0, 0.0, 0.1), (1.0, 2.0, 3.0)))
        cell.take(replace(make_snapshot(2, command=queue.commands[-1]), targets=(moved,)))
    after = words_of_result(cell, of)
    place = {
        register.name: register.address - of.address + len(before) - of.words for register in of.registers
    }
    head, tail, crc = (place[f"{prefix}{register}"] for register in ("SEQ_HEAD", "SEQ_TAIL", "CRC16"))
    assert (7, 7) == (before[head], before[tail])
    for words in (before, after):
        assert reg.crc16(bytes_of(words[:crc])) == words[crc]
    for cut in range(1, tail + 1):
        mixed = before[:cut] + after[cut:]
        if mixed[: crc + 1] not in (before[: crc + 1], after[: crc + 1]):
            assert reg.crc16(bytes_of(mixed[:crc])) != mixed[crc], f"cut before word {cut}"
        if mixed[: tail + 1] != before[: tail + 1] and not change.startswith("the number"):
            assert (7, 7) != (mixed[head], mixed[tail]), f"cut before word {cut}"


def bytes_of(words: tuple[int, ...]) -> bytes:
    """The bytes of words, high byte first."""
    return struct.pack(f">{len(words)}H", *words)
