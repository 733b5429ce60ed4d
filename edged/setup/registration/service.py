"""Registration drafts in a running cell: points and poses are taken, and judged after each of them.

The worker process examines pictures and judges samples, so the event loop of the cell never blocks.
"""

from __future__ import annotations

import asyncio
import json
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.frames import FramePair
from edged.errors import CalibrationError, EdgedError, FileFormatError, UserError
from edged.files.rig import rig_of, rig_text
from edged.robot.orientations import Brand
from edged.robot.pendant import PENDANTS, mm_per_unit, numbers_in
from edged.setup.documents import DraftHead, Trouble, now_text
from edged.setup.drafts import Latest, OpenDrafts
from edged.setup.history import solved_rig
from edged.setup.inuse import CellInUse, RigInUse
from edged.setup.registration.documents import (
    ROBOT,
    Conventions,
    RegistrationDocument,
    brands,
    document_of,
    is_active,
    map_of,
    readings_in,
)
from edged.setup.registration.drafts import RobotDraft, RobotDrafts
from edged.setup.registration.model import (
    Confirmed,
    Kind,
    LookState,
    Mount,
    Place,
    RegistrationState,
    SampleState,
)
from edged.setup.registration.verdict import Judged
from edged.vision.boards.board import parse_boards
from edged.vision.geometry.camera import StereoRig

FUNCTIONS = {
    name: f"edged.setup.registration.work:{name}"
    for name in ("marks_to_touch", "features_to_touch", "pose_with_board", "judge_touch", "judge_poses")
}


@dataclass(frozen=True, slots=True)
class Given:
    """Numbers that a robot shows, or a pasted text with them."""

    numbers: tuple[float, ...] | None = None
    text: str | None = None


@dataclass(eq=False, slots=True)
class OpenRegistration:
    """An open draft. judge : the latest verdict on its samples."""

    draft: RobotDraft
    judge: Latest[Judged] = field(init=False)
    is_gone: bool = False

    @property
    def is_busy(self) -> bool:
        """Whether its samples are being judged."""
        return self.judge.is_running

    @property
    def solved(self) -> StereoRig | None:
        """The registered rig; None before it is solved or if its file cannot be read."""
        solved = self.draft.state.solved
        return None if solved is None else _solved(self.draft.folder, solved.digest)


