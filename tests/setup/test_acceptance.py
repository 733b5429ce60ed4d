"""Acceptance tests and studies of a size: what is right passes, what is wrong does not, with a reason."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edged.domain.acceptance import NS_PER_DAY, Acceptance, AcceptanceState
from edged.domain.arrays import FloatArray
from edged.errors import FileFormatError, UserError
from edged.files.acceptance import acceptance_file, document_of, load_acceptance
from edged.files.atomic import write_file
from edged.report.acceptance import ReportedTest, acceptance_page, acceptance_pdf
from edged.setup.acceptance.measuring import crossed, read_truth
from edged.setup.acceptance.studies import capability, gauge_study, guard_bands
from edged.setup.acceptance.verdicts import (
    LEAST_POSES,
    PlacedPoses,
    length_test,
    pose_test,
    robot_test,
    still_verdict,
    without,
)
from edged.setup.trials.stilltest import StillResult
from edged.vision.geometry.rigid import apply, rotation_matrix, transform

STAGE = transform(rotation_matrix(np.array([0.3, -0.2, 2.0])), np.array([100.0, 5.0, -40.0]))


def placed(places: FloatArray, sigma_mm: float = 0.001, circles: FloatArray | None = None) -> PlacedPoses:
    """Poses of a part that is only shifted, with an exact calibration."""
    count = len(places)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 3] = places
    return PlacedPoses(
        tuple(f"p{k}" for k in range(count)),
        poses,
        np.tile(sigma_mm**2 * np.eye(3), (count, 1, 1)),
        np.zeros((count, 3, 1)),
        np.zeros((1, 1)),
        np.zeros((count, 0, 3)) if circles is None else circles,
    )


def places(rng: np.random.Generator) -> FloatArray:
    """Random positions of a stage."""
    return rng.uniform(-1, 1, (LEAST_POSES, 3)) * (30.0, 22.5, 15.0) + (0, 0, 205.0)


def test_poses_on_a_stage_pass_when_they_scatter_as_stated() -> None:
    """Whatever the stage's axes are, chi² is about 1, and 95 % of the poses are within 10 um."""
    rng = np.random.default_rng(1)
    true = places(rng)
    tested = pose_test(placed(true + rng.normal(0, 0.001, true.shape)), apply(STAGE, true), 0.0)
    assert tested.good, tested.why
    assert 0.6 < float(tested.figures["chi2 per degree of freedom"]) < 1.5


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (lambda p: p * 1.001, "places are off"),
        (lambda p: p * 1.0001, "chi2"),
        (lambda p: p + 1e-4 * (p - p.mean(axis=0)) ** 2, "places are off"),
    ],
)
def test_poses_of_a_wrong_scale_or_a_bent_space_do_not_pass(wrong: object, why: str) -> None:
    """A wrong board length, even if within 10 um, and a bent depth do not pass."""
    rng = np.random.default_rng(2)
    true = places(rng)
    measured = wrong(true) + rng.normal(0, 0.001, true.shape)
    tested = pose_test(placed(measured), apply(STAGE, true), 0.0)
    assert tested.good is False
    assert why in tested.why


def test_what_poses_share_counts_as_shared() -> None:
    """A scale error as large as the calibration's known uncertainty of 0.03 % passes; without it chi² is
    too large."""
    rng = np.random.default_rng(3)
    true = places(rng)
    shared = replace(placed(true * 1.0003), moved=(true - true.mean(axis=0))[..., None])
    known = replace(shared, parameters=np.array([[3e-4**2]]))
    assert "chi2" in pose_test(shared, true, 0.0001).why
    assert pose_test(known, true, 0.0001).good


