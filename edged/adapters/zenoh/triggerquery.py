"""Parameters of a trigger's query, checked as untrusted input."""

from __future__ import annotations

import math
from typing import NamedTuple

import zenoh

from edged.adapters.zenoh.keys import TRIGGER_PARAMETERS
from edged.domain.arrays import FloatArray
from edged.domain.events import CommandKind
from edged.domain.numerals import decimal, whole
from edged.errors import CommandRefused
from edged.robot.orientations import Brand, transform_of

MAX_TIMEOUT_S = 60.0


class Trigger(NamedTuple):
    """A command, and how long its result is waited for. job : number, 0 for the active one.

    tries_all : every job, instead.
    robot_from_flange (4, 4) : None where it was not said; shown : its numbers.
    """

    kind: CommandKind
    job: int
    timeout_s: float
    robot_from_flange: FloatArray | None
    tries_all: bool = False
    shown: tuple[float, ...] = ()


def parse_trigger(parameters: zenoh.Parameters, default_timeout_s: float) -> Trigger:
    """The trigger of a query's parameters. Raises `CommandRefused` that says what was expected."""
    known = {name: default for name, (default, _) in TRIGGER_PARAMETERS.items()}
    known["timeout_s"] = str(default_timeout_s)
    for name, value in parameters:  # type: ignore[attr-defined]  # its stub returns a list
        if name not in known:
            raise CommandRefused(f"unknown parameter {name[:40]!r}, expected {', '.join(known)}")
        known[name] = value
    # one answer holds every part: there is no next one to ask for
    kinds = {kind.name.lower(): kind for kind in CommandKind if kind is not CommandKind.NEXT_PART}
    kind = kinds.get(known["kind"].lower())
    if kind is None:
        raise CommandRefused(f"kind: expected one of {', '.join(kinds)}, got {known['kind'][:40]!r}")
    tries_all = known["job"] == "all"
    if tries_all:
        known["job"] = "0"
    try:
        job = whole(known["job"])
    except ValueError:
        job = -1
    if not 0 <= job <= 65535:
        raise CommandRefused(f"job: expected a number from 0 to 65535, or all, got {known['job'][:40]!r}")
    try:
        timeout_s = decimal(known["timeout_s"])
    except ValueError:
        timeout_s = math.nan
    if not 0 < timeout_s <= MAX_TIMEOUT_S:
        raise CommandRefused(
            f"timeout_s: expected seconds up to {MAX_TIMEOUT_S:g}, got {known['timeout_s'][:40]!r}"
        )
    flange, shown = _parse_flange(known["flange"])
    return Trigger(kind, job, timeout_s, flange, tries_all, shown)


def _parse_flange(text: str) -> tuple[FloatArray | None, tuple[float, ...]]:
    """robot_from_flange (4, 4) of position in mm and quaternion, scalar first, and these numbers."""
    if not text:
        return None, ()
    try:
        shown = tuple(decimal(part.strip(" ")) for part in text[:400].split(","))
        return transform_of(Brand.ABB, shown), shown
    except ValueError as error:
        raise CommandRefused(f"flange: {error}") from None
