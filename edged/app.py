"""The composition root: the only module that names adapters.

`load_cell` turns a configuration file into a measuring set-up (and finds every mistake in it);
`Daemon` connects cameras, loop and publishers, and exchanges parts of them on reload.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from edged.capture import StereoHead
from edged.config import CamerasSection, Config, fingerprint, load
from edged.cycle import Cycle, LoadedJob, Setup
from edged.domain import Frame, FramePair, Outcome
from edged.errors import ConfigError, EdgedError, UserError
from edged.jobs import load_job
from edged.pipeline import PreparedRig, locate, prepare
from edged.ports import Publisher
from edged.store import load_rig
from edged.vision.job import Job

log = logging.getLogger(__name__)

STOP_GRACE_S = 1.0
"""A running cycle may end; what takes longer is cancelled, so that a stop takes less than 2 s."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadedCell:
    """A configuration with the rig and the jobs it names."""

    config: Config
    setup: Setup
    jobs: tuple[Job, ...]


def load_cell(path: Path) -> LoadedCell:
    """Read configuration, rig and all jobs. Raises `ConfigError` with every mistake in them."""
    config = load(path)
    problems: list[str] = []
    rig: PreparedRig | None = None
    try:
        rig = prepare(load_rig(config.cell.rig))
    except UserError as error:
        problems.append(f"cell.rig: {error}")
    jobs = _load_jobs(config, problems)
    if rig is None or problems:
        raise ConfigError(str(path), problems)
    files = {"rig": config.cell.rig.read_bytes()}
    for file in sorted(config.cell.jobs.glob("*/*")):
        if file.is_file():
            files[str(file.relative_to(config.cell.jobs))] = file.read_bytes()
    setup = Setup(
        jobs={job.number: LoadedJob(job.name, job.number, _bind(job, rig)) for job in jobs},
        active_job=next(job.number for job in jobs if job.name == config.cell.job),
        period_s=config.cycle.period_s if config.cycle.mode == "free" else None,
        calibration_id=rig.rig.calibration_id,
        fingerprint=fingerprint(config, files),
        simulated=config.cameras.source.startswith("virtual"),
        robot_from_rig=rig.rig.robot_from_rig,
    )
    return LoadedCell(config, setup, tuple(jobs))


def _load_jobs(config: Config, problems: list[str]) -> list[Job]:
    folder = config.cell.jobs
    if not folder.is_dir():
        problems.append(f"cell.jobs: {folder}: no such folder")
        return []
    jobs: list[Job] = []
    for entry in sorted(folder.iterdir()):
        if not (entry / "job.toml").is_file():
            continue
        try:
            job = load_job(entry)
        except UserError as error:
            problems.append(f"cell.jobs: {error}")
            continue
        twin = next((other for other in jobs if other.number == job.number), None)
        if twin is not None:
            problems.append(f"cell.jobs: {job.name} and {twin.name} both have the number {job.number}")
        jobs.append(job)
    names = [job.name for job in jobs]
    if config.cell.job not in names:
        problems.append(
            f"cell.job: no usable job {config.cell.job!r} in {folder} (there: {', '.join(names) or 'none'})"
        )
    return jobs


def _bind(job: Job, rig: PreparedRig) -> Callable[[FramePair, Callable[[str], None]], Outcome]:
    def locate_job(pair: FramePair, lap: Callable[[str], None]) -> Outcome:
        return locate(pair, job, rig, lap)

    return locate_job


def warm_up(setup: Setup, shape: tuple[int, int]) -> None:
    """Run every job once on an empty pair: buffers are allocated and kernels are loaded."""
    blank = np.zeros(shape, np.uint8)
    pair = FramePair(*(Frame(side, 0, blank, 0, 0) for side in ("left", "right")))
    for job in setup.jobs.values():
        job.locate(pair, lambda _stage: None)


