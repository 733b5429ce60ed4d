"""The handshake, driven by random clients, cells, faults and times."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from edged.plc import handshake as hs
from edged.plc.handshake import Answer, Handshake, Limits, Reason, Verdict, is_valid, may_write, step

LIMITS = Limits(validity_s=2.0, heartbeat_s=1.0, owner_s=5.0, queue=8)


class Run:
    """A handshake that is driven step by step; remembers every effect."""

    def __init__(self, synchronised: int | None = 0) -> None:
        self.state: Handshake[str] = Handshake(LIMITS, synchronised=synchronised)
        self.now_s = 100.0
        self.effects: list[hs.Effect] = []

    def tell(self, event: hs.Event[str]) -> tuple[hs.Effect, ...]:
        self.state, effects = step(self.state, event, self.now_s)
        self.effects += effects
        return effects

    def good(self, ticket: int | None, cycle: int = 1, payload: str = "part") -> None:
        self.tell(hs.Finished(ticket, cycle, Verdict.GOOD, self.now_s, payload))

    @property
    def valid(self) -> bool:
        return is_valid(self.state, self.now_s)


def test_a_command_is_answered_and_its_result_is_valid_until_acknowledged() -> None:
    """SEQ 7 is written: nothing valid; result: ACK, valid with SEQ 7; ACK_SEQ 7: not valid any more."""
    run = Run()
    assert (hs.Submit(7),) == run.tell(hs.SequenceWritten(7))
    assert not run.valid
    run.tell(hs.Exposed(7))
    assert run.state.exposure_done
    assert not run.valid
    run.good(7)
    assert run.valid
    assert (7, 7, Answer.ACK) == (run.state.result.sequence, run.state.done_sequence, run.state.answer)
    run.tell(hs.AckWritten(6))
    assert run.valid
    run.tell(hs.AckWritten(7))
    assert not run.valid


def test_the_same_sequence_again_does_not_run_again() -> None:
    """A PLC that writes its block cyclically triggers once."""
    run = Run()
    run.tell(hs.SequenceWritten(7))
    assert () == run.tell(hs.SequenceWritten(7))


def test_the_first_number_after_the_start_runs_nothing() -> None:
    """A PLC that goes on writing what it wrote to the daemon before this one: NACK 8, the next one runs."""
    run = Run(synchronised=None)
    assert (hs.Answered(7, Answer.NACK, Reason.BASELINE),) == run.tell(hs.SequenceWritten(7))
    assert (7, 7, Reason.BASELINE) == (run.state.command_sequence, run.state.done_sequence, run.state.reason)
    assert () == run.tell(hs.SequenceWritten(7))
    assert (hs.Submit(8),) == run.tell(hs.SequenceWritten(8))


def test_zero_is_a_first_number_as_good_as_any() -> None:
    """A PLC that starts with cleared registers commands with its next write, and no result is taken down."""
    run = Run(synchronised=None)
    run.good(None, cycle=3)
    assert () == run.tell(hs.SequenceWritten(0))
    assert run.valid
    assert (hs.Submit(1),) == run.tell(hs.SequenceWritten(1))


def test_a_command_that_is_written_once_on_purpose_needs_no_number_before() -> None:
    """And it makes this connection's number known, so that a cyclic repetition runs nothing."""
    run = Run(synchronised=None)
    assert (hs.Submit(7),) == run.tell(hs.SequenceWritten(7, client=5, once=True))
    assert () == run.tell(hs.SequenceWritten(7, client=5))
    assert (hs.Submit(8),) == run.tell(hs.SequenceWritten(8, client=5))


def test_a_new_connection_and_another_client_begin_with_a_number_that_runs_nothing() -> None:
    """Whoever wrote CMD_SEQ last goes on; anybody else, and a connection made anew, begins."""
    run = Run()
    assert (hs.Submit(1),) == run.tell(hs.SequenceWritten(1))
    run.good(1)
    run.tell(hs.Released(0))
    assert (hs.Submit(2),) == run.tell(hs.SequenceWritten(2)), "only the right to write was given up"
    run.good(2)
    for event in (hs.SequenceWritten(9, client=4), hs.SequenceWritten(2)):
        (answered,) = run.tell(event)
        assert isinstance(answered, hs.Answered) and answered.reason is Reason.BASELINE
        assert not run.valid
    run.tell(hs.Released(0, gone=True))
    (answered,) = run.tell(hs.SequenceWritten(3))
    assert isinstance(answered, hs.Answered) and answered.reason is Reason.BASELINE


