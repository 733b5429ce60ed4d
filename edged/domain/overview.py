"""Overview of a cell for people: what it lacks, its rig, the right to write, and the use of its jobs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RigFigures:
    """The rig in use. rows_px, length_percent : NaN if unknown.

    sigma_um : of X, Y, Z at the taught parts, due to the calibration alone; None: unknown.
    """

    calibration_id: str
    robot: str
    verdict: str
    rows_px: float
    length_percent: float
    sigma_um: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class Overview:
    """State of a cell that no event carries.

    missing : "rig", "jobs". plc_owner : client with the right to write, "" for none. auto_lock : the plant
    forbids SETUP. stage : the cameras are virtual, and the scene before them can be changed.
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
        """Share of good cycles; None before the first cycle."""
        return self.good / self.cycles if self.cycles else None
