"""Immutable copies of the registers, from the cell's event loop to the server's thread."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from edged.domain.events import Snapshot
from edged.payload import encode, message, snapshot_to_json
from edged.plc.registers import Number


@dataclass(frozen=True, slots=True, eq=False)
class ResultRecord:
    """The result on display.

    epoch, sequence : START_EPOCH and SEQ_HEAD. cell, started_ns : origin, as in messages over Zenoh.
    is_silent : without numbers, as after VERIFY.
    """

    epoch: int
    sequence: int
    snapshot: Snapshot
    cell: str
    started_ns: int
    is_silent: bool

    @property
    def name(self) -> str:
        """Id of the result, and of the job that it belongs to."""
        return job_name(self.epoch, self.sequence)

    def content(self) -> str:
        """The message as `edged.payload` writes it; "" if silent."""
        if self.is_silent:
            return ""
        return encode(message("target", self.cell, self.started_ns, snapshot_to_json(self.snapshot))).decode()


def job_name(epoch: int, sequence: int) -> str:
    """Unique id of an execution."""
    return f"{epoch}-{sequence}"


@dataclass(frozen=True, slots=True)
class RegisterPicture:
    """All registers at one moment.

    values : by name, those of the status, the command and the result. numbers : by address, all.
    valid_until_s : monotonic clock; from then on no coordinate may be shown. 0: without coordinates.
    jobs : number and name. result : on display, None without one.
    called : sequence of the last command that came by a method.
    """

    values: Mapping[str, Number]
    numbers: Mapping[int, Number]
    valid_until_s: float = 0.0
    jobs: tuple[tuple[int, str], ...] = ()
    result: ResultRecord | None = None
    called: int = 0
