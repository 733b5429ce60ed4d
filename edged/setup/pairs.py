"""Stereo pairs for processing: pictures are read when needed, and two are processed at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol, Self, TypeVar

from edged.domain.arrays import SIDES, Image, Side
from edged.errors import CalibrationError, ImageError, translated
from edged.files.atomic import write_atomically
from edged.files.images import load_image
from edged.files.pairs import ImagePair
from edged.pictures.encoding import jpeg, png
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import check_size

THUMBNAIL_QUALITY = 95
"""JPEG quality of small pictures."""
_WORKERS = 2  # OpenCV and the corner kernel release the GIL; a cell PC has at least two cores
T = TypeVar("T")


def load_pair(rig: StereoRig, left: Path, right: Path) -> tuple[Image, Image]:
    """Load both pictures. Raises `ImageError` that names the file, also if its size is not the rig's."""
    images = load_image(left), load_image(right)
    for path, image, side in zip((left, right), images, SIDES, strict=True):
        try:
            check_size(rig.camera(side), image, side)
        except ImageError as error:
            raise ImageError(f"{path}: {error}") from error
    return images


class Progress(Protocol):
    """Callback for progress, called in the thread that requested the work; an exception ends the work."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report progress. stage : in words. done of total pieces; total 0 for one piece that has begun."""


def silent(stage: str, done: int, total: int) -> None:
    """Progress callback that does nothing."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture. label : its name in messages. read : returns its pixels; raises `ImageError`."""

    label: str
    read: Callable[[], Image]


@dataclass(frozen=True, slots=True)
class Pair:
    """Two pictures of one exposure."""

    name: str
    left: Picture
    right: Picture

    @classmethod
    def of_files(cls, pair: ImagePair) -> Self:
        """Pair of pictures on disc, read again each time they are needed."""
        left, right = (Picture(path.name, partial(load_image, path)) for path in (pair.left, pair.right))
        return cls(pair.name, left, right)

    @classmethod
    def of_images(cls, name: str, left: Image, right: Image) -> Self:
        """Pair of pictures in memory. left, right : (H, W) uint8, not to be changed any more."""
        return cls(name, Picture(f"{name}_left", lambda: left), Picture(f"{name}_right", lambda: right))

    def side(self, side: Side) -> Picture:
        """The picture of one camera."""
        return self.left if side == "left" else self.right


def work_on(tasks: Sequence[Callable[[], T]], stage: str, progress: Progress) -> list[T]:
    """Results of all tasks, in their order; two run at a time.

    The first error in that order ends the work; tasks that have not begun are dropped.
    """
    with _pool() as pool:
        futures = [pool.submit(task) for task in tasks]
        progress(stage, 0, len(tasks))
        results: list[T] = []
        for future in futures:
            results.append(future.result())
            progress(stage, len(results), len(tasks))
    return results


@contextmanager
def _pool() -> Iterator[ThreadPoolExecutor]:
    """Thread pool that drops tasks not begun when an error or ctrl-C ends the block."""
    pool = ThreadPoolExecutor(_WORKERS, thread_name_prefix="board")
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def write_sides(
    folder: Path, name: str, images: tuple[Image, Image], encode: Callable[[Image], bytes] = png
) -> None:
    """Write both pictures; the left one is last, as its file makes them a pair. name : with {side} in it.

    Raises `OSError`.
    """
    for side, image in reversed(list(zip(SIDES, images, strict=True))):
        write_atomically(folder / name.format(side=side), encode(image))


def write_pair(folder: Path, name: str, images: tuple[Image, Image], small: tuple[Image, Image]) -> None:
    """Write a pair to a draft's folder, lossless, and small JPEGs of it.

    Raises `CalibrationError` if it cannot be written.
    """
    with translated(CalibrationError, f"{folder}: the pair cannot be kept"):
        write_sides(folder / "pictures", f"{name}_{{side}}.png", images)
        write_sides(folder / "small", f"{name}_{{side}}.jpg", small, partial(jpeg, quality=THUMBNAIL_QUALITY))
