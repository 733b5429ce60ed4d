"""What decides between two poses of a part: few edges, and edges that do not show, say only so much."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edged.vision.solid.edgemodel import EDGES
from edged.vision.solid.evidence import PoseEvidence, margin_over, sigmas_of
from edged.vision.solid.params import DECISION, EVIDENCE


def evidence(hits: dict[int, bool], samples: int, column: int = 10) -> PoseEvidence:
    """Evidence of edges, each a column of samples in the left picture, which shows it or not."""
    curve = np.repeat(EDGES * np.array(list(hits)), samples)
    pixels = np.column_stack([column * (1 + curve // EDGES), np.tile(np.arange(samples), len(hits))])
    return PoseEvidence(
        np.repeat(list(hits.values()), samples), np.full(len(curve), 0.2), curve, pixels.astype(np.float64),
        np.zeros(len(curve), np.int64), np.ones(len(curve), bool),
    )  # fmt: skip


def test_an_edge_that_does_not_show_counts_once_however_long() -> None:
    """A hundred samples of it say no more against a pose than that it does not show, as one in seven."""
    seen = evidence({0: True, 1: False}, 100)
    assert float(seen.log_ratio().sum()) < float(seen.log_ratio(by_edge=True).sum())
    alone = evidence({1: False}, 100)
    assert float(alone.log_ratio(by_edge=True).sum()) == pytest.approx(math.log(1 - EVIDENCE.shown))
    shown = evidence({0: True}, 100)
    np.testing.assert_array_equal(shown.log_ratio(), shown.log_ratio(by_edge=True))


def test_a_pose_does_not_win_by_an_edge_that_the_other_one_misses() -> None:
    """Both explain one edge; the other one predicts another, which does not show: the turn stays in doubt."""
    first, other = evidence({0: True}, 100), evidence({0: True, 1: False}, 100)
    assert 0.0 < margin_over(first, other) < DECISION.certain
    more = evidence({0: True, 1: True}, 100)
    assert margin_over(more, first) > DECISION.certain


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_few_nats_are_few_sigmas(sign: float) -> None:
    """Odds of a hundred to one are three sigmas, though the ratios hardly scatter."""
    assert sign * sigmas_of(sign * np.array([2.3, 2.3])) == pytest.approx(math.sqrt(2 * 4.6))
    assert sign * sigmas_of(sign * np.full(40, 1.5)) == pytest.approx(math.sqrt(2 * 60.0))
    assert sigmas_of(np.zeros(0)) == 0.0
