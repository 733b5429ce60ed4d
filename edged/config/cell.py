"""Sections for what is measured and when, where the robot may go, and what is recorded."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from edged.config.fields import FilePath, Name, Section
from edged.domain.belt import Belt
from edged.domain.picking import Bounds, Box, Gripper
from edged.errors import CalibrationError
from edged.vision.boards.board import NominalBoard, parse_boards


class CellSection(Section):
    """The cell: what it measures, and with which rig."""

    name: Name = Field(description="name of the cell; part of every Zenoh key")
    rig: FilePath = Field(description="calibrated rig, written by `edged calibrate`")
    jobs: FilePath = Field(description="folder with one folder for each taught job")
    job: Name | None = Field(
        None, description="the job that is active after start; left out: the one with the lowest number"
    )


class CycleSection(Section):
    """When the cell measures."""

    mode: Literal["free", "command", "external"] = Field(
        "command",
        description='"free": every period; "command": when asked over Modbus or Zenoh; '
        '"external": each exposure that somebody else triggers',
    )
    period_s: float = Field(0.5, ge=0.0, le=3600, description="time from trigger to trigger in free mode")
    idle_s: float | None = Field(
        None,
        ge=0.05,
        le=1,
        description='"command": while nothing is asked, an exposure so often that is thrown away: a sensor '
        "that is read at a steady pace keeps its temperature; a command may wait for it; left out: none",
    )

    @model_validator(mode="after")
    def _belongs(self) -> CycleSection:
        if self.idle_s is not None and self.mode != "command":
            raise ValueError(f'idle_s: only with mode "command", not {self.mode!r}')
        return self


class DriftSection(Section):
    """Limits beyond which the calibration counts as drifting, or results are refused (means over cycles)."""

    warn_rows_px: float = Field(0.5, gt=0, le=100, description="row difference of corresponding points, rms")
    invalid_rows_px: float = Field(1.0, gt=0, le=100, description="the same: beyond it results are refused")
    warn_length_percent: float = Field(
        0.1, gt=0, le=100, description="deviation of the job's witness, a size that is known"
    )
    invalid_length_percent: float = Field(
        0.3, gt=0, le=100, description="the same: beyond it results are refused"
    )
    min_cycles: int = Field(20, ge=2, le=100_000, description="before any verdict")

    @model_validator(mode="after")
    def _ordered(self) -> DriftSection:
        for what in ("rows_px", "length_percent"):
            warn, invalid = getattr(self, f"warn_{what}"), getattr(self, f"invalid_{what}")
            if warn > invalid:
                raise ValueError(f"warn_{what} {warn:g} is beyond invalid_{what} {invalid:g}")
        return self


class MarksSection(Section):
    """Reference marks around the pick area (`edged marks teach`). Has no effect until marks are taught."""

    on_knock: Literal["heal", "refuse"] = Field(
        "heal",
        description='after a knock of a camera, the rig or the plate: "heal": results come again when the '
        'marks agree on where the cameras are; "refuse": not before the marks are taught anew',
    )
    material: Literal["steel", "aluminium", "invar", "ceramic", "glass"] = Field(
        "steel", description="what the marks are on: how much it grows with the temperature is in sigma"
    )
    range_k: float = Field(
        10.0, gt=0, le=100, description="how far, in kelvin, temperatures differ from those of the teaching"
    )


Corner = Annotated[list[Annotated[float, Field(ge=-100_000, le=100_000)]], Field(min_length=3, max_length=3)]


class ZoneSection(Section):
    """Box in which a part must lie, or keep-out zone; in the robot's frame, or the rig's without a robot."""

    name: Name = Field(description="for people")
    min_mm: Corner = Field(description="least x, y, z")
    max_mm: Corner = Field(description="largest x, y, z, each more than the least")

    @model_validator(mode="after")
    def _ordered(self) -> ZoneSection:
        if not all(low < high for low, high in zip(self.min_mm, self.max_mm, strict=True)):
            raise ValueError(f"min_mm {self.min_mm} must be less than max_mm {self.max_mm} along each axis")
        return self

    def box(self) -> Box:
        """Convert to the domain value."""
        (a, b, c), (d, e, f) = self.min_mm, self.max_mm
        return Box(self.name, (a, b, c), (d, e, f))


Zones = Annotated[list[ZoneSection], Field(max_length=64)]


class BodySection(ZoneSection):
    """Box of the gripper's body; in the tip's frame, whose z is the approach direction."""


class GripperSection(Section):
    """The tool on the flange. Left out: its turn is the taught one, and its body is not checked."""

    tip_mm: Corner = Field(
        [0.0, 0.0, 0.0], description="the tip in the flange's frame, as the robot's tool data"
    )
    tip_deg: Corner = Field([0.0, 0.0, 0.0], description="its turn about the flange's fixed x, y, z")
    box: Annotated[list[BodySection], Field(max_length=16)] = Field(
        default_factory=list,
        description="what must meet no other part and no keep-out zone, there and on the straight ways",
    )

    def gripper(self) -> Gripper:
        """Convert to the domain value."""
        x, y, z = self.tip_mm
        a, b, c = (math.radians(angle) for angle in self.tip_deg)
        return Gripper((x, y, z), (a, b, c), tuple(box.box() for box in self.box))


class LimitsSection(Section):
    """Where the robot may go, for all jobs; a job's `[limits]` may restrict it more. Left out: everywhere."""

    box: Zones = Field(default_factory=list, description="a part in none of them is not good")
    keep_out: Zones = Field(default_factory=list, description="a part in one of them is not good")
    gripper: GripperSection | None = None

    def bounds(self) -> Bounds:
        """Convert to the domain value."""
        return Bounds(
            tuple(zone.box() for zone in self.box),
            tuple(zone.box() for zone in self.keep_out),
            None if self.gripper is None else self.gripper.gripper(),
        )