def test_a_command_that_had_to_wait_for_its_turn_runs_nothing() -> None:
    """It may have been given up meanwhile, and a PLC goes on writing it."""
    run = Run()
    run.tell(hs.Barred(3))
    assert (hs.Submit(1),) == run.tell(hs.SequenceWritten(1)), "another client's turn is nothing to this one"
    run.good(1)
    run.tell(hs.Barred(0))
    (answered,) = run.tell(hs.SequenceWritten(2))
    assert isinstance(answered, hs.Answered) and answered.reason is Reason.BASELINE


def test_a_connection_never_gets_the_answer_of_another_under_its_own_number() -> None:
    """7 is shown, or still measured, for a client that is gone: a new one that writes 7 sees neither."""
    done, late = Run(), Run()
    done.tell(hs.SequenceWritten(7))
    done.good(7)
    assert done.valid
    late.tell(hs.SequenceWritten(7))
    for run in (done, late):
        run.tell(hs.Released(0, gone=True))
        run.tell(hs.SequenceWritten(7, client=1))
        run.good(7)
        assert run.state.result is None
        assert (7, Answer.NACK, Reason.BASELINE) == (
            run.state.done_sequence,
            run.state.answer,
            run.state.reason,
        )


def test_a_late_result_of_an_older_command_with_the_same_number_is_not_shown() -> None:
    """5 times out, 0 resets, 5 again: the first 5's result comes late and belongs to nobody."""
    run = Run()
    run.tell(hs.SequenceWritten(5, timeout_s=0.5))
    run.now_s += 1.0
    run.tell(hs.SequenceWritten(0))
    run.tell(hs.SequenceWritten(5))
    run.good(5, payload="old")
    assert run.state.result is None
    assert Answer.NONE is run.state.answer
    run.good(5 + 65536, payload="new")
    assert "new" == run.state.result.payload
    assert run.valid


def test_the_sequence_wraps() -> None:
    """After 65535 comes 1, and its ticket is a new one."""
    run = Run()
    run.tell(hs.SequenceWritten(65535))
    run.good(65535)
    assert (hs.Submit(65536 + 1),) == run.tell(hs.SequenceWritten(1))
    run.good(65536 + 1)
    assert run.valid
    assert 1 == run.state.result.sequence


def test_a_ninth_open_command_is_refused_with_overrun_and_the_next_accepted_one_clears_it() -> None:
    """Eight wait at most; a refused command leaves nothing valid."""
    run = Run()
    for sequence in range(1, 9):
        run.tell(hs.SequenceWritten(sequence))
    assert (hs.Answered(9, Answer.NACK, Reason.QUEUE_FULL),) == run.tell(hs.SequenceWritten(9))
    assert run.state.overrun
    for ticket in range(1, 9):
        run.good(ticket)
    assert not run.valid
    run.tell(hs.SequenceWritten(10))
    assert not run.state.overrun
    run.good(10)
    assert run.valid


def test_the_newest_answer_is_not_written_over_by_an_older_command() -> None:
    """2 times out while 1 is still measured; 1 ends later: DONE_SEQ goes on to say 2, NACK."""
    run = Run()
    run.tell(hs.SequenceWritten(1))
    run.tell(hs.SequenceWritten(2, timeout_s=0.1))
    run.now_s += 0.2
    run.tell(hs.Tick())
    run.good(1)
    assert (2, Answer.NACK, Reason.TIMEOUT) == (
        run.state.done_sequence,
        run.state.answer,
        run.state.reason,
    )
    assert {1: Answer.ACK, 2: Answer.NACK} == {
        effect.ticket: effect.answer for effect in run.effects if isinstance(effect, hs.Answered)
    }


def test_an_unknown_or_declined_command_is_a_nack_with_its_reason() -> None:
    """And what was on display before is gone: nobody can take it for the answer."""
    run = Run()
    run.good(None, cycle=3)
    assert run.valid
    run.tell(hs.SequenceWritten(1, known=False))
    assert (Answer.NACK, Reason.UNKNOWN_COMMAND) == (run.state.answer, run.state.reason)
    assert not run.valid
    run.tell(hs.SequenceWritten(2))
    assert (hs.Answered(2, Answer.NACK, Reason.REFUSED),) == run.tell(hs.Declined(2))
    assert () == run.tell(hs.Declined(2))


def test_a_camera_fault_is_a_nack_and_never_valid() -> None:
    """The command could not be carried out; the fault itself may be displayed."""
    run = Run()
    run.tell(hs.SequenceWritten(4))
    run.tell(hs.Finished(4, 1, Verdict.FAULT, run.now_s, "fault"))
    assert (Answer.NACK, Reason.CAPTURE_FAULT) == (run.state.answer, run.state.reason)
    assert "fault" == run.state.result.payload
    assert not run.valid


