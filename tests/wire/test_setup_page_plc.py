"""The PLC and go-live page: exchanges, swapped words, client sources, and READY."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from helpers.browser import Browser, browser
from helpers.browsersession import PASSWORD
from helpers.needs import needs
from helpers.setuppage import DIALOG, SMALL_TARGETS, TOO_WIDE, UNTRANSLATED, go, log_in, press, said, take
from helpers.waiting import until
from helpers.webcell import Cell, running

from edged.adapters.modbus import ModbusPublisher, ModbusSettings
from edged.domain.cell import CellPhase
from edged.plc.registers import MAP_VERSION, WordOrder
from edged.robots.formats import DOWNLOADS, FORMATS, written

pytestmark = pytest.mark.slow
CLIENT = 4711
"""A client number without a connection, as OPC UA uses."""


@asynccontextmanager
async def beside(order: WordOrder = "high") -> AsyncIterator[tuple[Cell, ModbusPublisher]]:
    """A cell that serves Modbus."""
    async with running(modbus=ModbusSettings(port=0, word_order=order)) as cell:
        assert cell.modbus is not None
        await until(lambda: cell.ear.state() is CellPhase.READY)
        yield cell, cell.modbus


async def command(cell: Cell, modbus: ModbusPublisher, sequence: int, code: int = 1) -> dict[str, Any]:
    """Write a command; returns its ladder when it has ended."""
    modbus.write(CLIENT, {"COMMAND": code, "JOB": 0, "CMD_SEQ": sequence})
    ends = ("ack", "nack")
    await until(lambda: modbus.exchanges[0].rungs[-1].what in ends)
    return dict((await cell.ask("GET", "/api/v1/plc/exchanges", None))[1]["exchanges"][0])


async def test_exchanges_and_client_sources_are_told_as_they_are() -> None:
    """Two commands are reported as they were, and each source is what `edged registers` prints, zipped if
    several."""
    async with beside() as (cell, modbus):
        await cell.log_in("Vera")
        modbus.write(CLIENT, {"CMD_SEQ": 0})
        right, wrong = await command(cell, modbus, 5), await command(cell, modbus, 6, 99)
        assert ("", 99, 6) == (wrong["command"], wrong["code"], wrong["sequence"])
        assert [("plc", "command", ""), ("cell", "nack", "UNKNOWN_COMMAND")] == [
            (rung["by"], rung["what"], rung["detail"]) for rung in wrong["rungs"]
        ]
        assert ["command", "exposure", "result", "ack"] == [rung["what"] for rung in right["rungs"]]
        assert ("LOCATE", "NO_TARGET", None) == (
            right["command"],
            right["rungs"][2]["detail"],
            right["hint"],
        )
        status, plc = await cell.ask("GET", "/api/v1/plc", None)
        assert (200, True, modbus.port, "high") == (status, plc["listening"], plc["port"], plc["word_order"])
        assert {one["kind"]: one["file"] for one in plc["clients"]} == DOWNLOADS
        assert {"md", "json"} == set(FORMATS) - set(DOWNLOADS)
        for kind in DOWNLOADS:
            async with cell.session.get(f"/api/v1/plc/clients/{kind}") as answer:
                assert DOWNLOADS[kind] in answer.headers["Content-Disposition"]
                data = await answer.read()
            if len(written(kind)) > 1:
                with zipfile.ZipFile(io.BytesIO(data)) as archive:
                    files = {name: archive.read(name).decode() for name in archive.namelist()}
                assert written(kind) == files
            else:
                assert {DOWNLOADS[kind]: data.decode()} == written(kind)
        async with cell.session.get("/api/v1/plc/clients/cobol") as answer:
            assert 404 == answer.status


def swapped(value: int, words: bool, octets: bool) -> int:
    """A 32-bit value as read by a client that swaps words or bytes."""
    pair = struct.unpack(">2H", struct.pack(">I", value))
    pair = tuple(((word & 255) << 8) | word >> 8 for word in pair) if octets else pair
    return int.from_bytes(struct.pack(">2H", *(pair[::-1] if words else pair)), "big")


@pytest.mark.long
@needs("chromium")
async def test_the_page_tells_what_is_swapped_shows_the_ladder_and_gives_the_cell_back() -> None:
    """Swapped words, swapped bytes and an address off by one are named, READY returns, the last commands are
    listed as they come, and nothing is cut off."""
    async with beside() as (cell, modbus), browser() as page:
        await log_in(page, cell.origin, "Anna", PASSWORD, "/setup", (1280, 900))
        await take(page)
        await go(page, "plc")
        await page.until(said("How the PLC reaches the cell"))
        assert await page.value(said("You have the cell: READY comes when you give it back."))
        await check_probes(page)

        await press(page, "Give the cell back: READY")
        await page.until(DIALOG)
        await page.click("dialog[open] .primary")
        await page.until(said("The cell is READY: it measures for the plant."))
        modbus.write(CLIENT, {"CMD_SEQ": 0})
        modbus.write(CLIENT, {"COMMAND": 256, "JOB": 0, "CMD_SEQ": 8})
        await page.until(said("The bytes are swapped"))
        modbus.write(CLIENT, {"COMMAND": 1, "JOB": 0, "CMD_SEQ": 9})
        await page.until(said("EXPOSURE_DONE: the robot may leave the picture"))
        await page.until(said("result: no part found."))
        assert [] == await page.violations()
        assert [] == await page.value(SMALL_TARGETS)

        await page.open(f"{cell.origin}/setup?pseudo#/plc", 360, 740)
        await page.until('document.querySelectorAll(".plc-exchanges details").length === 2')
        assert [] == await page.value(UNTRANSLATED)
        assert 0 == await page.value(TOO_WIDE)
        assert [] == page.complaints


async def check_probes(page: Browser) -> None:
    """Check the text for each value that a PLC may show."""
    u32 = 0x01020304
    shown = {
        str(u32): "Right: words",
        hex(u32): "Right: words",
        str(swapped(u32, words=True, octets=False)): "choose low word first below",
        str(swapped(u32, words=False, octets=True)): "The two bytes of each word are swapped",
        str(swapped(u32, words=True, octets=True)): "Bytes and words are both swapped",
        str(0x030442F6): "The address is one too high",
        str(MAP_VERSION << 16 | 0x0102): "The address is one too low",
        str(0x0102): "That is one word of two",
        "12": "That is something else",
        "abc": "A number, such as",
    }
    for text, sentence in shown.items():
        await page.type("[name=shows]", text)
        await page.until(said(sentence))
    await page.choose("[name=probe]", "PROBE_F32")
    (whole,) = struct.unpack(">I", struct.pack(">f", 123.456))
    (other,) = struct.unpack(">f", struct.pack(">I", swapped(whole, words=True, octets=False)))
    for text, sentence in {"123,456": "Right: words", repr(other): "The words are swapped"}.items():
        await page.type("[name=shows]", text)
        await page.until(said(sentence))
