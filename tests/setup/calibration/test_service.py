"""From boards before two cameras to a rig, over HTTP and a running daemon."""

from __future__ import annotations

import asyncio
import io
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import pytest
from helpers.boardcell import BoardCell, with_views
from helpers.boardpairs import RIG, SPEC, pairs
from helpers.samepage import worker_of
from rich.console import Console

from edged.commands.calibrate import calibrate
from edged.domain.arrays import Image
from edged.files.rig import load_rig, rig_of
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply
from edged.vision.geometry.triangulation import triangulate_raw
from edged.vision.geometry.uncertainty import calibration_covariance


@pytest.mark.long
async def test_views_become_a_rig_that_is_right(tmp_path: Path) -> None:
    """Over HTTP there are suggestions, a solution with its report and its activation, and measured points
    are true."""
    async with BoardCell(tmp_path).running(page_is_here=False) as cell:
        place, token = await with_views(cell, 6)
        draft = await cell.until(place, lambda draft: not draft["guiding"])
        assert draft["sigma_um"]["z"] > 0
        assert 3 == len(draft["suggestions"])
        assert 4 == len(draft["suggestion"]["left"]) == len(draft["suggestion"]["right"])
        assert draft["suggestion"]["sigma_um"]["x"] < draft["sigma_um"]["x"]
        assert [True] * 6 == [view["used"] for view in draft["views"]]
        status, begun = await cell.ask("POST", f"{place}/solve", {})
        assert 202 == status
        ended = await cell.done(begun["task"])
        assert ("done", None, "solve") == (ended["state"], ended["problem"], ended["what"])
        _, draft = await cell.ask("GET", place)
        solved = draft["solved"]
        assert solved["rms_px"] < 0.05
        assert None is solved["moved_um"]
        assert all(view["heldout_px"] < 0.1 for view in draft["views"])
        async with cell.session.get(f"/api/v1{place}/report") as answer:
            assert "sandbox" in answer.headers["Content-Security-Policy"]
            assert solved["calibration_id"] in await answer.text()
        async with cell.session.get(draft["views"][0]["thumbnails"]["left"]) as answer:
            assert (200, b"\xff\xd8") == (answer.status, (await answer.read())[:2])
        note = {"note": "first board"}
        assert (409, "setup_refused") == await refused(cell, "POST", f"{place}/activate", note)
        status, release = await cell.ask("POST", f"{place}/activate", {**note, "token": token})
        assert (200, 1, True) == (status, release["number"], release["active"])
        assert solved["calibration_id"] == release["rig"]
        _, now = await cell.ask("GET", "/cell")
        assert (["jobs"], release["rig"]) == (now["missing"], load_rig(cell.rig).calibration_id)
        _, draft = await cell.ask("GET", place)
        assert draft["active"]
        _, listed = await cell.ask("GET", "/releases")
        assert [release] == listed["releases"]
        again = {"reason": "once more", "token": token}
        assert (422, "input") == await refused(cell, "POST", "/releases/1/activate", again)
        assert (404, "unknown") == await refused(cell, "POST", "/releases/2/activate", again)
    assert cell.rig.read_bytes() == next((cell.state / "drafts").glob("*/rig-*.json")).read_bytes()

    pictures = next((cell.state / "drafts").glob("*/pictures"))
    calibrate(pictures, SPEC, tmp_path / "by_command.json", "division", None, Console(file=io.StringIO()))
    written = next((cell.state / "drafts").glob("*/rig-*.json")).read_bytes()
    assert (tmp_path / "by_command.json").read_bytes() == written, "the page and the command disagree"
    assert 0.1 < error_in_sigmas(rig_of(written, tmp_path)) < 2.5


def error_in_sigmas(rig: StereoRig) -> float:
    """Largest error of points in the working volume, measured with pictures of the true rig, over the
    stated sigma."""
    depth_mm = RIG.baseline_mm / (2 * np.tan(np.radians(12)))
    x, y, z = np.meshgrid([-20.0, 0.0, 20.0], [-15.0, 0.0, 15.0], [0.95 * depth_mm, 1.05 * depth_mm])
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    pixels = RIG.left.project(points), RIG.right.project(apply(RIG.right_from_left, points))
    errors_mm = triangulate_raw(rig, *pixels) - points
    variances = np.einsum("nii->n", calibration_covariance(rig, points))
    print(f"error {1e3 * np.sqrt(np.mean(errors_mm**2)):.1f} µm a coordinate")
    return float(np.sqrt(np.sum(errors_mm**2) / np.sum(variances)))


