"""A new rig for a running cell, as a release, or an older one's. A failure leaves the cell as it was."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from edged.commissioning.releases import RigFiles, make, rig_in
from edged.commissioning.setups import RIG, Contents
from edged.commissioning.shelf import Release, Shelf, Tested
from edged.config.chosencameras import chosen_file, read_chosen, with_changes
from edged.domain.arrays import Side
from edged.errors import EdgedError, FileFormatError, SetupRefused, UserError
from edged.files.atomic import make_folders, read_bytes, sync, write_atomically
from edged.files.rig import rig_of
from edged.files.statefolder import state_folder

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class CellNow:
    """The cell as it runs. is_complete : it has rig and jobs.  cameras : what is tried of them in SETUP.

    locked : the plant forbids changes. holder : who has the cell, or "".
    contents : of the files that it measures by, as `CellFiles` has them.
    """

    rig: Path
    fingerprint: str
    is_complete: bool
    cameras: Mapping[Side, Mapping[str, str | float]]
    locked: bool
    holder: str
    contents: Contents = field(default_factory=dict)


Gate = Callable[[Contents, str | None], Awaitable[Tested | None]]
"""Told what the cell would measure by, and why that may make recorded cycles worse, if somebody signs for it.

Returns what is kept of it; raises `RegressionNeeded`.
"""


async def _open(_contents: Contents, _signed: str | None) -> None:
    """The gate of a cell that records nothing."""


class Activation:
    """What makes rigs active, one after the other; used on the cell's event loop.

    config : the cell's file.  running : the cell, as it is then.
    renew : raises `SetupRefused` for a token that is not that of who has the cell.
    reload : reads the configuration again; returns why it was refused, or "".
    gate : asked before anything is written.
    """

    def __init__(
        self,
        shelf: Shelf,
        config: Path,
        running: Callable[[], CellNow],
        renew: Callable[[str], None],
        reload: Callable[[], Awaitable[str]],
        gate: Gate = _open,
    ) -> None:
        self._shelf = shelf
        self._config = config
        self._running = running
        self._renew = renew
        self._reload = reload
        self._gate = gate
        self._turn = asyncio.Lock()

    @property
    def fingerprint(self) -> str:
        """Of what the cell runs by."""
        return self._running().fingerprint

    @property
    def active(self) -> int | None:
        """The release that the cell runs by; None for one that was changed by hand since."""
        fingerprint = self._running().fingerprint
        found = (one.number for one in self._shelf.all() if one.activated and one.fingerprint == fingerprint)
        return next(found, None)

    async def listed(self) -> tuple[list[Release], int | None]:
        """All releases, the youngest first, and which of them is active."""
        return await asyncio.to_thread(lambda: (self._shelf.all(), self.active))

    def check(self, token: str | None) -> None:
        """Raises `SetupRefused` when nothing may be changed now, by somebody without or with a token."""
        if token is not None:
            self._renew(token)
        elif holder := self._running().holder:
            raise SetupRefused(f"{holder} has the cell")
        self._check_unlocked()

    def _check_unlocked(self) -> None:
        if self._running().locked:
            raise SetupRefused("the plant runs: its PLC forbids changes (AUTO_LOCK is 1)")

    async def activate(self, rig: bytes, author: str, note: str, signed: str | None = None) -> Release:
        """Let the cell run by another rig, and by the cameras that are tried with it.

        signed : why it may make recorded cycles worse. Raises `EdgedError`, `OSError`; then it runs by the
        former ones.
        """
        running = self._running()
        file = chosen_file(running.rig)
        cameras = await asyncio.to_thread(read_chosen, running.rig)
        if running.cameras:
            cameras = with_changes(cameras, file, running.cameras)
        return await self._activate(RigFiles(rig, cameras), author, note, signed)

    async def activate_again(self, number: int, author: str, reason: str) -> Release:
        """The same by rig and cameras of a release; jobs and settings stay. Raises `KeyError`, too.

        The way back is never barred: its reason is the signature.
        """
        files = rig_in(await asyncio.to_thread(self._shelf.open, number))
        return await self._activate(files, author, f"the rig of release {number}: {reason}", reason)

    async def finish(self) -> None:
        """Do what a kill or a power cut has interrupted: rig and cameras are of one release again."""
        if await asyncio.to_thread(self._finish):
            log.warning("a release was being activated when the daemon ended: that is finished now")
            await self._reload()

    async def _activate(self, files: RigFiles, author: str, note: str, signed: str | None) -> Release:
        # whoever asked may go away: half done it must not stay
        doing = asyncio.create_task(self._in_turn(files, author, note, signed), name="activate")
        return await asyncio.shield(doing)

    async def _in_turn(self, files: RigFiles, author: str, note: str, signed: str | None) -> Release:
        async with self._turn:
            self._check_unlocked()
            tested = await self._gate({**self._running().contents, RIG: files.rig}, signed)
            release, is_new = await asyncio.to_thread(self._prepare, files, author, note)
            former = await asyncio.to_thread(self._exchange, release, files, is_new, tested)
            refused = await self._reload()
            if refused:
                await asyncio.to_thread(self._put_back, release, former, is_new)
                raise UserError(f"the cell does not run by it, and runs on as before: {refused}")
            await asyncio.to_thread(self._shelf.prune)
            log.info("release %d is active: %s, by %s", release.number, note, author)
            return await asyncio.to_thread(self._shelf.get, release.number)

    def _prepare(self, files: RigFiles, author: str, note: str) -> tuple[Release, bool]:
        """The release to be, proven to load, beside the cell as it is. False: it is on the shelf already."""
        calibration_id = rig_of(files.rig, Path("the new rig")).calibration_id
        made = make(self._config, files)
        running, now = self._running(), datetime.now(UTC)
        if made.backup.fingerprint == running.fingerprint:
            raise UserError("the cell runs by this rig already")
        if running.is_complete and self.active is None:
            found = make(self._config)
            as_found = rig_of(rig_in(found.backup).rig, running.rig).calibration_id
            kept = self._shelf.add(
                found, rig=as_found, author="edged", note="as it was found", parent=None, now=now
            )
            self._shelf.note_active(kept.number, now)
        again = next((one for one in self._shelf.all() if one.fingerprint == made.backup.fingerprint), None)
        if again is not None:
            return again, False
        release = self._shelf.add(
            made, rig=calibration_id, author=author, note=note, parent=self.active, now=now
        )
        return release, True

    def _exchange(self, release: Release, files: RigFiles, is_new: bool, tested: Tested | None) -> _Former:
        """Write rig and cameras where the configuration has them; returns what was there."""
        place = self._running().rig
        former: _Former | None = None
        try:
            former = _Former(read_bytes(place, "a rig") if place.exists() else None, read_chosen(place))
            # first: what is cut off here is finished by the release, which must be known to have been active
            self._shelf.note_active(release.number, datetime.now(UTC), tested)
            if former.cameras != files.cameras:
                self._shelf.note_underway(release.number)
            try:
                _write(place, files.rig, files.cameras, former.cameras)
            except OSError as error:
                raise FileFormatError(
                    f"{place}: the daemon cannot write there ({error.strerror or error}): let cell.rig of "
                    f"{self._config} name a file in its state directory, for example "
                    f"{state_folder(self._config) / 'rig.json'}, and reload"
                ) from error
            self._shelf.note_underway(None)
        except (EdgedError, OSError):
            if former is not None:
                with contextlib.suppress(OSError):  # where nothing can be written, nothing was
                    _write(place, former.rig, former.cameras, files.cameras)
            self._withdraw(release, is_new)
            raise
        return former

    def _put_back(self, release: Release, former: _Former, is_new: bool) -> None:
        """As before, in each byte."""
        place = self._running().rig
        _write(place, former.rig, former.cameras, read_chosen(place))
        self._withdraw(release, is_new)

    def _withdraw(self, release: Release, is_new: bool) -> None:
        """It never was active."""
        self._shelf.note_underway(None)
        if is_new:
            self._shelf.forget(release.number)
        else:
            self._shelf.restore(release)

    def _finish(self) -> bool:
        number = self._shelf.underway
        if number is None:
            return False
        place = self._running().rig
        try:
            files = rig_in(self._shelf.open(number))
            _write(place, files.rig, files.cameras, read_chosen(place))
        except (KeyError, EdgedError, OSError) as error:
            # the message names the file: a traceback says no more
            log.error("release %d was being activated, and cannot be: %s", number, error)  # noqa: TRY400
            return False
        self._shelf.note_underway(None)
        return True


@dataclass(frozen=True, slots=True, eq=False)
class _Former:
    """Content of the rig's file and of its cameras'; None: there was none."""

    rig: bytes | None
    cameras: bytes | None


def _write(place: Path, rig: bytes | None, cameras: bytes | None, there: bytes | None) -> None:
    """Let the rig's file and that of its cameras hold this. there : of the cameras by now."""
    make_folders(place.parent)
    if cameras != there:
        _put(chosen_file(place), cameras)
    _put(place, rig)


def _put(file: Path, content: bytes | None) -> None:
    if content is not None:
        write_atomically(file, content)
    elif file.exists():
        file.unlink()
        sync(file.parent)
