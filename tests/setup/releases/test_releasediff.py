"""Differences between releases are listed completely, without secrets."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edged.domain.picking import Tray
from edged.files.jobs import load_job, save_job
from edged.files.rig import load_rig, save_rig
from edged.setup.cellfiles import read_any_cell, read_cell
from edged.setup.releases.archive import make
from edged.setup.releases.differences import ReleaseDifference, difference, difference_of, moved_between
from edged.vision.part.job import CircleFeature, Job, MeasurementSpec


def told(template: Path, tmp_path: Path, change: Callable[[Path], None]) -> ReleaseDifference:
    """Differences of a cell before and after a change in its folder."""
    folder = tmp_path / "cell"
    shutil.copytree(template, folder)
    before = read_any_cell(folder / "cell.toml")
    change(folder)
    return difference_of(before, read_any_cell(folder / "cell.toml"))


def with_job(change: Callable[[Job], Job]) -> Callable[[Path], None]:
    """Change the job as a page would write it."""

    def changed(folder: Path) -> None:
        job = folder / "jobs" / "flange"
        save_job(job, change(load_job(job)))
        shutil.rmtree(job.with_name("flange.old"))

    return changed


def test_the_same_is_not_told(template: Path) -> None:
    """Two archives of one cell differ in nothing."""
    one, other = (make(template / "cell.toml").backup for _ in range(2))
    same = difference(one, other)
    assert (None, [], []) == (same.rig, same.cameras, same.settings)
    assert ([], [], []) == (same.jobs.added, same.jobs.removed, same.jobs.changed)


def test_a_job_is_told_by_what_changed_in_it(template: Path, tmp_path: Path) -> None:
    """A limit, a new feature, a moved one and a size are listed with code, name and both values."""

    def change(job: Job) -> Job:
        (circle,) = job.circles
        more = CircleFeature("c1", circle.centre_mm + np.array([5.0, 0.0, 0.0]), 1.5, 1)
        size = MeasurementSpec("gap", "distance", ("c0", "c1"), 5.0, 0.1)
        return replace(
            job,
            circles=(replace(circle, radius_mm=circle.radius_mm + 0.5), more),
            limits=replace(job.limits, max_sigma_mm=0.05),
            measurements=(*job.measurements, size),
            picking=replace(
                job.picking, tray=Tray((0.0,) * 3, ((90.0, 0.0, 0.0), *((0.0,) * 3,) * 2), (4, 1, 1), 8.0)
            ),
        )

    found = told(template, tmp_path, with_job(change))
    (changed,) = found.jobs.changed
    assert ("flange", None) == (changed.name, found.rig)
    codes = {(one.code, one.name): (one.before, one.after) for one in changed.changes}
    assert (0.2, 0.05) == codes.pop(("limit", "max_sigma_mm"))
    assert (None, [3.0]) == codes.pop(("feature_added", "c1"))
    before, after = codes.pop(("feature", "c0"))
    assert [1.0] == pytest.approx([after[0] - before[0]], abs=1e-3)
    assert (None, [5.0, 0.1]) == codes.pop(("size", "gap"))
    was, tray = codes.pop(("tray", None))
    assert (None, [4, 1, 1], [90.0, 0.0, 0.0], 8.0) == (
        was,
        tray["counts"],
        tray["ends_mm"][0],
        tray["tolerance_mm"],
    )
    assert {} == codes


def test_jobs_come_and_go_by_their_names(template: Path, tmp_path: Path) -> None:
    """A renamed job is one removed and one added."""

    def change(folder: Path) -> None:
        text = (folder / "jobs" / "flange" / "job.toml").read_text()
        shutil.copytree(folder / "jobs" / "flange", folder / "jobs" / "disc")
        text = text.replace('name = "flange"', 'name = "disc"').replace("number = 1 ", "number = 2 ")
        (folder / "jobs" / "disc" / "job.toml").write_text(text)

    found = told(template, tmp_path, change)
    assert (["disc"], [], []) == (found.jobs.added, found.jobs.removed, found.jobs.changed)


def test_a_rig_is_told_by_how_much_it_moves_places(template: Path, tmp_path: Path) -> None:
    """A longer baseline is listed with the resulting displacement of points."""

    def change(folder: Path) -> None:
        rig = load_rig(folder / "rig.json")
        moved = rig.right_from_left.copy()
        moved[:3, 3] *= 1.001
        save_rig(folder / "rig.json", replace(rig, right_from_left=moved, calibration_id="wide"))

    found = told(template, tmp_path, change)
    assert found.rig is not None
    assert ("wide", False) == (found.rig.after, found.rig.robot)
    assert found.rig.moved is not None
    assert 205.0 == pytest.approx(found.rig.moved.mean_um[2], rel=0.05)
    assert ([], [], []) == (found.jobs.changed, found.cameras, found.settings)
    rig = read_cell(template / "cell.toml").rig
    same = moved_between(rig, rig, 200.0)
    assert same is not None
    assert 0.0 == same.max_um
    assert None is moved_between(rig, replace(rig, left=replace(rig.left, width=100)), 200.0)


def test_settings_are_told_by_their_names_and_secrets_are_not(template: Path, tmp_path: Path) -> None:
    """Camera settings are listed apart from others, and a changed password not at all."""
    secret = "$argon2id$v=19$m=8,t=1,p=1$c2FsdHNhbHQ$aGFzaGhhc2hoYXNoaGFzaA"

    def change(folder: Path) -> None:
        config = folder / "cell.toml"
        more = "[drift]\nwarn_rows_px = 0.25\n[cameras.left]\nexposure_us = 777.0\n"
        config.write_text(f'{config.read_text()}password_hash = "{secret}"\n{more}')

    found = told(template, tmp_path, change)
    assert [("cameras.left.exposure_us", 777.0)] == [(one.name, one.after) for one in found.cameras]
    assert [("drift.warn_rows_px", 0.5, 0.25)] == [
        (one.name, one.before, one.after) for one in found.settings
    ]
    assert "argon2" not in found.model_dump_json()
