"""The routes by which a draft becomes what the cell runs by, and by which it goes back to a release."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from edged.adapters.web.routes import Answer, Body, Call, Reason, Token, route
from edged.identity.visitors import Role
from edged.setup.draftroutes import known
from edged.setup.drafts import OpenDrafts
from edged.setup.jobs.worker import Worker
from edged.setup.releases.differences import ReleaseDifference
from edged.setup.releases.releasefolder import Release, Tested
from edged.setup.releases.service import Activation


class Activating(Body):
    """Why; and the token, while somebody has the cell.

    signed : why it may become active though recorded cycles get worse by it, or were not tried.
    """

    token: Token | None = None
    note: Reason
    signed: Reason | None = None


class Returning(Body):
    """Why an older release becomes active again; and the token, while somebody has the cell."""

    token: Token | None = None
    reason: Reason


class ReleaseDocument(Answer):
    """A release. active : the cell runs by it. rig : its calibration id. tested : on recorded cycles."""

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
    """The youngest first."""

    releases: list[ReleaseDocument]


class ReleaseRoutes:
    """The routes."""

    def __init__(self, activation: Activation, worker: Worker) -> None:
        self._activation = activation
        self._worker = worker

    @route(
        "POST",
        "/releases/{number:[0-9]{1,6}}/activate",
        "Let the cell run by rig, cameras and jobs of a release again; settings stay",
        audit=True,
    )
    async def _return(self, call: Call[Returning]) -> ReleaseDocument:
        self._activation.check(call.body.token)
        number, body = int(call.part("number")), call.body
        call.trail.before = self._activation.fingerprint
        release = await known(self._activation.activate_again(number, call.visitor.name, body.reason))
        call.trail.after = release.fingerprint
        return document_of_release(release, is_active=True)

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


async def activated(
    activation: Activation,
    call: Call[Activating],
    solution: Callable[[str], Awaitable[bytes]],
    drafts: OpenDrafts[Any, Any, Any],
) -> ReleaseDocument:
    """Let the cell run by the rig that a draft was solved to. Raises as `Activation.activate`; `KeyError`."""
    activation.check(call.body.token)
    rig = await solution(call.part("id"))
    call.trail.before = activation.fingerprint
    release = await activation.activate(rig, call.visitor.name, call.body.note, signature(call))
    call.trail.after = release.fingerprint
    await drafts.tell_again(call.part("id"))
    return document_of_release(release, is_active=True)


def document_of_release(release: Release, *, is_active: bool) -> ReleaseDocument:
    """A release as it is answered."""
    fields = release.model_dump(exclude={"format", "version", "activated", "digests", "pictures"})
    was_active = bool(release.activated) or is_active
    return ReleaseDocument(**{**fields, "jobs": list(release.jobs)}, active=is_active, was_active=was_active)


def signature(call: Call[Activating]) -> str | None:
    """Why recorded cycles may get worse, if somebody signs for it; the audit has it beside the note."""
    body = call.body
    if body.signed is not None:
        call.trail.reason = f"{body.note}; signed: {body.signed}"
    return body.signed
