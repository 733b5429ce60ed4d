"""Taking the cell over HTTP: who may, from where, and its effect on the cell."""

from __future__ import annotations

import base64

import cv2
import numpy as np
import pytest
from helpers.browsersession import PASSWORD
from helpers.waiting import until
from helpers.webcell import running

from edged.domain.cell import CellPhase

CHANGING = (
    ("POST", "/api/v1/setup", {"name": "Anna"}),
    ("PUT", "/api/v1/setup/lease", {"token": "x"}),
    ("DELETE", "/api/v1/setup", {"name": "Anna"}),
    ("POST", "/api/v1/captures", {"token": "x"}),
)


async def test_somebody_takes_the_cell_looks_and_gives_it_back() -> None:
    """The state changes before the answer, and pictures are exactly those of the cameras."""
    async with running(visitor="Anna") as cell:
        status, entered = await cell.ask("POST", "/api/v1/setup", {"name": "Anna"})
        assert (201, CellPhase.SETUP) == (status, cell.ear.state())
        async with cell.session.get("/ready") as answer:
            assert (503, "setup by Anna") == (answer.status, (await answer.json())["error"])
        token = {"token": entered["token"]}
        assert (204, None) == await cell.ask("PUT", "/api/v1/setup/lease", token)
        status, taken = await cell.ask("POST", "/api/v1/captures", token)
        assert 201 == status
        for side in ("left", "right"):
            async with cell.session.get(taken[side]) as answer:
                image = cv2.imdecode(np.frombuffer(await answer.read(), np.uint8), cv2.IMREAD_UNCHANGED)
                assert np.array_equal(np.zeros((4, 4), np.uint8), image)
        assert (204, None) == await cell.ask("DELETE", "/api/v1/setup", token)
        await until(lambda: cell.ear.state() is CellPhase.READY)
    assert [] == cell.ear.snapshots()


async def test_two_people_are_told_of_each_other() -> None:
    """A second user is refused with the first one's name, and may take over, which ends the first token."""
    async with running(visitor="Anna") as cell:
        _, first = await cell.ask("POST", "/api/v1/setup", {"name": "Anna"})
        status, refused = await cell.ask("POST", "/api/v1/setup", {"name": "Ben"})
        assert (409, "setup_refused", "Anna has the cell") == (status, refused["code"], refused["detail"])
        status, second = await cell.ask("POST", "/api/v1/setup", {"name": "Ben", "take_over": True})
        assert 201 == status
        status, refused = await cell.ask("POST", "/api/v1/captures", {"token": first["token"]})
        assert (409, "Ben has the cell") == (status, refused["detail"])
        status, _ = await cell.ask("POST", "/api/v1/captures", {"token": second["token"]})
        assert 201 == status
        assert (204, None) == await cell.ask("DELETE", "/api/v1/setup", {"name": "Carl"})
        await until(lambda: cell.ear.state() is CellPhase.READY)


async def test_a_dead_camera_and_an_old_picture_are_problems_with_a_code() -> None:
    """A picture that is too old and a dead camera give problems with a code and a sentence (RFC 9457)."""
    async with running(visitor="Anna") as cell:
        _, entered = await cell.ask("POST", "/api/v1/setup", {"name": "Anna"})
        for _ in range(5):
            _, taken = await cell.ask("POST", "/api/v1/captures", entered)
        for number, expected in (("1", 404), ("5", 200)):
            async with cell.session.get(taken["left"].replace("/5/", f"/{number}/")) as answer:
                assert expected == answer.status
        cell.head.broken = True
        status, problem = await cell.ask("POST", "/api/v1/captures", entered)
        assert (503, "camera_104") == (status, problem["code"])
        assert "unplugged" in problem["detail"]


@pytest.mark.parametrize("method, path, document", CHANGING)
async def test_nobody_changes_the_cell_but_from_the_page(
    method: str, path: str, document: dict[str, str]
) -> None:
    """Requests without a log-in, with a scraper's password, or from another or no origin are refused."""
    async with running() as cell:
        async with cell.session.request(method, path, json=document) as answer:
            assert 401 == answer.status
        basic = "Basic " + base64.b64encode(f"edged:{PASSWORD}".encode()).decode()
        status, problem = await cell.ask(method, path, document, Authorization=basic)
        assert (403, "log_in") == (status, problem["code"])
        await cell.log_in()
        for origin in ("http://evil.example", "null", cell.origin.replace("http", "https"), ""):
            status, problem = await cell.ask(method, path, document, Origin=origin)
            assert (403, "origin") == (status, problem["code"])
        sent = {"Origin": cell.origin}
        async with cell.session.request(method, path, json=document) as answer:
            assert (403, "origin") == (answer.status, (await answer.json())["code"])
        async with cell.session.request(method, path, data=document, headers=sent) as answer:
            assert 415 == answer.status
    ear = cell.ear
    assert CellPhase.SETUP not in {event.state for event in ear.events if hasattr(event, "setup_by")}


@pytest.mark.parametrize("method, path, document", CHANGING)
async def test_without_the_switch_there_is_no_such_route(
    method: str, path: str, document: dict[str, str]
) -> None:
    """With commissioning off, changing routes do not exist."""
    async with running(commissioning=False, visitor="") as cell:
        assert 404 == (await cell.ask(method, path, document))[0]


@pytest.mark.parametrize(
    "body, status, code, field",
    [
        (b"{", 400, "json", None),
        (b"[]", 400, "json", None),
        (b"[" * 4000, 400, "json", None),
        (b"\xff", 400, "json", None),
        (b'{"name": ""}', 400, "invalid", "name"),
        (b'{"name": "  "}', 400, "invalid", "name"),
        (b'{"name": "Anna", "colour": 1}', 400, "invalid", "colour"),
        (b'{"name": "Anna", "take_over": "yes"}', 400, "invalid", "take_over"),
        (b'{"name": 7}', 400, "invalid", "name"),
        (b'{"name": "a\\nb"}', 400, "invalid", "name"),
        (b'{"name": "' + b"a" * 65 + b'"}', 400, "invalid", "name"),
        (b'{"name": "' + b"a" * 5000 + b'"}', 413, "too_large", None),
    ],
)
async def test_what_is_no_request_is_said(body: bytes, status: int, code: str, field: str | None) -> None:
    """The problem names the invalid field, and the cell is not taken."""
    async with running(visitor="Anna") as cell:
        headers = {"Origin": cell.origin, "Content-Type": "application/json"}
        async with cell.session.post("/api/v1/setup", data=body, headers=headers) as answer:
            assert status == answer.status
            assert "application/problem+json" == answer.content_type
            problem = await answer.json()
            assert (code, field) == (problem["code"], problem.get("field"))
        assert CellPhase.SETUP is not cell.ear.state()


async def test_the_plant_that_runs_is_named() -> None:
    """With AUTO_LOCK the answer is 409, and READY stays."""
    async with running(visitor="Anna") as cell:
        cell.cycle.lock_setup(True)
        status, problem = await cell.ask("POST", "/api/v1/setup", {"name": "Anna"})
        assert 409 == status
        assert "AUTO_LOCK" in problem["detail"]
        await until(lambda: cell.ear.state() is CellPhase.READY)
