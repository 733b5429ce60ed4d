"""Detection of swapped pictures: the left camera's given as the right one's."""

from __future__ import annotations

from contextlib import suppress

from edged.domain.arrays import Image
from edged.domain.frames import FramePair
from edged.domain.measurement import Status
from edged.errors import ImageError
from edged.pipeline import PreparedRig, locate
from edged.vision.part.job import Job

SWAPPED = "left and right are swapped: with the pictures exchanged it succeeds; the left camera's comes first"


def is_swapped(left: Image, right: Image, job: Job, rig: PreparedRig) -> bool:
    """Whether a pair without a good part yields one when its sides are swapped."""
    with suppress(ImageError):  # the cameras' images differ in size, so they are not swapped
        return locate(FramePair.of_images(right, left), job, rig).status is Status.OK
    return False
