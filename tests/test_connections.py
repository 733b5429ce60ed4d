"""A listening port: clients count at once, and none can block others or fill the log."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import subprocess
import sys

import pytest
from helpers.waiting import LIMIT_S, WHOLE_S, until

from edged.connections import Rate, Rates, TcpClient, TcpListener

FEW_DESCRIPTORS = """
import asyncio, logging, resource, sys
from edged.connections import TcpListener

class Echo(asyncio.Protocol):
    def connection_made(self, transport):
        self.transport = transport
    def data_received(self, data):
        self.transport.write(data)

async def main():
    listener = TcpListener("echo", lambda client: Echo(), lambda client: True, idle_s=600)
    await listener.open("127.0.0.1", 0)
    resource.setrlimit(resource.RLIMIT_NOFILE, (32, 32))
    print(listener.port, flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    await listener.close()

logging.basicConfig()
asyncio.run(main())
"""


def run(test) -> None:
    """Run a test's coroutine with a time limit."""

    async def bounded() -> None:
        async with asyncio.timeout(LIMIT_S):
            await test()

    asyncio.run(bounded())


async def connect(listener: TcpListener) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """A connection to a listener."""
    return await asyncio.open_connection("127.0.0.1", listener.port)


@pytest.mark.slow
def test_without_descriptors_the_log_stays_short_and_who_waits_gets_in_later() -> None:
    """With a hundred connections and thirty file descriptors there is one line of log, and later
    connections are served."""
    command = [sys.executable, "-W", "error", "-c", FEW_DESCRIPTORS]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    port = int(process.stdout.readline())
    many = [socket.create_connection(("127.0.0.1", port)) for _ in range(100)]
    try:
        many[0].settimeout(LIMIT_S)
        many[0].sendall(b"first")
        assert b"first" == many[0].recv(5)
        with socket.create_connection(("127.0.0.1", port), LIMIT_S) as last:
            last.sendall(b"last")
            for one in many:
                one.close()
            assert b"last" == last.recv(4)
    finally:
        for one in many:
            one.close()
        _, log = process.communicate(timeout=WHOLE_S)

    assert ["echo: nobody can connect: Too many open files"] == [
        line.partition("edged.connections:")[2] for line in log.splitlines()
    ]
    assert 0 == process.returncode


async def test_a_client_counts_until_it_is_aborted_and_is_forgotten_once() -> None:
    """A client counts until it is aborted or ends, and its end is reported once; a refused one never
    counts."""
    left: list[TcpClient] = []
    listener = TcpListener(
        "test",
        lambda _: asyncio.Protocol(),
        lambda _: len(listener.clients) < 2,
        left.append,
        idle_s=600,
    )
    await listener.open("localhost", 0)
    ends = [await connect(listener) for _ in range(3)]
    assert b"" == await ends[2][0].read()
    first, second = listener.clients
    first.abort()
    assert (second,) == listener.clients
    assert [first] == left
    assert b"" == await ends[0][0].read()
    ends[1][1].close()
    await until(lambda: not listener.clients)
    for _, writer in ends:
        writer.close()
    await listener.close()
    assert [first, second] == left


async def test_a_client_that_is_busy_is_not_idle() -> None:
    """A busy client is not ended as idle; an idle one is."""
    listener = TcpListener("test", lambda _: asyncio.Protocol(), lambda _: True, idle_s=0.2)
    await listener.open("127.0.0.1", 0)
    (busy_reader, busy), (idle_reader, idle) = await connect(listener), await connect(listener)
    await until(lambda: len(listener.clients) == 2)
    listener.client(busy.get_extra_info("sockname")).touch(busy=True)
    assert b"" == await idle_reader.read()
    (left,) = listener.clients
    assert busy.get_extra_info("sockname") == left.name
    await listener.close()
    assert b"" == await busy_reader.read()
    for writer in (busy, idle):
        writer.close()


def test_a_rate_is_so_many_a_second() -> None:
    """The rate allows this many calls at once, and further ones in their share of a second."""
    now_s = 0.0
    rate = Rate(4, lambda: now_s)
    assert [True] * 4 + [False] * 2 == [rate.take() for _ in range(6)]
    now_s = 0.5
    assert [True, True, False] == [rate.take() for _ in range(3)]
    now_s = 1000.0
    assert [True] * 4 + [False] == [rate.take() for _ in range(5)]


async def test_a_client_that_sends_more_than_it_may_is_ended() -> None:
    """A client that sends more than allowed is ended; one without a limit is not, and all of its data
    arrive."""
    heard: dict[str, int] = {"limited": 0, "free": 0}

    class Ear(asyncio.Protocol):
        def __init__(self, name: str) -> None:
            self.name = name

        def data_received(self, data: bytes) -> None:
            heard[self.name] += len(data)

    names = iter(heard)
    listener = TcpListener("test", lambda _: Ear(next(names)), lambda _: True, idle_s=600)
    await listener.open("127.0.0.1", 0)
    reader, limited = await connect(listener)
    await until(lambda: len(listener.clients) == 1 and listener.clients[0].is_in)
    (client,) = listener.clients
    client.limit(1.0, 1000.0)
    _, free = await connect(listener)
    limited.write(bytes(900))
    await until(lambda: heard["limited"] == 900)
    assert not client.has_flooded
    limited.write(bytes(200))
    with contextlib.suppress(ConnectionError):
        assert b"" == await reader.read()
    assert client.has_flooded
    free.write(bytes(1_000_000))
    await until(lambda: heard["free"] == 1_000_000)
    assert 900 == heard["limited"]
    for writer in (limited, free):
        writer.close()
    await listener.close()


def test_a_rate_is_of_each_and_can_be_forfeited() -> None:
    """Each rate is separate, and a forfeited one recovers with time."""
    now_s = [0.0]
    rate = Rate(10.0, lambda: now_s[0], burst=20.0)
    assert rate.take(20)
    assert not rate.take()
    now_s[0] = 1.0
    rate.forfeit(5.0)
    now_s[0] = 6.0
    assert not rate.take()
    now_s[0] = 6.2
    assert rate.take()

    rates = Rates(1.0, 2.0, most=2)
    assert [True, True, False] == [rates.of("one").take() for _ in range(3)]
    assert rates.of("other").take()
    assert not rates.of("one").take()
    assert rates.of("third").take()  # and "other" is forgotten
    assert not rates.of("one").take()
