"""The WebSocket of a tab: who may open one, what it receives, and that it blocks nobody."""

from __future__ import annotations

import asyncio
import contextlib
import json
from dataclasses import replace
from typing import Any

import aiohttp
import cv2
import numpy as np
import pytest
from helpers.waiting import LIMIT_S, until
from helpers.webcell import Cell, running

from edged.adapters.web import server, sockets
from edged.domain.cell import CellPhase, CellState
from edged.domain.overview import Overview
from edged.identity.sessions import IDLE_S

PLACE = "/api/v1/ws"


class Tab:
    """The browser's end. pictures : (number, side) of those received; told : the JSON messages."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket
        self.pictures: list[tuple[int, int]] = []
        self.told: list[dict[str, Any]] = []
        self.jpeg = b""

    async def hear(self, kind: str, **expected: Any) -> dict[str, Any]:
        """Next message of a kind with these values; earlier ones are recorded."""
        while True:
            message = await self.socket.receive()
            if message.type is aiohttp.WSMsgType.BINARY:
                self.jpeg = message.data[9:]
                self.pictures.append((int.from_bytes(message.data[1:9], "big"), message.data[0]))
                continue
            assert message.type is aiohttp.WSMsgType.TEXT, message
            document = json.loads(message.data)
            self.told.append(document)
            if document["type"] == kind and expected.items() <= document.items():
                return document

    async def look(self) -> int:
        """Receive one pair to its second picture; returns its number."""
        number = (await self.hear_frame())["number"]
        while (number, 1) not in self.pictures:
            message = await self.socket.receive()
            assert message.type is aiohttp.WSMsgType.BINARY, message
            self.jpeg = message.data[9:]
            self.pictures.append((int.from_bytes(message.data[1:9], "big"), message.data[0]))
        return int(number)

    async def hear_frame(self) -> dict[str, Any]:
        """Next announcement of a pair."""
        while "number" not in (document := await self.hear("live")):
            pass
        return document


async def opened(cell: Cell) -> Tab:
    """Open a socket as the page does."""
    return Tab(await cell.session.ws_connect(PLACE, origin=cell.origin))


async def test_a_tab_hears_of_the_cell_as_it_changes() -> None:
    """A tab receives the cell's state on opening and after each change, including the lease."""
    async with running(visitor="Anna") as cell:
        tab = await opened(cell)
        await tab.hear("cell", state="READY", setup=None)
        _, entered = await cell.ask("POST", "/api/v1/setup", {"name": "Anna"})
        shown = await tab.hear("cell", state="SETUP")
        assert ("Anna", True) == (shown["setup"]["name"], shown["setup"]["yours"])
        await cell.ask("DELETE", "/api/v1/setup", entered)
        await tab.hear("cell", state="READY")
        await tab.socket.close()


async def test_live_pictures_come_one_after_another_as_they_are_seen() -> None:
    """Left and right of one exposure are sent, the next only after `seen`, to viewers as well, until
    switched off."""
    async with running(visitor="Anna") as cell:
        _, entered = await cell.ask("POST", "/api/v1/setup", {"name": "Anna"})
        tab, other = await opened(cell), await opened(cell)
        await tab.socket.send_json({"live": True, **entered})
        first = await tab.look()
        assert [(first, 0), (first, 1)] == tab.pictures
        image = cv2.imdecode(np.frombuffer(tab.jpeg, np.uint8), cv2.IMREAD_UNCHANGED)
        assert image is not None
        assert (4, 4) == image.shape
        taken = cell.head.captures
        await until(lambda: cell.head.captures >= taken + 3)
        assert tab.pictures[-1][0] == first
        await tab.socket.send_json({"seen": first})
        assert first + 3 <= await tab.look()
        assert await other.look()
        await tab.socket.send_json({"live": False})
        await tab.hear("live", on=False)
        taken = cell.head.captures
        await cell.ask("POST", "/api/v1/captures", entered)
        assert taken + 1 == cell.head.captures
        for one in (tab, other):
            await one.socket.close()


