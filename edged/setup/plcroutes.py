"""Routes of the PLC: its exchanges with the cell, and the source code of clients."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Protocol

from aiohttp import web

from edged.adapters.web.routes import Answer, Call, route
from edged.identity.visitors import Role
from edged.link.summary import CellSummary
from edged.plc.exchangelog import Exchange
from edged.plc.registers import ADDRESS, constant_values
from edged.robot.orientations import Convention
from edged.robots.formats import DOWNLOADS, written
from edged.setup.draftroutes import unknown

EPOCH = (2026, 1, 1, 0, 0, 0)
"""Fixed time of files in archives, so that the same source gives the same archive."""


class RungDocument(Answer):
    """One step of an exchange; see `edged.plc.exchangelog.ExchangeStep`. by : "plc" or "cell"."""

    after_ms: float
    by: str
    what: str
    detail: str
    valid: bool


class ExchangeDocument(Answer):
    """A command and its outcome. hint : "bytes" or "words" if the client seems to swap them, or null."""

    number: int
    at: str
    client: str
    sequence: int
    code: int
    command: str
    job: int
    hint: str | None
    times: int
    rungs: list[RungDocument]


class Exchanges(Answer):
    """Exchanges, newest first."""

    exchanges: list[ExchangeDocument]


class ProbeDocument(Answer):
    """A register with a known value. address : to be used by the client, including the base address."""

    name: str
    address: int
    value: float


class ClientDocument(Answer):
    """Source code of a client that can be downloaded."""

    kind: str
    file: str


class PlcDocument(Answer):
    """How PLCs reach the cell. listening : Modbus is on; otherwise its other fields are unset."""

    listening: bool
    host: str | None = None
    port: int | None = None
    unit_id: int | None = None
    word_order: str | None = None
    base_address: int | None = None
    convention: str | None = None
    connected: int = 0
    owner: str | None = None
    refused: list[str] = []  # noqa: RUF012  (pydantic copies it)
    probes: list[ProbeDocument] = []  # noqa: RUF012  (likewise)
    clients: list[ClientDocument]


class PlcSide(Protocol):
    """The cell's side of the connection to PLCs."""

    @property
    def summary(self) -> CellSummary:
        """State of the cell."""

    async def exchanges(self) -> Sequence[Exchange]:
        """The last commands and their outcome, newest first. Raises `LinkError`."""


class PlcRoutes:
    """Routes of the PLC."""

    def __init__(self, cell: PlcSide) -> None:
        self._cell = cell

    @route("GET", "/plc", "How PLCs reach the cell", role=Role.VIEWER)
    async def _plc(self, _call: Call[None]) -> PlcDocument:
        now = self._cell.summary.plc
        clients = [ClientDocument(kind=kind, file=file) for kind, file in DOWNLOADS.items()]
        if now is None:
            return PlcDocument(listening=False, clients=clients)
        known = constant_values(Convention[now.convention.upper()], 0, 0)
        return PlcDocument(
            listening=True,
            host=now.host,
            port=now.port,
            unit_id=now.unit_id,
            word_order=now.word_order,
            base_address=now.base_address,
            convention=now.convention,
            connected=now.connected,
            owner=now.owner or None,
            refused=list(now.refused),
            probes=[
                ProbeDocument(name=name, address=now.base_address + ADDRESS[name], value=known[name])
                for name in ("MAGIC", "MAP_VERSION", "PROBE_U32", "PROBE_F32")
            ],
            clients=clients,
        )

    @route(
        "GET",
        "/plc/exchanges",
        "The last commands of PLC or robot, and what became of them",
        role=Role.VIEWER,
        is_by_itself=True,
    )
    async def _exchanges(self, _call: Call[None]) -> Exchanges:
        return Exchanges(exchanges=[_document(exchange) for exchange in await self._cell.exchanges()])

    @route(
        "GET",
        "/plc/clients/{kind:[a-z0-9]{2,20}}",
        "The source of a client: structured text, URScript, Python and others",
        role=Role.VIEWER,
        answer="application/octet-stream",
    )
    async def _client(self, call: Call[None]) -> web.Response:
        kind = call.part("kind")
        if kind not in DOWNLOADS:
            raise unknown()
        files = written(kind)
        data = _packed(files) if len(files) > 1 else "".join(files.values()).encode()
        headers = {"Content-Disposition": f'attachment; filename="{DOWNLOADS[kind]}"'}
        return web.Response(body=data, content_type="application/octet-stream", headers=headers)


def _document(exchange: Exchange) -> ExchangeDocument:
    at = datetime.fromtimestamp(exchange.began_ns / 1e9, UTC)
    rungs = [
        RungDocument(
            **asdict(rung),
            after_ms=round(1e3 * rung.after_s, 1),
            by="plc" if rung.what in ("command", "acknowledged", "taken_down") else "cell",
        )
        for rung in exchange.rungs
    ]
    fields = {**asdict(exchange), "hint": exchange.hint or None, "rungs": rungs}
    return ExchangeDocument(**fields, at=at.isoformat(timespec="milliseconds"), command=exchange.command)


def _packed(files: dict[str, str]) -> bytes:
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(zipfile.ZipInfo(name, EPOCH), text, zipfile.ZIP_DEFLATED)
    return data.getvalue()
