"""Every error, fault, status and reason, with its number where it has one."""

from __future__ import annotations

from collections.abc import Iterator

from edged.domain.cell import CalibrationHealth
from edged.domain.measurement import Status
from edged.errors import CaptureError, EdgedError
from referencepages.markdown import code, first_line, member_docs, table
from referencepages.registers import rejects


def subclasses(kind: type[EdgedError], depth: int = 0) -> Iterator[tuple[type[EdgedError], int]]:
    """The tree of exceptions, with the depth of each; only those of `edged.errors`."""
    yield kind, depth
    for special in kind.__subclasses__():
        if special.__module__ == kind.__module__:
            yield from subclasses(special, depth + 1)


def tree() -> str:
    """The exceptions as a nested list."""
    return "\n".join(
        f"{'    ' * depth}- {code(kind.__name__)}{_number(kind)}: {_small(first_line(kind))}"
        for kind, depth in subclasses(EdgedError)
    )


def _number(kind: type[EdgedError]) -> str:
    return f" ({kind.code})" if issubclass(kind, CaptureError) else ""


def _small(sentence: str) -> str:
    return sentence[:1].lower() + sentence[1:]


def faults() -> str:
    """Faults of the cameras by number."""
    found = sorted(
        (kind.code, kind) for kind, _ in subclasses(CaptureError) if issubclass(kind, CaptureError)
    )
    return table(
        ("code", "exception", "meaning"), ((n, code(k.__name__), first_line(k)) for n, k in found), numbers=1
    )


def statuses() -> str:
    """How a cycle may end, by status."""
    docs = member_docs(Status)
    return table(("status", "meaning"), ((code(one.value), docs[one.name]) for one in Status))


def calibration() -> str:
    """Verdicts on the calibration."""
    docs = member_docs(CalibrationHealth)
    return table(
        ("value", "name", "meaning"),
        ((one.value, code(one.name), docs[one.name]) for one in CalibrationHealth),
        numbers=1,
    )


PARTS = {"tree": tree, "faults": faults, "statuses": statuses, "rejects": rejects, "calibration": calibration}
