"""The method as a library: images in, poses with covariance out; needs no daemon and no files.

Each name is imported as `from edged import locate`. Lengths are in mm, angles in rad, pixels (x, y) with
integers at pixel centres, covariances in the units of their quantities. Every refusal is an
`edged.errors.UserError` whose text says what was expected.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from edged import pipeline
from edged.domain.arrays import SIDES, Image
from edged.domain.frames import FramePair
from edged.domain.measurement import Outcome
from edged.errors import ImageError
from edged.files import jobs
from edged.files import rig as rigfiles
from edged.robot.picking import frame_of, picked
from edged.setup.calibration.boards import boards_in, stated_boards
from edged.setup.calibration.views import Calibrated, Views, solve
from edged.setup.pairs import Pair
from edged.setup.teaching.proposal import check_name, check_tilt, propose_from_pair
from edged.vision.calibration.lenschoice import LensWish
from edged.vision.geometry.camera import StereoRig
from edged.vision.part.job import Job
from edged.vision.teaching.pair import WantedJob
from edged.vision.teaching.region import Area, Region

PREPARED_RIGS = 4
"""Number of rigs whose rectification is cached: it takes as long as several cycles, and 20 MB."""


def load_rig(path: str | Path) -> StereoRig:
    """Read a rig that `edged calibrate`, `edged rig convert` or `save_rig` wrote.

    Raises `FileFormatError` that names the file, the field and what was expected.
    """
    return rigfiles.load_rig(Path(path))


def load_job(folder: str | Path) -> Job:
    """Read a job that `edged teach` or `save_job` wrote.

    Raises `FileFormatError` that names the file, the field and what was expected.
    """
    return jobs.load_job(Path(folder))


def save_rig(path: str | Path, calibrated: Calibrated | StereoRig) -> None:
    """Write a rig; after a calibration, with its quality figures. Replaces an existing file atomically.

    Raises `FileFormatError` if it cannot be written.
    """
    if isinstance(calibrated, StereoRig):
        rigfiles.save_rig(Path(path), calibrated)
    else:
        rigfiles.save_rig(Path(path), calibrated.rig, calibrated.quality)


def save_job(folder: str | Path, job: Job) -> None:
    """Write a job's folder; an existing job is kept as FOLDER.old, later ones as FOLDER.2.old, ...

    Raises `FileFormatError` if something else is there, or it cannot be written.
    """
    jobs.save_job(Path(folder), job)


def calibrate(
    pairs: Sequence[tuple[Image, Image]],
    board: str | float,
    *,
    lens: LensWish = "auto",
    plate_shape: bool = False,
) -> Calibrated:
    """Calibrate two cameras from pictures of a board.

    pairs : (left, right) of each exposure, (H, W) uint8; at least three, twenty are a good number.
    board : as for `edged calibrate`, "chessboard:9x6:25" with the inner corners and the square's side in mm;
    or only that length, if the board can be identified from the pictures.
    lens : the lens model, or "auto" to choose it by the views.
    plate_shape : also measure how the board is bent and misprinted.

    Returns the `rig`, the `verdict` (grade, reasons, the view to add) and the `quality` figures. All lengths
    are as accurate as the given length of the board. Raises `CalibrationError` when the pairs give no
    trustworthy rig, `ImageError` for arrays that are not grey images.
    """
    named = [Pair.of_images(f"pair {number}", *_grey(pair)) for number, pair in enumerate(pairs, 1)]
    boards, _ = boards_in(stated_boards(str(board)), [pair.left for pair in named])
    views = Views(boards)
    views.add(named)
    return solve(views, lens, plate_shape=plate_shape)


def teach(
    left: Image,
    right: Image,
    rig: StereoRig,
    region: Area | tuple[float, float, float, float] | None = None,
    *,
    exclude: Sequence[Area] = (),
    further: Sequence[tuple[Image, Image]] = (),
    name: str = "part",
    tilt_rad: float | None = None,
) -> Job:
    """Learn a part from one stereo pair: its shape, and the circles, edges and slots that give its pose.

    left, right : raw images (H, W) uint8 of the rig's cameras.
    region : of the part in the left image, as x, y, width, height in px or as an `Area`; None: all of it.
    exclude : areas of it that do not belong to the part.
    further : pairs that show the part tilted or in other light: they determine the form of its edge breaks.
    tilt_rad : maximum tilt of parts, up to 45 degrees; None: about as at teaching.

    Its number on a PLC is 1; for another one use `dataclasses.replace(job, number=2)`. Anything that weakens
    the job, such as an edge that the region cuts, is a Python warning. Raises `TeachError` for a pair from
    which no job can be learnt, or a further one that does not show the part, `ImageError` for images that the
    rig was not calibrated for.
    """
    check_name(name)
    tilt_deg = None if tilt_rad is None else float(np.degrees(tilt_rad))
    check_tilt(tilt_deg)
    area = Region(*region) if isinstance(region, tuple) else region
    proposal = propose_from_pair(
        left,
        right,
        _prepared(rig).rectification,
        WantedJob(name, 1, tilt_deg=tilt_deg),
        region=area,
        exclude=exclude,
        further=further,
    )
    for text in proposal.inspection.warnings:
        warnings.warn(text, stacklevel=2)
    return proposal.job


def locate(left: Image, right: Image, job: Job, rig: StereoRig) -> Outcome:
    """Find a job's parts in one stereo exposure, and measure their poses.

    left, right : raw images (H, W) uint8 of the rig's cameras.

    Returns the `status` and a `Target` for each part, those within the job's limits first, with
    `rig_from_part` (4, 4), its `covariance` (6, 6) of (x, y, z, rotation vector), and `reject`, the reasons
    why it is not good. `outcome.nearest.ask()` is the closest miss if nothing was found. The results are
    identical to those of the daemon for the same images. Raises `ImageError` for images that the rig was not
    calibrated for.
    """
    pair = FramePair.of_images(left, right)
    return picked(pipeline.locate(pair, job, _prepared(rig)), job.picking, frame_of(rig))


@lru_cache(PREPARED_RIGS)
def _prepared(rig: StereoRig) -> pipeline.PreparedRig:
    return pipeline.prepare(rig)


def _grey(pair: tuple[Image, Image]) -> tuple[Image, Image]:
    for side, image in zip(SIDES, pair, strict=True):
        if image.ndim != 2 or image.dtype != np.uint8:
            raise ImageError(f"{side} image: {image.shape} {image.dtype}, expected grey (H, W) uint8")
    return pair
