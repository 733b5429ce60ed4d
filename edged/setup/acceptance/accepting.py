"""Acceptance from the pictures in a folder: the tests, and the documents with their results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from edged import __version__
from edged.domain.acceptance import NS_PER_DAY, Acceptance
from edged.domain.arrays import FloatArray
from edged.errors import UserError
from edged.files.acceptance import document_of
from edged.files.jobs import load_job
from edged.files.touched import read_touched
from edged.pipeline import PreparedRig, prepare
from edged.report.acceptance import ReportedTest, acceptance_page, acceptance_pdf
from edged.robot.golden import registration_digest
from edged.robot.picking import frame_of
from edged.setup.acceptance.measuring import pairs_of, poses_in, read_truth, sizes_in, still_in
from edged.setup.acceptance.verdicts import (
    AcceptanceTest,
    length_test,
    pose_test,
    robot_test,
    still_verdict,
    without,
)
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply, skew
from edged.vision.geometry.uncertainty import shift_by_parameters
from edged.vision.part.job import Job

VERDICTS = {True: "passed", False: "NOT PASSED", None: "cannot be said"}
TRUTH_NAME, TOUCHED_NAME = "truth.csv", "touched.csv"


@dataclass(frozen=True, slots=True)
class StatedTruth:
    """Known values for the pictures. length : name and mm of the bar's length, in length_job or the job.

    truth_um, robot_um : one sigma of the stage's positions, and of a touch of the robot. days : until the
    next acceptance is due.
    """

    length: tuple[str, float] | None = None
    length_job: Path | None = None
    truth_um: float = 2.0
    robot_um: float = 50.0
    days: int = 365


@dataclass(frozen=True, slots=True)
class AcceptanceDocuments:
    """Result of an acceptance and its documents. document : content of `acceptance.json`."""

    found: Acceptance
    document: bytes
    html: bytes
    pdf: bytes


def accepted(folder: Path, rig: StereoRig, job: Job, shown: StatedTruth) -> list[AcceptanceTest]:
    """Run the four tests, as far as the folder has still/, pose/, length/, robot/. Raises `UserError`."""
    return list(_tests(folder, rig, job, shown))


def documents_of(
    tests: Sequence[AcceptanceTest], rig: tuple[StereoRig, str], job: Job, by: str, days: int
) -> AcceptanceDocuments:
    """Documents of an acceptance made now. rig : the rig and its name for people. by : who made it."""
    measured_by, name = rig
    now_ns = int(datetime.now(UTC).timestamp()) * 10**9
    # the robot's test is only needed for a cell with a robot
    needed = [test for test in tests if test.name != "robot" or measured_by.robot_from_rig is not None]
    found = Acceptance(all(test.good for test in needed), now_ns, now_ns + days * NS_PER_DAY)
    about = {
        "rig": f"{name}, calibration {measured_by.calibration_id}",
        "job": f"{job.number} {job.name}",
        "made": f"{datetime.fromtimestamp(found.made_ns / 1e9, UTC):%Y-%m-%d %H:%M} UTC, edged {__version__}",
        "due again": f"{datetime.fromtimestamp(found.due_ns / 1e9, UTC):%Y-%m-%d}",
        **({"by": by} if by else {}),
        "in kind": "ASTM E2919 (pose), VDI/VDE 2634-1 (length); no conformity is claimed",
    }
    reported = [ReportedTest(test.name, VERDICTS[test.good], test.why, test.figures) for test in tests]
    page = ("Acceptance test", f"The cell {'PASSED' if found.passed else 'DID NOT PASS'}", about, reported)
    return AcceptanceDocuments(
        found,
        document_of(
            found,
            measured_by.calibration_id,
            registration_digest(measured_by),
            {"by": by, "tests": [_plain(test) for test in tests]},
        ),
        acceptance_page(*page).encode(),
        acceptance_pdf(*page),
    )


def _tests(folder: Path, rig: StereoRig, job: Job, shown: StatedTruth) -> Sequence[AcceptanceTest]:
    prepared = prepare(rig)
    return (
        _still(folder / "still", prepared, job),
        _pose(folder / "pose", prepared, job, shown),
        _length(folder / "length", prepared, job, shown),
        _robot(folder / "robot", rig, shown),
    )


def _not_made(name: str, folder: Path) -> AcceptanceTest:
    return AcceptanceTest(name, None, f"not made: nothing is in {folder.name}/", {})


def _still(folder: Path, rig: PreparedRig, job: Job) -> AcceptanceTest:
    return (
        still_verdict(still_in(rig, job, pairs_of(folder))) if folder.is_dir() else _not_made("still", folder)
    )


def _pose(folder: Path, rig: PreparedRig, job: Job, shown: StatedTruth) -> AcceptanceTest:
    if not folder.is_dir():
        return _not_made("pose", folder)
    truth = folder / TRUTH_NAME
    known = read_truth(truth) if truth.is_file() else None
    placed, missing = poses_in(rig, job, pairs_of(folder))
    places: FloatArray | None = None
    if known is not None:
        if unknown := [name for name in placed.names if name not in known]:
            raise UserError(f"{truth}: no line for {', '.join(unknown[:5])}")
        places = np.array([known[name] for name in placed.names]).reshape(-1, 3)
    return without(pose_test(placed, places, 1e-3 * shown.truth_um), missing)


def _length(folder: Path, rig: PreparedRig, job: Job, shown: StatedTruth) -> AcceptanceTest:
    if not folder.is_dir():
        return _not_made("length", folder)
    if shown.length is None:
        raise UserError(f"{folder}: it is not stated what is measured there, and its true length (NAME=MM)")
    name, true_mm = shown.length
    by = job if shown.length_job is None else load_job(shown.length_job)
    found, missing = sizes_in(rig, by, pairs_of(folder), name)
    measured = np.array([value for value, _ in found.values()])
    return without(length_test(list(found), measured, true_mm), missing)


def _robot(folder: Path, rig: StereoRig, shown: StatedTruth) -> AcceptanceTest:
    if not folder.is_dir():
        return _not_made("robot", folder)
    if rig.robot_from_rig is None:
        raise UserError(f"{folder}: the rig is not registered to a robot (edged register)")
    _, rig_mm, touched_mm = read_touched(folder / TOUCHED_NAME)
    expected = apply(rig.robot_from_rig, rig_mm)
    if rig.robot_map is not None:
        return _by_map(rig, rig_mm, expected, touched_mm, shown)
    parameters = np.zeros((0, 0)) if rig.covariance is None else rig.covariance
    turned = rig.robot_from_rig[:3, :3] @ shift_by_parameters(rig, rig_mm)
    moved = turned.reshape(expected.size, -1)[:, : len(parameters)]
    shared = moved @ parameters @ moved.T
    if rig.registration_covariance is not None:
        lever = np.concatenate([np.tile(np.eye(3), (len(expected), 1, 1)), -skew(expected)], axis=2)
        shared = shared + lever.reshape(-1, 6) @ rig.registration_covariance @ lever.reshape(-1, 6).T
    return robot_test(expected, shared, touched_mm, 1e-3 * shown.robot_um)


def _by_map(
    rig: StereoRig, rig_mm: FloatArray, expected: FloatArray, touched_mm: FloatArray, shown: StatedTruth
) -> AcceptanceTest:
    """Robot test for points as the cell publishes them with the map of the robot's error.

    The map's uncertainty includes that of the registration.
    """
    frame = frame_of(rig)
    shifts = [frame.shift(place) for place in rig_mm]
    known = [shift for shift in shifts if shift is not None]
    inside = np.array([shift is not None for shift in shifts], bool)
    rows = np.array([shift.row for shift in known]).reshape(len(known), -1)
    noise = max([shift.noise_mm for shift in known], default=0.0)
    shared = np.kron(rows @ rows.T + noise**2 * np.eye(len(known)), np.eye(3))
    mapped = expected[inside] + np.array([shift.shift_mm for shift in known]).reshape(-1, 3)
    return robot_test(mapped, shared, touched_mm[inside], 1e-3 * shown.robot_um)


def _plain(test: AcceptanceTest) -> Mapping[str, object]:
    return {"name": test.name, "good": test.good, "why": test.why, "figures": dict(test.figures)}
