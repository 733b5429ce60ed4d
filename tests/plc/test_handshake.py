"""The handshake, driven by random clients, cells, faults and times."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from edged.plc import handshake as hs
from edged.plc import handshakeevents as ev
from edged.plc.answers import AckState, NackReason, ResultVerdict
from edged.plc.handshake import Handshake, HandshakeLimits, is_valid, may_write, step

LIMITS = HandshakeLimits(validity_s=2.0, heartbeat_s=1.0, owner_s=5.0, queue=8)


class Run:
    """A handshake driven step by step that records every effect."""

    def __init__(self, synchronised: int | None = 0) -> None:
        self.state: Handshake[str] = Handshake(LIMITS, synchronised=synchronised)
        self.now_s = 100.0
        self.effects: list[ev.Effect] = []

    def tell(self, event: ev.Event[str]) -> tuple[ev.Effect, ...]:
        self.state, effects = step(self.state, event, self.now_s)
        self.effects += effects
        return effects

    def good(
        self, ticket: int | None, cycle: int = 1, payload: str = "part", *rest: str, job: int = 0
    ) -> None:
        basis = self.state.basis
        self.tell(ev.Finished(ticket, cycle, ResultVerdict.GOOD, self.now_s, payload, rest, job, basis))

    def next_part(self, sequence: int, client: int = 0, job: int = 0, once: bool = False) -> str:
        """Payload shown by NEXT_PART; "" for a NACK with its own reason. It always ends at once."""
        (answered,) = self.tell(ev.SequenceWritten(sequence, client=client, once=once, next_of=job))
        assert isinstance(answered, ev.Answered) and answered.ticket & 0xFFFF == sequence
        assert () == self.state.open
        if answered.answer is AckState.NACK:
            assert (NackReason.NO_LIST, None) == (answered.reason, self.state.result)
            return ""
        assert self.valid and self.state.exposure_done
        assert (sequence, sequence) == (self.state.result.sequence, self.state.done_sequence)
        return self.state.result.payload

    @property
    def valid(self) -> bool:
        return is_valid(self.state, self.now_s)


def test_a_command_is_answered_and_its_result_is_valid_until_acknowledged() -> None:
    """A written CMD_SEQ invalidates, its result is valid with that number, and ACK_SEQ ends that."""
    run = Run()
    assert (ev.Submit(7),) == run.tell(ev.SequenceWritten(7))
    assert not run.valid
    run.tell(ev.Exposed(7))
    assert run.state.exposure_done
    assert not run.valid
    run.good(7)
    assert run.valid
    assert (7, 7, AckState.ACK) == (run.state.result.sequence, run.state.done_sequence, run.state.answer)
    run.tell(ev.AckWritten(6))
    assert run.valid
    run.tell(ev.AckWritten(7))
    assert not run.valid


def test_the_same_sequence_again_does_not_run_again() -> None:
    """A CMD_SEQ written repeatedly runs once."""
    run = Run()
    run.tell(ev.SequenceWritten(7))
    assert () == run.tell(ev.SequenceWritten(7))


def test_the_first_number_after_the_start_runs_nothing() -> None:
    """The first CMD_SEQ gets NACK 8, so that one written to an earlier daemon does not run, and the next
    runs."""
    run = Run(synchronised=None)
    assert (ev.Answered(7, AckState.NACK, NackReason.BASELINE),) == run.tell(ev.SequenceWritten(7))
    assert (7, 7, NackReason.BASELINE) == (
        run.state.command_sequence,
        run.state.done_sequence,
        run.state.reason,
    )
    assert () == run.tell(ev.SequenceWritten(7))
    assert (ev.Submit(8),) == run.tell(ev.SequenceWritten(8))


def test_zero_is_a_first_number_as_good_as_any() -> None:
    """A first CMD_SEQ of 0 keeps the current result, and the next number runs."""
    run = Run(synchronised=None)
    run.good(None, cycle=3)
    assert () == run.tell(ev.SequenceWritten(0))
    assert run.valid
    assert (ev.Submit(1),) == run.tell(ev.SequenceWritten(1))


def test_a_command_that_is_written_once_on_purpose_needs_no_number_before() -> None:
    """With `once` the first number runs, and repeating it runs nothing."""
    run = Run(synchronised=None)
    assert (ev.Submit(7),) == run.tell(ev.SequenceWritten(7, client=5, once=True))
    assert () == run.tell(ev.SequenceWritten(7, client=5))
    assert (ev.Submit(8),) == run.tell(ev.SequenceWritten(8, client=5))


def test_a_new_connection_and_another_client_begin_with_a_number_that_runs_nothing() -> None:
    """The last client's next number runs; another client's first, or one on a new connection, does not."""
    run = Run()
    assert (ev.Submit(1),) == run.tell(ev.SequenceWritten(1))
    run.good(1)
    run.tell(ev.Released(0))
    assert (ev.Submit(2),) == run.tell(ev.SequenceWritten(2)), "only the right to write was given up"
    run.good(2)
    for event in (ev.SequenceWritten(9, client=4), ev.SequenceWritten(2)):
        (answered,) = run.tell(event)
        assert isinstance(answered, ev.Answered) and answered.reason is NackReason.BASELINE
        assert not run.valid
    run.tell(ev.Released(0, gone=True))
    (answered,) = run.tell(ev.SequenceWritten(3))
    assert isinstance(answered, ev.Answered) and answered.reason is NackReason.BASELINE


def test_a_command_that_had_to_wait_for_its_turn_runs_nothing() -> None:
    """A command written during another client's turn runs nothing afterwards."""
    run = Run()
    run.tell(ev.WriteRejected(3))
    assert (ev.Submit(1),) == run.tell(ev.SequenceWritten(1)), "another client's turn is nothing to this one"
    run.good(1)
    run.tell(ev.WriteRejected(0))
    (answered,) = run.tell(ev.SequenceWritten(2))
    assert isinstance(answered, ev.Answered) and answered.reason is NackReason.BASELINE


