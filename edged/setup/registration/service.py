"""Drafts of registrations in a running cell: points and poses are taken, and judged after each of them.

Pictures are looked at and samples judged in the worker: the loop of the cell never waits for it.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from edged.cell.lease.notices import Notices
from edged.cell.tasks import cancel_and_await
from edged.domain.arrays import FloatArray, Image
from edged.domain.frames import FramePair
from edged.errors import CalibrationError, EdgedError, FileFormatError, UserError
from edged.files.rig import rig_of, rig_text
from edged.robot.orientations import Brand
from edged.robot.pendant import PENDANTS, mm_per_unit, numbers_in
from edged.setup.inuse import RigInUse
from edged.setup.jobs.worker import Worker
from edged.setup.registration.documents import (
    ROBOT,
    Conventions,
    RegistrationDocument,
    RegistrationLine,
    RegistrationList,
    brands,
    document_of,
    is_active,
    readings_in,
)
from edged.setup.registration.drafts import (
    Change,
    Confirmed,
    Kind,
    LookState,
    Mount,
    Place,
    RegistrationState,
    RobotDraft,
    RobotDrafts,
    SampleState,
)
from edged.setup.registration.verdict import Judged, Trouble
from edged.vision.boards.board import parse_boards
from edged.vision.geometry.camera import StereoRig
from edged.vision.part.job import Job

FUNCTIONS = {
    name: f"edged.setup.registration.work:{name}"
    for name in ("marks_to_touch", "features_to_touch", "pose_with_board", "judge_touch", "judge_poses")
}


@dataclass(eq=False, slots=True)
class _Open:
    """A draft that is worked on. judged_of : what `judged` was made of. solved : the registered rig."""

    draft: RobotDraft
    judged: Judged = field(default_factory=Judged)
    judged_of: tuple[object, ...] = ()
    judging: asyncio.Task[None] | None = None
    fault: Trouble | None = None
    solved: StereoRig | None = None
    is_gone: bool = False  # discarded: what is still under way for it is told nobody

    def wanted(self, rig: RigInUse | None) -> tuple[object, ...]:
        """What a verdict depends on."""
        state = self.draft.state
        numbers = tuple((name, state.numbers.get(name)) for name in state.used)
        return numbers, state.brand, state.mount, state.limit_mm, None if rig is None else rig.content


@dataclass(frozen=True, slots=True)
class Given:
    """What a robot shows: numbers, or a text that was pasted."""

    numbers: tuple[float, ...] | None = None
    text: str | None = None


class Registrations:
    """All drafts of a cell; used on its event loop.

    capture : an exposure, for the token of who has the cell. rig : the one in use; None without. jobs : by
    name.
    """

    def __init__(
        self,
        folder: Path,
        worker: Worker,
        notices: Notices,
        capture: Callable[[str], Awaitable[FramePair]],
        rig: Callable[[], RigInUse | None],
        jobs: Callable[[], Mapping[str, Job]],
    ) -> None:
        self._drafts = RobotDrafts(folder)
        self._worker = worker
        self._notices = notices
        self._capture = capture
        self._rig = rig
        self._jobs = jobs
        self._open: dict[str, _Open] = {}
        self._taking = asyncio.Lock()

    async def close(self) -> None:
        """Nothing is done any more; drafts are on disc."""
        await cancel_and_await(*(one.judging for one in self._open.values() if one.judging is not None))

    async def begin(
        self, author: str, mount: Mount, kind: Kind, brand: Brand | None, board: str, limit_mm: float
    ) -> RegistrationDocument:
        """A new draft. board : "" for the one of the calibration, where poses need one.

        Raises `CalibrationError` for what does not fit together, and without a calibration; `OSError`.
        """
        rig = self._needed_rig()
        if not board and kind == "poses":
            board = rig.boards[0] if rig.boards else ""
            if not board:
                raise CalibrationError("which board does the flange hold? State it")
        about = (author, rig.calibration_id, datetime.now(UTC), mount, kind, brand, board, limit_mm)
        draft = await asyncio.to_thread(self._drafts.create, *about)
        self._open = {name: one for name, one in self._open.items() if one.judging is not None}
        self._open[draft.state.id] = _Open(draft)
        return self._tell(self._open[draft.state.id])

    async def remove(self, identity: str) -> None:
        """Discard a draft, and what is under way for it. Raises `KeyError`."""
        async with self._taking:  # a sample that is being kept is kept before
            await asyncio.to_thread(self._drafts.remove, identity)
            one = self._open.pop(identity, None)
        self._notices.publish("registration", {"id": identity, "gone": True})
        if one is not None:
            one.is_gone = True
            if one.judging is not None:
                await cancel_and_await(one.judging)

    async def listed(self) -> RegistrationList:
        """All of them."""
        states = await asyncio.to_thread(self._drafts.states)
        return RegistrationList(registrations=[self._line(*one) for one in states], brands=brands())

    async def document(self, identity: str) -> RegistrationDocument:
        """One of them. Raises `KeyError`, and `FileFormatError` for one that cannot be read."""
        return self._document(await self._opened(identity))

    async def conventions(self, identity: str) -> Conventions:
        """How its poses read, as far as it was judged. Raises as `document`."""
        return Conventions(conventions=readings_in((await self._opened(identity)).judged))

    async def draft(self, identity: str) -> RobotDraft:
        """Raises as `document`."""
        return (await self._opened(identity)).draft

    async def change(self, identity: str, change: Change) -> RegistrationDocument:
        """Anything that a draft can. Raises what it raises."""
        one = await self._opened(identity)
        async with self._taking:
            _check_there(one)
            await asyncio.to_thread(change, one.draft)
            await self._keep_solved(one)
        self._judge(one)
        return self._tell(one)

    async def look(self, identity: str, token: str, job: str | None) -> RegistrationDocument:
        """Take a pair, and look for what a tip can touch: marks of the draft's board, or the part of a job.

        Raises `SetupRefused`, `CaptureError`, `UserError` for no such job.
        """
        one = await self._opened(identity)
        self._needed_rig()
        if job is not None and job not in self._jobs():
            raise UserError(f"there is no job {job}")
        if job is None and not one.draft.state.board:
            raise CalibrationError("which board, or which part? State one of them")
        await self._keep_look(one, await self._images(token), job)
        return self._tell(one)

    async def touch(self, identity: str, key: str, given: Given) -> RegistrationDocument:
        """A place of the last pictures was touched. Raises `CalibrationError`, `UserError`."""
        one = await self._opened(identity)
        looked = one.draft.state.looked
        place = _place(one, key)
        if one.draft.state.kind != "touch" or looked is None:
            raise CalibrationError("this registration is by poses of the flange")
        sample = SampleState(place=place, look=looked.name)
        numbers = _read(one.draft, given)
        return await self.change(identity, lambda draft: draft.add(draft.next_sample, sample, numbers))

    async def pose(self, identity: str, token: str, given: Given | None) -> RegistrationDocument:
        """Take a pair of the board at a pose of the flange. Raises as `look`."""
        one = await self._opened(identity)
        if one.draft.state.kind != "poses":
            raise CalibrationError("this registration is by touched points")
        numbers = None if given is None else _read(one.draft, given)
        self._needed_rig()
        await self._keep_pose(one, await self._images(token), numbers)
        return self._tell(one)

    async def write(self, identity: str, name: str, given: Given) -> RegistrationDocument:
        """Say what the robot showed at a sample. Raises `KeyError`, `UserError`."""
        numbers = _read((await self._opened(identity)).draft, given)
        return await self.change(identity, lambda draft: draft.write(name, numbers))

    async def solve(self, identity: str) -> RegistrationDocument:
        """Keep what its samples give. Raises `CalibrationError` where that is not good, with the reason."""
        one = await self._opened(identity)
        self._judge(one)
        if one.judging is not None:
            await asyncio.shield(one.judging)
        rig, judged = self._needed_rig(), one.judged
        trouble = one.fault or judged.trouble
        if one.judged_of != one.wanted(rig) or (judged.registered is None and trouble is None):
            raise CalibrationError("samples came or went meanwhile: solve it again")
        if judged.registered is None:
            raise CalibrationError(trouble.text if trouble is not None else "it is not good")
        quality = json.loads(rig.content).get("quality")
        when = datetime.now(UTC).isoformat(timespec="seconds")
        kept = {
            **(quality if isinstance(quality, dict) else {}),
            "registration": {**judged.registered.how, "when": when},
        }
        solved = rig_text(judged.registered.rig, kept)
        return await self.change(identity, lambda draft: draft.solve(solved))

    async def confirm(self, identity: str, key: str, given: Given) -> RegistrationDocument:
        """A place was touched, to see whether it holds. Raises `CalibrationError`, `UserError`."""
        one = await self._opened(identity)
        document = self._document(one)
        found = next((place for place in document.places if place.key == key), None)
        if one.solved is None or found is None or found.robot is None:
            raise CalibrationError(
                "there is no such place to go to: solve it, and take pictures of the place"
            )
        numbers = _read(one.draft, given, count=3)
        unit_mm = 1.0 if one.draft.state.brand is None else mm_per_unit(one.draft.state.brand)
        off = unit_mm * (np.array(numbers) - np.array(found.robot.numbers))
        x, y, z = off.tolist()
        place = Place.model_validate(
            {
                **found.model_dump(include={"key", "kind", "name"}),
                **{name: tuple(getattr(found, name)) for name in ("rig_mm", "left", "right")},
            }
        )
        confirmed = Confirmed(place=place, numbers=numbers, off_mm=(x, y, z))
        return await self.change(identity, lambda draft: draft.confirm(confirmed))

    async def solution(self, identity: str) -> bytes:
        """The rig that a draft was solved to. Raises as `RobotDraft.rig`, and for another calibration's."""
        one = await self._opened(identity)
        rig = await asyncio.to_thread(one.draft.rig)
        if self._needed_rig().calibration_id != one.draft.state.calibration_id:
            raise CalibrationError("the cell has another calibration by now: register it again")
        return rig

    async def tell(self, identity: str) -> None:
        """Tell every page how a draft is now: whether it is active is not its own doing."""
        self._tell(await self._opened(identity))

    # --- by the robot's own program ------------------------------------------------------------------

    async def adopt(self, mount: Mount, kind: Kind, brand: Brand, board: str, limit_mm: float) -> str:
        """Begin a draft that a robot's program fills; returns its id. Raises as `begin`."""
        return (await self.begin(ROBOT, mount, kind, brand, board, limit_mm)).id

    async def adopt_pose(self, identity: str, images: tuple[Image, Image], given: Given) -> None:
        """A pose of the flange, with its pictures. Raises as `pose`."""
        one = await self._opened(identity)
        await self._keep_pose(one, images, _read(one.draft, given))

    async def adopt_point(
        self, identity: str, images: tuple[Image, Image], job: str, rig_mm: FloatArray, given: Given
    ) -> None:
        """A point (3,) that the tip touched, on the part of a job. Raises as `look` and `touch`."""
        one = await self._opened(identity)
        await self._keep_look(one, images, job)
        looked = one.draft.state.looked
        if looked is not None and looked.places:
            off = [np.linalg.norm(np.array(place.rig_mm) - rig_mm) for place in looked.places]
            await self.touch(identity, looked.places[int(np.argmin(off))].key, given)

    async def adopt_solved(self, identity: str) -> None:
        """The cell runs by what the program has solved."""
        rig = self._needed_rig()
        await self.change(identity, lambda draft: draft.solve(rig.content))

    # --- judging -----------------------------------------------------------------------------------

    def _judge(self, one: _Open) -> None:
        """See to it that what is said is of the samples that count."""
        if one.judging is None and one.judged_of != one.wanted(self._rig()):
            one.judging = asyncio.create_task(self._run_judge(one), name="judge")

    async def _run_judge(self, one: _Open) -> None:
        try:
            while one.judged_of != (wanted := one.wanted(rig := self._rig())):
                judged, fault = Judged(), None
                try:
                    judged = await self._judged(one, rig)
                except EdgedError as error:
                    fault = Trouble("refused", str(error))
                one.judged, one.fault, one.judged_of = judged, fault, wanted
        finally:
            one.judging = None
            self._tell(one)

    async def _judged(self, one: _Open, rig: RigInUse | None) -> Judged:
        state = one.draft.state
        if rig is None or rig.calibration_id != state.calibration_id:
            raise CalibrationError("the cell has another calibration by now: begin another registration")
        arguments: tuple[object, ...]
        counted = {name: state.samples[name] for name in state.used if name in state.numbers}
        if state.kind == "touch":
            touched = {
                name: (np.array(sample.place.rig_mm), state.numbers[name])
                for name, sample in counted.items()
                if sample.place is not None
            }
            arguments = (touched, state.brand, state.limit_mm)
        else:
            posed = {
                name: (np.array(sample.view), state.numbers[name])
                for name, sample in counted.items()
                if sample.view is not None
            }
            mount = "eye-to-hand" if state.mount == "fixed" else "eye-in-hand"
            arguments = (posed, parse_boards(state.board)[0], state.brand, mount, state.limit_mm)
        judged: Judged = await self._worker.run(f"judge_{state.kind}", rig.content, rig.path, *arguments)
        return judged

    # --- telling -------------------------------------------------------------------------------------

    async def _keep_look(self, one: _Open, images: tuple[Image, Image], job: str | None) -> None:
        rig, draft = self._needed_rig(), one.draft
        async with self._taking:
            _check_there(one)
            about = (draft.folder, draft.next_look, *images, rig.content, rig.path)
            if job is None:
                what = parse_boards(draft.state.board)[0]
                looked: LookState = await self._worker.run("marks_to_touch", *about, what)
            else:
                looked = await self._worker.run("features_to_touch", *about, self._jobs()[job])
            await asyncio.to_thread(draft.look, looked)

    async def _keep_pose(
        self, one: _Open, images: tuple[Image, Image], numbers: tuple[float, ...] | None
    ) -> None:
        rig, draft = self._needed_rig(), one.draft
        async with self._taking:
            _check_there(one)
            name, board = draft.next_sample, parse_boards(draft.state.board)[0]
            about = (draft.folder, name, *images, rig.content, rig.path, board)
            sample: SampleState = await self._worker.run("pose_with_board", *about)
            await asyncio.to_thread(draft.add, name, sample, numbers)
        self._judge(one)
        self._tell(one)

    async def _images(self, token: str) -> tuple[Image, Image]:
        pair = await self._capture(token)
        return pair.left.image, pair.right.image

    def _needed_rig(self) -> RigInUse:
        rig = self._rig()
        if rig is None:
            raise CalibrationError("there is no calibration to register: calibrate first")
        return rig

    async def _opened(self, identity: str) -> _Open:
        if identity not in self._open:
            draft = await asyncio.to_thread(self._drafts.load, identity)
            if identity not in self._open:  # nobody was quicker
                self._open[identity] = one = _Open(draft)
                await self._keep_solved(one)
                self._judge(one)
        return self._open[identity]

    async def _keep_solved(self, one: _Open) -> None:
        one.solved = None
        if one.draft.state.solved is not None:
            one.solved = rig_of(await asyncio.to_thread(one.draft.rig), one.draft.folder)

    def _line(self, identity: str, state: RegistrationState | FileFormatError) -> RegistrationLine:
        if isinstance(state, FileFormatError):
            return RegistrationLine(id=identity, trouble=str(state))
        return RegistrationLine(
            id=identity,
            kind=state.kind,
            mount=state.mount,
            samples=len(state.used),
            created=state.created,
            author=state.author,
            active=is_active(state, self._rig()),
        )

    def _tell(self, one: _Open) -> RegistrationDocument:
        document = self._document(one)
        if not one.is_gone:
            self._notices.publish("registration", document.model_dump(mode="json"))
        return document

    def _document(self, one: _Open) -> RegistrationDocument:
        judging = one.judging is not None
        return document_of(
            one.draft.state, one.judged, self._rig(), one.solved, judging=judging, fault=one.fault
        )


def _check_there(one: _Open) -> None:
    """Raises `KeyError` for a draft that was discarded meanwhile."""
    if one.is_gone:
        raise KeyError(one.draft.state.id)


def _place(one: _Open, key: str) -> Place:
    looked = one.draft.state.looked
    found = [place for place in ([] if looked is None else looked.places) if place.key == key]
    if not found:
        raise CalibrationError("there is no such place in the last pictures: take them again")
    return found[0]


def _read(draft: RobotDraft, given: Given, count: int | None = None) -> tuple[float, ...]:
    """As many numbers as a point or a pose has. Raises `UserError`."""
    state = draft.state
    whole = (6, 7) if state.brand is None else (len(PENDANTS[state.brand].labels),)
    is_point = state.kind == "touch" or count == 3
    counts = (3, *whole) if is_point else whole
    if given.text is not None:
        numbers = numbers_in(given.text, counts)
    else:
        numbers = given.numbers or ()
        if len(numbers) not in counts:
            expected = " or ".join(map(str, counts))
            raise UserError(f"expected {expected} numbers, got {len(numbers)}")
    return numbers[:3] if is_point else numbers
