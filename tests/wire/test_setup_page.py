"""The setup page in a real browser: the lease, languages, keyboards, on a screen and on a phone."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest
from helpers.browser import Browser, browser
from helpers.browsersession import PASSWORD
from helpers.needs import needs
from helpers.setuppage import (
    DIALOG,
    LEASE,
    SMALL_TARGETS,
    STATE,
    TOO_WIDE,
    UNTRANSLATED,
    come_back,
    freeze,
    go,
    leave,
    log_in,
    press,
    said,
    take,
    thaw,
)
from helpers.waiting import until
from helpers.webcell import Cell, running

from edged.domain.cell import CellPhase, CellState
from edged.identity.sessions import CONFIRMED_S

pytestmark = [pytest.mark.slow, needs("chromium")]


@asynccontextmanager
async def on_the_page(
    width: int = 1280, height: int = 900, place: str = "/setup"
) -> AsyncIterator[tuple[Browser, Cell]]:
    """Anna's page; fails if its console shows any error."""
    async with running() as cell, browser() as page:
        await log_in(page, cell.origin, "Anna", PASSWORD, place, (width, height))
        yield page, cell
        assert [] == page.complaints


async def test_somebody_takes_the_cell_and_gives_it_back() -> None:
    """The state is shown in words, a reload keeps cell and step, and giving the cell back asks first."""
    async with on_the_page() as (page, cell):
        await page.until(f'{STATE} === "READY"')
        await take(page)
        assert cell.ear.state() is CellPhase.SETUP
        assert (await page.value(STATE)).startswith("SETUP by ")

        await page.ask("Page.reload")
        await page.until('document.querySelector(".lease.mine")')
        assert "#/welcome" == await page.value("location.hash")

        await page.click(".lease button")
        await page.until(DIALOG)
        assert cell.ear.state() is CellPhase.SETUP
        await page.click("dialog[open] .primary")
        await until(lambda: cell.ear.state() is CellPhase.READY)
        await page.until(f'{STATE} === "READY"')


async def test_whoever_loses_the_cell_is_told_who_has_it() -> None:
    """The page names the new holder and is read-only until the cell is taken over again."""
    async with on_the_page() as (page, cell):
        await take(page)
        await cell.log_in()
        status, _ = await cell.ask("POST", "/api/v1/setup", {"name": "Ben", "take_over": True})
        assert 201 == status
        await page.until(f'{LEASE}.includes("Ben has the cell")')
        await page.until(said("You no longer have the cell: the line above says who does."))
        await page.until(f'{STATE} === "SETUP by Ben"')
        await page.click(".lease button")
        await page.until(DIALOG)
        assert "Take over from Ben?" in await page.value(f"{DIALOG}.textContent")
        await page.click("dialog[open] .primary")
        await page.until('document.querySelector(".lease.mine")')
        page.complaints.clear()  # about the lost lease


async def test_the_page_speaks_as_it_is_told() -> None:
    """The chosen language applies at once and is kept, also for the user and the Run page, and numbers are
    written and read in its notation.
    """
    async with on_the_page() as (page, cell):
        await page.choose(".language select", "de")
        await page.until(f'{STATE} === "BEREIT"')
        await page.ask("Page.reload")
        await page.until(f'document.querySelector("#state") && {STATE} === "BEREIT"')
        assert "de" == await page.value("document.documentElement.lang")
        texts = "import('/static/setup/shared/texts.js')"
        read = texts + ".then((m) => [m.number(1234.5, 1), ...%s.map(m.parseNumber)])"
        assert ["1234,5", 0.5, 0.5, -3.0] == await page.value(read % "['0,5', ' .5', '-3']")
        signed = texts + ".then((m) => %s.map((x) => m.sign(x, 1)))"
        assert ["0,0", "−0,1", "+0,1"] == await page.value(signed % "[-0.04, -0.05, 0.06]")
        assert "0,000" == await page.value(texts + ".then((m) => m.number(-0.0004, 3))")
        wrong = texts + ".then((m) => %s.filter((x) => !Number.isNaN(m.parseNumber(x))))"
        assert [] == await page.value(wrong % "['1.000,5', '', '4 mm', '1e3', '.', '--1']")

        # another device: only the user's record is left
        await page.value("document.cookie = 'edged_language=; path=/; max-age=0'")
        await page.open(f"{cell.origin}/", 1280, 900)
        await page.until(said("Letzte Zyklen"))
        await page.choose("#language", "en")
        await page.until(said("Last cycles"))
        await page.value(
            """(async () => { while ((await (await fetch("/api/v1/me")).json()).language !== "en"); })()"""
        )
        await page.open(f"{cell.origin}/setup", 1280, 900)
        await page.until(f'document.querySelector("#state") && {STATE} === "READY"')