def test_age_counts_from_the_exposure() -> None:
    """A result that took 1.5 s to compute is valid for another 0.5 s; one from the future never."""
    run = Run()
    run.tell(hs.Finished(None, 1, Verdict.GOOD, run.now_s - 1.5, "slow"))
    assert run.valid
    run.now_s += 0.51
    assert not run.valid
    run.tell(hs.Finished(None, 2, Verdict.GOOD, run.now_s + 0.1, "future"))
    assert not run.valid


def test_a_free_running_cell_shows_the_newest_and_keeps_quiet_while_commanded() -> None:
    """With CMD_SEQ 0 each cycle replaces the last; with another only the command's own result counts."""
    run = Run()
    run.good(None, cycle=65535)
    assert 65535 == run.state.result.sequence
    run.good(None, cycle=65536)
    assert 1 == run.state.result.sequence
    run.tell(hs.SequenceWritten(1))
    run.good(None, cycle=65537)
    assert run.state.result is None
    run.good(1, payload="mine")
    run.good(None, cycle=65538)
    assert "mine" == run.state.result.payload
    run.tell(hs.SequenceWritten(0))
    run.good(None, cycle=65539)
    assert 4 == run.state.result.sequence


def test_a_client_whose_heartbeat_stops_loses_its_result_and_its_right_to_write() -> None:
    """Counting supervises, 0 ends it, silence withdraws."""
    run = Run()
    run.tell(hs.ClaimedBy(1))
    run.tell(hs.HeartbeatWritten(1))
    run.good(None)
    run.now_s += 0.9
    run.tell(hs.HeartbeatWritten(2))
    run.now_s += 0.9
    run.tell(hs.Tick())
    assert run.valid
    run.tell(hs.HeartbeatWritten(2))  # the same value is no sign of life
    run.now_s += 0.2
    run.tell(hs.Tick())
    assert run.state.client_lost
    assert not run.valid
    assert may_write(run.state, 2, run.now_s)
    run.tell(hs.HeartbeatWritten(0))
    assert not run.state.client_lost


def test_one_client_writes_at_a_time() -> None:
    """The right lapses with time, but not while a command is open; and it ends with the connection."""
    run = Run()
    run.tell(hs.ClaimedBy(1))
    assert may_write(run.state, 1, run.now_s)
    assert not may_write(run.state, 2, run.now_s)
    run.tell(hs.SequenceWritten(1))
    assert not may_write(run.state, 2, run.now_s + 60)
    run.good(1)
    assert may_write(run.state, 2, run.now_s + 60)
    assert not may_write(run.state, 2, run.now_s)
    run.tell(hs.Released(2))
    assert not may_write(run.state, 2, run.now_s)
    run.tell(hs.Released(1))
    assert may_write(run.state, 2, run.now_s)


