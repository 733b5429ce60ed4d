"""The walk through all setup pages: no work is lost, and everyone can use them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, replace

import pytest
from helpers.browser import Browser, browser
from helpers.cells import small_rig
from helpers.needs import needs
from helpers.setuppage import (
    CUT_OFF,
    LEASE,
    SMALL_TARGETS,
    STEPS,
    TABBED,
    TOO_WIDE,
    freeze,
    go,
    log_in,
    press,
    said,
    take_over,
    thaw,
)
from helpers.stagecell import PASSWORD, Newcomer, staged

from edged.commands.stage import USER
from edged.files.rig import save_rig

pytestmark = [pytest.mark.slow, needs("chromium")]
SCREENS = [(360, 740, 1.0), (800, 480, 1.0), (1024, 768, 1.0), (1920, 1080, 1.0), (1024, 768, 2.0)]
"""Width, height, and zoom."""
SPARE = 3
"""Tab stops allowed for scrollable elements."""
BOARD = "chessboard:11x8:4"
ENTERED = {
    "cameras": 'document.querySelectorAll(".tile .shape").length === 2',
    "light": 'document.querySelector("[name=left-exposure_us]")?.value === "2345"',
    "calibrate": 'document.querySelectorAll(".strip li.unused").length === 1',
    "check": said("The calibration holds."),
    "teach": f"""{said("walked")} && document.querySelector(".region .rectangle")
      && document.querySelectorAll(".features-list input:not(:checked)").length === 1""",
    "try": 'document.querySelector("[name=which]")?.selectedOptions[0]?.text === "walked"',
    "robot": said("Points and poses (1)"),
    "plc": said("Modbus TCP 127.0.0.1:"),
}
"""Shows that the cell has kept what was done on a page; pages without an entry need only their heading."""
BESIDE_STAGE = """document.documentElement.scrollHeight > innerHeight
  ? (document.querySelector(".foot")?.getBoundingClientRect().top ?? innerHeight)
    - document.querySelector(".stage").getBoundingClientRect().bottom : 0"""
"""Gap between the pinned stage and what is below it; 0 where the page ends."""
FOOT_PX, FINGER_PX = 'document.querySelector(".foot")?.offsetHeight ?? 0', 48
"""Back, next and the action stand in one row, however many there are."""
OTHERS = ["viewer", "operator"]
"""Roles that may not set up the cell."""
ALONE = {"light"}
"""Pages whose contents only the lease's holder gets, as a camera's settings."""
USE_ALL = """(async () => {
  const mine = "input[type=password], [aria-labelledby=sessions] button";
  const all = "main :is(button, input, select, summary), .lease button, .foot button, .stage button";
  for (const e of document.querySelectorAll(all)) {
    if (!e.isConnected || !e.checkVisibility() || e.matches(`:disabled, ${mine}`)) continue;
    if (e.matches("select")) e.selectedIndex = e.options.length - 1;
    else if (e.matches("[type=checkbox], [type=radio], button, summary")) e.click();
    else e.value = "1";
    for (const kind of ["input", "change"]) e.dispatchEvent(new Event(kind, { bubbles: true }));
    await new Promise((done) => setTimeout(done, 100));
    document.querySelector("dialog[open]")?.close();
  }
  await new Promise((done) => setTimeout(done, 500)); })()"""
"""Uses everything enabled on a page, except one's own password and sessions."""
HERE = """location.hash === "#/{step}" && document.querySelector('main[data-page="{step}"] h1')
  && document.querySelector('[href="#/{step}"][aria-current]')"""

LOST = f"""document.querySelector(".trouble")?.innerText.includes("You no longer have the cell")
  && {LEASE}.includes("me has the cell")"""
ASLEEP = """
  const [sockets, now] = [[], Date.now];
  let late = 0;
  Date.now = () => now() + late;
  WebSocket = class extends WebSocket {
    constructor(...what) {
      super(...what);
      sockets.push(this);
      this.addEventListener("message", (event) => this.isDead && event.stopImmediatePropagation());
    }
    send(what) { if (!this.isDead) super.send(what); }
  };
  globalThis.cutOff = () => sockets.forEach((one) => { one.isDead = true; });
  globalThis.skip = (ms) => { late += ms; };
"""
"""A network that fails silently and a clock that continues, as while a tablet is away."""