async def test_a_step_that_is_chosen_while_the_page_comes_is_entered() -> None:
    """A step chosen while the page loads is not replaced by the first one."""
    async with on_the_page() as (page, cell):
        await page.ask(
            "Page.addScriptToEvaluateOnNewDocument",
            source="""{ const asked = fetch;
            window.fetch = (path, request) => {
              if (path === "/api/v1/cell") location.hash = "#/system";
              return asked(path, request); }; }""",
        )
        await page.ask("Page.navigate", url=f"{cell.origin}/setup")
        await page.until('document.querySelector("main[data-page=system] h1")')
        assert "#/system" == await page.value("location.hash")


async def test_of_an_answer_and_what_was_told_meanwhile_the_newer_one_holds() -> None:
    """A message that overtakes an answer wins if it has the same id and no older revision."""
    race = """Promise.all([import("/static/setup/shared/live.js"), import("/static/vendor/ui.js")])
    .then(async ([{ newest }, { signal }]) => {
      const heard = signal({ id: "a", revision: 9 });
      const raced = async (message) => {
        const answer = newest(heard, new Promise((done) => setTimeout(() => done({ id: "a", revision: 2 }))));
        if (message) heard.value = message;
        return (await answer) === message; };
      const messages = [null, ["a", 1], ["b", 2], ["a", 2], ["a", 3]];
      const held = [];
      for (const one of messages) held.push(await raced(one && { id: one[0], revision: one[1] }));
      return held; })"""
    async with on_the_page() as (page, _):
        assert [False, False, False, True, True] == await page.value(race)


async def test_no_word_is_written_into_the_page() -> None:
    """With marked and stretched texts, all readable text carries the mark, and fits."""
    async with on_the_page(360, 740, "/setup?pseudo") as (page, _):
        assert [] == await page.value(UNTRANSLATED)
        await take(page)
        assert [] == await page.value(UNTRANSLATED)
        assert 0 == await page.value(TOO_WIDE)


@pytest.mark.parametrize(("width", "height"), [(360, 740), (800, 480), (1920, 1080)])
async def test_everybody_can_use_the_shell(width: int, height: int) -> None:
    """axe finds nothing, everything fits the window, also with doubled font size, and targets are large
    enough."""
    async with on_the_page(width, height) as (page, _):
        await take(page)
        assert [] == await page.violations()
        assert 0 == await page.value(TOO_WIDE)
        assert [] == await page.value(SMALL_TARGETS)
        await page.value('document.documentElement.style.fontSize = "200%"')
        assert 0 == await page.value(TOO_WIDE)


async def test_who_was_away_says_the_password_again() -> None:
    """After ten minutes an engineer is read-only; the page says so, and the password ends it."""
    async with on_the_page() as (page, cell):
        await page.until(f'{STATE} === "READY"')
        cell.sleep(660.0)
        await press(page, "Take the cell")
        await page.until(DIALOG)
        await page.click("dialog[open] .primary")
        await page.until(said("Anna, you have been idle for ten minutes"))
        assert cell.ear.state() is CellPhase.READY
        page.complaints.clear()  # about the refusal
        await page.type(".wake [type=password]", PASSWORD)
        await press(page, "I am here")
        await page.until('!document.querySelector(".wake")')
        await take(page)
        assert cell.ear.state() is CellPhase.SETUP


@pytest.mark.long
async def test_an_engineer_says_who_may_come_in() -> None:
    """Users are added and removed on the page and can log in accordingly; one's own role is fixed."""
    people = '[...document.querySelectorAll(".people strong")].map((e) => e.textContent)'
    async with on_the_page() as (page, cell):
        await page.click('header nav a[href="#/system"]')
        await page.until(f"{people}.length === 4")
        assert await page.value("document.querySelector(\"[aria-label='Role of Anna']\").disabled")
        await page.type("#users ~ form label:nth-child(1) input", "Rita")
        await page.type("#users ~ form [type=password]", "correct horse")
        await press(page, "Add")
        await page.until(f'{people}.includes("Rita")')
        assert await cell.comes_in("Rita")
        await page.click("[aria-label='Remove Rita']")
        await page.until(DIALOG)
        await page.click("dialog[open] .primary")
        await page.until(f'!{people}.includes("Rita")')
        assert not await cell.comes_in("Rita")
        assert [] == await page.violations()
        assert [] == await page.value(SMALL_TARGETS)
        await page.open(f"{cell.origin}/setup?pseudo#/system", 360, 740)
        await page.until(f"{people}.length === 4")
        assert [] == await page.value(UNTRANSLATED)
        assert 0 == await page.value(TOO_WIDE)


