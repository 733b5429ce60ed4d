"""Pictures in shared memory: the cell writes them into a ring of few slots, and a page copies them out.

The memory belongs to the cell, and is bounded whatever a page does: a slot is reused without asking. A page
that is too late sees from the slot's number that it holds another pair by now, and does without. No page can
change the size of the memory or map it for writing, and the cell never reads it.
"""

from __future__ import annotations

import fcntl
import mmap
import os
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from edged.domain.arrays import Image

SLOTS = 4
ALIGN = 64
F_SEAL_FUTURE_WRITE = 0x0010
"""From <linux/fcntl.h>; Python has no name for it before 3.13. Linux has it since 5.1."""
MAX_BYTES = 1 << 30


class Placed(NamedTuple):
    """Place of a message's pictures: offset of the slot, its number, and (height, width) of each."""

    offset: int
    number: int
    sizes: list[list[int]]


class PictureRing:
    """The cell's side of the ring; used by one thread."""

    def __init__(self) -> None:
        self._map: mmap.mmap | None = None
        self._slot_bytes = 0
        self._number = 0

    def place(self, images: Sequence[Image]) -> tuple[Placed, int | None]:
        """Write pictures (H, W) uint8 into the next slot.

        Returns their place, and the descriptor of the memory if it is new, which the caller closes.
        Raises `OSError`.
        """
        needed = ALIGN + sum(_aligned(image.nbytes) for image in images)
        descriptor = None
        if self._map is None or needed > self._slot_bytes:
            self.close()
            self._slot_bytes = _aligned(needed)
            self._map, descriptor = _memory(SLOTS * self._slot_bytes)
        self._number += 1
        offset = self._number % SLOTS * self._slot_bytes
        slot = np.frombuffer(self._map, np.uint8, self._slot_bytes, offset)
        head = slot[:8].view(np.uint64)
        head[0] = 0  # being written: a page that copies now notices
        at = ALIGN
        for image in images:
            slot[at : at + image.nbytes].reshape(image.shape)[:] = image
            at += _aligned(image.nbytes)
        head[0] = self._number
        return Placed(offset, self._number, [list(image.shape) for image in images]), descriptor

    def close(self) -> None:
        """Release the memory."""
        self._map = None  # it is freed with the last array that uses it


class SharedPictures:
    """A page's side of the ring: reads the memory that came last."""

    def __init__(self) -> None:
        self._map: mmap.mmap | None = None

    def map(self, descriptor: int) -> None:
        """Use another memory; the descriptor is closed. Raises `OSError`, `ValueError`."""
        try:
            size = os.fstat(descriptor).st_size
            if size > SLOTS * MAX_BYTES:
                raise ValueError(f"{size} bytes of pictures")
            self._map = mmap.mmap(descriptor, size, prot=mmap.PROT_READ)
        finally:
            os.close(descriptor)

    def copy(self, placed: Placed) -> list[Image | None]:
        """Copy the pictures; None for each if their slot was reused. Raises `ValueError`."""
        lost: list[Image | None] = [None] * len(placed.sizes)
        if self._map is None:
            return lost
        memory = np.frombuffer(self._map, np.uint8)
        head = memory[placed.offset : placed.offset + 8].view(np.uint64)
        if head[0] != placed.number:
            return lost
        images: list[Image | None] = []
        at = placed.offset + ALIGN
        for height, width in placed.sizes:
            images.append(memory[at : at + height * width].reshape(height, width).copy())
            at += _aligned(height * width)
        return images if head[0] == placed.number else lost


def _aligned(size: int) -> int:
    return -(-size // ALIGN) * ALIGN


def _memory(size: int) -> tuple[mmap.mmap, int]:
    """Memory of a fixed size that only this process can write, and a descriptor to read it."""
    descriptor = os.memfd_create("edged-pictures", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        os.ftruncate(descriptor, size)
        ours = mmap.mmap(descriptor, size)
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW)
        try:
            fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, F_SEAL_FUTURE_WRITE | fcntl.F_SEAL_SEAL)
        except OSError:
            fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SEAL)
    except BaseException:
        os.close(descriptor)
        raise
    return ours, descriptor
