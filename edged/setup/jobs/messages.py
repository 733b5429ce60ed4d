"""Encoding of orders to the worker process and of its answers: only values of listed classes are accepted.

The worker reads untrusted files with C++ libraries. An attacker who takes it over may send any answer, but it
is only accepted as a value of a class on this list.
"""

from __future__ import annotations

from typing import Any

from edged.cbor import CborBounds
from edged.codec.codec import Codec

MOST_BYTES = 256 << 20
"""Largest message: several pictures of the largest sensors."""
_KINDS = {
    "edged.domain.measurement": "Status",
    "edged.domain.picking": "Bounds Box Grasp Gripper Order Picking Tray",
    "edged.domain.robotmap": "RobotMap",
    "edged.files.jobs.schema": "TraySection",
    "edged.files.recording": "Entry",
    "edged.robot.orientations": "Brand Convention",
    "edged.robot.readings": "PoseFormat",
    "edged.setup.calibration.checking": "Finding Limits",
    "edged.setup.calibration.drafts": "Solution",
    "edged.setup.calibration.guidance": "Ghost Guided",
    "edged.setup.calibration.shown": "Seen Watched",
    "edged.setup.calibration.views": "Looked",
    "edged.setup.documents": "PlaceMm SigmaAbc SigmaXyz Trouble",
    "edged.setup.inuse": "RigInUse",
    "edged.setup.jobs.workerprocess": (
        "OutOfMemory TaskBug TaskLimits TaskOrder TaskProgress TaskRefused TaskResult"
    ),
    "edged.setup.recordings.comparing": "Found GoodPart TriedCycle",
    "edged.setup.recordings.recordedparts": "FeatureSight OutlinePx PartSight SizeSight",
    "edged.setup.recordings.whatif": "Change CycleVerdict LimitChange Remedy WhatIf",
    "edged.setup.registration.model": "LookState Place SampleState SkyDocument",
    "edged.setup.registration.registering": "RegisteredRig",
    "edged.setup.registration.verdict": "Judged Row",
    "edged.setup.releases.differences": (
        "ChangedJobDocument Difference JobsDifference Moved ReleaseDifference RigDifference"
    ),
    "edged.setup.teaching.documents": (
        "ContoursDocument FeatureDocument Outline PredictedDocument ReferenceDocument RivalDocument "
        "SizeDocument WarningDocument"
    ),
    "edged.setup.teaching.editing": "FormerFiles",
    "edged.setup.teaching.model": "Brush Content Corners DiscRegion Drawing Gripping Mark Rectangle Size",
    "edged.setup.teaching.proposing": "JobSeen LearningOrder",
    "edged.setup.trials.sigmamap": "SigmaMap",
    "edged.setup.trials.stilltest": "StillSample StillResult",
    "edged.setup.trials.tried": "Lines Terms TriedPair TriedPart Whiskers",
    "edged.setup.trials.work": "TrialSetup",
    "edged.vision.boards.board": "Charuco Chessboard CircleGrid Detection DotBoard NotDetected",
    "edged.vision.calibration.imaging": "ImagingFinding",
    "edged.vision.calibration.verification": "BoardCheck Length",
    "edged.vision.curves.planefit": "Scatter",
    "edged.vision.geometry.camera": "CameraModel StereoRig",
    "edged.vision.part.body": "PartBody",
    "edged.vision.part.job": (
        "CircleFeature CornerFeature EdgeFeature Job MeasurementSpec ModelPoint ResultLimits SlotFeature"
    ),
    "edged.vision.part.traced": "TracedCurve",
    "edged.vision.shape.model": "ShapeLevel ShapeModel",
    "edged.vision.shape.params": "SearchParams",
}
"""Classes by their modules, which are imported when the first such value arrives."""
CODEC = Codec(
    "a worker",
    {name: module for module, names in _KINDS.items() for name in names.split()},
    CborBounds(MOST_BYTES, 2_500_000, 100),
)


def encode_message(value: object) -> bytes:
    """Encode a value as CBOR. Raises `TypeError` that names a class that is not on the list."""
    return CODEC.encode(value)


def decode_message(data: bytes) -> Any:
    """Decode a value. Raises `ValueError` for anything that `encode_message` does not write."""
    return CODEC.decode(data)
