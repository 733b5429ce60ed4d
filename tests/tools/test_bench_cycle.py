"""The counted work of a cycle: extra work shows here on any machine."""

from __future__ import annotations

from typing import Any

import bench_cycle
import numpy as np
import pytest
import scenes

from edged.vision.shape import scan
from edged.vision.shape.learning import create_model
from edged.vision.shape.scan import Array
from edged.vision.shape.search import SearchParams, find_shapes

MOST = {
    "candidates followed": 1.5,
    "fits on a coarse level": 4.5,
    "places looked around": 0.5,
    "fits on the finest level": 1.5,
    "joint fits": 3.5,
    "coarse steps of the joint fit": 5.0,
    "steps of the joint fit": 2.0,
    "Python calls": 1500.0,
}
"""Most work per cycle, over the demo's flange at six poses; 1, 3, 0, 1, 3, 4, 1 and 1,300 when written
down."""


@pytest.mark.long
def test_a_cycle_does_no_more_work_than_it_did() -> None:
    """No count of a cycle is above its limit."""
    work = bench_cycle.work_of(bench_cycle.bench(6))
    assert set(MOST) == set(work)
    assert {} == {what: count for what, count in work.items() if not 0 <= count <= MOST[what]}
    assert work["steps of the joint fit"] > 0


def test_a_small_part_is_scanned_in_few_poses(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scan of a small part begins on a large level with at most 110 poses, and finds the part."""
    part, rng, poses = scenes.bracket(60.0), np.random.default_rng(1), list[int]()
    model = create_model(*scenes.teach_image(part))
    image = scenes.render([(part, scenes.Truth(300.0, 200.0, 1.0))], scenes.Look(noise=5), rng, (640, 480))
    exhaustive = scan.scan

    def counted(maps: Array, offsets: Array, *others: Any) -> None:
        poses.append(len(offsets))
        exhaustive(maps, offsets, *others)

    monkeypatch.setattr(scan, "scan", counted)
    asked = SearchParams(scale_min=0.8, scale_max=4 / 3, polarity="local")
    (found,) = find_shapes(image, model, asked)
    assert (found.x_px, found.y_px) == pytest.approx((300.0, 200.0), abs=0.1)
    assert 2 == len(model.levels)
    assert 0 < poses[0] <= 110
