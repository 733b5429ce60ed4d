"""Triggers over Zenoh and what answers them."""

from __future__ import annotations

from edged.adapters.zenoh.triggers import Triggers
from edged.domain import CommandKind


def test_each_trigger_is_answered_once_by_its_own_command() -> None:
    """A second answer finds nobody, nor does the command of somebody else."""
    triggers: Triggers[str] = Triggers()
    first = triggers.add("first", CommandKind.LOCATE, 0, None)
    second = triggers.add("second", CommandKind.LOCATE, 0, None)
    assert ["second", "first", None] == [triggers.take(command) for command in (second, first, first)]
    assert None is triggers.take(None)


def test_a_command_of_the_publisher_before_a_reload_answers_nobody() -> None:
    """Both count from 1: an exposure from before the reload is not the answer of the trigger after it."""
    before: Triggers[str] = Triggers()
    old = before.add("old", CommandKind.LOCATE, 0, None)
    after: Triggers[str] = Triggers()
    new = after.add("new", CommandKind.LOCATE, 0, None)
    assert old == new
    assert None is after.take(old)
    assert "new" == after.take(new)
