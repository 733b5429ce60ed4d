"""The status page over real HTTP: what it shows, who may see it, and that it never delays a cycle."""

from __future__ import annotations

import asyncio
import contextlib
import io
import itertools
import json
import math
import re
import threading
import time
from asyncio import StreamReader, StreamWriter
from base64 import b64encode
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import aiohttp
import cv2
import numpy as np
import pytest
from helpers.browsersession import PASSWORD, browsing
from helpers.cells import flange, frame_pair
from helpers.livecell import GRASPS
from helpers.pagesources import FixedSources
from helpers.snapshots import make_snapshot, make_target, make_transform
from helpers.waiting import LIMIT_S, until
from helpers.webcell import HASH
from rich.console import Console

from edged.adapters.web import WebPublisher, WebSettings, login, page, places, server, viewers
from edged.adapters.web.assets import read_assets
from edged.adapters.web.marks import outlines
from edged.adapters.web.page import FAULTS, HISTORY, RECENT, SPARE, THUMBNAIL_PX, StatusPage, picture
from edged.adapters.web.server import FREE
from edged.commands.status import status
from edged.domain.cell import CalibrationHealth, CellPhase, CellState, DriftState, SetupSource
from edged.domain.events import ExposureDone, Snapshot
from edged.domain.frames import Frame, FramePair
from edged.domain.measurement import Match, Nearest, NearMiss, NotMeasured, Reject, Status
from edged.errors import ListenError
from edged.identity.access import Access
from edged.identity.attempts import MAX_WAITING, TooManyAttempts
from edged.payload import translatable
from edged.plc.registers import Kind, Register
from edged.plc.registers.values import measured
from edged.robot.grasping import allowed_grasps
from edged.robot.orientations import Convention
from edged.sim.cell import demo_rig
from edged.vision.geometry.rectification import make_rectification

COOKIE = login.cookie_name("cell<1>", secure=False).encode()
SLOW_FORM = (
    b"POST /login HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://127.0.0.1\r\nContent-Length: 99\r\n\r\npass"
)
RECTIFICATION = make_rectification(demo_rig())
READY = CellState(CellPhase.READY, True, True, "flange", 1, 0)
SETUP = CellState(CellPhase.SETUP, False, True, "flange", 1, 0, setup=SetupSource.PERSON)


async def some_metrics() -> bytes:
    """Prometheus text."""
    return b"# HELP edged_x x\nedged_x 1\n"


def sources(facts: Mapping[str, Mapping[str, Any]] | None = None) -> FixedSources:
    """Fixed sources of the page."""
    return FixedSources(
        rectification=lambda: RECTIFICATION,
        jobs=lambda: [(1, "flange"), (2, "<script>alert(1)</script>")],
        facts=lambda: facts or {"Modbus": {"clients": 2}},
        known_registers=lambda: [
            (Register("SEQ_HEAD", 300, Kind.U32, "", "sequence"), 7),
            (Register("F_X", 500, Kind.F32, "mm", "x"), float("nan")),
        ],
        convention=lambda: Convention.KUKA_ABC,
    )


def make_pair(grey: int = 100) -> FramePair:
    """A pair of the rig's image size."""
    rig = RECTIFICATION.rig
    return FramePair(
        *(
            Frame(side, 1, np.full((camera.height, camera.width), grey, np.uint8), 0, 1)
            for side, camera in (("left", rig.left), ("right", rig.right))
        )
    )


def measure(web: WebPublisher | StatusPage, cycle: int, status: Status = Status.OK, error: str = "") -> None:
    """Publish one cycle with pictures, or without in case of a camera fault."""
    take = web.announce if isinstance(web, WebPublisher) else web.take
    if not error:
        take(ExposureDone(cycle, None, make_pair()))
    take(replace(make_snapshot(cycle, status), error=error, error_code=104 if error else 0))


def words(fault: Mapping[str, Any]) -> str:
    """English text of a fault."""
    return ". ".join(one["text"] for one in fault["why"])


@asynccontextmanager
async def served(
    settings: WebSettings | None = None,
    asked: FixedSources | None = None,
    metrics: Callable[[], Awaitable[bytes]] = some_metrics,
) -> AsyncIterator[tuple[WebPublisher, aiohttp.ClientSession]]:
    """A page on a free port, with a browser's session."""
    web = WebPublisher("cell<1>", settings or WebSettings(port=0), asked or sources(), metrics)
    await web.start()
    try:
        async with browsing(f"http://127.0.0.1:{web.port}") as session:
            yield web, session
    finally:
        await web.close()


def own_origin(session: aiohttp.ClientSession) -> dict[str, str]:
    """The header that a browser sends with a form of the page."""
    return {"Origin": str(session._base_url).rstrip("/")}  # noqa: SLF001  (what it has open)


async def next_event(stream: aiohttp.StreamReader) -> tuple[str, dict[str, Any]]:
    """Name and data of the next server-sent event."""
    name = ""
    while True:
        line = (await stream.readline()).decode().rstrip("\n")
        if line.startswith("event: "):
            name = line[7:]
        elif line.startswith("data: "):
            return name, json.loads(line[6:])


async def test_every_path_has_its_headers() -> None:
    """Only own scripts, no frames and no caching, also for errors."""
    async with served() as (_, session):
        for path in (
            "/",
            "/status.json",
            "/registers.json",
            "/metrics",
            "/nowhere",
            *map("/static/{}".format, read_assets()),
        ):
            async with session.get(path) as answer:
                assert (answer.status == 200) == (path != "/nowhere"), path
                assert "script-src 'self'" in answer.headers["Content-Security-Policy"]
                assert answer.headers["Cache-Control"] == "no-store"


