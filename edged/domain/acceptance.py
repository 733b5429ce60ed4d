"""The last acceptance test of a cell: whether it was passed, and until when it is valid."""

from __future__ import annotations

import enum
from dataclasses import dataclass

NS_PER_DAY = 86_400 * 10**9


class AcceptanceState(enum.IntEnum):
    """Validity of a cell's last acceptance test."""

    NONE = 0
    """There was no test."""
    PASSED = 1
    """Passed, and not yet due again."""
    FAILED = 2
    """Not passed, or incomplete."""
    OVERDUE = 3
    """Passed, but due again."""
    OTHER_RIG = 4
    """The rig has been recalibrated or reregistered since."""
    DAMAGED = 5
    """Its file cannot be read."""


@dataclass(frozen=True, slots=True)
class Acceptance:
    """Summary of an acceptance test. passed : all of its parts. made_ns, due_ns : UTC; 0: there was none.

    wrong : why its result does not count: `OTHER_RIG` or `DAMAGED`; `NONE` if it counts.
    """

    passed: bool = False
    made_ns: int = 0
    due_ns: int = 0
    wrong: AcceptanceState = AcceptanceState.NONE

    def state(self, now_ns: int) -> AcceptanceState:
        """Return its validity at a time, UTC."""
        if self.wrong is not AcceptanceState.NONE or not self.made_ns:
            return self.wrong
        if not self.passed:
            return AcceptanceState.FAILED
        return AcceptanceState.OVERDUE if now_ns > self.due_ns else AcceptanceState.PASSED

    def days_left(self, now_ns: int) -> int:
        """Return the whole days until it is due; negative if overdue."""
        return (self.due_ns - now_ns) // NS_PER_DAY
