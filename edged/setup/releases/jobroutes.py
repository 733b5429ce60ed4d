"""The routes of the cell's jobs."""

from __future__ import annotations

from pydantic import model_validator

from edged.adapters.web.routes import Body, Call, Reason, Token, route
from edged.identity.visitors import Role
from edged.setup.draftroutes import Nothing, known, unknown
from edged.setup.releases.jobs import JobList, Jobs, VersionList
from edged.setup.releases.service import Activation
from edged.setup.teaching.model import JobName, Number

JOB = "/jobs/{name:[A-Za-z0-9_][A-Za-z0-9_. +@=-]{0,127}}"


class Changing(Body):
    """Another name or number, or whether it is in use. note : why; left out, what was asked for.

    signed : why it may be so though recorded cycles get worse by it.
    """

    token: Token | None = None
    new_name: JobName | None = None
    number: Number | None = None
    retired: bool | None = None
    note: Reason | None = None
    signed: Reason | None = None

    @model_validator(mode="after")
    def _one_thing(self) -> Changing:
        is_change = self.new_name is not None or (self.number is not None and self.retired is None)
        if is_change == (self.retired is not None):
            raise ValueError("expected new_name or number, or retired: true, or false with another number")
        if self.retired and self.number is not None:
            raise ValueError("expected no number for what is retired")
        return self


class Copying(Body):
    """Name and number of the copy; number : left out: one that is free."""

    token: Token | None = None
    new_name: JobName
    number: Number | None = None
    note: Reason | None = None
    signed: Reason | None = None


class JobRoutes:
    """The routes."""

    def __init__(self, jobs: Jobs, activation: Activation) -> None:
        self._jobs = jobs
        self._activation = activation

    @route("GET", "/jobs", "All jobs, and how they do", role=Role.VIEWER)
    async def _list(self, _call: Call[None]) -> JobList:
        return await self._jobs.listed()

    @route(
        "PUT",
        JOB,
        "Rename a job, give it another number, retire it or bring it back: as a release",
        audit=True,
    )
    async def _change(self, call: Call[Changing]) -> JobList:
        self._activation.check(call.body.token)
        folder, body, author = call.part("name"), call.body, call.visitor.name
        call.trail.object, call.trail.before = folder, self._activation.fingerprint
        if body.signed is not None:
            call.trail.reason = f"{body.note or ''}; signed: {body.signed}".removeprefix("; ")
        if body.retired is None:
            wanted = [f"name {body.new_name}"] if body.new_name else []
            wanted += [f"number {body.number}"] if body.number else []
            note = body.note or f"{folder}: {', '.join(wanted)}"
            asked = self._jobs.change(
                folder, author, note, body.signed, name=body.new_name, number=body.number
            )
        elif body.retired:
            asked = self._jobs.retire(folder, author, body.note or f"{folder} is retired", body.signed)
        else:
            note = body.note or f"{folder} is in use again"
            asked = self._jobs.bring_back(folder, author, note, body.signed, number=body.number)
        call.trail.after = (await known(asked)).fingerprint
        return await self._jobs.listed()

    @route(
        "POST",
        f"{JOB}/duplicate",
        "The same job once more, under another name: as a release",
        status=201,
        audit=True,
    )
    async def _copy(self, call: Call[Copying]) -> JobList:
        self._activation.check(call.body.token)
        job, body = call.part("name"), call.body
        call.trail.object, call.trail.before = body.new_name, self._activation.fingerprint
        note = body.note or f"{body.new_name}, as {job}"
        asked = self._jobs.copy(
            job, call.visitor.name, note, body.signed, name=body.new_name, number=body.number
        )
        call.trail.after = (await known(asked)).fingerprint
        return await self._jobs.listed()

    @route("GET", f"{JOB}/versions", "The releases that changed a job", role=Role.VIEWER)
    async def _versions(self, call: Call[None]) -> VersionList:
        return await known(self._jobs.versions(call.part("name")))

    @route(
        "POST",
        f"{JOB}/use",
        "Measure by this job from the next cycle on; not while a PLC has the right to write",
        role=Role.OPERATOR,
        status=202,
        audit=True,
    )
    async def _take(self, call: Call[Nothing]) -> None:
        call.trail.object = call.part("name")
        try:
            self._jobs.take(call.part("name"))
        except KeyError:
            call.trail.object = ""
            raise unknown() from None