async def test_the_page_needs_nothing_from_elsewhere() -> None:
    """No page or asset refers to an external address, as a cell PC has no internet."""
    async with served() as (_, session):
        for path in ("/", "/login", *map("/static/{}".format, read_assets())):
            async with session.get(path) as answer:
                text = await answer.text()
            namespaces = r"http://www\.w3\.org/(2000/svg|1999/xhtml|1998/Math/MathML)"
            found = [
                one for one in re.findall(r"https?://[^\"' ]+", text) if not re.fullmatch(namespaces, one)
            ]
            assert [] == found, path
            assert "<script>" not in text and " onclick" not in text


async def test_a_viewer_hears_of_each_cycle() -> None:
    """A viewer gets everything first, then the newest state with the points since, each once."""
    async with served() as (web, session):
        web.announce(READY)
        measure(web, 1)
        async with session.get("/events") as answer:
            name, first = await next_event(answer.content)
            assert (name, [point["cycle"] for point in first["points"]]) == ("all", [1])
            assert first["cell"] == "cell<1>"
            assert first["state"]["ready"]
            assert first["result"]["targets"][0]["position_mm"][0] == 10.0
            for cycle in (2, 3, 4):
                measure(web, cycle)
            seen: list[int] = []
            while not seen or seen[-1] < 4:
                _, update = await next_event(answer.content)
                seen += [point["cycle"] for point in update["points"]]
            assert seen == [2, 3, 4]


@pytest.mark.long
async def test_a_viewer_that_does_not_read_holds_nothing_up() -> None:
    """Announcing stays fast with a viewer that does not read, and no states are queued for it."""
    async with served() as (web, session), session.get("/events"):
        for cycle in range(1, 3 * HISTORY):
            measure(web, cycle)
            if cycle % 100 == 0:
                await asyncio.sleep(0)
        async with session.get("/status.json") as answer:
            assert (await answer.json())["result"]["cycle"] == 3 * HISTORY - 1


async def test_closing_ends_every_viewer() -> None:
    """Closing the page ends open event streams at once."""
    async with served() as (web, session), session.get("/events") as answer:
        await next_event(answer.content)
        await asyncio.wait_for(web.close(), LIMIT_S)
        assert (await answer.content.read()).strip() == b""


async def test_pictures_are_rectified_and_end_with_their_cycle() -> None:
    """A picture is a JPEG in the shape of the rectified image, and 404 for an old cycle, other sides or
    sizes."""
    async with served() as (web, session):
        for cycle in range(1, RECENT + SPARE + 2):
            measure(web, cycle)
        width, height = RECTIFICATION.size
        for size, width_px in (("", 960), ("/small", THUMBNAIL_PX), ("/full", width)):
            async with session.get(f"/picture/2/left{size}") as answer:
                image = cv2.imdecode(np.frombuffer(await answer.read(), np.uint8), cv2.IMREAD_UNCHANGED)
            assert image is not None
            assert width_px == image.shape[1]
            assert abs(image.shape[1] / image.shape[0] - width / height) < 0.01
            assert abs(int(np.median(image)) - 100) <= 1
        for path in ("1/left", "2/middle", "2/left/huge", "99999999999999999999/left"):
            path = f"/picture/{path}"
            async with session.get(path) as answer:
                assert answer.status == 404


