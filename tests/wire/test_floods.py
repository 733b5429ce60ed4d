"""Clients that flood the page are disconnected, and the PLC beside them gets every answer."""

from __future__ import annotations

import asyncio
import contextlib
import struct
import sys
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from helpers.waiting import WHOLE_S
from helpers.webcell import Cell, running

from edged.adapters.modbus import ModbusSettings
from edged.adapters.web.sockets import OF_SESSION
from edged.plc.registers import ADDRESS

FLOODER = Path(__file__).parents[1] / "helpers" / "flooder.py"
COMMANDS = 12
PATIENCE_S = 5.0
"""Longest wait of the PLC for one command."""
TABS, LINES = 8, 16


@asynccontextmanager
async def flood(
    cell: Cell, kind: str, connections: int, *sessions: Mapping[str, str]
) -> AsyncIterator[list[int]]:
    """Flood the page within the context. Yields a list that receives the number of closed connections."""
    cookies = ["; ".join(f"{name}={value}" for name, value in session.items()) for session in sessions]
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, str(FLOODER), str(cell.web.port), kind, str(connections), *cookies),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    closed: list[int] = []
    try:
        assert b"flooding\n" == await process.stdout.readline()
        yield closed
        process.stdin.close()
        closed.append(int(await process.stdout.readline()))
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.communicate()


async def answered(port: int) -> int:
    """Number of a PLC's commands that get their result before its patience ends."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)

    async def ask(pdu: bytes, size: int) -> bytes:
        writer.write(struct.pack(">HHHB", 1, 0, len(pdu) + 1, 1) + pdu)
        return await reader.readexactly(size)

    async def command(sequence: int) -> None:
        await ask(struct.pack(">BHHB3H", 16, ADDRESS["COMMAND"], 3, 6, 1, 0, sequence), 12)
        while sequence != struct.unpack(">H", (await ask(struct.pack(">BHH", 3, 300, 1), 11))[9:])[0]:  # noqa: ASYNC110  (a PLC polls)
            await asyncio.sleep(0.005)

    await ask(struct.pack(">BHH", 6, ADDRESS["CMD_SEQ"], 0), 12)  # the first of a connection runs nothing
    count = 0
    for sequence in range(1, COMMANDS + 1):
        try:
            async with asyncio.timeout(PATIENCE_S):
                await command(sequence)
        except TimeoutError:
            break
        count += 1
    writer.close()
    return count


def beside(kind: str, connections: int) -> tuple[int, int]:
    """PLC commands answered, and floods closed; a logged-in user can still use the page."""

    async def bounded() -> tuple[int, int]:
        async with asyncio.timeout(WHOLE_S), running(modbus=ModbusSettings(port=0)) as cell:
            assert cell.modbus is not None
            sessions = [await cell.log_in_anew("Vera") for _ in range(TABS // OF_SESSION)]
            strangers = [{}] if kind == "requests" else sessions
            async with flood(cell, kind, connections, *strangers) as closed:
                count = await answered(cell.modbus.port)
            cell.use(sessions[0])
            if kind == "requests":
                assert 200 == (await cell.ask("GET", "/api/v1/me"))[0]
            return count, closed[0]

    return asyncio.run(bounded())


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pings", "pongs", "messages", "fragments"])
def test_tabs_that_flood_are_closed_and_the_plc_is_answered(kind: str) -> None:
    """Floods of any frame type from a logged-in viewer are closed, also fragments of an endless message."""
    assert (COMMANDS, TABS) == beside(kind, TABS)


@pytest.mark.slow
def test_requests_without_end_are_closed_and_the_plc_is_answered() -> None:
    """Floods of pipelined requests without a session are closed, and a logged-in user is still served."""
    assert (COMMANDS, LINES) == beside("requests", LINES)
