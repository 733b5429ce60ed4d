"""Users over HTTP: logging in, management by an engineer, and the end of rights."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from helpers.browsersession import PASSWORD
from helpers.webcell import HASH, USERS, Cell, running

from edged.identity.access import Access
from edged.identity.invite import Invite
from edged.identity.sessions import IDLE_S
from edged.identity.users import RoleName, User, UserFile
from edged.identity.visitors import Role

NEW = "battery staple"


async def me(cell: Cell) -> tuple[str, str]:
    """Name and role of the session."""
    _, told = await cell.ask("GET", "/api/v1/me", None)
    return told["name"], told["role"]


async def test_everybody_is_who_they_said() -> None:
    """A name and password give that user's role, the page's password alone a viewer, a wrong one nothing."""
    async with running() as cell:
        for said, name, role in (
            ("anna", "Anna", "engineer"),
            ("Otto", "Otto", "operator"),
            ("Vera", "Vera", "viewer"),
            ("", "", "viewer"),
        ):
            await cell.log_in(said)
            assert (name, role) == await me(cell)
        for name, password in (("Anna", "guess"), ("Nobody", PASSWORD)):
            assert not await cell.comes_in(name, password)


async def test_an_engineer_makes_changes_and_removes_users() -> None:
    """Changes take effect at once, and sessions end when their user or password is changed."""
    async with running(visitor="Anna") as cell:
        anna = cell.cookies()
        new = {"name": "Jörg B.", "role": "operator", "password": NEW, "language": "de"}
        status, made = await cell.ask("POST", "/api/v1/users", new)
        assert (201, {"name": "Jörg B.", "role": "operator", "language": "de"}) == (status, made)
        status, problem = await cell.ask("POST", "/api/v1/users", {**new, "name": "jörg b."})
        assert (409, "exists", "name") == (status, problem["code"], problem["field"])
        assert await cell.comes_in("Jörg B.", NEW)
        joerg = cell.cookies()
        cell.use(anna)
        place = "/api/v1/users/Jörg B."
        assert (204, None) == await cell.ask("PUT", place, {"role": "engineer"})
        cell.use(joerg)
        assert ("Jörg B.", "engineer") == await me(cell)
        cell.use(anna)
        assert (204, None) == await cell.ask("PUT", place, {"password": "something else"})
        cell.use(joerg)
        assert 401 == (await cell.ask("GET", "/api/v1/me", None))[0]
        assert await cell.comes_in("Jörg B.", "something else")
        joerg = cell.cookies()
        cell.use(anna)
        _, listed = await cell.ask("GET", "/api/v1/users", None)
        assert ["Anna", "Ben", "Jörg B.", "Otto", "Vera"] == [user["name"] for user in listed["users"]]
        assert (204, None) == await cell.ask("DELETE", place, None)
        assert 404 == (await cell.ask("DELETE", place, None))[0]
        cell.use(joerg)
        assert 401 == (await cell.ask("GET", "/api/v1/me", None))[0]


async def test_there_is_always_an_engineer() -> None:
    """The last engineer can be neither removed nor demoted."""
    async with running(visitor="Anna") as cell:
        assert (204, None) == await cell.ask("DELETE", "/api/v1/users/Ben", None)
        for method, document in (("DELETE", None), ("PUT", {"role": "viewer"})):
            status, problem = await cell.ask(method, "/api/v1/users/Anna", document)
            assert (409, "last_engineer") == (status, problem["code"])
        assert ("Anna", "engineer") == await me(cell)


async def test_everybody_changes_their_own_password() -> None:
    """It needs the old one, ends the user's other sessions, and is impossible without a name."""
    async with running(visitor="Vera") as cell:
        other = cell.cookies()
        await cell.log_in("Vera")
        place = "/api/v1/me/password"
        status, problem = await cell.ask("PUT", place, {"old": "guess", "new": NEW})
        assert (403, "password", "old") == (status, problem["code"], problem["field"])
        status, problem = await cell.ask("PUT", place, {"old": PASSWORD, "new": "short"})
        assert (400, "new") == (status, problem["field"])
        assert (204, None) == await cell.ask("PUT", place, {"old": PASSWORD, "new": NEW})
        assert ("Vera", "viewer") == await me(cell)
        status, changed = await cell.ask("PUT", "/api/v1/me", {"language": "zh-CN"})
        assert (200, "zh-CN") == (status, changed["language"])
        cell.use(other)
        assert 401 == (await cell.ask("GET", "/api/v1/me", None))[0]
        assert not await cell.comes_in("Vera", PASSWORD)
        assert await cell.comes_in("Vera", NEW)
        await cell.log_in("")
        assert 404 == (await cell.ask("PUT", place, {"old": PASSWORD, "new": NEW}))[0]


@pytest.mark.parametrize(
    "document, field",
    [
        ({"name": "", "role": "viewer", "password": NEW}, "name"),
        ({"name": "A\tB", "role": "viewer", "password": NEW}, "name"),
        ({"name": "A" * 65, "role": "viewer", "password": NEW}, "name"),
        ({"name": "A", "role": "root", "password": NEW}, "role"),
        ({"name": "A", "role": "viewer", "password": "short"}, "password"),
        ({"name": "A", "role": "viewer", "password": "x" * 300}, "password"),
        ({"name": "A", "role": "viewer", "password": NEW, "language": "<script>"}, "language"),
        ({"name": "A", "role": "viewer"}, "password"),
    ],
)
async def test_a_user_that_cannot_be_names_the_field(document: dict[str, Any], field: str) -> None:
    """The error names the invalid field, and no user is created."""
    async with running(visitor="Anna") as cell:
        status, problem = await cell.ask("POST", "/api/v1/users", document)
        assert (400, "invalid", field) == (status, problem["code"], problem["field"])
        _, listed = await cell.ask("GET", "/api/v1/users", None)
        assert 4 == len(listed["users"])


