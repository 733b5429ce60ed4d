"""Small scenes with exact truth for tests: the demo's rig at half its resolution, and whole cells on disk."""

from __future__ import annotations

import functools
import math
import re
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.domain.frames import Frame, FramePair
from edged.sim.cell import demo_part, demo_rig
from edged.sim.render.scene import Part, PlacedPart, Scene, Surface, Table
from edged.sim.views import stereo_views
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import rotation_matrix
from edged.vision.teaching.region import Region

PLACE_MM = (8.0, 0.0, 205.0)
"""Point that both cameras of the demo's rig look at."""
TEXTURED = Surface(albedo=0.16, contrast=0.25, feature_mm=0.8, seed=2)


def shrunk(rig: StereoRig, by: int) -> StereoRig:
    """The rig with pixels `by` times as large: the same field of view in smaller pictures."""

    def camera(whole: CameraModel) -> CameraModel:
        return replace(
            whole,
            width=whole.width // by,
            height=whole.height // by,
            fx=whole.fx / by,
            fy=whole.fy / by,
            cx=(whole.cx + 0.5) / by - 0.5,
            cy=(whole.cy + 0.5) / by - 0.5,
        )

    return replace(rig, left=camera(rig.left), right=camera(rig.right))


def small_rig() -> StereoRig:
    """The demo's rig with pictures of 640x480."""
    return shrunk(demo_rig(), 2)


def patient(text: str) -> str:
    """A cell's configuration with limits for a busy machine: nothing moves, pictures may be late."""
    for setting in ("timeout_s = 10.0", "max_skew_ms = 1000.0"):
        text, count = re.subn(rf"^{setting.partition(' ')[0]} = [\d.]+", setting, text, flags=re.MULTILINE)
        assert 1 == count, setting
    return text


def pose(
    place_mm: tuple[float, float, float] = PLACE_MM, turn_deg: float = 0.0, tilt_deg: float = 0.0
) -> FloatArray:
    """rig_from_part: turned about its normal, then tilted about an oblique axis."""
    tilt = rotation_matrix(math.radians(tilt_deg) * np.array([0.6, 0.8, 0.0]))
    rig_from_part = np.eye(4)
    rig_from_part[:3, :3] = tilt @ rotation_matrix(np.array([0.0, 0.0, math.radians(turn_deg)]))
    rig_from_part[:3, 3] = place_mm
    return rig_from_part


def scene(*placed: tuple[Part, FloatArray], table: Surface = TEXTURED) -> Scene:
    """Parts over a table 6 mm below PLACE_MM."""
    rig_from_table = pose((PLACE_MM[0], PLACE_MM[1], PLACE_MM[2] + 6.0))
    return Scene(Table(table, rig_from_table), tuple(PlacedPart(part, where) for part, where in placed))


def pictures(rig: StereoRig, world: Scene, seed: int = 0) -> tuple[Image, Image]:
    """Left and right raw image, with the sensor's noise."""
    views = stereo_views(rig)
    left, right = (
        views[side].render(world, np.random.default_rng((seed, index)))
        for index, side in enumerate(("left", "right"))
    )
    return left, right


def clean_greys(rig: StereoRig, world: Scene) -> tuple[FloatArray, FloatArray]:
    """Left and right picture before noise and rounding, so that one scene can be given noise many times."""
    views = stereo_views(rig)
    left, right = (
        view.sensor.black + view.sensor.white * view.radiance(world).astype(np.float64)
        for view in (views["left"], views["right"])
    )
    return left, right


def noisy(grey: FloatArray, noise: float, rng: np.random.Generator) -> Image:
    """A picture with white noise, in 8 bits."""
    return np.clip(np.rint(grey + rng.normal(0, noise, grey.shape)), 0, 255).astype(np.uint8)


def frame_pair(left: Image, right: Image) -> FramePair:
    """Two images as the frames of one exposure."""
    return FramePair(Frame("left", 1, left, 0, 0), Frame("right", 1, right, 0, 0))


def region_around(rig: StereoRig, centre_mm: FloatArray, radius_mm: float) -> Region:
    """Square of the left image that holds a disc with some margin."""
    x, y = rig.left.project(centre_mm[None])[0]
    half = 1.12 * radius_mm * rig.left.fx / centre_mm[2]
    return Region(float(x - half), float(y - half), float(2 * half), float(2 * half))


@dataclass(frozen=True, slots=True, eq=False)
class Flange:
    """The demo's flange, placed for teaching on the small rig."""

    rig: StereoRig
    part: Part
    rig_from_part: FloatArray
    left: Image
    right: Image

    @property
    def region(self) -> Region:
        """Region around the whole part."""
        return region_around(self.rig, self.rig_from_part[:3, 3], 14.0)


@functools.cache
def flange() -> Flange:
    """One pair shared by all tests of a process; read-only."""
    rig, part, where = small_rig(), demo_part(), pose()
    left, right = pictures(rig, scene((part, where)))
    for image in (left, right):
        image.flags.writeable = False
    return Flange(rig, part, where, left, right)