def test_a_connection_never_gets_the_answer_of_another_under_its_own_number() -> None:
    """A new connection that writes the number of a departed client sees neither its result nor a late one."""
    done, late = Run(), Run()
    done.tell(ev.SequenceWritten(7))
    done.good(7)
    assert done.valid
    late.tell(ev.SequenceWritten(7))
    for run in (done, late):
        run.tell(ev.Released(0, gone=True))
        run.tell(ev.SequenceWritten(7, client=1))
        run.good(7)
        assert run.state.result is None
        assert (7, AckState.NACK, NackReason.BASELINE) == (
            run.state.done_sequence,
            run.state.answer,
            run.state.reason,
        )


def test_a_late_result_of_an_older_command_with_the_same_number_is_not_shown() -> None:
    """The late result of a timed-out command is not shown for a new one with the same number."""
    run = Run()
    run.tell(ev.SequenceWritten(5, timeout_s=0.5))
    run.now_s += 1.0
    run.tell(ev.SequenceWritten(0))
    run.tell(ev.SequenceWritten(5))
    run.good(5, payload="old")
    assert run.state.result is None
    assert AckState.NONE is run.state.answer
    run.good(5 + 65536, payload="new")
    assert "new" == run.state.result.payload
    assert run.valid


def test_the_sequence_wraps() -> None:
    """After 65535 comes 1, with a new ticket."""
    run = Run()
    run.tell(ev.SequenceWritten(65535))
    run.good(65535)
    assert (ev.Submit(65536 + 1),) == run.tell(ev.SequenceWritten(1))
    run.good(65536 + 1)
    assert run.valid
    assert 1 == run.state.result.sequence


def test_a_ninth_open_command_is_refused_with_overrun_and_the_next_accepted_one_clears_it() -> None:
    """The ninth open command gets QUEUE_FULL with overrun, and no result is valid."""
    run = Run()
    for sequence in range(1, 9):
        run.tell(ev.SequenceWritten(sequence))
    assert (ev.Answered(9, AckState.NACK, NackReason.QUEUE_FULL),) == run.tell(ev.SequenceWritten(9))
    assert run.state.overrun
    for ticket in range(1, 9):
        run.good(ticket)
    assert not run.valid
    run.tell(ev.SequenceWritten(10))
    assert not run.state.overrun
    run.good(10)
    assert run.valid


def test_the_newest_answer_is_not_written_over_by_an_older_command() -> None:
    """If 2 times out while 1 is measured, DONE_SEQ still shows 2 after 1 has ended."""
    run = Run()
    run.tell(ev.SequenceWritten(1))
    run.tell(ev.SequenceWritten(2, timeout_s=0.1))
    run.now_s += 0.2
    run.tell(ev.Tick())
    run.good(1)
    assert (2, AckState.NACK, NackReason.TIMEOUT) == (
        run.state.done_sequence,
        run.state.answer,
        run.state.reason,
    )
    assert {1: AckState.ACK, 2: AckState.NACK} == {
        effect.ticket: effect.answer for effect in run.effects if isinstance(effect, ev.Answered)
    }


def test_an_unknown_or_declined_command_is_a_nack_with_its_reason() -> None:
    """It gives a NACK with its reason and withdraws the displayed result."""
    run = Run()
    run.good(None, cycle=3)
    assert run.valid
    run.tell(ev.SequenceWritten(1, known=False))
    assert (AckState.NACK, NackReason.UNKNOWN_COMMAND) == (run.state.answer, run.state.reason)
    assert not run.valid
    run.tell(ev.SequenceWritten(2))
    assert (ev.Answered(2, AckState.NACK, NackReason.REFUSED),) == run.tell(ev.Declined(2))
    assert () == run.tell(ev.Declined(2))


def test_a_camera_fault_is_a_nack_and_never_valid() -> None:
    """It gives a NACK; the fault is displayed but never valid."""
    run = Run()
    run.tell(ev.SequenceWritten(4))
    run.tell(ev.Finished(4, 1, ResultVerdict.FAULT, run.now_s, "fault"))
    assert (AckState.NACK, NackReason.CAPTURE_FAULT) == (run.state.answer, run.state.reason)
    assert "fault" == run.state.result.payload
    assert not run.valid


def test_age_counts_from_the_exposure() -> None:
    """A result computed in 1.5 s is valid for another 0.5 s, and one from the future never."""
    run = Run()
    run.tell(ev.Finished(None, 1, ResultVerdict.GOOD, run.now_s - 1.5, "slow"))
    assert run.valid
    run.now_s += 0.51
    assert not run.valid
    run.tell(ev.Finished(None, 2, ResultVerdict.GOOD, run.now_s + 0.1, "future"))
    assert not run.valid


