"""A virtual cell: a part at a new pose for every trigger, two cameras, and the ground truth.

Exposures are paired by time, as with real cameras, whose frame ids restart after a reboot: the first
exposure creates a scene, the other camera's exposure within `PAIR_WINDOW_NS` sees the same one, and
no camera sees a scene twice. A lost trigger or a restarted camera costs a single pair, as long as
triggers are further apart than the window.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from edged.domain.arrays import SIDES, FloatArray, Image, Side
from edged.errors import ImageError
from edged.sim.exposure import ExposureRequest
from edged.sim.marksplate import marks_plate
from edged.sim.render.scene import (
    Disc,
    Hole,
    Part,
    PlacedPart,
    Plate,
    RenderedView,
    RoundedBox,
    Scene,
    SceneLight,
    Sensor,
    Surface,
    Table,
    extent_mm,
)
from edged.sim.showing import Pose, ShownNow, Thing, fingers, waving_hand
from edged.sim.views import ATTEMPTS, is_inside, stereo_views, tilted_pose
from edged.sim.weather import TrueCameras, Weather
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.kernels.jit import load_called
from edged.vision.marks.frame import MarkFrame

PAIR_WINDOW_NS = 50_000_000
"""Longer than two consecutive software triggers on a busy PC, shorter than any cycle."""

HISTORY = 1024
"""Number of scenes whose truth is kept: minutes of cycles, a megabyte."""

ABOVE_TABLE_MM = 1.0
"""Thickness of a plate of reference marks."""


@dataclass(frozen=True, slots=True)
class PartMotion:
    """Range of the part's poses, with independent, uniformly distributed coordinates.

    centre_mm : in the rig frame. shift_mm : half width in x and y. depth_mm : half width in z.
    tilt_rad : largest angle between the part's z and the rig's z. turn_rad : half range of the
    rotation about z.
    """

    centre_mm: tuple[float, float, float] = (8.0, 0.0, 205.0)
    shift_mm: tuple[float, float] = (24.0, 16.0)
    depth_mm: float = 3.0
    tilt_rad: float = math.radians(3.0)
    turn_rad: float = math.pi


@dataclass(frozen=True, slots=True, eq=False)
class TrueCircle:
    """A circle of the part in the rig frame; normal towards the cameras."""

    name: str
    centre_mm: FloatArray
    normal: FloatArray
    radius_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The true scene of an exposure.

    number : counts scenes from 0. exposed_ns : of the first exposure of the pair.
    rig_from_part : (4, 4) of the thing shown, also if it is a board; if nothing is shown, where the part
    would lie.
    """

    number: int
    exposed_ns: int
    rig_from_part: FloatArray
    circles: tuple[TrueCircle, ...]
    thing: Thing = Thing.PART


@dataclass(slots=True)
class _Moment:
    truth: Truth
    scene: Scene
    cameras: TrueCameras | None = None
    seen: dict[str, tuple[int, int]] = field(default_factory=dict)  # camera: frame id, exposed_ns


