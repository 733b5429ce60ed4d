"""What every line of the log can say beside its text: which cycle it belongs to, and fields to search for.

`edged.adapters.journal` writes them; nothing here writes. Three things keep the log from being filled:
`FaultLog` says a fault that lasts, or comes and goes, once, and when it is over, how often it happened;
`LogLimit` is for lines that strangers can cause; `RepeatLimit` holds back whatever repeats itself all the
same, also lines of libraries.
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
"""The cycle that the running code works for; inherited by its tasks."""

Fields = Mapping[str, str | int | float]

RELAPSE_S = 60.0
"""A fault that returns within this time is the same one: a loose plug, not a new event."""

REPEATS, REPEATS_S = 10, 10.0
"""So many lines that say the same are written in so long; the rest is counted."""

MAX_REPEATED = 256
"""Messages whose repetitions are counted at a time, so that lines which all differ fill no memory."""


def fields(**values: str | int | float) -> dict[str, Fields]:
    """For `extra=` of a log call; `extra=fields(fault=104)` is found by EDGED_FAULT=104."""
    return {"edged": values}


def fields_of(record: logging.LogRecord) -> dict[str, str | int | float]:
    """The fields of a record, with the cycle it was made in."""
    number = cycle_number.get()
    own: Fields = getattr(record, "edged", {})
    return dict(own) if number is None else {"cycle": number, **own}


class LogLimit:
    """Lets one line through per period and says how many were held back: peers can flood, logs must not."""

    def __init__(
        self, logger: str, period_s: float = 10.0, clock_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._log = logging.getLogger(logger)
        self._period_s = period_s
        self._clock_s = clock_s
        self._next_s = float("-inf")
        self._held = 0

    def warning(self, message: str, *arguments: object) -> None:
        """Log, or count."""
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
    """Lines that say the same since a moment; first : of those held back, what to say of them all."""

    since_s: float
    lines: int = 0
    held: int = 0
    first: Callable[[int], logging.LogRecord] | None = None


class RepeatLimit(logging.Filter):
    """Lets `REPEATS` lines that say the same through per `REPEATS_S`; says how many it held back.

    The same: from the same place in the code, with the same text before its figures are put in. What was held
    back is said with the first line of any kind after that time, or by `tell`. Records of the audit are
    always written: they are compared with the audit's files, which limit how many there are.
    write : where a line goes that says it.
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
        """How many messages are remembered."""
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
        """Say what is held back, before the log is closed."""
        with self._lock:
            past, self._seen = self._seen, {}
        self._tell(past.values())

    def _tell(self, past: Iterable[_Repeated]) -> None:
        for seen in past:
            if seen.first is not None:
                self._write(seen.first(seen.held))


def _place(record: logging.LogRecord) -> tuple[object, ...]:
    """What lines that say the same have in common; for a text that is all figures ("%s"), the whole line."""
    text = str(record.msg)
    text = record.getMessage() if text == "%s" else text
    return (record.name, record.levelno, record.pathname, record.lineno, text.partition("\n")[0])


def _summary(record: logging.LogRecord) -> Callable[[int], logging.LogRecord]:
    """What to say of lines like this one, by their number; keeps neither its traceback nor its arguments."""
    place = (record.name, record.levelno, record.pathname, record.lineno)
    text, function = record.getMessage().partition("\n")[0], record.funcName

    def summary(held: int) -> logging.LogRecord:
        template = "%s (%d more lines like this were held back)"
        return logging.LogRecord(*place, template, (text, held), None, function)

    return summary


@dataclass(slots=True)
class _Outage:
    """From the first failure until all has been well for `RELAPSE_S`.

    seen : code of each fault in it to its first text and how often it happened.
    over_s : since when it is well; None while it is not.
    """

    since_s: float
    seen: dict[int | str, tuple[str, int]] = field(default_factory=dict)
    returns: int = 0
    over_s: float | None = None


class FaultLog:
    """Says each fault once, and once that it is over, with how often it happened.

    A camera that is gone fails in several ways, one after the other: each is said once, and their end is one.
    What returns within `RELAPSE_S` is counted, and said again only when it has stayed away for so long.
    level, kind : of the first line, and the field that has the code in it.
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
        """Something failed; faults are distinguished by their code, because texts hold changing figures."""
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
                **{self._kind: next(iter(outage.seen))},
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
