"""Dirt on marks: at its place, and nowhere else in a picture."""

from __future__ import annotations

import numpy as np
from helpers.markedplate import AT, OWN, VIEWS, pair
from hypothesis import given
from hypothesis import strategies as st

from edged.domain.arrays import SIDES
from edged.sim.dirt import OIL_DARK, oiled, swarf
from edged.vision.geometry.rigid import apply


def test_a_chip_lies_where_it_was_laid_in_both_pictures() -> None:
    """A chip changes both pictures within 3 mm of its place and nowhere else."""
    chips = swarf(np.random.default_rng(3), AT, OWN[2:3])
    clean, dirty = pair(AT, 4), pair(AT, 4, *chips)
    for side, before, after in zip(SIDES, clean, dirty, strict=True):
        changed = np.argwhere(before != after)[:, ::-1]
        place = VIEWS[side].project(apply(AT, OWN[2:3]))[0]
        assert len(changed) > 20
        assert np.abs(changed - place).max() < 3.0 * 3180.0 / 200.0


@given(st.integers(0, 99), st.floats(10.0, 40.0))
def test_oil_takes_light_where_it_is(seed: int, radius_px: float) -> None:
    """Oil darkens an even surface by at most its share, and not beyond its rim."""
    rng = np.random.default_rng(seed)
    image = np.full((90, 120), 200, np.uint8)
    place = rng.uniform((20, 20), (100, 70))
    found = oiled(image, place[None], radius_px)
    y, x = np.mgrid[:90, :120]
    away = np.hypot(x - place[0], y - place[1])
    assert (found[away >= radius_px] == 200).all()
    assert found.min() >= round(200 * (1 - OIL_DARK)) - 1
    assert found[away < 0.3 * radius_px].max() < 150
