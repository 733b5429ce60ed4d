"""Wrong plates in drawn pictures, through the whole filter: no wrong result."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.markedday import new_day
from helpers.markedplate import AT, MIDDLE, OWN, VIEWS, pair, taught

from edged.domain.arrays import FloatArray, Image
from edged.domain.marks import MarksReport, MarksState, MarksTrack
from edged.sim.dirt import oiled
from edged.sim.marksplate import marks_plate
from edged.sim.render.scene import PlacedPart
from edged.vision.geometry.rigid import apply, transform
from edged.vision.marks.frame import parse_frame
from edged.vision.marks.tracking import MarksFilter, MarksSettings

S = 10**9


def steps(*pairs: tuple[Image, Image], settings: MarksSettings | None = None) -> list[MarksReport]:
    """Reports of exposures one second apart, after a first one of the taught plate."""
    tracker = MarksFilter(taught(), settings)
    track, report = tracker.step(tracker.begin(), *pair(AT, 20), S)
    assert report.state is MarksState.CORRECTED
    reports = []
    for second, images in enumerate(pairs, 2):
        track, report = tracker.step(track, *images, second * S)
        reports.append(report)
    return reports


def beside(shift: tuple[float, float, float]) -> FloatArray:
    """The plate's pose, shifted by mm."""
    return transform(np.eye(3), np.add(MIDDLE, shift))


@pytest.mark.slow
def test_the_plate_of_another_cell_is_named() -> None:
    """The codes of another plate are named and give no result until the taught plate is back."""
    other = pair(AT, 21, first=100)
    first, second, again = steps(other, other, pair(AT, 22))
    assert (first.state, first.valid) == (MarksState.CONTRADICTED, False)
    assert "codes 100, 101" in first.why
    assert not second.valid
    assert (again.state, again.valid) == (MarksState.CORRECTED, True)


@pytest.mark.slow
def test_a_mirrored_plate_has_no_marks() -> None:
    """No mark of a mirrored plate is seen, as if all were covered."""
    mirrored = tuple(np.ascontiguousarray(image[:, ::-1]) for image in pair(AT, 23))
    (report,) = steps((mirrored[0], mirrored[1]))
    assert report.seen == 0
    assert report.state in (MarksState.COASTING, MarksState.CONTRADICTED)


@pytest.mark.slow
def test_a_second_plate_of_the_same_codes_does_not_move_the_cell() -> None:
    """A second plate with the same codes, elsewhere in the pictures, does not change the result."""
    copy = PlacedPart(marks_plate(parse_frame("60x52:8:2:40")), beside((9.0, 4.0, -0.2)))
    both = pair(AT, 24, copy)
    (report,) = steps(both)
    assert report.valid
    left_mm, right_mm = report.left_mm, report.right_mm
    assert left_mm is not None
    assert right_mm is not None
    assert max(left_mm, right_mm) < 0.02


@pytest.mark.slow
def test_a_copy_alone_elsewhere_is_no_weather() -> None:
    """If the taught plate is gone and its copy lies 5 mm beside it, there is no result."""
    elsewhere = pair(beside((4.0, 3.0, 0.0)), 25)
    first, *_ = steps(elsewhere, settings=MarksSettings(heals=False))
    assert not first.valid


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.98, 1.02, 1.1])
def test_a_plate_of_another_size_is_no_result(size: float) -> None:
    """A plate with the taught codes, but 2 % or more larger or smaller, gives no result in four exposures."""
    tracker = MarksFilter(taught())
    track, _ = tracker.step(tracker.begin(), *pair(AT, 20), S)
    plate = marks_plate(parse_frame("60x52:8:2:40"), size)
    for second in range(2, 6):
        images = only(PlacedPart(plate, AT), second)
        track, report = tracker.step(track, *images, second * S)
        assert not report.valid, report


def only(placed: PlacedPart, noise: int) -> tuple[Image, Image]:
    """Both pictures of one plate, without the taught one."""
    left, right = pair(AT, noise, instead=placed)
    return left, right


@pytest.mark.slow
def test_marks_outside_of_where_they_are_looked_for_are_searched() -> None:
    """A rig moved by 4 mm, whose dots are 60 px off, is found as knocked, with its marks."""
    elsewhere = [pair(beside((4.0, 0.0, 0.0)), noise) for noise in range(30, 35)]
    reports = steps(*elsewhere)
    assert reports[0].state is MarksState.KNOCKED
    assert reports[0].seen >= 6
    assert not reports[0].valid
    assert reports[-1].valid
    shown = VIEWS["left"].project(apply(beside((4.0, 0.0, 0.0)), OWN)) - taught().pixels[0]
    assert np.linalg.norm(shown, axis=1).min() > 30


@pytest.mark.long
def test_marks_that_are_covered_for_ever_end_in_a_sigma_that_says_so() -> None:
    """With an exposure each ten minutes for a year and no marks, sigma grows beyond the largest that is
    allowed."""
    day = new_day(1)
    for at_s in range(3):
        day.expose(float(at_s))
    sigmas = []
    track: MarksTrack = day.track
    for step in range(1, 365 * 144):
        if step in (6, 144, 30 * 144, 364 * 144):
            day.track = track
            cameras, report = day.expose(600.0 * step, list(range(8)))
            track = day.track
            _, _, stated = day.part(cameras)
            sigmas.append(float(np.sqrt(np.diag(stated)).max()))
            assert (report.state, report.seen) == (MarksState.COASTING, 0)
        else:
            track = day.filter.predicted(track, round(1e9 * (600.0 * step + 1.0)))
    assert np.isfinite(sigmas).all()
    assert sigmas == sorted(sigmas)
    assert sigmas[-1] > 0.2  # mm: beyond the default of max_sigma_mm
    assert all(np.isfinite(day.track.covariance).ravel())
    _, report = day.expose(600.0 * 365 * 144)
    assert (report.state, report.valid) == (MarksState.CORRECTED, True)


def under_oil(images: tuple[Image, Image], marks: list[int]) -> tuple[Image, Image]:
    """Pictures with drops of oil on some dots."""
    places = taught().pixels[:, marks] + (6.0, -4.0)
    left, right = (oiled(image, at, 45.0) for image, at in zip(images, places, strict=True))
    return left, right


@pytest.mark.slow
@pytest.mark.parametrize("marks", [[2], [0, 3, 5]])
def test_oil_on_marks_is_no_knock(marks: list[int]) -> None:
    """Dots under oil are used or excluded, and the report does not say that a camera moved."""
    for report in steps(*(under_oil(pair(AT, noise), marks) for noise in (40, 41, 42))):
        assert report.valid, report
        assert report.state in (MarksState.CORRECTED, MarksState.CONTRADICTED)
        assert {taught().codes[mark] for mark in marks} >= set(report.excluded)
        assert report.left_mm is not None
        assert report.left_mm < 0.02