def test_without_a_stage_the_part_is_its_own_witness() -> None:
    """Without a stage the distances between circles must be constant to pass; one circle gives no verdict."""
    rng = np.random.default_rng(4)
    true = places(rng)
    circles = np.tile(np.array([[0.0, 0, 0], [20, 0, 0], [0, 15, 0]]), (len(true), 1, 1))
    good = circles + rng.normal(0, 0.001, circles.shape)
    assert pose_test(placed(true, circles=good), None, 0.0).good
    deeper = circles * (1 + 1e-4 * (true[:, 2] - 205.0))[:, None, None]
    assert pose_test(placed(true, circles=deeper), None, 0.0).good is False
    assert pose_test(placed(true, circles=circles[:, :1]), None, 0.0).good is None


def test_a_turn_that_is_not_the_stages_is_named() -> None:
    """If the stage only shifts, turns of 0.1 degrees are named as errors."""
    rng = np.random.default_rng(5)
    true = places(rng)
    turned = placed(true)
    for pose in turned.rig_from_part:
        pose[:3, :3] = rotation_matrix(rng.normal(0, np.radians(0.1), 3))
    assert "turns are off" in pose_test(turned, true, 0.001).why


def test_lengths_pass_within_five_um_and_a_twenty_thousandth() -> None:
    """An error of 7 um at 40 mm passes; the worst position is named, and six positions are too few."""
    names = [f"p{k}" for k in range(7)]
    errors = np.array([0, 1, -2, 3, -6.9, 4, 0]) / 1000
    assert length_test(names, 40.0 + errors, 40.0).good
    tested = length_test(names, 40.0 + 1.1 * errors, 40.0)
    assert tested.good is False
    assert tested.why.startswith("p4: -7.6 um")
    assert length_test(names[:6], 40.0 + errors[:6], 40.0).good is None


def test_a_robot_with_backlash_does_not_pass() -> None:
    """A robot passes if its touches scatter as stated, fails with backlash, and has no verdict with nine
    points; an error that all points share does not count."""
    rng = np.random.default_rng(6)
    points = rng.uniform(-50, 50, (12, 3))
    shared = np.tile(0.2**2 * np.eye(3), (12, 12))  # all of them 0.2 mm beside it
    touched = points + np.array([0.2, -0.1, 0.1]) + rng.normal(0, 0.03, points.shape)
    assert robot_test(points, shared, touched, 0.03).good
    back = touched + 0.15 * np.sign(rng.normal(size=points.shape))
    assert robot_test(points, shared, back, 0.03).good is False
    assert robot_test(points[:9], shared[:27, :27], touched[:9], 0.03).good is None


def test_a_still_part_is_judged_by_its_scatter() -> None:
    """A true sigma passes; a larger scatter, a movement or too few pictures does not."""
    sigma = np.full(3, 0.001)
    result = StillResult("honest", 50, sigma, sigma, sigma, 1.0, (0.8, 1.2), True)
    assert still_verdict(result).good
    assert still_verdict(replace(result, verdict="larger")).good is False
    assert still_verdict(replace(result, verdict="moving", chi2=None)).why == "the part or a camera moved"
    assert still_verdict(replace(result, pictures=49)).good is None
    assert still_verdict(StillResult("vanished", 50, None, None, None, None, (0.8, 1.2))).good is None


def test_a_pair_without_the_part_fails_a_test_that_was_good() -> None:
    """A pair in which the part was not found fails a good test, and is named."""
    names = [f"p{k}" for k in range(7)]
    tested = without(length_test(names, np.full(7, 40.0), 40.0), {"p9": "no good part: NO_TARGET"})
    assert tested.good is False
    assert "p9 (no good part: NO_TARGET)" in tested.why


# --- studies ------------------------------------------------------------------------------------

