"""The filter of the reference marks: weather, knocks, hidden and wrong marks; dots are computed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.markedday import FRAME, MarkedDay, chi2, new_day

from edged.domain.arrays import SIDES
from edged.domain.marks import MarksState
from edged.sim.cell import demo_rig
from edged.sim.weather import Knock
from edged.vision.geometry.correction import (
    RigCorrection,
    of_side,
    seen_with_slopes,
    shift_by_displacement,
)
from edged.vision.geometry.rigid import apply, rotation_matrix
from edged.vision.geometry.triangulation import triangulate_raw
from edged.vision.marks.frame import parse_frame
from edged.vision.marks.observing import DotsInPair
from edged.vision.marks.params import MARKS
from edged.vision.marks.tracking import correction_of

HOUR_S = 3600.0


def settled(
    seed: int = 0, *knocks: Knock, exposures: int = 20, swing_k: float = 10.0, **more: bool
) -> MarkedDay:
    """A day after some exposures, one per second."""
    day = new_day(seed, *knocks, swing_k=swing_k, **more)
    for at_s in range(exposures):
        assert day.expose(float(at_s))[1].valid
    return day


# --- geometry ---------------------------------------------------------------------------------------------


def test_slopes_of_a_displacement_are_its_differences() -> None:
    """The slopes of pixels and of a triangulated point equal differences, for every element."""
    rig, rng = demo_rig(), np.random.default_rng(1)
    points = np.array([[7.0, 3.0, 205.0], [-20.0, -15.0, 190.0]])
    at = rng.normal(0, 1, 14) * np.tile([1e-3] * 3 + [0.2] * 3 + [1e-4], 2)
    step = np.tile([1e-6] * 3 + [1e-4] * 3 + [1e-6], 2)
    shift = shift_by_displacement(rig, RigCorrection(at, np.eye(14)), points)
    true = [seen_with_slopes(rig, at, side, points)[0] for side in SIDES]
    for k in range(14):
        moved = at + step[k] * np.eye(14)[k]
        correction = RigCorrection(moved, np.eye(14))
        found = apply(
            correction.world_from_left(rig), triangulate_raw(correction.applied(rig), true[0], true[1])
        )
        largest = np.abs(shift[..., k]).max()
        assert (found - points) / step[k] == pytest.approx(shift[..., k], rel=1e-2, abs=1e-2 * largest)
        for side, there in zip(SIDES, true, strict=True):
            now, _, _ = seen_with_slopes(rig, moved, side, points)
            _, slopes, _ = seen_with_slopes(rig, at, side, points)
            own = k - of_side(side).start
            expected = slopes[..., own] if 0 <= own < 7 else np.zeros_like(there)
            assert (now - there) / step[k] == pytest.approx(
                expected, rel=1e-2, abs=2e-3 * np.abs(slopes[..., :6]).max()
            )


def test_no_displacement_is_the_calibrated_rig_to_the_last_bit() -> None:
    """Without a displacement the corrected rig equals the calibrated one exactly."""
    rig = demo_rig()
    none = RigCorrection(np.zeros(14), np.zeros((14, 14)))
    assert (rig.left, rig.right) == (none.applied(rig).left, none.applied(rig).right)
    assert np.array_equal(none.applied(rig).right_from_left, rig.right_from_left)
    assert np.array_equal(none.world_from_left(rig), np.eye(4))


# --- weather ----------------------------------------------------------------------------------------------


@pytest.mark.long
def test_weather_is_followed_and_sigma_is_honest() -> None:
    """In six hours of warming by 10 K the error is below 0.15 of that without marks, and as large as its
    sigma."""
    with_marks, without, squares = [], [], []
    for seed in range(3):
        day = new_day(seed)
        for at_s in np.arange(60.0, 6 * HOUR_S, 60.0):
            cameras, report = day.expose(float(at_s))
            assert (MarksState.CORRECTED, True, 8) == (report.state, report.valid, report.seen)
            error, plain, stated = day.part(cameras)
            with_marks.append(error)
            without.append(plain)
            squares.append(chi2(error, stated))
    rms, plain_rms = (float(np.sqrt(np.mean(np.square(errors)))) for errors in (with_marks, without))
    assert rms < 3.5e-3
    assert rms < 0.15 * plain_rms
    assert 0.3 < np.mean(squares) < 1.4


def test_at_a_constant_temperature_nothing_is_corrected_but_noise() -> None:
    """At a constant temperature the correction's error stays below 2 µm, as its sigma says."""
    day = new_day(3, swing_k=0.0)
    for at_s in range(200):
        cameras, report = day.expose(float(at_s))
    errors = np.array([day.part(cameras)[0] for _ in range(20)])
    assert MarksState.CORRECTED is report.state
    assert np.sqrt(np.mean(errors**2)) < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("period_s", [1, 3600])