async def test_closing_the_tab_ends_its_pictures() -> None:
    """The cameras stop, and the lease stays."""
    async with running(visitor="Anna") as cell:
        _, entered = await cell.ask("POST", "/api/v1/setup", {"name": "Anna"})
        tab, other = await opened(cell), await opened(cell)
        await tab.socket.send_json({"live": True, **entered})
        await tab.look()
        await tab.socket.close()
        await other.hear("live", on=False)
        assert (204, None) == await cell.ask("PUT", "/api/v1/setup/lease", entered)
        await other.socket.close()


async def test_live_without_the_cell_is_refused() -> None:
    """Without a valid token live is refused with a code, no picture is taken, and the tab stays open."""
    async with running(visitor="Anna") as cell:
        tab = await opened(cell)
        for said in ({"live": True}, {"live": True, "token": "of nobody"}):
            await tab.socket.send_json(said)
            refused = await tab.hear("live", on=False)
            assert "setup_refused" == refused["code"]
        assert 0 == cell.head.captures
        await tab.socket.close()


async def test_only_an_engineer_lets_cameras_run() -> None:
    """A viewer, an engineer with another's token, and an idle one are refused; activity ends idleness."""
    async with running(visitor="Anna") as cell:
        anna = cell.cookies()
        _, entered = await cell.ask("POST", "/api/v1/setup", {})
        for name, code in (("Vera", "role"), ("Ben", "setup_refused")):
            await cell.log_in(name)
            tab = await opened(cell)
            await tab.socket.send_json({"live": True, **entered})
            assert code == (await tab.hear("live", on=False))["code"]
            await tab.socket.close()
        cell.use(anna)
        tab = await opened(cell)
        cell.sleep(0.6 * IDLE_S)
        await tab.socket.send_json({"active": True})
        await tab.socket.send_json({"live": True, **entered})
        await tab.look()
        await tab.socket.send_json({"live": False})
        await tab.hear("live", on=False)
        cell.sleep(0.6 * IDLE_S)
        await tab.socket.send_json({"live": True, **entered})
        await tab.hear("live", on=True)
        await tab.socket.send_json({"live": False})
        await tab.hear("live", on=False)
        cell.sleep(IDLE_S)
        await tab.socket.send_json({"live": True, **entered})
        assert "idle" == (await tab.hear("live", on=False))["code"]
        await tab.socket.close()


async def test_what_the_plant_says_is_told_without_an_event(monkeypatch: pytest.MonkeyPatch) -> None:
    """AUTO_LOCK of a ready cell, which causes no event, is reported when the cell is idle."""
    monkeypatch.setattr("edged.cell.context.IDLE_S", 0.05)
    async with running(visitor="Anna") as cell:
        tab = await opened(cell)
        assert not (await tab.hear("cell", state="READY"))["plc"]["auto_lock"]
        cell.plant = Overview(auto_lock=True, plc_owner="10.0.0.5")
        assert {"owner": "10.0.0.5", "auto_lock": True} == (await tab.hear("cell"))["plc"]
        await tab.socket.close()


@pytest.mark.parametrize("said", ["{", "[]", '{"seen": -1}', '{"seen": 1.5}', '{"colour": 1}', "[" * 900])
async def test_what_is_no_message_ends_the_socket(said: str) -> None:
    """An invalid message closes the socket with a policy violation."""
    async with running(visitor="Anna") as cell:
        tab = await opened(cell)
        await tab.socket.send_str(said)
        while not tab.socket.closed:
            await tab.socket.receive()
        assert aiohttp.WSCloseCode.POLICY_VIOLATION == tab.socket.close_code


async def test_a_page_elsewhere_or_without_a_session_opens_no_socket() -> None:
    """Without a session the answer is 401, and from another origin 403."""
    async with running() as cell:
        with pytest.raises(aiohttp.WSServerHandshakeError, match="401"):
            await cell.session.ws_connect(PLACE, origin=cell.origin)
        await cell.log_in()
        for origin in ("http://evil.example", "null", None):
            with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                await cell.session.ws_connect(PLACE, origin=origin)
        assert 426 == (await cell.ask("GET", PLACE, None))[0]


