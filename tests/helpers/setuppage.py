"""Actions of tests on the setup pages, and checks that apply to each page."""

from __future__ import annotations

import re

from edged.adapters.web.assets import read_assets
from helpers.browser import Browser

STEPS = re.findall(r"\{ id: \"(\w+)\", topic:", read_assets()["setup/steps.js"])
"""All pages, on the guided path and beside it, in the order of their table."""
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
"""Elements whose middle a finger cannot hit, or whose text is cut off."""
TABBED = """(() => {
  const all = "a[href], button, select, input, textarea, summary, [tabindex='0']";
  return [...document.querySelectorAll(all)].filter((e) => e.checkVisibility() && !e.disabled
    && !(e.type === "radio" && !e.checked && document.querySelector(`[name="${e.name}"]:checked`))); })()"""
"""Elements that the Tab key must reach; of a group of radio buttons the selected one."""
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
    """Log in with the form, to which the page redirects visitors without a session; then open a page."""
    await page.open(f"{origin}/setup", *size)
    await page.until('document.querySelector("#password")')
    await page.type("#name", name)
    await page.type("#password", password)
    await page.click("button")
    await page.until('!document.querySelector("#password")')
    page.complaints.clear()  # the form complains that it was typed into before it had the focus
    await page.open(f"{origin}{place}", *size)
    await page.until('document.querySelector("main h1")')


async def take(page: Browser) -> None:
    """Take the cell with the button, and confirm."""
    await page.click(".lease .primary")
    await page.until(DIALOG)
    await page.click("dialog[open] .primary")
    await page.until('document.querySelector(".lease.mine")')


async def take_over(page: Browser) -> None:
    """Take over the cell from the session shown by the page."""
    await press(page, "Take over")
    await page.until(DIALOG)
    await page.click("dialog[open] .primary")
    await page.until('document.querySelector(".lease.mine")')


async def go(page: Browser, step: str) -> None:
    """Go to a step by its link."""
    await page.value(f"""location.hash = "#/{step}" """)
    await page.until(f"""document.querySelector('main[data-page="{step}"] h1')""")


async def press(page: Browser, text: str) -> None:
    """Press a button by its label, once it is enabled."""
    found = f"""[...document.querySelectorAll("button")].find((b) => b.textContent.trim() === {text!r})"""
    await page.until(f"{found}?.disabled === false")
    await page.click_on(found)


def said(text: str) -> str:
    """Expression: whether the page shows this text."""
    return f"document.body?.innerText.includes({text!r})"


async def put_in_force(page: Browser) -> None:
    """Put a draft of settings in force, and wait until the page confirms it."""
    await press(page, "Use these settings")
    await press(page, "Put them in force")
    await page.until(IN_FORCE)


async def discard(page: Browser) -> None:
    """Discard the first draft that can be, and confirm."""
    await press(page, "Discard")
    await page.until(DIALOG)
    await page.click("dialog[open] .primary")
    await page.until(f"!{DIALOG}")


async def leave(page: Browser) -> None:
    """Leave the document, which the browser keeps for going back.

    Only the event is sent: Chromium does not keep pages with no-store, other browsers do.
    """
    await page.value("""dispatchEvent(new PageTransitionEvent("pagehide", { persisted: true })), 0""")


async def come_back(page: Browser) -> None:
    """Go back to a document that was left."""
    await page.value("""dispatchEvent(new PageTransitionEvent("pageshow", { persisted: true })), 0""")


async def freeze(page: Browser) -> None:
    """Freeze the tab, as one in the background."""
    await page.ask("Emulation.setFocusEmulationEnabled", enabled=False)
    await page.ask("Page.setWebLifecycleState", state="frozen")


async def thaw(page: Browser) -> None:
    """Resume a frozen tab."""
    await page.ask("Page.setWebLifecycleState", state="active")
    await page.ask("Emulation.setFocusEmulationEnabled", enabled=True)
