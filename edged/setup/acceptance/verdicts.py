"""Tests of an acceptance: their limits, figures and verdicts.

Modelled on ASTM E2919 (poses) and VDI/VDE 2634-1 (lengths); their texts were not at hand, and no conformity
is claimed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.setup.trials.stilltest import StillResult
from edged.vision.geometry.rigid import apply, fit_rigid, rotation_vector, skew

LEAST_POSES = 30
LEAST_LENGTHS = 7
LEAST_TOUCHED = 10
LEAST_STILL = 50
POSE_UM, POSE_DEG = 10.0, 0.02
"""Limits on the 95 % quantile of the errors of poses."""
HONEST = 2.0
"""Largest chi² per degree of freedom; for 30 poses it exceeds 1.6 by chance in 1 of 1000 cases.

A small value proves nothing: for a part that only shifts, as on a stage, much of the error is the same in all
places.
"""
LENGTH_UM, LENGTH_PER = 5.0, 20_000.0
"""Largest error of a length L: LENGTH_UM + L / LENGTH_PER."""


@dataclass(frozen=True, slots=True)
class AcceptanceTest:
    """One test. good : None if undecided. why : reason if it is not good. figures : for people, by name."""

    name: str
    good: bool | None
    why: str
    figures: Mapping[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class PlacedPoses:
    """Poses of one part in several places, as measured. names : of the pairs.

    rig_from_part (N, 4, 4). own (N, 3, 3) : independent part of the position's covariance, mm².
    moved (N, 3, P) : Jacobian of each position by the rig's parameters. parameters (P, P) : their covariance.
    circles (N, M, 3) : centres of the circles in the part's own frame, mm; M may be 0.
    """

    names: tuple[str, ...]
    rig_from_part: FloatArray
    own: FloatArray
    moved: FloatArray
    parameters: FloatArray
    circles: FloatArray


def without(test: AcceptanceTest, missing: Mapping[str, str]) -> AcceptanceTest:
    """Add the pairs that do not count, by name and reason, to a test: a part that is not found fails it."""
    if not missing:
        return test
    lost = f"{len(missing)} pairs do not count: " + ", ".join(
        f"{name} ({why})" for name, why in list(missing.items())[:3]
    )
    good = None if test.good is None else False
    return AcceptanceTest(test.name, good, f"{test.why}; {lost}" if test.why else lost, test.figures)


def pose_test(placed: PlacedPoses, truth_mm: FloatArray | None, truth_sigma_mm: float) -> AcceptanceTest:
    """Test poses of a part in many places. truth_mm (N, 3) : positions by a stage; None to test the shape.

    The stage only translates: its frame is fitted to the same poses, and all rotations must be equal. Without
    it, the distances between the part's circles are compared with their means.
    """
    count = len(placed.names)
    if count < LEAST_POSES:
        return AcceptanceTest("pose", None, f"{count} poses with a good part, {LEAST_POSES} are needed", {})
    return _by_stage(placed, truth_mm, truth_sigma_mm) if truth_mm is not None else _by_shape(placed)


def _by_stage(placed: PlacedPoses, truth_mm: FloatArray, truth_sigma_mm: float) -> AcceptanceTest:
    places = placed.rig_from_part[:, :3, 3]
    covariance = _joint(placed) + truth_sigma_mm**2 * np.eye(3 * len(places))
    errors, chi2 = _misfit(places, truth_mm, covariance)
    away_um = 1e3 * float(np.quantile(np.linalg.norm(errors, axis=1), 0.95))
    turns = placed.rig_from_part[:, :3, :3]
    mean = turns.mean(axis=0)
    left, _, right = np.linalg.svd(mean)
    mean = left @ right
    degrees = [float(np.degrees(np.linalg.norm(rotation_vector(turn @ mean.T)))) for turn in turns]
    turned_deg = float(np.quantile(degrees, 0.95))
    wrong = []
    if away_um > POSE_UM:
        wrong.append(f"places are off by {away_um:.1f} um, at most {POSE_UM:g} are good")
    if turned_deg > POSE_DEG:
        wrong.append(f"turns are off by {turned_deg:.3f} degrees, at most {POSE_DEG:g} are good")
    if chi2 > HONEST:
        wrong.append(f"chi2 is {chi2:.2f}, at most {HONEST:g} is honest")
    return AcceptanceTest(
        "pose",
        not wrong,
        "; ".join(wrong),
        {
            "poses": f"{len(places)}",
            "truth": f"a stage, known to {1e3 * truth_sigma_mm:g} um",
            "error of 95 %": f"{away_um:.1f} um, {turned_deg:.4f} degrees",
            "largest": f"{1e3 * np.linalg.norm(errors, axis=1).max():.1f} um, {max(degrees):.4f} degrees",
            "chi2 per degree of freedom": f"{chi2:.2f}",
        },
    )


def _joint(placed: PlacedPoses) -> FloatArray:
    """Joint covariance (3 N, 3 N) of all positions, which share the rig's parameters."""
    count = len(placed.own)
    moved = placed.moved.reshape(3 * count, -1)
    joint = moved @ placed.parameters @ moved.T
    for index, own in enumerate(placed.own):
        joint[3 * index : 3 * index + 3, 3 * index : 3 * index + 3] += own
    return np.asarray(joint)


