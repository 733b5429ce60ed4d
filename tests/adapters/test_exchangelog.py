"""The exchanges between PLC and cell, kept for people to read."""

from __future__ import annotations

import struct

import pytest
from helpers.snapshots import make_snapshot

from edged.adapters.modbus.cell import CellRegisters
from edged.adapters.modbus.pdu import RequestRefused
from edged.adapters.modbus.settings import ModbusSettings
from edged.domain.events import Basis, Command, CommandFailed, CommandKind, ExposureDone
from edged.plc import registers as reg
from edged.plc.exchangelog import KEPT, MOST_RUNGS, Exchange


class Queue:
    """A commander that accepts everything."""

    def __init__(self) -> None:
        self.commands: list[Command] = []

    def lock_setup(self, locked: bool) -> None:
        pass

    def submit(self, command: Command) -> None:
        self.commands.append(command)


class Talk:
    """A PLC with one address; every word takes 10 ms."""

    def __init__(self) -> None:
        self.now_s, self.queue = 1000.0, Queue()
        self.cell = CellRegisters(ModbusSettings(), self.queue, self._clock)
        self.cell.addresses |= {1: "10.0.0.5", 2: "10.0.0.9"}
        self.cell.write(1, reg.ADDRESS["CMD_SEQ"], [0])

    def _clock(self) -> float:
        return self.now_s

    def command(self, sequence: int, kind: int = CommandKind.LOCATE, client: int = 1) -> None:
        """Write the first three words of the command block."""
        self.now_s += 0.01
        self.cell.write(client, reg.ADDRESS["COMMAND"], [kind, 0, sequence])

    @property
    def last(self) -> Exchange:
        """The newest exchange."""
        return self.cell.ladder.exchanges[0]


def said(exchange: Exchange) -> list[tuple[str, str]]:
    """Each step with its detail."""
    return [(rung.what, rung.detail) for rung in exchange.rungs]


def test_a_good_exchange_is_one_ladder_from_the_command_to_its_acknowledgement() -> None:
    """A good exchange is listed from the command to its acknowledgement, with times; listing it changes
    nothing."""
    talk = Talk()
    talk.command(7)
    (command,) = talk.queue.commands
    talk.now_s += 0.1
    talk.cell.take(ExposureDone(1, command))
    talk.now_s += 0.05
    talk.cell.take(make_snapshot(1, command=command))
    for _ in range(3):
        talk.cell.read(reg.STATUS.address, reg.STATUS.words)
        talk.cell.write(1, reg.ADDRESS["ACK_SEQ"], [7])
    talk.command(0)

    exchange = talk.last
    assert ("10.0.0.5", 7, "LOCATE", 0, "") == (
        exchange.client,
        exchange.sequence,
        exchange.command,
        exchange.job,
        exchange.hint,
    )
    whats = [("command", ""), ("exposure", ""), ("result", "OK"), ("ack", ""), ("acknowledged", "")]
    assert [*whats, ("taken_down", "")] == said(exchange)
    assert exchange.rungs[2].valid
    assert [0.0, 0.1, 0.15] == pytest.approx([rung.after_s for rung in exchange.rungs[:3]])


def test_a_reload_shows_where_it_took_a_result_and_a_command() -> None:
    """A reload is listed with the result or command that it ended; a second reload adds nothing."""
    talk = Talk()
    talk.command(7)
    talk.cell.take(make_snapshot(1, command=talk.queue.commands[0]))
    for number in (1, 2):
        talk.cell.take(Basis(number, "cal", "beef"))
    assert [("command", ""), ("result", "OK"), ("ack", ""), ("reloaded", "")] == said(talk.last)
    talk.command(8)
    talk.cell.take(Basis(3, "cal", "cafe"))
    assert [("command", ""), ("nack", "RELOADED")] == said(talk.last)


def test_what_is_refused_says_why_and_a_stranger_is_told_apart() -> None:
    """A refused command has its reason: a failure, an unknown number, or another client's turn."""
    talk = Talk()
    talk.command(1)
    talk.cell.take(CommandFailed(talk.queue.commands[0], "no"))
    assert [("command", ""), ("nack", "FAILED")] == said(talk.last)
    talk.command(2, 77)
    assert ("", 77, [("command", ""), ("nack", "UNKNOWN_COMMAND")]) == (
        talk.last.command,
        talk.last.code,
        said(talk.last),
    )
    for _ in range(3):
        with pytest.raises(RequestRefused):
            talk.command(3, client=2)
    assert ("10.0.0.9", 3, [("barred", "")]) == (talk.last.client, talk.last.times, said(talk.last))
    talk.now_s += 10
    talk.command(5, client=2)
    assert ("10.0.0.9", [("command", ""), ("nack", "BASELINE")]) == (talk.last.client, said(talk.last))


def test_words_and_bytes_that_a_client_has_exchanged_are_seen_in_what_it_writes() -> None:
    """Exchanged bytes of a command and exchanged words of a flange pose give a hint."""
    talk = Talk()
    talk.command(1, CommandKind.LOCATE << 8)
    assert "bytes" == talk.last.hint
    for order, hint in ((1, ""), (-1, "words")):
        words = [w for mm in (512.3, -88.1, 611.0, 12.0, 3.0, 178.0) for w in _words(mm)[::order]]
        talk.cell.write(1, reg.ADDRESS["FLANGE_X"], words)
        talk.command(2 + order)
        assert hint == talk.last.hint


def _words(mm: float) -> tuple[int, ...]:
    return struct.unpack(">2H", struct.pack(">i", round(1000 * mm)))


def test_only_the_last_are_kept_and_none_grows_without_end() -> None:
    """Only the last commands are kept, each with a limited number of steps."""
    talk = Talk()
    for sequence in range(1, KEPT + 20):
        talk.command(sequence)
    kept = talk.cell.ladder.exchanges
    assert list(range(KEPT + 19, 19, -1)) == [one.sequence for one in kept]
    for _ in range(3 * MOST_RUNGS):
        talk.command(0)
        talk.command(KEPT + 20)
    assert all(len(one.rungs) <= MOST_RUNGS for one in talk.cell.ladder.exchanges)
    assert KEPT == len(talk.cell.ladder.exchanges)
