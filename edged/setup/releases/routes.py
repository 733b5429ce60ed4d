"""Routes of releases, which make a draft active in the cell, and of the cell's jobs."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from pydantic import model_validator

from edged.adapters.web.routes import Answer, Body, Call, Reason, Token, route
from edged.identity.visitors import Role
from edged.setup.draftroutes import DraftRoutes, Nothing, known, unknown
from edged.setup.drafts import OpenDrafts
from edged.setup.jobs.worker import Worker
from edged.setup.releases.differences import ReleaseDifference
from edged.setup.releases.jobs import JobList, Jobs, VersionList
from edged.setup.releases.releasefolder import Release, Tested
from edged.setup.releases.service import Activation, Mandate
from edged.setup.teaching.model import JobName, Number


class Activating(Body):
    """Request to activate: the reason, and the token while there is a lease.

    signed : why it may become active although recorded cycles get worse with it, or were not tried.
    """

    token: Token | None = None
    note: Reason
    signed: Reason | None = None


AnyActivating = TypeVar("AnyActivating", bound=Activating)


class Returning(Body):
    """Request to activate an older release again: the reason, and the token while there is a lease."""

    token: Token | None = None
    reason: Reason


class ReleaseDocument(Answer):
    """A release. active : the cell uses it. rig : its calibration id. tested : on recorded cycles."""

    number: int
    created: str
    author: str
    note: str
    parent: int | None
    fingerprint: str
    rig: str
    jobs: list[str]
    active: bool
    was_active: bool
    tested: Tested | None


class ReleaseList(Answer):
    """All releases, newest first."""

    releases: list[ReleaseDocument]


class ReleaseRoutes:
    """Routes of releases."""

    def __init__(self, activation: Activation, worker: Worker) -> None:
        self._activation = activation
        self._worker = worker

    @route(
        "POST",
        "/releases/{number:[0-9]{1,6}}/activate",
        "Let the cell run by rig, cameras, settings and jobs of a release again",
        audit=True,
        needs_password=True,
    )
    async def _return(self, call: Call[Returning]) -> ReleaseDocument:
        await self._activation.check(call.body.token)
        asked = self._activation.activate_again(int(call.part("number")), mandate(call, call.body.reason))
        return await noted(call, self._activation.fingerprint, known(asked))

    @route(
        "GET",
        "/releases/{before:[0-9]{1,6}}..{after:[0-9]{1,6}}",
        "What is other in one release than in another: jobs, rig, cameras, settings",
        role=Role.VIEWER,
    )
    async def _compare(self, call: Call[None]) -> ReleaseDifference:
        numbers = (int(call.part(key)) for key in ("before", "after"))
        archives = await known(self._activation.archives(*numbers))
        difference: ReleaseDifference = await self._worker.run("compare_releases", *archives)
        return difference

    @route("GET", "/releases", "All releases", role=Role.VIEWER)
    async def _list(self, _call: Call[None]) -> ReleaseList:
        releases, active = await self._activation.listed()
        return ReleaseList(
            releases=[
                document_of_release(release, is_active=release.number == active) for release in releases
            ]
        )


def add_activation(
    routes: DraftRoutes, activate: Callable[[str, Call[Activating]], Awaitable[ReleaseDocument]], what: str
) -> None:
    """Add the route that makes a draft active in the cell; it asks for the user's own password."""
    routes.add(
        "POST",
        "/activate",
        activate,
        what,
        Activating,
        answer=ReleaseDocument,
        audit=True,
        needs_password=True,
    )


async def activated(
    activation: Activation,
    call: Call[Activating],
    solution: Callable[[str], Awaitable[bytes]],
    drafts: OpenDrafts[Any, Any, Any],
) -> ReleaseDocument:
    """Activate the rig that a draft was solved to. Raises as `Activation.activate`, and `KeyError`."""
    await activation.check(call.body.token)
    rig = await solution(call.part("id"))
    release = await noted(call, activation.fingerprint, activation.activate(rig, signed_mandate(call)))
    await drafts.republish(call.part("id"))
    return release


async def noted(call: Call[Any], fingerprint: str, asked: Awaitable[Release]) -> ReleaseDocument:
    """Await a release, with the fingerprints before and after it in the audit."""
    call.trail.before = fingerprint
    release = await asked
    call.trail.after = release.fingerprint
    return document_of_release(release, is_active=True)


