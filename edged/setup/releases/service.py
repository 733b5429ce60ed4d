"""Another rig or other jobs for a running cell, as a release. A failure leaves the cell as it was."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from edged.config.chosencameras import chosen_file, read_chosen, with_changes
from edged.errors import EdgedError, FileFormatError, SetupRefused, UserError
from edged.files.atomic import make_folders, sync, write_atomically
from edged.files.rig import read_rig, rig_of
from edged.setup.inuse import CellInUse
from edged.setup.recordings.setups import RIG, Contents
from edged.setup.releases.archive import Made, RigFiles, make, rig_in
from edged.setup.releases.jobsfolder import (
    Jobs,
    contents_with,
    jobs_in,
    pictures_in,
    without_pictures,
    write_jobs,
)
from edged.setup.releases.releasefolder import Release, ReleaseFolder, Tested

log = logging.getLogger(__name__)


Gate = Callable[[Contents, str | None], Awaitable[Tested | None]]
"""Told what the cell would measure by, and why that may make recorded cycles worse, if somebody signs for it.

Returns what is kept of it; raises `RegressionNeeded`.
"""


async def _open(_contents: Contents, _signed: str | None) -> None:
    """The gate of a cell that records nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class _Parts:
    """What is exchanged of a cell: content of its files; None: there is none."""

    rig: bytes | None
    cameras: bytes | None
    jobs: Jobs


