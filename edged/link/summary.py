"""State of the cell as its page sees it at one moment, in addition to events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from edged.config.chosencameras import ChosenCamera
from edged.domain.arrays import FloatArray, Side
from edged.domain.frames import FramePair
from edged.domain.overview import Overview, Use


@dataclass(frozen=True, slots=True)
class PlcNow:
    """State of the Modbus server. convention : of A, B, C, as in the configuration. refused : addresses."""

    host: str
    port: int
    unit_id: int
    word_order: str
    base_address: int
    convention: str
    connected: int
    owner: str
    refused: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class OpenCamera:
    """Camera that the cell has open. packet_bytes : None if it sends no packets.

    resent, lost : packets since it was opened; None: not counted.
    """

    firmware: str
    packet_bytes: int | None
    resent: int | None
    lost: int | None


@dataclass(frozen=True, slots=True)
class CellSummary:
    """State of a cell that is not contained in events.

    facts : groups of name to value, as the status page shows them. jobs : number and name. holder : of the
    lease, "" without one. is_locked : the plant forbids SETUP. camera_changes : on trial, by side.
    cameras : those that are open.
    uses : use of each job by its number; active_job : number of the active job, 0: none. plc : None without
    a Modbus server.
    """

    overview: Overview = field(default_factory=Overview)
    facts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    jobs: tuple[tuple[int, str], ...] = ()
    holder: str = ""
    is_locked: bool = False
    camera_changes: Mapping[Side, ChosenCamera] = field(default_factory=dict)
    cameras: Mapping[str, OpenCamera] = field(default_factory=dict)
    uses: Mapping[int, Use] = field(default_factory=dict)
    active_job: int = 0
    plc: PlcNow | None = None


@dataclass(frozen=True, slots=True)
class FilesInUse:
    """The files that the cell uses. config : JSON of the configuration. contents : as in a recording.

    lacks : name of the `SetupSource` for what is missing first; "" for a complete cell.
    missing : a line for each file that does not exist.
    """

    config: str
    contents: Mapping[str, bytes]
    fingerprint: str
    lacks: str = ""
    missing: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PageTask:
    """Task of a page process. path : of the configuration.

    addresses : of virtual cameras, left and right; None without. is_staged : the stage is set up, too.
    """

    path: Path
    cell: str
    addresses: tuple[str, str] | None = None
    is_staged: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class ProgramStep:
    """Step of a registration by a robot's program, to show it as a draft on the page.

    step : "begun" with mount, kind, board and limit_mm; "posed" with pair and pose (4, 4); "touched" with
    pair, pose, job and point_mm (3,); or "activated".
    """

    step: str
    mount: str = ""
    kind: str = ""
    board: str = ""
    limit_mm: float = 0.0
    pair: FramePair | None = None
    pose: FloatArray | None = None
    job: str = ""
    point_mm: FloatArray | None = None