async def test_logging_out_ends_the_socket() -> None:
    """The socket is closed after logging out."""
    async with running(visitor="Anna") as cell:
        tab = await opened(cell)
        await tab.hear("cell")
        async with cell.session.post(
            "/logout", headers={"Origin": cell.origin}, allow_redirects=False
        ) as answer:
            assert 303 == answer.status
        await tab.socket.send_json({"seen": 0})
        while not tab.socket.closed:
            await tab.socket.receive()
        assert sockets.LOGGED_OUT == tab.socket.close_code


async def test_there_are_so_many_sockets_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond the limit a socket is refused with 503, and closing one frees its place."""
    monkeypatch.setattr(sockets, "MAX_SOCKETS", 2)
    async with running(visitor="Anna") as cell:
        tabs = [await opened(cell) for _ in range(2)]
        with pytest.raises(aiohttp.WSServerHandshakeError, match="503"):
            await opened(cell)
        await tabs[0].socket.close()
        async with asyncio.timeout(LIMIT_S):
            while True:
                try:
                    tabs[0] = await opened(cell)
                    break
                except aiohttp.WSServerHandshakeError:
                    await asyncio.sleep(0.01)
        for tab in tabs:
            await tab.socket.close()


async def test_stopping_ends_every_socket() -> None:
    """Stopping closes every socket with "going away", without waiting for the browser."""
    async with running(visitor="Anna") as cell:
        tab = await opened(cell)
        await tab.hear("cell")
        closing = asyncio.create_task(cell.web.close())
        while not tab.socket.closed:
            await tab.socket.receive()
        await closing
        assert aiohttp.WSCloseCode.GOING_AWAY == tab.socket.close_code


async def test_a_ping_is_answered_and_too_many_end_the_socket(monkeypatch: pytest.MonkeyPatch) -> None:
    """Too many messages close the socket, and the sender is refused for a while, but not others."""
    monkeypatch.setattr(server, "FLOODED_S", 60.0)
    async with running(visitor="Vera") as cell:
        socket = await cell.session.ws_connect(PLACE, origin=cell.origin, autoping=False)
        await socket.ping(b"here")
        while (message := await socket.receive()).type is not aiohttp.WSMsgType.PONG:
            assert message.type is aiohttp.WSMsgType.TEXT
        assert b"here" == bytes(message.data)
        with contextlib.suppress(ConnectionError):
            for _ in range(2 * int(sockets.MESSAGES_AT_ONCE)):
                await socket.ping()
        while not socket.closed:
            message = await socket.receive()
        assert socket.close_code in (
            aiohttp.WSCloseCode.POLICY_VIOLATION,
            aiohttp.WSCloseCode.ABNORMAL_CLOSURE,
        )
        assert 429 == (await cell.ask("GET", "/api/v1/me"))[0]
        await cell.log_in_anew("Anna")
        assert 200 == (await cell.ask("GET", "/api/v1/me"))[0]


async def test_a_cell_that_fails_in_a_beat_is_not_only_seen_failing() -> None:
    """If every second picture fails, both states are sent, with the error code."""
    async with running(visitor="Vera") as cell:
        await until(lambda: cell.ear.state() is CellPhase.READY)
        well = next(event for event in reversed(cell.ear.events) if isinstance(event, CellState))
        fault = {"error": "camera left: frame 4: incomplete: timeout", "error_code": 105}
        tab = await cell.session.ws_connect(PLACE, origin=cell.origin)
        heard = list[tuple[str, int]]()

        async def listen() -> None:
            async for message in tab:
                told = json.loads(message.data)
                if told["type"] == "cell":
                    heard.append((told["error"], told["error_code"]))

        listening = asyncio.create_task(listen())
        for _ in range(4):
            cell.web.announce(well)
            cell.web.announce(replace(well, state=CellPhase.BUSY))
            await asyncio.sleep(0.15)
            cell.web.announce(replace(well, state=CellPhase.FAULT, ready=False, **fault))
            await asyncio.sleep(0.1)
            cell.web.announce(replace(well, state=CellPhase.BUSY, ready=False, **fault))
            await asyncio.sleep(0.35)
        await tab.close()
        await listening
    assert heard.count(("", 0)) >= 3
    assert heard.count((fault["error"], fault["error_code"])) >= 3
