"""Connections to the page: how many a stranger has, and that logged-in users always get theirs."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
import zlib
from asyncio import StreamReader, StreamWriter
from pathlib import Path
from urllib.parse import urlencode

import aiohttp
import pytest
from helpers.browsersession import PASSWORD
from helpers.certificates import make_certificates
from helpers.pagesources import FixedSources
from helpers.waiting import until
from helpers.webcell import HASH, Cell, running

from edged.adapters.web import WebPublisher, WebSettings, login, places, sockets

SLOW_FORM = (
    b"POST /login HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://127.0.0.1\r\nContent-Length: 99\r\n\r\npass"
)
PLACE = "/api/v1/ws"


async def connect(cell: Cell, address: str, sent: bytes = b"") -> tuple[StreamReader, StreamWriter]:
    """Open a stranger's connection and send this."""
    reader, writer = await asyncio.open_connection("127.0.0.1", cell.web.port, local_addr=(address, 0))
    writer.write(sent)
    await writer.drain()
    return reader, writer


async def is_closed(reader: StreamReader) -> bool:
    """Whether the page has closed a connection."""
    with contextlib.suppress(TimeoutError, ConnectionError):
        async with asyncio.timeout(0.05):
            return await reader.read(65536) == b""
        return False
    return reader.exception() is not None


async def still_open(lines: list[tuple[StreamReader, StreamWriter]]) -> int:
    """Number of connections that are still open."""
    return sum([not await is_closed(reader) for reader, _ in lines])


def shut(lines: list[tuple[StreamReader, StreamWriter]]) -> None:
    """Close the connections."""
    for _, writer in lines:
        writer.close()


@pytest.mark.slow
async def test_a_stranger_has_eight_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """One address has eight connections, and another one displaces its longest silent one."""
    monkeypatch.setattr(login, "FORM_S", 60.0)
    async with running() as cell:
        lines = [await connect(cell, "127.0.0.9") for _ in range(20)]
        await until(lambda: len(clients(cell)) <= places.OF_ADDRESS)
        assert [False] * 8 == [await is_closed(reader) for reader, _ in lines[-8:]]
        assert 8 == await still_open(lines)
        shut(lines)


def clients(cell: Cell) -> list[str]:
    """Addresses of the connected clients."""
    listener = cell.web._listener  # noqa: SLF001  (what the page counts itself)
    assert listener is not None
    return [client.peer for client in listener.clients]


