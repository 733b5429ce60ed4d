"""/api/v1/machine, /backup, /support: findings and repairs, backup and restore, support bundles."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from aiohttp import web
from pydantic import StringConstraints

from edged import __version__
from edged.adapters.web.gate import chunks
from edged.adapters.web.routes import Answer, Body, Call, route
from edged.errors import UserError
from edged.setup.draftroutes import Nothing
from edged.setup.machine.service import ArchiveSummary, Examination, MachineService
from edged.setup.releases.routes import Activating, ReleaseDocument, noted, signed_mandate

MOST_BYTES = 64 * 1024 * 1024
"""Largest archive: one with a hundred jobs has a tenth of it."""
Digest = Annotated[str, StringConstraints(pattern="^[0-9a-f]{64}$")]


class MachineCheck(Answer):
    """A check of `edged doctor`. verdict : ok, warn, bad or skip. mend : see `edged.doctor.findings`."""

    name: str
    verdict: str
    finding: str
    consequence: str
    remedy: str
    mend: str


class Findings(Answer):
    """The last examination. at : null if there was none yet. version : of edged. now : the machine's UTC."""

    at: str | None
    checks: list[MachineCheck]
    version: str
    now: str


class Mending(Body):
    """The repair to carry out."""

    what: Literal["reload", "secrets"]


class Restoring(Activating):
    """Activation of the archive that was checked, by its digest."""

    digest: Digest


class MachineRoutes:
    """Routes of the machine, of backups and of support bundles."""

    def __init__(self, machine: MachineService) -> None:
        self._machine = machine

    @route("GET", "/machine", "What edged doctor found on the machine the last time")
    async def _last(self, _call: Call[None]) -> Findings:
        return _findings(self._machine.last)

    @route("POST", "/machine/examination", "Let edged doctor look again; no picture is taken")
    async def _examine(self, _call: Call[Nothing]) -> Findings:
        return _findings(await self._machine.examine())

    @route(
        "POST",
        "/machine/mend",
        "Do what a finding needs: read the cell's files again, or take those with secrets from other users",
        audit=True,
        needs_password=True,
    )
    async def _mend(self, call: Call[Mending]) -> Findings:
        call.trail.object = call.body.what
        return _findings(await self._machine.mend(call.body.what))

    @route(
        "POST",
        "/backup",
        "All that the cell stands on, as edged backup writes it, with the hashes of its passwords",
        answer="application/gzip",
        audit=True,
        needs_password=True,
    )
    async def _back_up(self, _call: Call[Nothing]) -> web.Response:
        return _file(*await self._machine.backup(), "application/gzip")

    @route("PUT", "/backup", "Check an archive; its bytes are the body")
    async def _check(self, call: Call[None]) -> ArchiveSummary:
        archive = b"".join([chunk async for chunk in chunks(call.request, MOST_BYTES)])
        if not archive:
            raise UserError("an archive of no bytes")
        return await self._machine.check_archive(archive)

    @route(
        "POST",
        "/backup/activate",
        "Let the cell run by rig, cameras and jobs of the archive that was checked; settings stay",
        audit=True,
        needs_password=True,
    )
    async def _restore(self, call: Call[Restoring]) -> ReleaseDocument:
        call.trail.object = digest = call.body.digest
        return await noted(
            call, self._machine.fingerprint, self._machine.restore(digest, signed_mandate(call))
        )

    @route(
        "POST",
        "/support",
        "A bundle for who helps from afar: a failed cycle, findings, configuration; no password, no key",
        answer="application/zip",
        audit=True,
    )
    async def _support(self, _call: Call[Nothing]) -> web.Response:
        return _file(*await self._machine.support(), "application/zip")


def _findings(found: Examination | None) -> Findings:
    return Findings(
        at=None if found is None else found.at.isoformat(),
        checks=[] if found is None else [MachineCheck(**_known(check)) for check in found.checks],
        version=__version__,
        now=datetime.now(UTC).isoformat(),
    )


def _known(check: Mapping[str, str]) -> dict[str, Any]:
    """The known fields of a check, as `edged doctor` may be of another version."""
    return {name: check.get(name, "") for name in MachineCheck.model_fields}


def _file(name: str, content: bytes, kind: str) -> web.Response:
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return web.Response(body=content, content_type=kind, headers=headers)