def test_a_free_running_cell_shows_the_newest_and_keeps_quiet_while_commanded() -> None:
    """With CMD_SEQ 0 each cycle replaces the last result; otherwise only the command's result counts."""
    run = Run()
    run.good(None, cycle=65535)
    assert 65535 == run.state.result.sequence
    run.good(None, cycle=65536)
    assert 1 == run.state.result.sequence
    run.tell(ev.SequenceWritten(1))
    run.good(None, cycle=65537)
    assert run.state.result is None
    run.good(1, payload="mine")
    run.good(None, cycle=65538)
    assert "mine" == run.state.result.payload
    run.tell(ev.SequenceWritten(0))
    run.good(None, cycle=65539)
    assert 4 == run.state.result.sequence


def test_a_client_whose_heartbeat_stops_loses_its_result_and_its_right_to_write() -> None:
    """A counting heartbeat is supervised, 0 ends that, and silence withdraws the result."""
    run = Run()
    run.tell(ev.ClaimedBy(1))
    run.tell(ev.HeartbeatWritten(1))
    run.good(None)
    run.now_s += 0.9
    run.tell(ev.HeartbeatWritten(2))
    run.now_s += 0.9
    run.tell(ev.Tick())
    assert run.valid
    run.tell(ev.HeartbeatWritten(2))  # an unchanged value is no sign of life
    run.now_s += 0.2
    run.tell(ev.Tick())
    assert run.state.client_lost
    assert not run.valid
    assert may_write(run.state, 2, run.now_s)
    run.tell(ev.HeartbeatWritten(0))
    assert not run.state.client_lost


def test_one_client_writes_at_a_time() -> None:
    """The right to write lapses with time, but not during an open command, and ends with the connection."""
    run = Run()
    run.tell(ev.ClaimedBy(1))
    assert may_write(run.state, 1, run.now_s)
    assert not may_write(run.state, 2, run.now_s)
    run.tell(ev.SequenceWritten(1))
    assert not may_write(run.state, 2, run.now_s + 60)
    run.good(1)
    assert may_write(run.state, 2, run.now_s + 60)
    assert not may_write(run.state, 2, run.now_s)
    run.tell(ev.Released(2))
    assert not may_write(run.state, 2, run.now_s)
    run.tell(ev.Released(1))
    assert may_write(run.state, 2, run.now_s)


def test_one_exposure_gives_part_after_part_each_held_until_it_is_acknowledged() -> None:
    """LOCATE shows the first of three parts, NEXT_PART the others under their own numbers, then none."""
    run = Run()
    run.tell(ev.SequenceWritten(1))
    run.good(1, 1, "a", "b", "c")
    assert 2 == hs.remaining(run.state)
    run.tell(ev.AckWritten(1))
    assert not run.valid
    assert "b" == run.next_part(2)
    assert 1 == hs.remaining(run.state)
    run.tell(ev.AckWritten(1))
    assert run.valid
    assert "c" == run.next_part(3), "whoever asks for the next one has done with this one"
    assert 0 == hs.remaining(run.state)
    assert "" == run.next_part(4)
    assert not run.valid


def test_the_same_number_again_gives_no_other_part() -> None:
    """A repeated NEXT_PART number shows the same part, and a reused one the next part."""
    run = Run()
    run.tell(ev.SequenceWritten(1))
    run.good(1, 1, "a", "b", "c")
    assert "b" == run.next_part(2)
    assert () == run.tell(ev.SequenceWritten(2, next_of=0))
    assert (True, "b", 1) == (run.valid, run.state.result.payload, hs.remaining(run.state))
    assert "c" == run.next_part(1)


def test_a_list_is_as_old_as_its_exposure() -> None:
    """All parts of a list expire together with their exposure."""
    run = Run()
    run.tell(ev.SequenceWritten(1))
    run.good(1, 1, "a", "b", "c")
    run.now_s += 1.9
    assert "b" == run.next_part(2)
    run.now_s += 0.2
    run.tell(ev.Tick())
    assert not run.valid
    assert 0 == hs.remaining(run.state)
    assert "" == run.next_part(3)


OTHERS = {
    "a trigger": ev.SequenceWritten(2),
    "a refused one": ev.SequenceWritten(2, known=False),
    "no command": ev.SequenceWritten(0),
    "another client": ev.SequenceWritten(2, client=5, once=True),
    "another basis": ev.Exchanged(1),
    "another job by somebody else": ev.JobChangedElsewhere(),
    "SETUP": ev.Suspended(),
    "the connection's end": ev.Released(0, gone=True),
}


@pytest.mark.parametrize("what", OTHERS)
def test_whatever_else_happens_ends_the_list(what: str) -> None:
    """Any other command, client, reload, SETUP or disconnection ends the list."""
    run = Run()
    run.tell(ev.SequenceWritten(1))
    run.good(1, 1, "a", "b")
    run.tell(OTHERS[what])
    assert 0 == hs.remaining(run.state)
    run.tell(ev.Resumed())
    run.tell(ev.Finished(2, 2, ResultVerdict.BAD, run.now_s, "bad"))
    assert "" == run.next_part(3, once=True)