AIAG = np.array(
    [
        [
            [0.29, -0.56, 1.34, 0.47, -0.80, 0.02, 0.59, -0.31, 2.26, -1.36],
            [0.41, -0.68, 1.17, 0.50, -0.92, -0.11, 0.75, -0.20, 1.99, -1.25],
            [0.64, -0.58, 1.27, 0.64, -0.84, -0.21, 0.66, -0.17, 2.01, -1.31],
        ],
        [
            [0.08, -0.47, 1.19, 0.01, -0.56, -0.20, 0.47, -0.63, 1.80, -1.68],
            [0.25, -1.22, 0.94, 1.03, -1.20, 0.22, 0.55, 0.08, 2.12, -1.62],
            [0.07, -0.68, 1.34, 0.20, -1.28, 0.06, 0.83, -0.34, 2.19, -1.50],
        ],
        [
            [0.04, -1.38, 0.88, 0.14, -1.46, -0.29, 0.02, -0.46, 1.77, -1.49],
            [-0.11, -1.13, 1.09, 0.20, -1.07, -0.67, 0.01, -0.56, 1.45, -1.77],
            [-0.15, -0.96, 0.67, 0.11, -1.45, -0.49, 0.21, -0.49, 1.87, -2.16],
        ],
    ]
)
"""(people, trials, parts): the well-known example of AIAG's manual."""


def test_a_gauge_study_gives_the_published_figures() -> None:
    """The published figures 0.200, 0.227, 0.302 and 1.042 come out by analysis of variance without
    interaction."""
    found = gauge_study(AIAG.transpose(2, 0, 1), 8.0)
    assert found.repeatability_mm == pytest.approx(0.19993, abs=2e-5)
    assert found.reproducibility_mm == pytest.approx(0.22684, abs=2e-5)
    assert found.grr_mm == pytest.approx(0.30237, abs=2e-5)
    assert found.part_mm == pytest.approx(1.04233, abs=2e-5)
    assert found.of_variation == pytest.approx(27.86, abs=0.01)
    assert (found.distinct, found.pooled) == (4, True)
    assert found.good is None  # 22.7 % of 8
    assert (
        gauge_study(AIAG.transpose(2, 0, 1), 2.0).good,
        gauge_study(AIAG.transpose(2, 0, 1), 30.0).good,
    ) == (False, True)


def test_an_interaction_counts_as_the_gauges() -> None:
    """If people differ part by part, that interaction counts as reproducibility of the gauge."""
    rng = np.random.default_rng(7)
    values = rng.normal(0, 1, (10, 1, 1)) + rng.normal(0, 0.3, (10, 3, 1)) + rng.normal(0, 0.01, (10, 3, 3))
    found = gauge_study(values, 10.0)
    assert not found.pooled
    assert found.repeatability_mm < 0.02
    assert 0.2 < found.reproducibility_mm < 0.4


def test_a_master_tells_spread_and_bias() -> None:
    """C_g depends on the spread alone and C_gk also on the bias; 24 measurements are too few."""
    rng = np.random.default_rng(8)
    values = rng.normal(8.002, 0.001, 50)
    found = capability(values, 8.0, 0.1)
    assert found.cg == pytest.approx(0.01 / (3 * values.std(ddof=1)))
    assert found.cgk == pytest.approx((0.01 - abs(values.mean() - 8.0)) / (3 * values.std(ddof=1)))
    assert found.good
    assert not found.bias_is_chance
    assert not capability(values, 8.0, 0.03).good
    with pytest.raises(ValueError, match="24 measurements"):
        capability(values[:24], 8.0, 0.1)


def test_guard_bands_leave_one_bad_part_in_twenty() -> None:
    """A part at the tolerance limit is measured inside the guard band in 5 % of measurements."""
    low, _ = guard_bands(7.99, 8.01, 0.001)
    measured = 7.99 + np.random.default_rng(9).normal(0, 0.001, 100_000)
    assert np.mean(measured > low) == pytest.approx(0.05, abs=0.003)


def test_a_study_that_is_not_whole_is_named(tmp_path: Path) -> None:
    """A part that a person did not measure, and a different number of trials, are named."""
    whole = {(part, person): [1.0, 2.0] for part in "abc" for person in "xy"}
    assert crossed(whole, tmp_path).shape == (3, 2, 2)
    with pytest.raises(UserError, match="y did not measure b"):
        crossed({key: value for key, value in whole.items() if key != ("b", "y")}, tmp_path)
    with pytest.raises(UserError, match="not as many good pairs of each: a/x 2"):
        crossed(whole | {("c", "y"): [1.0]}, tmp_path)


