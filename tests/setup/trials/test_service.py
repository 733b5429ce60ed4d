"""Trials of a job on live pairs over HTTP: every tab gets the results."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import pytest
from helpers.cells import flange
from helpers.partcell import PartCell, turned

from edged.cell.tasks import cancel_and_await
from edged.files.jobs import save_job
from edged.pipeline import prepare
from edged.setup.jobs.worker import Worker
from edged.vision.teaching.pair import teach


class TaughtCell(PartCell):
    """A cell with a job of the flange."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        rectification = prepare(flange().rig).rectification
        job = teach(flange().left, flange().right, rectification, flange().region, "flange")
        save_job(folder / "jobs" / "flange", job)
        self.config.write_text(self.config.read_text().replace('job = "none"', 'job = "flange"'))


Trials = asyncio.Queue[dict[str, Any]]


@asynccontextmanager
async def live(cell: PartCell, token: dict[str, str]) -> AsyncIterator[Trials]:
    """A tab of the user who has the cell, and the trials that it receives.

    It watches the live pictures all the time: a tab that does not is disconnected.
    """
    trials = Trials()

    async def look(socket: aiohttp.ClientWebSocketResponse) -> None:
        async for message in socket:
            if message.type is aiohttp.WSMsgType.BINARY:
                await socket.send_json({"seen": int.from_bytes(message.data[1:9], "big")})
            elif (document := json.loads(message.data))["type"] == "trial":
                trials.put_nowait(document)

    headers = {"Origin": f"http://127.0.0.1:{cell.port}"}
    async with cell.session.ws_connect("/api/v1/ws", headers=headers) as socket:
        await socket.send_json({"live": True, **token})
        looking = asyncio.create_task(look(socket))
        try:
            yield trials
        finally:
            await cancel_and_await(looking)


