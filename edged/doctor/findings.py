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
    """One finding; consequence and remedy are empty if all is well.

    mend : fix that the cell's page can apply on request: "reload", "secrets", or "address" and a camera's
    serial number; "" if only a person at the machine can fix it.
    """

    name: str
    verdict: CheckResult
    finding: str
    consequence: str = ""
    remedy: str = ""
    mend: str = ""

    def to_json(self) -> dict[str, str]:
        """Return all fields as text."""
        return {key: str(value) for key, value in asdict(self).items()}


def ok(name: str, finding: str) -> Check:
    """Return a check with a good result."""
    return Check(name, CheckResult.OK, finding)


def skip(name: str, finding: str) -> Check:
    """Return a check that could not be made."""
    return Check(name, CheckResult.SKIP, finding)


def warn(name: str, finding: str, consequence: str, remedy: str, mend: str = "") -> Check:
    """Return a check whose finding may cause trouble."""
    return Check(name, CheckResult.WARN, finding, consequence, remedy, mend)


def bad(name: str, finding: str, consequence: str, remedy: str, mend: str = "") -> Check:
    """Return a check whose finding stops the cell from working."""
    return Check(name, CheckResult.BAD, finding, consequence, remedy, mend)
