"""The lock of a body onto a pair."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.drawnparts import images_of, place
from solids import random_design
from solidworld import write_drawing

from edged.files.step import read_step
from edged.vision.geometry.rigid import rotation_matrix, transform
from edged.vision.solid import lock
from edged.vision.solid.edgemodel import model_of, sampled
from edged.vision.solid.forms import with_breaks
from edged.vision.solid.params import BREAKS
from edged.vision.teaching.cadbody import body_of


def test_a_lock_is_the_same_whatever_is_cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Samples made anew each time give the pose, to the last bit, that kept ones give: another thread may
    take them out of the cache between two steps."""
    write_drawing(tmp_path, random_design(4))
    body = body_of(read_step(tmp_path / "P4.step"), np.eye(4))
    assert body is not None
    model, images = with_breaks(model_of(body), 0.3), images_of(4, 5)
    pyramids = lock.Pyramids(images.rig, images.raw, BREAKS.levels)
    starts = [
        place(0.0) @ transform(rotation_matrix(np.array([lean, -lean, 0.0])), np.array([0.3, -0.2, 0.5]))
        for lean in (0.0, 0.02, 0.05)
    ]
    kept = lock.lay_all(model, pyramids, starts, BREAKS.steps)
    monkeypatch.setattr(lock, "sampled", sampled.__wrapped__)
    anew = lock.lay_all(model, pyramids, starts, BREAKS.steps)
    assert kept[0] is not None
    for first, other in zip(kept, anew, strict=True):
        assert (first is None) == (other is None)
        if first is not None and other is not None:
            assert np.array_equal(first.pose, other.pose)
            assert np.array_equal(first.agreeing, other.agreeing)
