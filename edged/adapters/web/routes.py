"""The routes of /api/v1 as one table: what each takes and returns, and who may use it.

Handlers make no check that the table can state: role, origin, type, size and form of the body, and the lease
are checked before they are called (`gate`). The OpenAPI document (`openapi`) and the test of every route with
every role are generated from the same table.
"""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass, field
from typing import (
    Annotated,
    Any,
    Generic,
    NamedTuple,
    TypedDict,
    TypeGuard,
    TypeVar,
    Unpack,
    get_args,
    get_type_hints,
)

from aiohttp import web
from pydantic import AfterValidator, BaseModel, ConfigDict, StringConstraints

from edged.domain.arrays import Side
from edged.errors import without_folders
from edged.identity.visitors import Role, Visitor
from edged.payload import Json

BASE = "/api/v1"
LIMIT_BYTES = 4096
"""Default size limit of a body."""
WEBSOCKET = "websocket"
"""`Route.answer` of a route that becomes a WebSocket."""
_MARK = "_route"
_PARAMETER = re.compile(r"\{(\w+)(?::([^{}]*(?:\{[0-9,]+\}[^{}]*)*))?\}")


class Problem(Exception):
    """Error response to a request (RFC 9457).

    code : for programs, and for the page, which has its own text for it. field : of the body.
    params : values that such a text needs.
    """

    def __init__(
        self, status: int, code: str, detail: str, *, field: str | None = None, params: Json | None = None
    ) -> None:
        self.status = status
        self.code = code
        self.field = field
        self.params = params
        super().__init__(detail)

    def response(self) -> web.Response:
        """Return it as an HTTP response."""
        document: Json = {"status": self.status, "code": self.code, "detail": without_folders(str(self))}
        if self.field is not None:
            document["field"] = self.field
        if self.params is not None:
            document["params"] = self.params
        return web.json_response(document, status=self.status, content_type="application/problem+json")


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("expected printable characters, on one line")
    return text


Name = Annotated[str, StringConstraints(min_length=1, max_length=64), AfterValidator(_printable)]
"""Name of a person or a thing, one line."""
Reason = Annotated[str, StringConstraints(min_length=1, max_length=500), AfterValidator(_printable)]
"""Reason for an action, one line."""
Token = Annotated[str, StringConstraints(min_length=1, max_length=64), AfterValidator(_printable)]
"""Token of a lease of the cell."""