@pytest.mark.long
async def test_pictures_take_themselves_when_the_board_is_still(tmp_path: Path) -> None:
    """The board is recognised in live pairs, and a view is taken of each place where it rests."""
    async with BoardCell(tmp_path).running() as cell:
        _, entered = await cell.ask("POST", "/setup", {"name": "Anna"})
        token = entered["token"]
        _, draft = await cell.ask("POST", "/calibrations", {"recognise": True, "mm": 6.0})
        place = f"/calibrations/{draft['id']}"
        headers = {"Origin": f"http://127.0.0.1:{cell.port}"}
        async with cell.session.ws_connect("/api/v1/ws", headers=headers) as socket:
            await socket.send_json({"live": True, "token": token})
            looking = asyncio.create_task(look(socket))
            draft = await cell.until(place, lambda draft: draft["boards"])
            assert [SPEC] == draft["boards"]
            draft = await cell.until(place, lambda draft: draft["still"] and draft["suggestion"])
            assert 4 == len(draft["shown"]["left"]["polygon"])
            assert (None, False, []) == (draft["shown"]["left"]["missing"], draft["auto"], draft["views"])
            status, draft = await cell.ask("PUT", f"{place}/auto", {"token": token, "on": True})
            assert (200, True) == (status, draft["auto"])
            await cell.until(place, lambda draft: len(draft["views"]) == 1)
            await cell.until(place, lambda draft: draft["waits"] == "same")
            cell.world.shown = tuple(np.full_like(image, 90) for image in pairs(6)[0])
            draft = await cell.until(place, lambda draft: draft["waits"] == "no_board")
            assert "not_found" == draft["shown"]["left"]["missing"]
            _, other = await cell.ask("POST", "/setup", {"name": "Ben", "take_over": True})
            await socket.send_json({"live": True, "token": other["token"]})
            cell.world.shown = pairs(6)[1]
            await cell.until(place, lambda draft: not draft["auto"])
            _, draft = await cell.ask("GET", place)
            assert 1 == len(draft["views"]), "nobody who has the cell has asked for it"
            looking.cancel()


async def look(socket: aiohttp.ClientWebSocketResponse) -> None:
    """A tab that acknowledges each pair at once."""
    async for message in socket:
        if message.type is aiohttp.WSMsgType.TEXT and "number" in (told := message.json()):
            await socket.send_json({"seen": told["number"]})


@pytest.mark.long
async def test_a_draft_survives_the_daemon(tmp_path: Path) -> None:
    """Another daemon continues with the same views, undo history and suggestion."""
    cell = BoardCell(tmp_path)

    async with cell.running():
        place, _ = await with_views(cell, 3)
        await cell.ask("DELETE", f"{place}/views/view_002", {})
        _, draft = await cell.ask("POST", f"{place}/undo", {})
        assert (True, True) == (draft["can_undo"], draft["can_redo"])
        before = await cell.until(place, lambda draft: not draft["guiding"])
    async with cell.running():
        after = await cell.until(place, lambda draft: not draft["guiding"])
        for key in ("revision", "boards", "views", "sigma_um", "suggestion", "can_redo"):
            assert before[key] == after[key], key
        _, listed = await cell.ask("GET", "/calibrations")
        assert [(before["id"], 3)] == [(one["id"], one["views"]) for one in listed["calibrations"]]


