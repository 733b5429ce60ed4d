"""Immutable copies of the registers, passed from the cell's event loop to the server's thread."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from edged.domain.events import Snapshot
from edged.payload import encode, message, snapshot_to_json
from edged.plc.registers import Number


@dataclass(frozen=True, slots=True, eq=False)
class ResultRecord:
    """The result on display.

    epoch, sequence : START_EPOCH and SEQ_HEAD. cell, started_ns : origin, as in Zenoh messages.
    is_silent : has no content, as after VERIFY.
    """

    epoch: int
    sequence: int
    snapshot: Snapshot
    cell: str
    started_ns: int
    is_silent: bool

    @property
    def name(self) -> str:
        """Id of the result and of its execution, called "job" in the specification."""
        return job_name(self.epoch, self.sequence)

    def content(self) -> str:
        """The message in the format of `edged.payload`; "" if silent."""
        if self.is_silent:
            return ""
        return encode(message("target", self.cell, self.started_ns, snapshot_to_json(self.snapshot))).decode()


def job_name(epoch: int, sequence: int) -> str:
    """Unique id of an execution."""
    return f"{epoch}-{sequence}"


@dataclass(frozen=True, slots=True)
class RegisterPicture:
    """All registers at one moment.

    values : registers of the status, command and result blocks, by name. numbers : all registers, by address.
    valid_until_s : monotonic clock; from then on no coordinate may be shown. 0: there are no coordinates.
    jobs : number and name. result : on display, None without one.
    called : sequence number of the last command that came by a method.
    """

    values: Mapping[str, Number]
    numbers: Mapping[int, Number]
    valid_until_s: float = 0.0
    jobs: tuple[tuple[int, str], ...] = ()
    result: ResultRecord | None = None
    called: int = 0
