"""The registers of a cell between two of their lives: what one was asked, the next does not answer."""

from __future__ import annotations

from dataclasses import replace

from snapshots import make_snapshot

from edged.adapters.modbus.cell import CellRegisters
from edged.adapters.modbus.settings import ModbusSettings
from edged.domain.cell import CellPhase, CellState, SetupSource
from edged.domain.events import Command, CommandFailed, CommandKind, ExposureDone, JobChanged
from edged.errors import BeingSetUp
from edged.plc import registers as reg
from edged.plc.answers import Reason


class Queue:
    """A commander that takes everything."""

    def __init__(self) -> None:
        self.commands: list[Command] = []
        self.locks: list[bool] = []

    def lock_setup(self, locked: bool) -> None:
        self.locks.append(locked)

    def submit(self, command: Command) -> None:
        self.commands.append(command)


def registers(queue: Queue) -> CellRegisters:
    """As a start or a reload makes them, and a PLC that has begun to write."""
    cell = CellRegisters(ModbusSettings(), queue, lambda: 1000.0)
    cell.write(1, reg.ADDRESS["CMD_SEQ"], [0])
    return cell


def status(cell: CellRegisters) -> dict[str, reg.Number]:
    """The block by name."""
    return reg.decode(reg.STATUS, cell.read(reg.STATUS.address, reg.STATUS.words))


def shown(cell: CellRegisters) -> tuple[reg.Number, reg.Number]:
    """SEQ_HEAD and X."""
    result = reg.decode(reg.RESULT, cell.read(reg.RESULT.address, reg.RESULT.words))
    return result["SEQ_HEAD"], result["X"]


def test_what_is_in_flight_over_a_reload_does_not_answer_the_next_command_of_that_number() -> None:
    """LOCATE 1 is measured while [modbus] changes, and is written again: its own exposure counts."""
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


def test_a_box_is_said_with_each_command_and_stays() -> None:
    """Written once, of every command until it is written again."""
    queue = Queue()
    cell = registers(queue)
    cell.write(1, reg.ADDRESS["COMMAND"], [CommandKind.LOCATE, 0, 1])
    cell.write(1, reg.ADDRESS["BOX"], [2])
    for sequence in (2, 3):
        cell.write(1, reg.ADDRESS["COMMAND"], [CommandKind.LOCATE, 0, sequence])
    assert [0, 2, 2] == [command.box for command in queue.commands]
    assert 2 == cell.read(reg.ADDRESS["BOX"], 1)[0]


def test_what_others_ask_is_not_shown_to_the_plc() -> None:
    """A part that was located over Zenoh is no cycle of a free-running cell; one that nobody asked for is."""
    cell = registers(Queue())
    cell.take(make_snapshot(1, command=Command(CommandKind.LOCATE, "zenoh", 1)))
    assert (0, reg.INT32_MIN) == shown(cell)
    cell.take(make_snapshot(2))
    assert (2, 10_000) == shown(cell)


def test_what_comes_after_the_time_out_is_not_shown_as_a_free_running_cycle_either() -> None:
    """The command has ended, CMD_SEQ is 0 again: its late result belongs to nobody."""
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
    """A PLC that writes its whole block for ever says it once; another client's end is nothing to it."""
    queue = Queue()
    cell = registers(queue)
    for _ in range(3):
        cell.write(1, reg.ADDRESS["AUTO_LOCK"], [1, 0, 0])
    cell.gone(2)
    assert [True] == queue.locks
    cell.gone(1)
    assert [True, False] == queue.locks
    words = cell.read(reg.COMMAND.address, reg.COMMAND.words)
    assert 0 == reg.decode(reg.COMMAND, words)["AUTO_LOCK"]
    for value in (0, 7, 0):
        cell.write(1, reg.ADDRESS["AUTO_LOCK"], [value])
    assert [True, False, True, False] == queue.locks


def test_a_command_that_the_cell_refuses_for_setup_says_so() -> None:
    """Also before the state has been told: between a start, or a reload, and its first event."""

    class Busy(Queue):
        def submit(self, command: Command) -> None:
            raise BeingSetUp("the cell is being set up")

    cell = registers(Busy())
    cell.write(1, reg.ADDRESS["COMMAND"], [CommandKind.LOCATE, 0, 1])
    assert (1, Reason.SETUP) == tuple(status(cell)[name] for name in ("DONE_SEQ", "NACK_REASON"))


def test_a_stop_in_setup_makes_nothing_ready() -> None:
    """STOPPING, and a command that comes now, is as in SETUP."""
    queue = Queue()
    cell = registers(queue)
    setup = CellState(CellPhase.SETUP, False, True, "flange", 1, 0, setup=SetupSource.PERSON)
    cell.take(setup)
    cell.take(replace(setup, state=CellPhase.STOPPING, setup=SetupSource.NONE))
    cell.write(1, reg.ADDRESS["COMMAND"], [CommandKind.LOCATE, 0, 1])
    assert [] == queue.commands
    assert (4, Reason.SETUP) == tuple(status(cell)[name] for name in ("STATE", "NACK_REASON"))
