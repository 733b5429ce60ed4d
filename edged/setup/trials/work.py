"""Functions that the worker process runs for trying a job."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from edged.domain.arrays import Image
from edged.domain.frames import FramePair
from edged.domain.picking import Bounds
from edged.files.rig import rig_of
from edged.pipeline import PreparedRig, inspect, prepare
from edged.robot.orientations import Convention
from edged.setup.jobs.messages import decode_message
from edged.setup.pairs import Progress
from edged.setup.trials import tried as trying
from edged.setup.trials.sigmamap import SigmaMap, sigma_map
from edged.setup.trials.stilltest import StillResult, StillSample
from edged.setup.trials.tried import TriedPair
from edged.vision.part.expected import Scatters
from edged.vision.part.job import Job
from edged.vision.part.measured import MeasuredPart


@dataclass(frozen=True, slots=True)
class TrialSetup:
    """Setup of a trial. rig, path : content and path of the rig file. job : as bytes, as a key for the cache.

    bounds : where the cell's robot may go.  convention : of A, B, C.
    """

    rig: bytes
    path: Path
    job: bytes
    bounds: Bounds
    convention: Convention


@lru_cache(maxsize=1)  # keeps the rectification, which takes long, for one trial at a time
def _prepared(rig: bytes, path: Path) -> PreparedRig:
    return prepare(rig_of(rig, path))


@lru_cache(maxsize=1)
def _job(content: bytes) -> Job:
    job: Job = decode_message(content)
    return job


def try_pair(setup: TrialSetup, images: tuple[Image, Image]) -> TriedPair:
    """Measure a live pair."""
    rig = _prepared(setup.rig, setup.path)
    return trying.try_pair(rig, _job(setup.job), FramePair.of_images(*images), setup.bounds, setup.convention)


def stand(setup: TrialSetup, images: tuple[Image, Image]) -> StillSample | None:
    """Measurement of the best part in a pair, for a still test; None without one."""
    inspection = inspect(FramePair.of_images(*images), _job(setup.job), _prepared(setup.rig, setup.path))
    best = max(inspection.measured, key=_rank, default=None)
    return None if best is None else trying.stand_of(best)


def _rank(measured: MeasuredPart) -> tuple[bool, float]:
    return not measured.target.reject, measured.target.match.score


def still(setup: TrialSetup, stands: Sequence[StillSample | None]) -> StillResult:
    """Judge the pictures of a still test."""
    return trying.still_part(_prepared(setup.rig, setup.path), _job(setup.job), stands)


def sigmas(setup: TrialSetup, scatters: Scatters, progress: Progress) -> SigmaMap:
    """Sigma to expect in the working volume."""
    return sigma_map(_prepared(setup.rig, setup.path), _job(setup.job), scatters, progress)
