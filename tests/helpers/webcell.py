"""A cell in memory with its page, and a browser session that uses /api/v1."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import aiohttp
import pytest
from argon2 import PasswordHasher

from edged.adapters.modbus import ModbusPublisher, ModbusSettings
from edged.adapters.web import SettingUp, WebPublisher, WebSettings
from edged.app.cellservice import plc_now
from edged.cell.cycle import Cycle
from edged.domain.overview import Overview
from edged.identity.users import RoleName, User, UserFile
from edged.link.summary import CellSummary
from edged.plc.exchangelog import Exchange
from edged.setup.plcroutes import PlcRoutes
from helpers.browsersession import PASSWORD, BrowserSession, browsing
from helpers.pagesources import FixedSources
from helpers.scriptedhead import Ear, Head, make_setup

HASH = PasswordHasher(time_cost=1, memory_cost=512, parallelism=1).hash(PASSWORD)
"""Cheap to check, as many tests log in."""
USERS: dict[str, RoleName] = {"Anna": "engineer", "Ben": "engineer", "Otto": "operator", "Vera": "viewer"}
"""Users and their roles, all with the same password."""


class PlcBeside:
    """The Modbus server beside a page in one process (`edged.setup.plcroutes.PlcSide`)."""

    def __init__(self, modbus: ModbusPublisher) -> None:
        self._modbus = modbus

    @property
    def summary(self) -> CellSummary:
        """Summary of the server alone."""
        return CellSummary(plc=plc_now(self._modbus))

    async def exchanges(self) -> Sequence[Exchange]:
        """Exchanges of the server."""
        return self._modbus.exchanges


class Cell(BrowserSession):
    """A cycle with its page, and a browser session."""

    def __init__(
        self,
        cycle: Cycle,
        web: WebPublisher,
        head: Head,
        ear: Ear,
        session: aiohttp.ClientSession,
        asleep_s: list[float],
        state: Path,
    ) -> None:
        super().__init__(session)
        self.cycle, self.web, self.head, self.ear, self.state = cycle, web, head, ear, state
        self.asleep_s = asleep_s
        self.plant = Overview()
        self.modbus: ModbusPublisher | None = None
        self.runs_by = ""

    def sleep(self, seconds: float) -> None:
        """Let this much time pass without activity."""
        self.asleep_s[0] += seconds


@asynccontextmanager
async def running(
    *,
    commissioning: bool = True,
    users: Mapping[str, RoleName] | None = USERS,
    modbus: ModbusSettings | None = None,
    is_open: bool = False,
    visitor: str | None = None,
) -> AsyncIterator[Cell]:
    """A cell with a head in memory, its page on a free port, and a browser's session with it.

    users : None: the user file is invalid. modbus : also serve Modbus, with its page. is_open : viewing needs
    no password. visitor : logged-in user; "" with the page's password alone.
    """
    ear = Ear()
    with TemporaryDirectory() as folder:
        state = Path(folder)
        if users is None:
            (state / "users.json").write_text("{")
        for name, role in (users or {}).items():
            UserFile(state / "users.json").put(User(name=name, role=role, password_hash=HASH))
        seen = list[Cell]()
        head = Head()
        cycle = Cycle(head, make_setup())
        sources = FixedSources(
            rectification=lambda: pytest.fail("no cycle has made a picture"),
            overview=lambda: seen[0].plant if seen else Overview(),
            fingerprint=lambda: seen[0].runs_by if seen else "",
        )
        password_hash = "" if is_open else HASH
        settings = WebSettings(port=0, password_hash=password_hash, commissioning=commissioning, state=state)
        asleep_s = [0.0]
        plc = None if modbus is None else ModbusPublisher(modbus, cycle)
        web = WebPublisher(
            "cell1",
            settings,
            sources,
            setup=SettingUp(cycle.session, routes=[] if plc is None else [PlcRoutes(PlcBeside(plc))]),
            clock_s=lambda: time.monotonic() + asleep_s[0],
        )
        await web.start()
        if plc is not None:
            await plc.start()
        cycle.set_publishers([ear, web, *([] if plc is None else [plc])])
        task = asyncio.create_task(cycle.run())
        try:
            async with browsing(f"http://127.0.0.1:{web.port}") as session:
                cell = Cell(cycle, web, head, ear, session, asleep_s, state)
                cell.modbus = plc
                seen.append(cell)
                if visitor is not None:
                    await cell.log_in(visitor)
                yield cell
        finally:
            cycle.stop()
            await task
            await web.close()
            if plc is not None:
                await plc.close()
