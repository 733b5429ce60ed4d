"""Hand-built results for tests of what is published; no vision needed."""

from __future__ import annotations

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.events import Command, Snapshot
from edged.domain.measurement import (
    Circle3D,
    Corner3D,
    Edge3D,
    Match,
    Measurement,
    Reject,
    Slot3D,
    Status,
    Target,
)
from edged.vision.geometry.rigid import rotation_matrix, transform


def make_transform(turn_rad: tuple[float, float, float], shift_mm: tuple[float, float, float]) -> FloatArray:
    """A (4, 4) rigid transform of a rotation vector and a shift."""
    return transform(rotation_matrix(np.array(turn_rad)), np.array(shift_mm))


def make_target(reject: Reject = Reject.NONE, x_mm: float = 10.0) -> Target:
    """A target with a full covariance: every axis differs, all are correlated."""
    factor = np.tril(np.arange(1.0, 37.0).reshape(6, 6)) * 1e-4
    circle = Circle3D(
        "c0",
        np.array([x_mm, 20.0, 200.0]),
        np.array([0.0, 0.0, -1.0]),
        5.0,
        np.diag([1.0, 4.0, 9.0, 16.0]) * 1e-6,
    )
    return Target(
        job="flange",
        match=Match(320.5, 240.25, np.pi / 6, 1.0, 1.0, 0.97),
        rig_from_part=make_transform((0.1, -0.2, 0.3), (x_mm, 20.0, 200.0)),
        covariance=factor @ factor.T,
        circles=(circle,),
        epipolar_rms_px=0.05,
        reject=reject,
        edges=(Edge3D("e0", np.array([x_mm, 0.0, 200.0]), np.array([x_mm, 9.0, 200.0]), 1e-6 * np.eye(2)),),
        slots=(
            Slot3D("s0", np.array([x_mm, 1.0, 200.0]), np.array([1.0, 0.0, 0.0]), 9.0, 4.0, 1e-6 * np.eye(5)),
        ),
        corners=(Corner3D("k0", np.array([x_mm, 2.0, 200.0]), 1e-6 * np.eye(3)),),
        measurements=(
            Measurement("l", "distance", "mm", 42.01, 0.002, 42.0, 0.05),
            Measurement("square", "angle", "deg", np.nan, np.nan, 90.0, 0.1),
            Measurement("width", "width", "mm", 4.0, 0.001),
        ),
    )


def make_snapshot(
    cycle: int = 1,
    status: Status = Status.OK,
    targets: tuple[Target, ...] | None = None,
    command: Command | None = None,
    robot_from_rig: FloatArray | None = None,
    exposed_ns: int = 1_700_000_000_000_000_000,
) -> Snapshot:
    """A snapshot of job 1, "flange"; with one target when its status is OK."""
    if targets is None:
        targets = (make_target(),) if status is Status.OK else ()
    is_fault = status is Status.CAPTURE_FAULT
    return Snapshot(
        cycle=cycle,
        status=status,
        command=command,
        job="flange",
        job_number=1,
        calibration_id="cal",
        fingerprint="f00dcafe",
        simulated=True,
        exposed_ns=0 if is_fault else exposed_ns,
        published_ns=1_700_000_000_050_000_000,
        targets=targets,
        timing_ms={"capture": 12.5, "find": 3.25, "total": 20.0},
        error="camera left: unplugged" if is_fault else "",
        error_code=104 if is_fault else 0,
        robot_from_rig=robot_from_rig,
    )
