"""Buffers of the search, allocated once per image size: fresh large arrays cost page faults."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain.arrays import Image
from edged.vision.kernels.jit import for_kernel
from edged.vision.shape.params import SCAN
from edged.vision.shape.refine import no_step

_NOTHING = np.empty(0, np.uint8)
_ALL_VALID = np.ones((1, 1), np.uint8)  # a mask of one pixel stands for no mask


class Workspace:
    """The pyramid of one image with gradients, and the buffers of the exhaustive scan.

    Reused from image to image; one per thread. Level l has pixel centres at (x + 0.5) / 2**l - 0.5.
    step : to be filled by a step of `refine`.
    """

    def __init__(self) -> None:
        self.images: list[Image] = []
        self._gradients: list[tuple[npt.NDArray[np.int16], npt.NDArray[np.int16]] | None] = []
        self._pool: dict[tuple[str, int], tuple[npt.NDArray[Any], npt.NDArray[Any]]] = {}
        self.step = no_step()
        self._masks: dict[tuple[int, ...], tuple[Image, Image]] = {}

    def load(self, image: Image, levels: int) -> None:
        """Build the pyramid (area averages) of an image (H, W) uint8, at most `levels` high."""
        self.images = [for_kernel(image, np.uint8)]
        while len(self.images) < levels:
            height, width = self.images[-1].shape
            if min(height, width) < 2 * SCAN.min_level_px:
                break
            below = self.images[-1][: height // 2 * 2, : width // 2 * 2]
            level = self.buffer("image", (height // 2, width // 2), np.uint8, len(self.images))
            cv2.resize(below, (width // 2, height // 2), dst=level, interpolation=cv2.INTER_AREA)
            self.images.append(level)
        self._gradients = [None] * len(self.images)

    def forget(self) -> None:
        """Release the image; the buffers are kept."""
        self.images, self._gradients = [], []

    def gradient(self, level: int) -> tuple[npt.NDArray[np.int16], npt.NDArray[np.int16]]:
        """Sobel x and y (H, W) int16 of a level, computed on first use."""
        found = self._gradients[level]
        if found is None:
            shape = self.images[level].shape
            gx = self.buffer("gx", shape, np.int16, level)
            gy = self.buffer("gy", shape, np.int16, level)
            cv2.spatialGradient(self.images[level], gx, gy)
            found = self._gradients[level] = (gx, gy)
        return found

    def mask(self, valid: Image | None, level: int) -> Image:
        """A mask (H, W) uint8 on a level, shrunk so that its border is no edge; (1, 1) for none.

        The last read-only mask is cached, as it cannot change.
        """
        if valid is None:
            return _ALL_VALID
        shape = self.images[level].shape
        kept = self._masks.get(shape)
        if kept is not None and kept[0] is valid:
            return kept[1]
        full = cv2.resize((valid > 0).astype(np.uint8) * 255, shape[::-1], interpolation=cv2.INTER_AREA)
        # a gradient reaches 1 px, and the area average of a partly hidden pixel is no grey value
        shrunk = np.asarray(cv2.erode((full == 255).astype(np.uint8), np.ones((3, 3), np.uint8)), np.uint8)
        if not valid.flags.writeable and valid.base is None:
            self._masks[shape] = (valid, shrunk)
        return shrunk

    def buffer(
        self, name: str, shape: tuple[int, ...], dtype: npt.DTypeLike, slot: int = 0
    ) -> npt.NDArray[Any]:
        """An array of this shape, not cleared; its memory is kept and reused."""
        flat, shaped = self._pool.get((name, slot)) or (_NOTHING, _NOTHING)
        if shaped.shape != shape or shaped.dtype != dtype:
            size = math.prod(shape)
            if flat.size < size or flat.dtype != dtype:
                flat = np.empty(size, dtype)
            shaped = flat[:size].reshape(shape)
            self._pool[(name, slot)] = flat, shaped
        return shaped


class WorkspacePool:
    """Workspaces for as many searches as run at once, from any thread; the last one used is lent first."""

    def __init__(self) -> None:
        self._free: list[Workspace] = []

    @contextmanager
    def lend(self) -> Iterator[Workspace]:
        """A workspace for exclusive use until the block ends."""
        try:
            work = self._free.pop()  # one step under the GIL: two threads never get the same
        except IndexError:
            work = Workspace()
        try:
            yield work
        finally:
            work.forget()
            self._free.append(work)
