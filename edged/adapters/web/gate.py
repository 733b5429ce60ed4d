"""Checks that every request to /api/v1 must pass before its handler is called, and responses to errors.

Requests that change the cell must come from a session of the page (a password is not enough: a scraper has
one) and from a page of this very host, in JSON of a limited size. Errors are problems (RFC 9457) with a
`code` for programs.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import math
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import replace
from functools import partial
from typing import Any

from aiohttp import web
from pydantic import BaseModel, ValidationError

from edged.adapters.web.auditing import Auditor
from edged.adapters.web.login import is_from_here, visitor_of
from edged.adapters.web.places import body_of
from edged.adapters.web.repeats import Repeats
from edged.adapters.web.routes import BASE, Call, Given, Problem, Route, RouteTable
from edged.domain.numerals import decimal
from edged.errors import (
    CalibrationError,
    CaptureError,
    CommandRefused,
    EdgedError,
    FileFormatError,
    ImageError,
    LinkError,
    RegressionNeeded,
    SetupRefused,
    TaskFailed,
    TaskTooLarge,
    TeachError,
    UserError,
)
from edged.identity.access import Access
from edged.identity.attempts import TooManyAttempts
from edged.identity.visitors import Role, Visitor
from edged.ports import Commissioner

log = logging.getLogger(__name__)

READ_S = 5.0
"""Time for a body of a few bytes to arrive; routes with a larger limit get more, by `SLOW_BYTES_PER_S`."""
SLOW_BYTES_PER_S = 250_000.0
STATUSES: tuple[tuple[type[EdgedError], int, str], ...] = (
    (SetupRefused, 409, "setup_refused"),
    (CommandRefused, 409, "command_refused"),
    (RegressionNeeded, 409, "regression"),
    (CalibrationError, 422, "calibration"),
    (TeachError, 422, "teach"),
    (ImageError, 422, "image"),
    (FileFormatError, 422, "file"),
    (UserError, 422, "input"),
    (TaskTooLarge, 422, "task_too_large"),
    (TaskFailed, 503, "task_failed"),
    (LinkError, 503, "no_cell"),
)
"""Errors of services with their statuses and codes; the first that matches applies."""
NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}


class Gate:
    """Serves the routes of a table. holds : whether a session has taken the cell."""

    def __init__(
        self,
        table: RouteTable,
        commissioner: Commissioner,
        access: Access,
        auditor: Auditor,
        holds: Callable[[str], bool],
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._repeats = Repeats(clock_s)
        self._table = table
        self._commissioner = commissioner
        self._access = access
        self._auditor = auditor
        self._holds = holds

    def add_to(self, router: web.UrlDispatcher) -> None:
        """Add the table's routes to a router."""
        for route in self._table:
            router.add_route(route.method, BASE + route.path, self._serving(route))

    def _serving(self, route: Route) -> Callable[[web.Request], Awaitable[web.StreamResponse]]:
        async def serve(request: web.Request) -> web.StreamResponse:
            visitor = visitor_of(self._access, request) or Visitor("", Role.VIEWER, request.remote or "")
            call: Call[Any] = Call(visitor, None, request)
            outcome = "broken_off"
            try:
                check_visitor(route, visitor, request)
                if route.changes and not route.is_by_itself:
                    self._access.note_activity(visitor.session)
                call = replace(call, body=await _body(route, request))
                self._check_lease(call)
                if route.changes:
                    do = partial(self._done, route, call)
                    response, is_repeat = await self._repeats.once(visitor, request, call.body, do)
                    outcome = "again" if is_repeat else "ok"
                else:
                    response, outcome = await self._done(route, call), "ok"
            except (Problem, TooManyAttempts, EdgedError, OSError) as error:
                problem = _problem(error)
                outcome = problem.code
                response = problem.response()
            finally:
                if route.audit:
                    await self._auditor.note(route, call, outcome)
            return response

        return serve

    def _check_lease(self, call: Call[Any]) -> None:
        """Check that a token comes from the session that holds the cell. Raises `Problem`."""
        if getattr(call.body, "token", None) is not None and not self._holds(call.visitor.session):
            raise Problem(409, "setup_refused", "the cell was not taken in this session, or not any more")

    async def _done(self, route: Route, call: Call[Any]) -> web.StreamResponse:
        if route.needs_lease:
            await self._commissioner.renew_setup(call.body.token)
        return _response(route, await route.handler(call))


