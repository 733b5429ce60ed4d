#!/usr/bin/env python3
"""Measure whether a cell with reference marks stays accurate.

    tools/bench weather [--seeds N] [--only WHAT] [--draws N]

A virtual cell with weather (`edged/sim/weather.py`), whose truth is exact. Dots are computed where the true
cameras see them, with noise and an error that depends on the sub-pixel position of each; no picture is drawn,
except for `rendered` and `dirt`. A part of 28 mm is judged, anywhere in 60 x 45 x 30 mm around the marks.

day       24 h of +-10 K: error of a part with and without marks, rms and largest, and chi² per hour.
knocks    0.2 mm and 1 mrad, of one camera and of the rig, once in each draw, at random hours of a day:
          exposures until results come again, results beyond 4 sigma, and the same while marks are hidden.
hidden    6 of 8 marks covered for an hour, at the steepest hour: sigma before and after, error in sigmas.
limits    one mark moved, half of the plate bent, another plate, a larger one, all covered.
rendered  noise and error of dots in drawn pictures.
dirt      chips of steel and drops of oil on the marks in drawn pictures: dots seen, results, and their error.
robot     a robot that is off by about 0.5 mm, with play: touched points, with and without a map of its error.
looks     that robot with the cameras on its flange: its tool at the part after one look, and after a second
          from the approach.
price     ms of the filter, and the sigma that a correction adds to a part: it knows the range, not the drift;
          beside the sigma of the calibration alone.
"""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from bench_accept import calibrated
from benching import bench_parser, finish
from helpers.markedday import FRAME, MIDDLE, NOISE_PX, SWING_K, chi2, new_day, rim_mm

from edged.domain.arrays import SIDES, FloatArray
from edged.robot.handeye import hand_eye
from edged.robot.picking import frame_of
from edged.robots.registervalues import SHIFTS_MM, TURNS_DEG
from edged.setup.registration.registering import from_points
from edged.sim.arm import ErringArm
from edged.sim.cell import demo_rig
from edged.sim.dirt import oiled, swarf
from edged.sim.marksplate import marks_plate
from edged.sim.render.scene import PlacedPart, Scene, Surface, Table
from edged.sim.views import stereo_views
from edged.sim.weather import DAY_S, Knock
from edged.vision.geometry.correction import shift_by_displacement
from edged.vision.geometry.rigid import apply, invert, rotation_matrix, skew, transform
from edged.vision.geometry.uncertainty import calibration_covariance
from edged.vision.marks.frame import parse_frame
from edged.vision.marks.measuring import measure_marks
from edged.vision.marks.observing import DotsInPair
from edged.vision.marks.params import MARKS
from edged.vision.marks.taught import TaughtMarks, teach_marks
from edged.vision.marks.tracking import MarksFilter, MarksSettings, correction_of

HOUR_S = 3600.0


# --- 24 hours ---------------------------------------------------------------------------------------------