def there(step: str) -> str:
    """Expression: whether a page is shown, with what was done on it."""
    return f"{HERE.format(step=step)} && ({ENTERED.get(step, 'true')})"


@dataclass(frozen=True, slots=True)
class Walk:
    """A stage with work done at every step, and the browsers of two users."""

    runner: asyncio.Runner
    newcomer: Newcomer
    page: Browser
    other: Browser

    async def hold(self, page: Browser, step: str) -> None:
        """Have the cell, and go to a step."""
        await go(page, step)
        if not await page.value('Boolean(document.querySelector(".lease.mine"))'):
            await take_over(page)
        await page.until(there(step))

    @asynccontextmanager
    async def watched(self, refused: str = "no code") -> AsyncIterator[None]:
        """Fails if the consoles show any error. refused : a status that is expected."""
        yield
        complaints = self.page.complaints + self.other.complaints
        self.page.complaints.clear()
        self.other.complaints.clear()
        assert [] == [one for one in complaints if refused not in one]


async def worked(newcomer: Newcomer) -> None:
    """Do something at every step, with the pages' requests."""
    ask, token = newcomer.ask, newcomer.token

    for role in OTHERS:
        someone = {"name": f"a {role}", "role": role, "password": PASSWORD}
        await ask("POST", "users", someone, 201)
    newcomer.world.cell.teach_pair()  # the first rendering takes longer than a camera may
    await ask("PUT", "stage", {"showing": "part"})
    draft = f"teachings/{(await ask('POST', 'teachings', token, 201))['id']}"
    while (taught := await ask("GET", draft))["proposing"]:  # noqa: ASYNC110  (there is no event for it)
        await asyncio.sleep(0.02)
    left_out = {"revision": taught["revision"], "features": {taught["features"][3]["key"]: False}}
    taught = await ask("PUT", f"{draft}/features", left_out)
    taught = await ask("PUT", draft, {"revision": taught["revision"], "name": "walked"})
    box = {"kind": "rectangle", "add": False, "x": 10, "y": 20, "width": 40, "height": 30}
    await ask("PUT", f"{draft}/region", {"revision": taught["revision"], "shapes": [*taught["shapes"], box]})

    await ask("PUT", "stage", {"showing": "board", "still": True})
    await ask("POST", "checks", {**token, "board": BOARD}, 201)
    draft = f"calibrations/{(await ask('POST', 'calibrations', {'boards': [BOARD]}, 201))['id']}"
    view = (await ask("POST", f"{draft}/views", token, 201))["views"][0]["name"]
    await ask("DELETE", f"{draft}/views/{view}", {})
    how = {"mount": "fixed", "kind": "touch", "brand": "fanuc", "board": BOARD}
    draft = f"registrations/{(await ask('POST', 'registrations', how, 201))['id']}"
    looked = await ask("POST", f"{draft}/looks", token, 201)
    x, y = looked["places"][0]["left"]
    shown = (await ask("GET", f"stage/robot?brand=fanuc&x={x}&y={y}"))["text"]
    touched = {"revision": looked["revision"], "place": looked["places"][0]["key"], "text": shown}
    await ask("POST", f"{draft}/samples", touched, 201)
    await ask("PUT", "cameras/left", {**token, "exposure_us": 2345.0})
    await ask("PUT", "stage", {"showing": "nothing"})  # its pictures are faster


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Walk]:
    """One walk for all tests."""
    folder = tmp_path_factory.mktemp("walk")
    save_rig(folder / "rig.json", replace(small_rig(), robot_from_rig=None), {"board": BOARD})

    async def ready(stack: AsyncExitStack) -> tuple[Newcomer, Browser, Browser]:
        newcomer = await stack.enter_async_context(staged(folder, gige=False, page_is_here=False))
        pages = [await stack.enter_async_context(browser()) for _ in range(2)]
        await worked(newcomer)
        for page in pages:
            await page.ask("Page.addScriptToEvaluateOnNewDocument", source=ASLEEP)
            await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
            await go(page, "teach")
            await press(page, "Continue")
        return newcomer, pages[0], pages[1]

    with asyncio.Runner() as runner:
        stack = AsyncExitStack()
        newcomer, page, other = runner.run(ready(stack))
        yield Walk(runner, newcomer, page, other)
        runner.run(stack.aclose())


