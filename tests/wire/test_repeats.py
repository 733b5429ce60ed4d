"""A request that is repeated because its answer was lost is answered again, but not carried out twice."""

from __future__ import annotations

import asyncio

import pytest
from helpers.browsersession import PASSWORD
from helpers.webcell import running

from edged.adapters.web.repeats import KEPT, KEPT_S, MAX_LETTERS

USERS, NEW = "/api/v1/users", {"name": "Erna", "role": "viewer", "password": PASSWORD}


def again(key: str) -> dict[str, str]:
    """The idempotency header."""
    return {"Idempotency-Key": key}


@pytest.mark.slow
async def test_what_is_sent_again_is_answered_as_before() -> None:
    """A repeated request gets the same answer, also while the first runs; another one with its key is
    refused."""
    async with running(visitor="Anna") as cell:
        first, second = await asyncio.gather(
            *(cell.ask("POST", USERS, NEW, **again("erna")) for _ in range(2))
        )
        assert (201, first) == (first[0], second)
        assert first == await cell.ask("POST", USERS, NEW, **again("erna"))
        status, problem = await cell.ask("POST", USERS, {**NEW, "role": "operator"}, **again("erna"))
        assert (422, "key") == (status, problem["code"])
        status, problem = await cell.ask("POST", USERS, NEW, **again("another"))
        assert (409, "exists") == (status, problem["code"])
        _, told = await cell.ask("GET", "/api/v1/audit", None)
        outcomes = [one["outcome"] for one in told["records"] if one["verb"] == "POST"]
        assert ["again", "again", "exists", "key", "ok"] == sorted(outcomes)


async def test_what_was_refused_may_be_possible_later() -> None:
    """A refused request is carried out when it is repeated with the same key."""
    async with running(visitor="Anna") as cell:
        cell.cycle.lock_setup(True)
        assert 409 == (await cell.ask("POST", "/api/v1/setup", {}, **again("1")))[0]
        cell.cycle.lock_setup(False)
        assert 201 == (await cell.ask("POST", "/api/v1/setup", {}, **again("1")))[0]


@pytest.mark.slow
async def test_a_key_is_that_of_its_session_for_ten_minutes() -> None:
    """Keys belong to a session and expire, the oldest beyond a limit are dropped, and too long ones
    refused."""
    async with running(visitor="Ben") as cell:
        tongue = "/api/v1/me", {"language": "de"}
        assert 200 == (await cell.ask("PUT", *tongue, **again("1")))[0]
        await cell.log_in()
        status, _ = await cell.ask("PUT", "/api/v1/me", {"language": "en"}, **again("1"))
        assert 200 == status
        assert 400 == (await cell.ask("PUT", *tongue, **again("x" * (MAX_LETTERS + 1))))[0]
        assert 422 == (await cell.ask("PUT", *tongue, **again("1")))[0]
        for number in range(KEPT):
            await cell.ask("PUT", *tongue, **again(f"many {number}"))
        assert 200 == (await cell.ask("PUT", *tongue, **again("1")))[0]
        cell.sleep(KEPT_S + 1)
        assert 200 == (await cell.ask("PUT", "/api/v1/me", {"language": "en"}, **again("1")))[0]
