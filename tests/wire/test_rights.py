"""Rights of a session: cookies, host names, tokens, and confirmation by password."""

from __future__ import annotations

import ssl
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from argon2 import PasswordHasher
from helpers.browsersession import PASSWORD, BrowserSession, browsing
from helpers.certificates import make_certificates
from helpers.pagesources import FixedSources
from helpers.webcell import HASH, USERS, Cell, running

from edged.adapters.web import WebPublisher, WebSettings
from edged.identity.invite import Invite
from edged.identity.sessions import CONFIRMED_S, IDLE_S
from edged.identity.users import UserFile

NEW = "battery staple"
TOKEN = "of prometheus alone"


@asynccontextmanager
async def page(
    name: str, certificate: Path | None = None, key: Path | None = None, **settings: Any
) -> AsyncIterator[BrowserSession]:
    """A page of a cell with this name, and a browser session."""
    wanted = WebSettings(port=0, password_hash=HASH, certificate=certificate, key=key, **settings)
    web = WebPublisher(
        name, wanted, FixedSources(rectification=lambda: pytest.fail("no cycle has made a picture"))
    )
    await web.start()
    try:
        scheme = "http" if certificate is None else "https"
        async with browsing(f"{scheme}://127.0.0.1:{web.port}") as session:
            yield BrowserSession(session)
    finally:
        await web.close()


async def logged_in(browser: BrowserSession, **how: Any) -> aiohttp.ClientResponse:
    """Answer to a log-in with the page's password."""
    headers = {"Origin": browser.origin} | how.pop("headers", {})
    async with browser.session.post(
        "/login", data={"password": PASSWORD}, headers=headers, allow_redirects=False, **how
    ) as answer:
        return answer


# --- cookies, hosts, origins -------------------------------------------------------------------


async def test_two_cells_on_one_host_have_two_cookies() -> None:
    """As browsers send cookies to every port of a host, each cell has a cookie name of its own."""
    async with page("cell1") as one, page("cell2") as other:
        names = [set((await logged_in(browser)).cookies) for browser in (one, other)]
        assert 2 == len(names[0] | names[1])


async def test_the_cookie_of_a_page_with_tls_is_bound_to_its_host(tmp_path: Path) -> None:
    """The cookie has the `__Host-` prefix, Secure and Path=/, and no Domain."""
    make_certificates(tmp_path)
    trusting = ssl.create_default_context()
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    async with page("cell1", tmp_path / "server.pem", tmp_path / "server.key") as browser:
        answer = await logged_in(browser, ssl=trusting)
        (header,) = answer.headers.getall("Set-Cookie")
        assert header.startswith("__Host-")
        assert "Secure" in header and "Path=/" in header and "Domain" not in header


