"""Edge models of parts in `tests/data/cad`, and their visible samples in the small rig's cameras."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from edged.domain.arrays import FloatArray
from edged.files.step import read_step
from edged.vision.solid.edgemodel import EdgeModel, model_of, sampled
from edged.vision.solid.forms import with_breaks
from edged.vision.solid.visible import Cameras, VisibleSamples, see
from edged.vision.teaching.cadbody import body_of
from helpers.cells import small_rig

CAD = Path(__file__).parents[1] / "data" / "cad"


@functools.cache
def model(name: str = "D3", break_mm: float = 0.0) -> EdgeModel:
    """Edge model of a STEP file, its outer edges broken by `break_mm`."""
    body = body_of(read_step(CAD / f"{name}.step"), np.eye(4))
    assert body is not None
    plain = model_of(body)
    return with_breaks(plain, np.full(len(plain.start), break_mm))


def seen(part: EdgeModel, where: FloatArray, camera: int) -> VisibleSamples:
    """Visible samples, half a millimetre apart, in a picture of 640 x 480."""
    return see(part, sampled(part, 0.5), Cameras.of(small_rig(), 0).view(camera, part, where), 384)