def test_the_covariance_stays_one_for_years(period_s: int) -> None:
    """After 4,000 updates, each second or hour, the covariance is symmetric, positive, and at most twice
    the weather's."""
    day = settled()
    dots = DotsInPair(day.taught.pixels, np.full((2, 8), 0.02))
    track = day.track
    for _ in range(4_000):
        track, _ = day.filter.updated(day.filter.predicted(track, track.exposed_ns + period_s * 10**9), dots)
    assert np.array_equal(track.covariance, track.covariance.T)
    scale = np.sqrt(np.diag(track.covariance))
    assert np.linalg.eigvalsh(track.covariance / np.outer(scale, scale)).min() > 1e-9
    assert (scale <= 2.0 * np.sqrt(np.diag(day.filter.begin().covariance))).all()


def test_time_that_goes_back_or_jumps_does_no_harm() -> None:
    """A time in the past adds nothing to the covariance; a year adds as much as a day."""
    day = settled()
    back = day.filter.predicted(day.track, day.track.exposed_ns - 10**15)
    assert np.array_equal(back.covariance, day.track.covariance)
    year, single = (
        day.filter.predicted(day.track, day.track.exposed_ns + hours * 3600 * 10**9) for hours in (8760, 24)
    )
    assert np.array_equal(year.covariance, single.covariance)


def test_the_same_dots_give_the_same_bits() -> None:
    """A second filter with the same dots has exactly the same state."""
    first, again = settled(4), settled(4)
    for name in ("displacement", "covariance", "cross"):
        assert np.array_equal(getattr(first.track, name), getattr(again.track, name))


# --- hidden marks -----------------------------------------------------------------------------------------


def test_while_all_marks_are_hidden_sigma_grows() -> None:
    """While all marks are hidden results stay valid, the state is COASTING, and sigma grows."""
    day = settled()
    sigmas = []
    for minute in range(0, 61, 20):
        cameras, report = day.expose(20.0 + 60 * minute, hidden=range(8))
        assert (MarksState.COASTING, True, 0) == (report.state, report.valid, report.seen)
        sigmas.append(float(np.sqrt(np.diag(day.part(cameras)[2]).max())))
    assert sigmas == sorted(sigmas)
    assert sigmas[-1] > 2 * sigmas[0]


def test_marks_never_seen_leave_what_weather_may_have_done() -> None:
    """With no marks from the first exposure on, sigma is that of the possible weather, tens of
    micrometres."""
    day = new_day(1)
    cameras, report = day.expose(0.0, hidden=range(8))
    assert (MarksState.COASTING, True) == (report.state, report.valid)
    assert 0.02 < np.sqrt(np.diag(day.part(cameras)[2]).max()) < 0.2


# --- knocks -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hit", ["left", "right", "rig"])
@pytest.mark.parametrize(("shift", "turn"), [((0.1, -0.1, 0.14), (0, 0, 0)), ((0, 0, 0), (8e-4, 0, 6e-4))])
def test_a_knock_heals_after_three_exposures_that_agree(hit: str, shift: tuple, turn: tuple) -> None:
    """After a knock three exposures give no result; then each is within 4 sigma."""
    day = settled(2, Knock(20.0, hit, shift, turn))
    states = []
    for at_s in range(20, 26):
        cameras, report = day.expose(float(at_s))
        states.append((report.state, report.valid))
        if report.valid:
            error, _, stated = day.part(cameras)
            assert (np.abs(error) < 4 * np.sqrt(np.diag(stated))).all()
    assert [(MarksState.KNOCKED, False)] * 3 + [(MarksState.CORRECTED, True)] * 3 == states
    said = day.expose(27.0)[1]
    assert "" == said.why


def test_what_was_moved_is_said() -> None:
    """The report names the moved camera, also along the baseline, or says that the whole rig or the plate
    moved."""
    for hit, said in (
        ("left", "the left camera was moved"),
        ("right", "the right camera was moved"),
        ("rig", "the rig as a whole, or the plate"),
    ):
        day = settled(2, Knock(20.0, hit, (0.2, 0, 0)))
        assert said in day.expose(20.0)[1].why


def test_without_healing_a_knock_stays_one() -> None:
    """With healing off a knock stays a knock, also after a restart."""
    day = settled(2, Knock(20.0, "right", (1.0, 0, 0)), heals=False)
    for at_s in range(20, 40):
        report = day.expose(float(at_s))[1]
        assert (MarksState.KNOCKED, False) == (report.state, report.valid)
    assert "on_knock is refuse" in report.why
    day.track = day.filter.begin()
    for at_s in range(40, 50):
        report = day.expose(float(at_s))[1]
        assert (MarksState.KNOCKED, False) == (report.state, report.valid)


def test_a_knock_while_most_marks_are_hidden_is_no_result() -> None:
    """With two visible marks a knock gives no result; with six it heals."""
    day = settled(2, Knock(20.0, "left", (0.2, 0, 0)))
    for at_s in range(20, 30):
        report = day.expose(float(at_s), hidden=range(6))[1]
        assert (MarksState.CONTRADICTED, False) == (report.state, report.valid)
    reports = [day.expose(float(at_s), hidden=[0, 1])[1] for at_s in range(30, 35)]
    assert [False, False, False, True, True] == [report.valid for report in reports]


