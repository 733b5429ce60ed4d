"""The stage and the cameras' routes: a new user's cell, with real GigE Vision cameras over loopback."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import aiohttp
import numpy as np
import pytest
from helpers.cells import small_rig
from helpers.needs import needs_aravis
from helpers.ports import free_port
from helpers.stagecell import staged
from helpers.waiting import WHOLE_S, until

from edged.domain.arrays import SIDES
from edged.files.rig import save_rig
from edged.sim.gige import genicam as g
from edged.sim.stage import stage_board
from edged.sim.world import SERIALS
from edged.vision.boards.board import Chessboard, Detection
from edged.vision.boards.detection import detect_board

pytestmark = [pytest.mark.slow, needs_aravis()]
BOARD = Chessboard(11, 8, 4.0)


async def test_the_board_follows_what_is_drawn(tmp_path: Path) -> None:
    """An empty folder becomes a cell in SETUP with a stage, whose hand moves the board to a drawn outline."""
    async with staged(tmp_path) as newcomer:
        cell = await newcomer.ask("GET", "cell")
        assert (True, "SETUP", ["rig", "jobs"]) == (cell["stage"], cell["state"], cell["missing"])
        assert "nothing" == (await newcomer.ask("GET", "stage"))["showing"]
        shown = await newcomer.ask("PUT", "stage", {"showing": "board", "still": True})
        assert ("board", "chessboard:11x8:4", True) == (shown["showing"], shown["board"], shown["still"])
        pictures = await newcomer.picture()
        for image in pictures.values():
            assert isinstance(detect_board(image, BOARD), Detection)
        goal = np.eye(4)
        goal[:3, 3] = -14, -16, 211
        marks = stage_board().points_mm[[0, 10, 87, 77]] + goal[:3, 3]
        outlines = {side: newcomer.world.cell.view(side).project(marks).tolist() for side in SIDES}
        assert (await newcomer.ask("PUT", "stage/hand", outlines))["moving"]
        while (await newcomer.ask("GET", "stage"))["moving"]:
            await newcomer.picture()
        found = detect_board((await newcomer.picture())["left"], BOARD)
        assert isinstance(found, Detection)
        # where it is drawn, but for a hand's miss of 10 mm: 155 px
        first = found.pixels[found.ids == 0][0]
        assert 3 < np.linalg.norm(first - outlines["left"][0]) < 160
        truth = await newcomer.ask("GET", "stage/truth")
        assert (None, None) == (truth["status"], truth["error_mm"])
        refused = await newcomer.ask("PUT", "stage/hand", {"left": [[1, 1]] * 4}, 422)
        assert "no_board" == refused["code"]


async def test_a_stranger_neither_sees_nor_moves_anything(tmp_path: Path) -> None:
    """Without a log-in every route of the cameras and the stage answers 401."""
    async with staged(tmp_path) as newcomer:
        document = await newcomer.ask("GET", "openapi.json")
        asked = []
        async with aiohttp.ClientSession(newcomer.origin) as stranger:
            for path, methods in document["paths"].items():
                for method in methods if path.split("/")[3] in ("cameras", "stage") else ():
                    asked.append((method, path))
                    async with stranger.request(method, path.replace("{side}", "left"), json={}) as answer:
                        assert 401 == answer.status, asked[-1]
        assert 15 == len(asked)


@pytest.mark.long
async def test_cameras_are_found_adjusted_and_exchanged_until_setup_ends(tmp_path: Path) -> None:
    """Cameras are assigned by a waved hand, adjusted within their limits and exchanged, and all is undone
    at the end."""
    async with staged(tmp_path) as newcomer:
        await newcomer.picture()
        now = await newcomer.ask("GET", "cameras")
        now |= await newcomer.ask("POST", "cameras/settings", newcomer.token)
        found = {camera["serial"]: (camera["side"], camera["trouble"]) for camera in now["found"]}
        assert dict(zip(SERIALS, (("left", None), ("right", None)), strict=True)) == found
        assert {"exposure_us": 2000.0, "gain_db": 0.0} == now["settings"]["left"]
        assert [10.0, 1e6] == now["limits"]["right"]["exposure_us"]

        made = await newcomer.ask("PUT", "cameras/left", {**newcomer.token, "exposure_us": 800.0})
        assert {"exposure_us": 800.0, "gain_db": 0.0} == made
        refused = await newcomer.ask("PUT", "cameras/left", {**newcomer.token, "exposure_us": 3.0}, 422)
        assert "outside 10 to" in refused["detail"]

        # a hand before the right camera, where the left one is asked for: both are exchanged
        await newcomer.ask("PUT", "stage", {"waving": "right"})
        waved = await newcomer.ask("POST", "cameras/wave", {**newcomer.token, "side": "left"})
        assert {"moved": "right", "exchanged": True} == waved
        await newcomer.ask("PUT", "stage", {"waving": "none"})
        now = await newcomer.ask("GET", "cameras")
        sides = {camera["serial"]: camera["side"] for camera in now["found"]}
        assert dict(zip(SERIALS, ("right", "left"), strict=True)) == sides
        tried = now["configured"]["left"]["tried"]
        assert (SERIALS[1], 800.0) == (tried["serial"], tried["exposure_us"])
        devices = newcomer.world._devices  # noqa: SLF001  (what the cameras themselves hold)
        exposures = [device.registers.number(g.EXPOSURE_TIME) for device in devices]
        assert [2000.0, 800.0] == exposures

        await newcomer.ask("DELETE", "setup", newcomer.token, 204)
        await until(lambda: not any(device.controlled for device in devices))
        assert [2000.0, 2000.0] == [device.registers.number(g.EXPOSURE_TIME) for device in devices]


@pytest.mark.long
async def test_what_is_kept_outlives_setup_and_the_daemon(tmp_path: Path) -> None:
    """Kept exposures and exchanged cameras of a cell without a rig outlive SETUP and the daemon."""
    for is_kept in (False, True):
        async with staged(tmp_path) as newcomer:
            assert is_kept == (tmp_path / "rig.cameras.json").exists()
            if not is_kept:
                chosen = {"serial": SERIALS[1], "gain_db": 3.0}
                await newcomer.ask("PUT", "cameras/left", {**newcomer.token, **chosen})
                await newcomer.ask("POST", "cameras/keep", newcomer.token, 204)
                configured = (await newcomer.ask("GET", "cameras"))["configured"]
                left = [configured[side]["tried"] for side in ("left", "right")]
                assert [{}, {}] == left  # nothing is left to keep
            await newcomer.ask("DELETE", "setup", newcomer.token, 204)
            newcomer.token = await newcomer.ask("POST", "setup", {"name": "Ben"}, 201)
            await newcomer.picture()
            devices = newcomer.world._devices  # noqa: SLF001  (what the cameras themselves hold)
            assert [0.0, 3.0] == [device.registers.number(g.GAIN) for device in devices]


async def test_light_and_focus_of_live_pictures_are_told(tmp_path: Path) -> None:
    """A lens out of focus and too much light are reported with figures of their own camera."""
    async with staged(tmp_path) as newcomer:
        await newcomer.ask("GET", "cameras/quality", expected=404)
        await newcomer.ask("PUT", "stage", {"showing": "board", "still": True, "rings": {"right": 0.4}})
        await newcomer.ask("PUT", "cameras/left", {**newcomer.token, "exposure_us": 6000.0})
        headers = {"Origin": newcomer.origin}
        async with newcomer.session.ws_connect("/api/v1/ws", headers=headers) as socket:
            await socket.send_str(json.dumps({"live": True, **newcomer.token}))
            while True:
                message = await socket.receive()
                told = json.loads(message.data) if message.type is aiohttp.WSMsgType.TEXT else {}
                if told.get("type") == "quality":
                    break
                if told.get("number"):
                    await socket.send_str(json.dumps({"seen": told["number"]}))
        asked = await newcomer.ask("GET", "cameras/quality")
        assert asked["number"] >= told["number"]
        left, right = told["left"], told["right"]
        assert left["clipped_share"] > 0.05
        assert "less_light" == left["advice"]["code"]
        assert "good" == right["advice"]["code"]
        spread = right["edge_spread_px"]
        assert spread["median"] == pytest.approx(np.hypot(0.6, np.hypot(1.2, 12**-0.5)), rel=0.05)
        assert (6, 8) == (len(spread["map"]), len(spread["map"][0]))
        assert 1.6 < right["sigma_z_factor"] < 2.2


@pytest.mark.long
@pytest.mark.parametrize(
    ("is_calibrated", "expected"),
    [
        (False, "without a calibration and without a job"),
        (True, "with the calibration of this folder, and without a job"),
    ],
)
def test_the_command_says_where_to_go_and_ends_with_ctrl_c(
    tmp_path: Path, is_calibrated: bool, expected: str
) -> None:
    """The command prints address, new password and the contents of the folder, and exits with 0 after
    Ctrl+C.
    """
    if is_calibrated:
        (tmp_path / "cell").mkdir()
        save_rig(tmp_path / "cell" / "rig.json", small_rig(), {"board": "chessboard:11x8:4"})
    ports = [str(free_port()) for _ in range(3)]
    options = (f"--{name}-port={port}" for name, port in zip(("web", "modbus", "zenoh"), ports, strict=True))
    command = [sys.executable, "-m", "edged", "demo", "--stage", "--in-process", *options, "--folder"]
    with subprocess.Popen(
        [*command, str(tmp_path / "cell")], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        said = ""
        while " yet" not in said:
            line = process.stdout.readline()
            assert line, said
            said += line
        process.send_signal(signal.SIGINT)
        rest = process.communicate(timeout=WHOLE_S)[0]
    assert (0, "") == (process.returncode, rest)
    assert f"http://127.0.0.1:{ports[0]}/setup" in said
    assert expected in said
    made = {path.name for path in (tmp_path / "cell").iterdir()}
    assert {".cell.state", "cell.toml", "recordings"} == made - {"rig.json"}
    assert 0 == (tmp_path / "cell" / "cell.toml").stat().st_mode & 0o007