class VirtualCell:
    """Scenes, their pictures and their truth; each is determined by the seed and its number.

    board : may be held in front of the cameras by `show`. weather : moves the cameras from the first exposure
    on, at `pace` times real time; `rig` is the state at that moment, and poses stay in its frame. marks : lie
    on the table around the middle; those with codes in `covered` have no dots. Thread-safe: cameras expose
    from their own threads, and the thing shown may change at any time; both pictures of a pair show the same
    moment. Raises ValueError if the part fits nowhere into the view of both cameras.
    """

    def __init__(
        self,
        rig: StereoRig,
        part: Part,
        *,
        seed: int = 0,
        motion: PartMotion | None = None,
        board: Plate | None = None,
        weather: Weather | None = None,
        marks: MarkFrame | None = None,
        pace: float = 1.0,
    ) -> None:
        self.rig, self.part, self.board = rig, part, board
        self.weather, self.marks, self.covered = weather, marks, frozenset[int]()
        self._pace, self._begun_ns = pace, 0
        self._moved: dict[str, RenderedView] = {}
        self._seed = seed
        self._motion = motion or PartMotion()
        self._table = Surface(albedo=0.16, contrast=0.25, feature_mm=0.6, seed=2)
        self._light = SceneLight()
        self._views = stereo_views(rig)
        self._showing = ShownNow()
        self._moments: deque[_Moment] = deque(maxlen=HISTORY)
        self._born = 0
        self._lock = threading.Lock()
        self.pose(0)  # fail here, not at the first trigger, if the part cannot be placed

    def exposure(self, camera: str, other: RenderedView | None = None) -> Callable[[ExposureRequest], Image]:
        """Image function for a virtual camera, "left" or "right".

        other : view of another camera on that side; None: the side's present one.
        """
        _load_kernels()

        def expose(request: ExposureRequest) -> Image:
            view = other or self._views[camera]
            if request.width > view.camera.width or request.height > view.camera.height:
                raise ImageError(
                    f"virtual camera {camera}: {request.width}x{request.height} asked for, "
                    f"the sensor has {view.camera.width}x{view.camera.height}"
                )
            moment = self._moment(camera, request)
            if moment.cameras is not None:
                view = self._in_weather(camera, moment.cameras, view.sensor)
            rng = np.random.default_rng((self._seed, 1 + SIDES.index(camera), moment.truth.number))
            image = view.render(moment.scene, rng, request.exposure_us, request.gain_db)
            return np.ascontiguousarray(image[: request.height, : request.width])

        return expose

    def _in_weather(self, camera: str, cameras: TrueCameras, sensor: Sensor) -> RenderedView:
        """View of a camera moved by the weather; reuses the last one if nothing has changed."""
        model, pose = cameras.camera("left" if camera == "left" else "right")
        view = self._moved.get(camera)
        if (
            view is None
            or (model, sensor) != (view.camera, view.sensor)
            or (pose != view.camera_from_rig).any()
        ):
            view = self._moved[camera] = RenderedView(model, pose, sensor)
        return view

    # --- things shown from the next exposure on ------------------------------------------------

    @property
    def middle_mm(self) -> FloatArray:
        """Centre (3,) of the range of part positions, in the rig frame."""
        return np.array(self._motion.centre_mm)

    @property
    def showing(self) -> ShownNow:
        """The thing shown, and its pose."""
        return self._showing

    def show(self, thing: Thing | str, pose: Pose | None = None, *, covered: bool = False) -> None:
        """Put something in front of the cameras.

        pose : fixed, or a function of time; None: random poses of the part, new at every exposure.
        covered : fingers cover a corner of the board.
        Raises ValueError for an unknown thing, and for a board that the cell lacks or without a pose.
        """
        thing = Thing(thing)
        if thing is Thing.BOARD and (self.board is None or pose is None):
            raise ValueError("a board needs to be given to the cell, and a pose")
        with self._lock:
            self._showing = replace(self._showing, thing=thing, pose=pose, covered=covered)

    def wave(self, side: Side | None) -> None:
        """Wave a hand in front of this camera; None: stop."""
        with self._lock:
            self._showing = replace(self._showing, waving=side)

    def focus(self, side: Side, psf_sigma_px: float) -> None:
        """Change the blur of a camera's lens, as by turning its focus ring."""
        view = self._views[side]
        sensor = replace(view.sensor, psf_sigma_px=psf_sigma_px)
        self._views[side] = RenderedView(view.camera, view.camera_from_rig, sensor)

    def view(self, side: Side) -> RenderedView:
        """Current view of a camera."""
        return self._views[side]

    def replace_camera(self, side: Side, view: RenderedView) -> None:
        """Replace the camera of a side; hands are placed by the new camera's view."""
        self._views[side] = view

    # --- the truth -----------------------------------------------------------------------------

    def truth(self, exposed_ns: int, tolerance_ns: int = PAIR_WINDOW_NS) -> Truth | None:
        """The scene exposed nearest to a time; None if there was none, or it is no longer kept."""
        with self._lock:
            truths = [moment.truth for moment in self._moments]
        nearest = min(truths, key=lambda truth: abs(truth.exposed_ns - exposed_ns), default=None)
        if nearest is None or abs(nearest.exposed_ns - exposed_ns) > tolerance_ns:
            return None
        return nearest

    def truth_of_frame(self, camera: str, frame_id: int) -> Truth | None:
        """The scene of a camera's latest frame with that id; ids restart with the camera."""
        with self._lock:
            for moment in reversed(self._moments):
                if camera in moment.seen and moment.seen[camera][0] == frame_id:
                    return moment.truth
        return None

    def teach_pair(self) -> tuple[Image, Image, Truth]:
        """Left and right image of the part with its axes parallel to the rig's, and the truth (number -1)."""
        rig_from_part = np.eye(4)
        rig_from_part[:3, 3] = self._motion.centre_mm
        scene = self.scene(rig_from_part)
        left, right = (
            self._views[camera].render(scene, np.random.default_rng((self._seed, 3, index)))
            for index, camera in enumerate(SIDES)
        )
        return left, right, self._truth(-1, 0, rig_from_part)

    def scene(self, rig_from_part: FloatArray) -> Scene:
        """Scene of the cell with the part at a pose."""
        return Scene(self._floor(), (PlacedPart(self.part, rig_from_part),), self._light)

    def _floor(self) -> Table:
        rig_from_table = np.eye(4)
        # below the lowest possible point of a tilted part
        rig_from_table[:3, 3] = self._motion.centre_mm
        rig_from_table[2, 3] += self._motion.depth_mm + extent_mm(self.part.outline) * math.sin(
            self._motion.tilt_rad
        )
        return Table(self._table, rig_from_table)

    def moment(self, camera: str, request: ExposureRequest) -> Truth:
        """The scene of this exposure; a new one if there is none to share."""
        return self._moment(camera, request).truth

    def _moment(self, camera: str, request: ExposureRequest) -> _Moment:
        frame = (request.frame_id, request.exposed_ns)
        with self._lock:
            for moment in reversed(self._moments):
                near = abs(request.exposed_ns - moment.truth.exposed_ns) <= PAIR_WINDOW_NS
                if near and moment.seen.get(camera, frame) == frame:
                    moment.seen[camera] = frame
                    return moment
            moment = self._next(request.exposed_ns)
            moment.seen[camera] = frame
            self._born += 1
            self._moments.append(moment)
            return moment

    def _next(self, exposed_ns: int) -> _Moment:
        """Create the next scene, at this time."""
        self._begun_ns = self._begun_ns or exposed_ns
        cameras = (
            None
            if self.weather is None
            else self.weather.at(self._pace * 1e-9 * (exposed_ns - self._begun_ns))
        )
        showing = self._showing
        pose = showing.pose_at(exposed_ns)
        if pose is None:
            pose = self.pose(self._born)
        truth = self._truth(self._born, exposed_ns, pose, showing.thing)
        placed: list[PlacedPart] = []
        if self.marks is not None:
            scale = 1.0 if cameras is None else cameras.plate_scale
            placed.append(
                PlacedPart(marks_plate(self.marks, scale, tuple(self.covered)), self.rig_from_marks)
            )
        if showing.thing is Thing.PART:
            placed.append(PlacedPart(self.part, pose))
        elif showing.thing is Thing.BOARD and self.board is not None:
            placed.append(PlacedPart(self.board.part, pose))
            if showing.covered:
                placed.append(fingers(self.board, pose))
        if showing.waving is not None:
            placed.append(waving_hand(self._views[showing.waving], exposed_ns))
        return _Moment(truth, Scene(self._floor(), tuple(placed), self._light), cameras)

    @property
    def rig_from_marks(self) -> FloatArray:
        """Pose (4, 4) of the reference marks, just above the table."""
        pose = self._floor().rig_from_table.copy()
        pose[2, 3] -= ABOVE_TABLE_MM
        return pose

    def pose(self, number: int) -> FloatArray:
        """rig_from_part (4, 4) of the scene with this number, in view of both cameras."""
        motion = self._motion
        rng = np.random.default_rng((self._seed, 0, number))
        for _ in range(ATTEMPTS):
            shift = rng.uniform(-1.0, 1.0, 3) * (*motion.shift_mm, motion.depth_mm)
            tilt, azimuth = motion.tilt_rad * math.sqrt(rng.random()), rng.uniform(0.0, 2.0 * math.pi)
            turn = rng.uniform(-motion.turn_rad, motion.turn_rad)
            pose = tilted_pose(np.array(motion.centre_mm) + shift, tilt, azimuth, turn)
            if is_inside(self._views, pose, extent_mm(self.part.outline)):
                return pose
        raise ValueError(f"part {self.part.name}: fits nowhere into the view of both cameras")

    # --- inside ------------------------------------------------------------------------------

    def _truth(
        self, number: int, exposed_ns: int, rig_from_part: FloatArray, thing: Thing = Thing.PART
    ) -> Truth:
        circles = tuple(
            TrueCircle(
                name,
                rig_from_part[:3, :3] @ (disc.x_mm, disc.y_mm, 0.0) + rig_from_part[:3, 3],
                -rig_from_part[:3, 2],
                disc.radius_mm,
            )
            for name, disc in (self.part.circles if thing is Thing.PART else ())
        )
        return Truth(number, exposed_ns, rig_from_part, circles, thing)


