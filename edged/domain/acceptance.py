"""The last acceptance test of a cell: whether it was passed, and until when that counts."""

from __future__ import annotations

import enum
from dataclasses import dataclass

NS_PER_DAY = 86_400 * 10**9


class AcceptanceState(enum.IntEnum):
    """What the last acceptance test of a cell says today."""

    NONE = 0
    """There was none."""
    PASSED = 1
    """Passed, and not due again."""
    FAILED = 2
    """Not passed, or not whole."""
    OVERDUE = 3
    """Passed, and its date is over."""
    OTHER_RIG = 4
    """The rig was calibrated or registered anew since."""
    DAMAGED = 5
    """Its file cannot be read."""


@dataclass(frozen=True, slots=True)
class Acceptance:
    """What is kept of one. passed : all of its tests. made_ns, due_ns : UTC; 0: there was none.

    wrong : why it says nothing, whatever it found: `OTHER_RIG`, `DAMAGED`, or `NONE`.
    """

    passed: bool = False
    made_ns: int = 0
    due_ns: int = 0
    wrong: AcceptanceState = AcceptanceState.NONE

    def state(self, now_ns: int) -> AcceptanceState:
        """What it says at a time, UTC."""
        if self.wrong is not AcceptanceState.NONE or not self.made_ns:
            return self.wrong
        if not self.passed:
            return AcceptanceState.FAILED
        return AcceptanceState.OVERDUE if now_ns > self.due_ns else AcceptanceState.PASSED

    def days_left(self, now_ns: int) -> int:
        """Whole days until it is due; negative ones since."""
        return (self.due_ns - now_ns) // NS_PER_DAY
