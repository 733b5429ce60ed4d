"""A job is taught on the page, with taps and keys, tried and used, on a stage with known truth."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.browser import Browser, browser
from helpers.browsersession import PASSWORD
from helpers.cells import small_rig
from helpers.flangedrawing import flange_drawing
from helpers.needs import needs
from helpers.setuppage import (
    DIALOG,
    SMALL_TARGETS,
    STEPS,
    TOO_WIDE,
    UNTRANSLATED,
    discard,
    go,
    log_in,
    press,
    said,
    take,
    take_over,
)
from helpers.stagecell import Newcomer, staged

from edged.commands.stage import USER
from edged.files.rig import save_rig
from edged.files.statefolder import state_folder

pytestmark = [pytest.mark.slow, needs("chromium")]

DIAMETERS_MM = [28.0, 8.0, 3.2, 3.2, 3.2, 3.2, 1.8]
"""True diameters of the stage's flange, in the order of its features."""
LEFT = "[data-side=left]"
VIEW = f"""document.querySelector("{LEFT}").getAttribute("viewBox").split(" ").map(Number)"""
PROPOSED = f"""document.querySelectorAll("{LEFT} .feature").length >= 7"""
ROWS = '[...document.querySelectorAll(".features-list li")].map((row) => row.innerText)'
CHECKED = '[...document.querySelectorAll(".features-list input")].map((box) => box.checked)'
FIGURES = '[...document.querySelectorAll(".figures-of dd")]'
QUIET = '!document.querySelector("progress")'
"""No search is running."""
TEXTS = """(() => {
  const [walk, found] = [document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), []];
  for (let node; (node = walk.nextNode()); )
    if (!node.parentElement.closest("[translate=no], script, noscript")) found.push(node.textContent.trim());
  return found; })()"""
"""All texts of the page except names and values of cell.toml, as `free-run`."""
TEXT_ID = "[a-z]+(?:-[a-z]+)+"
"""Shown in place of a text that a language lacks."""
STILL = 'document.querySelector("[aria-labelledby=try-still] tbody")'
STILL_ROWS = f"""[...{STILL}.rows].map((row) => [...row.cells].map((cell) => cell.innerText))"""
CTRL, SHIFT, ALT = 2, 8, 1