@pytest.mark.parametrize("width_px", [960, 200])
def test_a_picture_is_the_rectified_image_in_small(width_px: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sampled directly at the page's size, it equals the rectified image shrunk afterwards."""
    monkeypatch.setattr(page, "WIDTH_PX", width_px)
    pair = frame_pair(flange().left, flange().right)
    rectification = make_rectification(flange().rig)
    for side, rectify, image in (
        ("left", rectification.left_image, pair.left.image),
        ("right", rectification.right_image, pair.right.image),
    ):
        shown = cv2.imdecode(
            np.frombuffer(picture(pair, rectification, side), np.uint8),
            cv2.IMREAD_UNCHANGED,
        )
        assert shown is not None
        assert shown.shape[1] == min(width_px, rectification.size[0])
        whole = cv2.resize(rectify(image), shown.shape[::-1], interpolation=cv2.INTER_AREA).astype(float)
        apart = {
            (dx, dy): float(np.std((np.roll(whole, (dy, dx), (0, 1)) - shown)[2:-2, 2:-2]))
            for dx in (-1, 0, 1)
            for dy in (-1, 0, 1)
        }
        assert min(apart, key=lambda shift: apart[shift]) == (0, 0)
        assert apart[0, 0] < 4.0


def test_marks_lie_on_the_parts_edge() -> None:
    """A circle, slot and edge of the rig, projected by the camera models and rectified, lie on the drawn
    outlines."""
    target = replace(make_target(), rig_from_part=make_transform((0.0, 0.0, 0.0), (10.0, 20.0, 200.0)))
    circle = target.circles[0]
    marks = {side: outlines(target, RECTIFICATION, side) for side in ("left", "right")}
    width, height = RECTIFICATION.size
    for side, camera in (("left", RECTIFICATION.rig.left), ("right", RECTIFICATION.rig.right)):
        drawn, slot, edge = (np.array(one) * [width, height] - 0.5 for one in marks[side]["features"])
        raw = RECTIFICATION.raw_points(side, drawn)
        from_rig = np.eye(4) if side == "left" else RECTIFICATION.rig.right_from_left
        rays = np.column_stack([camera.normalise(raw), np.ones(len(raw))]) @ from_rig[:3, :3]
        eye = -from_rig[:3, :3].T @ from_rig[:3, 3]
        depth = ((circle.centre_mm - eye) @ circle.normal) / (rays @ circle.normal)
        radius = np.linalg.norm(eye + depth[:, None] * rays - circle.centre_mm, axis=1)
        assert np.allclose(radius, circle.radius_mm, atol=0.01), side
        assert np.array_equal(slot[0], slot[-1])
        for line, ends in (
            (edge, [target.edges[0].start_mm, target.edges[0].end_mm]),
            (slot[[np.argmin(slot[:, 0]), np.argmax(slot[:, 0])]], [(5.5, 1.0, 200.0), (14.5, 1.0, 200.0)]),
        ):
            seen = camera.project(np.array(ends) @ from_rig[:3, :3].T + from_rig[:3, 3])
            assert np.abs(RECTIFICATION.raw_points(side, line) - seen).max() < 0.3, side


def test_the_page_says_where_a_sigma_comes_from() -> None:
    """The budget is that of the first good part, with the job's limit, and its squares add up to the
    sigma."""
    page = StatusPage("cell", replace(sources(), limits=lambda: {1: 0.2}))
    assert page.status()["budget"] is None
    target = make_target()
    bad = make_target(Reject.SIGMA_LIMIT)
    known = replace(target, by_edges=0.25 * target.covariance)
    page.take(make_snapshot(1, Status.OK, (bad, known)))
    budget = page.status()["budget"]
    assert (0.2, False, "rig") == (budget["limit_mm"], budget["free"], budget["frame"])
    sigma = np.sqrt(np.diag(target.covariance))
    np.testing.assert_allclose(budget["sigma"]["mm"], sigma[:3])
    np.testing.assert_allclose(budget["terms"]["edges"]["deg"], 0.5 * np.degrees(sigma[3:]))
    np.testing.assert_allclose(budget["terms"]["calibration"]["mm"], math.sqrt(0.75) * sigma[:3])
    assert [0.0, 0.0, 0.0] == budget["terms"]["doubt"]["mm"]
    page.take(make_snapshot(2, Status.OK, (target,)))
    assert page.status()["budget"] is None


def test_the_tool_is_drawn_where_it_takes_the_part() -> None:
    """The tool is drawn from approach to tip as the cameras see it, and not without a grasp."""
    target = make_target()
    assert [] == outlines(target, RECTIFICATION, "left")["tool"]
    (grasp,) = allowed_grasps(target, GRASPS.grasps, lambda _pose: True)
    width, height = RECTIFICATION.size
    held = replace(target, grasp=grasp)
    for side, camera in (("left", RECTIFICATION.rig.left), ("right", RECTIFICATION.rig.right)):
        drawn = np.array(outlines(held, RECTIFICATION, side)["tool"]) * [width, height] - 0.5
        from_rig = np.eye(4) if side == "left" else RECTIFICATION.rig.right_from_left
        for point, pose in zip(drawn, (grasp.rig_from_approach, grasp.rig_from_tcp), strict=False):
            raw = camera.project((from_rig @ pose)[:3, 3][None])
            rays = np.column_stack([camera.normalise(raw), np.ones(1)])
            back = np.column_stack(
                [camera.normalise(RECTIFICATION.raw_points(side, point[None])), np.ones(1)]
            )
            assert np.allclose(rays, back, atol=2e-3), side


def test_the_last_faults_stay_and_a_repeated_one_is_listed_once() -> None:
    """A repeated fault is listed once with its count, leaving earlier faults in the list."""
    page = StatusPage("cell", sources())
    measure(page, 1, Status.LOW_QUALITY)
    for cycle in range(2, 50):
        measure(page, cycle, Status.CAPTURE_FAULT, "cable")
    measure(page, 50)

    faults = page.status()["faults"]
    assert [(fault["cycle"], words(fault), fault["has_picture"], fault["times"]) for fault in faults] == [
        (2, "cable", False, 48),
        (1, "", True, 1),
    ]
    for cycle in range(51, 51 + 2 * FAULTS):
        page.take(replace(make_snapshot(cycle, Status.NO_TARGET), job=f"job {cycle}"))
    assert len(page.status()["faults"]) == FAULTS


def test_a_miss_that_repeats_is_listed_once() -> None:
    """A repeated miss is one line with its count; another reason, job or hour starts another line."""
    page, match = StatusPage("cell", sources()), Match(512.0, 300.4, 0.1, 1.0, 1.0, 0.91)
    for cycle in range(1, 40):
        measure(page, cycle, Status.NO_TARGET if cycle % 3 else Status.OK)
    empty, start_ns = make_snapshot(40, Status.NO_TARGET), make_snapshot().published_ns
    page.take(replace(empty, cycle=41, dismissed=(NotMeasured(match, Reject.LEFT_RIGHT_MISMATCH),)))
    page.take(replace(empty, cycle=42, published_ns=start_ns + 59 * 10**9))
    page.take(replace(empty, cycle=43, published_ns=start_ns + 118 * 10**9))
    page.take(replace(empty, cycle=44, published_ns=start_ns + 179 * 10**9))

    faults = [(fault["cycle"], fault["times"], fault["has_picture"]) for fault in page.status()["faults"]]
    assert [(44, 1, False), (41, 1, False), (1, 28, True)] == faults
    assert start_ns + 118 * 10**9 == page.status()["faults"][2]["last_ns"]


def test_the_last_cycles_stay_to_be_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """Recent cycles, newest first, have marks and reasons; with large cameras only the newest is kept."""
    page = StatusPage("cell", sources())
    newest = RECENT + SPARE + 2
    for cycle in range(1, newest + 1):
        measure(page, cycle, Status.OK if cycle % 2 else Status.LOW_QUALITY)
    measure(page, 99, Status.CAPTURE_FAULT, "cable")

    recent = page.status()["recent"]
    assert [newest - n for n in range(RECENT)] == [one["cycle"] for one in recent]
    assert ["LOW_QUALITY", "OK"] == [one["status"] for one in recent[:2]]
    shown = page.cycle(newest - 1)
    assert shown is not None
    assert 1 == len(shown["picture"]["marks"])
    assert page.cycle(newest - RECENT) is not None  # for a viewer who has just received its number
    assert page.cycle(1) is None
    assert page.cycle(2) is not None  # no longer recent, but the first of its kind of fault
    assert page.cycle(99) is None

    monkeypatch.setattr("edged.adapters.web.page.RECENT_BYTES", 1)
    measure(page, 100)
    assert [100] == [one["cycle"] for one in page.status()["recent"]]


async def test_a_cycle_can_be_asked_for() -> None:
    """/cycle gives what the enlarged pictures need, and 404 once it is forgotten."""
    async with served() as (web, session):
        web.announce(ExposureDone(5, None, make_pair()))
        web.announce(make_snapshot(5, Status.LOW_QUALITY, (make_target(Reject.SIGMA_LIMIT),)))
        async with session.get("/cycle/5.json") as answer:
            shown = await answer.json()
        assert (5, "LOW_QUALITY", "flange") == (shown["cycle"], shown["status"], shown["job"])
        assert ["SIGMA_LIMIT"] == [one["code"] for one in shown["why"]]
        assert [False] == [mark["good"] for mark in shown["picture"]["marks"]]
        async with session.get("/cycle/6.json") as answer:
            assert 404 == answer.status


def test_a_page_in_fault_knows_since_when_there_is_no_picture() -> None:
    """Without a picture, the time of the last one is still known."""
    page = StatusPage("cell", sources())
    assert 0 == page.status()["pictured_ns"]
    measure(page, 1)
    seen_ns = page.status()["pictured_ns"]
    measure(page, 2, Status.CAPTURE_FAULT, "cable")

    assert seen_ns > 0
    assert (None, seen_ns) == (page.status()["picture"], page.status()["pictured_ns"])


def test_trends_are_of_what_can_get_worse() -> None:
    """Trends hold sigma, rows and drift of good cycles; a fault has only cycle, time and status."""
    page = StatusPage("cell", sources())
    page.take(replace(make_snapshot(1), drift=DriftState(CalibrationHealth.HOLDS, 0.05, math.nan)))
    measure(page, 2, Status.CAPTURE_FAULT, "cable")
    good, bad = page.history()

    assert (max(make_snapshot().targets[0].sigma_mm), 0.05) == (good["sigma_mm"], good["drift_px"])
    assert {"cycle", "time_ns", "status"} == set(bad)


def test_the_orientation_is_what_the_plc_reads() -> None:
    """The angles are those of the registers, in the cell's convention and the robot's frame."""
    page = StatusPage("cell", sources())
    turned = make_transform((0.3, -0.2, 2.0), (100.0, 0.0, 0.0))
    snapshot = make_snapshot(1, robot_from_rig=turned)
    page.take(snapshot)
    best = measured(snapshot, Convention.KUKA_ABC).poses[0]
    (shown,) = page.status()["angles"]["of"]

    assert "kuka_abc" == page.status()["angles"]["convention"]
    assert best is not None
    assert list(best.integers[3:]) == [round(1000 * value) for value in shown["deg"]]


async def test_the_log_in_names_the_cell() -> None:
    """The form shows the cell's name, escaped."""
    async with (
        served(WebSettings(port=0, password_hash=HASH)) as (_, session),
        session.get("/login") as answer,
    ):
        assert '<h1 translate="no">cell&lt;1&gt;</h1>' in await answer.text()


def test_why_nothing_was_found_reaches_the_page() -> None:
    """A match that could not be measured is shown with its place, else the best score, its place and
    advice."""
    page, match = StatusPage("cell", sources()), Match(512.0, 300.4, 0.1, 1.0, 1.0, 0.91)
    for cycle, code, found, expected in (
        (
            1,
            "SEEN",
            {"dismissed": (NotMeasured(match, Reject.LEFT_RIGHT_MISMATCH),)},
            r"512, 300 px .*LEFT_RIGHT_MISMATCH.*Try",
        ),
        (
            2,
            "NEAREST",
            {"nearest": Nearest(lambda: NearMiss(replace(match, score=0.52), 0.6))},
            r"0\.52 at 512, 300 px, 0\.60 is needed\. Try",
        ),
        (3, "NOTHING", {}, r"nothing in the left picture is like the part\. Try"),
    ):
        page.take(replace(make_snapshot(cycle, Status.NO_TARGET), **found))
        for question in set(page.questions()):
            assert [] == page.status()["why"]  # not yet known
            question.ask()
        (line,) = page.status()["why"]
        assert code == line["code"]
        assert re.search(expected, line["text"])
        assert [line] == page.status()["faults"][0]["why"] or cycle > 1


async def test_only_a_viewer_has_the_cell_look_again() -> None:
    """A miss starts the search for the nearest match only when a viewer looks, once, outside of the loop."""
    looks = list[str]()

    def look() -> None:
        looks.append(threading.current_thread().name)

    async with served() as (web, session):
        web.announce(replace(make_snapshot(1, Status.NO_TARGET), nearest=Nearest(look)))
        assert not looks
        for _ in range(2):
            async with session.get("/status.json") as answer:
                (line,) = (await answer.json())["why"]
                assert "nothing in the left picture is like the part" in line["text"]
        (thread,) = looks
        assert thread.startswith("web")  # never the loop's thread, which has to answer the PLC


def test_a_fault_without_pictures_is_not_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """If its pictures have been dropped, a fault is not searched again and has no reason."""
    monkeypatch.setattr(page, "FAULT_BYTES", 0)
    shown, asked = StatusPage("cell", sources()), [Nearest(lambda: None), Nearest(lambda: None)]
    for cycle, nearest in enumerate(asked, 1):
        shown.take(ExposureDone(cycle, None, make_pair()))
        shown.take(replace(make_snapshot(cycle, Status.NO_TARGET), nearest=nearest, job=f"job {cycle}"))
    assert {asked[1]} == set(shown.questions())
    assert asked[0].ask() is None
    assert not asked[0].answered
    assert [] == shown.status()["faults"][1]["why"]


def test_pictures_of_faults_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """With large cameras the oldest faults lose their pictures and say so; the newest always has them."""
    pair = make_pair()
    monkeypatch.setattr(page, "FAULT_BYTES", 2 * (pair.left.image.nbytes + pair.right.image.nbytes))
    shown = StatusPage("cell", sources())
    for cycle in (1, 2, 3, 4):
        shown.take(ExposureDone(cycle, None, make_pair()))
        shown.take(replace(make_snapshot(cycle, Status.NO_TARGET), job=f"job {cycle}"))
    for cycle in range(5, 5 + RECENT + SPARE):
        measure(shown, cycle)

    faults = shown.status()["faults"]
    assert [(4, True), (3, True), (2, False), (1, False)] == [(f["cycle"], f["has_picture"]) for f in faults]
    assert shown.pair(3) is not None
    assert shown.pair(2) is None


def test_why_a_target_was_not_good_is_in_words() -> None:
    """The reason is "sigma over its limit", with its code."""
    page = StatusPage("cell", sources())
    page.take(make_snapshot(1, Status.LOW_QUALITY, (make_target(Reject.SIGMA_LIMIT),)))

    (why,) = page.status()["faults"][0]["why"]
    assert {"code": "SIGMA_LIMIT", "text": "sigma over its limit"} == why
    assert page.history()[0].get("position_mm") is None


async def test_a_terminal_says_facts_and_the_last_fault_in_english() -> None:
    """`edged status` prints values as they are and messages as sentences, several on one line."""
    facts = {
        "Cameras": {
            "source": "gige",
            "left": [translatable("temperature", "41.5 °C", value="41.5"), translatable("a", "b c")],
        }
    }
    console = Console(file=io.StringIO(), width=200)
    async with served(asked=sources(facts)) as (web, _):
        web.announce(READY)
        bad = make_target(Reject.SIGMA_LIMIT | Reject.KEEP_OUT)
        web.announce(make_snapshot(5, Status.LOW_QUALITY, (bad,)))
        code = await asyncio.to_thread(status, f"http://127.0.0.1:{web.port}", False, console)
        assert 0 == code
    assert isinstance(console.file, io.StringIO)
    told = console.file.getvalue()
    assert "source gige, left 41.5 °C; b c" in told
    assert "cycle 5: sigma over its limit. in a keep-out zone" in told


async def test_numbers_that_are_none_are_null() -> None:
    """A register that is NaN is null in JSON."""
    async with served() as (_, session), session.get("/registers.json") as answer:
        rows = json.loads(await answer.text(), parse_constant=lambda name: pytest.fail(name))
        assert [(row["value"], row["text"]) for row in rows] == [(7, "7"), (None, "–")]


async def test_ready_tells_a_load_balancer_and_a_person() -> None:
    """/ready is 503 with the reason until a trigger would be carried out, and /health always 200."""
    async with served() as (web, session):
        for state, expected in (
            (CellState(CellPhase.FAULT, False, False, "flange", 1, 0, "cable", 104), 503),
            (replace(SETUP, setup_by="Anna"), 503),
            (READY, 200),
        ):
            web.announce(state)
            async with session.get("/ready") as answer:
                assert answer.status == expected
                assert (await answer.json())["error"] == state.why
            async with session.get("/health") as answer:
                assert (answer.status, (await answer.json())["state"]) == (200, state.state)


async def test_without_a_session_only_the_form_is_shown() -> None:
    """Every other path needs the password; a browser is redirected to the form, a scraper gets a
    challenge."""
    async with served(WebSettings(port=0, password_hash=HASH)) as (_, session):
        for path in (
            "/status.json",
            "/events",
            "/registers.json",
            "/metrics",
            "/picture/1/left",
            "/static/run/run.js",
        ):
            async with session.get(path) as answer:
                assert answer.status == 401, path
        for path in sorted(FREE):
            async with session.get(path) as answer:
                assert answer.status in (200, 503), path
        async with session.get("/", headers={"Accept": "text/html"}) as answer:
            assert answer.url.path == "/login"
        basic = "Basic " + b64encode(f"prometheus:{PASSWORD}".encode()).decode()
        async with session.get("/metrics", headers={"Authorization": basic}) as answer:
            assert (await answer.text()).startswith("# HELP")


async def test_links_of_the_plant_stand_below_the_page() -> None:
    """Configured links are in the footer, with names and addresses escaped."""
    links = {"Grafana": "https://grafana.example/d/edged-fleet?var-plant=north", "<b>": 'http://a/"onclick'}
    async with served(WebSettings(port=0, links=links)) as (_, session), session.get("/") as answer:
        text = await answer.text()
    footer = text[text.index("<footer>") :]
    assert f'<a href="{links["Grafana"]}" rel="noreferrer" translate="no">Grafana</a>' in footer
    assert ">&lt;b&gt;</a>" in footer
    assert '"onclick' not in footer


@pytest.mark.slow
async def test_the_password_opens_a_session_and_log_out_ends_it() -> None:
    """The cookie is HttpOnly and SameSite=Strict, and logging out ends the session."""
    async with served(WebSettings(port=0, password_hash=HASH)) as (_, session):
        own, form = own_origin(session), {"password": PASSWORD}
        async with session.post("/login", data={"password": "guess"}, headers=own) as answer:
            assert answer.url.path == "/login"
        async with session.post("/login", data=form, headers=own, allow_redirects=False) as answer:
            cookie = answer.headers["Set-Cookie"]
            assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
        async with session.get("/status.json") as answer:
            assert (answer.status, (await answer.json())["protected"]) == (200, True)
        await (await session.post("/logout", headers=own)).read()
        async with session.get("/status.json") as answer:
            assert answer.status == 401


@pytest.mark.slow
async def test_guessing_is_slowed_down() -> None:
    """After five wrong passwords even the right one must wait, but not from other addresses."""
    now_s = [0.0]
    access = Access(HASH, lambda: now_s[0])
    for _ in range(5):
        assert await access.log_in("10.0.0.9", "guess") is None
    with pytest.raises(TooManyAttempts):
        await access.log_in("10.0.0.9", PASSWORD)
    assert await access.log_in("10.0.0.7", PASSWORD)
    now_s[0] = 31.0
    assert await access.log_in("10.0.0.9", PASSWORD)


async def test_log_ins_at_once_cost_one_hash_after_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only one password is checked at a time; a few others wait, and the rest is told when to retry."""
    hashed, at_once, most = list[str](), [0], [0]
    started, may_end = threading.Event(), threading.Event()

    def slow(_: str, password: str) -> bool:
        hashed.append(password)
        at_once[0] += 1
        most[0] = max(at_once[0], most[0])
        started.set()
        assert may_end.wait(LIMIT_S)
        at_once[0] -= 1
        return password == PASSWORD

    monkeypatch.setattr("edged.identity.access.is_password", slow)
    access = Access(HASH)
    first = asyncio.create_task(access.log_in("10.0.0.9", "guess"))
    try:
        await asyncio.to_thread(started.wait, 20)
        others = [
            asyncio.create_task(access.log_in(f"10.0.{n // 200}.{n % 200}", "guess")) for n in range(1500)
        ]
        refused = 1500 - MAX_WAITING
        await until(lambda: sum(task.done() for task in others) == refused)
        # disconnecting does not free its place: the thread continues
        first.cancel()
        await asyncio.wait({first})
        assert ["guess"] == hashed
    finally:
        may_end.set()
    found = await asyncio.gather(*others, return_exceptions=True)
    assert [1.0] * refused == [error.wait_s for error in found if isinstance(error, TooManyAttempts)]
    assert (1 + MAX_WAITING, 1) == (len(hashed), most[0])


async def test_an_attempt_counts_before_it_is_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Guesses that are broken off count, too: after five the next is refused unchecked."""
    hashed = list[str]()
    monkeypatch.setattr("edged.identity.access.is_password", lambda _, password: hashed.append(password))
    access = Access(HASH, lambda: 0.0)
    for _ in range(1000):
        guess = asyncio.create_task(access.log_in("10.0.0.9", "guess"))
        await asyncio.sleep(0)
        guess.cancel()
        await asyncio.wait({guess})
        refused = None if guess.cancelled() else guess.exception()
        if isinstance(refused, TooManyAttempts) and refused.wait_s == 30.0:
            break
    else:
        pytest.fail("no guess was refused for a while")
    # those broken off before a thread was free were not checked either
    assert len(hashed) <= 5


async def test_who_hangs_up_as_it_is_their_turn_takes_nobody_elses(monkeypatch: pytest.MonkeyPatch) -> None:
    """If a waiting log-in is cancelled just as its turn comes, the next one is still checked."""
    may_end, ended = threading.Event(), threading.Event()

    def check(_: str, password: str) -> bool:
        may_end.wait(LIMIT_S)
        ended.set()
        return password == "right"

    monkeypatch.setattr("edged.identity.access.is_password", check)
    access = Access(HASH, lambda: 0.0)
    asked = [("10.0.0.1", "wrong"), ("10.0.0.2", "right"), ("10.0.0.3", "right")]
    first, second, third = (asyncio.create_task(access.log_in(*one)) for one in asked)
    await asyncio.sleep(0.1)  # the others wait
    may_end.set()
    ended.wait(LIMIT_S)
    time.sleep(0.2)  # noqa: ASYNC251  (the loop is blocked: the thread's result is in its queue)
    await asyncio.sleep(0)  # its end is known, but its turn not passed on yet
    second.cancel()
    await asyncio.wait({first, second, third}, timeout=LIMIT_S)
    assert third.done()
    assert third.exception() is None


async def test_who_has_to_wait_is_told_how_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """The answer is 429 with Retry-After in whole seconds, never 0, for the form and HTTP Basic."""
    monkeypatch.setattr("edged.identity.access.is_password", lambda *_: False)
    async with served(WebSettings(port=0, password_hash=HASH)) as (_, session):
        basic = {"Authorization": "Basic " + b64encode(b"x:guess").decode()}
        for _ in range(5):
            async with session.get("/metrics", headers=basic) as answer:
                assert answer.status == 401
        for answer in (
            await session.get("/metrics", headers=basic),
            await session.post("/login", data={"password": PASSWORD}, headers=own_origin(session)),
        ):
            async with answer:
                assert answer.status == 429
                assert 1 <= int(answer.headers["Retry-After"]) <= 30


@pytest.mark.parametrize(
    "header",
    [
        b"Cookie: " + COOKIE + b"=\xff",
        b"Cookie: \xff\xfe=\xff; " + COOKIE + b"=\xed\xa0\x80",
        b"Authorization: Basic \xff\xfe",
        b"Authorization: Basic " + b64encode(b"x:\xff"),
        b"Authorization: Basic =",
        b"Authorization: \xff",
    ],
)
async def test_bytes_that_are_no_text_are_not_logged_in(
    header: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    """Cookies or passwords with invalid bytes give 401 or 400, and no traceback in the log."""
    async with served(WebSettings(port=0, password_hash=HASH)) as (web, _):
        for path in (b"GET /status.json", b"POST /logout"):
            head, _ = await answered(web.port, path, header)
            assert head in (b"HTTP/1.1 401", b"HTTP/1.1 400"), head
    assert [] == [record.getMessage() for record in caplog.records if record.exc_info]


@pytest.mark.parametrize(
    ("content_type", "body"),
    [
        (b"application/x-www-form-urlencoded", b"password=%ff"),
        (b"application/x-www-form-urlencoded", b"password=\xff"),
        (b"application/x-www-form-urlencoded; charset=utf-7", b"password=+2AA-"),
        (b"application/x-www-form-urlencoded; charset=no-such", b"password=x"),
        (b"application/x-www-form-urlencoded", b"&" * 4000),
        (b"multipart/form-data", b"--"),
        (b"multipart/form-data; boundary=x", b"--x\r\n\r\n"),
        (b"text/plain", b"password=x"),
    ],
)
async def test_a_form_of_other_bytes_is_a_wrong_password(
    content_type: bytes, body: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    """Any invalid form leads back to the form, without a traceback in the log."""
    async with served(WebSettings(port=0, password_hash=HASH)) as (web, _):
        fields = b"Content-Type: " + content_type + b"\r\nContent-Length: %d" % len(body)
        head, rest = await answered(web.port, b"POST /login", fields, body)
        assert (b"HTTP/1.1 303", True) == (head, b"/login?wrong" in rest)
    assert [] == [record.getMessage() for record in caplog.records if record.exc_info]


async def answered(port: int, request: bytes, header: bytes, body: bytes = b"") -> tuple[bytes, bytes]:
    """Status line and rest of the answer to a raw request."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        head = (
            request
            + b" HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://127.0.0.1\r\nConnection: close\r\n"
            + header
        )
        writer.write(head + b"\r\n\r\n" + body)
        answer = await reader.read()
    finally:
        writer.close()
        await writer.wait_closed()
    return answer[:12], answer[12:]


async def test_a_session_ends_by_itself() -> None:
    """A session ends twelve hours after the log-in."""
    now_s = [0.0]
    access = Access(HASH, lambda: now_s[0])
    cookie = await access.log_in("10.0.0.9", PASSWORD)
    assert cookie is not None
    assert access.visitor(cookie, "10.0.0.9")
    now_s[0] = 12 * 3600.0 + 1
    assert access.visitor(cookie, "10.0.0.9") is None


async def test_a_foreign_host_name_reaches_no_open_page() -> None:
    """A host name other than this machine's gets 421, which prevents DNS rebinding."""
    async with served() as (_, session):
        for host, expected in (
            ("evil.example", 421),
            ("localhost:1", 200),
            ("127.0.0.1", 200),
            ("[::1]:8080", 200),
        ):
            async with session.get("/status.json", headers={"Host": host}) as answer:
                assert answer.status == expected, host


async def test_nothing_can_be_changed_and_large_bodies_are_refused() -> None:
    """Other methods on the read-only page are 405, and a body that is too large is 413."""
    async with served() as (_, session):
        for path in ("/", "/status.json", "/registers.json", "/metrics"):
            async with session.post(path, data=b"x") as answer:
                assert answer.status == 405
        form, own = {"password": "x" * 100_000}, own_origin(session)
        async with session.post("/login", data=form, headers=own) as answer:
            assert answer.status == 413


async def test_a_port_in_use_is_named() -> None:
    """The error names the address, and nothing is started."""
    async with served() as (web, _):
        other = WebPublisher("cell", WebSettings(port=web.port), sources())
        with pytest.raises(ListenError, match=f"127.0.0.1:{web.port}"):
            await other.start()
        await other.close()


def test_a_snapshot_without_its_exposure_has_no_picture() -> None:
    """A result without its exposure has no picture, rather than an older one."""
    page = StatusPage("cell", sources())
    measure(page, 1)
    page.take(make_snapshot(2))

    assert page.status()["picture"] is None
    assert page.pair(2) is None
    assert isinstance(make_snapshot(2), Snapshot)


# --- strangers ---------------------------------------------------------------------------------


async def connect(web: WebPublisher, host: str = "127.0.0.1") -> tuple[StreamReader, StreamWriter]:
    """A plain connection from an address of this machine."""
    return await asyncio.open_connection("127.0.0.1", web.port, local_addr=(host, 0))


async def ended(reader: StreamReader) -> bool:
    """Wait until the server closes the connection."""
    with contextlib.suppress(ConnectionError):
        while await reader.read(65536):
            pass
    return True


@pytest.mark.parametrize(
    "sent",
    [b"", b"GET / HTTP/1.1\r\nHost: x\r\nX: ", SLOW_FORM],
)
async def test_a_request_that_does_not_come_is_not_waited_for(
    sent: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Silent, half a header or half a form: the connection is closed, even if more bytes dribble in."""
    monkeypatch.setattr(server, "IDLE_S", 0.4)
    monkeypatch.setattr(login, "FORM_S", 0.2)
    async with served() as (web, _):
        reader, writer = await connect(web)
        writer.write(sent)
        closed = asyncio.create_task(ended(reader))
        while not closed.done():
            writer.write(b"x" if sent else b"")
            await asyncio.wait({closed}, timeout=0.1)
        assert closed.result()
        writer.close()


async def test_an_answer_that_nobody_fetches_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """A client that sends requests without reading the answers is disconnected."""
    monkeypatch.setattr(server, "IDLE_S", 0.4)
    async with served() as (web, _):
        _, writer = await connect(web)
        with pytest.raises(ConnectionError):
            while True:
                writer.write(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 100)
                await writer.drain()
        writer.close()


async def test_many_connections_take_no_place_from_others() -> None:
    """With three times the limit from one address, its own oldest are closed, and others are served."""
    async with served() as (web, session):
        other_reader, other = await connect(web, "127.0.0.2")
        many = [await connect(web) for _ in range(3 * places.MAX_CONNECTIONS)]
        async with session.get("/health") as answer:
            assert answer.status == 200
        for reader, _ in many[: 2 * places.MAX_CONNECTIONS]:
            assert await ended(reader)
        other.write(b"GET /health HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        assert (await other_reader.readline()).startswith(b"HTTP/1.1 200")
        for _, writer in (*many, (None, other)):
            writer.close()


async def test_viewers_that_do_not_read_are_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """A viewer that does not read its events is disconnected."""
    monkeypatch.setattr(viewers, "WRITE_S", 0.2)
    monkeypatch.setattr(viewers, "PERIOD_S", 0.0)
    async with served(asked=sources({"Modbus": {"text": "x" * 1_000_000}})) as (web, _):
        _, writer = await connect(web)
        writer.transport.pause_reading()
        writer.write(b"GET /events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        with pytest.raises(ConnectionError):
            for cycle in itertools.count(1):
                measure(web, cycle, error="camera left: gone")
                writer.write(b"\r\n")
                await writer.drain()
                await asyncio.sleep(0.01)
        writer.close()


async def test_viewers_of_one_address_do_not_keep_others_out() -> None:
    """If one address holds all event streams, its first one is closed for another address."""
    asked = b"GET /events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    async with served() as (web, _):
        many = []
        for _ in range(viewers.MAX_VIEWERS):
            many.append(await connect(web))
            many[-1][1].write(asked)
            assert (await many[-1][0].readline()).startswith(b"HTTP/1.1 200")
        reader, writer = await connect(web, "127.0.0.2")
        writer.write(asked)
        assert (await reader.readline()).startswith(b"HTTP/1.1 200")
        assert await ended(many[0][0])
        for _, one in (*many, (reader, writer)):
            one.close()


async def test_what_is_no_http_is_one_line_of_the_log(caplog: pytest.LogCaptureFixture) -> None:
    """Invalid HTTP gives one log line, not one per request, without parser details."""
    async with served() as (web, _):
        for sent in (
            b"\x16\x03\x01",
            b"GET / HTTP/9.9",
            b"GET /\0 HTTP/1.1",
            b"GET / HTTP/1.1\r\na b: c",
        ) * 5:
            reader, writer = await connect(web)
            writer.write(sent + b"\r\n\r\n")
            assert await ended(reader)
            writer.close()
    (record,) = caplog.records
    assert "127.0.0.1 sent what is no HTTP" in record.getMessage()
    assert record.exc_info is None


async def test_a_bug_that_strangers_find_is_one_trace(caplog: pytest.LogCaptureFixture) -> None:
    """Repeated internal errors give one traceback."""
    async with served(metrics=lambda: 1 / 0) as (_, session):
        for _ in range(5):
            async with session.get("/metrics") as answer:
                assert answer.status == 500
    (record,) = caplog.records
    assert isinstance(record.exc_info[1], ZeroDivisionError)


async def test_who_leaves_in_the_middle_of_a_form_leaves_no_trace(caplog: pytest.LogCaptureFixture) -> None:
    """Disconnecting in the middle of a form logs nothing."""
    async with served() as (web, session):
        _, writer = await connect(web)
        writer.write(SLOW_FORM)
        await writer.drain()
        async with session.get("/health") as answer:  # by then the form is being read
            assert answer.status == 200
        writer.transport.abort()
        async with session.get("/health") as answer:
            assert answer.status == 200
    assert [] == caplog.messages


@pytest.mark.parametrize(
    ("header", "body"),
    [
        ("Content-Type: multipart/form-data", b"x"),
        ("Content-Type: text/plain; charset=nothing", b"password=x"),
        ("Content-Type: application/x-www-form-urlencoded", b"\xff\xfe&&&=;%zz"),
        ("Content-Type: application/x-www-form-urlencoded", b"&".join([b"a=b"] * 99)),
        ("Content-Encoding: gzip", b"no gzip"),
        ("Content-Encoding: deflate", b"\0\1"),
        ("Authorization: Basic \xff\xfe", b""),
        (f"Cookie: {COOKIE.decode()}=\xff; =; ,", b""),
        ("Expect: nothing", b""),
    ],
)
async def test_no_form_makes_an_internal_error(
    header: str, body: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    """Any body or header posted to the log-in gets a redirect or a client error, and logs no traceback."""
    async with served(WebSettings(port=0, password_hash=HASH)) as (web, _):
        reader, writer = await connect(web)
        head = (
            "POST /login HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://127.0.0.1\r\n"
            f"{header}\r\nContent-Length: {len(body)}\r\n\r\n"
        )
        writer.write(head.encode("latin-1") + body)
        status = int((await reader.readline()).split()[1])
        assert 300 <= status < 500
        writer.close()
    assert not [record for record in caplog.records if record.exc_info]
