"""The table of /api/v1: its document, and that every route asks every visitor the same questions."""

from __future__ import annotations

import asyncio
import base64
import re
from typing import Any

import pytest
from scriptedhead import until
from webcell import PASSWORD, USERS, Cell, run

from edged.adapters.web.routes import Body, Leased, RouteTable
from edged.domain.cell import CellPhase

ROLES = ("viewer", "operator", "engineer")
PARAMETERS, FITTING = re.compile(r"\{(\w+)\}"), {"side": "left", "name": "nobody"}
BASIC = "Basic " + base64.b64encode(f"edged:{PASSWORD}".encode()).decode()


async def document_of(cell: Cell) -> dict[str, Any]:
    """As the cell gives it."""
    async with cell.session.get("/api/v1/openapi.json", headers={"Authorization": BASIC}) as answer:
        assert 200 == answer.status
        return dict(await answer.json())


def operations(document: dict[str, Any]) -> list[tuple[str, str, dict[str, Any]]]:
    """Method, a path that fits, and what the document says of it."""
    found = []
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            found.append(
                (method.upper(), PARAMETERS.sub(lambda found: FITTING.get(found[1], "1"), path), operation)
            )
    return found


def test_the_document_names_every_route_with_its_models() -> None:
    """OpenAPI 3.1: each parameter of a path is told, each reference leads somewhere, no id comes twice."""

    async def test(cell: Cell) -> None:
        document = await document_of(cell)
        assert "3.1.0" == document["openapi"]
        names = [operation["operationId"] for _, _, operation in operations(document)]
        assert len(names) == len(set(names))
        assert {"get_cell", "get_me", "post_setup", "put_setup_lease", "delete_setup"} <= set(names)
        for path, methods in document["paths"].items():
            for operation in methods.values():
                told = {one["name"] for one in operation["parameters"] if one["in"] == "path"}
                assert {part[1:].partition("}")[0] for part in path.split("/") if part[:1] == "{"} <= told
        for place in references(document):
            found = document
            for name in place.removeprefix("#/").split("/"):
                found = found[name]
        entering = document["components"]["schemas"]["Entering"]
        assert not entering["additionalProperties"]

    run(test)


def references(part: Any) -> list[str]:
    """Every `$ref` in a document."""
    if isinstance(part, list):
        return [place for one in part for place in references(one)]
    if not isinstance(part, dict):
        return []
    here = [part["$ref"]] if isinstance(part.get("$ref"), str) else []
    return here + [place for one in part.values() for place in references(one)]


@pytest.mark.parametrize("name, role", [("", "viewer"), *USERS.items()])
def test_every_route_lets_in_who_may_and_nobody_else(name: str, role: str) -> None:
    """By the role that the document says; with too little of it, nothing else about the route is told."""

    async def test(cell: Cell) -> None:
        await cell.log_in(name)
        for method, path, operation in operations(await document_of(cell)):
            status, answer = await cell.ask(method, path, {} if method != "GET" else None)
            needed = operation["x-edged-role"]
            if ROLES.index(role) < ROLES.index(needed):
                assert (403, "role") == (status, answer["code"]), path
                assert {"needed": needed, "role": role} == answer["params"]
            else:
                assert 403 != status, path

    run(test)


def test_every_route_asks_every_visitor_the_same_questions() -> None:
    """In this order: who are you, from where, in what, how much; and a lease where a camera is used."""

    async def test(cell: Cell) -> None:
        asked = operations(await document_of(cell))
        assert len(asked) >= 15
        for method, path, _ in asked:
            assert 401 == (await cell.ask(method, path, {}))[0], path
        for method, path, operation in asked:
            if method != "GET" or operation["x-edged-role"] != "viewer":
                assert (403, "log_in") == await coded(cell, method, path, Authorization=BASIC), path
        await cell.log_in()
        for method, path, operation in asked:
            if method == "GET":
                continue
            for origin in ("http://evil.example", "null", ""):
                assert (403, "origin") == await coded(cell, method, path, Origin=origin), path
            if "requestBody" in operation:
                await refuse_bodies(cell, method, path, operation["x-edged-limit-bytes"])
            if operation["x-edged-lease"]:
                assert (400, "invalid") == await coded(cell, method, path), path
                status, problem = await cell.ask(method, path, {"token": "of nobody"})
                assert (status, problem["code"]) in ((409, "setup_refused"), (400, "invalid")), path

    run(test)


async def refuse_bodies(cell: Cell, method: str, path: str, limit_bytes: int) -> None:
    """Of another type; too large, whether that is told before or not; of no JSON; of what is not known."""
    own = {"Origin": cell.origin}
    async with cell.session.request(method, path, data={"a": "b"}, headers=own) as answer:
        assert 415 == answer.status, path
    large = b'{"a": "' + b"x" * limit_bytes + b'"}'
    bodies = ((large, 413, "too_large"), (pieces(large), 413, "too_large"), (b"[]", 400, "json"))
    for data, status, code in (*bodies, (b"{", 400, "json"), (b'{"colour": 1}', 400, "invalid")):
        headers = {**own, "Content-Type": "application/json"}
        async with cell.session.request(method, path, data=data, headers=headers) as answer:
            assert (status, code) == (answer.status, (await answer.json())["code"]), path


async def coded(cell: Cell, method: str, path: str, **headers: str) -> tuple[int, str]:
    """Status and code of the problem."""
    status, problem = await cell.ask(method, path, {}, **headers)
    return status, problem["code"]


async def pieces(data: bytes) -> Any:
    """A body whose length is not told before."""
    for start in range(0, len(data), 1000):
        yield data[start : start + 1000]
        await asyncio.sleep(0)


def test_who_has_the_cell_is_in_the_overview() -> None:
    """With whether it is this very session; and what the cell is without anybody."""

    async def test(cell: Cell) -> None:
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

    run(test)


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
