"""The result of one check."""

from __future__ import annotations

import enum
from dataclasses import asdict, dataclass


class CheckResult(enum.StrEnum):
    """Outcome of a check."""

    OK = "ok"
    WARN = "warn"
    BAD = "bad"
    SKIP = "skip"


@dataclass(frozen=True, slots=True)
class Check:
    """One finding; consequence and remedy are empty when all is well.

    mend : what the cell's page can do about it when asked: "reload", "secrets", or "address" and a camera's
    serial number; "" where only a person at the machine can.
    """

    name: str
    verdict: CheckResult
    finding: str
    consequence: str = ""
    remedy: str = ""
    mend: str = ""

    def to_json(self) -> dict[str, str]:
        """Plain values."""
        return {key: str(value) for key, value in asdict(self).items()}


def ok(name: str, finding: str) -> Check:
    """All is well."""
    return Check(name, CheckResult.OK, finding)


def skip(name: str, finding: str) -> Check:
    """It could not be looked at."""
    return Check(name, CheckResult.SKIP, finding)


def warn(name: str, finding: str, consequence: str, remedy: str, mend: str = "") -> Check:
    """It may do harm."""
    return Check(name, CheckResult.WARN, finding, consequence, remedy, mend)


def bad(name: str, finding: str, consequence: str, remedy: str, mend: str = "") -> Check:
    """The cell does not work with it."""
    return Check(name, CheckResult.BAD, finding, consequence, remedy, mend)