@pytest.mark.long
async def test_a_worker_that_is_killed_costs_one_task(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the worker is killed while solving, keeping a pair or suggesting, that task fails and the draft
    is kept."""
    async with BoardCell(tmp_path).running() as cell:
        place, token = await with_views(cell, 3)
        await cell.until(place, lambda draft: not draft["guiding"])
        # no other reference knows its process
        worker = worker_of(cell.pages)
        functions = worker._functions  # noqa: SLF001  (as above)
        with monkeypatch.context() as patch:
            patch.setitem(functions, "keep_pair", "helpers.workertasks:vanish")
            assert (503, "task_failed") == await refused(cell, "POST", f"{place}/views", {"token": token})
            patch.setitem(functions, "guide", "helpers.workertasks:vanish")
            await cell.ask("DELETE", f"{place}/views/view_003", {})
            draft = await cell.until(place, lambda draft: not draft["guiding"])
            assert "task_failed" == draft["trouble"]["code"]
        await cell.ask("POST", f"{place}/undo", {})
        draft = await cell.until(place, lambda draft: not draft["guiding"])
        assert None is draft["trouble"]
        _, begun = await cell.ask("POST", f"{place}/solve", {})
        await cell.until(f"/tasks/{begun['task']}", lambda task: task["text"] != "waits for its turn")
        assert (422, "calibration") == (await refused(cell, "POST", f"{place}/solve"))
        os.kill(worker.pid, signal.SIGKILL)
        ended = await cell.done(begun["task"])
        assert ("failed", "task_failed") == (ended["state"], ended["problem"]["code"])
        assert "SIGKILL" in ended["problem"]["detail"]
        _, again = await cell.ask("POST", f"{place}/solve", {})
        _, cancelled = await cell.ask("DELETE", f"/tasks/{again['task']}", {})
        assert "cancelled" == cancelled["state"]
        _, draft = await cell.ask("GET", place)
        assert (None, None, 3) == (draft["solved"], draft["task"], len(draft["views"]))


@pytest.mark.long
async def test_a_discarded_draft_is_gone_with_what_was_under_way_for_it(tmp_path: Path) -> None:
    """Discarding cancels suggestions, solving and automatic views, and the next draft is independent."""
    async with BoardCell(tmp_path).running() as cell:
        place, token = await with_views(cell, 3)
        _, begun = await cell.ask("POST", f"{place}/solve", {})
        await cell.ask("PUT", f"{place}/auto", {"token": token, "on": True})
        assert (204, None) == await cell.ask("DELETE", place, {})
        assert "cancelled" == (await cell.done(begun["task"]))["state"]
        for method, path in (("GET", ""), ("DELETE", ""), ("POST", "/solve"), ("POST", "/go-on")):
            assert (404, "unknown") == await refused(cell, method, place + path)
        assert (404, "unknown") == await refused(cell, "POST", f"{place}/views", {"token": token})
        assert {"calibrations": []} == (await cell.ask("GET", "/calibrations"))[1]

        status, draft = await cell.ask("POST", "/calibrations", {"boards": [SPEC]})
        assert (201, True, False, []) == (status, draft["current"], draft["auto"], draft["views"])
        place = f"/calibrations/{draft['id']}"
        for number in range(3):
            cell.world.shown = pairs(6)[number]
            assert 201 == (await cell.ask("POST", f"{place}/views", {"token": token}))[0]
        draft = await cell.until(place, lambda draft: not draft["guiding"])
        assert draft["sigma_um"]["z"] > 0


@pytest.mark.long
async def test_live_pairs_are_looked_at_for_the_draft_that_somebody_goes_on_with(tmp_path: Path) -> None:
    """Live pairs are for the draft begun or continued last; others take no view automatically."""
    async with BoardCell(tmp_path).running() as cell:
        _, entered = await cell.ask("POST", "/setup", {"name": "Anna"})
        token = entered["token"]
        places = []
        for board in ("chessboard:9x6:6", SPEC):
            _, draft = await cell.ask("POST", "/calibrations", {"boards": [board]})
            places.append(f"/calibrations/{draft['id']}")
            await cell.ask("PUT", f"{places[-1]}/auto", {"token": token, "on": True})
        headers = {"Origin": f"http://127.0.0.1:{cell.port}"}
        async with cell.session.ws_connect("/api/v1/ws", headers=headers) as socket:
            await socket.send_json({"live": True, "token": token})
            looking = asyncio.create_task(look(socket))
            for place, other in (places[::-1], places):
                status, draft = await cell.ask("POST", f"{place}/go-on", {})
                assert (200, True) == (status, draft["current"])
                draft = await cell.until(place, lambda draft: draft["shown"])
                _, before = await cell.ask("GET", other)
                assert (False, False) == (before["current"], before["auto"])
            _, listed = await cell.ask("GET", "/calibrations")
            current = {one["id"]: one["current"] for one in listed["calibrations"]}
            assert {places[0][14:]: True, places[1][14:]: False} == current
            looking.cancel()


WRONG: dict[str, tuple[str, Callable[[int], tuple[Image, Image]]]] = {
    "calibration_other_board": ("chessboard:9x6:6", lambda view: pairs(6)[view]),
    "calibration_swapped": (SPEC, lambda view: pairs(6)[view][::-1]),
    "calibration_moving": (SPEC, lambda view: (pairs(6)[view][0], pairs(6)[view - 1][1])),
    "calibration_few_views": (SPEC, lambda view: tuple(np.full_like(one, 90) for one in pairs(6)[view])),
}
"""Mistakes visible in pictures: the stated board, and what a view shows."""


@pytest.mark.long
async def test_a_mistake_at_the_board_has_a_name(tmp_path: Path) -> None:
    """Each mistake has a code of its own, and nothing is solved."""
    async with BoardCell(tmp_path).running() as cell:
        _, entered = await cell.ask("POST", "/setup", {"name": "Anna"})
        for code, (stated, view) in WRONG.items():
            _, draft = await cell.ask("POST", "/calibrations", {"boards": [stated]})
            place = f"/calibrations/{draft['id']}"
            for number in range(4):
                cell.world.shown = view(number)
                assert 201 == (await cell.ask("POST", f"{place}/views", {"token": entered["token"]}))[0]
            _, begun = await cell.ask("POST", f"{place}/solve", {})
            ended = await cell.done(begun["task"])
            assert ("failed", code) == (ended["state"], ended["problem"]["code"])
            draft = await cell.until(place, lambda draft: not draft["guiding"])
            assert None is draft["solved"]
            if code != "calibration_other_board":
                assert code == draft["trouble"]["code"]
            else:
                assert {"stated": stated, "seen": SPEC} == ended["problem"]["params"]


@pytest.mark.slow
async def test_another_board_than_the_stated_one_is_told_at_once(tmp_path: Path) -> None:
    """Another board is reported before any view is taken."""
    async with BoardCell(tmp_path).running() as cell:
        _, entered = await cell.ask("POST", "/setup", {"name": "Anna"})
        _, draft = await cell.ask("POST", "/calibrations", {"boards": ["chessboard:9x6:6"]})
        place = f"/calibrations/{draft['id']}"
        headers = {"Origin": f"http://127.0.0.1:{cell.port}"}
        async with cell.session.ws_connect("/api/v1/ws", headers=headers) as socket:
            await socket.send_json({"live": True, "token": entered["token"]})
            looking = asyncio.create_task(look(socket))
            draft = await cell.until(
                place, lambda draft: draft["shown"] and draft["shown"]["left"]["other_board"]
            )
            for side in ("left", "right"):
                shown = draft["shown"][side]
                assert ("other_board", "chessboard:8x6") == (shown["missing"], shown["other_board"])
            looking.cancel()


async def refused(cell: BoardCell, method: str, path: str, document: Any = None) -> tuple[int, str]:
    """Status and error code."""
    status, problem = await cell.ask(method, path, {} if document is None else document)
    return status, problem["code"]


@pytest.mark.slow
async def test_what_cannot_be_is_refused_with_a_code(tmp_path: Path) -> None:
    """Requests without board, lease, known id, or anything to undo or solve are refused with a code."""
    async with BoardCell(tmp_path).running() as cell:
        assert (422, "calibration") == await refused(
            cell, "POST", "/calibrations", {"boards": ["carpet:1x1:1"]}
        )
        assert (400, "invalid") == await refused(cell, "POST", "/calibrations", {})
        assert (400, "invalid") == await refused(cell, "POST", "/calibrations", {"recognise": True})
        place, _ = await with_views(cell, 0)
        assert (409, "setup_refused") == await refused(cell, "POST", f"{place}/views", {"token": "x"})
        assert (422, "calibration") == await refused(cell, "POST", f"{place}/undo")
        assert (422, "calibration") == await refused(cell, "POST", f"{place}/solve")
        assert (404, "unknown") == await refused(cell, "DELETE", f"{place}/views/view_001")
        assert (404, "unknown") == await refused(cell, "POST", "/calibrations/20260101-000000-ffff/undo")
        assert (404, "unknown") == await refused(cell, "DELETE", "/tasks/0123456789ab")
        status, problem = await cell.ask("GET", f"{place}/report")
        assert (422, "calibration") == (status, problem["code"])
        _, draft = await cell.ask("GET", place)
        assert (0, []) == (draft["revision"], draft["views"])
        state = next((cell.state / "drafts").glob("*/state.json"))
        state.write_text("{")
        _, listed = await cell.ask("GET", "/calibrations")
        assert "state.json" in listed["calibrations"][0]["trouble"]
