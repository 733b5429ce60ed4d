"""A registration by a robot's program, as shown on the page."""

from __future__ import annotations

import base64
import json
import time
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import pytest
from argon2 import PasswordHasher
from helpers.ports import free_port
from helpers.waiting import LIMIT_S
from helpers.walkedcell import ROBOT_FROM_RIG, TAUGHT_MM, Arm, WalkedCell

from edged.vision.geometry.rigid import apply, transform

PASSWORD = "correct horse"
pytestmark = pytest.mark.slow


class Page:
    """A viewer with the page's password, of a cell that does not run yet."""

    def __init__(self, cell: WalkedCell) -> None:
        self._port = free_port()
        hashed = PasswordHasher(time_cost=1, memory_cost=512, parallelism=1).hash(PASSWORD)
        web = f'\n[web]\nport = {self._port}\ncommissioning = true\npassword_hash = "{hashed}"\n'
        cell.write(cell.config.read_text() + web)

    def ask(self, path: str) -> Any:
        """Answer to a request."""
        code = base64.b64encode(f"edged:{PASSWORD}".encode()).decode()
        asked = Request(
            f"http://127.0.0.1:{self._port}/api/v1/{path}", headers={"Authorization": f"Basic {code}"}
        )
        with urlopen(asked, timeout=LIMIT_S) as answer:
            return json.load(answer)

    def draft(self, **wanted: object) -> dict[str, Any]:
        """The newest draft, once it has these values and is judged."""
        deadline_s = time.monotonic() + LIMIT_S
        while True:
            assert time.monotonic() < deadline_s, wanted
            lines = self.ask("registrations")["registrations"]
            if lines:
                draft = dict(self.ask(f"registrations/{lines[0]['id']}"))
                found = {**draft, "count": len(draft["samples"])}
                if not draft["judging"] and all(found[name] == value for name, value in wanted.items()):
                    return draft
            time.sleep(0.02)


@pytest.mark.long
def test_a_robots_program_is_seen_pose_by_pose_and_point_by_point(tmp_path: Path) -> None:
    """Six poses are listed as they come, judged as in the robot's answers, and active after solving; then
    touched points of a part."""
    cell = WalkedCell(tmp_path, Arm())
    page = Page(cell)  # a reload later on would refuse the commands that wait for it
    with cell:
        walk = cell.arm.walk()
        with cell.robot() as robot:
            assert 0 == robot.ask("HAND_EYE_START")[0]
            for count, pose in enumerate(walk[:6], 1):
                assert 0 == robot.add(pose)
                if count in (1, 6):
                    draft = page.draft(count=count, by_program=True)
            assert ("poses", "fixed", "fanuc", "a robot's program") == tuple(
                draft[name] for name in ("kind", "mount", "brand", "author")
            )
            assert (True, None, False) == (draft["good"], draft["trouble"], draft["active"])
            assert draft["conventions"][0]["rms_mm"] < 0.03
            # in whole micrometres, as in its registers
            _, _, rms, held_out, *_ = robot.ask("REGISTER_SOLVE")
            assert [rms, held_out] == pytest.approx(
                [draft["figures"]["rms_mm"], draft["figures"]["worst_mm"]], abs=5.1e-4
            )
            assert page.draft(active=True)["solved"]

            cell.arm.shows, cell.arm.part = "part", transform(cell.arm.part[:3, :3], TAUGHT_MM)
            assert 0 == robot.ask("TOUCH_START")[0]
            tip = transform(walk[0][:3, :3], apply(ROBOT_FROM_RIG, TAUGHT_MM))
            assert 0 == robot.add(tip)
            draft = page.draft(count=1, kind="touch")
            assert draft["samples"][0]["numbers"] == pytest.approx(tip[:3, 3].tolist(), abs=1e-3)
            assert draft["samples"][0]["rig_mm"] == pytest.approx(TAUGHT_MM.tolist(), abs=0.05)
