"""The cell in a PLC's own memory: the handshake as over Modbus, with servers of the makers' protocols."""

from __future__ import annotations

import contextlib
import math
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from helpers import plcmemories as at
from helpers.livecell import LiveCell
from helpers.plcmemories import (
    BadServer,
    Controller,
    LogixController,
    LogixProgram,
    Mangler,
    MelsecController,
    Program,
    S7Controller,
    S7Program,
    UdtController,
    memory_of,
)
from helpers.snapshots import make_target
from helpers.waiting import wait_until
from pymodbus.client import ModbusTcpClient

from edged.adapters.modbus import ModbusPublisher, ModbusSettings
from edged.adapters.plcmemory import PlcMemoryPublisher, make_memory, probe
from edged.config.plc import MelsecSection, PlcSection
from edged.errors import PlcFault
from edged.plc.answers import NackReason
from edged.plc.registers import ADDRESS, ControlBit

pytestmark = pytest.mark.slow

FAMILIES: dict[str, Callable[[], Controller]] = {
    "s7": S7Controller,
    "logix": LogixController,
    "udt": UdtController,
    "melsec": MelsecController,
}


@pytest.fixture(params=FAMILIES)
def controller(request: pytest.FixtureRequest) -> Iterator[Controller]:
    """A PLC of each family."""
    made = FAMILIES[request.param]()
    try:
        yield made
    finally:
        made.stop()


@contextlib.contextmanager
def program_beside(
    cell: LiveCell, controller: Controller, handshake: str = "start-bit"
) -> Iterator[tuple[Program, PlcMemoryPublisher]]:
    """A running cell that has reached the PLC."""
    section = controller.section.model_copy(update={"handshake": handshake})
    with cell, memory_of(cell, section) as publisher:
        program = Program(controller)
        wait_until(lambda: program.word(at.MAGIC) == 0x4544 and not publisher.problem)
        yield program, publisher


def test_four_steps_give_a_part_in_mm(controller: Controller) -> None:
    """START with a job in the upper byte gives a part, NEXT the next one, and failures give a reason."""
    with program_beside(cell := LiveCell(), controller) as (program, _):
        for job, x_mm in ((0, 10.0), (2, -12.5)):
            cell.targets = tuple(make_target(x_mm=x) for x in (x_mm, x_mm + 5.0))
            for word, expected in ((1 | job << 8, x_mm), (3, x_mm + 5.0)):
                program.until(lambda bits: bits & at.READY)
                program.write(at.CONTROL, word)
                bits, reason, x = program.until(lambda bits: bits & at.DONE)
                assert (at.DONE | at.OK, 0) == (bits & ~at.EXPOSED, reason)
                assert expected == pytest.approx(x)
                program.write(at.CONTROL, 0)
                _, _, x = program.until(lambda bits: not bits & at.DONE)
                assert math.isnan(x), "acknowledged: no number"
        assert 2 == cell.head.captures
        program.until(lambda bits: bits & at.READY)
        program.write(at.CONTROL, 1 | 99 << 8)
        bits, reason, _ = program.until(lambda bits: bits & at.DONE)
        assert (at.DONE | at.NOK, NackReason.REFUSED) == (bits, reason)


def test_sequences_work_as_over_modbus(controller: Controller) -> None:
    """A connection's first CMD_SEQ runs nothing, later ones do, and an acknowledged result is withdrawn."""
    Program(controller).write(at.CMD_SEQ, 7)
    Program(controller).write(at.CMD, 1)
    with program_beside(cell := LiveCell(), controller, "sequence") as (program, _):
        wait_until(lambda: program.word(at.REASON + 6) == NackReason.BASELINE)
        assert 0 == cell.head.captures
        for sequence in (8, 9):
            program.write(at.CMD_SEQ, sequence)
            wait_until(lambda sequence=sequence: program.word(at.DONE_SEQ) == sequence)
            assert (sequence, sequence) == (program.word(at.SEQ_HEAD), program.word(at.SEQ_TAIL))
            assert 1 == program.word(at.FLAGS) & 1
            program.write(at.ACK_SEQ, sequence)
            wait_until(lambda: program.word(at.SEQ_TAIL) == 0)
        assert 2 == cell.head.captures


