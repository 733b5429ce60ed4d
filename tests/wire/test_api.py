"""The routes of /api/v1: their OpenAPI document, and that every route checks every visitor alike."""

from __future__ import annotations

import pytest
from helpers.everyroute import BASIC, check_document, check_questions, check_roles
from helpers.waiting import until
from helpers.webcell import USERS, running

from edged.adapters.web.routes import Body, Leased, RouteTable
from edged.domain.cell import CellPhase


async def test_the_document_names_every_route_with_its_models() -> None:
    """The document is valid OpenAPI 3.1 with the expected routes, and forbids unknown fields in bodies."""
    async with running() as cell:
        document = await check_document(cell)
        asked = {f"{method} {path}" for path, methods in document["paths"].items() for method in methods}
        assert {"get /api/v1/cell", "post /api/v1/setup", "delete /api/v1/users/{name}"} <= asked
        entering = document["components"]["schemas"]["Entering"]
        assert not entering["additionalProperties"]


async def test_every_route_lets_in_who_may_and_nobody_else() -> None:
    """Each user can use exactly their role's routes, and a refusal reveals nothing else about a route."""
    async with running() as cell:
        await check_roles(cell, {"": "viewer", **USERS})


async def test_every_route_asks_every_visitor_the_same_questions() -> None:
    """A missing session, forged origin, wrong type, excess size and missing lease have codes of their own."""
    async with running() as cell:
        assert await check_questions(cell) >= 15


async def test_who_has_the_cell_is_in_the_overview() -> None:
    """The overview names the lease's holder and whether it is this session, and the state without one."""
    async with running() as cell:
        await until(lambda: cell.ear.state() is CellPhase.READY)
        await cell.log_in()
        _, me = await cell.ask("GET", "/api/v1/me", None)
        assert {"name": "Anna", "role": "engineer", "language": None, "idle": False} == me
        _, shown = await cell.ask("GET", "/api/v1/cell", None)
        assert ("cell1", "READY", None) == (shown["name"], shown["state"], shown["setup"])
        assert {"owner": None, "auto_lock": False} == shown["plc"]
        _, entered = await cell.ask("POST", "/api/v1/setup", {"name": "Anna"})
        _, shown = await cell.ask("GET", "/api/v1/cell", None)
        expected = {"name": "Anna", "unattended": False, "yours": True, "source": "person"}
        assert ("SETUP", expected) == (shown["state"], shown["setup"])
        assert (204, None) == await cell.ask("PUT", "/api/v1/setup/lease", entered)
        cell.session.cookie_jar.clear()
        _, shown = await cell.ask("GET", "/api/v1/cell", None, Authorization=BASIC)
        assert {**expected, "yours": False} == shown["setup"]


def test_a_row_of_the_table_that_contradicts_itself_is_a_bug() -> None:
    """A lease route without a token in its body, and a route that exists already, raise ValueError."""

    async def nothing(_call: object) -> None:
        pass

    table = RouteTable()
    with pytest.raises(ValueError, match="token"):
        table.route("POST", "/x", nothing, "x", body=Body, needs_lease=True)
    table.route("POST", "/x", nothing, "x", body=Leased, needs_lease=True)
    with pytest.raises(ValueError, match="already"):
        table.route("POST", "/x", nothing, "x")
    assert ["/api/v1/x"] == [route.plain_path for route in table]
    assert [204] == [route.status for route in table]