async def test_the_first_engineer_comes_in_by_the_code(caplog: pytest.LogCaptureFixture) -> None:
    """The code from the log creates the first engineer; a wrong code or differing passwords do not."""
    async with running(users={}) as cell:
        (line,) = [one.getMessage() for one in caplog.records if "with the code" in one.getMessage()]
        code = line.partition("with the code ")[2].partition(",")[0]
        form = {"code": code, "name": "Erna", "password": NEW, "again": NEW}
        for changes, to in (
            ({"code": "abcd-efgh-jkmn"}, "/invite?wrong"),
            ({"again": PASSWORD}, "/invite?differ"),
            ({"password": "short"}, "/invite?short"),
            ({"name": ""}, "/invite?short"),
            ({}, "/setup"),
            ({}, "/invite?wrong"),
        ):
            async with cell.session.post(
                "/invite", data=form | changes, headers={"Origin": cell.origin}, allow_redirects=False
            ) as answer:
                assert to == answer.headers["Location"], changes
        assert ("Erna", "engineer") == await me(cell)
        async with cell.session.get("/invite") as answer:
            assert 200 == answer.status


@pytest.mark.parametrize(("users", "to"), [({}, "/invite"), (USERS, "/login?to=setup")])
async def test_who_comes_to_set_up_a_cell_that_all_may_look_at_is_asked_who_they_are(
    users: Mapping[str, RoleName], to: str
) -> None:
    """Without an engineer the visitor is sent to the invitation form, otherwise to log in."""
    async with (
        running(users=users, is_open=True) as cell,
        cell.session.get("/setup", allow_redirects=False) as answer,
    ):
        assert (303, to) == (answer.status, answer.headers.get("Location"))


async def test_rights_of_an_engineer_end_without_a_sign_of_them(tmp_path: Path) -> None:
    """After ten minutes without activity an engineer is only a viewer, until the password is given again."""
    users = UserFile(tmp_path / "users.json")
    for who, role in (("Anna", "engineer"), ("Otto", "operator")):
        users.put(User(name=who, role=role, password_hash=HASH))
    now_s = [0.0]
    access = Access(HASH, lambda: now_s[0], users=users, invite=Invite(tmp_path))

    cookies = [await access.log_in("", PASSWORD, name) or "" for name in ("Anna", "Otto")]

    def roles() -> list[Role]:
        found = [access.visitor(cookie, "") for cookie in cookies]
        return [visitor.role for visitor in found if visitor is not None]

    both, idle = [Role.ENGINEER, Role.OPERATOR], [Role.VIEWER, Role.OPERATOR]
    now_s[0] = IDLE_S - 1
    assert both == roles()
    anna = access.visitor(cookies[0], "")
    assert anna is not None
    access.note_activity(anna.session)
    now_s[0] += IDLE_S - 1
    assert both == roles()
    now_s[0] += 1
    assert idle == roles()
    access.note_activity(anna.session)
    assert idle == roles()
    visitor = access.visitor(cookies[0], "")
    assert visitor is not None
    assert visitor.is_idle
    assert not await access.confirm("", visitor, "guess")
    assert idle == roles()
    assert await access.confirm("", visitor, PASSWORD)
    assert both == roles()


async def test_who_is_idle_is_told_so_and_wakes() -> None:
    """The answer is a 403 with its own code until the password is given, and the lease continues
    meanwhile."""
    async with running(visitor="Anna") as cell:
        _, entered = await cell.ask("POST", "/api/v1/setup", {})
        cell.sleep(IDLE_S)
        _, told = await cell.ask("GET", "/api/v1/me", None)
        assert ("viewer", True) == (told["role"], told["idle"])
        status, problem = await cell.ask("POST", "/api/v1/captures", entered)
        assert (403, "idle") == (status, problem["code"])
        assert (204, None) == await cell.ask("PUT", "/api/v1/setup/lease", entered)
        status, problem = await cell.ask("POST", "/api/v1/me/wake", {"password": "guess"})
        assert (403, "password") == (status, problem["code"])
        assert (204, None) == await cell.ask("POST", "/api/v1/me/wake", {"password": PASSWORD})
        assert 201 == (await cell.ask("POST", "/api/v1/captures", entered))[0]
        for _ in range(3):
            cell.sleep(IDLE_S - 1)
            assert 201 == (await cell.ask("POST", "/api/v1/captures", entered))[0]
        for _ in range(2):
            cell.sleep(IDLE_S - 1)
            assert (204, None) == await cell.ask("PUT", "/api/v1/setup/lease", entered)
        assert 403 == (await cell.ask("POST", "/api/v1/captures", entered))[0]


@pytest.mark.slow
async def test_users_that_cannot_be_read_let_nobody_in(caplog: pytest.LogCaptureFixture) -> None:
    """The log says so, the page's own password still works, and no code makes an engineer."""
    async with running(users=None) as cell:
        assert any("nobody can log in by name" in one.getMessage() for one in caplog.records)
        assert not await cell.comes_in("Anna")
        await cell.log_in("")
        assert ("", "viewer") == await me(cell)
        code = Invite(cell.state).make("Erna")
        form = {"code": code, "name": "Erna", "password": NEW, "again": NEW}
        headers = {"Origin": cell.origin}
        async with cell.session.post("/invite", data=form, headers=headers, allow_redirects=False) as answer:
            assert 500 == answer.status
            assert "users.json" in await answer.text()
        assert Invite(cell.state).take(code, "Erna", is_new=True)