@pytest.mark.parametrize("handshake", ["sequence", "start-bit"])
def test_the_belt_in_an_image_reaches_the_registers(controller: Controller, handshake: str) -> None:
    """Count and speed come with the image of either handshake; that of sequences leaves CONTROL alone."""
    with program_beside(cell := LiveCell(), controller, handshake) as (program, _):
        program.write(at.CONTROL + 2, 1_234_567, "I")
        program.write(at.CONTROL + 6, 200_000, "I")
        program.write(at.CONTROL, ControlBit.ALLOW_SIMULATED)
        with ModbusTcpClient("127.0.0.1", port=cell.port) as client:

            def words() -> list[int]:
                return list(client.read_holding_registers(ADDRESS["CONTROL"], count=5).registers)

            expected = [
                int(ControlBit.ALLOW_SIMULATED) if handshake == "start-bit" else 0,
                18,
                54919,
                3,
                3392,
            ]
            wait_until(lambda: words() == expected)


def test_a_start_that_was_up_before_runs_nothing(controller: Controller) -> None:
    """A START that was already up runs nothing, also after a restart, and a stopping cell clears its
    image."""
    Program(controller).write(at.CONTROL, 1)
    with program_beside(cell := LiveCell(), controller) as (program, _):
        heartbeat = program.word(at.HEARTBEAT)
        wait_until(lambda: program.word(at.HEARTBEAT) not in (heartbeat, heartbeat + 1))
        assert (0, 0) == (cell.head.captures, program.word(at.BITS))
        program.write(at.CONTROL, 0)
        program.locate()
    assert bytes(128) == controller.get(64, 128)
    with program_beside(LiveCell(), controller) as (program, _):
        assert 0 == program.word(at.BITS)


def test_the_flange_that_stands_before_start_is_the_one_that_counts(controller: Controller) -> None:
    """Each command has the pose written before it, however shortly before, also if it is repeated."""
    cell = LiveCell()
    commands = []
    with program_beside(cell, controller) as (program, _):
        submit = cell.cycle.submit
        cell.call(lambda: vars(cell.server)["_cell"].__dict__.update(_commander=Spy(commands, submit, cell)))
        poses = (*range(1000, 1010), 1009)
        for x_um in poses:
            program.until(lambda bits: bits & at.READY)
            program.write(at.FLANGE_X, x_um, "i")
            program.write(at.CONTROL, 1)
            program.until(lambda bits: bits & at.DONE)
            program.write(at.CONTROL, 0)
    assert list(poses) == [round(command.robot_from_flange[0, 3] * 1000) for command in commands]


class Spy:
    """A commander that records its commands."""

    def __init__(self, commands, submit, cell) -> None:
        self._commands, self._submit, self._cell = commands, submit, cell

    def submit(self, command) -> None:
        self._commands.append(command)
        self._submit(command)

    def lock_setup(self, locked: bool) -> None:
        self._cell.cycle.lock_setup(locked)


def test_a_plc_that_comes_back_is_served_again_and_runs_nothing_old(controller: Controller) -> None:
    """The right to write ends when the PLC is off, and a START still up must fall first when it is back."""
    with program_beside(cell := LiveCell(), controller) as (program, publisher):
        program.locate()
        controller.stop()
        wait_until(lambda: publisher.problem)
        wait_until(lambda: cell.call(lambda: cell.server.owner) == "")
        again = type(controller)(port=controller.port)
        try:
            program = Program(again)
            program.write(at.CONTROL, 1)
            wait_until(lambda: not publisher.problem)
            heartbeat = program.word(at.HEARTBEAT)
            wait_until(lambda: program.word(at.HEARTBEAT) not in (heartbeat, heartbeat + 1))
            assert (1, 0) == (cell.head.captures, program.word(at.BITS))
            program.write(at.CONTROL, 0)
            program.locate()
        finally:
            again.stop()


OTHER = 99
"""A client without a connection here."""