class Body(BaseModel):
    """Body of a request, of a GET the query: no further fields, strict types, texts of limited length."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, str_strip_whitespace=True, allow_inf_nan=False
    )


class Leased(Body):
    """Request by the holder of the cell."""

    token: Token


class Answer(BaseModel):
    """Body of a response; can be made from any object with the same attributes."""

    model_config = ConfigDict(
        frozen=True, from_attributes=True, json_schema_serialization_defaults_required=True
    )


B = TypeVar("B")


@dataclass(slots=True)
class Trail:
    """Details of a request for the audit, besides path, body and outcome; handlers fill in what they know.

    object : name of what was made. before, after : hash of what was changed. reason : default: the body's.
    """

    object: str = ""
    before: str | None = None
    after: str | None = None
    reason: str | None = None


@dataclass(frozen=True, slots=True)
class Call(Generic[B]):
    """A request that has passed every check of its route."""

    visitor: Visitor
    body: B
    request: web.Request
    trail: Trail = field(default_factory=Trail)

    def part(self, name: str) -> str:
        """Return a parameter of the path."""
        return self.request.match_info[name]

    @property
    def side(self) -> Side:
        """Camera that the path names by its parameter `side`."""
        return "left" if self.part("side") == "left" else "right"


Given = BaseModel | web.StreamResponse | None
Handler = Callable[[Call[Any]], Awaitable[Given]]


class RouteOptions(TypedDict, total=False):
    """Optional fields of a route; see `Route`."""

    role: Role
    status: int
    audit: bool
    needs_lease: bool
    needs_password: bool
    limit_bytes: int
    is_by_itself: bool


@dataclass(frozen=True, slots=True)
class Route:
    """One row of the table.

    path : below /api/v1, with parameters in aiohttp's syntax, `{number:[0-9]{1,9}}`.
    what : one line for the OpenAPI document. role : the lowest that is allowed.
    body : model of the JSON object, for a GET of the query; None: the handler reads the body itself, up to
    limit_bytes, with `gate.chunks`. answer : a model, a media type, `WEBSOCKET`, or None.
    status : of a success; default: 200, or 204 without an answer.
    audit : recorded with its outcome, also when refused. needs_lease : the body's `token` must be that of the
    lease, which the request extends. needs_password : the visitor must have entered theirs in the last
    minutes. is_by_itself : pages send it without a user's action.
    """

    method: str
    path: str
    handler: Handler
    what: str
    body: type[BaseModel] | None
    answer: type[BaseModel] | str | None
    status: int
    role: Role = Role.ENGINEER
    audit: bool = False
    needs_lease: bool = False
    needs_password: bool = False
    limit_bytes: int = LIMIT_BYTES
    is_by_itself: bool = False

    @property
    def changes(self) -> bool:
        """Whether it changes anything; then it needs a session and a page of our own."""
        return self.method != "GET"

    @property
    def needs_origin(self) -> bool:
        """Whether to check the origin, since a foreign page could ask in a user's name.

        That includes WebSockets, which browsers open to any host.
        """
        return self.changes or self.answer == WEBSOCKET

    @property
    def parameters(self) -> list[tuple[str, str]]:
        """Name and pattern ("": none) of each parameter of the path."""
        return _PARAMETER.findall(self.path)

    @property
    def plain_path(self) -> str:
        """Full path, its parameters without patterns."""
        return BASE + _PARAMETER.sub(r"{\1}", self.path)


H = TypeVar("H", bound=Callable[..., Awaitable[Given]])


def route(
    method: str, path: str, what: str, *, answer: str | None = None, **options: Unpack[RouteOptions]
) -> Callable[[H], H]:
    """Mark a method with one argument, a `Call`, as the handler of a `Route`.

    Its annotations give the body, `Call[Body]`, and the answer, if that is a model.
    """

    def mark(handler: H) -> H:
        vars(handler)[_MARK] = (method, path, what, answer, options)
        return handler

    return mark


def is_model(kind: Any) -> TypeGuard[type[BaseModel]]:
    """Whether an annotation is a model."""
    return isinstance(kind, type) and issubclass(kind, BaseModel)


class RouteMark(NamedTuple):
    """A method marked by `route`. name : of the method. answer : a model, a media type or None."""

    name: str
    method: str
    path: str
    what: str
    body: Any
    answer: Any
    options: RouteOptions


def marks_of(kind: type) -> Iterator[RouteMark]:
    """Marked methods of a class."""
    for name, handler in vars(kind).items():
        if (mark := getattr(handler, _MARK, None)) is not None:
            method, path, what, media, options = mark
            body, answer = _body_and_answer(handler)
            yield RouteMark(name, method, path, what, body, media or answer, options)


def _body_and_answer(handler: Callable[..., Any]) -> tuple[Any, Any]:
    """Body and answer in a handler's annotations; the answer is None if it is not a model."""
    types = get_type_hints(handler)
    returned = types.pop("return")
    (taken,) = (get_args(call) for call in types.values())
    return (taken[0] if taken else None), (returned if is_model(returned) else None)


class RouteTable:
    """Every route of the API."""

    def __init__(self) -> None:
        self._routes: dict[tuple[str, str], Route] = {}

    def __iter__(self) -> Iterator[Route]:
        return iter(self._routes.values())

    def add(self, *several: object) -> None:
        """Add the methods marked by `route`; an object may also have an `add_to(table)`, which is called."""
        for routes in several:
            for row in marks_of(type(routes)):
                handler = getattr(routes, row.name)
                self.route(
                    row.method, row.path, handler, row.what, body=row.body, answer=row.answer, **row.options
                )
            if (add_to := getattr(routes, "add_to", None)) is not None:
                add_to(self)

    def route(
        self,
        method: str,
        path: str,
        handler: Callable[[Call[B]], Awaitable[Given]],
        what: str,
        *,
        body: type[B] | None = None,
        answer: type[BaseModel] | str | None = None,
        **options: Unpack[RouteOptions],
    ) -> None:
        """Add a route. Raises `ValueError` if it needs a lease but takes no token, and for a duplicate."""
        model = body if is_model(body) else None
        if options.get("needs_lease") and (model is None or "token" not in model.model_fields):
            raise ValueError(f"{method} {path}: a route with a lease takes a token")
        if (method, path) in self._routes:
            raise ValueError(f"{method} {path}: is there already")
        options.setdefault("status", 200 if answer is not None else 204)
        self._routes[method, path] = Route(method, path, handler, what, model, answer, **options)
