"""Teaching without a console: the same job as the command's, written only when it is committed."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import pytest
from helpers import cells
from helpers.snapshots import make_snapshot
from rich.console import Console

from edged.commands.teach import PairSource, teach
from edged.files.jobs import load_job
from edged.files.recording import Recording, decode, encode
from edged.files.rig import save_rig
from edged.pipeline import locate, prepare
from edged.setup.recordings.regression import COMPARED, compare, decided, inspected
from edged.setup.teaching.proposal import Proposal, WantedJob, commit, former_job, propose_from_pair
from edged.vision.teaching.region import Region

QUIET = Console(quiet=True)


@pytest.fixture(scope="module")
def flat() -> cells.Flange:
    """A pair of the flange."""
    return cells.flange()


@pytest.fixture(scope="module")
def folder(flat: cells.Flange, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with rig, pictures and the job that the command taught from them."""
    folder = tmp_path_factory.mktemp("cell")
    save_rig(folder / "rig.json", flat.rig)
    for side, image in (("left", flat.left), ("right", flat.right)):
        cv2.imwrite(str(folder / f"{side}.png"), image)
    area = flat.region
    region = f"{area.x},{area.y},{area.width},{area.height}"
    source = PairSource(folder / "left.png", folder / "right.png", region)
    teach(folder / "rig.json", source, "flange", folder / "jobs" / "flange", QUIET)
    return folder


def proposal(flat: cells.Flange, wanted: WantedJob) -> Proposal:
    """The proposal from the same pictures in memory."""
    area: Region = flat.region
    rectification = prepare(flat.rig).rectification
    return propose_from_pair(flat.left, flat.right, rectification, wanted, region=area)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a job."""
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.mark.slow
def test_the_same_pair_gives_the_same_job_to_the_last_byte(
    flat: cells.Flange, folder: Path, tmp_path: Path
) -> None:
    """A job from memory equals the command's byte by byte; a proposal alone writes nothing."""
    proposed = proposal(flat, WantedJob("flange", 1))
    assert [] == list(tmp_path.iterdir())
    commit(tmp_path / "flange", proposed)

    assert contents(folder / "jobs" / "flange") == contents(tmp_path / "flange")


@pytest.mark.slow
def test_what_people_changed_in_the_former_job_is_proposed_again(
    flat: cells.Flange, folder: Path, tmp_path: Path
) -> None:
    """A limit that was changed in the former job is carried over as by the command, and listed."""
    job = tmp_path / "flange"
    shutil.copytree(folder / "jobs" / "flange", job)
    text = (job / "job.toml").read_text()
    (job / "job.toml").write_text(text.replace("min_score = 0.", "min_score = 0.9"))
    former = former_job(job)
    assert former is not None
    assert former.search.min_score > 0.9

    proposed = proposal(flat, WantedJob("flange", former.number, former=former))

    assert former.search.min_score == proposed.job.search.min_score
    assert any(line.startswith("kept: search.min_score") for line in proposed.carried)


@pytest.mark.slow
def test_an_exposure_is_measured_by_any_rig_and_job(flat: cells.Flange, folder: Path) -> None:
    """A recorded exposure gives the same digits with its own rig and job; with a tighter limit it is
    refused."""
    rig, job = prepare(flat.rig), load_job(folder / "jobs" / "flange")
    pair = cells.frame_pair(flat.left, flat.right)
    outcome = locate(pair, job, rig)
    published = replace(
        make_snapshot(),
        status=outcome.status,
        targets=outcome.targets,
        robot_from_rig=flat.rig.robot_from_rig,
        registration_covariance=flat.rig.registration_covariance,
    )
    taken = decode(encode(published, pair), "there")
    assert [] == _differences(taken, decided(taken, inspected(taken, rig, job), rig, job))

    strict = replace(job, limits=replace(job.limits, max_sigma_mm=1e-6))
    changed = _differences(taken, decided(taken, inspected(taken, rig, strict), rig, strict))

    assert 'status: "OK" -> "LOW_QUALITY"' in changed


def _differences(taken: Recording, again: dict[str, Any]) -> list[str]:
    return [line for key in COMPARED for line in compare(key, taken.snapshot[key], again[key])]
