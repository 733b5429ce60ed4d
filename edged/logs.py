"""Structured fields of log lines, such as the cycle they belong to, and limits on repeated lines.

`edged.adapters.journal` writes them; nothing here writes. Three classes keep the log from being flooded:
`FaultLog` logs a fault that lasts, or comes and goes, once, and when it is over, how often it happened;
`LogLimit` is for lines that strangers can cause; `RepeatLimit` suppresses all other repetition, including
that of libraries.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field

from edged.domain.events import Snapshot

cycle_number: ContextVar[int | None] = ContextVar("cycle_number", default=None)
"""Number of the cycle that the running code works for; inherited by its tasks."""

Fields = Mapping[str, str | int | float]

RELAPSE_S = 60.0
"""A fault that returns within this time counts as the same one: a loose plug, not a new event."""

REPEATS, REPEATS_S = 10, 10.0
"""Maximum number of equal lines written in this time; the rest is counted."""

MAX_REPEATED = 256
"""Maximum number of messages whose repetitions are counted, so that ever different lines fill no memory."""


def fields(**values: str | int | float) -> dict[str, Fields]:
    """Fields for `extra=` of a log call; `extra=fields(fault=104)` is found by EDGED_FAULT=104."""
    return {"edged": values}


def fields_of(record: logging.LogRecord) -> dict[str, str | int | float]:
    """Fields of a record, with the current cycle."""
    number = cycle_number.get()
    own: Fields = getattr(record, "edged", {})
    return dict(own) if number is None else {"cycle": number, **own}


class LogLimit:
    """Lets one line through per period, with the number held back: peers may flood, but not the log."""

    def __init__(
        self, logger: str, period_s: float = 10.0, clock_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._log = logging.getLogger(logger)
        self._period_s = period_s
        self._clock_s = clock_s
        self._next_s = float("-inf")
        self._held = 0

    def warning(self, message: str, *arguments: object) -> None:
        """Log a warning, or count it."""
        self._tell(logging.WARNING, message, arguments, None)

    def error(self, message: str, *arguments: object, exc_info: BaseException | bool) -> None:
        """Log an error with its traceback, or count it."""
        self._tell(logging.ERROR, message, arguments, exc_info)

    def _tell(
        self, level: int, message: str, arguments: tuple[object, ...], exc_info: BaseException | bool | None
    ) -> None:
        now_s = self._clock_s()
        if now_s < self._next_s:
            self._held += 1
            return
        held = f" ({self._held} more lines like this were held back)" if self._held else ""
        self._log.log(level, message + held, *arguments, exc_info=exc_info, stacklevel=3)
        self._next_s, self._held = now_s + self._period_s, 0


@dataclass(slots=True)
class _Repeated:
    """Equal lines since a time. first : from the first one held back, makes the record to sum them up."""

    since_s: float
    lines: int = 0
    held: int = 0
    first: Callable[[int], logging.LogRecord] | None = None


class RepeatLimit(logging.Filter):
    """Lets `REPEATS` equal lines through per `REPEATS_S`, and logs how many it held back.

    Lines are equal if they come from the same place in the code and have the same text before its arguments
    are filled in. The number held back is logged with the first line of any kind after that time, or by
    `tell`. Records of the audit are always written: they are compared with the audit's files, which limit how
    many there are. write : writes the line with the number.
    """

    def __init__(
        self, write: Callable[[logging.LogRecord], None], clock_s: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__()
        self._write = write
        self._clock_s = clock_s
        self._seen: dict[tuple[object, ...], _Repeated] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        """Number of messages that are remembered."""
        return len(self._seen)

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to write a line."""
        if "audit" in getattr(record, "edged", {}):
            return True
        now_s = self._clock_s()
        with self._lock:
            past = {key: seen for key, seen in self._seen.items() if now_s - seen.since_s >= REPEATS_S}
            while len(self._seen) - len(past) >= MAX_REPEATED:
                key = next(key for key in self._seen if key not in past)
                past[key] = self._seen[key]
            for key in past:
                del self._seen[key]
            seen = self._seen.setdefault(_place(record), _Repeated(now_s))
            seen.lines += 1
            held = seen.lines > REPEATS
            seen.held += held
            if held and seen.first is None:
                seen.first = _summary(record)
        self._tell(past.values())
        return not held

    def tell(self) -> None:
        """Log how many lines are held back, before the log is closed."""
        with self._lock:
            past, self._seen = self._seen, {}
        self._tell(past.values())

    def _tell(self, past: Iterable[_Repeated]) -> None:
        for seen in past:
            if seen.first is not None:
                self._write(seen.first(seen.held))


def _place(record: logging.LogRecord) -> tuple[object, ...]:
    """Key that equal lines have in common; for a format that is only an argument ("%s"), the whole line."""
    text = str(record.msg)
    text = record.getMessage() if text == "%s" else text
    return (record.name, record.levelno, record.pathname, record.lineno, text.partition("\n")[0])


def _summary(record: logging.LogRecord) -> Callable[[int], logging.LogRecord]:
    """Maker of the record for a number of held lines like this one; keeps neither traceback nor arguments."""
    place = (record.name, record.levelno, record.pathname, record.lineno)
    text, function = record.getMessage().partition("\n")[0], record.funcName

    def summary(held: int) -> logging.LogRecord:
        template = "%s (%d more lines like this were held back)"
        return logging.LogRecord(*place, template, (text, held), None, function)

    return summary


@dataclass(slots=True)
class _Outage:
    """Outage, from the first failure until all has been well for `RELAPSE_S`.

    seen : for the code of each fault, its first text and how often it happened.
    over_s : time since which all is well; None while it is not.
    """

    since_s: float
    seen: dict[int | str, tuple[str, int]] = field(default_factory=dict)
    returns: int = 0
    over_s: float | None = None


class FaultLog:
    """Logs each fault once, and once that it is over, with how often it happened.

    A camera that is gone fails in several ways, one after the other: each is logged once, and their end once.
    A fault that returns within `RELAPSE_S` is only counted; it is logged again after it was away for longer.
    level : of the first line. kind : name of the field with the code.
    """

    def __init__(
        self,
        log: logging.Logger,
        monotonic_s: Callable[[], float] = time.monotonic,
        *,
        level: int = logging.ERROR,
        kind: str = "fault",
    ) -> None:
        self._log = log
        self._monotonic_s = monotonic_s
        self._level = level
        self._kind = kind
        self._outage: _Outage | None = None

    def failed(self, text: str, code: int | str) -> None:
        """Report a failure; faults are distinguished by code, because texts contain changing figures."""
        if self._outage is None:
            self._outage = _Outage(self._monotonic_s())
        outage = self._outage
        if outage.over_s is not None:
            outage.returns += 1
            outage.over_s = None
        if code not in outage.seen:
            self._log.log(self._level, "%s", text, extra=fields(**{self._kind: code}))
        first_text, count = outage.seen.get(code, (text, 0))
        outage.seen[code] = (first_text, count + 1)

    def well(self) -> None:
        """Report that it works."""
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
                **{self._kind: next(iter(outage.seen))},
                failures=sum(count for _, count in outage.seen.values()),
                returns=outage.returns,
                lasted_s=round(lasted_s, 3),
            ),
        )


class FaultMemory:
    """Tells new faults from known ones: evidence of the first must outlive the thousandth."""

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