def test_a_list_belongs_to_who_asked_for_it_and_to_its_job() -> None:
    """Another connection, a lost client or another job's number gets a NACK, and the list ends."""
    for client, job, given in ((0, 7, "b"), (0, 0, "b"), (0, 8, ""), (4, 7, "")):
        run = Run()
        run.tell(ev.SequenceWritten(1))
        run.good(1, 1, "a", "b", job=7)
        assert given == run.next_part(2, client, job, once=True)
        assert 0 == hs.remaining(run.state)
    run = Run()
    run.tell(ev.HeartbeatWritten(1))
    run.tell(ev.SequenceWritten(1))
    run.good(1, 1, "a", "b")
    run.now_s += 1.1
    assert "" == run.next_part(2)


def test_only_a_good_result_of_the_newest_command_leaves_a_list() -> None:
    """Only a GOOD result of the newest command, in time, leaves a list."""
    for verdict in ResultVerdict:
        run = Run()
        run.tell(ev.SequenceWritten(1))
        run.tell(ev.Finished(1, 1, verdict, run.now_s, "a", ("b",)))
        assert ("b" if verdict is ResultVerdict.GOOD else "") == run.next_part(2)
    run = Run()
    run.good(None, 1, "a", "b")
    assert "" == run.next_part(1)
    run = Run()
    run.tell(ev.SequenceWritten(1, timeout_s=0.1))
    run.now_s += 0.2
    run.good(1, 1, "a", "b")
    assert "" == run.next_part(2)


def test_a_next_part_that_overtakes_its_measurement_gets_none() -> None:
    """The list of a LOCATE that ends after a NEXT_PART is discarded."""
    run = Run()
    run.tell(ev.SequenceWritten(1))
    (answered,) = run.tell(ev.SequenceWritten(2, next_of=0))
    assert ev.Answered(2, AckState.NACK, NackReason.NO_LIST) == answered
    run.good(1, 1, "a", "b")
    assert (0, None) == (hs.remaining(run.state), run.state.result)
    assert "" == run.next_part(3)


def test_setup_ends_what_is_open_and_takes_the_result_down() -> None:
    """Open commands get NACK with SETUP, the newest answer is displayed, and the result is withdrawn."""
    run = Run()
    run.tell(ev.SequenceWritten(1))
    run.good(1)
    assert run.valid
    run.tell(ev.SequenceWritten(2))
    run.tell(ev.SequenceWritten(3))
    run.tell(ev.Exposed(3))
    ended = run.tell(ev.Suspended())
    assert {2: NackReason.SETUP, 3: NackReason.SETUP} == {effect.ticket: effect.reason for effect in ended}
    assert (3, AckState.NACK, NackReason.SETUP) == (
        run.state.done_sequence,
        run.state.answer,
        run.state.reason,
    )
    run.good(3)
    assert (None, (), False) == (run.state.result, run.state.open, run.state.exposure_done)


def test_in_setup_each_command_ends_so_and_free_cycles_are_not_shown() -> None:
    """Every command in SETUP gets NACK with SETUP, and afterwards the next number runs."""
    run = Run(synchronised=None)
    run.tell(ev.Suspended())
    assert () == run.tell(ev.Suspended()), "it is set up already"
    for sequence, known in ((7, True), (8, False), (9, True)):
        (answered,) = run.tell(ev.SequenceWritten(sequence, known))
        assert ev.Answered(sequence, AckState.NACK, NackReason.SETUP) == answered
        assert sequence == run.state.done_sequence
    assert () == run.tell(ev.SequenceWritten(0))
    run.good(None)
    assert run.state.result is None
    run.tell(ev.SequenceWritten(10))
    assert () == run.tell(ev.Resumed())
    assert () == run.tell(ev.SequenceWritten(10)), "a PLC that repeats its number repeats no command"
    assert (ev.Submit(11),) == run.tell(ev.SequenceWritten(11))
    run.good(11)
    assert run.valid


def test_a_result_of_before_is_not_valid_after_setup() -> None:
    """A result from before SETUP is not valid after it."""
    run = Run()
    run.good(None)
    run.tell(ev.Suspended())
    run.tell(ev.Resumed())
    assert not run.valid
    run.good(None, cycle=2)
    assert run.valid


def test_a_robots_registration_runs_in_setup_and_nothing_else_does() -> None:
    """Its commands run without displaying a result, and SETUP by a person ends them."""
    run = Run()
    assert (ev.Submit(1),) == run.tell(ev.SequenceWritten(1, registers=True))
    run.tell(ev.Finished(1, 0, ResultVerdict.DONE, run.now_s, None))
    assert (1, AckState.ACK) == (run.state.done_sequence, run.state.answer)
    run.tell(ev.Suspended(registers=True))
    (refused,) = run.tell(ev.SequenceWritten(2))
    assert ev.Answered(2, AckState.NACK, NackReason.SETUP) == refused
    assert (ev.Submit(3),) == run.tell(ev.SequenceWritten(3, registers=True))
    assert () == run.tell(ev.Suspended(registers=True)), "the same state, told again"
    run.tell(ev.Exposed(3))
    assert run.state.exposure_done
    run.good(3)
    assert (3, AckState.ACK, None) == (run.state.done_sequence, run.state.answer, run.state.result)
    run.tell(ev.SequenceWritten(4, registers=True))
    assert (ev.Answered(4, AckState.NACK, NackReason.SETUP),) == run.tell(ev.Suspended())
    (refused,) = run.tell(ev.SequenceWritten(5, registers=True))
    assert ev.Answered(5, AckState.NACK, NackReason.SETUP) == refused
    run.tell(ev.Resumed())
    assert (ev.Submit(6),) == run.tell(ev.SequenceWritten(6, registers=True))


