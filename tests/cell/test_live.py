"""Live pictures without a server: who requests them, who receives them, and when they end."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from helpers.scriptedhead import Head, make_setup, running
from helpers.waiting import until

from edged.cell.cycle import Cycle
from edged.cell.lease import live as live_pictures
from edged.cell.lease.live import UNSEEN_S, LivePictures
from edged.cell.lease.notices import Notices
from edged.domain.frames import FramePair
from edged.errors import LinkError, SetupRefused


class Scene:
    """A cell whose lease is held, its live pictures, and what was published about them."""

    def __init__(self, cycle: Cycle, head: Head, token: str) -> None:
        self.cycle, self.head, self.token = cycle, head, token
        self.now_s = 0.0
        self.told: list[dict[str, Any]] = []
        notices = Notices()
        notices.listen(lambda kind, document: self.told.append({"kind": kind, **document}))
        self.live = LivePictures(cycle.session, notices, lambda: self.now_s)
        self.numbers: list[int] = []
        self.stop = self.live.listen(lambda number, _pair: self.numbers.append(number))


@asynccontextmanager
async def live(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Scene]:
    """A running cell whose lease is held."""
    monkeypatch.setattr(live_pictures, "PERIOD_S", 0.001)
    monkeypatch.setattr(live_pictures, "REST_S", 0.001)
    head = Head()
    cycle = Cycle(head, make_setup())
    async with running(cycle):
        scene = Scene(cycle, head, await cycle.session.enter_setup("Anna"))
        yield scene
        await scene.live.close()


async def test_pictures_come_while_they_are_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures are numbered without gaps, and stop when no one wants them."""
    async with live(monkeypatch) as scene:
        await scene.live.want("tab", scene.token)
        await until(lambda: len(scene.numbers) >= 5)
        assert list(range(1, len(scene.numbers) + 1)) == scene.numbers
        scene.live.unwant("tab")
        await until(lambda: not scene.live.is_on)
        taken = scene.head.captures
        await scene.cycle.session.capture(scene.token)
        assert taken + 1 == scene.head.captures
        assert [True, False] == [one["on"] for one in scene.told]


async def test_only_who_has_the_cell_gets_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """An invalid token is refused, and taking over the cell ends the pictures with a reason."""
    async with live(monkeypatch) as scene:
        with pytest.raises(SetupRefused):
            await scene.live.want("tab", "of nobody")
        assert not scene.live.is_on
        await scene.live.want("tab", scene.token)
        await until(lambda: scene.numbers)
        await scene.cycle.session.enter_setup("Ben", take_over=True)
        await until(lambda: not scene.live.is_on)
        assert ("live", False, "setup_refused") == tuple(
            scene.told[-1][name] for name in ("kind", "on", "code")
        )
        assert "Ben" in scene.told[-1]["detail"]


async def test_who_does_not_look_gets_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures end for a viewer that sends no `seen` for too long, and continue for one that does."""
    async with live(monkeypatch) as scene:
        await scene.live.want("tab", scene.token)
        for _ in range(3):
            scene.now_s += 0.7 * UNSEEN_S
            scene.live.seen("tab")
            before = len(scene.numbers)
            await until(lambda before=before: len(scene.numbers) > before)
        scene.now_s += UNSEEN_S
        await until(lambda: not scene.live.is_on)
        assert "unseen" == scene.told[-1]["code"]


async def test_a_dead_camera_is_told_once_and_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fault is reported once with its code, and pictures continue when the camera answers."""
    async with live(monkeypatch) as scene:
        scene.head.broken = True
        await scene.live.want("tab", scene.token)
        await until(lambda: len(scene.told) >= 2)
        await asyncio.sleep(0.02)
        assert [None, "camera_104"] == [one["code"] for one in scene.told]
        scene.head.broken = False
        await until(lambda: scene.numbers)


@pytest.mark.long
async def test_a_cell_that_stops_ends_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the cell stops, pictures end without an unhandled task error."""

    async def stopped(_token: str) -> FramePair:
        raise LinkError("the cell has stopped")

    async with live(monkeypatch) as scene:
        await scene.live.want("tab", scene.token)
        await until(lambda: scene.numbers)
        failed: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(lambda _loop, context: failed.append(context))
        monkeypatch.setattr(scene.cycle.session, "capture", stopped)
        await until(lambda: not scene.live.is_on)
        gc.collect()
        assert [] == failed


async def test_who_has_stopped_listening_hears_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """After stop, also twice, a listener gets nothing, while others still do."""
    async with live(monkeypatch) as scene:
        others: list[int] = []
        scene.live.listen(lambda number, _pair: others.append(number))
        scene.stop()
        scene.stop()
        await scene.live.want("tab", scene.token)
        await until(lambda: len(others) >= 2)
        assert [] == scene.numbers