class Daemon:
    """Cameras, loop and publishers of one configuration file.

    observers : more publishers, for example the demo's view; they outlive a reload.
    build_head : makes the stereo head of a configuration; the demo passes its own cameras.
    """

    def __init__(
        self,
        path: Path,
        loaded: LoadedCell,
        *,
        observers: Sequence[Publisher] = (),
        build_head: Callable[[CamerasSection], StereoHead] | None = None,
    ) -> None:
        self._path = path
        self._loaded = loaded
        self._build_head = build_head or head_of
        self._cycle = Cycle(self._build_head(loaded.config.cameras), loaded.setup)
        self._observers = tuple(observers)
        self._servers: dict[str, Publisher] = {}
        self._reloading = asyncio.Lock()

    async def run(self) -> None:
        """Publish and measure until `stop`. Raises `ListenError` when a port cannot be opened."""
        try:
            config = self._loaded.config
            if config.modbus.enabled:
                await self._start("modbus", self._modbus(config.modbus))
            if config.zenoh.enabled:
                await self._start("zenoh", self._zenoh(config.cell.name, config.zenoh))
            for observer in self._observers:
                await observer.start()
            self._tell_cycle()
            await self._run_cycle()
        finally:
            for publisher in (*self._servers.values(), *self._observers):
                await publisher.close()

    def stop(self) -> None:
        """End after the running cycle."""
        self._cycle.stop()

    async def reload(self) -> bool:
        """Read the configuration again and exchange what changed; False if it was refused.

        A configuration with mistakes, or one whose ports cannot be opened, leaves everything as it was.
        """
        async with self._reloading:
            try:
                loaded = await asyncio.to_thread(load_cell, self._path)
                await asyncio.to_thread(warm_up, loaded.setup)
                await self._exchange_servers(loaded.config)
            except EdgedError as error:
                log.error("reload refused, the running configuration stays: %s", error)  # noqa: TRY400
                return False
            changed = loaded.config.cameras != self._loaded.config.cameras
            self._loaded = loaded
            self._cycle.exchange(loaded.setup, self._build_head(loaded.config.cameras) if changed else None)
            log.info("reloaded %s, fingerprint %s", self._path, loaded.setup.fingerprint)
            return True

    async def _run_cycle(self) -> None:
        task = asyncio.create_task(self._cycle.run(), name="cycle")
        stopped = asyncio.create_task(self._cycle.stopping.wait(), name="stop")
        try:
            await asyncio.wait({task, stopped}, return_when=asyncio.FIRST_COMPLETED)
            await asyncio.wait({task}, timeout=STOP_GRACE_S)
        finally:
            stopped.cancel()
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    async def _exchange_servers(self, new: Config) -> None:
        old = self._loaded.config
        if new.modbus != old.modbus:
            build_new = self._modbus(new.modbus) if new.modbus.enabled else None
            build_old = self._modbus(old.modbus) if old.modbus.enabled else None
            await self._exchange_server("modbus", build_new, build_old)
        if (new.zenoh, new.cell.name) != (old.zenoh, old.cell.name):
            build_new = self._zenoh(new.cell.name, new.zenoh) if new.zenoh.enabled else None
            build_old = self._zenoh(old.cell.name, old.zenoh) if old.zenoh.enabled else None
            await self._exchange_server("zenoh", build_new, build_old)

    async def _exchange_server(self, name: str, new: Publisher | None, old: Publisher | None) -> None:
        """Close the running server and start the new one; when that fails, start the old one again."""
        if name in self._servers:
            await self._servers.pop(name).close()
        try:
            if new is not None:
                await self._start(name, new)
        except EdgedError:
            if old is not None:
                await self._start(name, old)
            raise
        finally:
            self._tell_cycle()

    async def _start(self, name: str, publisher: Publisher) -> None:
        await publisher.start()
        self._servers[name] = publisher

    def _tell_cycle(self) -> None:
        self._cycle.set_publishers((*self._servers.values(), *self._observers))