async def told(trials: Trials, condition: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    """The next trial that fulfils a condition."""
    while not condition(trial := await trials.get()):
        pass
    return trial


def cropping(run: Callable[..., Awaitable[Any]]) -> Callable[..., Awaitable[Any]]:
    """A worker's `run` that tries pictures of smaller cameras."""

    async def cropped(worker: Worker, name: str, *arguments: Any) -> Any:
        if name == "try_pair":
            setup, images = arguments
            arguments = setup, tuple(image[:-8] for image in images)
        return await run(worker, name, *arguments)

    return cropped


@pytest.mark.long
async def test_a_job_is_tried_on_live_pairs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A trial gives the part's place in the robot's frame, follows a moved part with a longer trail, and
    also tries a draft; what cannot be tried is refused with a code."""
    cell = TaughtCell(tmp_path)
    async with cell.running():
        token = await cell.take()
        for what, code in (
            ({"job": "gear"}, (422, "input_no_job")),
            ({"teaching": "20260101-120000-0000"}, (404, "unknown")),
            ({}, (422, "input")),
            ({"job": "gear", "teaching": "20260101-120000-0000"}, (400, "invalid")),
        ):
            assert code == await coded(cell, "PUT", {**token, **what, "on": True}), what
        assert (409, "setup_refused") == await coded(cell, "PUT", {"token": "x", "job": "gear", "on": True})
        assert (422, "input") == await coded(cell, "GET", None)
        _, nothing = await cell.ask("GET", "/trials", None)
        assert (False, None, []) == (nothing["on"], nothing["status"], nothing["targets"])

        _, begun = await cell.ask("PUT", "/trials", {**token, "job": "flange", "on": True})
        assert (True, "flange", None) == (begun["on"], begun["job"], begun["teaching"])
        async with live(cell, token) as trials:
            first = await told(trials, lambda one: one["number"])
            assert ("OK", "OK", []) == (first["status"], first["words_code"], first["reasons"])
            (part,) = first["targets"]
            place = np.array([part["pose"][f"{axis}_mm"] for axis in "xyz"])
            robot_from_rig = flange().rig.robot_from_rig
            assert robot_from_rig is not None
            true = robot_from_rig @ flange().rig_from_part
            assert ("robot", True) == (part["frame"], bool(np.abs(place - true[:3, 3]).max() < 0.02))
            cell.world.shown = turned(70.0)
            moved = await told(trials, lambda one: len(one["covered"]) == 2)
            assert moved["number"] > first["number"]

            status, chart = await cell.ask("GET", "/trials/map", None)
            assert (200, True) == (status, chart["measured"])
            assert chart["columns"] * chart["rows"] * chart["layers"] == len(chart["points"])
            seen = [one for one in chart["points"] if one["sigma_um"]]
            assert all(max(one["sigma_um"].values()) < chart["limit_um"] for one in seen)
            charted = await told(trials, lambda one: one["covered_share"] is not None)
            assert 1 <= round(charted["covered_share"] * len(seen)) <= 2

            cell.world.shown = (np.full_like(flange().left, 30),) * 2
            gone = await told(trials, lambda one: one["status"] != "OK")
            assert ("NO_TARGET", "NOT_FOUND", []) == (gone["status"], gone["words_code"], gone["targets"])

            with monkeypatch.context() as patch:
                patch.setattr(Worker, "run", cropping(Worker.run))
                trouble = (await told(trials, lambda one: one["trouble"]))["trouble"]
            height, width = flange().left.shape
            sizes = {"found": f"{width}x{height - 8}", "wanted": f"{width}x{height}"}
            assert ("image_size", {"side": "left", **sizes}) == (trouble["code"], trouble["params"])
            assert sizes["wanted"] in trouble["text"]
            assert None is (await told(trials, lambda one: one["status"]))["trouble"]

            status, off = await cell.ask("PUT", "/trials", {**token, "on": False})
            assert (200, False, len(gone["covered"])) == (status, off["on"], len(off["covered"]))
            cell.world.shown = turned(70.0)
            draft = (await cell.begun(**token))["id"]
            await cell.ask("PUT", "/trials", {**token, "teaching": draft, "on": True})
            of_draft = await told(trials, lambda one: one["teaching"] == draft and one["number"])
            assert ("OK", None, 1) == (of_draft["status"], of_draft["job"], len(of_draft["covered"]))
            _, again = await cell.ask("GET", "/trials/map?job=flange", None)
            assert chart == again
            _, still_on = await cell.ask("GET", "/trials", None)
            assert (True, draft) == (still_on["on"], still_on["teaching"])


@pytest.mark.long
async def test_the_still_test_is_a_task_with_a_verdict(tmp_path: Path) -> None:
    """Identical pictures do not scatter; a part that is moved or taken away gives no verdict."""
    cell = TaughtCell(tmp_path)

    async def still(token: dict[str, str], pictures: int) -> str:
        body = {**token, "job": "flange", "pictures": pictures}
        status, begun = await cell.ask("POST", "/trials/still", body)
        assert 202 == status, begun
        return str(begun["task"])

    async def last() -> dict[str, Any]:
        return dict((await cell.ask("GET", "/trials/still", None))[1]["last"])

    async with cell.running():
        token = await cell.take()
        assert (200, {"last": None}) == await cell.ask("GET", "/trials/still", None)
        assert "done" == (await cell.done(await still(token, 6)))["state"]
        found = await last()
        assert ("smaller", True, 6, "Anna") == (found["verdict"], found["covers"], found["n"], found["by"])
        assert 0 < found["edges_um"]["z"] < 20
        assert found["expected"][0] < 1 < found["expected"][1]

        task = await still(token, 20)
        assert (409, "setup_refused") == await coded(cell, "POST", {**token, "job": "flange"})
        await cell.until(f"/tasks/{task}", lambda told: (told["done"] or 0) > 0.2)
        cell.world.shown = turned(20.0)
        assert "done" == (await cell.done(task))["state"]
        assert ("moving", None) == ((found := await last())["verdict"], found["chi2"])

        cell.world.shown = (np.full_like(flange().left, 30),) * 2
        await cell.done(await still(token, 6))
        assert ("vanished", None) == ((found := await last())["verdict"], found["scatter_um"])


async def coded(cell: PartCell, method: str, body: Any) -> tuple[int, str]:
    """Status and problem code of a trial, a still test or the map."""
    path = {"PUT": "/trials", "POST": "/trials/still", "GET": "/trials/map"}[method]
    status, problem = await cell.ask(method, path, body)
    return status, problem["code"]
