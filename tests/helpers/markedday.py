"""A virtual cell with reference marks over several days: dots are computed, no picture is rendered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import SIDES, FloatArray
from edged.domain.marks import MarksReport, MarksTrack
from edged.sim.cell import demo_rig
from edged.sim.render.lens import project
from edged.sim.weather import Knock, Schedule, TrueCameras, Weather
from edged.vision.geometry.correction import shift_by_displacement
from edged.vision.geometry.rigid import apply, rotation_matrix
from edged.vision.geometry.triangulation import triangulate_raw
from edged.vision.marks.frame import CODE_AWAY, MarkFrame, parse_frame
from edged.vision.marks.measuring import PlacedMarks
from edged.vision.marks.observing import DotsInPair
from edged.vision.marks.params import MARKS
from edged.vision.marks.taught import TaughtMarks, taught_of
from edged.vision.marks.tracking import MarksFilter, MarksSettings, correction_of

FRAME = "60x52:8:2:40"
MIDDLE = np.array([7.0, 0.0, 207.9])
NOISE_PX, GRID_PX = 0.02, 0.01
SWING_K = 10.0


def rim_mm() -> FloatArray:
    """(8, 3) points on the rim of a part of 28 mm."""
    angles = np.arange(8) * np.pi / 4
    return 14.0 * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])


@dataclass(eq=False)
class MarkedDay:
    """One virtual cell with marks, starting at its teaching."""

    weather: Weather
    seed: int
    frame: MarkFrame
    settings: MarksSettings
    grid_px: float = GRID_PX

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng((self.seed, 51))
        self.places = np.column_stack([self.frame.places[:, :2], np.zeros(self.frame.count)])
        self.phases = self.rng.uniform(0, 1, (2, self.frame.count, 2))
        along = np.column_stack([self.frame.places[:, 2:], np.zeros(self.frame.count)])
        d = self.frame.diameter_mm
        self.placed = PlacedMarks(
            tuple(self.frame.codes),
            MIDDLE + self.places,
            CODE_AWAY * d * along,
            np.array([0.0, 0.0, 1.0]),
            np.full(self.frame.count, d / 2),
        )
        start = self.weather.at(0.0)
        every = np.stack([self.dots(start) for _ in range(MARKS.min_exposures)])
        sigma = np.full(every.shape[:3], NOISE_PX)
        self.taught: TaughtMarks = taught_of(
            self.weather.rig,
            self.placed,
            every,
            sigma,
            np.broadcast_to((1 / 16, 0.0, 1 / 16), (2, self.frame.count, 3)),
            (0.7, 0.7),
            1,
        )
        self.filter = MarksFilter(self.taught, self.settings)
        self.track: MarksTrack = self.filter.begin()
        self.exposures = 0

    def dots(self, cameras: TrueCameras, moved: FloatArray | None = None) -> FloatArray:
        """(2, N, 2) measured positions of the dots. moved (N, 3) : displacement of the marks, mm."""
        places = self.places if moved is None else self.places + moved
        space = MIDDLE + cameras.plate_scale * places
        seen = np.stack([project(*cameras.camera(side), space) for side in SIDES])
        # a wave over each pixel, as large as the bias that the filter assumes
        grid = np.sqrt(2.0) * self.grid_px * np.sin(2 * np.pi * (seen + self.phases))
        return seen + grid + self.rng.normal(0.0, NOISE_PX, seen.shape)

    def expose(
        self, at_s: float, hidden: Sequence[int] = (), moved: FloatArray | None = None
    ) -> tuple[TrueCameras, MarksReport]:
        """Make one exposure; returns the true cameras and the marks' report."""
        cameras = self.weather.at(at_s)
        pixels = self.dots(cameras, moved)
        pixels[:, list(hidden)] = np.nan
        sigma = np.where(np.isfinite(pixels[..., 0]), NOISE_PX, np.nan)
        at = self.filter.predicted(self.track, round(1e9 * (at_s + 1.0)))
        self.track, report = self.filter.updated(at, DotsInPair(pixels, sigma))
        self.exposures += 1
        return cameras, report

    def part(self, cameras: TrueCameras) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Error of a part at a random place, mm, with marks (3,) and without, and stated covariance."""
        place = MIDDLE + self.rng.uniform(-1, 1, 3) * (30.0, 22.5, 15.0) - (0.0, 0.0, 10.0)
        points = place + rim_mm() @ rotation_matrix(self.rng.normal(0, 0.05, 3)).T
        left, right = (project(*cameras.camera(side), points) for side in SIDES)
        rig, correction = self.weather.rig, correction_of(self.track)
        found = apply(correction.world_from_left(rig), triangulate_raw(correction.applied(rig), left, right))
        plain = triangulate_raw(rig, left, right)
        slopes = shift_by_displacement(rig, correction, points).mean(axis=0)
        stated = slopes @ correction.covariance @ slopes.T
        return (found - points).mean(axis=0), (plain - points).mean(axis=0), stated


def new_day(
    seed: int, *knocks: Knock, swing_k: float = SWING_K, material: str = "steel", **more: bool
) -> MarkedDay:
    """A cell on its first day, taught at the mean temperature."""
    schedule = Schedule.days(swing_k, 2.0) if swing_k else Schedule(((0.0, 0.0),))
    weather = Weather(demo_rig(), schedule, knocks, seed)
    settings = MarksSettings(material, max(swing_k, 1.0), **more)
    return MarkedDay(weather, seed, parse_frame(FRAME), settings)


def chi2(error: FloatArray, covariance: FloatArray) -> float:
    """Squared error in units of the stated covariance, per coordinate."""
    return float(error @ np.linalg.solve(covariance, error)) / 3
