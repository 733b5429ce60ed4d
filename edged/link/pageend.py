"""The page's end of the link: it sends requests, and gets answers and news in the order of the cell."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from collections.abc import AsyncIterator
from itertools import count
from typing import Any, NamedTuple

from edged.codec.plainerrors import error_of
from edged.errors import LinkError
from edged.link.pictures import Placed, SharedPictures
from edged.link.requests import GREETING, Asked, Envelope, encoded, greeting_of
from edged.link.stream import Frames, framed, send_within
from edged.link.values import CODEC, MOST_BYTES

READ_BYTES = 1024 * 1024
MOST_DESCRIPTORS = 16
ANSWER_S = 120.0
"""Time-out of an answer, longer than the cell takes for any request."""


class LinkNews(NamedTuple):
    """News from the cell. kind : "task", "files", "summary", "event" or "step"."""

    kind: str
    body: Any


class PageEnd:
    """The link to the cell. connection : a Unix stream socket, owned from now on.

    listening : sockets for the page to serve, which come with its task; the caller takes and closes them.
    """

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        self._connection = connection
        self._frames = Frames(MOST_BYTES)
        self._pictures = SharedPictures()
        self._memories: list[int] = []
        self._numbers = count(1)
        self._asked: dict[int, asyncio.Future[Any]] = {}
        self._writing = asyncio.Lock()
        self._is_over = False
        self.listening: list[socket.socket] = []

    async def greet(self) -> None:
        """Send this version, and read the cell's. Raises `LinkError` if it is another."""
        await self._write(encoded(GREETING))
        greeting_of(await self._message()).check("the cell")

    async def ask(self, request: Asked, memory: int | None = None) -> Any:
        """Ask the cell; return its answer. memory : sent with it. Raises its errors, and `LinkError`."""
        if self._is_over:
            raise LinkError("the cell is not reached")
        number = next(self._numbers)
        answer = self._asked[number] = asyncio.get_running_loop().create_future()
        try:
            await self._write(encoded(Envelope(number=number, request=request)), memory)
            async with asyncio.timeout(ANSWER_S):
                return await answer
        except TimeoutError as error:
            raise LinkError(f"the cell has not answered within {ANSWER_S:g} s") from error
        finally:
            self._asked.pop(number, None)

    async def news(self) -> AsyncIterator[LinkNews]:
        """Yield news from the cell until the link ends; answers are set once earlier news is handled."""
        try:
            while True:
                message = CODEC.decode(await self._message())
                self._take_sockets(message.get("sockets", 0))
                images: list[Any] = []
                if message.get("memory"):
                    self._pictures.map(self._memories.pop(0))
                if "pictures" in message:
                    images = self._pictures.copy(Placed(*message["pictures"]))
                body = CODEC.decode(message["body"], images)
                if message["kind"] != "answer":
                    yield LinkNews(message["kind"], body)
                    continue
                answer = self._asked.get(message["number"])
                if answer is None or answer.done():
                    continue
                if message["error"] is not None:
                    answer.set_exception(error_of(**message["error"]))
                else:
                    answer.set_result(body)
        except LinkError:
            return
        finally:
            self._end()

    def _take_sockets(self, count: int) -> None:
        for _ in range(count):
            opened = socket.socket(fileno=self._memories.pop(0))
            opened.setblocking(False)
            self.listening.append(opened)

    def close(self) -> None:
        """Close the link."""
        self._end()
        for opened in self.listening:
            opened.close()
        self.listening.clear()
        for memory in self._memories:
            os.close(memory)
        self._memories.clear()
        self._connection.close()

    def _end(self) -> None:
        self._is_over = True
        for answer in self._asked.values():
            if not answer.done():
                answer.set_exception(LinkError("the cell has stopped"))

    async def _write(self, data: bytes, memory: int | None = None) -> None:
        """Send a whole message, even if the caller is cancelled meanwhile."""
        own = None if memory is None else os.dup(memory)
        await asyncio.shield(asyncio.ensure_future(self._written(data, own)))

    async def _written(self, data: bytes, memory: int | None) -> None:
        async with self._writing:
            try:
                if memory is None:
                    await asyncio.get_running_loop().sock_sendall(self._connection, framed(data))
                else:
                    await asyncio.to_thread(send_within, self._connection, data, [memory], ANSWER_S)
            except OSError as error:
                raise LinkError(f"the cell is not reached: {error.strerror or error}") from error
            finally:
                if memory is not None:
                    os.close(memory)

    async def _message(self) -> bytes:
        """Read the next message. Raises `LinkError` when the link has ended."""
        while not self._frames.has_next():
            try:
                data, memories, _flags, _ = socket.recv_fds(
                    self._connection, READ_BYTES, MOST_DESCRIPTORS, socket.MSG_CMSG_CLOEXEC
                )
            except (BlockingIOError, InterruptedError):
                await self._readable()
                continue
            except OSError as error:
                raise LinkError(f"the cell is not reached: {error.strerror or error}") from error
            self._memories += memories
            if not data:
                raise LinkError("the cell has stopped")
            self._frames.feed(data)
        return self._frames.next()

    async def _readable(self) -> None:
        loop = asyncio.get_running_loop()
        is_readable: asyncio.Future[None] = loop.create_future()

        def wake() -> None:
            if not is_readable.done():
                is_readable.set_result(None)

        loop.add_reader(self._connection, wake)
        try:
            await is_readable
        finally:
            with contextlib.suppress(ValueError):
                loop.remove_reader(self._connection)