class Registrations:
    """All drafts of a cell; used on its event loop."""

    def __init__(self, cell: CellInUse) -> None:
        self._cell = cell
        self._worker = cell.worker
        self._folders = RobotDrafts(cell.folder / "registrations")
        self.drafts = OpenDrafts("registration", cell.notices, self._folders, self)

    def about(self) -> dict[str, object]:
        """Further fields of the list of drafts."""
        return {"brands": brands(), "robot_map": map_of(self._cell.rig())}

    async def close(self) -> None:
        """Stop all work under way; drafts are on disc."""
        await self.drafts.close()

    async def begin(
        self, author: str, mount: Mount, kind: Kind, brand: Brand | None, board: str, limit_mm: float
    ) -> DraftHead:
        """Begin a draft. board : "" for that of the calibration, where poses need one.

        Raises `CalibrationError` for settings that do not fit together and without a calibration; `OSError`.
        """
        rig = self._needed_rig()
        if not board and kind == "poses":
            board = rig.boards[0] if rig.boards else ""
            if not board:
                raise CalibrationError("which board does the flange hold? State it")
        about = (author, rig.calibration_id, datetime.now(UTC), mount, kind, brand, board, limit_mm)
        return self.drafts.publish(await self.drafts.begin(partial(self._folders.create, *about)))

    async def conventions(self, identity: str) -> Conventions:
        """Ways to read its poses, by the latest verdict. Raises as `OpenDrafts.get`."""
        return Conventions(conventions=readings_in((await self.drafts.get(identity)).judge.value))

    async def look(self, identity: str, token: str, job: str | None) -> DraftHead:
        """Take a pair, and find places that a tip can touch: marks of the draft's board, or on a job's part.

        Raises `SetupRefused`, `CaptureError`, and `UserError` for an unknown job.
        """
        opened = await self.drafts.get(identity)
        self._needed_rig()
        if job is not None:
            self._cell.job(job)
        if job is None and not opened.draft.state.board:
            raise CalibrationError("which board, or which part? State one of them")
        await self._keep_look(opened, await self._cell.session.capture(token), job)
        return self.drafts.publish(opened)

    async def touch(self, identity: str, key: str, given: Given, revision: int | None = None) -> DraftHead:
        """Add a touched place of the last pictures. Raises `CalibrationError`, `UserError`, `StaleDraft`."""
        opened = await self.drafts.get(identity)
        self.drafts.check(opened, revision)
        state = opened.draft.state
        places = () if state.looked is None else state.looked.places
        place = next((place for place in places if place.key == key), None)
        if place is None:
            raise CalibrationError("there is no such place in the last pictures: take them again")
        if state.kind != "touch" or state.looked is None:
            raise CalibrationError("this registration is by poses of the flange")
        sample, numbers = SampleState(place=place, look=state.looked.name), _read(state, given)
        return await self.drafts.change(
            identity, lambda draft: draft.add(draft.next_sample, sample, numbers), revision
        )

    async def pose(
        self, identity: str, token: str, given: Given | None, revision: int | None = None
    ) -> DraftHead:
        """Take a pair of the board at a pose of the flange. Raises as `look`, and `StaleDraft`."""
        opened = await self.drafts.get(identity)
        self.drafts.check(opened, revision)
        if opened.draft.state.kind != "poses":
            raise CalibrationError("this registration is by touched points")
        numbers = None if given is None else _read(opened.draft.state, given)
        self._needed_rig()
        return await self._keep_pose(opened, await self._cell.session.capture(token), numbers)

    async def write(self, identity: str, name: str, given: Given, revision: int | None = None) -> DraftHead:
        """Record the numbers that the robot showed. Raises `KeyError`, `UserError`, `StaleDraft`."""
        opened = await self.drafts.get(identity)
        self.drafts.check(opened, revision)
        numbers = _read(opened.draft.state, given)
        return await self.drafts.change(identity, lambda draft: draft.write_numbers(name, numbers), revision)

    async def solve(self, identity: str, revision: int | None = None) -> DraftHead:
        """Keep the rig that its samples give. Raises `CalibrationError` with the reason if it is not good."""
        opened = await self.drafts.get(identity)
        self.drafts.check(opened, revision)
        await opened.judge.wait()
        rig, judged = self._needed_rig(), opened.judge.value
        if judged.registered is None and judged.trouble is not None and opened.judge.is_current:
            raise CalibrationError(judged.trouble.text)
        if judged.registered is None or not opened.judge.is_current:
            raise CalibrationError("the samples have changed meanwhile: solve it again")
        quality = json.loads(rig.content).get("quality")
        when = now_text()
        kept = {
            **(quality if isinstance(quality, dict) else {}),
            "registration": {**judged.registered.how, "when": when},
        }
        solved = rig_text(judged.registered.rig, kept)
        return await self.drafts.change(identity, lambda draft: draft.solve(solved))

    async def confirm(self, identity: str, key: str, given: Given, revision: int | None = None) -> DraftHead:
        """Record a touch that checks the solved registration. Raises as `touch`."""
        opened = await self.drafts.get(identity)
        self.drafts.check(opened, revision)
        found = next((place for place in self.document(opened).places if place.key == key), None)
        if found is None or found.robot is None:
            raise CalibrationError(
                "there is no such place to go to: solve it, and take pictures of the place"
            )
        state = opened.draft.state
        numbers = _read(state, given, count=3)
        unit_mm = 1.0 if state.brand is None else mm_per_unit(state.brand)
        x, y, z = (unit_mm * (np.array(numbers) - np.array(found.robot.numbers))).tolist()
        place = Place.model_validate_json(found.model_dump_json(include=set(Place.model_fields)))
        confirmed = Confirmed(place=place, numbers=numbers, off_mm=(x, y, z))
        return await self.drafts.change(identity, lambda draft: draft.confirm(confirmed))

    async def solution(self, identity: str) -> bytes:
        """Content of the rig file that a draft was solved to.

        Raises as `RobotDraft.rig`, and `CalibrationError` if the cell has another calibration by now.
        """
        draft = (await self.drafts.get(identity)).draft
        rig = await asyncio.to_thread(draft.rig)
        if self._needed_rig().calibration_id != draft.state.calibration_id:
            raise CalibrationError("the cell has another calibration by now: register it again")
        return rig

    # --- by the robot's own program ------------------------------------------------------------------

    async def adopt(self, mount: Mount, kind: Kind, brand: Brand, board: str, limit_mm: float) -> str:
        """Begin a draft that a robot's program fills, and return its id. Raises as `begin`."""
        return (await self.begin(ROBOT, mount, kind, brand, board, limit_mm)).id

    async def adopt_pose(self, identity: str, pair: FramePair, given: Given) -> None:
        """Add a pose of the flange, with its pictures. Raises as `pose`."""
        opened = await self.drafts.get(identity)
        await self._keep_pose(opened, pair, _read(opened.draft.state, given))

    async def adopt_point(
        self, identity: str, pair: FramePair, job: str, rig_mm: FloatArray, given: Given
    ) -> None:
        """Add a point (3,) that the tip touched, on the part of a job. Raises as `look` and `touch`."""
        opened = await self.drafts.get(identity)
        await self._keep_look(opened, pair, job)
        looked = opened.draft.state.looked
        if looked is not None and looked.places:
            off = [np.linalg.norm(np.array(place.rig_mm) - rig_mm) for place in looked.places]
            await self.touch(identity, looked.places[int(np.argmin(off))].key, given)

    async def adopt_solved(self, identity: str) -> None:
        """Mark the draft as solved to the rig in use, which the program has solved."""
        rig = self._needed_rig()
        await self.drafts.change(identity, lambda draft: draft.solve(rig.content))

    # --- in the worker -------------------------------------------------------------------------------

    async def _judged(self, opened: OpenRegistration) -> Judged:
        rig, state = self._cell.rig(), opened.draft.state
        counted = {name: state.samples[name] for name in state.used if name in state.numbers}
        wanted: tuple[object, ...] = (state.brand, state.limit_mm)
        seen: dict[str, Any]
        if state.kind == "touch":
            seen = {name: sample.place.rig_mm for name, sample in counted.items() if sample.place is not None}
        else:
            seen = {name: sample.view for name, sample in counted.items() if sample.view is not None}
            mount = "eye-to-hand" if state.mount == "fixed" else "eye-in-hand"
            wanted = (parse_boards(state.board)[0], state.brand, mount, state.limit_mm)
        samples = {name: (np.array(place), state.numbers[name]) for name, place in seen.items()}
        try:
            if rig is None or rig.calibration_id != state.calibration_id:
                raise CalibrationError("the cell has another calibration by now: begin another registration")
            judged: Judged = await self._worker.run(f"judge_{state.kind}", rig, samples, *wanted)
        except EdgedError as error:
            return Judged(trouble=Trouble(code="refused", text=str(error)))
        return judged

    async def _keep_look(self, opened: OpenRegistration, pair: FramePair, job: str | None) -> None:
        rig, draft, worker = self._needed_rig(), opened.draft, self._worker
        async with self.drafts.changing(opened):
            order = (draft.folder, draft.next_look, pair.images, rig)
            looked: LookState
            if job is None:
                looked = await worker.run("marks_to_touch", *order, parse_boards(draft.state.board)[0])
            else:
                looked = await worker.run("features_to_touch", *order, self._cell.job(job))
            await asyncio.to_thread(draft.look, looked)

    async def _keep_pose(
        self, opened: OpenRegistration, pair: FramePair, numbers: tuple[float, ...] | None
    ) -> DraftHead:
        rig, draft = self._needed_rig(), opened.draft
        async with self.drafts.changing(opened):
            name, board = draft.next_sample, parse_boards(draft.state.board)[0]
            images = pair.images
            sample: SampleState = await self._worker.run(
                "pose_with_board", draft.folder, name, images, rig, board
            )
            await asyncio.to_thread(draft.add, name, sample, numbers)
        return self.drafts.publish(opened)

    def _needed_rig(self) -> RigInUse:
        rig = self._cell.rig()
        if rig is None:
            raise CalibrationError("there is no calibration to register: calibrate first")
        return rig

    # --- the topic of `drafts` -----------------------------------------------------------------------

    def opened(self, draft: RobotDraft) -> OpenRegistration:
        """Open a draft for work."""
        opened = OpenRegistration(draft)
        inputs, compute = partial(self._judged_by, opened), partial(self._judged, opened)
        opened.judge = Latest(Judged(), inputs, compute, partial(self.drafts.publish, opened))
        return opened

    def _judged_by(self, opened: OpenRegistration) -> tuple[object, ...]:
        """Inputs that a verdict depends on."""
        state, rig = opened.draft.state, self._cell.rig()
        numbers = tuple((name, state.numbers.get(name)) for name in state.used)
        return numbers, state.brand, state.mount, state.limit_mm, None if rig is None else rig.content

    def refresh(self, opened: OpenRegistration) -> None:
        """Judge the samples that count."""
        opened.judge.refresh()

    async def stop(self, opened: OpenRegistration) -> None:
        """Stop judging."""
        await opened.judge.stop()

    def summary(self, state: RegistrationState) -> dict[str, Any]:
        """A draft in the list."""
        about = {"kind": state.kind, "mount": state.mount, "samples": len(state.used)}
        return {**about, "active": is_active(state, self._cell.rig())}

    def document(self, opened: OpenRegistration) -> RegistrationDocument:
        """Full document of a draft."""
        judge, rig = opened.judge, self._cell.rig()
        return document_of(opened.draft.state, judge.value, rig, opened.solved, judging=judge.is_running)


def _solved(folder: Path, digest: str) -> StereoRig | None:
    """The rig that a draft was solved to; None if its file was changed since, or cannot be read."""
    with suppress(FileFormatError):
        return _read_solved(folder, digest)
    return None


@lru_cache(maxsize=4)
def _read_solved(folder: Path, digest: str) -> StereoRig:
    return rig_of(solved_rig(folder, digest, "samples"), folder)


def _read(state: RegistrationState, given: Given, count: int | None = None) -> tuple[float, ...]:
    """Parse the numbers of a point or a pose. Raises `UserError` for another count than it needs."""
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
