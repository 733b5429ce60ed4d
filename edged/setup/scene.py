"""3D scene of the cell for the page: cameras, depths of its jobs, boards that were taken, the robot.

Everything is in mm in the rig's frame: the left camera's centre is its origin, x right, y down, z forward.
"""

from __future__ import annotations

import asyncio

import numpy as np

from edged.adapters.web.routes import Answer, Call, route
from edged.domain.arrays import SIDES, FloatArray, Side
from edged.identity.visitors import Role
from edged.setup.calibration.service import Calibrations
from edged.setup.inuse import CellInUse
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import invert

Point = list[float]


class SceneCamera(Answer):
    """A camera. corners : of its picture at a depth of 1 mm, relative to its centre."""

    side: Side
    centre: Point
    corners: list[Point]


class SceneBoard(Answer):
    """A board that both cameras saw, of the newest calibration draft with any. corners : four."""

    name: str
    used: bool
    corners: list[Point]


class SceneDocument(Answer):
    """3D scene of the cell. depth_mm : nearest and farthest that any job allows. robot : rig_from_robot, 4x4.

    cameras : empty without a calibration. robot : null if the rig is not registered, or is carried.
    """

    rig: str | None = None
    baseline_mm: float | None = None
    cameras: list[SceneCamera] = []  # noqa: RUF012  (pydantic copies it)
    boards: list[SceneBoard] = []  # noqa: RUF012  (likewise)
    depth_mm: list[float] | None = None
    robot: list[Point] | None = None


class SceneRoutes:
    """Route of the 3D scene."""

    def __init__(self, cell: CellInUse, calibrations: Calibrations) -> None:
        self._cell = cell
        self._calibrations = calibrations

    @route("GET", "/scene", "Cameras, boards, depths and robot in space", role=Role.VIEWER)
    async def _get(self, _call: Call[None]) -> SceneDocument:
        return await asyncio.to_thread(self._scene)

    def _scene(self) -> SceneDocument:
        found = self._cell.rig()
        if found is None:
            return SceneDocument()
        rig = found.stereo()
        depths = [job.limits.depth_mm for job in self._cell.jobs().values()]
        robot = rig.robot_from_rig
        return SceneDocument(
            rig=found.calibration_id,
            baseline_mm=rig.baseline_mm,
            cameras=[_camera(rig, side) for side in SIDES],
            boards=[
                SceneBoard(name=name, used=used, corners=_rounded(corners))
                for name, used, corners in self._calibrations.boards_in_space(rig)
            ],
            depth_mm=[min(near for near, _ in depths), max(far for _, far in depths)] if depths else None,
            robot=None if robot is None else invert(robot).tolist(),
        )


def _camera(rig: StereoRig, side: Side) -> SceneCamera:
    camera = rig.camera(side)
    width, height = camera.width - 1, camera.height - 1
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)], np.float64)
    rays = np.column_stack([camera.normalise(corners), np.ones(4)])
    rig_from_camera = np.eye(4) if side == "left" else invert(rig.right_from_left)
    centre, turned = rig_from_camera[:3, 3], rays @ rig_from_camera[:3, :3].T
    return SceneCamera(side=side, centre=_rounded(centre[None])[0], corners=_rounded(turned, 6))


def _rounded(points: FloatArray, digits: int = 3) -> list[Point]:
    return [[round(float(value), digits) for value in point] for point in points]
