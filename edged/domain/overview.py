"""What people see first of a cell: what it lacks, its rig, the right to write, and how its jobs were used."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RigFigures:
    """The rig in use. deviations are NaN where they are not known.

    sigma_um : of X, Y, Z of a point where parts were taught, by the calibration alone; None: not known.
    """

    calibration_id: str
    robot: str
    verdict: str
    rows_px: float
    length_percent: float
    sigma_um: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class Overview:
    """What events do not tell.

    missing : "rig", "jobs". plc_owner : who holds the right to write, "" for nobody. auto_lock : the plant
    forbids SETUP. stage : the cameras are virtual, and what stands before them can be moved.
    """

    missing: tuple[str, ...] = ()
    rig: RigFigures | None = None
    plc_owner: str = ""
    auto_lock: bool = False
    stage: bool = False


@dataclass(frozen=True, slots=True)
class Use:
    """Use of a job since the daemon started. last_ns : UTC of its last cycle; 0: none."""

    cycles: int = 0
    good: int = 0
    last_ns: int = 0

    @property
    def good_share(self) -> float | None:
        """None before the first cycle."""
        return self.good / self.cycles if self.cycles else None