Step = Annotated[list[Annotated[float, Field(ge=-10, le=10)]], Field(min_length=3, max_length=3)]


class BeltSection(Section):
    """Conveyor belt that carries the parts, as `edged belt` teaches it. Left out: the parts lie still."""

    mm_per_count: Step = Field(
        description="by how much a part goes on with one count of the encoder: x, y, z of the robot's frame"
    )
    first_mm: Corner = Field(description="origin of the belt's frame, whose x is along the travel")
    speed_mm_s: float = Field(
        gt=0, le=5000, description="of the belt, the highest; counts where no client says its speed"
    )
    source: Literal["command", "camera"] = Field(
        "command",
        description='of the count: "command": a client writes it with LOCATE; "camera": `count` of a camera',
    )
    jitter_ms: float = Field(
        1.0, ge=0, le=1000, description="one sigma of when the count was read; times the speed it is in sigma"
    )
    counts: int = Field(
        2**32, ge=2**8, le=2**32, description="after so many the encoder's register begins again at 0"
    )
    same_mm: float = Field(
        10.0,
        gt=0,
        le=1000,
        description="two parts nearer than this, by the belt, are one that was seen twice",
    )

    @field_validator("mm_per_count")
    @classmethod
    def _goes_on(cls, step: list[float]) -> list[float]:
        if not math.hypot(*step) > 1e-6:
            raise ValueError("expected at least 0.000001 mm a count")
        return step

    def belt(self, exposure_s: float, focal_px: float) -> Belt:
        """Convert to the domain value."""
        (a, b, c), (x, y, z) = self.mm_per_count, self.first_mm
        return Belt(
            (a, b, c),
            (x, y, z),
            self.counts,
            self.source,
            self.speed_mm_s,
            self.jitter_ms / 1000,
            exposure_s,
            focal_px,
            self.same_mm,
        )


class RegistrationSection(Section):
    """Registration of the rig by a robot's program (HAND_EYE_START, TOUCH_START). Left out: people only."""

    board: str | None = Field(
        None, description="for HAND_EYE_START, as for `edged calibrate`: chessboard:11x8:4.0, ..."
    )
    mount: Literal["fixed", "flange"] = Field("fixed", description="where the cameras are")
    limit_mm: float = Field(
        0.5, gt=0, le=100, description="no registration is taken whose poses or points disagree by more"
    )

    @field_validator("board")
    @classmethod
    def _is_board(cls, text: str | None) -> str | None:
        if text is not None:
            try:
                boards = parse_boards(text)
            except CalibrationError as error:
                raise ValueError(str(error)) from None
            if len(boards) != 1:
                raise ValueError("expected one board, not several")
        return text

    @property
    def pattern(self) -> NominalBoard | None:
        """The board; None without one."""
        return None if self.board is None else parse_boards(self.board)[0]


class RecorderSection(Section):
    """Recording of cycles on disk, for `edged replay`. Left out: nothing is recorded."""

    folder: FilePath = Field(description="where recordings go")
    keep_good: int = Field(200, ge=0, le=1_000_000, description="good cycles")
    keep_bad: int = Field(500, ge=0, le=1_000_000, description="others: no target, low quality, faults")
    max_mib: int = Field(2000, ge=1, le=100_000_000, description="of all recordings")
    max_age_days: float = Field(
        30.0, gt=0, le=36_500, description="older ones are removed; a gap counts a tenth of it at most"
    )
    min_free_mib: int = Field(
        1000, ge=0, le=100_000_000, description="of the disk, which is never filled further"
    )


class HistorySection(Section):
    """A row for each cycle, for `edged history`. Left out: none; needs the extra `history`."""

    folder: FilePath = Field(description="where rows go, as Parquet by plant, day and cell")
    plant: Name = Field("plant", description="name of the plant, by which cells of several are told apart")
    bucket: str = Field(
        "",
        pattern=r"^(s3://[a-z0-9][^\s@]*)?$",
        description="s3://BUCKET/PREFIX that is sent what is packed, too; left out: none",
    )
    max_days: int = Field(400, ge=1, le=36_500, description="days with cycles; older ones are removed")
    max_mib: int = Field(2000, ge=1, le=100_000_000, description="of this cell's rows")
    min_free_mib: int = Field(
        500, ge=0, le=100_000_000, description="of the disk: with less no rows are written"
    )
    recordings_mib: int = Field(
        0, ge=0, le=100_000_000, description="of recordings that are kept with the rows; 0: none"
    )
    every_good: int = Field(
        100, ge=1, le=1_000_000, description="which good ones of them; of others all that the recorder has"
    )
