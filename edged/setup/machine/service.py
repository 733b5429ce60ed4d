"""Maintenance of a cell's machine on its page: findings, repairs, backup, restore, support bundles."""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any, Literal

from edged.config.chosenconnections import chosen_connections
from edged.errors import FileFormatError, UserError
from edged.files.atomic import make_folders, read_bytes, write_atomically
from edged.setup.cellfiles import CellFiles
from edged.setup.documents import Frozen
from edged.setup.inuse import CellInUse
from edged.setup.machine import bundle
from edged.setup.releases.archive import MAX_BYTES, Backup, fits_map, make, restored, unpack
from edged.setup.releases.releasefolder import Release
from edged.setup.releases.service import Activation, Mandate

UPLOADED = "uploaded.tar.gz"
PLACE = "the archive"


@dataclass(frozen=True, slots=True)
class Examination:
    """Findings in the order of the checks, and their time."""

    at: datetime
    checks: Sequence[Mapping[str, str]]


class ArchiveSummary(Frozen):
    """An archive that was checked. digest : identifies it for restoring. left_out : files that are not in it.

    jobs : their names. is_same : the cell already runs with it. fits_map : its Modbus map is the same as this
    version's.
    """

    digest: str
    cell: str
    created: str
    version: str
    rig: str
    jobs: list[str]
    files: int
    left_out: dict[str, str]
    is_same: bool
    fits_map: bool


class MachineService:
    """Maintenance of one cell's machine; used on the event loop."""

    def __init__(self, cell: CellInUse, activation: Activation) -> None:
        self._cell = cell
        self._activation = activation
        self.last: Examination | None = None

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the cell."""
        return self._cell.files.fingerprint

    async def examine(self) -> Examination:
        """Run `edged doctor`. Raises `CommandRefused`."""
        checks = await self._cell.running.examine()
        self.last = Examination(datetime.now(UTC), checks)
        return self.last

    async def mend(self, what: Literal["reload", "secrets"]) -> Examination:
        """Carry out a repair, and examine again. Raises `SetupRefused`, `CommandRefused`, `UserError`."""
        await self._cell.running.mend(what)
        return await self.examine()

    async def backup(self) -> tuple[str, bytes]:
        """Name and content of a new archive, checked by restoring it once. Raises `UserError`."""
        made = await asyncio.to_thread(make, self._cell.path)
        return f"{made.backup.cell}-{made.backup.created:%Y%m%d-%H%M}.tar.gz", made.archive

    async def check_archive(self, archive: bytes) -> ArchiveSummary:
        """Check an archive with all checksums, and keep it for restoring. Raises `FileFormatError`."""
        return await asyncio.to_thread(self._checked, archive)

    def _checked(self, archive: bytes) -> ArchiveSummary:
        taken = unpack(archive, PLACE)
        cell = restored(taken)
        if cell.rig is None:
            raise FileFormatError(f"{PLACE}: there is no calibration in it")
        make_folders(self._cell.folder)
        write_atomically(self._cell.folder / UPLOADED, archive, mode=0o600)
        return ArchiveSummary(
            digest=hashlib.sha256(archive).hexdigest(),
            cell=taken.cell,
            created=taken.created.isoformat(),
            version=taken.version,
            rig=cell.rig.calibration_id,
            jobs=sorted(job.name for job in cell.jobs) if isinstance(cell, CellFiles) else [],
            files=len(taken.files),
            left_out=dict(taken.left_out),
            is_same=taken.fingerprint == self._cell.files.fingerprint,
            fits_map=fits_map(taken),
        )

    async def restore(self, digest: str, by: Mandate) -> Release:
        """Activate rig, cameras and jobs of the archive that was checked last.

        Raises as `Activation.activate`, and `UserError` if another one was checked meanwhile.
        """
        await self._activation.check(by.token)
        taken = await asyncio.to_thread(self._uploaded, digest)
        release = await self._activation.activate_backup(taken, by)
        (self._cell.folder / UPLOADED).unlink(missing_ok=True)
        return release

    def _uploaded(self, digest: str) -> Backup:
        file = self._cell.folder / UPLOADED
        archive = read_bytes(file, PLACE, MAX_BYTES) if file.exists() else b""
        if hashlib.sha256(archive).hexdigest() != digest:
            raise UserError(f"{PLACE}: another one was chosen meanwhile, or it was restored: choose it again")
        return unpack(archive, PLACE)

    async def support(self) -> tuple[str, bytes]:
        """Name and content of a bundle for remote support: a failed cycle, without passwords and keys.

        Raises `CommandRefused`, `UserError`.
        """
        found = self.last or await self.examine()
        releases, active = await self._activation.listed()
        now = datetime.now(UTC)
        content = await asyncio.to_thread(self._bundle, found, releases, active, now)
        return f"{self._cell.files.config.cell.name}-support-{now:%Y%m%d-%H%M}.zip", content

    def _bundle(
        self, found: Examination, releases: Sequence[Release], active: int | None, now: datetime
    ) -> bytes:
        document = self._document(found, releases, active, now)
        return bundle.pack(document, bundle.failed_cycle(self._cell.recordings))

    def _document(
        self, found: Examination, releases: Sequence[Release], active: int | None, now: datetime
    ) -> dict[str, Any]:
        files, summary = self._cell.files, self._cell.running.summary
        chosen = chosen_connections(files.config.cell.rig).model_dump(mode="json")
        if chosen["opcua"]:
            chosen["opcua"].pop("password_hash", None)
        rig = json.loads(files.contents.get("rig.json", b"{}"))
        return {
            **bundle.about(self._cell.folder, files, now),
            "missing": summary.overview.missing,
            "facts": summary.facts,
            "jobs": summary.jobs,
            "plc": None if summary.plc is None else asdict(summary.plc),
            "chosen": chosen,
            "calibration": rig.get("quality"),
            "active_release": active,
            "releases": [
                release.model_dump(mode="json", exclude={"digests", "pictures"}) for release in releases
            ],
            "examined": found.at.isoformat(),
            "checks": found.checks,
        }
