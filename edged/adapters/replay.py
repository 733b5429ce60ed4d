"""Image pairs from a folder, behind the `Camera` port.

`replay_cameras` checks the folder and returns both cameras; they go through the pairs of `edged.files.pairs`
in step, in the order of their names, and start again after the last one.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from pathlib import Path

from edged.domain.arrays import SIDES, Image
from edged.domain.frames import Frame
from edged.errors import CameraUnreachable, FrameIncomplete, FrameTimeout, ImageError
from edged.files.images import load_image
from edged.files.pairs import ImagePair, find_pairs


class PairSequence:
    """The sequence of pairs that two `ReplayCamera`s go through in step.

    An exposure begins when a side that has taken part in the current one asks again; the other side joins it.
    """

    def __init__(self, pairs: Sequence[ImagePair], shape: tuple[int, int]) -> None:
        self.pairs = tuple(pairs)
        self.shape = shape
        self.number = 0
        self.exposed_ns = 0
        self._taken: set[str] = set(SIDES)

    def expose(self, side: str) -> None:
        """Join the exposure that the other side began, or begin the next one."""
        if side in self._taken:
            self.number += 1
            self.exposed_ns = time.time_ns()
            self._taken.clear()
        self._taken.add(side)

    def resynchronise(self) -> None:
        """End the exposure, so that the next `expose` begins a new one."""
        self._taken = set(SIDES)

    def load(self, side: str, number: int) -> Image:
        """Read the image of exposure `number`, from 1. Raises `ImageError`."""
        pair = self.pairs[(number - 1) % len(self.pairs)]
        path = pair.left if side == "left" else pair.right
        image = load_image(path)
        if image.shape != self.shape:
            raise ImageError(f"{path}: {_size(image.shape)}, expected {_size(self.shape)} as the first image")
        return image


class ReplayCamera:
    """Camera for one side of a folder of pairs."""

    def __init__(self, name: str, reel: PairSequence) -> None:
        if name not in SIDES:
            raise ValueError(f"a replay camera is left or right, not {name!r}")
        self._name = name
        self._reel = reel
        self._is_open = False
        self._exposure: tuple[int, int] | None = None

    @property
    def name(self) -> str:
        """ "left" or "right"."""
        return self._name

    async def open(self) -> None:
        """Mark the camera as open; the sequence continues where it was."""
        if not self._is_open:
            self._is_open = True
            self._reel.resynchronise()

    async def trigger(self) -> None:
        """Go to the next pair."""
        if not self._is_open:
            raise CameraUnreachable(self._name, "not open")
        self._reel.expose(self._name)
        self._exposure = (self._reel.number, self._reel.exposed_ns)

    async def frame(self) -> Frame:
        """Return the image of the last trigger. Raises `FrameIncomplete` for a file that has become bad."""
        if self._exposure is None:
            raise FrameTimeout(self._name, "no exposure was triggered")
        (number, exposed_ns), self._exposure = self._exposure, None
        try:
            image = await asyncio.to_thread(self._reel.load, self._name, number)
        except ImageError as error:
            raise FrameIncomplete(self._name, str(error)) from error
        return Frame(self._name, number, image, exposed_ns, exposed_ns)

    async def close(self) -> None:
        """Mark the camera as closed, and forget the exposure under way."""
        self._is_open = False
        self._exposure = None


def replay_cameras(folder: Path) -> tuple[ReplayCamera, ReplayCamera]:
    """Left and right camera of a folder of pairs.

    Raises `ImageError` for a folder without complete pairs (see `find_pairs`) and for a first pair that
    cannot be read or whose halves differ in size. Every later image must have the size of the first.
    """
    pairs = find_pairs(folder)
    left = load_image(pairs[0].left)
    reel = PairSequence(pairs, (left.shape[0], left.shape[1]))
    reel.load("right", 1)
    return ReplayCamera("left", reel), ReplayCamera("right", reel)


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]}x{shape[0]} pixels"
