"""A VALID cell gets another camera, board, part and robot by clicks, without a restart, and goes back."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path

import pytest
from helpers.browsersession import PASSWORD
from helpers.cells import small_rig
from helpers.engines import BROWSERS, Opener
from helpers.needs import needs_aravis
from helpers.setuppage import log_in
from helpers.stagecell import staged
from helpers.waiting import WHOLE_S
from newcomerclicks import Clicks
from secondclicks import bench, second_pass

from edged.commands.stage import USER
from edged.files.rig import save_rig

pytestmark = [pytest.mark.slow, pytest.mark.takes(3 * WHOLE_S), needs_aravis()]
GOAL_UM = 40.0
"""For pictures of 640x480 this is soon reached: the clicks are tested."""
PLACES = 1
ASKED_BACK = re.compile(r"status of (403|409) .*/activate$")
"""A release asks for the password again, and for a signature if recorded cycles were not tried."""


@pytest.mark.long
@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("browser", BROWSERS[:2])  # a minute each
async def test_all_is_done_a_second_time_with_a_lost_picture_in_every_action(
    tmp_path: Path, browser: Opener, backward: bool
) -> None:
    """The cell is VALID with the second set-up, with the first again, and with the second again, though a
    picture is lost in every action."""
    save_rig(tmp_path / "rig.json", small_rig(), {"board": "chessboard:11x8:4"})
    async with staged(tmp_path, page_is_here=False) as newcomer, browser() as page:
        # what is drawn for the first time takes longer than a camera, or the page, may wait
        await asyncio.to_thread(newcomer.world.cell.teach_pair)
        await newcomer.ask("PUT", "stage", {"showing": "part"})
        draft = f"teachings/{(await newcomer.ask('POST', 'teachings', newcomer.token, 201))['id']}"
        await newcomer.until(draft, lambda taught: not taught["proposing"])
        await newcomer.ask("POST", f"{draft}/activate", {"note": "part", **newcomer.token})
        await newcomer.ask("DELETE", "setup", newcomer.token, 204)
        port = (await newcomer.ask("GET", "plc"))["port"]
        with bench(newcomer.world, loses=True) as beside:
            await log_in(page, newcomer.origin, USER, PASSWORD, "/setup", (1280, 900))
            await page.click(".stage summary")
            clicks = Clicks(page, None)
            also = {"backward": backward}
            found = await second_pass(page, clicks, beside, port, PASSWORD, GOAL_UM, PLACES, **also)
        first, second, back, again = found["valid"]
        assert (1, 2, 1, 2) == tuple(result["JOB"] for result in found["valid"])
        assert first["CALIBRATION"] == back["CALIBRATION"] != second["CALIBRATION"] == again["CALIBRATION"]
        assert ("50", "505", "50", "505") == tuple(result["setting"] for result in found["valid"])
        assert found["lost"] > 20
        assert [] == [one for one in page.complaints if not ASKED_BACK.search(one)]
