"""The lock: align a part, as one rigid solid, with the edges of both pictures, from coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from edged.domain.arrays import B8, F32, FloatArray, Image
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import invert
from edged.vision.kernels.jit import for_each, for_kernel, thread_number
from edged.vision.solid.edgemodel import EdgeModel, EdgePoints, sampled
from edged.vision.solid.lockstep import MOST, LevelPicture, find_edges, step
from edged.vision.solid.params import LOCK, VISIBILITY, LockStep
from edged.vision.solid.visible import (
    Cameras,
    VisibleSamples,
    hidden_from,
    samples_at,
    see,
    spacing_at,
    view_of,
)


class Pyramids:
    """Image pyramids of both pictures: cameras, grey values and slopes of each level."""

    def __init__(self, rig: StereoRig, images: Sequence[Image], levels: int) -> None:
        self.rig = rig
        self.cameras = [Cameras.of(rig, level) for level in range(levels)]
        self.grey: list[list[F32]] = []
        self._pictures: list[tuple[LevelPicture, LevelPicture]] = []
        self._for_other_thread: list[tuple[LevelPicture, LevelPicture]] = []
        now = [np.asarray(image, np.float32) for image in images]
        for level in range(levels):
            if level:
                now = [_halved(image) for image in now]
            self.grey.append(now)
            left, right = (_picture(self.cameras[level], k, image) for k, image in enumerate(now))
            self._pictures.append((left, right))

    @property
    def pictures(self) -> list[tuple[LevelPicture, LevelPicture]]:
        """Those of both cameras at each level; each thread of `for_both` draws in buffers of its own."""
        if thread_number() == 0:
            return self._pictures
        if not self._for_other_thread:
            self._for_other_thread = [(_undrawn(left), _undrawn(right)) for left, right in self._pictures]
        return self._for_other_thread


def _picture(cameras: Cameras, camera: int, grey: F32) -> LevelPicture:
    view = view_of(cameras.models[camera], cameras.from_rig[camera], np.zeros(3))
    soft = np.asarray(cv2.GaussianBlur(grey, (0, 0), LOCK.smoothing_px), np.float32)
    drawn = np.full(grey.shape, -1, np.int32)
    return LevelPicture(
        view.focal, view.centre, view.size, view.lens, view.model, view.pose, *_slopes(soft), drawn
    )


def _undrawn(picture: LevelPicture) -> LevelPicture:
    """The picture with a buffer of its own."""
    return picture._replace(drawn=np.full(picture.drawn.shape, -1, np.int32))


def _halved(image: F32) -> F32:
    height, width = (size // 2 for size in image.shape)
    return np.asarray(
        cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA),
        np.float32,
    )


_CENTRAL = np.array([[-0.5, 0.0, 0.5]], np.float32)  # central difference


def _slopes(image: F32) -> tuple[F32, F32]:
    return (
        np.asarray(cv2.filter2D(image, cv2.CV_32F, _CENTRAL), np.float32),
        np.asarray(cv2.filter2D(image, cv2.CV_32F, _CENTRAL.T), np.float32),
    )


@dataclass(frozen=True, slots=True, eq=False)
class LockedPose:
    """A part locked at pose rig_from_part (4, 4), and the share (2,) of its predicted edges that agree.

    model : the edges that it was locked by.  agreeing : for each camera.
    """

    model: EdgeModel
    pose: FloatArray
    agreeing: FloatArray

    @property
    def mean(self) -> float:
        """Mean agreement of both cameras."""
        return float(self.agreeing.mean())


def scale_at(rig: StereoRig, pose: FloatArray, model: EdgeModel) -> float:
    """Pixels of the left camera per mm at a part's centre."""
    depth = float(pose[2, :3] @ model.centre + pose[2, 3])
    return rig.left.fx / max(depth, 1.0)


