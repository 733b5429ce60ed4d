"""The audit of what is done over the page: kept in its file, mirrored to the journal, read by engineers."""

from __future__ import annotations

import asyncio
import logging
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import Any

from aiohttp import web
from pydantic import Field

from edged.adapters.web.routes import BASE, Answer, Body, Call, Route, route
from edged.connections import Rate
from edged.errors import FileFormatError
from edged.identity.audit import AuditEntry, AuditFile, shown
from edged.logs import LogLimit, fields

log = logging.getLogger(__name__)

REFUSED_PER_S, REFUSED_BURST = 1 / 60, 20.0
"""Refusals beyond this rate go to the journal alone: somebody who may only look must not fill the audit, so
that its oldest records are deleted; at this rate that takes months."""
MAX_RECORDS = 500
RUN = "run"
"""The cell runs with other files than before, no matter who changed them."""
WAIT_S = 5.0


class Asked(Body):
    """Which records."""

    after: int = Field(0, ge=0, description="those that follow this number")
    most: int = Field(100, ge=1, le=MAX_RECORDS)


class Record(Answer):
    """What somebody did, or tried to."""

    number: int
    time: str
    user: str
    role: str
    address: str
    verb: str
    object: str
    outcome: str
    before: str | None
    after: str | None
    reason: str | None
    hash: str


class AuditNow(Answer):
    """first : number of the oldest that is kept; count : of the newest.

    problem : null for a chain that holds; else why it does not, and nothing after that is given.
    """

    records: list[Record]
    first: int
    count: int
    problem: str | None
    torn_bytes: int


class Auditor:
    """Notes deeds, one after another, in a thread of its own. file : None: the journal alone."""

    def __init__(self, file: AuditFile | None) -> None:
        self._file = file
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="audit")
        self._refused = Rate(REFUSED_PER_S, burst=REFUSED_BURST)
        self._limit = LogLimit(__name__)
        self._runs_by = ""
        self._is_closed = False

    async def note(self, route: Route, call: Call[Any], outcome: str) -> None:
        """A request to a route; on the disc when this returns, if that is possible at all."""
        trail = call.trail
        reason = trail.reason or getattr(call.body, "reason", None) or getattr(call.body, "note", None)
        place = call.request.path.removeprefix(f"{BASE}/")
        await self.add(
            AuditEntry(
                user=call.visitor.name,
                role=call.visitor.role.word,
                address=call.visitor.address,
                verb=route.method,
                object=f"{place}/{trail.object}" if trail.object else place,
                outcome=outcome,
                before=trail.before,
                after=trail.after,
                reason=reason if isinstance(reason, str) else None,
            )
        )

    async def note_login(self, request: web.Request, name: str, verb: str, outcome: str) -> None:
        """Note a log-in or an attempt."""
        await self.add(AuditEntry(name, "", request.remote or "", verb, "page", outcome))

    async def add(self, deed: AuditEntry) -> None:
        """Keep a deed, and mirror it; on the disc when this returns."""
        if deed.outcome != "ok" and not self._refused.take():
            self._limit.warning("audit: %s", _text(deed))
            return
        # the deed is done: it is noted even after a disconnect
        await asyncio.wait({asyncio.wrap_future(self.post(deed))}, timeout=WAIT_S)

    def post(self, deed: AuditEntry) -> Future[None]:
        """Keep a deed without waiting for the disc; after `close` it goes to the journal alone."""
        if self._is_closed:
            log.info("audit: %s", _text(deed))
            done = Future[None]()
            done.set_result(None)
            return done
        return self._thread.submit(self._keep, deed)

    def note_run(self, fingerprint: str) -> None:
        """What the cell runs by, where it was not noted last: also what a command or an editor changed."""
        if self._file is None or self._is_closed or fingerprint == self._runs_by:
            return
        self._runs_by = fingerprint
        self._thread.submit(self._keep_run, self._file, fingerprint)

    async def close(self) -> None:
        """Wait until everything is on the disc."""
        self._is_closed = True
        await asyncio.to_thread(self._thread.shutdown, wait=True)

    def _keep(self, deed: AuditEntry) -> None:
        number, digest = 0, ""
        if self._file is not None:
            try:
                record = self._file.add(deed)
                number, digest = int(record["number"]), str(record["hash"])
            except OSError as error:
                log.error("the audit cannot be written: %s", error)  # noqa: TRY400  (it says where)
        log.info("audit: %s", _text(deed), extra=fields(audit=number, audit_hash=digest, user=deed.user))

    def _keep_run(self, file: AuditFile, fingerprint: str) -> None:
        before: str | None = None
        with suppress(FileFormatError):  # reading the audit reports it
            runs = file.verify(lambda record: bool(record["verb"] == RUN), last=1).records
            before = next((run["after"] for run in runs), None)
        if before != fingerprint:
            self._keep(AuditEntry("", "", "", RUN, "cell", "ok", before=before, after=fingerprint))


def _text(deed: AuditEntry) -> str:
    who = f"{shown(deed.user) or 'nobody'} at {deed.address or 'the cell'}"
    why = f" ({shown(deed.reason)})" if deed.reason else ""
    return f"{deed.verb} {deed.object!r} by {who}: {deed.outcome}{why}"


class AuditRoutes:
    """The routes of an audit that is kept."""

    def __init__(self, file: AuditFile) -> None:
        self._file = file

    @route("GET", "/audit", "Who did what")
    async def _read(self, call: Call[Asked]) -> AuditNow:
        after, most = call.body.after, call.body.most
        verdict = await asyncio.to_thread(
            self._file.verify, lambda record: bool(after < record["number"] <= after + most)
        )
        return AuditNow(
            records=[Record.model_validate(record) for record in verdict.records],
            first=verdict.first,
            count=verdict.count,
            problem=verdict.problem or None,
            torn_bytes=verdict.torn_bytes,
        )