@pytest.mark.long
async def test_who_may_come_in_is_changed_with_the_password() -> None:
    """Some minutes after the log-in the password is asked for; a wrong one is reported, the right one
    works."""
    people = '[...document.querySelectorAll(".people strong")].map((e) => e.textContent)'
    async with on_the_page() as (page, cell):
        await go(page, "system")
        await page.until(f'{people}.includes("Vera")')
        cell.sleep(CONFIRMED_S)
        await page.click("[aria-label='Remove Vera']")
        await page.until(DIALOG)
        await page.click("dialog[open] .primary")
        await page.until(said("Enter your password to go on."))
        assert [] == await page.violations()
        for password in ("wrong", PASSWORD):
            await page.type("dialog[open] [type=password]", password)
            await page.click("dialog[open] form .primary")
            if password == "wrong":
                await page.until('document.querySelector("dialog[open] .wrong")')
                page.complaints.clear()  # about the refusals
        await page.until(f'!{people}.includes("Vera")')
        assert not await cell.comes_in("Vera")


async def test_a_page_shows_where_somebody_is_logged_in_and_ends_it_all() -> None:
    """Both devices are listed, and after logging out everywhere both ask for the password."""
    lines = '[...document.querySelectorAll("[aria-labelledby=sessions] li")].map((e) => e.textContent)'
    async with on_the_page() as (page, cell):
        await cell.log_in()
        await go(page, "system")
        await page.until(f"{lines}.length === 2")
        assert ["(here)" in line for line in await page.value(lines)] == [True, False]
        await press(page, "Log out everywhere")
        await page.until('document.querySelector("#password")')
        assert 401 == (await cell.ask("GET", "/api/v1/me"))[0]
        page.complaints.clear()  # about the ended session


async def test_everybody_has_a_password_of_their_own() -> None:
    """The present password is needed to change it, and the change is confirmed and counts at once."""
    async with on_the_page() as (page, cell):
        await go(page, "system")
        await page.type(".own [autocomplete=current-password]", "wrong")
        await page.type(".own [autocomplete=new-password]", "another horse")
        await press(page, "Change it")
        await page.until(said("Wrong password."))
        page.complaints.clear()  # about the refusal
        await press(page, "Understood")
        await page.value('document.querySelector(".own [autocomplete=current-password]").select()')
        await page.type(".own [autocomplete=current-password]", PASSWORD)
        await press(page, "Change it")
        await page.until(said("Your password is changed"))
        assert not await cell.comes_in("Anna")
        assert await cell.comes_in("Anna", "another horse")


async def test_a_keyboard_is_enough() -> None:
    """Tab first reaches the skip link, and Escape closes a question without an answer."""
    focused = "document.activeElement.textContent.trim()"

    async def key(page: Browser, name: str, code: int, **text: str) -> None:
        await page.ask("Input.dispatchKeyEvent", type="keyDown", key=name, windowsVirtualKeyCode=code, **text)
        await page.ask("Input.dispatchKeyEvent", type="keyUp", key=name, windowsVirtualKeyCode=code)

    async with on_the_page() as (page, cell):
        await key(page, "Tab", 9)
        assert "Skip to content" == await page.value(focused)
        for _ in range(40):
            if "Take the cell" == await page.value(focused):
                break
            await key(page, "Tab", 9)
        await key(page, "Enter", 13, text="\r")
        await page.until(DIALOG)
        await key(page, "Escape", 27)
        await page.until(f"!{DIALOG}")
        assert cell.ear.state() is CellPhase.READY
        await key(page, "Enter", 13, text="\r")
        await page.until(DIALOG)
        await key(page, "Tab", 9)
        await page.until(f'{focused} === "Take it"')
        await key(page, "Enter", 13, text="\r")
        await page.until('document.querySelector(".lease.mine")')