def check_visitor(route: Route, visitor: Visitor, request: web.Request) -> None:
    """Check the session, role, origin and password that a route needs. Raises `Problem`."""
    if not visitor.session and (route.needs_origin or route.role > Role.VIEWER):
        raise Problem(403, "log_in", "log in on the page first: with a password alone you may only look")
    if visitor.is_idle and route.role > Role.VIEWER:
        raise Problem(403, "idle", "idle for ten minutes: enter your password again")
    if visitor.role < route.role:
        raise Problem(
            403,
            "role",
            f"only an {route.role.word} may: you are {visitor.role.word}",
            params={"needed": route.role.word, "role": visitor.role.word},
        )
    if route.needs_origin and not is_from_here(request):
        raise Problem(403, "origin", "the request came from a page of another host, or from none")
    if route.needs_password and not visitor.is_confirmed:
        raise Problem(
            403, "confirm", "enter your password again: this changes who may, or what the cell runs by"
        )


async def chunks(request: web.Request, limit_bytes: int) -> AsyncIterator[bytes]:
    """Yield a body piece by piece. Raises `Problem` when it is too large, too slow or damaged."""
    too_large = Problem(
        413, "too_large", f"expected {limit_bytes} bytes at most", params={"limit_bytes": limit_bytes}
    )
    if (request.content_length or 0) > limit_bytes:
        raise too_large
    size = 0
    try:
        async with asyncio.timeout(READ_S + limit_bytes / SLOW_BYTES_PER_S):
            async for chunk in body_of(request):
                size += len(chunk)
                if size > limit_bytes:
                    raise too_large
                yield chunk
    except TimeoutError as error:
        raise Problem(408, "slow", "the body did not arrive in time") from error
    except web.RequestPayloadError as error:
        raise Problem(400, "json", "the body is damaged") from error


async def _body(route: Route, request: web.Request) -> BaseModel | None:
    """Body, or query of a GET, as the route's model; None without a model. Raises `Problem`."""
    if route.body is None:
        return None
    try:
        if route.method == "GET":
            if len(set(request.query)) < len(request.query):
                raise Problem(400, "query", "expected each parameter once")
            body = route.body.model_validate_strings(dict(request.query))
            _check_numerals(body, request)
            return body
        if request.content_type != "application/json":
            raise Problem(415, "json", "expected Content-Type: application/json")
        data = b"".join([chunk async for chunk in chunks(request, route.limit_bytes)])
        if not data.lstrip().startswith(b"{"):
            raise Problem(400, "json", "expected a JSON object")
        return route.body.model_validate_json(data)
    except ValidationError as error:
        raise _invalid(error) from error


def _check_numerals(body: BaseModel, request: web.Request) -> None:
    """Check that numbers were written as such: pydantic also takes `1_0` and ` 10`. Raises `Problem`."""
    for name, text in request.query.items():
        value = getattr(body, name, None)
        if isinstance(value, int | float) and not isinstance(value, bool):
            try:
                decimal(text)
            except ValueError as error:
                raise Problem(400, "invalid", f"{name}: {error}", field=name) from None


def _invalid(error: ValidationError) -> Problem:
    """Problem for the first mistake, with its field; the others show only after it is corrected."""
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    if first["type"] == "json_invalid":
        return Problem(400, "json", "expected JSON")
    field = ".".join(map(str, first["loc"]))
    detail = first["msg"].removeprefix("Value error, ")
    return Problem(400, "invalid", f"{field}: {detail}" if field else detail, field=field or None)


def _response(route: Route, given: Given) -> web.StreamResponse:
    if isinstance(given, web.StreamResponse):
        return given
    if given is None:
        return web.Response(status=route.status)
    return web.Response(text=given.model_dump_json(), status=route.status, content_type="application/json")


def _problem(error: Problem | TooManyAttempts | EdgedError | OSError) -> Problem:
    """Problem that answers an error. Raises the error itself where it is a bug."""
    if isinstance(error, Problem):
        return error
    if isinstance(error, TooManyAttempts):
        return Problem(429, "wait", str(error), params={"wait_s": math.ceil(error.wait_s)})
    if isinstance(error, CaptureError):
        return Problem(503, code_of(error), str(error), params={"camera": error.camera})
    if isinstance(error, OSError):
        if error.errno not in NO_ROOM:
            raise error
        log.error("%s", error)
        return Problem(507, "storage", f"it cannot be kept: {error.strerror}")
    for kind, status, _ in STATUSES:
        if isinstance(error, kind):
            return Problem(status, code_of(error), str(error), params=getattr(error, "params", None) or None)
    raise error


def code_of(error: EdgedError) -> str:
    """Code of an error for programs, such as "calibration" or "calibration_swapped"; "" for a bug."""
    if isinstance(error, CaptureError):
        return f"camera_{error.code}"
    code = next((code for kind, _, code in STATUSES if isinstance(error, kind)), "")
    which = error.code if isinstance(error, UserError) else ""
    return f"{code}_{which}" if which else code
