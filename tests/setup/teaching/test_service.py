"""From a part before two cameras to a draft of its job, over HTTP and a running daemon."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import signal
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.browsersession import BrowserSession
from helpers.cells import flange, frame_pair
from helpers.partcell import PartCell, turned
from helpers.samepage import worker_of
from rich.console import Console

from edged.commands.check import check
from edged.commands.teach import PairSource, teach
from edged.domain.events import Snapshot
from edged.domain.measurement import Status
from edged.errors import TeachError
from edged.files import recording
from edged.files.jobs import load_job
from edged.setup.teaching.sources import recorded_pair
from edged.vision.teaching.region import PolygonRegion

RADII_MM = {14.0: 1, 4.0: 1, 1.6: 4, 0.9: 1}
"""Circles of the flange by radius."""


async def refused(cell: PartCell, method: str, path: str, document: Any) -> tuple[int, str]:
    """Status and error code."""
    status, problem = await cell.ask(method, path, document)
    return status, problem["code"]


def left_of(draft: dict[str, Any], key: str) -> np.ndarray[Any, Any]:
    """Outline of a feature in the left picture."""
    return np.array(next(one for one in draft["features"] if one["key"] == key)["outline"]["left"])


@pytest.mark.slow
async def test_the_part_is_proposed_without_a_tap(tmp_path: Path) -> None:
    """The proposed region is the flange alone, with true sizes and a sigma that fits their errors."""
    async with PartCell(tmp_path).running() as cell:
        token = await cell.take()
        draft = await cell.begun(**token)
        assert None is draft["trouble"], draft["trouble"]
        assert ("part1", 1, 640, 480) == (draft["name"], draft["number"], draft["width"], draft["height"])
        corners = np.array(draft["region"][0]["points"])
        mask = PolygonRegion(corners).painted(640, 480)
        truth = flange()
        x, y = truth.rig.left.project(truth.rig_from_part[None, :3, 3])[0]
        radius_px = 14.0 * truth.rig.left.fx / truth.rig_from_part[2, 3]
        assert 1.0 < np.count_nonzero(mask) / (np.pi * radius_px**2) < 1.2
        circles = [one for one in draft["features"] if one["kind"] == "circle"]
        assert sum(RADII_MM.values()) == len(circles)
        for one in circles:
            radius_mm = min(RADII_MM, key=lambda r: abs(r - one["size"]["diameter_mm"] / 2))
            error_um = 1e3 * abs(one["size"]["diameter_mm"] - 2 * radius_mm)
            assert error_um < 5 * one["sigma_um"] + 2, one["key"]
        outline = left_of(draft, "c0")
        assert np.abs(np.hypot(*(outline - (x, y)).T) - radius_px).max() < 0.02 * radius_px
        assert max(draft["predicted"]["sigma_um"].values()) < 20
        assert ("c0", ["radius_c0"]) == (draft["reference"]["key"], [one["key"] for one in draft["sizes"]])
        assert all(len(draft["outlines"][side]) > 3 for side in ("left", "right"))
        async with cell.session.get(draft["pictures"]["right"]) as answer:
            shown = cv2.imdecode(np.frombuffer(await answer.read(), np.uint8), cv2.IMREAD_GRAYSCALE)
        assert np.abs(shown.astype(float) - flange().right).mean() < 3


@pytest.mark.long
async def test_what_people_say_is_what_is_learnt(tmp_path: Path) -> None:
    """Region, left-out features, reference, grip and sizes of a draft can be set, undone and done again."""
    async with PartCell(tmp_path).running() as cell:
        token = await cell.take()
        first = await cell.begun(**token, name="flange")
        x, y, width, height = dataclasses.astuple(flange().region)
        box = {"kind": "rectangle", "x": x, "y": y, "width": width, "height": height}
        draft = await cell.change("PUT", first, "/region", {"revision": first["revision"], "shapes": [box]})
        assert [{**box, "add": True}] == draft["region"]
        sigma = draft["predicted"]["sigma_um"]
        draft = await cell.change("PUT", draft, "/features", {"features": {"c0": False, "c3": False}})
        taken = {one["key"]: one["taken"] for one in draft["features"]}
        assert (False, False, True) == (taken["c0"], taken["c3"], taken["c1"])
        assert ("c1", "radius_c1") == (draft["reference"]["key"], draft["sizes"][0]["key"])
        assert draft["predicted"]["sigma_um"]["z"] > sigma["z"], "fewer features, and as sure"
        x, y = left_of(draft, "c2").mean(axis=0)
        wish = {"reference": {"x": x, "y": y}, "number": 7, "tilt_deg": 10.0}
        draft = await cell.change("PUT", draft, "", wish)
        assert ("c2", 7, 10.0) == (draft["reference"]["key"], draft["number"], draft["tilt_deg"])
        assert np.abs(np.array(draft["reference"]["left"]) - (x, y)).max() < 0.5
        assert 3.2 == pytest.approx(2 * draft["sizes"][0]["measured"], abs=0.01)
        grip = {"at": [x + 10, y], "approach_mm": 30.0}
        sizes = [{"kind": "distance", "of": ["c1", "c2"], "tolerance": 0.05}]
        draft = await cell.change("PUT", draft, "", {"gripping": grip, "sizes": sizes})
        assert np.abs(np.array(draft["gripping"]["left"]) - (x + 10, y)).max() < 0.2
        assert abs(draft["gripping"]["z_mm"]) < 0.01
        distance = draft["sizes"][1]
        assert ("distance_c1_c2", True, False) == (distance["key"], distance["ok"], distance["witness"])
        assert 10.2 == pytest.approx(distance["measured"], abs=0.02)
        for _ in range(4):
            draft = await cell.change("POST", draft, "/undo", {})
        assert (first["region"], False) == (draft["region"], draft["can_undo"])
        assert all(one["taken"] for one in draft["features"])
        for _ in range(4):
            draft = await cell.change("POST", draft, "/redo", {})
        assert ("c2", 7, False) == (draft["reference"]["key"], draft["number"], draft["can_redo"])
        tray = {"first_mm": [400.0, 0.0, 5.0], "columns": 4, "row_end_mm": [460.0, 0.0, 5.0], "rows": 3}
        tray |= {"column_end_mm": [400.0, 50.0, 5.0], "tolerance_mm": 8.0}
        draft = await cell.change("PUT", draft, "", {"tray": tray})
        assert {**tray, "layers": 1, "layer_end_mm": None} == draft["tray"]
        assert None is (await cell.change("PUT", draft, "", {"tray": "none"}))["tray"]
        draft = await cell.change("POST", draft, "/undo", {})
        assert 8.0 == draft["tray"]["tolerance_mm"]
        _, listed = await cell.ask("GET", "/teachings")
        assert [(draft["id"], "flange", 7)] == [
            (one["id"], one["name"], one["number"]) for one in listed["teachings"]
        ]


@pytest.mark.long
async def test_a_further_pair_says_what_the_breaks_are_and_one_without_the_part_is_named(
    tmp_path: Path,
) -> None:
    """A second pair gives the break of the flange's edges; a pair without the part is named by its number
    and can be removed, which undo takes back."""
    async with PartCell(tmp_path).running() as cell:
        token = await cell.take()
        first = await cell.begun(**token)
        assert ([], None, None) == (first["further"], first["break_mm"], first["break_end"])
        cell.world.shown = turned(70.0)
        draft = await cell.change("POST", first, "/further", token)
        (name,) = draft["further"]
        assert (None, 0.0) == (draft["trouble"], draft["break_mm"])
        async with cell.session.get(f"/api/v1/teachings/{draft['id']}/{name}-left.jpg") as answer:
            shown = cv2.imdecode(np.frombuffer(await answer.read(), np.uint8), cv2.IMREAD_GRAYSCALE)
        assert np.abs(shown.astype(float) - cell.world.shown[0]).mean() < 3
        cell.world.shown = (np.full_like(flange().left, 30),) * 2
        draft = await cell.change("POST", draft, "/further", token)
        assert ("teach_further_none", 3) == (draft["trouble"]["code"], draft["trouble"]["params"]["pair"])
        draft = await cell.change("PUT", draft, "/further", {"further": [name]})
        assert (None, 0.0) == (draft["trouble"], draft["break_mm"])
        draft = await cell.change("POST", draft, "/undo", {})
        assert 2 == len(draft["further"])
        draft = await cell.change("POST", draft, "/redo", {})
        assert [name] == draft["further"]
        gone = await refused(cell, "PUT", f"/teachings/{draft['id']}/further", {"further": ["0" * 12]})
        assert 404 == gone[0]
        assert 400 == (await refused(cell, "POST", f"/teachings/{draft['id']}/further", {}))[0]


@pytest.mark.long
async def test_two_people_and_a_kill(tmp_path: Path) -> None:
    """A late user is shown the newest draft, a tap finds the part and nothing on the table, and the draft
    survives a kill of the worker and a restart of the daemon."""
    kept: list[dict[str, Any]] = []
    async with PartCell(tmp_path).running() as cell:
        token = await cell.take()
        headers = {"Origin": f"http://127.0.0.1:{cell.port}"}
        async with cell.session.ws_connect("/api/v1/ws", headers=headers) as socket:
            draft = await cell.begun(**token)
            place = f"/teachings/{draft['id']}"
            async for message in socket:
                told = message.json()
                if told["type"] == "teaching" and told["features"]:
                    break
        assert {**draft, "type": "teaching"} == told
        stale = {"revision": draft["revision"], "name": "ring"}
        assert (200, "ring") == ((answer := await cell.ask("PUT", place, stale))[0], answer[1]["name"])
        status, problem = await cell.ask("PUT", place, stale)
        assert (412, "stale", "ring") == (status, problem["code"], problem["params"]["document"]["name"])
        assert (422, "teach_nothing_there") == await refused(cell, "POST", f"{place}/tap", {"x": 20, "y": 20})
        everything = {one["key"]: False for one in draft["features"]}
        nothing = {"features": everything}
        assert (422, "teach_nothing_left") == await refused(cell, "PUT", f"{place}/features", nothing)
        assert (404, "unknown") == await refused(
            cell, "PUT", f"{place}/features", {"features": {"c99": False}}
        )
        assert (400, "invalid") == await refused(cell, "PUT", place, {"name": "../etc"})
        assert (422, "teach_name_old") == await refused(cell, "PUT", place, {"name": "ring.old"})
        small = {"kind": "rectangle", "x": 1, "y": 1, "width": 4, "height": 4}
        wish = {"shapes": [small]}
        assert (422, "teach_small_region") == await refused(cell, "PUT", f"{place}/region", wish)
        table = {"kind": "rectangle", "x": 10, "y": 350, "width": 90, "height": 90}
        nothing = await cell.change("PUT", draft, "/region", {"shapes": [table]})
        assert nothing["trouble"]["code"] in {"teach_no_feature", "teach_one_sided", "teach_few_edges"}
        assert ([], None) == (nothing["features"], nothing["predicted"])
        back = await cell.change("POST", draft, "/undo", {})
        assert (None, draft["features"]) == (back["trouble"], back["features"])
        bore = np.array(draft["reference"]["left"])
        meant = await cell.change("POST", draft, "/tap", {"x": bore[0], "y": bore[1]})
        assert draft["features"] == meant["features"], "what was proposed is what was tapped"
        draft = await cell.change("POST", draft, "/undo", {})
        tapped = await cell.change("POST", draft, "/tap", {"x": bore[0], "y": bore[1]})
        again = await cell.change("POST", draft, "/tap", {"x": bore[0], "y": bore[1]})
        widths = [np.ptp(np.array(one["region"][0]["points"])[:, 0]) for one in (tapped, again)]
        assert widths[1] < 0.5 * widths[0]
        worker = worker_of(cell.pages)
        os.kill(worker.pid, signal.SIGKILL)
        draft = await cell.change("POST", draft, "/undo", {})
        assert tapped["region"] == draft["region"]
        assert (204, None) == await cell.ask("DELETE", f"/teachings/{(await cell.begun(**token))['id']}", {})
        kept.append(draft)
    state = next((cell.state / "teachings").iterdir()) / "state.json"
    assert kept[0]["revision"] == json.loads(state.read_text())["revision"]
    async with cell.running():
        assert kept[0] == await cell.learnt(kept[0]["id"])


@pytest.mark.long
async def test_a_draft_becomes_the_cells_job_and_the_way_back_is_open(tmp_path: Path) -> None:
    """The first job completes the cell and equals the command's byte by byte; edited from its kept pair it
    becomes the next release, and going back restores the fingerprint."""
    kept: dict[str, Any] = {}
    async with PartCell(tmp_path).running() as cell:
        token = await cell.take()
        draft = await cell.begun(**token)
        assert (409, "setup_refused") == await refused(
            cell, "POST", f"/teachings/{draft['id']}/activate", {"note": "without the cell"}
        )
        status, first = await cell.ask(
            "POST", f"/teachings/{draft['id']}/activate", {**token, "note": "first"}
        )
        assert (200, 1, ["part1"], True) == (status, first["number"], first["jobs"], first["active"])
        _, now = await cell.ask("GET", "/cell")
        assert ([], [{"number": 1, "name": "part1"}]) == (now["missing"], now["jobs"])
        draft = await cell.learnt(draft["id"])
        assert ("part1", True) == (draft["job"], draft["active"])
        folder = tmp_path / "jobs" / "part1"
        kept["text"], kept["region"] = (folder / "job.toml").read_bytes(), draft["region"][0]["points"]
        assert (422, "input") == await refused(
            cell, "POST", f"/teachings/{draft['id']}/activate", {**token, "note": "again"}
        )
        text = (folder / "job.toml").read_text().replace("max_sigma_mm = 0.2", "max_sigma_mm = 0.1")
        (folder / "job.toml").write_text(text)
        await BrowserSession(cell.session).reload(cell.daemon)

        edited = await cell.begun(job="part1")
        assert (draft["region"], "part1", False) == (edited["region"], edited["job"], edited["active"])
        edited = await cell.change("PUT", edited, "/features", {"features": {"c3": False}})
        edited = await cell.change("PUT", edited, "", {"name": "ring", "gripping": {"z_mm": 2.0}})
        status, second = await cell.ask(
            "POST", f"/teachings/{edited['id']}/activate", {**token, "note": "ring"}
        )
        assert (200, ["ring"]) == (status, second["jobs"])
        job = load_job(tmp_path / "jobs" / "ring")
        assert (0.1, 6) == (job.limits.max_sigma_mm, len(job.circles)), "people's edits were lost"
        assert [0.0, 0.0, 2.0] == job.picking.grasps[0].part_from_tcp[:3, 3].tolist()
        assert not folder.exists()
        status, back = await cell.ask("POST", "/releases/1/activate", {**token, "reason": "better"})
        assert (200, first["fingerprint"]) == (status, back["fingerprint"])
        assert kept["text"] == (folder / "job.toml").read_bytes()
    assert 0 == check(cell.config, as_json=True)
    taught = tmp_path / "jobs" / "part1" / "taught"
    region = "polygon:" + ";".join(f"{x},{y}" for x, y in kept["region"])
    source = PairSource(taught / "left.png", taught / "right.png", region)
    teach(cell.rig, source, "part1", tmp_path / "by_command", Console(file=io.StringIO()))
    for name in ("job.toml", "shape.npz"):
        assert (tmp_path / "by_command" / name).read_bytes() == (taught.parent / name).read_bytes(), name


def test_a_job_can_be_taught_from_a_recorded_cycle(tmp_path: Path) -> None:
    """A recorded cycle gives its own grey values, only if it is of the rig in use and has pictures."""
    file = tmp_path / "cycle.zip"
    snapshot = Snapshot(
        cycle=1,
        status=Status.NO_TARGET,
        command=None,
        job="flange",
        job_number=1,
        calibration_id="demo",
        fingerprint="12345678",
        simulated=True,
        exposed_ns=1,
        published_ns=2,
    )
    file.write_bytes(recording.encode(snapshot, frame_pair(flange().left, flange().right)))
    pair = recorded_pair(file, "demo")
    assert np.array_equal(flange().left, pair.left)
    assert np.array_equal(flange().right, pair.right)
    assert None is pair.content
    with pytest.raises(TeachError, match="measured by another rig"):
        recorded_pair(file, "cal-2")
    file.write_bytes(recording.encode(snapshot, None))
    with pytest.raises(TeachError, match="has no pictures"):
        recorded_pair(file, "demo")