def seen_by(
    model: EdgeModel, pyramids: Pyramids, pose: FloatArray, spacing_px: float
) -> list[VisibleSamples]:
    """Samples of the model that each camera sees, at full resolution."""
    samples = samples_at(model, scale_at(pyramids.rig, pose, model), spacing_px)
    views = (pyramids.cameras[0].view(k, model, pose) for k in (0, 1))
    return [see(model, samples, view, VISIBILITY.buffer_px[0]) for view in views]


def edges_beside(
    pyramids: Pyramids, camera: int, seen: VisibleSamples, reach_px: float, together: int
) -> FloatArray:
    """Edges (M, MOST) near the samples that a camera sees, px along the normals; see `find_edges`."""
    found = np.full((len(seen.row), MOST), np.nan)
    picture = pyramids.pictures[0][camera]
    find_edges(
        picture.slope_x, picture.slope_y, seen.pixels, seen.normals, seen.curve, reach_px, together,
        LOCK.fine_px, found,
    )  # fmt: skip
    return found


def lay(
    model: EdgeModel, pyramids: Pyramids, pose: FloatArray, steps: Sequence[LockStep]
) -> LockedPose | None:
    """Lock a model in several steps from a pose; None if too little of the part is seen on the way.

    Hidden samples are found again only when samples or level change: the pose moves by little.
    """
    pose, agreeing = np.array(pose, np.float64, order="C"), np.zeros(2)
    middle = for_kernel(model.centre, np.float64)
    before = None
    for how in steps:
        spacing_mm = spacing_at(scale_at(pyramids.rig, pose, model) / 2**how.level, how.spacing_px)
        if (how.level, spacing_mm) != before:
            before, samples = (how.level, spacing_mm), sampled(model, spacing_mm)
            some, hidden = _some_of(model, samples, pyramids.cameras[how.level], pose, how.level)
        fine = LOCK.fine_px if how.reach_px <= LOCK.coarse_reach_px else LOCK.coarse_px
        together = max(0, round(how.along_px / how.spacing_px / 2))
        if not step(
            some, hidden, *pyramids.pictures[how.level], middle, 0.5 * model.size_mm, how.reach_px, fine,
            together, how.cap_px, pose, agreeing,
        ):  # fmt: skip
            return None
    return LockedPose(model, pose, agreeing)


def _some_of(
    model: EdgeModel, samples: EdgePoints, cameras: Cameras, pose: FloatArray, level: int
) -> tuple[EdgePoints, B8]:
    """The samples that a camera may see as a pose is locked, and those (2, N) that are hidden from each."""
    size_px = VISIBILITY.buffer_px[min(level, len(VISIBILITY.buffer_px) - 1)]
    eyes = [for_kernel(invert(from_rig @ pose)[:3, 3], np.float64) for from_rig in cameras.from_rig]
    hidden = np.stack([hidden_from(model, samples, eye, size_px, LOCK.margin) for eye in eyes])
    seen = np.flatnonzero(~hidden.all(axis=0))
    if len(seen) < len(samples.points):
        samples = EdgePoints._make(field[seen] for field in samples)
        hidden = np.ascontiguousarray(hidden[:, seen])
    return samples, hidden


def lay_all(
    model: EdgeModel, pyramids: Pyramids, poses: Sequence[FloatArray], steps: Sequence[LockStep]
) -> list[LockedPose | None]:
    """`lay` from each of some poses, in two threads."""
    return for_each(lambda pose: lay(model, pyramids, pose, steps), poses)


def schedule(top: int) -> tuple[tuple[LockStep, ...], tuple[LockStep, ...]]:
    """Steps on the level below the top, and on the levels between that and the picture itself."""
    between = [how for level in range(max(top - 2, 0), 0, -1) for how in _at(LOCK.between, level)]
    return _at(LOCK.middle, max(top - 1, 0)), tuple(between)


def _at(steps: Sequence[tuple[float, float, float, float]], level: int) -> tuple[LockStep, ...]:
    return tuple(LockStep(level, *numbers) for numbers in steps)


FINE_STEPS = _at(LOCK.fine, 0)
"""Steps in the picture itself."""