@pytest.mark.parametrize("handshake", ["start-bit", "sequence"])
def test_during_another_clients_turn_a_plc_waits_as_one_that_writes_for_ever(handshake: str) -> None:
    """A START or CMD_SEQ written during another client's turn runs nothing and must be given again."""
    controller = S7Controller()
    settings = ModbusSettings(port=0, validity_s=30.0, owner_s=1e6)
    try:
        with program_beside(cell := LiveCell(settings), controller, handshake) as (program, _):
            wait_until(lambda: cell.call(lambda: cell.server.owner))
            # as when it lapses because the PLC is silent for longer than owner_s
            cell.call(lambda: vars(cell.server)["_cell"].client_disconnected(2_000_000))
            cell.call(lambda: cell.server.write(OTHER, {"CLIENT_HEARTBEAT": 0}))
            program.write(at.CONTROL, 1)
            program.write(at.CMD, 1)
            program.write(at.CMD_SEQ, 5)
            heartbeat = program.word(at.HEARTBEAT)
            wait_until(lambda: program.word(at.HEARTBEAT) not in (heartbeat, heartbeat + 1))
            assert 0 == cell.head.captures
            cell.call(lambda: cell.server.remove_client(OTHER))
            if handshake == "start-bit":
                wait_until(lambda: cell.call(lambda: cell.server.owner))  # its writes are taken again
                assert (0, 0) == (program.word(at.BITS), cell.head.captures)
                program.write(at.CONTROL, 0)
                program.locate()
                assert 1 == cell.head.captures
            else:
                wait_until(lambda: program.word(at.REASON + 6) == NackReason.BASELINE)
                assert 0 == cell.head.captures
    finally:
        controller.stop()


def test_registers_that_a_reload_exchanges_run_nothing_of_before() -> None:
    """The same thread continues with the new registers, and START must be seen down first."""
    controller, cell = S7Controller(), LiveCell()
    Program(controller).write(at.CONTROL, 0)
    try:
        with cell:
            served: list[ModbusPublisher | None] = [cell.server]

            async def start() -> PlcMemoryPublisher:
                made = make_memory(controller.section)
                publisher = PlcMemoryPublisher(controller.section, lambda: served[0], made)
                await publisher.start()
                cell.cycle.set_publishers([cell.server, publisher])
                return publisher

            publisher = cell.run(start())
            program = Program(controller)
            program.locate()
            served[0] = None
            wait_until(lambda: controller.get(64, 128) == bytes(128))
            other = ModbusPublisher(cell.settings, cell.cycle)
            cell.run(other.start())
            cell.call(lambda: cell.cycle.set_publishers([other, publisher]))
            served[0] = other
            wait_until(lambda: program.word(at.MAGIC) == 0x4544)
            assert (1, 0) == (cell.head.captures, program.word(at.BITS))
            program.write(at.CONTROL, 0)
            program.locate()
            cell.call(lambda: cell.cycle.set_publishers([cell.server]))
            cell.run(publisher.close())
            cell.run(other.close())
        assert 2 == cell.head.captures
    finally:
        controller.stop()


# --- bad answers -------------------------------------------------------------------------------------


def silent(line: socket.socket) -> None:
    """Receives everything and answers nothing."""
    while line.recv(4096):
        pass


def babbling(line: socket.socket) -> None:
    """Sends bytes that are no answer."""
    line.recv(4096)
    line.sendall(bytes(range(256)) * 40)


def truncated(line: socket.socket) -> None:
    """Begins a frame that claims to be long, then sends only a byte now and then."""
    line.recv(4096)
    line.sendall(b"\x03\x00\xff\xff")
    while True:
        line.sendall(b"\x00")
        time.sleep(0.05)


def hanging_up(line: socket.socket) -> None:
    """Disconnects at once, as for a wrong rack or slot."""
    line.recv(4096)


SECTIONS = {"s7": {"db": 100}, "logix": {}, "melsec": {"cpu": "iq-f"}}