def _misfit(places: FloatArray, truth: FloatArray, covariance: FloatArray) -> tuple[FloatArray, float]:
    """Errors (N, 3) of places fitted to the truth, and chi² per degree of freedom of the best fit by their
    joint covariance, which accounts for shared errors."""
    fit = fit_rigid(places, truth)
    errors = apply(fit.to_from_source, places) - truth
    # one weighted step from the fit, in the frame of the places
    back = (truth - fit.to_from_source[:3, 3]) @ fit.to_from_source[:3, :3]
    gaps = (places - back).ravel()
    centred = back - back.mean(axis=0)
    motions = np.concatenate([np.tile(np.eye(3), (len(places), 1, 1)), -skew(centred)], axis=2).reshape(-1, 6)
    weighed = np.linalg.solve(covariance, np.column_stack([motions, gaps]))
    step = np.linalg.solve(motions.T @ weighed[:, :6], motions.T @ weighed[:, 6])
    rest = gaps - motions @ step
    chi2 = float(rest @ np.linalg.solve(covariance, rest)) / (len(gaps) - 6)
    return errors, chi2


def _by_shape(placed: PlacedPoses) -> AcceptanceTest:
    first, second = np.triu_indices(placed.circles.shape[1], 1)
    if not len(first):
        return AcceptanceTest(
            "pose", None, "one circle has no shape to compare: give a stage's places (truth.csv)", {}
        )
    apart = np.linalg.norm(placed.circles[:, first] - placed.circles[:, second], axis=2)
    errors_um = 1e3 * np.abs(apart - apart.mean(axis=0))
    away_um = float(np.quantile(errors_um, 0.95))
    good = away_um <= POSE_UM
    return AcceptanceTest(
        "pose",
        good,
        "" if good else f"distances in the part vary by {away_um:.1f} um, at most {POSE_UM:g} are good",
        {
            "poses": f"{len(placed.names)}",
            "truth": f"the same part: {len(first)} distances between its circles",
            "deviation of 95 %": f"{away_um:.1f} um",
            "largest": f"{errors_um.max():.1f} um",
        },
    )


def length_test(names: Sequence[str], measured_mm: FloatArray, true_mm: float) -> AcceptanceTest:
    """Test measurements of a bar of known length in several positions. measured_mm (N,)."""
    if len(names) < LEAST_LENGTHS:
        return AcceptanceTest(
            "length", None, f"{len(names)} positions measured, {LEAST_LENGTHS} are needed", {}
        )
    errors_um = 1e3 * (measured_mm - true_mm)
    limit_um = LENGTH_UM + 1e3 * true_mm / LENGTH_PER
    worst = int(np.argmax(np.abs(errors_um)))
    good = bool(abs(errors_um[worst]) <= limit_um)
    why = "" if good else f"{names[worst]}: {errors_um[worst]:+.1f} um, at most {limit_um:.1f} are good"
    return AcceptanceTest(
        "length",
        good,
        why,
        {
            "length": f"{true_mm:g} mm in {len(names)} positions",
            "mean error": f"{errors_um.mean():+.1f} um",
            "largest error": f"{errors_um[worst]:+.1f} um ({names[worst]})",
            "limit": f"{limit_um:.1f} um",
        },
    )


def robot_test(
    expected_mm: FloatArray, shared: FloatArray, touched_mm: FloatArray, robot_sigma_mm: float
) -> AcceptanceTest:
    """Test expected points against the robot's positions when it touched them; (N, 3) in the robot's frame.

    shared (3 N, 3 N) : covariance of the expected points, which share registration and calibration.
    robot_sigma_mm : stated sigma of one touch by the robot.
    """
    count = len(touched_mm)
    if count < LEAST_TOUCHED:
        return AcceptanceTest("robot", None, f"{count} points touched, {LEAST_TOUCHED} are needed", {})
    gaps = touched_mm - expected_mm
    both = shared + robot_sigma_mm**2 * np.eye(gaps.size)
    chi2 = float(gaps.ravel() @ np.linalg.solve(both, gaps.ravel())) / gaps.size
    rms_um = 1e3 * math.sqrt(float(np.mean(np.sum(gaps**2, axis=1))))
    good = chi2 <= HONEST
    return AcceptanceTest(
        "robot",
        good,
        ""
        if good
        else f"chi2 is {chi2:.2f}, at most {HONEST:g}: the robot or the registration is not as stated",
        {
            "points": f"{count}",
            "rms": f"{rms_um:.0f} um",
            "largest": f"{1e3 * np.linalg.norm(gaps, axis=1).max():.0f} um",
            "expected": f"{1e3 * math.sqrt(3 * float(np.mean(np.diag(both)))):.0f} um rms",
            "chi2 per coordinate": f"{chi2:.2f}",
        },
    )


def still_verdict(result: StillResult) -> AcceptanceTest:
    """Test pictures of a part that does not move: its scatter must be as stated."""
    if result.pictures < LEAST_STILL:
        return AcceptanceTest("still", None, f"{result.pictures} pictures, {LEAST_STILL} are needed", {})
    if result.scatter_mm is None or result.edges_mm is None:
        return AcceptanceTest("still", None, "the part is not in all of the pictures", {})
    words = {
        "larger": "it scatters more than is stated",
        "smaller": "it scatters less than its noise explains",
        "moving": "the part or a camera moved",
    }
    why = words.get(result.verdict, "")
    return AcceptanceTest(
        "still",
        not why,
        why,
        {
            "pictures": f"{result.pictures}",
            "scatter X Y Z": " ".join(f"{1e3 * value:.2f}" for value in result.scatter_mm) + " um",
            "stated": " ".join(f"{1e3 * value:.2f}" for value in result.edges_mm) + " um",
            "chi2": "-"
            if result.chi2 is None
            else f"{result.chi2:.2f}, {result.expected[0]:.2f} to {result.expected[1]:.2f} is honest",
        },
    )
