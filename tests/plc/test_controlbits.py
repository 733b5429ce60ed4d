"""The start bit with the real handshake, driven by random clients, cells, faults and times."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from edged.plc import handshake as hs
from edged.plc import handshakeevents as ev
from edged.plc.answers import NackReason, ResultVerdict
from edged.plc.controlbits import (
    JOB_SHIFT,
    EndOfUse,
    StartBit,
    StartCommand,
    begun,
    cell_bits,
    control_written,
)
from edged.plc.handshake import Handshake, HandshakeLimits
from edged.plc.registers import CellBit, ControlBit

LIMITS = HandshakeLimits(validity_s=2.0, heartbeat_s=1.0, owner_s=5.0, queue=8)
UP, DOWN = int(ControlBit.START), 0


class Bits:
    """Handshake and start bit, combined as in the registers. The payload of a result is its ticket."""

    def __init__(self) -> None:
        self.shake: Handshake[int] = Handshake(LIMITS)
        self.start = StartBit()
        self.now_s = 100.0
        self.submitted: list[int] = []

    def tell(self, event: ev.Event[int]) -> None:
        """Apply one event to the handshake."""
        self.shake, effects = hs.step(self.shake, event, self.now_s)
        self.submitted += [effect.ticket for effect in effects if isinstance(effect, ev.Submit)]

    def write(self, client: int, word: int) -> bool:
        """Write CONTROL as this client; False if another client has the turn."""
        self.tell(ev.Tick())
        if not hs.may_write(self.shake, client, self.now_s):
            return False
        self.tell(ev.ClaimedBy(client))
        self.start, action = control_written(self.start, client, word, self.shake)
        if action is EndOfUse.ACKNOWLEDGE:
            self.tell(ev.AckWritten(self.shake.ticket & hs.SEQUENCE_MASK))
        elif action is EndOfUse.TAKE_BACK:
            self.tell(ev.SequenceWritten(0, client=client))
        elif isinstance(action, StartCommand):
            next_of = action.job if action.gives_next else None
            self.tell(ev.SequenceWritten(action.sequence, client=client, once=True, next_of=next_of))
            self.start = begun(self.start, self.shake.ticket)
        return True

    def finish(self, ticket: int, verdict: ResultVerdict = ResultVerdict.GOOD, *rest: int) -> None:
        """Finish a measurement."""
        basis = self.shake.basis
        self.tell(ev.Finished(ticket, 1, verdict, self.now_s, ticket, rest, 0, basis))

    def read(self) -> tuple[CellBit, NackReason]:
        """Read BITS and BITS_REASON."""
        self.tell(ev.Tick())
        valid = hs.is_valid(self.shake, self.now_s)
        return cell_bits(self.start, self.shake, is_ready=True, is_usable=valid, is_simulated=False)


def test_four_steps_are_a_measurement() -> None:
    """START up gives DONE and OK; START down ends DONE and acknowledges the result."""
    run = Bits()
    assert CellBit(0) == run.read()[0], "nobody has written"
    run.write(1, DOWN)
    assert CellBit.READY == run.read()[0]
    run.write(1, UP | 3 << JOB_SHIFT)
    assert ([1], CellBit.BUSY) == (run.submitted, run.read()[0])
    run.tell(ev.Exposed(1))
    assert CellBit.BUSY | CellBit.EXPOSURE_DONE == run.read()[0]
    run.finish(1)
    for _ in range(3):
        run.write(1, UP)
        assert CellBit.DONE | CellBit.OK | CellBit.EXPOSURE_DONE == run.read()[0]
    run.write(1, DOWN)
    assert CellBit.READY == run.read()[0]
    assert not hs.is_valid(run.shake, run.now_s)
    assert [1] == run.submitted


def test_a_start_that_was_up_before_the_cell_runs_nothing() -> None:
    """A START already up runs nothing, neither after a restart nor from another client."""
    run = Bits()
    for client in (1, 2):
        run.now_s += 10
        assert run.write(client, UP)
        assert ([], CellBit(0)) == (run.submitted, run.read()[0])
    run.write(2, DOWN)
    run.write(2, UP)
    assert 1 == len(run.submitted)


def test_what_is_not_good_is_done_and_not_ok() -> None:
    """A miss, a fault, an outdated and a taken-over result give DONE with NOK and the reason."""
    for verdict, reason in (
        (ResultVerdict.BAD, NackReason.NONE),
        (ResultVerdict.FAULT, NackReason.CAPTURE_FAULT),
        (ResultVerdict.GOOD, NackReason.NONE),
    ):
        run = Bits()
        run.write(1, DOWN)
        run.write(1, UP)
        run.finish(1, verdict)
        run.now_s += 3.0 if verdict is ResultVerdict.GOOD else 0.0
        bits, why = run.read()
        assert (CellBit.DONE | CellBit.NOK, reason) == (bits & ~CellBit.EXPOSURE_DONE, why)
    run.tell(ev.SequenceWritten(77, client=2, once=True))
    assert (CellBit.DONE | CellBit.NOK, NackReason.REFUSED) == run.read()
    run.write(1, DOWN)
    assert CellBit.READY == run.read()[0]


def test_a_start_that_falls_early_takes_its_command_back() -> None:
    """A START that falls early cancels its command, and the next edge is a new one."""
    run = Bits()
    run.write(1, DOWN)
    run.write(1, UP)
    run.write(1, DOWN)
    run.finish(1)
    assert CellBit.READY == run.read()[0]
    run.write(1, UP)
    assert CellBit.BUSY == run.read()[0]
    run.finish(1)
    assert CellBit.BUSY == run.read()[0], "an answer to the first is none to the second"
    run.finish(run.submitted[1])
    assert CellBit.OK in run.read()[0]


def test_parts_of_one_picture_come_one_by_one() -> None:
    """NEXT with START gives each part without an exposure, then NOK with reason 9."""
    run = Bits()
    run.write(1, DOWN)
    run.write(1, UP)
    run.finish(1, ResultVerdict.GOOD, 20)
    for expected in (CellBit.OK, CellBit.NOK):
        run.write(1, DOWN)
        run.write(1, UP | int(ControlBit.NEXT))
        bits, reason = run.read()
        assert expected in bits
    assert NackReason.NO_LIST is reason
    assert [1] == run.submitted


class AnyBits(RuleBasedStateMachine):
    """Random clients, cells, faults and times: two write CONTROL, a third one sequences."""

    @initialize()
    def start(self) -> None:
        self.run = Bits()
        self.last: dict[int, bool] = {}  # START as each client last wrote it, since it has the turn
        self.writer = 0  # the client that wrote CONTROL last
        self.edges = 0
        self.by_bits: list[int] = []  # tickets that an edge has begun
        self.used: set[int] = set()  # tickets whose START has fallen

    @rule(client=st.sampled_from([1, 1, 1, 2]), is_up=st.booleans(), is_next=st.booleans())
    def write_control(self, client: int, is_up: bool, is_next: bool) -> None:
        before, ticket = len(self.run.submitted), self.run.start.ticket
        was_mine = self.run.start.client == client
        if not self.run.write(client, (UP if is_up else DOWN) | (int(ControlBit.NEXT) if is_next else 0)):
            return
        if not was_mine:
            self.last.pop(client, None)
        rises = is_up and self.last.get(client) is False
        self.last[client], self.writer = is_up, client
        self.edges += int(rises)
        new = self.run.submitted[before:]
        assert len(new) <= int(rises and not is_next)
        if rises:
            assert self.run.start.ticket not in self.by_bits, "an edge is a command of its own"
            self.by_bits.append(self.run.start.ticket)
        if not is_up:
            self.used.add(ticket)

    @rule(sequence=st.sampled_from([0, 1, 2, 3, 65535]), once=st.booleans())
    def write_sequence(self, sequence: int, once: bool) -> None:
        if hs.may_write(self.run.shake, 3, self.run.now_s):
            self.run.tell(ev.ClaimedBy(3))
            self.run.tell(ev.SequenceWritten(sequence, client=3, once=once))

    @rule(
        which=st.integers(0, 3),
        verdict=st.sampled_from([ResultVerdict.GOOD, ResultVerdict.GOOD, *ResultVerdict]),
        more=st.booleans(),
    )
    def finish(self, which: int, verdict: ResultVerdict, more: bool) -> None:
        if self.run.submitted:
            ticket = self.run.submitted[-1 - which % len(self.run.submitted)]
            self.run.finish(ticket, verdict, *([-ticket] if more else []))

    @rule(which=st.integers(0, 3))
    def expose(self, which: int) -> None:
        if self.run.submitted:
            self.run.tell(ev.Exposed(self.run.submitted[-1 - which % len(self.run.submitted)]))

    @rule(seconds=st.sampled_from([0.01, 0.5, 2.1, 6.0]))
    def wait(self, seconds: float) -> None:
        self.run.now_s += seconds

    @rule(
        event=st.sampled_from(
            [ev.Suspended(), ev.Resumed(), ev.JobChangedElsewhere(), ev.Released(1), ev.Released(2)]
        )
    )
    def disturb(self, event: ev.Event[int]) -> None:
        self.run.tell(event)

    @rule()
    def exchange(self) -> None:
        self.run.tell(ev.Exchanged(self.run.shake.basis + 1))

    @rule(client=st.sampled_from([1, 2]))
    def hang_up(self, client: int) -> None:
        if self.run.start.client == client:
            self.run.start = StartBit()
            self.last.pop(client, None)
        self.run.tell(ev.Released(client, gone=True))

    @invariant()
    def answers_fit_what_was_asked(self) -> None:
        run = self.run
        bits, _ = run.read()
        assert 1 >= sum(bool(bits & one) for one in (CellBit.READY, CellBit.BUSY, CellBit.DONE))
        assert bool(bits & CellBit.DONE) == bool(bits & (CellBit.OK | CellBit.NOK))
        assert not (bits & CellBit.OK and bits & CellBit.NOK)
        is_up = run.start.client is not None and self.last.get(self.writer, False)
        if bits & (CellBit.BUSY | CellBit.DONE):
            assert is_up and run.start.client == self.writer
        if bits & CellBit.READY:
            assert not is_up
        if bits & CellBit.OK:
            assert hs.is_valid(run.shake, run.now_s)
            assert self.by_bits[-1] == run.shake.ticket
            shown = run.shake.result
            assert shown is not None and shown.sequence == run.shake.ticket & hs.SEQUENCE_MASK
            assert run.shake.ticket not in self.used, "used already"
        assert len(self.by_bits) == self.edges


TestAnyBits = AnyBits.TestCase
TestAnyBits.settings = settings(max_examples=300, stateful_step_count=40, deadline=None)
