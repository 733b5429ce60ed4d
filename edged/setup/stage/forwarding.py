"""Routes of the stage on a page in another process: requests are forwarded to the cell with the stage."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from typing import Any, cast

from pydantic import BaseModel, ValidationError

from edged.adapters.web.routes import Call, Problem, RouteTable, is_model, marks_of
from edged.errors import CommandRefused
from edged.identity.visitors import Role, Visitor
from edged.setup.stage.routes import StageRobotRoutes, StageRoutes

Ask = Callable[[str, dict[str, Any]], Awaitable[Mapping[str, Any]]]
"""Sends a request to the cell, as `METHOD path` with a body; returns `answer` or `problem`."""


class ForwardedStage:
    """Routes on the page's side, which forward requests."""

    def __init__(self, ask: Ask) -> None:
        self._ask = ask

    def add_to(self, table: RouteTable) -> None:
        """Add every route of the stage."""
        for routes in (StageRoutes, StageRobotRoutes):
            for row in marks_of(routes):
                handler = partial(self._forward, f"{row.method} {row.path}", row.answer)
                table.route(
                    row.method, row.path, handler, row.what, body=row.body, answer=row.answer, **row.options
                )

    async def _forward(self, route: str, answer: type[BaseModel] | None, call: Call[Any]) -> BaseModel | None:
        body = call.body.model_dump(mode="json") if isinstance(call.body, BaseModel) else {}
        found = await self._ask(route, body)
        if (problem := found.get("problem")) is not None:
            raise Problem(problem["status"], problem["code"], problem["detail"])
        return None if answer is None else answer.model_validate(_with_lists(found["answer"]))


class StageService:
    """Routes on the cell's side. Bodies are validated again, as a page may send anything."""

    def __init__(self, routes: Sequence[object]) -> None:
        self._rows = {
            f"{row.method} {row.path}": (row.body, getattr(held, row.name))
            for held in routes
            for row in marks_of(type(held))
        }

    async def answer(self, route: str, body: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out a request. Raises `CommandRefused` for an unknown route or an invalid body."""
        if route not in self._rows:
            raise CommandRefused("the stage has no such route")
        model, handler = self._rows[route]
        try:
            read = model.model_validate(body) if is_model(model) else None
        except ValidationError as error:
            raise CommandRefused(f"the stage cannot read the body: {error.error_count()} mistakes") from error
        try:
            answer = await handler(Call(Visitor("", Role.OPERATOR, ""), read, cast(Any, None)))
        except Problem as problem:
            return {"problem": {"status": problem.status, "code": problem.code, "detail": str(problem)}}
        return {"answer": None if answer is None else answer.model_dump(mode="json")}


def _with_lists(value: Any) -> Any:
    """Convert tuples from the link back to lists."""
    if isinstance(value, tuple):
        return [_with_lists(part) for part in value]
    if isinstance(value, dict):
        return {key: _with_lists(part) for key, part in value.items()}
    return value
