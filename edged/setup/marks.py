"""Reference marks in a running cell: from a pair of pictures to the corrected rig for measuring it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np

from edged.config.cell import MarksSection
from edged.domain.arrays import FloatArray, Image
from edged.domain.frames import FramePair
from edged.domain.marks import MarksReport, MarksTrack
from edged.domain.measurement import Outcome
from edged.errors import CalibrationError, FileFormatError, UserError
from edged.files.pairs import find_pairs
from edged.pipeline import PreparedRig, corrected, locate
from edged.setup.pairs import Progress, load_pair, silent
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.correction import RigCorrection, shift_by_displacement
from edged.vision.geometry.rectification import Rectification, linear_pair, make_rectification
from edged.vision.marks.observing import DotsInPair
from edged.vision.marks.params import MARKS
from edged.vision.marks.taught import TaughtMarks, teach_marks
from edged.vision.marks.tracking import MarksFilter, MarksSettings, correction_of
from edged.vision.part.job import Job


class RigMarks:
    """The reference marks of a rig.

    prepared : the rig as calibrated. jobs : by number. digest : of the marks and their settings; a track can
    be continued with marks of the same digest.
    """

    def __init__(
        self, prepared: PreparedRig, marks: MarksFilter, jobs: Mapping[int, Job], digest: str
    ) -> None:
        self._prepared, self._filter, self._jobs = prepared, marks, jobs
        self.digest = digest

    def begin(self) -> MarksTrack:
        """Initial track, before the first exposure."""
        return self._filter.begin()

    def see(self, track: MarksTrack, pair: FramePair) -> tuple[MarksTrack, MarksReport]:
        """Update a track with the marks in a pair."""
        images = linear_pair(self._prepared.rig, *pair.images)
        return self._filter.step(track, *images, pair.exposed_ns)

    def rig(self, track: MarksTrack) -> PreparedRig:
        """The rig as corrected by a track."""
        base = self._prepared
        if track.maps.any():
            rectification = _turned(self._prepared.rectification, track.maps.tobytes())
            base = PreparedRig(base.rig, rectification, base.workspaces)
        return corrected(base, correction_of(track))

    def then(self, track: MarksTrack, pair: FramePair) -> tuple[PreparedRig, MarksReport]:
        """The corrected rig for the pair that follows a track, and the report of its marks.

        Raises `FileFormatError` for a track of other marks.
        """
        if track.cross.shape[1] != 2 * len(self._filter.considered):
            raise FileFormatError(
                "the track is of other reference marks than the setup that it was recorded with"
            )
        after, report = self.see(track, pair)
        return self.rig(after), report

    def locate(self, number: int, pair: FramePair, track: MarksTrack, lap: Callable[[str], None]) -> Outcome:
        """Locate a job's part with the corrected rig."""
        return locate(pair, self._jobs[number], self.rig(track), lap)


def rig_marks(
    prepared: PreparedRig, taught: TaughtMarks, stated: MarksSection, jobs: Mapping[int, Job] | None = None
) -> RigMarks:
    """The marks of a rig from a cell's files."""
    settings = MarksSettings(stated.material, stated.range_k, stated.on_knock == "heal")
    numbers = (taught.pixels, taught.sigma_px, taught.placed.places_mm, taught.residual_px)
    whole = hashlib.sha256(repr((settings, taught.codes, taught.rig.calibration_id)).encode())
    for array in numbers:
        whole.update(np.ascontiguousarray(array).tobytes())
    return RigMarks(prepared, MarksFilter(taught, settings), jobs or {}, whole.hexdigest())


def taught_in(folder: Path, rig: StereoRig, progress: Progress = silent) -> TaughtMarks:
    """Teach the marks that all pairs of a folder show. Raises `UserError`."""
    if rig.flange_from_rig is not None:
        raise UserError("the robot carries the cameras: marks hold those that stand still")
    pairs = find_pairs(folder)
    if len(pairs) < MARKS.min_exposures:
        raise UserError(
            f"{folder}: {len(pairs)} pairs, at least {MARKS.min_exposures} are needed (edged grab)"
        )

    def pictures() -> Iterator[tuple[Image, Image]]:
        for number, pair in enumerate(pairs):
            progress("measure the marks", number, len(pairs))
            yield load_pair(rig, pair.left, pair.right)

    newest_ns = max(pair.left.stat().st_mtime_ns for pair in pairs)  # pictures contain no time
    try:
        return teach_marks(pictures(), rig, newest_ns)
    except CalibrationError as error:
        raise UserError(f"{folder}: {error}") from error


def sigma_um(taught: TaughtMarks, settings: MarksSettings) -> FloatArray:
    """Sigma (3,) of X, Y, Z in the middle of the marks after correction by one exposure, µm.

    For dots at other subpixel positions than at teaching, as after some thermal drift.
    """
    marks = MarksFilter(taught, settings)
    noise = taught.sigma_px * np.sqrt(taught.exposures) / taught.noise
    track, _ = marks.updated(marks.begin(), DotsInPair(taught.pixels + 0.5, noise))
    correction = correction_of(track)
    slopes = shift_by_displacement(taught.rig, correction, taught.world_from_marks[None, :3, 3])[0]
    return np.asarray(1e3 * np.sqrt(np.diag(slopes @ correction.covariance @ slopes.T)))


def noise_px(taught: TaughtMarks) -> float:
    """One sigma of a dot in one exposure."""
    return float(np.median(taught.sigma_px) * np.sqrt(taught.exposures))


def first_look(
    taught: TaughtMarks, settings: MarksSettings, images: tuple[Image, Image], exposed_ns: int
) -> tuple[DotsInPair, MarksTrack, MarksReport]:
    """Evaluate a pair like the first exposure after a start. images : as captured."""
    marks = MarksFilter(taught, settings)
    before = marks.predicted(marks.begin(), exposed_ns)
    dots, before = marks.look(before, *linear_pair(taught.rig, *images))
    return dots, *marks.updated(before, dots)


@lru_cache(maxsize=2)  # cameras are rarely knocked, and the maps are as large as eight pictures
def _turned(rectification: Rectification, displacement: bytes) -> Rectification:
    """The rectification for displaced cameras."""
    vector: FloatArray = np.frombuffer(displacement)
    return make_rectification(RigCorrection(vector, np.empty((0, 0))).applied(rectification.rig))
