"""The log-in forms: in the visitor's language, also for errors."""

from __future__ import annotations

import re

import pytest
from helpers.browser import browser
from helpers.browsersession import PASSWORD
from helpers.needs import needs
from helpers.setuppage import SMALL_TARGETS, TOO_WIDE, log_in
from helpers.webcell import Cell, running

from edged.adapters.web.assets import read_assets
from edged.identity.invite import Invite

NEW = {"code": "abcd-efgh-jkmn", "name": "Erna", "password": "battery staple", "again": "battery staple"}
SPEAK = "Emulation.setUserAgentOverride"
READ = """(() => {
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const found = [document.title];
  for (let node; (node = texts.nextNode()); )
    if (!node.parentElement.closest("[translate=no]")) found.push(node.textContent);
  return found.join("\\n"); })()"""
"""All readable text, except names."""
PROBLEM = (
    'document.querySelector("[autofocus][aria-describedby=problem]") && document.querySelector("#problem")'
)


async def test_a_form_comes_in_the_language_that_was_chosen_or_else_is_liked_best() -> None:
    """The form is in the language chosen on this device, else the browser's preferred one whatever the
    region, else English, also for malformed headers, and it needs no script.
    """
    async with running() as cell:
        for liked, chosen, expected in (
            ("de-CH, de;q=0.9, en;q=0.8", "", "de"),
            ("en-GB,en;q=0.9,de;q=0.8", "", "en"),
            ("it, en;q=0.3, DE-at;q=0.7", "", "de"),
            ("it-CH, *;q=0.5", "", "en"),
            ("fr-CA, en;q=0.8", "", "fr"),
            ("zh-CN,zh;q=0.9,en;q=0.8", "", "zh"),
            ("ja", "", "ja"),
            ("de;q=0, en;q=0.1", "", "en"),
            ("de;q=nan, ;;, en-" + "x" * 2000, "", "en"),
            ("", "", "en"),
            ("en", "de", "de"),
            ("de", "en", "en"),
            ("de", "../setup/de", "de"),
        ):
            sent = {"Accept-Language": liked, "Cookie": f"edged_language={chosen}"}
            for path, german in (("/login", "Passwort"), ("/invite", "Noch einmal dasselbe")):
                async with cell.session.get(path, headers=sent) as answer:
                    text = await answer.text()
                assert f'<html lang="{expected}">' in text, sent
                assert (expected == "de") == (german in text), sent
                assert "<script" not in text


@pytest.mark.long
@pytest.mark.parametrize(
    ("tag", "wrong", "differ", "short", "code", "wait", "storage"),
    [
        (
            "en",
            "Wrong name or password.",
            "The two passwords differ.",
            "a password of at least 8 characters.",
            "This code is wrong, already used",
            r"No password is accepted for \d+ s",
            "You cannot be made an engineer: .*users.json",
        ),
        (
            "de",
            "Name oder Passwort stimmt nicht.",
            "Die beiden Passwörter sind verschieden.",
            "ein Passwort, mindestens 8 Zeichen.",
            "Dieser Code stimmt nicht",
            r"\d+ s lang wird kein Passwort angenommen",
            "Sie können die Rolle „engineer“ nicht bekommen: .*users.json",
        ),
    ],
)
async def test_what_went_wrong_is_said(
    tag: str, wrong: str, differ: str, short: str, code: str, wait: str, storage: str
) -> None:
    """The form can be filled in again, shows only the last problem, and keeps where to go afterwards."""

    async def problem(cell: Cell, path: str, form: dict[str, str] | None) -> tuple[int, str, str]:
        """Status, message, and the form's address."""
        method = "GET" if form is None else "POST"
        sent = {"Accept-Language": tag, "Origin": cell.origin}
        async with cell.session.request(method, path, data=form, headers=sent) as answer:
            text = await answer.text()
            told = re.search(r'<p id="problem" .*role="alert">(.*)</p>', text)
            assert f'<html lang="{tag}">' in text
            assert 'name="password"' in text
            return answer.status, told[1] if told else "", answer.url.path_qs

    async with running() as cell:
        guess = {"name": "Anna", "password": "guess"}
        for path, form, status, expected, place in (
            ("/login", None, 200, "", "/login"),
            ("/login?to=setup", guess, 200, wrong, "/login?wrong&to=setup"),
            ("/invite", None, 200, "", "/invite"),
            ("/invite", {**NEW, "again": PASSWORD}, 200, differ, "/invite?differ"),
            ("/invite", {**NEW, "password": "short"}, 200, short, "/invite?short"),
            ("/invite", NEW, 200, code, "/invite?wrong"),
            *(("/login", guess, 200, wrong, "/login?wrong"),) * 3,
            ("/login?to=setup", guess, 429, wait, "/login?to=setup"),
            ("/invite", NEW, 429, wait, "/invite"),
        ):
            found, told, at = await problem(cell, path, form)
            assert (status, place) == (found, at)
            assert bool(expected) == bool(told)
            assert re.search(expected, told)
    async with running(users=None) as cell:
        status, told, _ = await problem(cell, "/invite", {**NEW, "code": Invite(cell.state).make()})
        assert 500 == status
        assert re.search(storage, told)


def words(text: str) -> set[str]:
    """Words of three letters or more."""
    return set(re.findall(r"[^\W\d_]{3,}", text))


@pytest.mark.long
@needs("chromium")
async def test_they_can_be_read_and_used_by_everybody() -> None:
    """In every language all words are in the texts, nothing is cut off or too small for a finger, and axe
    finds nothing, also after errors. A language chosen on a page is then used by the form, whatever the
    browser prefers.
    """

    async with running() as cell, browser() as page:
        agent = await page.value("navigator.userAgent")
        texts = read_assets()
        for tag in ("de", "fr", "ja", "zh", "en"):
            await page.ask(SPEAK, userAgent=agent, acceptLanguage=tag)
            for path in ("/login", "/login?wrong", "/invite", "/invite?wrong"):
                await page.open(f"{cell.origin}{path}", 1280, 844)
                await page.until(
                    f'location.href.endsWith("{path}") && document.readyState === "complete"'
                    ' && document.querySelector("button")'
                )
                assert tag == await page.value("document.documentElement.lang")
                assert set() == words(await page.value(READ)) - words(texts[f"login.{tag}.ftl"]) - {"cell"}
                assert ("wrong" in path) == bool(await page.value(f"Boolean({PROBLEM})"))
                for width in (1280, 390):
                    await page.resize(width, 844)
                    assert 0 == await page.value(TOO_WIDE)
                    assert [] == await page.value(SMALL_TARGETS)
                assert [] == await page.violations()
        assert [] == page.complaints

        await log_in(page, cell.origin, "Vera", PASSWORD, "/setup", (1280, 900))
        await page.value('import("/static/setup/shared/texts.js").then((texts) => texts.choose("de"))')
        await page.click("header .menu summary")
        await page.click("header form button")
        await page.until('document.querySelector("#password")')
        assert "de" == await page.value("document.documentElement.lang")