class Activation:
    """What makes rigs and jobs active, one after the other; used on the cell's event loop.

    gate : asked before anything is written.
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
        """The release that the cell runs by; None for one that was changed by hand since."""
        fingerprint = self._cell.files.fingerprint
        found = (
            release.number
            for release in self._releases.all()
            if release.activated and release.fingerprint == fingerprint
        )
        return next(found, None)

    async def listed(self) -> tuple[list[Release], int | None]:
        """All releases, the youngest first, and which of them is active."""
        return await asyncio.to_thread(lambda: (self._releases.all(), self.active))

    async def archives(self, *numbers: int) -> list[Path]:
        """Archives of releases. Raises `KeyError`, `FileFormatError`."""
        return await asyncio.to_thread(lambda: [self._releases.file(number) for number in numbers])

    async def check(self, token: str | None) -> None:
        """Raises `SetupRefused` when nothing may be changed now, by somebody without or with a token."""
        if token is not None:
            await self._cell.session.renew_setup(token)
        elif holder := self._cell.session.holder:
            raise SetupRefused(f"{holder} has the cell")
        self._check_unlocked()

    def _check_unlocked(self) -> None:
        if self._cell.session.is_locked:
            raise SetupRefused("the plant runs: its PLC forbids changes (AUTO_LOCK is 1)")

    async def activate(self, rig: bytes, author: str, note: str, signed: str | None = None) -> Release:
        """Let the cell run by another rig, and by the cameras that are tried with it; jobs stay.

        signed : why it may make recorded cycles worse. Raises `EdgedError`, `OSError`; then it runs by the
        former ones.
        """
        rig_of(rig, Path("the new rig"))

        def wanted(there: _Parts) -> _Parts:
            stated = {side: change.stated() for side, change in self._cell.session.camera_changes.items()}
            tried = {side: values for side, values in stated.items() if values}
            cameras = with_changes(there.cameras, chosen_file(self._rig), tried) if tried else there.cameras
            return replace(there, rig=rig, cameras=cameras)

        return await self._activate(wanted, author, note, signed)

    async def activate_jobs(
        self, change: Callable[[Jobs], Jobs], author: str, note: str, signed: str | None = None
    ) -> Release:
        """Let the cell have other jobs. change : of those it has; may refuse. Raises as `activate`."""
        return await self._activate(
            lambda there: replace(there, jobs=change(there.jobs)), author, note, signed
        )

    async def activate_again(self, number: int, author: str, reason: str) -> Release:
        """Let the cell run by rig, cameras and jobs of a release; settings stay. Raises `KeyError`, too.

        A release of before the first job says nothing of jobs. The way back is never barred: its reason is
        the signature.
        """
        files = rig_in(await asyncio.to_thread(self._releases.open, number))
        jobs = await asyncio.to_thread(self._releases.jobs, number)

        def wanted(there: _Parts) -> _Parts:
            return _Parts(files.rig, files.cameras, jobs or there.jobs)

        return await self._activate(wanted, author, f"what release {number} has: {reason}", reason)

    async def finish(self) -> None:
        """Do what a kill or a power cut has interrupted: rig and cameras are of one release again."""
        if await asyncio.to_thread(self._finish):
            log.warning("the daemon ended while it activated a release: finishing that now")
            await self._cell.reload()

    async def _activate(
        self, wanted: Callable[[_Parts], _Parts], author: str, note: str, signed: str | None
    ) -> Release:
        # the client may disconnect: it must not stay half done
        return await asyncio.shield(
            asyncio.create_task(self._in_turn(wanted, author, note, signed), name="activate")
        )

    async def _in_turn(
        self, change: Callable[[_Parts], _Parts], author: str, note: str, signed: str | None
    ) -> Release:
        async with self._turn:
            self._check_unlocked()
            former = await asyncio.to_thread(self._there)
            wanted = await asyncio.to_thread(change, former)
            made, again = await asyncio.to_thread(self._proven, wanted)
            tested = await self._gate(self._contents(wanted), signed)
            self._check_unlocked()
            release = again
            if release is None:
                release = await asyncio.to_thread(self._keep, made, wanted, former, author, note)
            await asyncio.to_thread(self._exchange, release, wanted, former, again is None, tested)
            refused = await self._cell.reload()
            if refused:
                await asyncio.to_thread(self._put_back, release, former, again is None)
                raise UserError(f"the cell cannot run with it, and goes on as before: {refused}")
            await asyncio.to_thread(self._releases.prune)
            log.info("release %d is active: %s, by %s", release.number, note, author)
            return await asyncio.to_thread(self._releases.get, release.number)

    def _contents(self, wanted: _Parts) -> Contents:
        """What the cell would measure by."""
        contents = contents_with(self._cell.files.contents, wanted.jobs)
        return contents if wanted.rig is None else {**contents, RIG: wanted.rig}

    def _there(self) -> _Parts:
        """What is exchanged, as it is now."""
        rig = read_rig(self._rig) if self._rig.exists() else None
        return _Parts(rig, read_chosen(self._rig), jobs_in(self._jobs))

    def _proven(self, wanted: _Parts) -> tuple[Made, Release | None]:
        """The cell to be, proven to load, beside the cell as it is; and the release that it is already."""
        if wanted.rig is None:
            raise UserError("there is no calibration: calibrate first")
        made = make(self._cell.path, RigFiles(wanted.rig, wanted.cameras), without_pictures(wanted.jobs))
        if made.backup.fingerprint == self._cell.files.fingerprint:
            raise UserError("the cell already runs with this")
        all_of_it = self._releases.all()
        return made, next(
            (release for release in all_of_it if release.fingerprint == made.backup.fingerprint), None
        )

    def _keep(self, made: Made, wanted: _Parts, former: _Parts, author: str, note: str) -> Release:
        """A release of the cell to be; and one of the cell as it is, if it is none: there is a way back."""
        if self._cell.is_complete and self.active is None:
            found = make(self._cell.path, jobs=without_pictures(former.jobs))
            kept = self._add(found, former, "edged", "as it was found", None)
            self._releases.note_active(kept.number, datetime.now(UTC))
        return self._add(made, wanted, author, note, self.active)

    def _add(self, made: Made, parts: _Parts, author: str, note: str, parent: int | None) -> Release:
        return self._releases.add(
            made,
            rig=_rig_id(made),
            author=author,
            note=note,
            parent=parent,
            now=datetime.now(UTC),
            pictures=pictures_in(parts.jobs),
        )

    def _exchange(
        self, release: Release, wanted: _Parts, former: _Parts, is_new: bool, tested: Tested | None
    ) -> None:
        """Write all of it where the configuration has it."""
        try:
            # first: what is cut off here is finished by the release, which must be known to have been active
            self._releases.note_active(release.number, datetime.now(UTC), tested)
            if _count(wanted, former) > 1:
                self._releases.note_underway(release.number)
            self._write(wanted, former)
            self._releases.note_underway(None)
        except (EdgedError, OSError):
            with contextlib.suppress(EdgedError, OSError):  # where nothing can be written, nothing was
                self._write(former, self._there())
            self._withdraw(release, is_new)
            raise

    def _put_back(self, release: Release, former: _Parts, is_new: bool) -> None:
        """Restore the files byte for byte."""
        self._write(former, self._there())
        self._withdraw(release, is_new)

    def _withdraw(self, release: Release, is_new: bool) -> None:
        """Undo that it became active."""
        self._releases.note_underway(None)
        if is_new:
            self._releases.forget(release.number)
        else:
            self._releases.restore(release)

    def _write(self, wanted: _Parts, there: _Parts) -> None:
        """Write the files of rig, cameras and jobs. there : what they hold.

        Each by itself is in one step, and every mixture loads: a daemon that starts between them finishes it.
        """
        try:
            make_folders(self._rig.parent)
            if wanted.cameras != there.cameras:
                _put(chosen_file(self._rig), wanted.cameras)
            if wanted.rig != there.rig:
                _put(self._rig, wanted.rig)
        except OSError as error:
            raise self._refused("cell.rig", self._rig, error) from error
        try:
            write_jobs(self._jobs, wanted.jobs, there.jobs)
        except OSError as error:
            raise self._refused("cell.jobs", self._jobs, error) from error

    def _refused(self, key: str, place: Path, error: OSError) -> FileFormatError:
        kind = "a file in" if key == "cell.rig" else "a folder in"
        return FileFormatError(
            f"{place}: the daemon cannot write there ({error.strerror or error}): let {key} of "
            f"{self._cell.path} name {kind} its state directory, for example "
            f"{self._cell.folder / place.name}, and reload"
        )

    def _finish(self) -> bool:
        number = self._releases.underway
        if number is None:
            return False
        try:
            files, there = rig_in(self._releases.open(number)), self._there()
            jobs = self._releases.jobs(number) or there.jobs
            self._write(_Parts(files.rig, files.cameras, jobs), there)
        except (KeyError, EdgedError, OSError) as error:
            # the message names the file: a traceback says no more
            log.error("the activation of release %d cannot be finished: %s", number, error)  # noqa: TRY400
            return False
        self._releases.note_underway(None)
        return True


def _rig_id(made: Made) -> str:
    """Id of the calibration."""
    return rig_of(rig_in(made.backup).rig, Path("the rig of a release")).calibration_id


def _count(first: _Parts, second: _Parts) -> int:
    """How many of the parts differ."""
    return (
        (first.rig != second.rig)
        + (first.cameras != second.cameras)
        + (dict(first.jobs) != dict(second.jobs))
    )


def _put(file: Path, content: bytes | None) -> None:
    if content is not None:
        write_atomically(file, content)
    elif file.exists():
        file.unlink()
        sync(file.parent)
