"""The second pass with a lost frame in every action: the pair is taken again, and no action fails."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.cells import small_rig
from helpers.stagecell import staged

from edged.cell.stereohead import StereoHead
from edged.domain.frames import FramePair
from edged.errors import FrameIncomplete
from edged.files.rig import save_rig

BOARD = "chessboard:11x8:4"
OTHER_ROBOT = {"mount": "fixed", "kind": "poses", "brand": "kuka", "board": BOARD}


class Losses:
    """Loses the next frame whenever a test asks for it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.is_due = False
        whole = StereoHead.capture

        async def capture(head: StereoHead) -> FramePair:
            if self.is_due:
                self.is_due = False
                raise FrameIncomplete("left", "a packet is missing")
            return await whole(head)

        monkeypatch.setattr(StereoHead, "capture", capture)


@pytest.mark.long
async def test_a_lost_frame_costs_no_action_of_a_second_pass(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every action of a second pass takes its picture although one frame is lost."""
    save_rig(tmp_path / "rig.json", replace(small_rig(), robot_from_rig=None), {"board": BOARD})
    async with staged(tmp_path, gige=False) as newcomer:
        losses = Losses(monkeypatch)

        async def act(path: str, document: object = None, expected: int = 201) -> dict[str, object]:
            losses.is_due = True
            body = {**newcomer.token, **(document if isinstance(document, dict) else {})}
            answer = await newcomer.ask("POST", path, body, expected)
            assert not losses.is_due, f"{path} took no picture"
            return dict(answer or {})

        newcomer.world.cell.teach_pair()  # what is drawn for the first time takes longer than a camera may
        await newcomer.ask("PUT", "stage", {"showing": "part"})
        await act("captures")
        for _ in ("a part", "another part"):
            taught = await act("teachings")
            taught = await newcomer.until(f"teachings/{taught['id']}", lambda draft: not draft["proposing"])
            assert taught["features"]
            await newcomer.ask("DELETE", f"teachings/{taught['id']}", {}, 204)
        await newcomer.ask("PUT", "stage", {"showing": "board", "still": True})
        for board in ("chessboard:9x8:4", BOARD):
            draft = await newcomer.ask("POST", "calibrations", {"boards": [board]}, 201)
            looked = await act(f"calibrations/{draft['id']}/views")
            assert (board == BOARD) == any(view["used"] for view in looked["views"])
        checked = await act("checks", {"board": BOARD})
        assert "OK" == checked["verdict"]
        touch = {**OTHER_ROBOT, "kind": "touch", "brand": "fanuc"}
        draft = await newcomer.ask("POST", "registrations", touch, 201)
        looked = await act(f"registrations/{draft['id']}/looks")
        assert looked["places"]
        draft = await newcomer.ask("POST", "registrations", OTHER_ROBOT, 201)
        await act(f"registrations/{draft['id']}/samples", {"revision": draft["revision"]})
