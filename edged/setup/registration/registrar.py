"""Registration by the commands of a robot's program: begun, added to, solved, and saved to the rig's file."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from edged.cell.loaded import Setup
from edged.domain.arrays import FloatArray
from edged.domain.events import Command, CommandKind, Registered
from edged.domain.frames import FramePair
from edged.domain.registration import Method, Obstacle
from edged.errors import UserError
from edged.setup.cellfiles import CellFiles, UnfinishedCell

if TYPE_CHECKING:  # a cell that measures does not load what calibrates
    from edged.setup.registration.model import Kind, Mount
    from edged.setup.registration.registering import RegisteredRig as Solved
    from edged.setup.registration.sampling import RegistrationSampling, Step


class RegistrationListener(Protocol):
    """Listener to what a robot's program adds; called on any thread, must neither block nor raise."""

    def begun(self, mount: Mount, kind: Kind, board: str, limit_mm: float) -> None:
        """A new registration was begun."""

    def posed(self, pair: FramePair, robot_from_flange: FloatArray) -> None:
        """A pose was taken."""

    def touched(self, pair: FramePair, job: str, rig_mm: FloatArray, robot_from_tip: FloatArray) -> None:
        """A point (3,) was taken, on the part of a job."""

    def activated(self) -> None:
        """The cell now uses the result."""


class Loaded(Protocol):
    """Files and jobs that a cell measures with."""

    @property
    def cell(self) -> CellFiles | UnfinishedCell:
        """Its files."""

    @property
    def setup(self) -> Setup:
        """Its jobs."""


class RegistrableCell(Protocol):
    """The cell that is registered."""

    @property
    def loaded(self) -> Loaded:
        """Files and jobs that it measures with at present."""

    async def register(self, base: object, save: Callable[[], None]) -> Setup:
        """Save the rig and measure with it. Raises `EdgedError`, `OSError`; also if base is not loaded."""


class CellRegistrar:
    """The `Registrar` of a cell. witness : notified of each step."""

    def __init__(self, cell: RegistrableCell) -> None:
        self._cell = cell
        self._base: Loaded | None = None
        self._sampling: RegistrationSampling | None = None
        self._solved: Solved | None = None
        self.witness: RegistrationListener | None = None

    def problem(self, kind: CommandKind) -> str:
        """Why a registration cannot begin with this command; "" when it can."""
        loaded = self._cell.loaded
        allowed = loaded.cell.config.registration
        if allowed is None:
            return "no robot's program may register the rig: there is no [registration] in the configuration"
        if kind is CommandKind.HAND_EYE_START and allowed.board is None:
            return "HAND_EYE_START needs registration.board in the configuration"
        if kind is CommandKind.TOUCH_START and allowed.mount == "flange":
            return "TOUCH_START is for cameras that stand still, registration.mount is flange"
        return _unwritable(loaded.cell.config.cell.rig)

    def begin(self, command: Command) -> Registered:
        """Begin a registration; samples taken before are forgotten."""
        from edged.setup.registration.sampling import RegistrationSampling

        self._base, self._solved = self._cell.loaded, None
        allowed, rig = self._base.cell.config.registration, self._base.cell.rig
        assert allowed is not None and rig is not None  # `problem` was asked; without a rig it is in SETUP
        is_touch = command.kind is CommandKind.TOUCH_START
        self._sampling = RegistrationSampling(
            rig,
            Method.TOUCH if is_touch else Method.HAND_EYE,
            "eye-in-hand" if allowed.mount == "flange" else "eye-to-hand",
            allowed.pattern,
            allowed.limit_mm,
        )
        if self.witness is not None:
            kind: Kind = "touch" if is_touch else "poses"
            self.witness.begun(allowed.mount, kind, "" if is_touch else allowed.board or "", allowed.limit_mm)
        by = "touched points" if is_touch else f"poses of the flange with {allowed.board}"
        return Registered(command, self._sampling.state, None, f"begun, by {by}; the cell is in SETUP")

    def add(self, command: Command, pair: FramePair) -> Registered:
        """Add one pose or point, with its pictures."""
        from edged.setup.registration.sampling import Step

        sampling, _ = self._under_way
        try:
            step = self._added(command, pair)
        except UserError as error:  # pictures of another size
            step = Step(sampling.state, Obstacle.FAILED, str(error))
        return _answer(command, step)

    def _added(self, command: Command, pair: FramePair) -> Step:
        from edged.setup.pairs import Pair

        sampling, base = self._under_way
        assert command.robot_from_flange is not None  # it is refused without
        if sampling.method is Method.TOUCH:
            setup = base.setup
            job = setup.jobs[command.job or setup.active_job]
            found = job.locate(pair, lambda _stage: None)
            step = sampling.add_part(found, command.robot_from_flange, command.shown)
            if self.witness is not None and step.obstacle is None:
                self.witness.touched(pair, job.name, sampling.views[-1], command.robot_from_flange)
            return step
        pictures = Pair.of_images("pose", *pair.images)
        step = sampling.add_board(pictures, command.robot_from_flange, command.shown)
        if self.witness is not None and step.obstacle is None:
            self.witness.posed(pair, command.robot_from_flange)
        return step

    def solve(self, command: Command) -> Registered:
        """Solve and judge the samples; nothing is saved."""
        step = self._under_way[0].solve()
        self._solved = step.registered
        return _answer(command, step)

    async def activate(self) -> Setup:
        """Save the solved rig and take it into use. Raises `EdgedError`, `OSError`."""
        _, base = self._under_way
        assert self._solved is not None
        rig, content = base.cell.config.cell.rig, base.cell.contents["rig.json"]
        setup = await self._cell.register(base, partial(_save, rig, content, self._solved))
        if self.witness is not None:
            self.witness.activated()
        return setup

    @property
    def _under_way(self) -> tuple[RegistrationSampling, Loaded]:
        assert self._sampling is not None and self._base is not None  # the loop calls `begin` first
        return self._sampling, self._base


def _answer(command: Command, step: Step) -> Registered:
    return Registered(command, step.registration, step.obstacle, step.why)


def _unwritable(rig: Path) -> str:
    """Why the rig's file could not be replaced; "" if it can."""
    if os.access(rig.parent, os.W_OK) and os.access(rig, os.W_OK):
        return ""
    return f"{rig} cannot be written by the daemon: let cell.rig be in its state directory"


def _save(rig: Path, loaded: bytes, solved: Solved) -> None:
    """Save the rig. Raises `UserError` if its file no longer holds the loaded rig, which would be lost."""
    from edged.setup.registration.registering import save

    if rig.read_bytes() != loaded:
        raise UserError(f"{rig} was changed since it was loaded: reload, and register again")
    save(rig, solved, rig)
