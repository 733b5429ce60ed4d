"""Password guessing over HTTP: few guesses are possible, and they lock out nobody else."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import aiohttp
import pytest
from helpers.browsersession import PASSWORD, BrowserSession
from helpers.waiting import LIMIT_S, until
from helpers.webcell import Cell, running

import edged.identity.access
from edged.adapters.web import server

HOUR_S = 3600.0
STEP_S = 5.0


@asynccontextmanager
async def somebody_at(cell: Cell, address: str) -> AsyncIterator[BrowserSession]:
    """Another browser session, from an address of its own."""
    connector = aiohttp.TCPConnector(local_addr=(address, 0))
    jar = aiohttp.CookieJar(unsafe=True)
    async with aiohttp.ClientSession(cell.origin, connector=connector, cookie_jar=jar) as session:
        yield BrowserSession(session)


async def attempt(browser: BrowserSession, name: str, password: str) -> int:
    """Status of a log-in: 303 if the password was checked, 429 if not."""
    form = {"name": name, "password": password}
    headers = {"Origin": browser.origin}
    async with browser.session.post("/login", data=form, headers=headers, allow_redirects=False) as answer:
        return answer.status


@pytest.mark.long
async def test_an_own_password_buys_no_guesses_at_that_of_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """Alternating wrong passwords with an own correct one allows two dozen guesses an hour, not thousands."""
    guesses = list[str]()
    is_password = edged.identity.access.is_password

    def counted(stored: str, password: str) -> bool:
        guesses.extend([password] if password != PASSWORD else [])
        return is_password(stored, password)

    monkeypatch.setattr("edged.identity.access.is_password", counted)
    monkeypatch.setattr(server, "REQUESTS_AT_ONCE", 10_000)  # an hour passes here in seconds
    async with running() as cell:
        for turn in range(int(HOUR_S / STEP_S)):
            for _ in range(4):
                await attempt(cell, "Anna", f"guess {turn}")
            await attempt(cell, "Vera", PASSWORD)
            cell.sleep(STEP_S)
    assert 5 <= len(guesses) <= 24


@pytest.mark.slow
async def test_one_account_is_not_guessed_at_from_many_addresses() -> None:
    """After twenty guesses all addresses wait, except one from which the owner has logged in before."""
    async with running(visitor="Anna") as cell:
        statuses = list[int]()
        for n in range(2, 32):
            async with somebody_at(cell, f"127.0.0.{n}") as stranger:
                statuses.append(await attempt(stranger, "Anna", "guess"))
        assert [303] * 20 + [429] * 10 == statuses
        async with somebody_at(cell, "127.0.0.99") as stranger:
            assert 429 == await attempt(stranger, "anna", PASSWORD)
            assert 303 == await attempt(stranger, "Otto", PASSWORD)
            assert 429 == await attempt(stranger, "Anna", PASSWORD)
        assert 303 == await attempt(cell, "Anna", PASSWORD)


async def test_nobody_waits_behind_one_who_floods_the_log_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """While one address floods the log-in, another is served next, as the flooder has one place in the
    queue."""
    looked_at = list[str]()
    may_go_on = threading.Semaphore(0)

    def slow(_: str, password: str) -> bool:
        looked_at.append(password)
        assert may_go_on.acquire(timeout=LIMIT_S)
        return password == PASSWORD

    async with running() as cell:
        monkeypatch.setattr("edged.identity.access.is_password", slow)
        async with somebody_at(cell, "127.0.0.9") as flooder, somebody_at(cell, "127.0.0.7") as other:
            flood = [asyncio.create_task(attempt(flooder, "Anna", f"guess {n}")) for n in range(4)]
            await until(lambda: len(looked_at) == 1)
            refused = (await asyncio.wait(flood, return_when=asyncio.FIRST_COMPLETED))[0]
            await until(lambda: sum(task.done() for task in flood) == 2)
            mine = asyncio.create_task(attempt(other, "Ben", PASSWORD))
            async with other.session.get("/health") as answer:  # by then it waits
                assert answer.status in (200, 503)
            for _ in range(3):
                may_go_on.release()
            assert 303 == await mine
            assert {429} == {task.result() for task in refused}
            assert [303, 303, 429, 429] == sorted([await task for task in flood])
        assert PASSWORD == looked_at[1]


async def test_sessions_with_the_pages_password_displace_nobody() -> None:
    """Seventy sessions with the page's password end no engineer's session, and eight of one address stay."""
    async with running(visitor="Anna") as cell:
        anna = cell.cookies()
        seen = [await cell.log_in_anew("") for _ in range(70)]
        cell.use(anna)
        assert 200 == (await cell.ask("GET", "/api/v1/me"))[0]
        open_still = 0
        for cookies in seen:
            cell.use(cookies)
            open_still += (await cell.ask("GET", "/api/v1/me"))[0] == 200
        assert 8 == open_still


async def test_a_persons_ninth_session_ends_their_own_first() -> None:
    """A person's ninth session ends their own oldest one, and no other person's."""
    async with running(visitor="Ben") as cell:
        ben = cell.cookies()
        seen = [await cell.log_in_anew("Anna") for _ in range(9)]
        statuses = list[int]()
        for cookies in (ben, *seen):
            cell.use(cookies)
            statuses.append((await cell.ask("GET", "/api/v1/me"))[0])
        assert [200, 401] + [200] * 8 == statuses