@pytest.mark.slow
async def test_a_form_that_does_not_come_keeps_no_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """While strangers hold unfinished forms from a hundred addresses, another stranger gets in, and a
    logged-in user is served on a new connection.
    """
    monkeypatch.setattr(login, "FORM_S", 60.0)
    async with running(visitor="Anna") as cell:
        lines = [await connect(cell, f"127.0.1.{n % 100 + 1}", SLOW_FORM) for n in range(200)]
        await until(lambda: len(clients(cell)) <= places.MAX_CONNECTIONS - places.KEPT)
        theirs = aiohttp.ClientSession(cell.origin, cookies=cell.cookies())
        async with asyncio.timeout(5.0), theirs, theirs.get("/api/v1/me") as answer:
            assert 200 == answer.status
        reader, writer = await connect(cell, "127.0.0.9", b"GET /health HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        async with asyncio.timeout(5.0):
            assert (await reader.readline()).startswith(b"HTTP/1.1 ")
        shut([*lines, (reader, writer)])


@pytest.mark.slow
async def test_strangers_end_no_connection_of_people() -> None:
    """Ten idle connections of a logged-in user outlast two hundred of strangers at the same address."""
    async with running(visitor="Anna") as cell:
        cookie = "; ".join(f"{name}={value}" for name, value in cell.cookies().items())
        asked = f"GET /api/v1/me HTTP/1.1\r\nHost: 127.0.0.1\r\nCookie: {cookie}\r\n\r\n".encode()
        mine = [await connect(cell, "127.0.0.1", asked) for _ in range(10)]
        for reader, _ in mine:
            assert (await reader.readline()).startswith(b"HTTP/1.1 200")
            while await reader.readline() != b"\r\n":
                pass
        lines = [await connect(cell, f"127.0.0.{n % 50 + 1}") for n in range(200)]
        for reader, writer in mine:
            await reader.read(65536)  # the body
            writer.write(asked)
            assert (await reader.readline()).startswith(b"HTTP/1.1 200")
        shut([*mine, *lines])


async def test_a_session_has_four_sockets() -> None:
    """A fifth socket of a session is refused, while another session can open one."""
    async with running(visitor="Vera") as cell:
        tabs = [await cell.session.ws_connect(PLACE, origin=cell.origin) for _ in range(4)]
        with pytest.raises(aiohttp.WSServerHandshakeError, match="503"):
            await cell.session.ws_connect(PLACE, origin=cell.origin)
        await cell.log_in("Anna")
        tabs.append(await cell.session.ws_connect(PLACE, origin=cell.origin))
        for tab in tabs:
            await tab.close()


@pytest.mark.slow
async def test_sockets_are_kept_for_people() -> None:
    """Sessions with only the page's password get at most half of the sockets, however many there are."""
    async with running() as cell:
        tabs = list[aiohttp.ClientWebSocketResponse]()
        with contextlib.suppress(aiohttp.WSServerHandshakeError):
            while True:
                if len(tabs) % sockets.OF_SESSION == 0:
                    await cell.log_in("")
                tabs.append(await cell.session.ws_connect(PLACE, origin=cell.origin))
        assert sockets.MAX_SOCKETS - sockets.KEPT == len(tabs)
        await cell.log_in("Vera")
        tabs.append(await cell.session.ws_connect(PLACE, origin=cell.origin))
        for tab in tabs:
            await tab.close()


@pytest.mark.slow
async def test_requests_that_expect_too_much_are_counted() -> None:
    """Requests with `Expect:`, which are answered early, also count towards the limit."""
    line, count = b"GET /health HTTP/1.1\r\nHost: 127.0.0.1\r\nExpect: more\r\n\r\n", 4000
    async with running() as cell:
        reader, writer = await connect(cell, "127.0.0.9")
        writer.write(line * count)
        answers = b""
        with contextlib.suppress(ConnectionError):
            while chunk := await reader.read(1 << 16):
                answers += chunk
        assert 0 < answers.count(b"HTTP/1.1 417 ") < count
        writer.close()


@pytest.mark.parametrize("coding", ["deflate", "gzip", "br"])
async def test_a_compressed_body_is_not_unpacked(coding: str) -> None:
    """It is refused with 415, as unpacking could use megabytes before the log-in."""
    async with running() as cell:
        form = zlib.compress(urlencode({"name": "Vera", "password": PASSWORD}).encode())
        headers = {
            "Origin": cell.origin,
            "Content-Encoding": coding,
            "Content-Type": "application/x-www-form-urlencoded",
        }
        async with cell.session.post("/login", data=form, headers=headers, allow_redirects=False) as answer:
            assert 415 == answer.status
        assert {} == cell.cookies()


async def test_a_request_without_a_host_asks_no_name_server(monkeypatch: pytest.MonkeyPatch) -> None:
    """Requests without a host, as from a load balancer, are answered without a DNS look-up."""
    asked = list[tuple[str, ...]]()
    monkeypatch.setattr("socket.getfqdn", lambda *names: asked.append(names) or "cellpc")
    async with running() as cell:
        for line, expected in (
            (b"GET /health HTTP/1.0\r\n\r\n", b"503"),
            (b"POST /login HTTP/1.0\r\nOrigin: http://\r\nContent-Length: 0\r\n\r\n", b"403"),
        ):
            reader, writer = await connect(cell, "127.0.0.9", line)
            assert (await reader.readline()).split()[1] in (expected, b"200")
            writer.close()
    assert [] == asked


@pytest.mark.slow
async def test_handshakes_of_one_address_keep_nobody_out(tmp_path: Path) -> None:
    """Beside two hundred connections that wait for TLS, one from another address is served."""
    make_certificates(tmp_path)
    certificate, key = tmp_path / "server.pem", tmp_path / "server.key"
    settings = WebSettings(port=0, password_hash=HASH, certificate=certificate, key=key)

    web = WebPublisher("cell1", settings, FixedSources(rectification=lambda: pytest.fail("no picture")))
    await web.start()
    trusting = ssl.create_default_context(cafile=str(tmp_path / "ca.pem"))
    place = f"https://127.0.0.1:{web.port}/login"
    lines = [
        await asyncio.open_connection("127.0.0.1", web.port, local_addr=("127.0.0.9", 0)) for _ in range(200)
    ]
    async with aiohttp.ClientSession() as session, session.get(place, ssl=trusting) as answer:
        assert 200 == answer.status
    shut(lines)
    await web.close()