class AnyClientAnyCell(RuleBasedStateMachine):
    """Random clients, cells, faults and times. The payload of a result is the ticket that asked for it.

    The model beside the machine: which tickets were accepted, and how often each was answered.
    """

    @initialize()
    def start(self) -> None:
        self.run = Run(synchronised=None)
        self.accepted: list[int] = []
        self.written_at: int | None = None  # newest ticket (or None when free running)
        self.in_cell: list[int] = []  # commands that the cell has and has not finished
        self.free_cycle = 0
        self.last_writer: int | None = None  # whose CMD_SEQ is known

    @rule(
        sequence=st.sampled_from([0, 1, 2, 3, 4, 65534, 65535]),
        known=st.booleans(),
        quick=st.booleans(),
        client=st.sampled_from([1, 1, 1, 2]),
        once=st.sampled_from([False, False, True]),
    )
    def write_sequence(self, sequence: int, known: bool, quick: bool, client: int, once: bool) -> None:
        begins = client != self.last_writer and not once
        self.last_writer = client
        changed = sequence != self.run.state.command_sequence or (begins and sequence != 0)
        effects = self.run.tell(hs.SequenceWritten(sequence, known, 0.5 if quick else None, client, once))
        submitted = [effect.ticket for effect in effects if isinstance(effect, hs.Submit)]
        assert len(submitted) <= int(changed and sequence != 0 and known and not begins)
        self.accepted += submitted
        self.in_cell += submitted
        if changed:
            assert not self.run.valid, "an old result survived a new command"
            self.written_at = self.run.state.ticket if sequence else None

    @rule()
    def decline(self) -> None:
        if self.in_cell:
            self.run.tell(hs.Declined(self.in_cell.pop()))

    @rule(verdict=st.sampled_from(Verdict), age_s=st.floats(0, 3), position=st.integers(0, 7))
    def finish(self, verdict: Verdict, age_s: float, position: int) -> None:
        if self.in_cell:
            ticket = self.in_cell.pop(position % len(self.in_cell))
            now_s = self.run.now_s
            self.run.tell(hs.Finished(ticket, 1, verdict, now_s - age_s, f"command {ticket}"))
            if verdict is not Verdict.GOOD or age_s > LIMITS.validity_s:
                assert not (self.run.valid and f"command {ticket}" == self.run.state.result.payload)

    @rule()
    def fail(self) -> None:
        if self.in_cell:
            self.run.tell(hs.Failed(self.in_cell.pop(0)))

    @rule(good=st.booleans())
    def free_cycle_ends(self, good: bool) -> None:
        self.free_cycle += 1
        verdict = Verdict.GOOD if good else Verdict.BAD
        self.run.tell(hs.Finished(None, self.free_cycle, verdict, self.run.now_s, f"cycle {self.free_cycle}"))

    @rule(ticket_back=st.integers(0, 3))
    def stray_event(self, ticket_back: int) -> None:
        """An event of a command that has ended, or never was, must change nothing that counts."""
        stray = self.run.state.ticket - ticket_back
        if stray not in self.in_cell:
            before = len(self.run.effects)
            self.run.tell(hs.Finished(stray, 1, Verdict.GOOD, self.run.now_s, "stray"))
            assert all(effect.reason is Reason.TIMEOUT for effect in self.run.effects[before:])

    @rule(seconds=st.sampled_from([0.0, 0.1, 0.6, 1.1, 2.5, 10.0]))
    def wait(self, seconds: float) -> None:
        self.run.now_s += seconds
        self.run.tell(hs.Tick())

    @rule(current=st.booleans(), other=st.integers(0, 65535))
    def acknowledge(self, current: bool, other: int) -> None:
        result = self.run.state.result
        sequence = result.sequence if current and result is not None else other
        self.run.tell(hs.AckWritten(sequence))
        if result is not None and sequence == result.sequence:
            assert not self.run.valid

    @rule(value=st.integers(0, 3))
    def beat(self, value: int) -> None:
        self.run.tell(hs.HeartbeatWritten(value))

    @rule(client=st.integers(1, 3), leaves=st.booleans(), gone=st.booleans())
    def client(self, client: int, leaves: bool, gone: bool) -> None:
        if leaves:
            self.run.tell(hs.Released(client, gone))
            if gone and self.last_writer == client:
                self.last_writer = None
        elif may_write(self.run.state, client, self.run.now_s):
            self.run.tell(hs.ClaimedBy(client))
            assert not any(may_write(self.run.state, other, self.run.now_s) for other in {1, 2, 3} - {client})

    @invariant()
    def never_valid_with_an_old_sequence(self) -> None:
        if not hasattr(self, "run") or not self.run.valid:
            return
        result = self.run.state.result
        if self.written_at is not None:
            assert f"command {self.written_at}" == result.payload
            assert self.written_at & 0xFFFF == result.sequence == self.run.state.command_sequence
        else:
            assert f"cycle {self.free_cycle}" == result.payload

    @invariant()
    def exactly_one_answer_for_each_accepted_command(self) -> None:
        if not hasattr(self, "run"):
            return
        answers = Counter(e.ticket for e in self.run.effects if isinstance(e, hs.Answered))
        still_open = {command.ticket for command in self.run.state.open}
        assert all(count == 1 for count in answers.values())
        assert len(set(self.accepted)) == len(self.accepted)
        for ticket in self.accepted:
            assert answers[ticket] == (0 if ticket in still_open else 1)
        assert len(still_open) <= LIMITS.queue

    @invariant()
    def the_newest_answer_stays_on_display(self) -> None:
        if not hasattr(self, "run") or self.written_at is None:
            return
        for effect in self.run.effects:
            if isinstance(effect, hs.Answered) and effect.ticket == self.written_at:
                state = self.run.state
                assert (self.written_at & 0xFFFF, effect.answer) == (state.done_sequence, state.answer)


TestAnyClientAnyCell = pytest.mark.slow(AnyClientAnyCell.TestCase)
TestAnyClientAnyCell.settings = settings(
    max_examples=150, stateful_step_count=40, deadline=None, derandomize=True
)
