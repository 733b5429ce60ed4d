"""The audit of what is done over the page: kept in its file, mirrored to the journal, read by engineers."""

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
"""Refusals of a person beyond this rate are counted and go to the journal alone: who may only look must not
fill the audit, so that its oldest records are deleted; at this rate that takes months. Log-ins that fail,
under whatever names, have as many of their own: guessing at passwords hides no other refusal."""
PERSON_PER_S, PERSON_BURST = 1 / 60, 60.0
"""Log-ins of a person, and what anybody but an engineer does."""
SAID_S = 60.0
"""Between two records of how many were left out."""
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
    """Notes deeds, one after another, in a thread of its own. file : None: the journal alone.

    What there is no room for is a record itself: deeds beyond their rate, and those that the disc refused.
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
        """A request to a route; on the disc when this returns, if that is possible at all."""
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
        """Note a log-in or an attempt."""
        rate = self._allowed.of(name) if outcome == "ok" else self._failed_log_ins
        await self._add(AuditEntry(name, "", request.remote or "", verb, "page", outcome), rate)

    async def _add(self, deed: AuditEntry, rate: Rate | None) -> None:
        """Keep a deed, and mirror it; on the disc when this returns. rate : None: it is kept always."""
        if rate is not None and not rate.take():
            self._left_out += 1
            self._limit.warning("audit: %s", _text(deed))
            return
        if self._left_out and self._saying.take():
            self._say_left_out()
        # the deed is done: it is noted even after a disconnect
        await asyncio.wait({asyncio.wrap_future(self.post(deed))}, timeout=WAIT_S)

    def _say_left_out(self) -> None:
        reason = f"{self._left_out} refusals and log-ins before this: more than are kept"
        self._left_out = 0
        self.post(AuditEntry("", "", "", "leave out", LINES, "rate", reason=reason))

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
        """Wait until everything is on the disc; a second time there is nothing to do."""
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
        """Keep how many records were lost, if the disc takes some again; whether none are any more."""
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
        with suppress(FileFormatError):  # reading the audit reports it
            runs = file.verify(lambda record: bool(record["verb"] == RUN), last=1).records
            before = next((run["after"] for run in runs), None)
        if before != fingerprint:
            self._keep(AuditEntry("", "", "", RUN, "cell", "ok", before=before, after=fingerprint))


def _mirror(deed: AuditEntry, record: Mapping[str, Any]) -> None:
    """Say a deed in the journal, with number and hash of its record; 0 and "" for one that is not kept."""
    number, digest = int(record.get("number", 0)), str(record.get("hash", ""))
    log.info("audit: %s", _text(deed), extra=fields(audit=number, audit_hash=digest, user=deed.user))


def _text(deed: AuditEntry) -> str:
    who = f"{printable(deed.user) or 'nobody'} at {deed.address or 'the cell'}"
    why = f" ({printable(deed.reason)})" if deed.reason else ""
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