@dataclass(frozen=True)
class Stand:
    """A stage with a rig and its part on the table, one browser, and a draft with its proposal.

    still : file of the last still test.
    """

    runner: asyncio.Runner
    newcomer: Newcomer
    page: Browser
    draft: str
    still: Path

    async def open(
        self,
        width: int = 1280,
        height: int = 900,
        query: str = "",
        step: str = "teach",
        there: str = PROPOSED,
    ) -> None:
        """Open a page; on the teaching page the draft is opened as after a reload."""
        await self.page.value(f'localStorage.setItem("edged.teaching", "{self.draft}")')
        await self.page.open("about:blank", width, height)
        await self.page.open(f"{self.newcomer.origin}/setup{query}#/{step}", width, height)
        await self.page.until(there)

    async def take(self) -> None:
        """Take the cell, unless another test has it already."""
        await self.page.until('document.querySelector(".lease")')
        if not await self.page.value('Boolean(document.querySelector(".lease.mine"))'):
            is_free = await self.page.value('Boolean(document.querySelector(".lease .primary"))')
            await (take if is_free else take_over)(self.page)

    async def until(self, is_so: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Wait until the stored draft fulfils the condition."""
        return await self.newcomer.until(f"teachings/{self.draft}", is_so)

    async def key(self, name: str, modifiers: int = 0, code: int = 0) -> None:
        """Press a key with modifiers held."""
        for kind in ("keyDown", "keyUp"):
            await self.page.ask(
                "Input.dispatchKeyEvent", type=kind, key=name, modifiers=modifiers, windowsVirtualKeyCode=code
            )


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stand]:
    """One stand for all tests."""
    folder = tmp_path_factory.mktemp("teach")
    save_rig(folder / "rig.json", small_rig())

    async def ready(stack: AsyncExitStack) -> tuple[Newcomer, Browser, str]:
        newcomer = await stack.enter_async_context(staged(folder, gige=False))
        page = await stack.enter_async_context(browser())
        newcomer.world.cell.teach_pair()  # the first rendering takes longer than a camera may
        await newcomer.ask("PUT", "stage", {"showing": "part"})
        draft = (await newcomer.ask("POST", "teachings", newcomer.token, 201))["id"]
        await newcomer.until(f"teachings/{draft}", lambda document: document["proposing"] is None)
        await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
        return newcomer, page, draft

    with asyncio.Runner() as runner:
        stack = AsyncExitStack()
        newcomer, page, draft = runner.run(ready(stack))
        yield Stand(runner, newcomer, page, draft, state_folder(folder / "cell.toml") / "still.json")
        runner.run(stack.aclose())


@pytest.fixture(autouse=True)
def _nothing_fails_unseen(stand: Stand) -> Iterator[None]:
    """No test may leave a console error."""
    yield
    assert [] == stand.page.complaints


@pytest.mark.long
async def test_a_part_is_proposed_with_its_true_sizes_and_each_tap_says_what_it_costs(stand: Stand) -> None:
    """Proposed sizes are true, taps and ticks show in both picture and list with their cost, and keys undo
    them."""
    page = stand.page
    await stand.take()
    await go(page, "teach")
    await page.until('document.querySelector("main h2")')
    assert [] == await page.violations()
    await press(page, "Take the pair")
    await page.until(PROPOSED)
    sizes = [re.search(r"Ø ([\d.]+) mm", row) for row in await page.value(ROWS)]
    diameters_mm = [float(size[1]) for size in sizes if size]
    assert DIAMETERS_MM == pytest.approx(diameters_mm, abs=0.02)

    figures = f"{FIGURES}.map((dd) => parseFloat(dd.innerText.slice(2)))"
    await page.until(QUIET)
    before = await page.value(figures)
    assert 6 == len(before)  # X Y Z A B C
    assert all(0 < value < 10 for value in before)
    await page.click(f"{LEFT} [data-key=c0]")  # within it are smaller ones: c1 is in its middle
    await page.until(f"{CHECKED}[1] === false")
    await page.until('document.querySelectorAll(".feature.left[data-key=c1]").length === 2')
    for row in (1, 3, 4, 5):
        await page.click(f".features-list li:nth-child({row}) input")
        await page.until(f"{CHECKED}[{row - 1}] === false")
    # with two small holes on the same side; the cost of a tap is relative to the one before
    await page.until(f"{figures}[3] > {before[3]} && document.querySelector('dd .before')")

    await page.value('document.querySelector(".features-list li:nth-child(3) input").focus()')
    await page.until('document.querySelectorAll(".feature.lit[data-key=c2]").length === 2')
    await stand.key("z", CTRL, 90)  # the box ticked last has the focus
    await page.until(f"{CHECKED}[4] === true")
    for row in (4, 3, 1, 2):
        await press(page, "Undo")
        await page.until(f"{CHECKED}[{row - 1}] === true")
    await page.until(QUIET)
    assert before == await page.value(figures)
    await press(page, "Redo")
    await page.until(f"{CHECKED}[1] === false")
    assert [] == await page.violations()
    assert [] == await page.value(SMALL_TARGETS)


async def test_wheel_and_fingers_bring_a_place_nearer_and_both_pictures_show_it(stand: Stand) -> None:
    """The point under the wheel stays in place, and the right picture zooms alike."""
    page = stand.page
    await stand.open()
    await press(page, "All")
    await page.until(f"{VIEW}[2] === 640")
    await page.wheel(LEFT, -400)
    await page.until(f"{VIEW}[2] < 350")
    x, y, width, height = await page.value(VIEW)
    assert (319.5, 239.5) == pytest.approx((x + width / 2, y + height / 2), abs=2)
    right = VIEW.replace("left", "right")
    assert [width, height] == (await page.value(right))[2:]
    await page.pinch(LEFT, (100, 200))
    await page.until(f"{VIEW}[2] < {0.7 * width}")
    await press(page, "All")
    await page.until(f"{VIEW}[2] === 640")


@pytest.mark.long
async def test_keys_alone_tap_and_move_points_as_finely_as_one_likes(stand: Stand) -> None:
    """Arrows move by 1 px, with shift 10, with alt 0.1; Enter taps at a cross, and Delete removes."""
    page = stand.page
    await stand.open()
    await page.value(f"""document.querySelector("{LEFT}").focus()""")
    was = await page.value(CHECKED)
    assert was[1]
    await stand.key("Enter")  # the middle of the view is that of the part: the bore
    await page.until(f"{CHECKED}[1] === false")
    await stand.key("Enter")
    await page.until(f"{CHECKED}[1] === true")

    start = (await stand.until(lambda now: now["proposing"] is None))["shapes"]
    await press(page, "Where the part is")
    await press(page, "Rectangle")
    await press(page, "Put one in the middle")
    await page.until('document.querySelectorAll(".handle").length === 4')
    await page.until(said("Rectangle 2"))
    first = (await stand.until(lambda now: now["shapes"][-1]["kind"] == "rectangle"))["shapes"][-1]
    await page.value('document.querySelector(".handle").focus()')
    for modifiers in (0, SHIFT, ALT):
        await stand.key("ArrowRight", modifiers)
    moved = (await stand.until(lambda now: now["shapes"][-1] != first))["shapes"][-1]
    assert 11.1 == pytest.approx(moved["x"] - first["x"], abs=1e-6)
    assert 11.1 == pytest.approx(first["width"] - moved["width"], abs=1e-6)
    await page.until(QUIET)
    await page.value('document.querySelector(".handle").focus()')
    await stand.key("Delete")
    await page.until('!document.querySelector(".handle")')
    for _ in range(3):  # the rectangle, its corner, and then nothing
        await press(page, "Undo")
    await stand.until(lambda now: now["shapes"] == start)


@pytest.mark.long
async def test_reference_grip_and_sizes_are_picked_on_the_part(stand: Stand) -> None:
    """A tap near a hole makes its centre the reference, and a size is judged at once against its true value.

    Grip, tray and name are entered and taken back.
    """
    page = stand.page
    await stand.open()
    await press(page, "Tap it in the picture")
    await page.click(f"{LEFT} [data-key=c3]")
    await page.until('document.querySelector(".columns select").value === "c3"')
    await press(page, "Type it")
    await page.until('document.querySelector("[name=grip-z]")')
    await page.type("[name=grip-z]", "-2,5")
    await page.until('document.querySelector("[name=grip-z]").value === "-2.500"')
    assert -2.5 == (await stand.until(lambda now: now["gripping"] is not None))["gripping"]["z_mm"]

    await press(page, "Add this size")
    await page.until('document.querySelector("[name=nominal]")')
    await page.type("[name=nominal]", "14")
    await page.type("[name=tolerance]", "0.02")
    await page.until(said("within"))
    await page.type("[name=nominal]", "14.1")
    await page.until(said("outside"))
    await page.type("[name=nominal]", "14")
    await page.until(said("within"))

    await press(page, "Describe a tray")
    await page.until('document.querySelector("[name=tray-rows]")')
    await page.type("[name=tray-rows]", "3")
    await page.until('document.querySelector("[name=tray-column-end-y]")?.value === "80.000"')
    await page.type("[name=tray-first-z]", "5")
    tray = (await stand.until(lambda now: now["tray"] and now["tray"]["first_mm"][2] == 5.0))["tray"]
    assert (2, 3, [40.0, 0.0, 0.0]) == (tray["columns"], tray["rows"], tray["row_end_mm"])
    await press(page, "No tray")
    await stand.until(lambda now: now["tray"] is None)

    await press(page, "No other place")
    await page.until('!document.querySelector("[name=grip-z]")')
    await page.choose(".columns select", "c0")
    await stand.until(lambda now: now["reference"]["key"] == "c0")
    await page.type("[name=job]", "no spaces")
    await page.until(said("beginning with a letter or digit"))
    await page.type("[name=job]", "flange-2")
    await page.until('document.querySelector(".draft-bar strong").textContent === "flange-2"')


@pytest.mark.long
async def test_a_further_pair_is_added_shown_and_removed(stand: Stand) -> None:
    """Both its pictures are shown with the finding that edges are sharp; removing it takes both back."""
    page = stand.page
    await stand.open()
    await stand.take()
    await press(page, "Add a pair")
    await page.until(f"{said('The edges are sharp')} && {QUIET}")
    shown = "[...document.querySelectorAll('[aria-labelledby=teach-further] img')]"
    await page.value(f"{shown}[0].scrollIntoView()")
    await page.until(f"{shown}.filter((one) => one.naturalWidth > 0).length === 2")
    assert [] == await page.violations()
    assert 1 == len((await stand.until(lambda now: now["proposing"] is None))["further"])
    await page.click('[aria-label="Remove pair 2"]')
    await page.until(f"{said('is not settled')} && {shown}.length === 0")


@pytest.mark.long
async def test_a_job_is_learnt_from_a_drawing_instead(stand: Stand, tmp_path: Path) -> None:
    """A DXF file gives the drawing's sizes on the pictured part, an error names its place in the file, and
    undo restores what the pair taught.
    """
    is_drawn = 'document.querySelector("#teach-drawing ~ .verdict")'
    is_open = flange_drawing(tmp_path, is_open=True).read_text()
    whole = flange_drawing(tmp_path).read_text()

    async def choose(page: Browser, name: str, text: str) -> None:
        await page.value(
            f"""(() => {{ const input = document.querySelector("[name=dxf]"), given = new DataTransfer();
            given.items.add(new File([{json.dumps(text)}], {json.dumps(name)}));
            input.files = given.files;
            input.dispatchEvent(new Event("change", {{bubbles: true}})); }})()"""
        )

    page = stand.page
    await stand.open()
    before = await stand.until(lambda now: now["proposing"] is None)
    await choose(page, "open.dxf", is_open)
    await page.until(said("An outline is open: it ends at x 40.000, y 5.000 mm."))
    page.complaints.clear()  # about the refusal
    await press(page, "Understood")
    await choose(page, "flange.dxf", whole)
    await page.until(is_drawn)
    drawn = await stand.until(lambda now: now["drawing"] is not None and now["proposing"] is None)
    assert None is drawn["trouble"]
    await page.until(QUIET)
    assert await page.value(said("Learnt from flange.dxf, its face "))
    await page.until(PROPOSED.replace("7", "6"))
    outline = np.concatenate([np.array(one) for one in drawn["outlines"]["left"]])
    taught = np.concatenate([np.array(one) for one in before["outlines"]["left"]])
    assert np.ptp(outline, axis=0) == pytest.approx(np.ptp(taught, axis=0), abs=8)
    assert outline.min(axis=0) == pytest.approx(taught.min(axis=0), abs=8)
    await page.value('document.querySelectorAll("main details").forEach((one) => (one.open = true))')
    assert [] == await page.violations()
    assert [] == await page.value(SMALL_TARGETS)
    await press(page, "Undo")
    await page.until(f"!{is_drawn}")
    back = await stand.until(lambda now: now["proposing"] is None)
    assert before["features"] == back["features"]


async def with_older_revision(stand: Stand) -> dict[str, Any]:
    """The draft, once an older revision of it exists."""
    draft: dict[str, Any] = await stand.until(lambda now: now["proposing"] is None)
    for name in (f"{draft['name']}-", draft["name"]):
        named = {"revision": draft["revision"], "name": name}
        draft = await stand.newcomer.ask("PUT", f"teachings/{stand.draft}", named)
    return draft


async def test_who_was_slower_is_told_and_sees_what_the_other_did(stand: Stand) -> None:
    """A change based on an old revision is refused, and the page shows the newer draft and says so."""
    page = stand.page
    await with_older_revision(stand)
    await stand.open()
    await page.value(
        "import('/static/setup/teaching/teaching.js').then(({teaching}) => "
        "{ teaching.value = {...teaching.value, revision: teaching.value.revision - 1, name: 'older'}; })"
    )
    was = await page.value(CHECKED)
    await page.click(".features-list li:nth-child(4) input")
    await page.until(said("This was changed meanwhile"))
    assert was == await page.value(CHECKED)
    assert "older" != await page.value('document.querySelector(".draft-bar strong").textContent')
    page.complaints.clear()  # about the refusal


async def test_a_tap_on_the_part_holds_whatever_the_cell_has_found_meanwhile(stand: Stand) -> None:
    """A tap based on an old revision is sent again automatically, as its place in the picture is
    unchanged."""
    page = stand.page
    before = await with_older_revision(stand)
    await stand.open()
    x, y = np.mean(before["features"][0]["outline"]["left"], axis=0).tolist()
    await page.value(
        "import('/static/setup/teaching/teaching.js').then(async ({teaching, change}) => {"
        "  teaching.value = {...teaching.value, revision: teaching.value.revision - 1};"
        f"  globalThis.isTapped = await change('POST', '/tap', {{x: {x}, y: {y}}}); }})"
    )
    assert await page.value("globalThis.isTapped")
    assert not await page.value(said("This was changed meanwhile"))
    page.complaints.clear()  # about the first try
    tapped = await stand.until(lambda now: now["proposing"] is None and now["revision"] > before["revision"])
    await stand.newcomer.ask("POST", f"teachings/{stand.draft}/undo", {"revision": tapped["revision"]})
    await stand.until(lambda now: now["proposing"] is None and now["revision"] > tapped["revision"])


@pytest.mark.parametrize(("width", "height"), [(360, 740), (1920, 1080)])
async def test_everybody_can_teach(stand: Stand, width: int, height: int) -> None:
    """axe finds nothing, all texts are translated and fit, also doubled, and targets are large enough."""
    page = stand.page
    await stand.open(width, height, "?pseudo")
    await page.until(QUIET)
    assert [] == await page.value(UNTRANSLATED)
    assert 0 == await page.value(TOO_WIDE)
    assert [] == await page.violations()
    assert [] == await page.value(SMALL_TARGETS)
    await page.value('document.documentElement.style.fontSize = "200%"')
    assert 0 == await page.value(TOO_WIDE)
    assert not await page.value(DIALOG)


async def test_the_cell_is_turned_in_space_by_mouse_and_keys(stand: Stand) -> None:
    """Both cameras are drawn, a drag reverses a key's turn, and the page is accessible."""
    paths = """[...document.querySelectorAll(".space path")].map((e) => e.getAttribute("d")).join()"""
    page = stand.page
    await stand.open(
        360, 740, "?pseudo", "space", 'document.querySelectorAll(".space .camera").length === 10'
    )
    assert [] == await page.value(UNTRANSLATED)
    assert [] == await page.violations()
    assert [] == await page.value(SMALL_TARGETS)
    assert 0 == await page.value(TOO_WIDE)
    first = await page.value(paths)
    await page.value('document.querySelector(".space").focus()')
    await page.press("ArrowLeft")
    await page.until(f"{paths} !== {first!r}")
    x, y = await page.middle(".space")
    for kind, moved in (("mousePressed", 0), ("mouseMoved", 15), ("mouseReleased", 15)):
        await page.ask(
            "Input.dispatchMouseEvent",
            type=kind,
            x=x + moved,
            y=y,
            button="left",
            buttons=1,
            clickCount=1,
        )
    await page.until(f"{paths} === {first!r}")
    await page.wheel(".space", -100)
    await page.until(f"{paths} !== {first!r}")
    await page.press("0")
    await page.until(f"{paths} === {first!r}")


@pytest.mark.long
@pytest.mark.parametrize("language", ["fr", "ja", "zh"])
async def test_every_page_fits_a_phone_in_every_language(stand: Stand, language: str) -> None:
    """360 px are enough, every text is translated, and only names are English."""
    texts = 'import("/static/setup/shared/texts.js")'
    page = stand.page
    await stand.open(360, 740)
    await page.value(f'{texts}.then((texts) => texts.choose("{language}"))')
    assert language == await page.value("document.documentElement.lang")
    for step in STEPS:
        await go(page, step)
        await page.until(f"""document.querySelector('main[data-page="{step}"]')""")
        if step == "settings":
            await page.until("document.querySelector('.setting')")  # they come from the cell
        assert 0 == await page.value(TOO_WIDE), step
        assert [] == [text for text in await page.value(TEXTS) if re.fullmatch(TEXT_ID, text)], step
    assert [] == await page.violations()
    await page.value(f'{texts}.then((texts) => texts.choose("en"))')


@pytest.mark.long
async def test_a_draft_is_tried_where_the_part_lies_and_the_map_says_what_is_to_come(stand: Stand) -> None:
    """Every outline is drawn and each place kept, and leaving the page ends the trial.

    The figures of a still test are shown.
    """
    placed = 'document.querySelectorAll(".covered").length'
    page = stand.page
    await stand.open(
        step="try", there=f"""document.querySelector("[name=which]")?.value.includes("{stand.draft}")"""
    )
    await stand.take()
    await page.until('document.querySelectorAll(".sigma-map text").length > 20')
    await press(page, "Try it live")
    await page.until(said("Good"))
    await page.until('document.querySelectorAll(".view .tried .line").length >= 10')
    await page.until(f"{placed} === 1")
    await stand.newcomer.ask("POST", "stage/lay", {})
    await page.until(f"{placed} === 2")
    assert [] == await page.violations()
    assert [] == await page.value(SMALL_TARGETS)
    await go(page, "jobs")
    await stand.newcomer.until("trials", lambda now: not now["on"])
    # as for a part that shakes: more than its noise, but within its sigma
    um = {name: dict.fromkeys("xyz", um) for name, um in (("scatter", 0.5), ("noise", 0.2), ("edges", 0.75))}
    found: dict[str, Any] = {f"{name}_um": values for name, values in um.items()}
    found |= {
        "at": "2026-01-31T12:00:00+00:00",
        "by": "me",
        "name": "flange",
        "calibration": "demo",
        "n": 30,
    }
    found |= {"chi2": 6.25, "expected": [0.72, 1.72], "verdict": "larger", "covers": True}
    stand.still.write_text(json.dumps(found))
    await stand.open(step="try", there=STILL)
    assert ["X", "0.50 µm", "0.20 µm", "0.75 µm"] == (await page.value(STILL_ROWS))[0]
    assert await page.value(said("more than the noise of the edges explains: 6.25, expected 0.72 to 1.72"))
    await stand.open(360, 740, "?pseudo", "try", 'document.querySelector(".sigma-map text")')
    assert [] == await page.value(UNTRANSLATED)
    assert 0 == await page.value(TOO_WIDE)
    await page.value('document.documentElement.style.fontSize = "200%"')
    assert 0 == await page.value(TOO_WIDE)


@pytest.mark.long
async def test_a_job_in_use_finds_the_part_where_it_truly_is(stand: Stand) -> None:
    """Two buttons turn a draft into a release that the cell measures with, and the list shows its
    accuracy."""
    page = stand.page
    await stand.open()
    await stand.take()
    name = (await stand.until(lambda now: now["proposing"] is None))["name"]
    await press(page, "Use this job")
    await page.until(DIALOG)
    await page.type("dialog[open] input", "the first")
    await page.click("dialog[open] .primary")
    await page.until(said(f"{name} is in use, as release"))
    await go(page, "jobs")
    await page.until(said("no cycles yet"))
    await press(page, "Name and number")
    await page.until(DIALOG)
    await page.type("dialog[open] [name=job]", "cover")
    await page.type("dialog[open] [name=number]", "7")
    await page.type("dialog[open] [name=note]", "as the drawing calls it")
    await page.click("dialog[open] .primary")
    await page.until(f"!{DIALOG}")  # the list may be updated before the answer arrives
    await stand.newcomer.until("jobs", lambda now: "cover" in [job["name"] for job in now["jobs"]])
    await page.until(said("cover"))
    await press(page, "Duplicate")
    await page.until(DIALOG)
    await page.type("dialog[open] [name=note]", "with another tolerance")
    await page.click("dialog[open] .primary")
    await page.until(f"!{DIALOG}")
    await stand.newcomer.until("jobs", lambda now: len(now["jobs"]) == 2)
    await page.until(said("cover-2"))
    await page.click(".versions summary")
    await page.until(said("me · with another tolerance"))
    await page.click(".lease button")
    await page.until(DIALOG)
    await page.click("dialog[open] .primary")
    truth = await stand.newcomer.until("stage/truth", lambda now: now["error_mm"] is not None)
    assert "OK" == truth["status"]
    assert [0, 0, 0] == pytest.approx(truth["error_mm"], abs=0.02)

    await stand.open(step="jobs", there=said("100 % of"))
    assert [] == await page.violations()
    assert [] == await page.value(SMALL_TARGETS)
    await stand.open(360, 740, "?pseudo", "jobs", 'document.querySelector(".job")')
    assert [] == await page.value(UNTRANSLATED)
    assert 0 == await page.value(TOO_WIDE)


@pytest.mark.long
async def test_another_part_is_taught_after_one_is_in_use_and_after_one_is_discarded(stand: Stand) -> None:
    """Each next part is taught from a fresh pair, on the page where the previous one was finished."""
    page = stand.page
    await stand.open()
    await stand.take()
    await press(page, "Another part")
    await press(page, "Take the pair")
    await page.until(PROPOSED)
    await page.until(QUIET)
    await press(page, "Use this job")
    await page.until(DIALOG)
    await page.type("dialog[open] input", "the second")
    await page.click("dialog[open] .primary")
    await page.until(said("is in use, as release"))
    await press(page, "Another part")
    for _ in range(2):
        await press(page, "Take the pair")
        await page.until(PROPOSED)
        await discard(page)
        await page.until('document.querySelector("#teach-begin")')
