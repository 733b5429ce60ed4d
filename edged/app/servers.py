"""Starts and replaces the servers of a configuration: Modbus, OPC UA, Zenoh, recorder, web page, ...

A cell without Zenoh or OPC UA does not import them, as each takes a tenth of the start. The page has its own
process.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import logging
import sys
from collections.abc import Callable, Mapping
from functools import partial

from edged.adapters.enip import EnipPublisher
from edged.adapters.history import CycleHistory
from edged.adapters.modbus import ModbusPublisher, server_context
from edged.adapters.plcmemory import PlcMemoryPublisher, make_memory
from edged.adapters.recorder import Recorder
from edged.app.running import Running
from edged.app.unprivileged import UNPRIVILEGED_PREFIX, environment
from edged.app.wantedservers import (
    WantedServer,
    ethernetip_settings,
    modbus_settings,
    opcua_settings,
    wanted_servers,
    zenoh_settings,
)
from edged.config.cell import HistorySection, RecorderSection
from edged.config.configuration import Config
from edged.config.plc import PlcSection
from edged.config.servers import EthernetIpSection, ModbusSection, OpcUaSection, WebSection
from edged.config.zenoh import ZenohSection
from edged.connections import tls_with
from edged.errors import EdgedError, ListenError, TookTooLong
from edged.ports import Publisher

log = logging.getLogger(__name__)

START_S = 10.0
"""Limit for starting one server while the cell waits. The slowest is OPC UA, which builds its address space
first: `python -m pytest tests/wire/test_opcua.py --durations 3`."""
LATE_START_S = 60.0
"""Limit for starting one while the cell measures: longer than any server's own limit (OPC UA 30 s)."""
CLOSE_S = 5.0
"""Limit for closing one server; OPC UA's own limit is 3 s."""
RETRY_S = 5.0


def import_servers(config: Config) -> None:
    """Import the modules that a configuration's servers need.

    Part of the work, such as reading certificates, is not Python, so it gains from a thread of its own.
    """
    wanted = {"zenoh": config.zenoh.enabled, "opcua": config.opcua is not None}
    if config.plc is not None:
        wanted[f"plcmemory.{config.plc.family}"] = True
    for name in (name for name, asked in wanted.items() if asked):
        with contextlib.suppress(ImportError):  # the server itself reports its missing package
            importlib.import_module(f"edged.adapters.{name}")


Build = Callable[[], Publisher]
"""Builds a server from what has been read before, without reading any file."""


async def start_within(limit_s: float, publisher: Publisher, what: str) -> None:
    """Start a publisher; close it if that fails. Raises `TookTooLong` that names it."""
    try:
        async with asyncio.timeout(limit_s):
            await publisher.start()
    except BaseException as error:
        await close_within(publisher, what)
        if isinstance(error, TimeoutError):
            why = str(error) or f"it has not started within {limit_s:g} s"
            raise TookTooLong(f"{what}: {why}") from error
        raise


async def close_within(publisher: Publisher, what: str) -> None:
    """Close a publisher; one that hangs is abandoned with a warning in the log."""
    try:
        async with asyncio.timeout(CLOSE_S):
            await publisher.close()
    except TimeoutError:
        log.warning("%s: it has not closed within %g s, and is abandoned", what, CLOSE_S)