def document_of_release(release: Release, *, is_active: bool) -> ReleaseDocument:
    """Document of a release, as routes return it."""
    fields = release.model_dump(exclude={"format", "version", "activated", "digests", "pictures"})
    was_active = bool(release.activated) or is_active
    return ReleaseDocument(**{**fields, "jobs": list(release.jobs)}, active=is_active, was_active=was_active)


def mandate(call: Call[Any], note: str, signed: str | None = None) -> Mandate:
    """Mandate of the caller, with their lease's token if they have one. note : why."""
    return Mandate(call.visitor.name, note, signed, call.body.token)


def signed_mandate(call: Call[AnyActivating]) -> Mandate:
    """Mandate with the signed reason why recorded cycles may get worse, if any; the audit records it too."""
    body = call.body
    if body.signed is not None:
        call.trail.reason = f"{body.note}; signed: {body.signed}"
    return mandate(call, body.note, body.signed)


JOB = "/jobs/{name:[A-Za-z0-9_][A-Za-z0-9_. +@=-]{0,127}}"


class Changing(Body):
    """Another name or number, or retire or bring back a job. note : why; default: the change itself.

    signed : why it is allowed although recorded cycles get worse with it.
    """

    token: Token | None = None
    new_name: JobName | None = None
    number: Number | None = None
    retired: bool | None = None
    note: Reason | None = None
    signed: Reason | None = None

    @model_validator(mode="after")
    def _is_consistent(self) -> Changing:
        is_change = self.new_name is not None or (self.number is not None and self.retired is None)
        if is_change == (self.retired is not None):
            raise ValueError("expected new_name or number, or retired: true, or false with another number")
        if self.retired and self.number is not None:
            raise ValueError("expected no number for what is retired")
        return self


class Copying(Body):
    """Name and number of the copy. number : default: a free one."""

    token: Token | None = None
    new_name: JobName
    number: Number | None = None
    note: Reason | None = None
    signed: Reason | None = None


class JobRoutes:
    """Routes of the cell's jobs."""

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
        needs_password=True,
    )
    async def _change(self, call: Call[Changing]) -> JobList:
        await self._activation.check(call.body.token)
        folder, body = call.part("name"), call.body
        call.trail.object = folder
        if body.signed is not None:
            call.trail.reason = f"{body.note or ''}; signed: {body.signed}".removeprefix("; ")
        if body.retired is None:
            wanted = [f"name {body.new_name}"] if body.new_name else []
            wanted += [f"number {body.number}"] if body.number else []
            note = body.note or f"{folder}: {', '.join(wanted)}"
            by = mandate(call, note, body.signed)
            asked = self._jobs.change(folder, by, name=body.new_name, number=body.number)
        elif body.retired:
            by = mandate(call, body.note or f"{folder} is retired", body.signed)
            asked = self._jobs.retire(folder, by)
        else:
            by = mandate(call, body.note or f"{folder} is in use again", body.signed)
            asked = self._jobs.bring_back(folder, by, number=body.number)
        await noted(call, self._activation.fingerprint, known(asked))
        return await self._jobs.listed()

    @route(
        "POST",
        f"{JOB}/duplicate",
        "The same job once more, under another name: as a release",
        status=201,
        audit=True,
        needs_password=True,
    )
    async def _copy(self, call: Call[Copying]) -> JobList:
        await self._activation.check(call.body.token)
        job, body = call.part("name"), call.body
        call.trail.object = body.new_name
        note = body.note or f"{body.new_name}, as {job}"
        by = mandate(call, note, body.signed)
        asked = self._jobs.copy(job, by, name=body.new_name, number=body.number)
        await noted(call, self._activation.fingerprint, known(asked))
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
        await self._command(call, self._jobs.take)

    @route(
        "POST",
        f"{JOB}/golden",
        "Measure, and keep where the one good part lies, for offsets; not while a PLC has the right to write",
        status=204,
        audit=True,
        needs_password=True,
    )
    async def _golden(self, call: Call[Nothing]) -> None:
        await self._command(call, self._jobs.keep_golden)

    async def _command(self, call: Call[Nothing], carry_out: Callable[[str], Awaitable[None]]) -> None:
        call.trail.object = call.part("name")
        try:
            await carry_out(call.part("name"))
        except KeyError:
            call.trail.object = ""
            raise unknown() from None