async def test_only_names_of_this_machine_are_served(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only its addresses, its host name and configured names are served, also with a password."""
    monkeypatch.setattr("socket.gethostname", lambda: "cellpc")
    async with page("cell1", names=("cells.plant.example",)) as browser:
        for host, expected in (
            ("evil.example", 421),
            ("cellpc.evil.example", 421),
            ("", 421),
            ("cellpc:8080", 200),
            ("CellPC.local", 200),
            ("cells.plant.example", 200),
            ("10.0.0.5:8080", 200),
            ("[fd00::5]:8080", 200),
            ("localhost", 200),
        ):
            async with browser.session.get("/login", headers={"Host": host}) as answer:
                assert expected == answer.status, host


async def test_a_page_elsewhere_logs_nobody_in_or_out() -> None:
    """Log-in, invitation and log-out from another origin are refused, and the session stays the same."""
    async with running(visitor="Anna") as cell:
        form = {"name": "Vera", "password": PASSWORD}
        for origin in ({"Origin": "http://evil.example"}, {"Origin": "null"}, {}):
            for path in ("/login", "/invite", "/logout"):
                async with cell.session.post(
                    path, data=form, headers=origin, allow_redirects=False
                ) as answer:
                    assert 403 == answer.status, (origin, path)
        assert "Anna" == (await cell.ask("GET", "/api/v1/me"))[1]["name"]


# --- the lease ---------------------------------------------------------------------------------


async def test_a_token_is_of_use_to_its_session_alone() -> None:
    """A token does not work in another engineer's session, nor in another session of the same engineer."""
    async with running(visitor="Anna") as cell:
        anna = cell.cookies()
        _, token = await cell.ask("POST", "/api/v1/setup", {})
        for name in ("Ben", "Anna"):
            await cell.log_in(name)
            for method, path in (
                ("PUT", "/api/v1/setup/lease"),
                ("POST", "/api/v1/captures"),
                ("DELETE", "/api/v1/setup"),
            ):
                status, problem = await cell.ask(method, path, token)
                assert (409, "setup_refused") == (status, problem["code"]), path
        cell.use(anna)
        assert 201 == (await cell.ask("POST", "/api/v1/captures", token))[0]
        await cell.log_in("Ben")
        _, taken = await cell.ask("POST", "/api/v1/setup", {"take_over": True})
        assert 201 == (await cell.ask("POST", "/api/v1/captures", taken))[0]


# --- the password once more ----------------------------------------------------------------------


async def test_people_are_changed_with_the_own_password_alone() -> None:
    """Changing users needs a recent password; other actions do not."""
    person = {"name": "Erna", "role": "operator", "password": NEW}
    async with running(visitor="Anna") as cell:
        assert CONFIRMED_S < IDLE_S
        cell.sleep(CONFIRMED_S)
        for method, path, document in (
            ("POST", "/api/v1/users", person),
            ("PUT", "/api/v1/users/Vera", {"role": "engineer"}),
            ("DELETE", "/api/v1/users/Vera", None),
        ):
            status, problem = await cell.ask(method, path, document)
            assert (403, "confirm") == (status, problem["code"]), path
        assert 201 == (await cell.ask("POST", "/api/v1/setup", {}))[0]
        status, problem = await cell.ask("POST", "/api/v1/me/wake", {"password": "guess"})
        assert (403, "password") == (status, problem["code"])
        assert (204, None) == await cell.ask("POST", "/api/v1/me/wake", {"password": PASSWORD})
        assert 201 == (await cell.ask("POST", "/api/v1/users", person))[0]


async def test_a_weak_password_is_refused() -> None:
    """Common passwords, key rows and one's own name are refused when creating, changing and inviting."""
    async with running(visitor="Anna") as cell:
        for password in ("Password1!", "qwertzuiop", "20252026", "abababab", "Erna1990", "P@ssw0rd"):
            person = {"name": "Erna", "role": "operator", "password": password}
            status, problem = await cell.ask("POST", "/api/v1/users", person)
            assert (400, "weak_password", "password") == (status, problem["code"], problem["field"]), password
        change = {"old": PASSWORD, "new": "anna2026"}
        status, problem = await cell.ask("PUT", "/api/v1/me/password", change)
        assert (400, "weak_password", "new") == (status, problem["code"], problem["field"])
        status, problem = await cell.ask("PUT", "/api/v1/users/Vera", {"password": "vera-2026"})
        assert (400, "weak_password", "password") == (status, problem["code"], problem["field"])
        code = Invite(cell.state).make("Erna")
        assert "/invite?common" == await redeemed(cell, code, "Erna", "erna12345")


async def redeemed(cell: Cell, code: str, name: str, password: str = NEW) -> str:
    """Redirect after redeeming a code."""
    form = {"code": code, "name": name, "password": password, "again": password}
    headers = {"Origin": cell.origin}
    async with cell.session.post("/invite", data=form, headers=headers, allow_redirects=False) as answer:
        return answer.headers["Location"]


async def test_an_invitation_makes_nobody_but_whom_it_was_made_for() -> None:
    """An invitation works only for its name, and the log's first code only for a new name."""
    async with running() as cell:
        code = Invite(cell.state).make("Erna")
        for name in ("Anna", "Somebody", "\u0415rna"):
            assert "/invite?wrong" == await redeemed(cell, code, name)
        assert "/setup" == await redeemed(cell, code, "erna")
        code = Invite(cell.state).make()
        assert "/invite?wrong" == await redeemed(cell, code, "Vera")
        assert await cell.comes_in("Vera")
        assert await cell.comes_in("Anna")


async def test_nobody_gets_a_name_that_looks_like_anothers() -> None:
    """Look-alike names are refused as existing, and an equivalent form of a name logs in the same user."""
    async with running(visitor="Anna") as cell:
        for name in ("\u0410nna", "Ann\u0430", "Anna\u3164", "\uff21nna", "0tto"):
            person = {"name": name, "role": "engineer", "password": NEW}
            status, problem = await cell.ask("POST", "/api/v1/users", person)
            assert (409, "exists", "name") == (status, problem["code"], problem["field"]), name
        assert await cell.comes_in("\uff21\uff2e\uff2e\uff21")
        assert "Anna" == (await cell.ask("GET", "/api/v1/me"))[1]["name"]
        assert set(USERS) == {user.name for user in UserFile(cell.state / "users.json").users}


async def test_everybody_sees_their_sessions_and_ends_them_all() -> None:
    """A user sees only their own sessions, and ending all of them ends the current one, too."""
    async with running(visitor="Ben") as cell:
        ben = cell.cookies()
        seen = list[Mapping[str, str]]()
        for _ in range(2):
            seen.append(await cell.log_in_anew("Anna"))
            cell.sleep(30)
        _, told = await cell.ask("GET", "/api/v1/me/sessions")
        shown = [(one["address"], one["age_s"], one["this"]) for one in told["sessions"]]
        assert [("127.0.0.1", 60, False), ("127.0.0.1", 30, True)] == shown
        assert (204, None) == await cell.ask("DELETE", "/api/v1/me/sessions")
        for cookies, expected in ((seen[0], 401), (seen[1], 401), (ben, 200)):
            cell.use(cookies)
            assert expected == (await cell.ask("GET", "/api/v1/me"))[0]
        await cell.log_in_anew("")
        for method in ("GET", "DELETE"):
            status, problem = await cell.ask(method, "/api/v1/me/sessions")
            assert (404, "no_user") == (status, problem["code"])


async def test_a_token_reads_the_metrics_and_nothing_else() -> None:
    """The metrics token opens only /metrics, and wrong ones are limited like password guesses."""
    hashed = PasswordHasher(1, 512, 1).hash(TOKEN)
    async with page("cell1", metrics_password_hash=hashed) as browser:
        for path, token, expected in (
            ("/metrics", TOKEN, 200),
            ("/status.json", TOKEN, 401),
            ("/", TOKEN, 401),
            ("/metrics", "\u00e9", 401),
            *(("/metrics", "guess", 401),) * 5,
            ("/metrics", "guess", 429),
            ("/metrics", TOKEN, 200),
        ):
            headers = {"Authorization": f"Bearer {token}"}
            async with browser.session.get(path, headers=headers) as answer:
                assert expected == answer.status, (path, token)
