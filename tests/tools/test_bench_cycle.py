"""The work of a cycle, counted: what would make it slower shows here first, on any machine."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

import bench_cycle

MOST = {
    "candidates followed": 1.5,
    "fits on a coarse level": 4.5,
    "places looked around": 0.5,
    "fits on the finest level": 1.5,
    "steps of the joint fit": 6.0,
}
"""Means per cycle over the demo's flange at six poses; 1, 3, 0, 1 and 5 when they were written down."""


def test_a_cycle_does_no_more_work_than_it_did() -> None:
    """One candidate is followed down the pyramid, and the joint fit takes its five steps."""
    work = bench_cycle.work_of(bench_cycle.bench(6))
    assert set(MOST) == set(work)
    assert {} == {what: count for what, count in work.items() if not 0 <= count <= MOST[what]}
    assert work["steps of the joint fit"] > 0