@cache
def _load_kernels() -> None:
    """Load the kernels once; otherwise the first picture takes four times as long, or comes late."""
    load_called("edged.sim")


# --- the demo's cell -------------------------------------------------------------------------------


def demo_rig() -> StereoRig:
    """Rig as in the paper's Table 2: f 14.8 mm on 4.65 µm pixels, baseline 110 mm, vergence 24°;
    the left camera looks straight down."""
    centre, target = np.array([109.3, 1.4, -12.2]), np.array([14.0, 1.0, 205.0])
    ahead = (target - centre) / np.linalg.norm(target - centre)
    down = np.array([0.006, 1.0, 0.0])  # 0.3° of roll, as remains after bolting a camera down
    right = np.cross(down, ahead)
    right /= np.linalg.norm(right)
    right_from_left = np.eye(4)
    right_from_left[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
    right_from_left[:3, 3] = -right_from_left[:3, :3] @ centre
    turn = math.radians(30.0)
    robot_from_rig = np.array(
        [
            [math.cos(turn), math.sin(turn), 0.0, 420.0],
            [math.sin(turn), -math.cos(turn), 0.0, -60.0],
            [0.0, 0.0, -1.0, 512.0],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    return StereoRig(
        CameraModel("division", 1280, 960, 3183.6, 3183.6, 645.8, 478.1, (-0.2416,)),
        CameraModel("division", 1280, 960, 3174.5, 3174.5, 646.9, 483.6, (-0.2331,)),
        right_from_left,
        "demo",
        robot_from_rig,
    )


def inside(marks: MarkFrame) -> PartMotion:
    """Range of the demo's part in which it does not cover marks, centred where both cameras see most."""
    reach_mm = extent_mm(demo_part().outline) + marks.diameter_mm
    free = [max(0.0, 0.5 * size_mm - reach_mm) for size_mm in (marks.width_mm, marks.height_mm)]
    return PartMotion(centre_mm=(7.0, 0.0, 205.0), shift_mm=(free[0], free[1]))


def demo_part() -> Part:
    """A flange: disc of radius 14 mm, bore with keyway, and five bolt holes, one of them smaller."""
    bolts = tuple(
        Hole(f"bolt{k}", Disc(10.2 * math.cos(angle), 10.2 * math.sin(angle), 0.9 if k == 4 else 1.6))
        for k, angle in enumerate(2.0 * math.pi * np.arange(5) / 5 + 0.35)
    )
    bore = Hole("bore", Disc(0.0, 0.0, 4.0))
    keyway = Hole("keyway", RoundedBox(4.4, 0.0, 3.6, 2.2))
    brushed = Surface(albedo=0.62, contrast=0.10, feature_mm=0.35, stretch=6.0, seed=1)
    return Part("flange", Disc(0.0, 0.0, 14.0), brushed, (bore, keyway, *bolts))
