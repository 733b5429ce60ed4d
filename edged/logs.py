"""What every line of the log can say beside its text: which cycle it belongs to, and fields to search for.

`edged.adapters.journal` writes them; nothing here writes. `FaultLog` keeps a fault that lasts, or comes
and goes, from filling the log: it is said once, and when it is over, how often it happened.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field

from edged.domain import Snapshot

cycle_number: ContextVar[int | None] = ContextVar("cycle_number", default=None)
"""The cycle that the running code works for; inherited by its tasks."""

Fields = Mapping[str, str | int | float]

RELAPSE_S = 60.0
"""A fault that returns within this time is the same one: a loose plug, not a new event."""


def fields(**values: str | int | float) -> dict[str, Fields]:
    """For `extra=` of a log call; `extra=fields(fault=104)` is found by EDGED_FAULT=104."""
    return {"edged": values}


def fields_of(record: logging.LogRecord) -> dict[str, str | int | float]:
    """The fields of a record, with the cycle it was made in."""
    number = cycle_number.get()
    own: Fields = getattr(record, "edged", {})
    return dict(own) if number is None else {"cycle": number, **own}


@dataclass(slots=True)
class _Outage:
    """From the first failure until all has been well for `RELAPSE_S`.

    seen : code of each fault in it to its first text and how often it happened.
    over_s : since when it is well; None while it is not.
    """

    since_s: float
    seen: dict[int, tuple[str, int]] = field(default_factory=dict)
    returns: int = 0
    over_s: float | None = None


class FaultLog:
    """Says each fault once, and once that it is over, with how often it happened.

    A camera that is gone fails in several ways, one after the other: each is said once, and their end is one.
    What returns within `RELAPSE_S` is counted, and said again only when it has stayed away for so long.
    """

    def __init__(self, log: logging.Logger, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._log = log
        self._monotonic_s = monotonic_s
        self._outage: _Outage | None = None

    def failed(self, text: str, code: int) -> None:
        """Something failed; faults are told apart by their code, because texts hold changing figures."""
        if self._outage is None:
            self._outage = _Outage(self._monotonic_s())
        outage = self._outage
        if outage.over_s is not None:
            outage.returns += 1
            outage.over_s = None
        if code not in outage.seen:
            self._log.error("%s", text, extra=fields(fault=code))
        first_text, count = outage.seen.get(code, (text, 0))
        outage.seen[code] = (first_text, count + 1)

    def well(self) -> None:
        """It works."""
        outage, now_s = self._outage, self._monotonic_s()
        if outage is None:
            return
        if outage.over_s is None:
            outage.over_s = now_s
            if not outage.returns:
                self._tell(outage, now_s)
        elif now_s - outage.over_s > RELAPSE_S:
            self._outage = None
            if outage.returns:
                self._tell(outage, outage.over_s)

    def _tell(self, outage: _Outage, over_s: float) -> None:
        lasted_s = over_s - outage.since_s
        counts = "; ".join(f"{count} x {text}" for text, count in outage.seen.values())
        relapses = f"; {outage.returns} relapse{'s' if outage.returns > 1 else ''} in {lasted_s:.1f} s"
        self._log.info(
            "recovered%s: %s",
            relapses if outage.returns else f" after {lasted_s:.1f} s",
            counts,
            extra=fields(
                fault=next(iter(outage.seen)),
                failures=sum(count for _, count in outage.seen.values()),
                returns=outage.returns,
                lasted_s=round(lasted_s, 3),
            ),
        )


class FaultMemory:
    """Tells faults that are news from known ones: evidence of the first must outlive the thousandth."""

    def __init__(self, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._monotonic_s = monotonic_s
        self._seen_s: dict[tuple[int, str], float] = {}

    def is_news(self, snapshot: Snapshot) -> bool:
        """False for a fault that was seen within `RELAPSE_S`; its text may hold other figures."""
        if not snapshot.error:
            return True
        # a text begins with the camera that it is about
        fault, now_s = (snapshot.error_code, snapshot.error.partition(":")[0]), self._monotonic_s()
        before_s, self._seen_s[fault] = self._seen_s.get(fault, -math.inf), now_s
        return now_s - before_s > RELAPSE_S