def test_a_result_is_none_any_more_when_what_it_stands_on_is_exchanged() -> None:
    """The result is withdrawn, its number and answer stay, and the next command runs."""
    run = Run()
    run.tell(ev.SequenceWritten(7))
    run.tell(ev.Exposed(7))
    run.good(7)
    assert run.valid
    assert () == run.tell(ev.Exchanged(1))
    assert not run.valid
    assert not run.state.exposure_done
    assert (7, ResultVerdict.EXCHANGED) == (run.state.result.sequence, run.state.result.verdict)
    assert (7, AckState.ACK) == (run.state.done_sequence, run.state.answer)
    assert (ev.Submit(8),) == run.tell(ev.SequenceWritten(8))
    run.good(8)
    assert run.valid


def test_what_is_said_to_be_exchanged_and_is_not_changes_nothing() -> None:
    """An exchange with the same basis changes nothing."""
    run = Run()
    run.tell(ev.SequenceWritten(7))
    run.good(7)
    run.tell(ev.SequenceWritten(8))
    before = run.state
    assert () == run.tell(ev.Exchanged(0))
    assert before == run.state


def test_a_command_that_waits_while_its_basis_is_exchanged_ends_so() -> None:
    """Each gets NACK with RELOADED, and its late result is not shown."""
    run = Run()
    run.tell(ev.SequenceWritten(7))
    run.tell(ev.SequenceWritten(8))
    ended = run.tell(ev.Exchanged(1))
    assert [(7, NackReason.RELOADED), (8, NackReason.RELOADED)] == [(one.ticket, one.reason) for one in ended]
    assert (8, AckState.NACK, NackReason.RELOADED) == (
        run.state.done_sequence,
        run.state.answer,
        run.state.reason,
    )
    run.good(8)
    assert run.state.result is None


def test_what_was_measured_by_another_basis_is_never_shown() -> None:
    """A command's late result gets NACK with RELOADED, and a free-running one is ignored."""
    run = Run()
    run.tell(ev.Exchanged(1))
    run.tell(ev.Finished(None, 1, ResultVerdict.GOOD, run.now_s, "old", basis=0))
    assert run.state.result is None
    run.tell(ev.SequenceWritten(7))
    (ended,) = run.tell(ev.Finished(7, 1, ResultVerdict.GOOD, run.now_s, "old", basis=0))
    assert (AckState.NACK, NackReason.RELOADED, None) == (ended.answer, ended.reason, run.state.result)


def test_a_registration_ends_by_an_exchange_of_its_own() -> None:
    """Its command gets ACK after the basis has changed."""
    run = Run()
    run.tell(ev.Suspended(registers=True))
    run.tell(ev.SequenceWritten(7, registers=True))
    assert () == run.tell(ev.Exchanged(1))
    run.tell(ev.Finished(7, 0, ResultVerdict.DONE, run.now_s, None, basis=1))
    assert (7, AckState.ACK) == (run.state.done_sequence, run.state.answer)


@pytest.mark.parametrize("fell", ["acknowledged", "too old"])
def test_a_result_that_fell_never_becomes_valid_again(fell: str) -> None:
    """An acknowledged or expired result never becomes valid again."""
    run = Run()
    run.tell(ev.SequenceWritten(7))
    run.good(7)
    if fell == "acknowledged":
        run.tell(ev.AckWritten(7))
        run.tell(ev.AckWritten(0))
    else:
        run.now_s += LIMITS.validity_s + 0.1
        run.tell(ev.Tick())
        run.now_s -= 0.2
    assert not run.valid
    assert not hs.is_as_published(run.state, run.now_s)


def test_another_way_to_take_the_part_on_display_leaves_the_list_as_it_is() -> None:
    """NEXT_GRASP shows the part under its own number with the same age; without another way it is a NACK."""
    run = Run()
    run.tell(ev.SequenceWritten(1))
    run.good(1, 1, "a", "b")
    run.now_s += 1.5
    (answered,) = run.tell(ev.SequenceWritten(2, wants_next_grasp=True, way="a, other"))
    assert ev.Answered(2, AckState.ACK, NackReason.NONE) == answered
    assert (True, 2, "a, other") == (run.valid, run.state.result.sequence, run.state.result.payload)
    assert (100.0, 1, ()) == (run.state.result.exposed_s, hs.remaining(run.state), run.state.open)
    (answered,) = run.tell(ev.SequenceWritten(3, wants_next_grasp=True))
    assert (NackReason.NO_LIST, False, 1) == (answered.reason, run.valid, hs.remaining(run.state))
    assert "b" == run.next_part(4)
    run.tell(ev.AckWritten(4))
    (answered,) = run.tell(ev.SequenceWritten(5, wants_next_grasp=True, way="b, other"))
    assert (NackReason.NO_LIST, None) == (answered.reason, run.state.result), "the robot has it already"


def test_only_who_asked_for_a_part_gets_another_way_to_take_it() -> None:
    """NEXT_GRASP of another connection is a NACK and ends the list."""
    run = Run()
    run.tell(ev.SequenceWritten(1))
    run.good(1, 1, "a", "b")
    (answered,) = run.tell(ev.SequenceWritten(2, client=5, once=True, wants_next_grasp=True, way="a, other"))
    assert (NackReason.NO_LIST, False, 0) == (answered.reason, run.valid, hs.remaining(run.state))