# --- files --------------------------------------------------------------------------------------


def test_an_acceptance_is_read_back_and_says_what_it_says_today(tmp_path: Path) -> None:
    """An acceptance is read back as passed, overdue or failed, and counts as none for another calibration
    or registration."""
    path = acceptance_file(tmp_path / "rig.json")
    assert load_acceptance(path, "cal", "reg").state(5) is AcceptanceState.NONE
    made = Acceptance(passed=True, made_ns=NS_PER_DAY, due_ns=11 * NS_PER_DAY)
    write_file(path, document_of(made, "cal", "reg", {"by": "me"}))
    found = load_acceptance(path, "cal", "reg")
    assert found == made
    assert found.state(2 * NS_PER_DAY) is AcceptanceState.PASSED
    assert found.days_left(2 * NS_PER_DAY) == 9
    assert found.state(11 * NS_PER_DAY + 1) is AcceptanceState.OVERDUE
    assert load_acceptance(path, "cal", "other").state(5) is AcceptanceState.OTHER_RIG
    assert load_acceptance(path, "other", "reg").state(5) is AcceptanceState.OTHER_RIG
    assert replace(made, passed=False).state(5) is AcceptanceState.FAILED


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("passed", 1, "passed: expected true or false"),
        ("due_ns", -1, "due_ns: expected a whole number"),
        ("made_ns", "x", "made_ns: expected a whole number"),
        ("calibration_id", "", "calibration_id: expected a name"),
        ("version", 9, "version 9"),
        ("format", "edged-marks", "not a acceptance test"),
    ],
)
def test_a_damaged_acceptance_is_named(tmp_path: Path, field: str, value: object, message: str) -> None:
    """A damaged acceptance is refused with file, field and expectation."""
    path = tmp_path / "acceptance.json"
    document = json.loads(document_of(Acceptance(True, 1, 2), "cal", "reg", {}))
    path.write_text(json.dumps(document | {field: value}))
    with pytest.raises(FileFormatError, match=message):
        load_acceptance(path, "cal", "reg")
    path.write_text("{")
    with pytest.raises(FileFormatError, match="not JSON"):
        load_acceptance(path, "cal", "reg")


def test_a_stages_table_is_read_with_suspicion(tmp_path: Path) -> None:
    """A stage's table is refused if a pair occurs twice, numbers are missing, or a value is no number."""
    path = tmp_path / "truth.csv"
    path.write_text("pair,x,y,z\np1,1,2,3\np2,4,5,6\n")
    assert read_truth(path)["p2"].tolist() == [4.0, 5.0, 6.0]
    for text, message in (
        ("p1,1,2,3\np1,1,2,3\n", "line 2: p1 is there twice"),
        ("p1,1,2\n", "expected NAME,x,y,z"),
        ("p1,1,2,x\n", "line 1"),
    ):
        path.write_text(text)
        with pytest.raises(FileFormatError, match=message):
            read_truth(path)


def test_the_page_says_what_was_found_and_escapes_it() -> None:
    """The HTML and the PDF contain verdicts and figures, and a job's name is escaped."""
    tests = [ReportedTest("pose", "NOT PASSED", "too <b>far</b>", {"largest": "12 um"})]
    page = acceptance_page("Acceptance test", "The cell DID NOT PASS", {"job": "<script>"}, tests)
    assert "NOT PASSED" in page
    assert "12 um" in page
    assert "<script>" not in page
    assert "<b>far" not in page
    pdf = acceptance_pdf("Acceptance test", "The cell DID NOT PASS", {"job": "x"}, tests)
    assert pdf.startswith(b"%PDF-1.4")
    assert b"largest: 12 um" in pdf
