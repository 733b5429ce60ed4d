"""The table of /api/v1: its document, and that every route asks every visitor the same questions."""

from __future__ import annotations

import pytest
from helpers.everyroute import BASIC, check_document, check_questions, check_roles
from helpers.waiting import until
from helpers.webcell import USERS, running

from edged.adapters.web.routes import Body, Leased, RouteTable
from edged.domain.cell import CellPhase


async def test_the_document_names_every_route_with_its_models() -> None:
    """OpenAPI 3.1; what a body may not hold is said, too."""
    async with running() as cell:
        document = await check_document(cell)
        asked = {f"{method} {path}" for path, methods in document["paths"].items() for method in methods}
        assert {"get /api/v1/cell", "post /api/v1/setup", "delete /api/v1/users/{name}"} <= asked
        entering = document["components"]["schemas"]["Entering"]
        assert not entering["additionalProperties"]


async def test_every_route_lets_in_who_may_and_nobody_else() -> None:
    """With too little of a role, nothing else about a route is told."""
    async with running() as cell:
        await check_roles(cell, {"": "viewer", **USERS})


async def test_every_route_asks_every_visitor_the_same_questions() -> None:
    """No session, a forged origin, another type, too much, no lease: each with its code."""
    async with running() as cell:
        assert await check_questions(cell) >= 15


async def test_who_has_the_cell_is_in_the_overview() -> None:
    """With whether it is this very session; and what the cell is without anybody."""
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
    """A lease without a token; a route that is there already."""

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
