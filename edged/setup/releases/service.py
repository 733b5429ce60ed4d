"""Activates another rig or other jobs in a running cell, as a release. A failure leaves it as it was."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from edged.config.chosencameras import chosen_file, with_changes
from edged.config.chosenconnections import connections_file, with_password_of
from edged.errors import EdgedError, LinkError, SetupRefused, UserError
from edged.files.rig import rig_of
from edged.setup.inuse import CellInUse
from edged.setup.recordings.setups import RIG, Contents
from edged.setup.releases.archive import (
    Backup,
    Made,
    Parts,
    make,
    pack,
    parts_at,
    parts_of,
    rig_in,
    with_parts,
)
from edged.setup.releases.jobsfolder import Jobs, contents_with, pictures_in, without_pictures
from edged.setup.releases.releasefolder import Release, ReleaseFolder, Tested

log = logging.getLogger(__name__)


Gate = Callable[[Contents, str | None], Awaitable[Tested | None]]
"""Takes the files that the cell would measure with, and the signed reason why recorded cycles may get worse.

Returns the record of the test; raises `RegressionNeeded`.
"""


async def _open(_contents: Contents, _signed: str | None) -> None:
    """Gate of a cell that records nothing: lets everything pass."""


@dataclass(frozen=True, slots=True)
class Mandate:
    """Author and reason of an activation. signed : why recorded cycles may get worse. token : a lease's."""

    author: str
    note: str
    signed: str | None = None
    token: str | None = None


