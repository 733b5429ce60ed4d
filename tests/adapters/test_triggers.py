"""Triggers over Zenoh and their answers."""

from __future__ import annotations

from pathlib import Path

import pytest
import zenoh

from edged.adapters.zenoh.triggers import MAX_TIMEOUT_S, PendingTriggers, parse_trigger
from edged.config.reading import load
from edged.domain.events import CommandKind
from edged.errors import CommandRefused, ConfigError


def test_each_trigger_is_answered_once_by_its_own_command() -> None:
    """Each trigger is answered once, by its own command."""
    triggers: PendingTriggers[str] = PendingTriggers()
    first = triggers.add("first", CommandKind.LOCATE, 0, None)
    second = triggers.add("second", CommandKind.LOCATE, 0, None)
    assert ["second", "first", None] == [triggers.take(command) for command in (second, first, first)]
    assert None is triggers.take(None)


def test_a_command_of_the_publisher_before_a_reload_answers_nobody() -> None:
    """A command from before a reload does not answer an equal one after it."""
    before: PendingTriggers[str] = PendingTriggers()
    old = before.add("old", CommandKind.LOCATE, 0, None)
    after: PendingTriggers[str] = PendingTriggers()
    new = after.add("new", CommandKind.LOCATE, 0, None)
    assert old == new
    assert None is after.take(old)
    assert "new" == after.take(new)


def test_the_longest_wait_that_may_be_configured_is_accepted(tmp_path: Path) -> None:
    """The longest configurable time-out is accepted by a trigger; a longer one is refused in the
    configuration."""
    text = (
        '[cell]\nname = "c"\nrig = "r"\njobs = "j"\njob = "f"\n'
        '[cameras]\nsource = "virtual"\n[zenoh]\ntrigger_timeout_s = '
    )
    path = tmp_path / "cell.toml"
    path.write_text(f"{text}{MAX_TIMEOUT_S}")
    longest_s = load(path).zenoh.trigger_timeout_s
    assert MAX_TIMEOUT_S == parse_trigger(zenoh.Parameters(""), longest_s).timeout_s
    path.write_text(f"{text}{MAX_TIMEOUT_S + 0.1}")
    with pytest.raises(ConfigError, match="trigger_timeout_s"):
        load(path)


def test_a_trigger_may_ask_for_all_jobs_and_never_for_the_next_part() -> None:
    """A trigger may ask for all jobs, but not for the next part."""
    asked = parse_trigger(zenoh.Parameters("job=all"), 5.0)
    assert (0, True) == (asked.job, asked.tries_all)
    assert not parse_trigger(zenoh.Parameters("job=7"), 5.0).tries_all
    for parameters, message in (
        ("job=every", "or all, got 'every'"),
        ("kind=next_part", "kind: expected one of"),
    ):
        with pytest.raises(CommandRefused, match=message):
            parse_trigger(zenoh.Parameters(parameters), 5.0)
