"""All routes of a daemon: its OpenAPI document, the roles, and the questions."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from helpers.boardcell import BoardCell
from helpers.browsersession import BrowserSession
from helpers.everyroute import check_document, check_questions, check_roles, operations
from helpers.webcell import HASH, USERS

from edged.adapters.web.assets import read_assets
from edged.files.statefolder import state_folder
from edged.identity.users import User, UserFile


@pytest.fixture
def asked(tmp_path: Path) -> Callable[[Callable[[BrowserSession], Awaitable[None]]], None]:
    """Run a test's coroutine with a browser before a daemon and the process of its page."""
    cell = BoardCell(tmp_path)
    for name, role in USERS.items():
        users = UserFile(state_folder(cell.config) / "users.json")
        users.put(User(name=name, role=role, password_hash=HASH))

    def run(test: Callable[[BrowserSession], Awaitable[None]]) -> None:
        cell.run(lambda cell: test(BrowserSession(cell.session)))

    return run


@pytest.mark.long
def test_all_of_the_api_is_what_its_document_says(
    asked: Callable[[Callable[[BrowserSession], Awaitable[None]]], None],
) -> None:
    """All routes behave as the API document says, nobody exceeds their role, and the page has a text for
    every audit entry.
    """

    async def test(browser: BrowserSession) -> None:
        document = await check_document(browser)
        assert {"/api/v1/cameras", "/api/v1/calibrations"} <= set(document["paths"])
        await check_roles(browser, {name: USERS[name] for name in ("Vera", "Otto", "Anna")})
        audited = [
            f"{method} {path.removeprefix('/api/v1/')}"
            for method, path, operation in operations(document)
            if operation["x-edged-audit"]
        ]
        worded = re.findall(r"\[/(\^.*)/, \"[a-z-]+\"\]", read_assets()["setup/cell/people.js"])
        deeds = [*audited, *(f"{deed}/what-was-made" for deed in audited)]
        assert [] == [deed for deed in deeds if not any(re.search(one, deed) for one in worded)]
        browser.session.cookie_jar.clear()
        assert await check_questions(browser) >= 30

    asked(test)
