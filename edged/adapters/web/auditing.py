"""Audit of actions over the page: kept in a file, mirrored to the journal, readable by engineers."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import Any

from aiohttp import web
from pydantic import Field

from edged.adapters.web.routes import BASE, Answer, Body, Call, Route, route
from edged.connections import Rate, Rates
from edged.errors import FileFormatError, printable
from edged.identity.audit import LINES, AuditEntry, AuditFile
from edged.identity.visitors import Role
from edged.logs import LogLimit, fields

log = logging.getLogger(__name__)

REFUSED_PER_S, REFUSED_BURST = 1 / 60, 20.0
"""Refusals of one person beyond this rate are only counted and go to the journal alone: a viewer must not be
able to fill the audit until its oldest records are deleted; at this rate that takes months. Failed log-ins,
under any name, have a limit of their own: guessing passwords hides no other refusal."""
PERSON_PER_S, PERSON_BURST = 1 / 60, 60.0
"""Limit of one person's log-ins and of actions by anyone but an engineer."""
SAID_S = 60.0
"""Shortest time between two records of how many were left out."""
MAX_RECORDS = 500
RUN = "run"
"""Verb for a cell that runs with other files than before, no matter who changed them."""
WAIT_S = 5.0


class Asked(Body):
    """Which records to read."""

    after: int = Field(0, ge=0, description="those that follow this number")
    most: int = Field(100, ge=1, le=MAX_RECORDS)


class Record(Answer):
    """An action that was taken or attempted."""

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
    """Records of the audit. first : number of the oldest that is kept; count : of the newest.

    problem : null for a valid chain; else what is wrong with it, and no record after that is given.
    """

    records: list[Record]
    first: int
    count: int
    problem: str | None
    torn_bytes: int


class Auditor:
    """Records actions one after another, in its own thread. file : None: the journal alone.

    How many could not be kept is a record, too: of those beyond their rate, and of those that could not be
    written.
    """

    def __init__(self, file: AuditFile | None) -> None:
        self._file = file
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="audit")
        self._refused, self._allowed = Rates(REFUSED_PER_S, REFUSED_BURST), Rates(PERSON_PER_S, PERSON_BURST)
        self._failed_log_ins = Rate(REFUSED_PER_S, burst=REFUSED_BURST)
        self._left_out, self._saying = 0, Rate(1 / SAID_S, burst=1)
        self._lost, self._why = 0, ""
        self._limit = LogLimit(__name__)
        self._runs_by = ""
        self._is_closed = False

    async def note(self, route: Route, call: Call[Any], outcome: str) -> None:
        """Record a request to a route; waits up to `WAIT_S` for the disk."""
        trail = call.trail
        reason = trail.reason or getattr(call.body, "reason", None) or getattr(call.body, "note", None)
        place = call.request.path.removeprefix(f"{BASE}/")
        visitor = call.visitor
        deed = AuditEntry(
            user=visitor.name,
            role=visitor.role.word,
            address=visitor.address,
            verb=route.method,
            object=f"{place}/{trail.object}" if trail.object else place,
            outcome=outcome,
            before=trail.before,
            after=trail.after,
            reason=reason if isinstance(reason, str) else None,
        )
        if outcome == "ok" and visitor.role is Role.ENGINEER:
            await self._add(deed, None)
        else:
            await self._add(deed, (self._allowed if outcome == "ok" else self._refused).of(visitor.name))

    async def note_login(self, request: web.Request, name: str, verb: str, outcome: str) -> None:
        """Record a log-in or an attempt."""
        rate = self._allowed.of(name) if outcome == "ok" else self._failed_log_ins
        await self._add(AuditEntry(name, "", request.remote or "", verb, "page", outcome), rate)

    async def _add(self, deed: AuditEntry, rate: Rate | None) -> None:
        """Keep an action and mirror it; waits up to `WAIT_S` for the disk. rate : None: no limit."""
        if rate is not None and not rate.take():
            self._left_out += 1
            self._limit.warning("audit: %s", _text(deed))
            return
        if self._left_out and self._saying.take():
            self._say_left_out()
        # the action has been taken: it is recorded even if the client disconnects
        await asyncio.wait({asyncio.wrap_future(self.post(deed))}, timeout=WAIT_S)

    def _say_left_out(self) -> None:
        reason = f"{self._left_out} refusals and log-ins before this: more than are kept"
        self._left_out = 0
        self.post(AuditEntry("", "", "", "leave out", LINES, "rate", reason=reason))

    def post(self, deed: AuditEntry) -> Future[None]:
        """Keep an action without waiting for the disk; after `close` it goes to the journal alone."""
        if self._is_closed:
            log.info("audit: %s", _text(deed))
            done = Future[None]()
            done.set_result(None)
            return done
        return self._thread.submit(self._keep, deed)

    def note_run(self, fingerprint: str) -> None:
        """Record the fingerprint that the cell runs with, unless it is the last one recorded."""
        if self._file is None or self._is_closed or fingerprint == self._runs_by:
            return
        self._runs_by = fingerprint
        self._thread.submit(self._keep_run, self._file, fingerprint)

    async def close(self) -> None:
        """Wait until everything is on disk; further calls do nothing."""
        if self._is_closed:
            return
        if self._left_out:
            self._say_left_out()
        self._is_closed = True
        self._thread.submit(self._keep_lost)
        await asyncio.to_thread(self._thread.shutdown, wait=True)

    def _keep(self, deed: AuditEntry) -> None:
        record: dict[str, Any] = {}
        if self._file is not None and self._keep_lost():
            try:
                record = self._file.add(deed)
            except OSError as error:
                self._lose(error)
        elif self._lost:
            self._lost += 1
        _mirror(deed, record)

    def _keep_lost(self) -> bool:
        """Try to record how many records were lost; True when none are outstanding."""
        if self._file is None or not self._lost:
            return True
        reason = f"{self._lost} records before this may be missing: {self._why}"
        deed = AuditEntry("", "", "", "lose", LINES, "disc", reason=reason)
        try:
            _mirror(deed, self._file.add(deed))
        except OSError:
            return False
        self._lost = 0
        return True

    def _lose(self, error: OSError) -> None:
        self._lost, self._why = self._lost + 1, error.strerror or str(error)
        log.error("the audit cannot be written: %s", error)

    def _keep_run(self, file: AuditFile, fingerprint: str) -> None:
        before: str | None = None
        with suppress(FileFormatError):  # a damaged file is reported when the audit is read
            runs = file.verify(lambda record: bool(record["verb"] == RUN), last=1).records
            before = next((run["after"] for run in runs), None)
        if before != fingerprint:
            self._keep(AuditEntry("", "", "", RUN, "cell", "ok", before=before, after=fingerprint))


def _mirror(deed: AuditEntry, record: Mapping[str, Any]) -> None:
    """Log an action to the journal, with number and hash of its record; 0 and "" for one that is not kept."""
    number, digest = int(record.get("number", 0)), str(record.get("hash", ""))
    log.info("audit: %s", _text(deed), extra=fields(audit=number, audit_hash=digest, user=deed.user))


def _text(deed: AuditEntry) -> str:
    who = f"{printable(deed.user) or 'nobody'} at {deed.address or 'the cell'}"
    why = f" ({printable(deed.reason)})" if deed.reason else ""
    return f"{deed.verb} {deed.object!r} by {who}: {deed.outcome}{why}"


class AuditRoutes:
    """Route that reads the audit."""

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
