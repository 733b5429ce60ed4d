"""What tests do on the pages that set a cell up, and look for on each of them."""

from __future__ import annotations

import re

from edged.adapters.web.assets import read_assets
from helpers.browser import Browser

STEPS = re.findall(r"\{ id: \"(\w+)\", topic:", read_assets()["setup/steps.js"])
"""All pages, on the way and beside it, as the table of them has it."""
STATE = 'document.querySelector("#state").textContent.trim()'
LEASE = 'document.querySelector(".lease").textContent'
DIALOG = 'document.querySelector("dialog[open]")'
IN_FORCE = "!document.querySelector('#settings-draft, dialog[open]')"
TOO_WIDE = "Math.max(document.documentElement.scrollWidth - innerWidth, 0)"
SMALL_TARGETS = """[...document.querySelectorAll("button, a, select, input, summary")]
  .filter((e) => e.checkVisibility() && !e.matches(".skip"))
  .map((e) => e.closest("label") ?? e)
  .filter((e) => e.getBoundingClientRect().height < 47.5).map((e) => e.outerHTML.slice(0, 80))"""
CUT_OFF = """[...document.querySelectorAll("button, a, select, input, textarea, summary, [tabindex='0']")]
  .filter((e) => e.checkVisibility() && !e.matches(".skip"))
  .filter((e) => {
    e.scrollIntoView({ block: "center", inline: "center" });
    const { left, right, top, width, height } = e.getBoundingClientRect();
    const hit = document.elementFromPoint(left + width / 2, top + height / 2);
    const isFree = e.contains(hit) || e.closest("label")?.contains(hit);
    const isCut = e.matches("button, .button, summary, nav a") && e.scrollWidth > e.clientWidth + 1;
    return !isFree || isCut || left < -0.5 || right > innerWidth + 0.5;
  }).map((e) => e.outerHTML.slice(0, 90))"""
"""What a finger cannot hit in its middle, or nobody reads to its end."""
TABBED = """(() => {
  const all = "a[href], button, select, input, textarea, summary, [tabindex='0']";
  return [...document.querySelectorAll(all)].filter((e) => e.checkVisibility() && !e.disabled
    && !(e.type === "radio" && !e.checked && document.querySelector(`[name="${e.name}"]:checked`))); })()"""
"""What the Tab key must come to: of radio buttons the one that is chosen."""
UNTRANSLATED = """(() => {
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const found = [];
  for (let node; (node = texts.nextNode()); ) {
    const [text, isData] = [node.textContent, node.parentElement.closest("[translate=no], script, noscript")];
    if (/\\p{L}{2}/u.test(text) && !text.includes("⟦") && !isData) found.push(text);
  }
  for (const e of document.querySelectorAll("[aria-label]"))
    if (!e.getAttribute("aria-label").includes("⟦")) found.push(e.getAttribute("aria-label"));
  return found; })()"""


async def log_in(
    page: Browser, origin: str, name: str, password: str, place: str, size: tuple[int, int]
) -> None:
    """By the form, to which the page leads whoever comes without; then to a place of the page."""
    await page.open(f"{origin}/setup", *size)
    await page.until('document.querySelector("#password")')
    await page.type("#name", name)
    await page.type("#password", password)
    await page.click("button")
    await page.until('!document.querySelector("#password")')
    page.complaints.clear()  # of the form: that it was typed into before it had the focus
    await page.open(f"{origin}{place}", *size)
    await page.until('document.querySelector("main h1")')


async def take(page: Browser) -> None:
    """With the button, and its question answered."""
    await page.click(".lease .primary")
    await page.until(DIALOG)
    await page.click("dialog[open] .primary")
    await page.until('document.querySelector(".lease.mine")')


async def take_over(page: Browser) -> None:
    """The cell, from the session that asks beside the page."""
    await press(page, "Take over")
    await page.until(DIALOG)
    await page.click("dialog[open] .primary")
    await page.until('document.querySelector(".lease.mine")')


async def go(page: Browser, step: str) -> None:
    """To a step, by its link."""
    await page.value(f"""location.hash = "#/{step}" """)
    await page.until(f"""document.querySelector('main[data-page="{step}"] h1')""")


async def press(page: Browser, text: str) -> None:
    """A button, by what stands on it, when it can be pressed."""
    found = f"""[...document.querySelectorAll("button")].find((b) => b.textContent.trim() === {text!r})"""
    await page.until(f"{found}?.disabled === false")
    await page.click_on(found)


def said(text: str) -> str:
    """Whether the page says something."""
    return f"document.body?.innerText.includes({text!r})"


async def put_in_force(page: Browser) -> None:
    """A draft of settings, until the cell runs by it and the page has its answer."""
    await press(page, "Use these settings")
    await press(page, "Put them in force")
    await page.until(IN_FORCE)


async def discard(page: Browser) -> None:
    """The first draft that can be, and its question answered."""
    await press(page, "Discard")
    await page.until(DIALOG)
    await page.click("dialog[open] .primary")
    await page.until(f"!{DIALOG}")


async def leave(page: Browser) -> None:
    """The document, which the browser keeps for the way back.

    Only its event: Chromium keeps no page that is not to be stored, other browsers do.
    """
    await page.value("""dispatchEvent(new PageTransitionEvent("pagehide", { persisted: true })), 0""")


async def come_back(page: Browser) -> None:
    """To a document that was left."""
    await page.value("""dispatchEvent(new PageTransitionEvent("pageshow", { persisted: true })), 0""")


async def freeze(page: Browser) -> None:
    """A tab that nobody looks at."""
    await page.ask("Emulation.setFocusEmulationEnabled", enabled=False)
    await page.ask("Page.setWebLifecycleState", state="frozen")


async def thaw(page: Browser) -> None:
    """A frozen tab that is looked at again."""
    await page.ask("Page.setWebLifecycleState", state="active")
    await page.ask("Emulation.setFocusEmulationEnabled", enabled=True)
