"""Errors are shown beside the pressed button, and no typed text is lost; in a real browser."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
from helpers.browser import Browser, browser
from helpers.browsersession import PASSWORD
from helpers.needs import needs
from helpers.setuppage import log_in, press, said
from helpers.webcell import Cell, running

pytestmark = [pytest.mark.slow, needs("chromium")]
APART_PX = 40
"""Largest distance between a button and its message."""
BESIDE = """(() => {
  const box = document.querySelector(".trouble").getBoundingClientRect();
  const pressed = [...document.querySelectorAll("button")].find((b) => b.textContent.trim() === "Change it")
    .getBoundingClientRect();
  return { gap: box.top - pressed.bottom, top: box.top, bottom: innerHeight - box.bottom,
    left: box.left, right: innerWidth - box.right }; })()"""


@asynccontextmanager
async def with_a_page(name: str, size: tuple[int, int], place: str) -> AsyncIterator[tuple[Browser, Cell]]:
    """A user's page."""
    async with running() as cell, browser() as page:
        await log_in(page, cell.origin, name, PASSWORD, place, size)
        yield page, cell


@pytest.mark.long
@pytest.mark.parametrize("size", [(360, 740), (800, 480), (1280, 900)])
async def test_an_error_stands_beside_what_was_pressed(size: tuple[int, int]) -> None:
    """The message is visible, also on small screens, far down a page and after scrolling."""
    async with with_a_page("Anna", size, "/setup#/system") as (page, _):
        await page.until('document.querySelector(".own")')
        await page.type(".own [autocomplete=current-password]", "wrong")
        await page.type(".own [autocomplete=new-password]", "another horse")
        await press(page, "Change it")
        await page.until(said("Wrong password."))
        await page.until('document.querySelector(".trouble.beside")')
        for scrolled in (0, 30):
            await page.value(f"scrollBy(0, {-scrolled})")
            await page.until(f"Math.abs({BESIDE}.gap) < {APART_PX}")
            at = await page.value(BESIDE)
            assert min(at["top"], at["left"], at["right"]) >= 0, at
        assert [] == await page.violations()
        await press(page, "Understood")
        await page.until('!document.querySelector(".trouble")')


@pytest.mark.long
async def test_the_next_person_is_typed_while_the_first_one_is_added() -> None:
    """Text typed meanwhile stays in its fields."""
    name = 'document.querySelector("#users ~ form label:nth-child(1) input")'
    people = '[...document.querySelectorAll(".people strong")].map((e) => e.textContent)'
    slow = """{ const asked = fetch;
      window.fetch = async (path, request) => {
        if (request?.method === "POST" && path.endsWith("/users"))
          await new Promise((done) => { window.goOn = done; });
        return asked(path, request); }; }"""
    async with with_a_page("Anna", (1280, 900), "/setup#/system") as (page, _):
        await page.until(f"{people}.length === 4")
        await page.value(slow)
        await page.type("#users ~ form label:nth-child(1) input", "Rita")
        await page.type("#users ~ form [type=password]", "correct horse")
        await press(page, "Add")
        await page.until("window.goOn")
        await page.type("#users ~ form label:nth-child(1) input", "Sven")
        await page.value("goOn()")
        await page.until(f'{people}.includes("Rita")')
        assert "Sven" == await page.value(f"{name}.value")
        assert "" == await page.value('document.querySelector("#users ~ form [type=password]").value')
