"""Cameras of a cell whose sides are not chosen yet: neither can be tried alone."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, cast

import pytest

from edged.adapters.aravis import CameraInfo
from edged.config.cameras import CameraSection, CamerasSection
from edged.config.chosencameras import UNCHOSEN, ChosenCamera
from edged.domain.arrays import Side
from edged.errors import UserError
from edged.setup.cameras import service
from edged.setup.cameras.service import CameraService


class Session:
    """What the test tries."""

    def __init__(self) -> None:
        self.camera_changes: Mapping[Side, ChosenCamera] = {}

    async def try_cameras(self, _token: str, changes: Mapping[Side, ChosenCamera]) -> None:
        self.camera_changes = changes


def camera(serial: str, control: str = "free") -> CameraInfo:
    """A camera that answers."""
    return CameraInfo(serial, "maker", "model", serial, f"10.0.0.{serial}", "GigEVision", "", control)


def chosen(cameras: CameraService) -> dict[Side, bool]:
    """Whether a camera is chosen, by side."""
    return {side: camera["chosen"] for side, camera in cameras.configured().items()}


def assigned(
    monkeypatch: pytest.MonkeyPatch, cameras: list[CameraInfo], right: str = UNCHOSEN["right"]
) -> dict[Side, str | None]:
    """Serial numbers by side after "use 2 as left"."""
    monkeypatch.setattr(service, "list_cameras", lambda: cameras)
    monkeypatch.setattr(service, "aravis_missing", lambda: "")
    session = Session()
    sections = CamerasSection(left=CameraSection(device=UNCHOSEN["left"]), right=CameraSection(device=right))
    files = SimpleNamespace(config=SimpleNamespace(cameras=sections))
    cell = SimpleNamespace(files=files, session=session, notices=None)
    live = SimpleNamespace(listen=lambda _look: None)
    tried = CameraService(cast(Any, cell), cast(Any, live), None, cast(Any, None))
    assert {"left": False, "right": right != UNCHOSEN["right"]} == chosen(tried)
    asyncio.run(tried.assign("token", "left", "2"))
    assert {"left": True, "right": True} == chosen(tried)
    return {side: change.serial for side, change in session.camera_changes.items()}


def test_the_only_other_free_camera_becomes_the_other_side(monkeypatch: pytest.MonkeyPatch) -> None:
    """One click assigns both sides; a camera that somebody else controls is not used."""
    cameras = [camera("1", "controlled"), camera("2"), camera("3")]
    assert {"left": "2", "right": "3"} == assigned(monkeypatch, cameras)


@pytest.mark.parametrize("others", [[], ["1", "3"]])
def test_no_camera_is_guessed(monkeypatch: pytest.MonkeyPatch, others: list[str]) -> None:
    """With one or three free cameras nothing is tried, and their number is named."""
    cameras = [camera("2"), *map(camera, others)]
    with pytest.raises(UserError, match=f"two free cameras are needed, and {1 + len(others)} answer"):
        assigned(monkeypatch, cameras)


def test_a_side_that_was_chosen_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """A chosen camera stays assigned although it does not answer."""
    assert {"left": "2"} == assigned(monkeypatch, [camera("2"), camera("3")], right="10.0.0.9")