@pytest.mark.parametrize(("before", "step"), [*zip(STEPS[-1:] + STEPS[:-1], STEPS, strict=True)])
async def test_reload_back_and_forward_lead_to_what_was_there(walk: Walk, before: str, step: str) -> None:
    """Reload, back and forward lead to the same step with its work, never to an empty page."""
    async with walk.watched():
        page = walk.page
        await walk.hold(page, before)
        await go(page, step)
        await page.until(there(step))
        await page.ask("Page.reload")
        await page.until(there(step))
        await page.value("history.back()")
        await page.until(there(before))
        await page.value("history.forward()")
        await page.until(there(step))


@pytest.mark.parametrize("step", STEPS)
async def test_a_second_screen_shows_the_same_and_takes_over(walk: Walk, step: str) -> None:
    """It names the holder, and after taking over the first screen is informed at once."""
    async with walk.watched("409 (Conflict)"):
        page, other = walk.page, walk.other
        await walk.hold(page, step)
        await go(other, step)
        await other.until(f'{LEASE}.includes("me has the cell")')
        await other.until(HERE.format(step=step) if step in ALONE else there(step))
        await take_over(other)
        await other.until(there(step))
        await page.until(LOST)
        await page.until(HERE.format(step=step))
        await press(page, "Understood")


@pytest.mark.parametrize("step", STEPS[::3])
async def test_who_slept_comes_back_to_what_is_so_now(walk: Walk, step: str) -> None:
    """After ten minutes without a network the page is live without a reload and knows the new holder."""
    async with walk.watched("409 (Conflict)"):
        page, other = walk.page, walk.other
        await walk.hold(page, step)
        await page.value("cutOff()")
        await freeze(page)
        await take_over(other)
        await page.value("skip(600_000)")
        await thaw(page)
        await page.until(LOST)
        await press(page, "Understood")


@pytest.mark.parametrize("step", STEPS)
async def test_every_screen_key_and_finger_will_do(walk: Walk, step: str) -> None:
    """On every screen all elements fit and can be hit, Tab reaches them visibly, and all data are the
    cell's."""
    async with walk.watched():
        page = walk.page
        await walk.hold(page, step)
        await page.value(
            "import('/static/setup/shared/live.js').then((m) => { m.liveViews.value = -1; })"
        )  # faster
        for screen in SCREENS:
            await page.resize(*screen)
            assert (0, []) == (await page.value(TOO_WIDE), await page.value(CUT_OFF)), screen
            assert await page.value(FOOT_PX) < 2 * FINGER_PX, screen
        await page.resize(360, 740)
        await page.value("scrollTo(0, 0)")
        assert await page.value(BESIDE_STAGE) < 1, "something shows below the stage"
        await page.resize(1280, 900)
        await page.value('document.querySelector(".stage details").open = true')
        assert [] == await page.value(CUT_OFF), "beside the stage"
        await page.value('document.querySelector(".stage details").open = false')
        await page.resize(*SCREENS[0])
        assert ([], []) == (await page.violations(), await page.value(SMALL_TARGETS))
        assert [] == await page.value(
            'performance.getEntriesByType("resource").map((one) => one.name)'
            ".filter((name) => new URL(name).origin !== location.origin)"
        )
        await page.value("""{ document.activeElement.blur(); scrollTo(0, 0); globalThis.tabbed = new Set();
          addEventListener("focusin", ({target}) => getComputedStyle(target).outlineStyle !== "none"
            && tabbed.add(target)); }""")
        for _ in range(SPARE + await page.value(f"{TABBED}.length")):
            await page.ask("Input.dispatchKeyEvent", type="rawKeyDown", key="Tab", windowsVirtualKeyCode=9)
        assert [] == await page.value(
            f"{TABBED}.filter((e) => !tabbed.has(e)).map((e) => e.outerHTML.slice(0, 90))"
        )
        await go(page, STEPS[STEPS.index(step) - 1])
        await page.ask("Emulation.setTouchEmulationEnabled", enabled=True)
        if await page.value(f"""!document.querySelector('header [href="#/{step}"]')"""):
            await page.tap(".path summary")
        await page.tap(f"""header [href="#/{step}"], details [href="#/{step}"]""")
        await page.until(there(step))
        await page.ask("Emulation.setTouchEmulationEnabled", enabled=False)
        await page.resize(1280, 900)