def test_a_second_knock_while_healing_begins_anew() -> None:
    """After a second knock it again takes three exposures."""
    day = settled(2, Knock(20.0, "left", (0.2, 0, 0)), Knock(22.0, "right", (0, 0.2, 0)))
    valid = [day.expose(float(at_s))[1].valid for at_s in range(20, 27)]
    assert [False] * 5 + [True] * 2 == valid


# --- hostile plates ---------------------------------------------------------------------------------------


def shifted(marks: list[int], mm: tuple[float, float, float]) -> np.ndarray:
    """Displacements of the places, with these marks off by some mm."""
    moved = np.zeros((8, 3))
    moved[marks] = mm
    return moved


@pytest.mark.parametrize("marks", [[2], [2, 5]])
def test_marks_that_were_moved_are_named_and_left_out(marks: list[int]) -> None:
    """Moved marks are named and left out, and the others correct as before."""
    day = settled()
    for at_s in range(20, 30):
        cameras, report = day.expose(float(at_s), moved=shifted(marks, (0.1, 0.0, 0.0)))
        assert (MarksState.CONTRADICTED, True, tuple(40 + mark for mark in marks)) == (
            report.state,
            report.valid,
            report.excluded,
        )
        error, _, stated = day.part(cameras)
        assert (np.abs(error) < 4 * np.sqrt(np.diag(stated))).all()


def test_a_plate_that_is_not_the_taught_one_is_no_result() -> None:
    """A bent, larger, smaller, mirrored or random plate gives no result."""
    places = np.column_stack([parse_frame(FRAME).places[:, :2], np.zeros(8)])
    rng = np.random.default_rng(6)
    hostile = {
        "bent": shifted([2, 3, 4, 5], (0, 0, 0.2)),
        "larger": 1e-3 * places,
        "smaller": -1e-2 * places,
        "much larger": 0.3 * places,
        "mirrored": places * (-2, 0, 0),
        "another": rng.normal(0, 10, (8, 3)),
    }
    for name, moved in hostile.items():
        day = settled()
        for at_s in range(20, 28):
            report = day.expose(float(at_s), moved=moved)[1]
            assert not report.valid, (name, at_s, report)
    day = settled()
    assert "larger than the one that was taught" in day.expose(20.0, moved=1e-2 * places)[1].why


def test_a_plate_that_was_turned_is_taken_for_a_rig_that_was() -> None:
    """A turned plate looks like a moved rig, and the report names both."""
    places = np.column_stack([parse_frame(FRAME).places[:, :2], np.zeros(8)])
    turned = places @ rotation_matrix(np.array([0, 0, 0.01])).T - places
    assert "or the plate" in settled().expose(20.0, moved=turned)[1].why


def test_without_a_plate_of_ours_other_codes_are_named() -> None:
    """If only other codes are seen, there is no result, and they are named."""
    day = settled()
    nothing = DotsInPair(np.full((2, 8, 2), np.nan), np.full((2, 8), np.nan), strange=(100, 101))
    _, report = day.filter.updated(day.track, nothing)
    assert (MarksState.CONTRADICTED, False) == (report.state, report.valid)
    assert "codes 100, 101" in report.why


def test_after_a_contradiction_the_track_is_as_it_was() -> None:
    """After a contradiction the track is as before, and the next exposure is corrected."""
    day = settled()
    before = day.track
    day.expose(20.0, moved=np.random.default_rng(1).normal(0, 5, (8, 3)))
    assert day.track.displacement == pytest.approx(before.displacement, rel=1e-4)
    assert day.expose(21.0)[1].state is MarksState.CORRECTED


def test_a_rough_exposure_counts_less() -> None:
    """An exposure with ten times the sigma of the dots moves the track much less."""
    day = settled(exposures=2)
    pixels = day.taught.pixels + 0.05
    ahead = day.filter.predicted(day.track, day.track.exposed_ns + 10**9)
    fine, rough = (
        day.filter.updated(ahead, DotsInPair(pixels, np.full((2, 8), sigma)))[0] for sigma in (0.05, 0.5)
    )
    moved = [np.linalg.norm((t.displacement - ahead.displacement)[[0, 1, 7, 8]]) for t in (fine, rough)]
    assert moved[1] < 0.3 * moved[0]


def test_the_settings_say_what_is_believed_of_the_plate() -> None:
    """With aluminium, which grows twice as much as steel, sigma at the rim is larger."""
    steel, aluminium = (new_day(5, material=name) for name in ("steel", "aluminium"))
    sigmas = []
    for day in (steel, aluminium):
        for at_s in range(5):
            day.expose(float(at_s))
        points = np.array([[37.0, 26.0, 207.9]])
        slopes = shift_by_displacement(day.weather.rig, correction_of(day.track), points)[0]
        sigmas.append(np.sqrt(np.diag(slopes @ day.track.covariance @ slopes.T)[0]))
    assert sigmas[1] > 1.2 * sigmas[0]
    assert MARKS.consistent == 3
    assert replace(steel.settings, heals=False) != steel.settings