def days(seeds: int, period_s: float = 20.0) -> dict[str, float]:
    """Print errors with and without marks, and chi² of each hour."""
    with_marks, without, hours = [], [], np.zeros((seeds, 24))
    states: dict[str, int] = {}
    for seed in range(seeds):
        day, squares = new_day(seed), [[] for _ in range(24)]
        for at_s in np.arange(period_s, DAY_S, period_s):
            cameras, report = day.expose(float(at_s))
            states[report.state.name] = states.get(report.state.name, 0) + 1
            error, plain, stated = day.part(cameras)
            with_marks.append(error)
            without.append(plain)
            squares[int(at_s // HOUR_S)].append(chi2(error, stated))
        hours[seed] = [np.mean(some) for some in squares]
    with_marks, without = 1e3 * np.array(with_marks), 1e3 * np.array(without)

    def line(name: str, errors: FloatArray) -> None:
        rms = np.sqrt(np.mean(errors**2, axis=0))
        print(
            f"| {name} | {rms[0]:.2f} | {rms[1]:.2f} | {rms[2]:.2f} | {np.sqrt(np.mean(errors**2)):.2f} "
            f"| {np.abs(errors).max():.1f} |"
        )

    print(f"\n24 h of +-{SWING_K:g} K, an exposure each {period_s:g} s, {seeds} seeds; µm\n")
    print("| | X rms | Y rms | Z rms | all rms | largest |")
    print("|---|---|---|---|---|---|")
    line("with marks", with_marks)
    line("without", without)
    pooled = hours.mean(axis=0)
    print("\nchi² per degree of freedom, hour by hour, mean of the seeds:")
    print(" ".join(f"{value:.2f}" for value in pooled))
    print(
        f"least {pooled.min():.2f}, most {pooled.max():.2f}, "
        f"of a seed alone {hours.min():.2f} to {hours.max():.2f}"
    )
    print("states:", ", ".join(f"{name} {count}" for name, count in sorted(states.items())))
    return {
        "rms_um": float(np.sqrt(np.mean(with_marks**2))),
        "without_um": float(np.sqrt(np.mean(without**2))),
    }


# --- knocks -----------------------------------------------------------------------------------------------


def knocks(draws: int) -> dict[str, object]:
    """Print how soon results come again after a knock, and how wrong each of them is."""
    healed, refused, valid, worst = [], 0, 0, []
    hidden_valid = 0
    for draw in range(draws):
        rng = np.random.default_rng((draw, 52))
        at_s = float(rng.uniform(0, DAY_S))
        hit = ("left", "right", "rig")[draw % 3]
        shift, turn = (0.2 * _direction(rng), 0 * _direction(rng))
        if draw % 2:
            shift, turn = 0 * shift, 1e-3 * _direction(rng)
        knock = Knock(at_s, hit, tuple(shift.tolist()), tuple(turn.tolist()))
        day = new_day(draw, knock)
        hidden = list(rng.permutation(8)[:4]) if draw % 10 == 9 else []
        for before in range(6, 0, -1):
            day.expose(at_s - before)
        again = None
        for number in range(8):
            cameras, report = day.expose(at_s + number, hidden)
            if not report.valid:
                continue
            again = number if again is None else again
            error, _, stated = day.part(cameras)
            worst.append(float((np.abs(error) / np.sqrt(np.diag(stated))).max()))
            valid += 1
        if hidden:
            hidden_valid += again is not None
        elif again is None:
            refused += 1
        else:
            healed.append(again)
    counts = np.bincount(healed, minlength=8)
    beyond = int(np.sum(np.array(worst) > 4.0))
    print(f"\n{draws} knocks of 0.2 mm or 1 mrad, of the left camera, the right one and the rig in turn\n")
    print(
        "| exposures without results | 0 | 1 | 2 | 3 | 4 | 5 | more | never |\n"
        "|---|---|---|---|---|---|---|---|---|"
    )
    print(f"| draws | {' | '.join(map(str, counts[:6]))} | {counts[6:].sum()} | {refused} |")
    print(f"with 4 of 8 marks hidden at the knock: results in {hidden_valid} of {draws // 10} draws")
    print(
        f"{valid} results after knocks, {beyond} with a coordinate beyond 4 sigma, farthest {max(worst):.2f}"
    )
    return {"counts": counts.tolist(), "never": refused, "beyond": beyond, "valid": valid}


def _direction(rng: np.random.Generator) -> FloatArray:
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)


# --- hidden marks -----------------------------------------------------------------------------------------


def hidden_hour(seeds: int, hidden: int = 6) -> dict[str, object]:
    """Print sigma and error while marks are covered for the hour of the steepest warming."""
    seeds *= 10
    rows: dict[int, list[FloatArray]] = {}
    states: dict[str, int] = {}
    for seed in range(seeds):
        day = new_day(seed)
        rng = np.random.default_rng((seed, 53))
        covered = list(rng.permutation(8)[:hidden])
        for at_s in np.arange(-600.0, 0.0, 20.0):
            day.expose(1.0 * HOUR_S + at_s)
        for at_s in np.arange(0.0, HOUR_S + 1.0, 20.0):
            cameras, report = day.expose(HOUR_S + float(at_s), covered)
            states[report.state.name] = states.get(report.state.name, 0) + 1
            if at_s % 900 == 0:
                for _ in range(4):
                    error, _, stated = day.part(cameras)
                    rows.setdefault(int(at_s // 60), []).append(
                        np.array([*(1e3 * np.sqrt(np.diag(stated))), *(error / np.sqrt(np.diag(stated)))])
                    )
    print(f"\n{hidden} of 8 marks covered for an hour, {seeds} seeds\n")
    print(
        "| minutes | sigma X | Y | Z, µm | error/sigma X rms | Y | Z | largest |\n"
        "|---|---|---|---|---|---|---|---|"
    )
    for minute, some in rows.items():
        table = np.array(some)
        sigma, ratio = table[:, :3].mean(axis=0), np.sqrt(np.mean(table[:, 3:] ** 2, axis=0))
        cells = [f"{value:.2f}" for value in (*sigma, *ratio, np.abs(table[:, 3:]).max())]
        print(f"| {minute} | {' | '.join(cells)} |")
    print("states:", ", ".join(f"{name} {count}" for name, count in sorted(states.items())))
    return {"states": states}


# --- hostile plates ---------------------------------------------------------------------------------------


def limits() -> dict[str, object]:
    """Print the results for plates that differ from the taught one."""

    def shifted(marks: Sequence[int], mm: Sequence[float]) -> FloatArray:
        moved = np.zeros((8, 3))
        moved[list(marks)] = mm
        return moved

    places = np.column_stack([parse_frame(FRAME).places[:, :2], np.zeros(8)])
    turned = places @ rotation_matrix(np.array([0, 0, 0.01])).T - places
    cases: dict[str, tuple[Sequence[int], FloatArray | None]] = {
        "all as taught": ((), None),
        "one mark moved by 0.1 mm": ((), shifted([2], (0.1, 0, 0))),
        "two marks moved by 0.1 mm": ((), shifted([2, 5], (0.1, 0, 0))),
        "half of the plate bent by 0.2 mm": ((), shifted([2, 3, 4, 5], (0, 0, 0.2))),
        "the plate turned by 10 mrad": ((), turned),
        "another plate, larger by 0.1 %": ((), 1e-3 * places),
        "another plate, larger by 1 %": ((), 1e-2 * places),
        "another plate, larger by 10 %": ((), 1e-1 * places),
        "mirrored": ((), places * (-2, 0, 0)),
        "5 of 8 covered": ((0, 1, 2, 3, 4), None),
        "all covered": (tuple(range(8)), None),
    }
    print(
        "\n| plate | states of 8 exposures | results | excluded | error, µm | sigma, µm |\n"
        "|---|---|---|---|---|---|"
    )
    said: dict[str, object] = {}
    for name, (hidden, moved) in cases.items():
        day = new_day(0)
        for at_s in range(20):
            day.expose(float(at_s))
        reports, errors, sigmas = [], [], []
        for at_s in range(20, 28):
            cameras, report = day.expose(float(at_s), hidden, moved)
            reports.append(report)
            if report.valid:
                error, _, stated = day.part(cameras)
                errors.append(np.abs(error).max())
                sigmas.append(np.sqrt(np.diag(stated).max()))
        states = " ".join(report.state.name[:6] for report in reports)
        valid = sum(report.valid for report in reports)
        excluded = sorted({code for report in reports for code in report.excluded})
        largest = f"{1e3 * max(errors):.1f} | {1e3 * max(sigmas):.1f}" if errors else "- | -"
        print(f"| {name} | {states} | {valid} of 8 | {excluded or '-'} | {largest} |")
        said[name] = {"valid": valid, "states": states}
    return said


# --- pictures ---------------------------------------------------------------------------------------------


def rendered(places: int = 12) -> dict[str, float]:
    """Print noise and error of dots in drawn pictures; the plate is shifted by fractions of a pixel."""
    rng, own = np.random.default_rng(54), own_places()
    views = stereo_views(demo_rig())
    taught = drawn_teaching()
    errors, clean = [], []
    for number in range(places):
        turn = rotation_matrix(rng.normal(0, 5e-4, 3))
        moved = transform(turn, MIDDLE + rng.uniform(-0.1, 0.1, 3))
        truth = [views[side].project(apply(moved, own)) for side in SIDES]
        for noise, into in ((number, errors), (None, clean)):
            for image, look, true in zip(drawn(moved, noise), taught.looks, truth, strict=True):
                into.append(measure_marks(image, look, true + rng.normal(0, 0.3, true.shape)).pixels - true)
    errors, clean = np.array(errors), np.array(clean)
    seen = np.isfinite(errors).all(axis=-1).mean()
    print(f"\nDots of 2 mm in drawn pictures, {places} places: {100 * seen:.1f} % measured")
    print(f"error rms {np.sqrt(np.nanmean(errors**2)):.4f} px, largest {np.nanmax(np.abs(errors)):.4f}")
    print(f"without sensor noise rms {np.sqrt(np.nanmean(clean**2)):.4f} px")
    return {"rms_px": float(np.sqrt(np.nanmean(errors**2))), "clean_px": float(np.sqrt(np.nanmean(clean**2)))}


def own_places() -> FloatArray:
    """Positions (8, 3) of the marks on their plate."""
    places = parse_frame(FRAME).places
    return np.column_stack([places[:, :2], np.zeros(len(places))])


def drawn(rig_from_frame: FloatArray, noise: int | None, *more: PlacedPart) -> list:
    """Both pictures of the plate and further objects on a table. noise : its seed; None: without."""
    floor = transform(np.eye(3), np.add(MIDDLE, (0, 0, 1.1)))
    table = Table(Surface(albedo=0.16, contrast=0.25, feature_mm=0.6, seed=2), floor)
    scene = Scene(table, (PlacedPart(marks_plate(parse_frame(FRAME)), rig_from_frame), *more))
    views = stereo_views(demo_rig())
    return [
        views[side].render(scene, None if noise is None else np.random.default_rng((noise, index)))
        for index, side in enumerate(SIDES)
    ]


@cache
def drawn_teaching() -> TaughtMarks:
    """Marks as taught from drawn pictures."""
    at = transform(np.eye(3), MIDDLE)
    return teach_marks((drawn(at, k) for k in range(MARKS.min_exposures)), demo_rig(), 1)


def dirt(scenes: int = 12) -> list[dict[str, object]]:
    """Print the effect of chips and oil on marks on dots, and on a part, where nothing has moved."""
    taught, at = drawn_teaching(), transform(np.eye(3), MIDDLE)
    true = np.stack([stereo_views(demo_rig())[side].project(apply(at, own_places())) for side in SIDES])
    filter_ = MarksFilter(taught, MarksSettings())
    part = MIDDLE + rim_mm() - (0.0, 0.0, 10.0)
    print(f"\n{scenes} drawn pairs a line: dirt on so many of 8 marks; a part of 28 mm above their middle\n")
    print("| dirt | dots seen | error px rms | largest | states | excluded | part: error µm | in sigma |")
    print("|---|---|---|---|---|---|---|---|")
    rows = []
    for kind, count in (("none", 0), *itertools.product(("swarf", "oil"), (2, 4, 8))):
        off, errors, ratios, states, excluded = [], [], [], {}, 0
        for number in range(scenes):
            rng = np.random.default_rng((number, count, len(kind)))
            hit = rng.permutation(8)[:count]
            chips = swarf(rng, at, own_places()[hit]) if kind == "swarf" else ()
            images = drawn(at, 900 + number, *chips)
            if kind == "oil":
                images = [
                    oiled(image, places[hit] + rng.normal(0, 8, (count, 2)), 45.0)
                    for image, places in zip(images, true, strict=True)
                ]
            track = filter_.predicted(filter_.begin(), 10**9)
            dots, track = filter_.look(track, *images)
            track, report = filter_.updated(track, dots)
            off.append(dots.pixels - true)
            states[report.state.name] = states.get(report.state.name, 0) + 1
            excluded += len(report.excluded)
            if report.valid:
                slopes = shift_by_displacement(demo_rig(), correction_of(track), part).mean(axis=0)
                errors.append(slopes @ track.displacement)
                ratios.append(np.abs(errors[-1]) / np.sqrt(np.diag(slopes @ track.covariance @ slopes.T)))
        off = np.array(off)
        seen = 100 * np.isfinite(off).all(axis=-1).mean()
        row = {
            "dirt": kind,
            "marks": count,
            "seen": seen,
            "rms_px": float(np.sqrt(np.nanmean(off**2))),
            "largest_px": float(np.nanmax(np.abs(off))),
            "states": states,
            "excluded": excluded,
            "part_um": 1e3 * float(np.abs(errors).max()) if errors else None,
            "sigmas": float(np.max(ratios)) if ratios else None,
        }
        said = ", ".join(f"{name} {times}" for name, times in sorted(states.items()))
        far = f"{row['part_um']:.1f} | {row['sigmas']:.2f}" if errors else "- | -"
        print(
            f"| {kind} {count or ''} | {seen:.0f} % | {row['rms_px']:.4f} | {row['largest_px']:.3f} | {said} "
            f"| {excluded} | {far} |"
        )
        rows.append(row)
    return rows


# --- a robot's error -------------------------------------------------------------------------------------


ROBOT_FROM_RIG = transform(rotation_matrix(np.array([np.pi, 0.0, 0.0])), np.array([560.0, -90.0, 260.0]))
REPEATS_MM, SEEN_MM = 0.02, 0.003
"""Repeatability of the robot, and of the cameras' measurement of its tip; one sigma."""


def robots(seeds: int, each: int = 20, places: int = 50) -> list[dict[str, object]]:
    """Print distances of robots from parts, and from a taught path, with and without a map of their error."""
    print(
        f"\n{seeds * each} robots a line, off by about 0.5 mm, repeating to {1e3 * REPEATS_MM:g} um; rms of "
        "all axes, um.\nPlay: of each axis, at half a metre. A golden part was taught in the same volume\n\n"
        "| volume mm | play | points | degree | robot itself | registration | with map | golden part "
        "| with map | chi² | chi² with map | beyond, refused |\n" + "|---" * 12 + "|"
    )
    rows = []
    small, large = (60.0, 45.0, 30.0), (400.0, 300.0, 150.0)
    for volume, play_mm, count in (
        (small, 0.0, 12),
        (small, 0.05, 12),
        (large, 0.0, 12),
        (large, 0.0, 24),
        (large, 0.0, 48),
        (large, 0.05, 24),
    ):
        found = [_one_robot(seed, volume, play_mm, count, places) for seed in range(seeds * each)]
        off, alone, mapped, golden, golden_mapped = (
            1e3 * np.sqrt(np.mean(np.concatenate([getattr(one, name) for one in found]) ** 2))
            for name in ("off", "alone", "mapped", "golden", "golden_mapped")
        )
        chi2s = [np.nanmean([getattr(one, name) for one in found]) for name in ("chi2", "chi2_mapped")]
        degrees = np.bincount([one.degree for one in found], minlength=4)
        beyond = f"{sum(one.refused for one in found)} of {sum(one.beyond for one in found)}"
        print(
            f"| {' x '.join(f'{mm:g}' for mm in volume)} | {play_mm:g} | {count} "
            f"| {' '.join(map(str, degrees))} "
            f"| {off:.0f} | {alone:.0f} | {mapped:.0f} | {golden:.0f} | {golden_mapped:.0f} "
            f"| {chi2s[0]:.2f} | {chi2s[1]:.2f} | {beyond} |"
        )
        rows.append(
            {"volume_mm": volume, "play_mm": play_mm, "points": count, "alone_um": alone, "mapped_um": mapped}
        )
    print(
        "degree: robots that got none (the registration is as good), and a map of degree 1, 2, 3; "
        "chi² with map: of those that got one"
    )
    return rows


@dataclass(frozen=True)
class _Robot:
    """Errors (N, 3) mm at places of parts: of the robot itself, with the registration alone, with its map."""

    off: FloatArray
    alone: FloatArray
    mapped: FloatArray
    golden: FloatArray
    golden_mapped: FloatArray
    chi2: float
    chi2_mapped: float
    degree: int
    refused: int
    beyond: int


def _one_robot(seed: int, volume: tuple[float, ...], play_mm: float, count: int, places: int) -> _Robot:
    rng = np.random.default_rng((seed, 78))
    arm, half = ErringArm.drawn(seed, backlash_mm=play_mm), np.array(volume) / 2
    corners = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    touched = np.concatenate([corners, rng.uniform(-1, 1, (count - 8, 3))]) * half + (0, 0, 200.0)
    parts = rng.uniform(-1, 1, (places, 3)) * half + (0, 0, 200.0)

    def shown(rig_mm: FloatArray) -> FloatArray:
        """Position that the robot shows there, approached from somewhere above."""
        said = []
        for place in apply(ROBOT_FROM_RIG, rig_mm):
            came = place + rng.uniform((-80, -80, 20), (80, 80, 120))
            said.append(arm.shown(place, came) + rng.normal(0, REPEATS_MM, 3))
        return np.array(said)

    def seen(rig_mm: FloatArray) -> FloatArray:
        return rig_mm + rng.normal(0, SEEN_MM, rig_mm.shape)

    solved = from_points(demo_rig(), seen(touched), shown(touched), 2.0, with_map=True)
    rig = solved.registered.rig
    frame, needed, own = frame_of(rig), shown(parts), seen(parts)
    alone = apply(rig.robot_from_rig, own)
    shifts = [frame.shift(place) for place in own]
    mapped = alone + [np.zeros(3) if shift is None else shift.shift_mm for shift in shifts]
    points, turned = alone[:, None], rig.registration_covariance
    lever = np.concatenate([np.tile(np.eye(3), (places, 1, 1)), -skew(points[:, 0])], axis=2)
    spread = lever @ turned @ lever.transpose(0, 2, 1) + SEEN_MM**2 * np.eye(3)
    chi2s = [chi2(*both) for both in zip(needed - alone, spread, strict=True)]
    of_map = [
        chi2(error, (shift.variance_mm2 + SEEN_MM**2) * np.eye(3)) if shift is not None else alone_too
        for error, shift, alone_too in zip(needed - mapped, shifts, chi2s, strict=True)
    ]
    outside = np.array([[0, 0, 200.0]]) + 1.5 * half * corners
    is_mapped = rig.robot_map is not None
    return _Robot(
        shown(parts) - apply(ROBOT_FROM_RIG, parts),
        needed - alone,
        needed - mapped,
        (needed - needed[0] - alone + alone[0])[1:],
        (needed - needed[0] - mapped + mapped[0])[1:],
        float(np.mean(chi2s)),
        float(np.mean(of_map)) if is_mapped else np.nan,
        rig.robot_map.degree if is_mapped else 0,
        sum(not frame.is_mapped(place) for place in outside) if is_mapped else 0,
        len(outside) if is_mapped else 0,
    )


# --- look, move, look -------------------------------------------------------------------------------------


TIP = transform(np.eye(3), np.array([0.0, 0.0, 180.0]))
BACK_MM, COMES_MM = 60.0, 30.0
AHEAD_MM = 240.0
"""Distance from the flange to the point the cameras look at, where the part lies at the approach."""
SEEN_RAD = 1e-4


def looks(seeds: int, each: int = 10, places: int = 30) -> list[dict[str, object]]:
    """Print the tool's distance from parts after one look and after two, with cameras on the flange."""
    print(
        f"\n{seeds * each} robots a line, {places} parts each in 400 x 300 x 60 mm, turned at will; error of "
        f"the tool at the part,\num rms of all axes (farthest). The second look is {BACK_MM:g} mm before the "
        f"part; along: the robot comes there\nalong its tool, from {COMES_MM:g} mm farther. Golden part: "
        "kept by a second look along, the path taught there\n\n"
        "| first look, mm farther | play mm | registered | robot itself | one look | two looks | two, along "
        "| two, along, golden part |\n" + "|---" * 8 + "|"
    )
    rows = []
    for away_mm, play_mm, exact in itertools.product((0.0, 300.0), (0.0, 0.05), (True, False)):
        found = np.concatenate([_looks_of(k, away_mm, play_mm, exact, places) for k in range(seeds * each)])
        rms = 1e3 * np.sqrt(np.mean(found**2, axis=(0, 2)))
        far = 1e3 * np.linalg.norm(found, axis=2).max(axis=0)
        cells = " | ".join(f"{one:.0f} ({farthest:.0f})" for one, farthest in zip(rms, far, strict=True))
        print(f"| {away_mm:g} | {play_mm:g} | {'exactly' if exact else 'by ten poses'} | {cells} |")
        rows.append({"away_mm": away_mm, "play_mm": play_mm, "exact": exact, "rms_um": rms.tolist()})
    return rows


def _looks_of(seed: int, away_mm: float, play_mm: float, exact: bool, places: int) -> FloatArray:
    """Distances (N, 5, 3) mm of one robot, with the columns of `looks`."""
    rng, arm = np.random.default_rng((seed, 79)), ErringArm.drawn(seed, backlash_mm=play_mm)
    turn, down = rotation_matrix(np.array([0.0, -0.48, 0.0])), rotation_matrix(np.array([np.pi, 0.0, 0.0]))
    mounted = transform(turn, (0.0, 0.0, AHEAD_MM) - turn @ MIDDLE)

    def stands(shown: FloatArray, before: FloatArray) -> FloatArray:
        return transform(np.eye(3), rng.normal(0, REPEATS_MM, 3)) @ arm.flange(shown, before)

    def back(pose: FloatArray, mm: float) -> FloatArray:
        return np.asarray(pose @ transform(np.eye(3), np.array([0.0, 0.0, -mm])))

    def seen(flange: FloatArray, part: FloatArray, farther_mm: float = 0.0) -> FloatArray:
        pose, sigma_mm = invert(flange @ mounted) @ part, SEEN_MM * (1 + farther_mm / AHEAD_MM) ** 2
        turned = rotation_matrix(rng.normal(0, SEEN_RAD, 3)) @ pose[:3, :3]
        return transform(turned, pose[:3, 3] + rng.normal(0, sigma_mm, 3))

    def somewhere() -> FloatArray:
        turned = rotation_matrix(np.array([0, 0, rng.uniform(-np.pi, np.pi)]))
        tilted = rotation_matrix(np.array([*rng.normal(0, 0.1, 2), 0]))
        return transform(tilted @ turned @ down, rng.uniform((360, -240, 30), (760, 60, 90)))

    board = transform(down, np.array([560.0, -90.0, 60.0]))
    walk = [
        board @ invert(transform(rotation_matrix(np.radians(turned)), MIDDLE + shift)) @ invert(mounted)
        for turned, shift in zip(TURNS_DEG, SHIFTS_MM, strict=True)
    ]
    views = [seen(stands(*both), board) for both in zip(walk, [walk[0], *walk], strict=False)]
    rig = mounted if exact else hand_eye(walk, views, 1.5 * own_places(), "eye-in-hand", hold_out=False).rig

    def looked(part: FloatArray) -> tuple[list[FloatArray], FloatArray]:
        """Part by one look, by two, and by two along the tool; and the flange's pose at the second look."""
        home = transform(down, part[:3, 3] + (*rng.uniform(-30, 30, 2), AHEAD_MM + away_mm))
        first = home @ rig @ seen(stands(home, back(home, 100.0)), part, away_mm)
        approach = back(first, BACK_MM) @ invert(TIP)
        second = [
            approach @ rig @ seen(stands(approach, came), part) for came in (home, back(approach, COMES_MM))
        ]
        return [first, *second], approach

    golden = somewhere()
    (*_, kept), approach = looked(golden)
    taught = golden
    for _ in range(4):
        taught = taught @ invert(arm.flange(taught @ invert(TIP), approach) @ TIP) @ golden
    errors = []
    for _ in range(places):
        part = somewhere()
        found, approach = looked(part)
        targets = [part, *found, found[-1] @ invert(kept) @ taught]
        tips = [stands(target @ invert(TIP), approach) @ TIP for target in targets]
        errors.append([tip[:3, 3] - part[:3, 3] for tip in tips])
    return np.array(errors)


# --- price ------------------------------------------------------------------------------------------------


def price() -> dict[str, object]:
    """Print the cost of marks: time, and sigma where nothing drifts."""
    day = new_day(0)
    for at_s in range(30):
        day.expose(float(at_s))
    pixels = day.dots(day.weather.at(30.0))
    dots = DotsInPair(pixels, np.full(pixels.shape[:2], NOISE_PX))
    times = []
    for k in range(300):
        begun = time.perf_counter()
        day.filter.updated(day.filter.predicted(day.track, round(31e9) + k), dots)
        times.append(1e3 * (time.perf_counter() - begun))
    filter_ms = float(np.median(times))
    print(f"\nfilter {filter_ms:.2f} ms of an exposure of 8 marks (median)")
    rig = calibrated("right", demo_rig())
    every = [np.diag(covariance) for covariance in calibration_covariance(rig, MIDDLE + rim_mm())]
    alone = 1e3 * np.sqrt(np.median(every, axis=0))
    print(f"\na part of a rig calibrated from 20 views has sigma {_three(alone)} um by that alone")
    print("| plate | range K | exposures | sigma that the correction adds, um | of it all, % |")
    print("|---|---|---|---|---|")
    rows = []
    cases = (("steel", 10, 30), ("steel", 10, 300), ("invar", 10, 30), ("steel", 2, 30))
    for material, swing_k, exposures in cases:
        day = new_day(0, material=material, swing_k=float(swing_k))
        for at_s in range(exposures):
            day.expose(float(at_s))
        cameras = day.weather.at(float(exposures))
        added = 1e3 * np.sqrt(np.median([np.diag(day.part(cameras)[2]) for _ in range(200)], axis=0))
        more = 100 * (np.hypot(alone, added) / alone - 1)
        print(f"| {material} | {swing_k} | {exposures} | {_three(added)} | {_three(more)} |")
        rows.append({"material": material, "range_k": swing_k, "sigma_um": added.tolist()})
    return {"filter_ms": filter_ms, "alone_um": alone.tolist(), "added": rows}


def _three(values: FloatArray) -> str:
    return " ".join(f"{value:.1f}" for value in values)


def main() -> None:
    """Run the requested parts."""
    parser = bench_parser(__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--draws", type=int, default=2000)
    works: dict[str, Callable[[], object]] = {
        "day": lambda: days(options.seeds),
        "knocks": lambda: knocks(options.draws),
        "hidden": lambda: hidden_hour(options.seeds),
        "limits": limits,
        "rendered": rendered,
        "dirt": dirt,
        "robot": lambda: robots(options.seeds),
        "looks": lambda: looks(options.seeds),
        "price": price,
    }
    parser.add_argument("--only", choices=tuple(works))
    options = parser.parse_args()
    figures = {name: work() for name, work in works.items() if options.only in (None, name)}
    finish(options, figures)


if __name__ == "__main__":
    sys.exit(main())
