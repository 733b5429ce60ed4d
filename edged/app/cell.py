"""Loads a configuration file into a cell that can measure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from edged.cell.drift import DriftLimits
from edged.cell.loaded import LoadedJob, Setup
from edged.config.configuration import Config
from edged.domain.belt import Belt
from edged.domain.events import Snapshot
from edged.domain.frames import FramePair
from edged.domain.marks import MarksState
from edged.domain.measurement import Outcome
from edged.errors import UserError
from edged.files.golden import golden_file, save_golden
from edged.files.rig import read_rig, rig_of
from edged.pipeline import PreparedRig, locate
from edged.robot.golden import GoldenPart, golden_of, golden_part, golden_target
from edged.robot.picking import frame_of
from edged.setup.cellfiles import (
    CellFiles,
    UnfinishedCell,
    acceptance_of,
    fingerprint,
    golden_parts,
    read_any_cell,
    read_cell,
)
from edged.setup.marks import rig_marks
from edged.vision.geometry.camera import StereoRig
from edged.vision.kernels.jit import load_called
from edged.vision.part.job import Job

PACKAGES = tuple(f"edged.vision.{package}" for package in ("shape", "edges", "curves", "part"))
"""Packages whose kernels every cycle calls."""
OF_MARKS = ("edged.vision.marks", "edged.vision.boards")
"""Further packages whose kernels a cycle with reference marks calls."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadedCell:
    """A cell's files and what is made of them: the rig with its maps, and the setup of the loop.

    rig : None for an unfinished cell, whose setup says what it lacks.
    """

    cell: CellFiles | UnfinishedCell
    rig: PreparedRig | None
    setup: Setup


def load_any_cell(path: Path) -> LoadedCell:
    """Load a cell, ready to measure or to be set up. Raises `ConfigError` with every mistake in its files."""
    cell = read_any_cell(path)
    if isinstance(cell, CellFiles):
        return _loaded(cell)
    setup = Setup(
        jobs={},
        active_job=0,
        period_s=None,
        calibration_id="",
        fingerprint=cell.fingerprint,
        simulated=cell.config.cameras.source.startswith("virtual"),
        robot_from_rig=None,
        listens=cell.config.cycle.mode == "external",
        lacks=cell.lacks,
    )
    return LoadedCell(cell, None, setup)


def load_cell(path: Path) -> LoadedCell:
    """Load a cell, ready to measure. Raises `ConfigError` with every mistake in its files."""
    return _loaded(read_cell(path))


def _loaded(cell: CellFiles) -> LoadedCell:
    config, rig = cell.config, PreparedRig(cell.rig, cell.rectification)
    jobs = [
        LoadedJob(
            job.name, job.number, _bind(job, rig), job.witness, job.picking, cell.golden.get(job.number)
        )
        for job in cell.jobs
    ]
    setup = Setup(
        jobs={job.number: job for job in jobs},
        active_job=min(job.number for job in jobs if config.cell.job in {None, job.name}),
        period_s=config.cycle.period_s if config.cycle.mode == "free" else None,
        calibration_id=cell.rig.calibration_id,
        fingerprint=cell.fingerprint,
        simulated=config.cameras.source.startswith("virtual"),
        robot_from_rig=cell.rig.robot_from_rig,
        registration_covariance=cell.rig.registration_covariance,
        flange_from_rig=cell.rig.flange_from_rig,
        error_map=frame_of(cell.rig).error_map,
        listens=config.cycle.mode == "external",
        drift=DriftLimits(**config.drift.model_dump()),
        bounds=config.limits.bounds(),
        belt=_belt(config, cell.rig),
        idle_s=config.cycle.idle_s,
        marks=None
        if cell.marks is None
        else rig_marks(rig, cell.marks, config.marks, {job.number: job for job in cell.jobs}),
        others=MarksState.OTHER_CALIBRATION if cell.other_marks else MarksState.NONE,
        acceptance=cell.acceptance,
    )
    return LoadedCell(cell, rig, setup)