class Activation:
    """Activates rigs and jobs, one at a time; used on the cell's event loop.

    gate : called before anything is written.
    """

    def __init__(self, releases: ReleaseFolder, cell: CellInUse, gate: Gate = _open) -> None:
        self._releases = releases
        self._cell = cell
        self._gate = gate
        self._turn = asyncio.Lock()

    @property
    def _rig(self) -> Path:
        return self._cell.files.config.cell.rig

    @property
    def _jobs(self) -> Path:
        return self._cell.files.config.cell.jobs

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the cell."""
        return self._cell.files.fingerprint

    @property
    def active(self) -> int | None:
        """Number of the release that the cell runs with; None if the cell was changed by hand since."""
        fingerprint = self._cell.files.fingerprint
        found = (
            release.number
            for release in self._releases.all()
            if release.activated and release.fingerprint == fingerprint
        )
        return next(found, None)

    async def listed(self) -> tuple[list[Release], int | None]:
        """All releases, newest first, and the number of the active one."""
        return await asyncio.to_thread(lambda: (self._releases.all(), self.active))

    async def archives(self, *numbers: int) -> list[Path]:
        """Paths of releases' archives. Raises `KeyError`, `FileFormatError`."""
        return await asyncio.to_thread(lambda: [self._releases.file(number) for number in numbers])

    async def check(self, token: str | None) -> None:
        """Check that changes are allowed now, with or without this token. Raises `SetupRefused` if not."""
        if token is not None:
            await self._cell.session.renew_setup(token)
        elif holder := self._cell.session.holder:
            raise SetupRefused(f"{holder} has the cell")
        self._check_unlocked()

    def _check_unlocked(self) -> None:
        if self._cell.session.is_locked:
            raise SetupRefused("the plant runs: its PLC forbids changes (AUTO_LOCK is 1)")

    async def activate(self, rig: bytes, by: Mandate) -> Release:
        """Activate another rig, and the camera settings that are being tried with it; jobs stay.

        Raises `EdgedError`, `OSError`; then the cell keeps the former ones.
        """
        rig_of(rig, Path("the new rig"))
        return await self._activate(lambda there: replace(self._with_tried(there), rig=rig), by)

    async def activate_jobs(self, change: Callable[[Jobs], Jobs], by: Mandate) -> Release:
        """Activate other jobs. change : makes them from the present ones; may raise. Raises as `activate`."""
        return await self._activate(lambda there: replace(there, jobs=change(there.jobs)), by)

    async def keep_cameras(self, by: Mandate) -> None:
        """Activate the camera settings that are being tried. Raises as `activate`."""
        await self._activate_settings(self._with_tried, by)

    async def activate_connections(self, content: bytes | None, by: Mandate) -> None:
        """Activate other connections of PLCs and robots, and other settings; None: as configured.

        Raises as `activate`.
        """
        await self._activate_settings(lambda there: replace(there, connections=content), by)

    async def _activate_settings(self, change: Callable[[Parts], Parts], by: Mandate) -> None:
        """Activate settings as a release.

        Without one before the first calibration, and for a change of passwords alone, which no fingerprint
        covers.
        """
        async with self._turn:
            self._check_unlocked()
            there = await asyncio.to_thread(parts_at, self._rig, self._jobs)
            wanted = await asyncio.to_thread(change, there)
            if wanted.rig is None or await asyncio.to_thread(self._is_in_use, wanted):
                await self._hand_over(wanted, by)
                return
        await self._activate(change, by)

    def _is_in_use(self, wanted: Parts) -> bool:
        return with_parts(self._cell.path, wanted).fingerprint == self._cell.files.fingerprint

    def _with_tried(self, there: Parts) -> Parts:
        """Parts with the camera settings that are being tried. Raises `ConfigError`."""
        stated = {side: change.stated() for side, change in self._cell.session.camera_changes.items()}
        tried = {side: values for side, values in stated.items() if values}
        if not tried:
            return there
        return replace(there, cameras=with_changes(there.cameras, chosen_file(self._rig), tried))

    async def activate_again(self, number: int, by: Mandate) -> Release:
        """Activate rig, cameras, settings and jobs of an older release. Raises as `activate`, and `KeyError`.

        A release without jobs leaves the present ones. Replaced passwords are not restored. Going back is
        never blocked by recorded cycles: its reason counts as the signature.
        """
        kept = parts_of(await asyncio.to_thread(self._releases.open, number))
        jobs = await asyncio.to_thread(self._releases.jobs, number)
        file = connections_file(self._rig)

        def wanted(there: Parts) -> Parts:
            connections = with_password_of(kept.connections, there.connections, file)
            return Parts(kept.rig, kept.cameras, connections, jobs or there.jobs)

        note = f"what release {number} has: {by.note}"
        return await self._activate(wanted, replace(by, note=note, signed=by.note))

    async def activate_backup(self, taken: Backup, by: Mandate) -> Release:
        """Activate rig, cameras and jobs of an archive; settings stay. Raises as `activate`."""
        parts = parts_of(taken)

        def wanted(there: Parts) -> Parts:
            return Parts(parts.rig, parts.cameras, there.connections, parts.jobs or there.jobs)

        return await self._activate(wanted, by)

    async def _activate(self, wanted: Callable[[Parts], Parts], by: Mandate) -> Release:
        # shielded: it must be completed even if the client disconnects
        return await asyncio.shield(asyncio.create_task(self._in_turn(wanted, by), name="activate"))

    async def _in_turn(self, change: Callable[[Parts], Parts], by: Mandate) -> Release:
        async with self._turn:
            self._check_unlocked()
            former = await asyncio.to_thread(parts_at, self._rig, self._jobs)
            wanted = await asyncio.to_thread(change, former)
            made, again = await asyncio.to_thread(self._proven, wanted)
            tested = await self._gate(self._contents(wanted), by.signed)
            self._check_unlocked()
            release = again
            if release is None:
                release = await asyncio.to_thread(self._keep, made, wanted, former, by)
            # noted first: the cell may finish an installation cut off here, and it must count as active then
            await asyncio.to_thread(self._releases.note_active, release.number, datetime.now(UTC), tested)
            try:
                await self._hand_over(wanted, by)
            except LinkError:  # the cell's fingerprint will show whether it was installed
                raise
            except (EdgedError, OSError):
                await asyncio.to_thread(self._withdraw, release, is_new=again is None)
                raise
            await asyncio.to_thread(self._releases.prune)
            log.info("release %d is active: %s, by %s", release.number, by.note, by.author)
            return await asyncio.to_thread(self._releases.get, release.number)

    async def _hand_over(self, wanted: Parts, by: Mandate) -> None:
        """Hand the parts over to the cell, which installs them. Raises `EdgedError`, `OSError`."""
        archive = await asyncio.to_thread(lambda: pack(with_parts(self._cell.path, wanted)))
        await self._cell.running.install(archive, by.token, by.author, by.note)

    def _contents(self, wanted: Parts) -> Contents:
        """Files that the cell would measure with."""
        contents = contents_with(self._cell.files.contents, wanted.jobs)
        return contents if wanted.rig is None else {**contents, RIG: wanted.rig}

    def _proven(self, wanted: Parts) -> tuple[Made, Release | None]:
        """Backup of the cell with these parts, checked to load, and a release with the same fingerprint."""
        if wanted.rig is None:
            raise UserError("there is no calibration: calibrate first")
        made = make(self._cell.path, replace(wanted, jobs=without_pictures(wanted.jobs)))
        if made.backup.fingerprint == self._cell.files.fingerprint:
            raise UserError("the cell already runs with this")
        all_of_it = self._releases.all()
        return made, next(
            (release for release in all_of_it if release.fingerprint == made.backup.fingerprint), None
        )

    def _keep(self, made: Made, wanted: Parts, former: Parts, by: Mandate) -> Release:
        """Add a release of the new cell; also one of the present cell if it has none, so one can go back."""
        if self._cell.is_complete and self.active is None:
            found = make(self._cell.path, replace(former, jobs=without_pictures(former.jobs)))
            kept = self._add(found, former, Mandate("edged", "as it was found"), None)
            self._releases.note_active(kept.number, datetime.now(UTC))
        return self._add(made, wanted, by, self.active)

    def _add(self, made: Made, parts: Parts, by: Mandate, parent: int | None) -> Release:
        return self._releases.add(
            made,
            rig=_rig_id(made),
            author=by.author,
            note=by.note,
            parent=parent,
            now=datetime.now(UTC),
            pictures=pictures_in(parts.jobs),
        )

    def _withdraw(self, release: Release, *, is_new: bool) -> None:
        """Undo the activation of a release: delete a new one, restore the description of an old one."""
        if is_new:
            self._releases.forget(release.number)
        else:
            self._releases.restore(release)


def _rig_id(made: Made) -> str:
    """Calibration id of the rig in a backup."""
    return rig_of(rig_in(made.backup), Path("the rig of a release")).calibration_id
