"""Views of both cameras of a virtual rig, poses in view of both, and calibration pictures of a plate."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import SIDES, FloatArray, Image
from edged.sim.render.scene import PlacedPart, Plate, RenderedView, Scene, Sensor, Surface, Table
from edged.vision.geometry.camera import StereoRig

BORDER_PX = 12.0
"""Distance of a part from the borders of both images, needed by the edge operator."""

ATTEMPTS = 300
"""Random poses tried before a part counts as too large for the common view."""


def stereo_views(rig: StereoRig, sensor: Sensor | None = None) -> dict[str, RenderedView]:
    """The views of both cameras, by name."""
    return {
        "left": RenderedView(rig.left, np.eye(4), sensor),
        "right": RenderedView(rig.right, rig.right_from_left, sensor),
    }


def tilted_pose(origin_mm: FloatArray, tilt_rad: float, azimuth_rad: float, turn_rad: float) -> FloatArray:
    """Pose turned about its own z, then tilted about a horizontal axis."""
    axis = np.array([math.cos(azimuth_rad), math.sin(azimuth_rad), 0.0])
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    tilt = np.eye(3) + math.sin(tilt_rad) * cross + (1.0 - math.cos(tilt_rad)) * cross @ cross
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    pose = np.eye(4)
    pose[:3, :3] = tilt @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    pose[:3, 3] = origin_mm
    return pose


def is_inside(views: dict[str, RenderedView], rig_from_part: FloatArray, radius_mm: float) -> bool:
    """Whether both cameras see a disc of this radius around the part's origin completely."""
    angles = np.linspace(0.0, 2.0 * math.pi, 48, endpoint=False)
    rim = np.stack([np.cos(angles), np.sin(angles), np.zeros(48)], axis=-1) * radius_mm
    points = rim @ rig_from_part[:3, :3].T + rig_from_part[:3, 3]
    return all(sees(view, points) for view in views.values())


def sees(view: RenderedView, points_mm: FloatArray) -> bool:
    """Whether a camera sees all points (N, 3), in the rig frame, at least `BORDER_PX` from its borders."""
    try:
        pixels = view.project(points_mm)
    except ValueError:  # so far out that the lens does not image it
        return False
    last = (view.camera.width - 1, view.camera.height - 1)
    return bool((pixels >= BORDER_PX).all() and (pixels <= np.array(last) - BORDER_PX).all())


# --- calibration images ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationView:
    """One stereo pair of a plate and its true pose."""

    left: Image
    right: Image
    rig_from_plate: FloatArray


def calibration_views(
    rig: StereoRig, plate: Plate, count: int, *, seed: int = 0
) -> Iterator[CalibrationView]:
    """Pictures of a plate as a careful person takes them: tilted by up to 20° in all directions, at
    several depths, all over the common field of view, never cut off.

    Raises ValueError if the plate does not fit into the view of both cameras.
    """
    views = stereo_views(rig)
    table_pose = np.eye(4)
    table_pose[:3, 3] = _meeting_point(rig)
    table_pose[2, 3] += 30.0
    table = Table(Surface(albedo=0.12), table_pose)
    for number, pose in enumerate(calibration_poses(rig, plate, count, seed=seed)):
        scene = Scene(table, (PlacedPart(plate.part, pose),))
        left, right = (
            views[camera].render(scene, np.random.default_rng((seed, 5 + index, number)))
            for index, camera in enumerate(SIDES)
        )
        yield CalibrationView(left, right, pose)


def calibration_poses(rig: StereoRig, plate: Plate, count: int, *, seed: int = 0) -> Iterator[FloatArray]:
    """Poses rig_from_plate (4, 4) of a carefully held plate. Raises as `calibration_views`."""
    views, points = stereo_views(rig), plate.points_mm
    centre = np.append(0.5 * (points.min(axis=0) + points.max(axis=0))[:2], 0.0)
    margin_mm = 1.5 * float(np.linalg.norm(points[1] - points[0]))
    rim = _rectangle(points.min(axis=0) - margin_mm, points.max(axis=0) + margin_mm)
    meeting_mm = _meeting_point(rig)
    for number in range(count):
        pose = _plate_pose(np.random.default_rng((seed, 4, number)), views, rim - centre, meeting_mm)
        pose[:3, 3] -= pose[:3, :3] @ centre
        yield pose


def _plate_pose(
    rng: np.random.Generator, views: dict[str, RenderedView], rim_mm: FloatArray, meeting_mm: FloatArray
) -> FloatArray:
    reach_mm = 0.12 * meeting_mm[2]
    for attempt in range(ATTEMPTS):
        reach = reach_mm * (1.0 - attempt / ATTEMPTS)  # a large plate leaves little space
        shift = rng.uniform(-1.0, 1.0, 3) * (reach, reach, 0.04 * meeting_mm[2])
        tilt, azimuth = math.radians(20.0) * math.sqrt(rng.random()), rng.uniform(0.0, 2.0 * math.pi)
        pose = tilted_pose(meeting_mm + shift, tilt, azimuth, rng.uniform(-0.3, 0.3))
        corners = rim_mm @ pose[:3, :3].T + pose[:3, 3]
        if all(sees(view, corners) for view in views.values()):
            return pose
    raise ValueError("the calibration plate fits nowhere into the view of both cameras")


def _rectangle(low: FloatArray, high: FloatArray) -> FloatArray:
    return np.array([(x, y, 0.0) for x in (low[0], high[0]) for y in (low[1], high[1])])


def _meeting_point(rig: StereoRig) -> FloatArray:
    """Point where both optical axes come closest; 2 baselines ahead if they are nearly parallel."""
    right_axis = rig.right_from_left[:3, :3].T @ (0.0, 0.0, 1.0)
    right_centre = -rig.right_from_left[:3, :3].T @ rig.right_from_left[:3, 3]
    # left (0, 0, a) and right c + b r: least squares for a, b
    system = np.stack([np.array([0.0, 0.0, 1.0]), -right_axis], axis=-1)
    (a, b), *_ = np.linalg.lstsq(system, right_centre, rcond=None)
    if a <= 0.0 or b <= 0.0 or math.hypot(*right_axis[:2]) < 0.02:
        return np.array([0.5 * right_centre[0], 0.5 * right_centre[1], 2.0 * rig.baseline_mm])
    return np.asarray(0.5 * (np.array([0.0, 0.0, a]) + right_centre + b * right_axis))
