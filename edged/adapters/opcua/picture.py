"""What travels from the cell's event loop to the server's thread: immutable, complete, one moment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from edged.domain.events import Snapshot
from edged.payload import encode, message, snapshot_to_json
from edged.plc.registers import Number


@dataclass(frozen=True, slots=True, eq=False)
class ResultRecord:
    """The result on display.

    epoch, sequence : START_EPOCH and SEQ_HEAD. cell, started_ns : as messages over Zenoh say where they come
    from. is_silent : nobody gets numbers of it, as after VERIFY.
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
        """The message as `edged.payload` writes it; "" when there is nothing to say."""
        if self.is_silent:
            return ""
        return encode(message("target", self.cell, self.started_ns, snapshot_to_json(self.snapshot))).decode()


def job_name(epoch: int, sequence: int) -> str:
    """Id of an execution: no other of this cell has it."""
    return f"{epoch}-{sequence}"


@dataclass(frozen=True, slots=True)
class RegisterPicture:
    """All registers at one moment.

    values : by name, those of the status, the command and the result. numbers : by address, all.
    valid_until_s : monotonic clock; from then on no coordinate may be shown. 0: there are none.
    jobs : number and name. result : what is on display and was measured, None when there is nothing.
    """

    values: Mapping[str, Number]
    numbers: Mapping[int, Number]
    valid_until_s: float = 0.0
    jobs: tuple[tuple[int, str], ...] = ()
    result: ResultRecord | None = None
