"""Groups of results on thick parts, and the width of a broken edge."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bench_solid import Part, absent, break_of, groups, missed, report


def found(tilt_deg: float, break_mm: float, error_um: float) -> Part:
    """A good result with this error along X."""
    return Part("s", "P", break_mm, tilt_deg, "good", np.array([error_um, 0, 0]), 0.03, 0.0, 1.5, 3)


@pytest.mark.parametrize(
    "stated, widest", [(0.2, 0.2), (None, 0.0), ({}, 0.0), ({"rim": 0.2, "bore": 0.3}, 0.3)]
)
def test_the_widest_break_counts(stated: object, widest: float) -> None:
    """The widest break of a set counts: one width for all edges, one for each feature, or none."""
    assert widest == break_of({"break_mm": stated})


def test_parts_are_grouped_by_breaks_and_tilt_and_decoys_are_a_group_of_their_own() -> None:
    """Results are grouped by breaks and tilt, absent parts are a group of their own, and empty groups are
    left out."""
    decoy = missed("x", absent("P"), "nothing, as it should be")
    rows = [found(10.0, 0.0, 3.0), found(40.0, 0.2, 4.0), found(20.0, 0.2, 5.0), decoy]
    sizes = {name: len(some) for name, some in groups(rows).items()}
    assert {"all": 4, "sharp": 1, "broken": 2, "tilt <= 15": 1, "tilt >= 30": 1, "broken, tilt >= 30": 1,
            "not there": 1} == sizes  # fmt: skip


def test_the_table_states_bounds_and_rms_of_what_was_good(capsys: pytest.CaptureFixture[str]) -> None:
    """The table's line has shares with bounds, and the rms of good results."""
    lost = missed("s", {"design": "P", "break_mm": 0.0, "tilt_bisector_deg": 5.0}, "not found")
    report([found(10.0, 0.0, 3.0), found(12.0, 0.0, 4.0), lost, missed("x", absent("P"), "WRONG: invented")])
    (line,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("| all |"))
    rms = f"{math.sqrt(12.5):.1f}"
    assert line == f"| all | 2 of 3 (21-94 %) | 1 of 4 (5-70 %) | {rms} | 0.030 | 1.50 |"