class AnyClientAnyCell(RuleBasedStateMachine):
    """Random clients, cells, faults and times. The payload of a result is the ticket that asked for it.

    The model: which tickets were accepted, and how often each was answered; which parts of
    the newest exposure are still to be given, to whom, until when.
    """

    @initialize()
    def start(self) -> None:
        self.run = Run(synchronised=None)
        self.accepted: list[int] = []
        self.written_at: int | None = None  # newest ticket (or None when free running)
        self.in_cell: list[int] = []  # commands that the cell has and has not finished
        self.free_cycle = 0
        self.last_writer: int | None = None  # whose CMD_SEQ is known
        self.list: list[str] = []  # parts that NEXT_PART can give
        self.list_client, self.list_job, self.list_until_s = 0, 0, 0.0
        self.given: set[str] = set()  # parts that were shown
        self.shown = ""  # the part that is on display, where NEXT_PART showed it
        self.is_set_up = False  # whether a user has the cell in SETUP
        self.is_registering = False  # it is a robot's program
        self.basis = 0  # what results stand on
        self.bases: dict[str, int] = {}  # by payload: what it was measured by
        self.fallen: set[tuple[int, int, str]] = set()  # good results that were seen as not valid any more
        self.registering: list[int] = []  # its commands

    @rule(
        sequence=st.sampled_from([0, 1, 2, 3, 4, 65534, 65535]),
        known=st.booleans(),
        quick=st.booleans(),
        client=st.sampled_from([1, 1, 1, 2]),
        once=st.sampled_from([False, False, True]),
        next_of=st.sampled_from([None, None, 0, 0, 7, 8]),
        registers=st.booleans(),
    )
    def write_sequence(
        self,
        sequence: int,
        known: bool,
        quick: bool,
        client: int,
        once: bool,
        next_of: int | None,
        registers: bool,
    ) -> None:
        registers = registers and known and next_of is None  # no command is both
        refused = self.is_set_up and not (registers and self.is_registering)
        begins = client != self.last_writer and not once
        self.last_writer = client
        changed = sequence != self.run.state.command_sequence or (begins and sequence != 0)
        timeout_s = 0.5 if quick else None
        effects = self.run.tell(
            ev.SequenceWritten(sequence, known, timeout_s, client, once, next_of, registers)
        )
        if changed:
            self.check_next_part(
                effects, sequence, client, next_of, asked=known and not begins and not refused
            )
        if next_of is not None:
            assert not any(isinstance(effect, ev.Submit) for effect in effects), "NEXT_PART made an exposure"
        submitted = [effect.ticket for effect in effects if isinstance(effect, ev.Submit)]
        may_run = changed and sequence != 0 and known and not begins and not refused
        assert len(submitted) <= int(may_run)
        if changed and sequence != 0 and refused:
            assert effects[-1:] == (ev.Answered(self.run.state.ticket, AckState.NACK, NackReason.SETUP),)
        self.accepted += submitted
        self.in_cell += submitted
        self.registering += submitted if registers else []
        if changed:
            assert self.shown or not self.run.valid, "an old result survived a new command"
            self.written_at = self.run.state.ticket if sequence else None

    def check_next_part(
        self, effects: tuple[ev.Effect, ...], sequence: int, client: int, next_of: int | None, *, asked: bool
    ) -> None:
        """The next part goes to its owner only, else there is a NACK; other commands end the list."""
        due, self.shown = self.due(), ""
        if next_of is None or sequence == 0:
            self.list = []
            return
        (answered,) = (
            effect
            for effect in effects
            if isinstance(effect, ev.Answered) and effect.ticket == self.run.state.ticket
        )
        if asked and due and client == self.list_client and next_of in (0, self.list_job):
            assert (AckState.ACK, sequence) == (answered.answer, self.run.state.result.sequence)
            self.shown = self.list.pop(0)
            assert self.shown == self.run.state.result.payload
            assert self.shown not in self.given, "a part was given twice"
            self.given.add(self.shown)
            return
        assert AckState.NACK is answered.answer
        assert not asked or NackReason.NO_LIST is answered.reason
        self.list = []

    @rule(
        sequence=st.sampled_from([0, 1, 2, 3, 4]), client=st.sampled_from([1, 1, 1, 2]), has_one=st.booleans()
    )
    def ask_another_way(self, sequence: int, client: int, has_one: bool) -> None:
        """The displayed part again, for its client only, whose list stays."""
        before, is_heard = self.run.state, client == self.last_writer and not self.is_set_up
        self.last_writer, mine = client, client == self.last_writer
        shown = before.result.payload if before.result is not None and self.run.valid else ""
        way = f"{shown}, taken as {before.ticket}" if has_one else None
        effects = self.run.tell(ev.SequenceWritten(sequence, client=client, wants_next_grasp=True, way=way))
        assert not any(isinstance(effect, ev.Submit) for effect in effects), "NEXT_GRASP made an exposure"
        if sequence == before.command_sequence and (mine or not sequence):
            return
        self.written_at = self.run.state.ticket if sequence else None
        self.list = self.list if sequence and is_heard and client == self.list_client else []
        self.shown = way if way and shown and sequence and is_heard else ""
        assert bool(self.shown) == self.run.valid
        if self.shown:
            self.bases[self.shown] = self.bases[shown]
            assert (self.shown, before.result.exposed_s) == (
                self.run.state.result.payload,
                self.run.state.result.exposed_s,
            )

    def due(self) -> bool:
        """Whether there is a list now."""
        return bool(self.list) and self.run.now_s <= self.list_until_s

    @rule(is_another=st.booleans())
    def exchange(self, is_another: bool) -> None:
        """All open commands end at once, except those of a registration, and nothing earlier is shown."""
        still_open = {command.ticket for command in self.run.state.open}
        if is_another:
            self.basis += 1
        effects = self.run.tell(ev.Exchanged(self.basis))
        ended = {effect.ticket: effect.reason for effect in effects if isinstance(effect, ev.Answered)}
        assert set(ended.values()) <= {NackReason.RELOADED, NackReason.TIMEOUT}
        if is_another:
            assert self.is_registering or still_open == set(ended)
            assert not self.run.valid
            assert self.is_registering or not self.run.state.exposure_done
            self.list, self.shown = [], ""

    @rule()
    def another_job_is_active(self) -> None:
        self.run.tell(ev.JobChangedElsewhere())
        assert not self.run.valid
        self.list, self.shown = [], ""

    @rule()
    def decline(self) -> None:
        if self.in_cell:
            self.run.tell(ev.Declined(self.in_cell.pop()))

    @rule(
        verdict=st.sampled_from([*ResultVerdict, ResultVerdict.GOOD, ResultVerdict.GOOD]),
        age_s=st.sampled_from([0.0, 0.0, 1.0, 3.0]),
        position=st.integers(0, 7),
        parts=st.integers(1, 4),
        before=st.sampled_from([0, 0, 1]),
    )
    def finish(self, verdict: ResultVerdict, age_s: float, position: int, parts: int, before: int) -> None:
        if self.in_cell:
            ticket = self.in_cell.pop(position % len(self.in_cell))
            now_s = self.run.now_s
            rest = tuple(f"command {ticket}, part {number}" for number in range(1, parts))
            payload, basis = f"command {ticket}", self.basis - before
            self.bases |= dict.fromkeys((payload, *rest), basis)
            self.run.tell(ev.Finished(ticket, 1, verdict, now_s - age_s, payload, rest, 7, basis))
            ended = any(
                isinstance(e, ev.Answered) and e == ev.Answered(ticket, AckState.ACK, NackReason.NONE)
                for e in self.run.effects
            )
            if ended and verdict is ResultVerdict.GOOD and ticket == self.written_at and self.last_writer:
                self.list, self.list_client, self.list_job = [*rest], self.last_writer, 7
                self.list_until_s = now_s - age_s + LIMITS.validity_s
            if verdict is not ResultVerdict.GOOD or age_s > LIMITS.validity_s:
                assert not (self.run.valid and f"command {ticket}" == self.run.state.result.payload)

    @rule()
    def fail(self) -> None:
        if self.in_cell:
            self.run.tell(ev.ExecutionFailed(self.in_cell.pop(0)))

    @rule(good=st.booleans(), before=st.sampled_from([0, 0, 1]))
    def free_cycle_ends(self, good: bool, before: int) -> None:
        verdict = ResultVerdict.GOOD if good else ResultVerdict.BAD
        payload, basis = f"cycle {self.free_cycle + 1}", self.basis - before
        self.bases[payload] = basis
        self.run.tell(ev.Finished(None, self.free_cycle + 1, verdict, self.run.now_s, payload, basis=basis))
        self.free_cycle += before == 0

    @rule(ticket_back=st.integers(0, 3))
    def stray_event(self, ticket_back: int) -> None:
        """An event of a command that has ended, or never existed, changes nothing."""
        stray = self.run.state.ticket - ticket_back
        if stray not in self.in_cell:
            before = len(self.run.effects)
            self.run.tell(
                ev.Finished(stray, 1, ResultVerdict.GOOD, self.run.now_s, "stray", basis=self.basis)
            )
            assert all(effect.reason is NackReason.TIMEOUT for effect in self.run.effects[before:])

    @rule(seconds=st.sampled_from([0.0, 0.1, 0.6, 1.1, 2.5, 10.0]))
    def wait(self, seconds: float) -> None:
        self.run.now_s += seconds
        self.run.tell(ev.Tick())

    @rule(current=st.booleans(), other=st.integers(0, 65535))
    def acknowledge(self, current: bool, other: int) -> None:
        result = self.run.state.result
        sequence = result.sequence if current and result is not None else other
        self.run.tell(ev.AckWritten(sequence))
        if result is not None and sequence == result.sequence:
            assert not self.run.valid

    @rule(late=st.booleans(), registers=st.booleans())
    def is_taken_for_setup(self, late: bool, registers: bool) -> None:
        """All open commands end at once, and their late results change nothing.

        Repeated, it changes nothing: a robot's registration continues.
        """
        still_open = {command.ticket for command in self.run.state.open}
        again = self.is_set_up and self.is_registering == registers
        effects = self.run.tell(ev.Suspended(registers))
        ended = {e.ticket: e.reason for e in effects if isinstance(e, ev.Answered)}
        if again:
            assert set(ended.values()) <= {NackReason.TIMEOUT}
            return
        assert still_open == set(ended)
        assert set(ended.values()) <= {NackReason.SETUP, NackReason.TIMEOUT}
        assert self.run.state.result is None
        assert not self.run.state.exposure_done
        self.is_set_up, self.is_registering, self.list = True, registers, []
        if not late:
            self.in_cell = []

    @rule()
    def is_given_back(self) -> None:
        """Nothing becomes valid by that alone, and nothing runs."""
        was_valid = self.run.valid
        assert not any(isinstance(effect, ev.Submit) for effect in self.run.tell(ev.Resumed()))
        assert was_valid or not self.run.valid
        self.is_set_up = self.is_registering = False

    @rule(ticket_back=st.integers(0, 3))
    def exposure(self, ticket_back: int) -> None:
        """An exposure of a command, of none, or of one that has ended."""
        self.run.tell(ev.Exposed(None if ticket_back == 0 else self.run.state.ticket - ticket_back + 1))
        assert not (self.is_set_up and not self.is_registering and self.run.state.exposure_done)

    @rule(value=st.integers(0, 3))
    def beat(self, value: int) -> None:
        self.run.tell(ev.HeartbeatWritten(value))

    @rule(client=st.integers(1, 3), leaves=st.booleans(), gone=st.booleans())
    def client(self, client: int, leaves: bool, gone: bool) -> None:
        if leaves:
            self.run.tell(ev.Released(client, gone))
            if gone and self.last_writer == client:
                self.last_writer = None
            if gone and self.list_client == client:
                self.list = []
        elif may_write(self.run.state, client, self.run.now_s):
            self.run.tell(ev.ClaimedBy(client))
            assert not any(may_write(self.run.state, other, self.run.now_s) for other in {1, 2, 3} - {client})

    @invariant()
    def nothing_is_valid_open_or_shown_while_it_is_set_up(self) -> None:
        """Only commands of a robot's registration may be open, and nothing is shown for those."""
        if hasattr(self, "run") and self.is_set_up:
            state = self.run.state
            assert state.result is None
            assert self.is_registering or ((), False) == (state.open, state.exposure_done)
            assert {command.ticket for command in state.open} <= set(self.registering)
            assert 0 == hs.remaining(state)
            assert not self.run.valid

    @invariant()
    def what_is_valid_stands_on_what_is_there_now(self) -> None:
        if hasattr(self, "run") and self.run.valid:
            assert self.basis == self.bases[self.run.state.result.payload]

    @invariant()
    def what_fell_stays_down(self) -> None:
        """A good result is unchanged while it is valid, and never valid again afterwards."""
        if not hasattr(self, "run"):
            return
        self.run.tell(ev.Tick())
        result = self.run.state.result
        if result is None:
            return
        name = (self.run.state.ticket, result.sequence, result.payload)
        if self.run.valid:
            assert name not in self.fallen
            assert hs.is_as_published(self.run.state, self.run.now_s)
        elif result.verdict in (ResultVerdict.GOOD, ResultVerdict.EXCHANGED):
            self.fallen.add(name)
            assert not hs.is_as_published(self.run.state, self.run.now_s)

    @invariant()
    def never_valid_with_an_old_sequence(self) -> None:
        if not hasattr(self, "run") or not self.run.valid:
            return
        result = self.run.state.result
        if self.written_at is not None:
            assert (self.shown or f"command {self.written_at}") == result.payload
            assert self.written_at & 0xFFFF == result.sequence == self.run.state.command_sequence
        else:
            assert f"cycle {self.free_cycle}" == result.payload

    @invariant()
    def the_list_is_what_is_left_of_one_exposure(self) -> None:
        if hasattr(self, "run"):
            state = self.run.state
            lost = state.client_lost or not self.due()
            self.run.tell(ev.Tick())
            if lost:
                self.list = []
            assert len(self.list) == hs.remaining(self.run.state)

    @invariant()
    def exactly_one_answer_for_each_accepted_command(self) -> None:
        if not hasattr(self, "run"):
            return
        answers = Counter(e.ticket for e in self.run.effects if isinstance(e, ev.Answered))
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
            if isinstance(effect, ev.Answered) and effect.ticket == self.written_at:
                state = self.run.state
                assert (self.written_at & 0xFFFF, effect.answer) == (state.done_sequence, state.answer)


TestAnyClientAnyCell = pytest.mark.slow(AnyClientAnyCell.TestCase)
TestAnyClientAnyCell.settings = settings(max_examples=150, stateful_step_count=40, derandomize=True)


def test_when_a_result_falls_by_time_alone_is_known_beforehand() -> None:
    """A result is valid until just before `valid_until_s`, which a heartbeat may shorten."""
    run = Run()
    assert hs.valid_until_s(run.state, run.now_s) is None
    run.tell(ev.SequenceWritten(7))
    run.good(7)
    fallen_s = hs.valid_until_s(run.state, run.now_s)
    assert run.now_s + LIMITS.validity_s == fallen_s
    assert is_valid(run.state, fallen_s)
    assert not is_valid(run.state, fallen_s + 1e-6)
    run.tell(ev.HeartbeatWritten(1))
    run.now_s += LIMITS.heartbeat_s / 2

    assert min(fallen_s, 100.0 + LIMITS.heartbeat_s) == hs.valid_until_s(run.state, run.now_s)