@pytest.mark.parametrize("answer", [silent, babbling, truncated, hanging_up])
@pytest.mark.parametrize("family", SECTIONS)
def test_the_cell_measures_whatever_the_plc_answers(
    family: str, answer: Callable[[socket.socket], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The problem is reported and retried, and commands of other clients do not wait for it."""
    monkeypatch.setattr("edged.adapters.plcmemory.exchange.HANG_S", 0.5)
    with BadServer(answer) as server:
        section = PlcSection.model_validate(
            {"host": "127.0.0.1", family: {**SECTIONS[family], "port": server.port}}
        )
        with LiveCell(period_s=0.01) as cell, memory_of(cell, section) as publisher:
            wait_until(lambda: server.connections >= 2)
            before = cell.head.captures
            assert publisher.problem not in ("", "no answer yet")
            wait_until(lambda: cell.head.captures > before + 5)
    wait_until(lambda: not any(thread.name == "plc" for thread in threading.enumerate()))


@pytest.mark.long
@pytest.mark.parametrize("family", ["s7", "udt", "melsec"])
def test_mangled_answers_end_in_a_new_connection(
    family: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """With a tenth of the answers mangled there is no unhandled error, and afterwards everything works."""
    for name, value_s in (("HANG_S", 0.3), ("FIRST_RETRY_S", 0.005), ("LAST_RETRY_S", 0.005)):
        monkeypatch.setattr(f"edged.adapters.plcmemory.exchange.{name}", value_s)
    monkeypatch.setattr("edged.adapters.plcmemory.publisher.ANSWER_S", 0.2)
    controller = FAMILIES[family]()
    key = controller.section.family
    try:
        with Mangler(controller.section.port, seed=1) as mangler, LiveCell() as cell:
            own = getattr(controller.section, key).model_copy(update={"port": mangler.port})
            with memory_of(cell, controller.section.model_copy(update={key: own})) as publisher:
                program = Program(controller)
                program.until(lambda bits: bits & at.READY)
                mangler.rate = 0.1
                wait_until(lambda: mangler.mangled >= 100)
                mangler.rate = 0.0
                assert mangler.connections > 20
                program.write(at.CONTROL, 0)
                connections = 0
                while connections != mangler.connections:  # answers still under way may be wrong
                    connections, heartbeat = mangler.connections, program.word(at.HEARTBEAT)
                    wait_until(lambda before=heartbeat: program.word(at.HEARTBEAT) > before + 4)
                assert not publisher.problem
                program.locate()
    finally:
        controller.stop()
    assert not [record for record in caplog.records if record.exc_info]


def test_a_block_that_is_too_short_or_missing_is_named() -> None:
    """`probe`, as used by `edged doctor`, and the cell name the problem, and nothing is written."""
    controller = S7Controller(size=191)
    try:
        with pytest.raises(PlcFault, match=r"DB100, 192 bytes from 0 on: .*that long"):
            probe(controller.section)
        assert controller.section.s7 is not None
        missing = controller.section.s7.model_copy(update={"db": 101})
        with pytest.raises(PlcFault, match="DB101"):
            probe(controller.section.model_copy(update={"s7": missing}))
        with LiveCell() as cell, memory_of(cell, controller.section) as publisher:
            wait_until(lambda: "DB100" in publisher.problem)
        assert bytes(191) == controller.get(0, 191)
    finally:
        controller.stop()


def test_a_plc_is_asked_without_being_written(controller: Controller) -> None:
    """`probe` reports the current words and writes nothing."""
    Program(controller).write(at.CMD_SEQ, 7)
    assert "192 bytes for edged: CMD_SEQ 7, CONTROL 0" in probe(controller.section)
    assert bytes(128) == controller.get(64, 128)


def logix_names(name: str) -> str:
    """Name of a variable of FB_EDGED_DB in the add-on instruction."""
    names = {"xError": "Failed", "uiReason": "Reason", "uiJob": "Job", "stResult": "Result"}
    return names.get(name, name if name in ("xExecute", "xBusy") else name.removeprefix("x"))


@pytest.mark.parametrize(
    ("make", "run_by", "named"),
    [(S7Controller, S7Program, str), (UdtController, LogixProgram, logix_names)],
    ids=["scl", "l5x"],
)
def test_the_generated_program_locates_parts_in_its_memory(
    make: Callable[[], Controller], run_by: Callable[[Controller], Any], named: Callable[[str], str]
) -> None:
    """It gets each part, a START that falls early starts no command, and a lost link is an error."""
    controller = make()
    program = run_by(controller)

    def value(name: str) -> Any:
        shared = program.program.shared
        return shared[named(name)] if named(name) in shared else program.values[named(name)]

    try:
        with program_beside(cell := LiveCell(), controller):
            program.until(named("xReady"))
            for job, x_mm in ((0, 10.0), (2, -12.5)):
                cell.targets = tuple(make_target(x_mm=x) for x in (x_mm, x_mm + 5.0))
                for is_next, expected in ((False, x_mm), (True, x_mm + 5.0)):
                    program.run(**{named("uiJob"): job, named("xNext"): is_next})
                    assert (True, True, False) == tuple(map(value, ("xDone", "xValid", "xError")))
                    assert expected == pytest.approx(value("stResult")["F_X"])
                    program.release()
                    assert not value("xValid")
                    program.until(named("xReady"))
            for job, is_execute in ((1, True), (1, False), (2, True)):  # faster than the cell reads
                program.values |= {named("uiJob"): job, named("xNext"): False, "xExecute": is_execute}
                program.scan()
            program.until(named("xDone"))
            assert (2, True) == (value("stResult")["JOB"], value("xValid"))
            program.release()
            program.until(named("xReady"))
            program.run(**{named("uiJob"): 99})
            assert (True, False, NackReason.REFUSED) == tuple(map(value, ("xError", "xValid", "uiReason")))
            program.release()
        program.values["xExecute"] = True
        program.until(named("xError"))
        assert (False, False, 101) == tuple(map(value, ("xDone", "xValid", "uiReason")))
    finally:
        controller.stop()


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"kind": b"\xca\x00"}, "Edged.ToCell is of type 0x00CA; expected the structure"),
        ({"to_cell_bytes": 60}, "Edged.ToCell has 60 bytes; expected 64"),
        ({"to_cell_bytes": 68}, "Edged.ToCell has 68 bytes; expected 64"),
    ],
)
def test_a_tag_that_is_another_is_named(changes: dict[str, bytes | int], expected: str) -> None:
    """The error names its type or length, and nothing is written."""
    controller = UdtController(**changes)
    try:
        with pytest.raises(PlcFault, match=expected):
            probe(controller.section)
        assert bytes(128) == bytes(controller.members["FromCell"])
    finally:
        controller.stop()


def test_a_tag_that_is_missing_is_named_and_a_programs_tag_is_found_by_its_path() -> None:
    """Each part of the name is a segment of its own, padded to even length."""
    controller = UdtController()
    try:
        logix = controller.section.logix
        assert logix is not None
        for tag in ("Other", "Program:Main.Edge"):
            section = controller.section.model_copy(update={"logix": logix.model_copy(update={"tag": tag})})
            with pytest.raises(PlcFault, match=f"{tag}.ToCell: status 0x05 : no tag of that name"):
                probe(section)
        assert [("Other", "ToCell"), ("Program:Main", "Edge", "ToCell")] == controller.paths
    finally:
        controller.stop()


@pytest.mark.parametrize(
    ("device", "expected"), [("D1000", "D1032"), ("W1F0", "W210"), ("ZR96", "ZR128"), ("R0", "R32")]
)
def test_the_second_image_is_32_devices_behind_the_first(device: str, expected: str) -> None:
    """The second image is 32 devices after the first; link registers count in hexadecimal."""
    assert (device, expected) == MelsecSection(port=5007, cpu="iq-r", device=device).devices(32)


def test_devices_that_a_cpu_does_not_have_are_named() -> None:
    """The error names the first device of a range that the CPU does not have."""
    controller = MelsecController()
    try:
        melsec = controller.section.melsec
        assert melsec is not None
        for device in ("D7950", "ZR0"):
            section = controller.section.model_copy(
                update={"melsec": melsec.model_copy(update={"device": device})}
            )
            with pytest.raises(PlcFault, match=f"96 words from {device} on: .*the CPU has them"):
                probe(section)
    finally:
        controller.stop()