@pytest.mark.long
async def test_few_keys_lead_about_and_none_while_somebody_types() -> None:
    """Keys are listed by "?", go to steps, do nothing in fields or dialogs, and can be switched off."""
    shown = 'document.querySelector("main").dataset.page'

    async def key(page: Browser, name: str, expected: str) -> None:
        await page.press(name)
        await page.until(f"{shown} === {expected!r}")

    async with on_the_page() as (page, cell):
        await page.press("?")
        await page.until(DIALOG)
        assert [] == await page.violations()
        rows = 'document.querySelectorAll("dialog[open] tr").length'
        assert 7 == await page.value(rows)
        await page.press("9")  # an open dialog ignores keys
        await page.click("dialog[open] .actions button")
        await page.until(f"!{DIALOG}")
        assert "welcome" == await page.value(shown)
        await go(page, "system")
        await key(page, "1", "welcome")
        await key(page, "9", "welcome")  # this cell has no such page
        await go(page, "system")
        await page.value('document.querySelector("main input:not([hidden])").focus()')
        await page.press("1")
        assert "system" == await page.value(shown)
        await page.value("document.activeElement.blur()")
        await page.click(".menu summary")
        await page.click(".keyboard")
        await page.click("dialog[open] [name=keys]")
        await page.click("dialog[open] .actions button")
        await page.press("1")
        assert "system" == await page.value(shown)
        assert cell.ear.state() is CellPhase.READY


async def test_a_page_that_does_not_come_says_so() -> None:
    """A page module that cannot be loaded is reported, and the other pages still work."""
    async with on_the_page() as (page, _):
        await page.ask("Network.enable")
        await page.ask("Network.setBlockedURLs", urls=["*/cell/system.js"])
        await page.value('location.hash = "#/system"')
        await page.until(said("This page could not be loaded."))
        await go(page, "welcome")
        page.complaints.clear()  # about the blocked page


async def test_what_cannot_be_fetched_is_no_uncaught_error() -> None:
    """A failing fetch is reported, and the language can still be changed."""
    async with on_the_page() as (page, _):
        await page.value("globalThis.fetch = () => Promise.reject(new TypeError('NetworkError')), 0")
        await page.value('location.hash = "#/system"')
        await page.until(said("This page could not be loaded."))
        await page.choose(".language select", "de")
        await page.until('document.documentElement.lang === "de"')


@pytest.mark.long
async def test_a_fault_is_said_in_words_with_what_ends_it() -> None:
    """The fault is shown on every page, stays while it recurs, and goes soon after it is over."""
    async with on_the_page(360, 740) as (page, cell):
        await page.until(f'{STATE} === "READY"')
        well = next(event for event in reversed(cell.ear.events) if isinstance(event, CellState))
        fault = {"error": "camera left: frame 4: incomplete: timeout", "error_code": 105}
        for _ in range(3):
            cell.web.announce(replace(well, state=CellPhase.FAULT, ready=False, **fault))
            await page.until(said("Left: An image came damaged: packets were lost on the network."))
            assert await page.value(said("with the next good pair it measures again"))
            assert [] == await page.violations()
            assert 0 == await page.value(TOO_WIDE)
            cell.web.announce(well)
            await page.until(f'{STATE} === "READY"')
            assert await page.value('Boolean(document.querySelector(".fault"))')
        await page.until('!document.querySelector(".fault")')


async def test_what_nobody_has_begun_is_no_fault() -> None:
    """If cameras were never chosen the step says "not begun", and if one is missing "look again"."""
    state = """[...document.querySelectorAll(".steps li")].find((e) => e.innerText.includes("Cameras"))
      .querySelector(".unseen").textContent"""
    cameras = """import("/static/setup/shared/live.js")
      .then(({ cameras }) => { cameras.value = { configured: %s, found: [] }; })"""
    async with on_the_page() as (page, _):
        for chosen, expected in (("false", "not begun"), ("true", "look again")):
            await page.value(cameras % f"{{ left: {{ chosen: true }}, right: {{ chosen: {chosen} }} }}")
            await page.until(f"{state} === {expected!r}")


async def test_a_page_without_its_cell_says_so() -> None:
    """The lost connection is reported in words."""
    async with on_the_page() as (page, cell):
        await page.until(f'{STATE} === "READY"')
        await cell.web.close()
        await page.until(said("Connection to the cell lost"))
        page.complaints.clear()  # about the connection


@pytest.mark.parametrize("way", ["leave", "freeze"])
async def test_a_page_that_comes_back_from_the_browsers_memory_listens_again(way: str) -> None:
    """The socket is closed on leaving, and afterwards the page shows what happened, without a reload."""
    connected = "live.isConnected.value"
    async with on_the_page() as (page, cell):
        await page.value('import("/static/setup/shared/live.js").then((live) => { globalThis.live = live; })')
        await page.until(connected)
        await (leave if way == "leave" else freeze)(page)
        assert not await page.value(connected)
        await cell.log_in()
        assert 201 == (await cell.ask("POST", "/api/v1/setup", {"name": "Ben"}))[0]
        await (come_back if way == "leave" else thaw)(page)
        await page.until(f'{STATE} === "SETUP by Ben"')