async def test_what_was_refused_stays_in_its_field(walk: Walk) -> None:
    """After a concurrent change a message and the newer state are shown, and the typed value can be sent."""
    number = 'document.querySelector("[name=number]").value'
    async with walk.watched("412 (Precondition Failed)"):
        page, ask = walk.page, walk.newcomer.ask
        await walk.hold(page, "teach")
        draft = await page.value('localStorage.getItem("edged.teaching")')
        await page.value("cutOff()")
        faster = {"revision": (await ask("GET", f"teachings/{draft}"))["revision"], "name": "faster"}
        await ask("PUT", f"teachings/{draft}", faster)
        await page.type("[name=number]", "17")
        await page.until(said("This was changed meanwhile"))
        assert ("17", "faster") == (
            await page.value(number),
            await page.value('document.querySelector(".draft-bar strong").textContent'),
        )
        await page.value('document.querySelector("[name=number]").focus()')
        await page.ask("Input.dispatchKeyEvent", type="keyDown", key="Enter", windowsVirtualKeyCode=13)
        await page.until('!document.querySelector(".trouble")')
        assert 17 == (await ask("GET", f"teachings/{draft}"))["number"]


async def test_tabs_of_one_browser_have_one_lease(walk: Walk) -> None:
    """A tab shares the lease that another tab took or gave back."""
    async with walk.watched("409 (Conflict)"):
        page = walk.page
        await walk.hold(page, "welcome")
        await page.value(
            """(async () => {
              const {ask} = await import("/static/setup/shared/api.js");
              const {token} = await ask("POST", "setup", {take_over: true});
              document.body.append(document.createElement("iframe"));
              globalThis.tab = document.querySelector("iframe").contentWindow.localStorage;
              tab.setItem("edged.lease", token);
              const live = await import("/static/setup/shared/live.js");
              while (live.token.value !== token) await new Promise((done) => setTimeout(done, 10)); })()"""
        )
        assert await page.value('Boolean(document.querySelector(".lease.mine"))')
        await page.value('tab.removeItem("edged.lease")')
        await page.until(f'{LEASE}.includes("You have the cell on another screen")')
        await page.ask("Page.reload")


@pytest.mark.long
@pytest.mark.parametrize("role", OTHERS)
async def test_who_may_not_is_refused_nothing(walk: Walk, role: str) -> None:
    """Viewers and operators get through all pages without an error: whatever can be used there is allowed."""
    async with walk.watched("AudioContext"):  # a script's click is no user gesture
        page, name = walk.other, f"a {role}"
        await page.ask("Network.clearBrowserCookies")
        await log_in(page, walk.newcomer.origin, name, PASSWORD, "/setup", (1280, 900))
        for step in STEPS:
            await go(page, step)
            await page.value("new Promise((done) => setTimeout(done, 500))")
            assert "" == await page.value('document.querySelector(".trouble")?.innerText ?? ""'), step
            await page.value(USE_ALL)
            assert "" == await page.value('document.querySelector(".trouble")?.innerText ?? ""'), step
        offered = await page.value(
            """[...document.querySelectorAll("main button, .lease button")].map((b) => b.textContent)"""
        )
        assert [] == [one for one in offered if one.strip() in ("Take the cell", "Take over")]


async def test_whoever_logs_in_again_is_where_they_were(walk: Walk) -> None:
    """Logging in again leads back to the same page, also after a wrong password, which is reported."""
    async with walk.watched(""):
        page = walk.other
        await go(page, "robot")
        await page.ask("Network.clearBrowserCookies")
        await page.ask("Page.reload")
        for password in ("wrong", PASSWORD):
            await page.until('document.querySelector("#password")')
            await page.type("#name", USER)
            await page.type("#password", password)
            await page.click("button")
            if password == "wrong":
                await page.until(said("Wrong name or password."))
        await page.until(there("robot"))