def _belt(config: Config, rig: StereoRig) -> Belt | None:
    if config.belt is None:
        return None
    exposures_us = [side.exposure_us or 0.0 for side in (config.cameras.left, config.cameras.right)]
    focal_px = max(max(model.fx, model.fy) for model in (rig.left, rig.right))
    return config.belt.belt(1e-6 * max(exposures_us), focal_px)


def with_registration(loaded: LoadedCell) -> LoadedCell:
    """Return the cell with the rig file read again: same cameras, new pose relative to the robot.

    Its jobs stay in memory, as they measure in the rig's own frame. Raises `EdgedError`.
    """
    cell, prepared = loaded.cell, loaded.rig
    if not isinstance(cell, CellFiles) or prepared is None:
        raise UserError("a cell without a rig cannot be registered")
    path = cell.config.cell.rig
    data = read_rig(path)
    rig = rig_of(data, path)
    contents = {**cell.contents, "rig.json": data}
    files = {name: content for name, content in contents.items() if name != "cell.toml"}
    identity = fingerprint(cell.config, files)
    acceptance = acceptance_of(path, rig)
    setup = replace(
        loaded.setup,
        fingerprint=identity,
        acceptance=acceptance,
        robot_from_rig=rig.robot_from_rig,
        registration_covariance=rig.registration_covariance,
        flange_from_rig=rig.flange_from_rig,
        error_map=frame_of(rig).error_map,
    )
    registered = replace(cell, rig=rig, fingerprint=identity, contents=contents, acceptance=acceptance)
    golden = golden_parts(path, rig, cell.jobs)
    return _with_golden_parts(LoadedCell(registered, replace(prepared, rig=rig), setup), golden)


def with_golden(loaded: LoadedCell, snapshot: Snapshot) -> LoadedCell:
    """Save the single good part of a snapshot as the golden part of its job; return the cell with it.

    Raises `UserError`; nothing has changed then.
    """
    cell, target = loaded.cell, golden_target(snapshot)
    if not isinstance(cell, CellFiles) or snapshot.fingerprint != cell.fingerprint:
        raise UserError("the cell's files were exchanged meanwhile: GOLDEN again")
    if isinstance(target, str):
        raise UserError(target)
    job = next(job for job in cell.jobs if job.number == snapshot.job_number)
    golden = golden_of(snapshot, target, job, cell.rig)
    save_golden(golden_file(cell.config.cell.rig, job.number), golden)
    return _with_golden_parts(loaded, {**cell.golden, job.number: golden_part(golden, job, cell.rig)})


def _with_golden_parts(loaded: LoadedCell, golden: Mapping[int, GoldenPart]) -> LoadedCell:
    assert isinstance(loaded.cell, CellFiles)
    jobs = {n: replace(job, golden=golden.get(n)) for n, job in loaded.setup.jobs.items()}
    return replace(loaded, cell=replace(loaded.cell, golden=golden), setup=replace(loaded.setup, jobs=jobs))


def _bind(job: Job, rig: PreparedRig) -> Callable[[FramePair, Callable[[str], None]], Outcome]:
    def locate_job(pair: FramePair, lap: Callable[[str], None]) -> Outcome:
        return locate(pair, job, rig, lap)

    return locate_job


def warm_up(loaded: LoadedCell) -> None:
    """Load the kernels that a cycle calls, and run every job once on a blank pair to allocate buffers."""
    if loaded.rig is None:
        return
    load_called(*PACKAGES)
    marks = loaded.setup.marks
    if marks is not None:
        load_called(*OF_MARKS)
    camera = loaded.rig.rig.left, loaded.rig.rig.right
    blank = [np.zeros((model.height, model.width), np.uint8) for model in camera]
    pair = FramePair.of_images(*blank)
    for job in loaded.setup.jobs.values():
        job.locate(pair, lambda _stage: None)
    if marks is not None:
        marks.see(marks.begin(), pair)