class Servers:
    """The publishers that a configuration asks for.

    running : the cell, whose `servers` and `problems` are kept up to date. changed : called whenever the set
    of running servers may have changed after the start. page : makes the page of a cell, given its name.
    """

    def __init__(
        self, running: Running, changed: Callable[[], None], page: Callable[[str, WebSection], Publisher]
    ) -> None:
        self._running = running
        self._started = running.servers
        self._problems = running.problems
        self._changed = changed
        self._page = page
        self._wanted: dict[str, tuple[WantedServer, Build]] = {}  # for running servers
        self._failing: dict[str, tuple[WantedServer, Build]] = {}
        self._trying: asyncio.Task[None] | None = None

    @property
    def started(self) -> Mapping[str, Publisher]:
        """Running servers, by the name of their section."""
        return self._started

    @property
    def problems(self) -> Mapping[str, str]:
        """Why servers could not start, by the name of their section; they are retried."""
        return self._problems

    async def start(self, config: Config) -> None:
        """Start all wanted servers; one that takes too long is retried while the cell measures.

        Raises `ListenError` for one that cannot start, so that the person who started the cell sees it and
        systemd restarts it. Those started before it keep running.
        """
        for name, wanted in wanted_servers(config).items():
            build = self._builder(wanted)
            try:
                await self._start(name, wanted, build)
            except TookTooLong as error:
                self._note_failing(name, (wanted, build), str(error))
        self._try_again_later()

    async def exchange(self, config: Config) -> None:
        """Replace servers whose settings or files have changed; on failure keep all as before, and raise.

        Files are read and checked before any server is touched. A server that moves to another port is
        started beside the running one. If one still cannot start, those replaced before it are restored with
        their old settings and files. One that could not start before and whose settings are unchanged is
        retried later.
        """
        wanted = await asyncio.to_thread(wanted_servers, config)
        await self._try_no_more()
        try:
            await self._exchange(wanted)
        finally:
            self._try_again_later()

    async def _exchange(self, wanted: dict[str, WantedServer]) -> None:
        before = {name: wanted for name, (wanted, _) in {**self._failing, **self._wanted}.items()}
        changed = [name for name in {**before, **wanted} if before.get(name) != wanted.get(name)]
        new = {name: (wanted[name], self._builder(wanted[name])) for name in changed if name in wanted}
        old, exchanged = dict(self._wanted), list[str]()
        try:
            for name in changed:
                exchanged.append(name)
                await self._restart(name, new.get(name))
        except (EdgedError, OSError):
            for name in reversed(exchanged):
                await self._put_back(name, old.get(name))
            raise
        for name in changed:
            self._forget_failing(name)

    async def close(self) -> None:
        """Close all servers."""
        await self._try_no_more()
        for name, publisher in self._started.items():
            await close_within(publisher, name)

    async def _restart(self, name: str, new: tuple[WantedServer, Build] | None) -> None:
        try:
            running = self._wanted.get(name)
            if new is not None and running is not None and _can_coexist(running[0], new[0]):
                before = self._started[name]
                await self._start(name, *new)
                await close_within(before, f"{name} on {running[0].place}")
                return
            if running is not None:
                del self._wanted[name]
                await close_within(self._started.pop(name), f"{name} on {running[0].place}")
            if new is not None:
                await self._start(name, *new)
        finally:
            self._changed()

    async def _put_back(self, name: str, old: tuple[WantedServer, Build] | None) -> None:
        if self._wanted.get(name) == old:
            return
        try:
            await self._restart(name, old)
        except (EdgedError, OSError) as error:
            # its port was taken meanwhile; the others must still be restored
            if old is not None:
                self._note_failing(name, old, str(error))

    async def _start(self, name: str, wanted: WantedServer, build: Build, limit_s: float = 0.0) -> None:
        publisher = build()
        await start_within(limit_s or START_S, publisher, f"{name} on {wanted.place}")
        self._started[name], self._wanted[name] = publisher, (wanted, build)

    # --- servers that cannot start now -------------------------------------------------------------

    def _note_failing(self, name: str, failing: tuple[WantedServer, Build], why: str) -> None:
        self._failing[name], self._problems[name] = failing, why
        log.error("%s; the cell runs without it, and tries again every %g s", why, RETRY_S)

    def _forget_failing(self, name: str) -> None:
        self._failing.pop(name, None)
        self._problems.pop(name, None)

    def _try_again_later(self) -> None:
        if self._failing and self._trying is None:
            self._trying = asyncio.create_task(self._try_again(), name="servers")
            self._trying.add_done_callback(_show_bug)

    async def _try_no_more(self) -> None:
        task, self._trying = self._trying, None
        if task is not None:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    async def _try_again(self) -> None:
        while self._failing:
            await asyncio.sleep(RETRY_S)
            for name, (wanted, build) in list(self._failing.items()):
                try:
                    await self._start(name, wanted, build, LATE_START_S)
                except (EdgedError, OSError) as error:
                    if str(error) != self._problems[name]:
                        self._note_failing(name, (wanted, build), str(error))
                    continue
                self._forget_failing(name)
                log.info("%s on %s: started after all", name, wanted.place)
                self._changed()
        self._trying = None

    def _builder(self, wanted: WantedServer) -> Build:
        """Read a server's files and return its builder. Raises `EdgedError`, `OSError` for unusable files."""
        running, section = self._running, wanted.section
        match section:
            case ModbusSection():
                modbus = modbus_settings(section)
                context = None if modbus.tls is None else server_context(modbus.tls)
                return partial(ModbusPublisher, modbus, running.cycle, context=context, jobs=running.jobs)
            case ZenohSection():
                from edged.adapters.zenoh import ZenohPublisher, configured

                zenoh = zenoh_settings(section, wanted.cell)
                return partial(
                    ZenohPublisher,
                    zenoh,
                    None if section.commands == "refused" else running.cycle,
                    jobs=running.jobs,
                    config=running.config_summary,
                    session=configured(zenoh),
                )
            case RecorderSection():
                return partial(Recorder, section, running.recorded)
            case HistorySection():
                return _history_builder(section, wanted)
            case OpcUaSection():
                return self._opcua_builder(wanted, section)
            case PlcSection():
                return partial(PlcMemoryPublisher, section, running.modbus, make_memory(section))
            case EthernetIpSection():
                settings = ethernetip_settings(section, wanted.cell)
                return partial(EnipPublisher, settings, running.modbus, section.handshake)
            case WebSection():
                if section.certificate is not None and section.key is not None:
                    tls_with("status page", section.certificate, section.key)  # the page's process reads them
                return partial(self._page, wanted.cell, section)

    def _opcua_builder(self, wanted: WantedServer, section: OpcUaSection) -> Build:
        try:
            from edged.adapters.opcua import OpcUaPublisher, identity_of
        except ImportError as error:
            raise ListenError(
                f"opcua: needs another package: pip install 'edged[opcua]' ({error})"
            ) from error
        settings = opcua_settings(section, wanted)
        running, identity = self._running, identity_of(settings)
        return partial(OpcUaPublisher, settings, running.modbus, running.jobs, identity=identity)


def _history_builder(section: HistorySection, wanted: WantedServer) -> Build:
    """Return the builder of the history. Raises `ListenError` if the package that packs it is missing."""
    if importlib.util.find_spec("pyarrow") is None:
        raise ListenError("history: needs another package: pip install 'edged[history]'")
    program = [*UNPRIVILEGED_PREFIX, sys.executable, "-m", "edged.files.history.packing", str(section.folder)]
    program += [section.plant, wanted.cell, str(section.max_days), str(section.max_mib), section.bucket]
    if wanted.recordings is not None:
        program += [str(wanted.recordings), str(section.every_good), str(section.recordings_mib)]
    return partial(CycleHistory, section, wanted.cell, (program, environment()))


def _show_bug(trying: asyncio.Task[None]) -> None:
    """Log a bug in a retried server at once rather than when the daemon ends."""
    if not trying.cancelled() and (bug := trying.exception()) is not None:
        log.error("a server cannot be started because of a bug, and is not tried again", exc_info=bug)


def _can_coexist(first: WantedServer, second: WantedServer) -> bool:
    """Whether both can run at once: both ports are known and differ."""
    return None not in (first.port, second.port) and first.port != second.port
