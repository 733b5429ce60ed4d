"""Slow displacements of edges along a curve: their shapes, and how large they are in this picture.

What lies beside an edge displaces it over whole arcs, in both cameras and on all curves of one kind
alike: the light comes from one side, and of a hole's wall, or of a disc's, each camera sees the side that is
turned to it. A strip of wall that is narrower than the blur cannot be told from the edge, whatever the
operator; it moves the edge by its share of the contrast times its width (0.03 to 0.2 px), and only along the
arc where it is seen at a glancing angle. Where that is follows from the pose.

How large the displacements are is in the samples: two cameras see one circle under different angles, and
several circles share one plane, so that most displacements contradict each other. Their variance is what
they show, in proportion to how much of each the samples tell, with one wave's worth of what was expected
beforehand; what no sample tells (both cameras see a hole too small) is then taken to be as large as what
they do tell.
Sources: C. R. Rao, "Estimation of Variance and Covariance Components in Linear Models", JASA 67, 1972
(squares against their expectations); D. J. C. MacKay, "Bayesian Interpolation", Neural Computation 4, 1992
(how much of a parameter is determined).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray
from edged.vision.jit import kernel
from edged.vision.spd import invert_spd

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

WAVE_SIGMAS = (1.5, 1.0, 1.0, 0.5, 0.5)
"""Of the waves. What displaces one side of a curve, as sin+ does, has 1 / pi, 1/2 and 2 / (3 pi) of them;
light from all sides adds to the mean. Holes and discs of path-traced parts: 0.08, 0.05 and 0.03 px."""
WALL_SIGMA = 1.5
"""At its largest, which is nearly all of it: a wall displaces a fifth of the curve and not the rest."""
WALL_SLANT = 0.05
"""Tangent of the viewing angle at which a wall displaces most: 1 px of a wall of 1 to 4 mm."""
DOUBT_PX = 0.03
"""What the search for the variance starts from: from above it settles within the rounds of the solver."""
EXPECTED_WAVES = 1.0
"""Weight of what was expected, in waves: as weak as leaves an answer where no sample tells any."""
ALIKE = 0.2
"""No curve is displaced by less than this share of what its kind is: one curve's expectation is vague."""


def slow_waves(normals: FloatArray) -> FloatArray:
    """(N, 5): up to two waves around a curve by the direction of its normals (N, 2) in the image.

    What a wrong circle looks like, and a displacement: light and view have one direction in the image. Each
    has a mean square of 1 around a closed curve.
    """
    cosine, sine = normals.T
    root2 = math.sqrt(2.0)
    waves = np.empty((len(normals), 5))
    waves[:, 0] = 1.0
    waves[:, 1:3] = root2 * normals
    waves[:, 3] = root2 * (cosine * cosine - sine * sine)
    waves[:, 4] = 2.0 * root2 * cosine * sine
    return waves


def displacements(normals: FloatArray, slant: FloatArray) -> FloatArray:
    """(N, 7): shapes of what displaces the edges of a curve, each with a sigma of about 1.

    normals (N, 2) : outwards, in the image.  slant (N,) : tangent of the angle between the plane's normal and
    the ray to each sample, positive where the ray runs outwards: a hole's wall is seen there, and a disc's
    where it is negative.
    """
    waves = slow_waves(normals) * WAVE_SIGMAS
    seen = np.maximum(np.stack([slant, -slant], axis=1) / WALL_SLANT, 0.0)
    return np.hstack([waves, WALL_SIGMA * seen * np.exp(1.0 - seen)])


def evened(expected_px: FloatArray, kinds: npt.NDArray[np.int64]) -> FloatArray:
    """(G,) expected sigmas, of which none is far below the rms of its kind (G,)."""
    square = np.bincount(kinds, expected_px**2) / np.maximum(np.bincount(kinds), 1)
    return np.sqrt(expected_px**2 + ALIKE**2 * square[kinds])


def slants(points_mm: FloatArray, outwards: FloatArray, normal: FloatArray, pose: FloatArray) -> FloatArray:
    """(N,) as `displacements` wants them.

    points_mm, outwards (N, 3) : samples of curves and their normals in the plane with this normal (3,), rig
    frame.  pose (4, 4) : camera_from_rig.
    """
    rays = points_mm + pose[:3, :3].T @ pose[:3, 3]
    across = np.maximum(np.abs(rays @ normal), 1e-9)
    return np.asarray(np.sum(rays * outwards, axis=1) / across)


@kernel("UniTuple(f8, 3)(i8[::1], i8, f8, f8[:, ::1], f8[::1], f8[::1], f8[:, ::1])")
def displacement_of(
    columns: I64, shared: int, bias: float, moments: F64, own_right: F64, delta: F64, covariance: F64
) -> tuple[float, float, float]:
    """What a group's own displacement came out as: its square in px², how much of it is known, and chance.

    A wave is known by the share g by which the samples narrow its variance; its estimate is g times what the
    samples say. Of a displacement of variance v and noise alone the square is g² v and g (1 - g) bias² in the
    mean; returned are the sums of the squares, of g², and of g (1 - g) bias². The arguments are those of one
    group in `robust`: moments and own_right of its design (C) and waves (M), the solution and its covariance.
    """
    wide, size = len(columns), len(own_right)
    many = size - wide
    inner, inverse = np.empty((many, many)), np.empty((many, many))
    for m in range(many):
        for k in range(many):
            inner[m, k] = moments[wide + m, wide + k]
        inner[m, m] += 1.0 / (bias * bias)
    if not invert_spd(inner, inverse):
        return 0.0, 0.0, 0.0
    # displacement = inverse (own_right - moments x solution), so that both their errors are in its variance
    place, factor = np.full(size, -1), np.ones(size)
    for i in range(wide):
        place[i] = columns[i]
    for m in range(many if shared >= 0 else 0):
        place[wide + m], factor[wide + m] = shared + m, bias
    gain, spread = np.zeros((many, size)), np.empty(size)
    square, known, chance = 0.0, 0.0, 0.0
    for m in range(many):
        value, variance = 0.0, inverse[m, m]
        for k in range(many):
            value += inverse[m, k] * own_right[wide + k]
        for i in range(size):
            if place[i] >= 0:
                for k in range(many):
                    gain[m, i] -= inverse[m, k] * moments[wide + k, i] * factor[i]
                value += gain[m, i] * delta[place[i]]
        for i in range(size):
            spread[i] = 0.0
            if place[i] >= 0:
                for j in range(size):
                    if place[j] >= 0:
                        spread[i] += covariance[place[i], place[j]] * gain[m, j]
                variance += gain[m, i] * spread[i]
        share = max(1.0 - variance / (bias * bias), 0.0)
        square += value * value
        known += share * share
        chance += share * (1.0 - share) * bias * bias
    return square, known, chance


@kernel(
    "void(i8[:, ::1], i8[::1], i8[::1], f8[::1], f8[:, :, ::1], f8[:, ::1], f8[::1], f8[:, ::1], f8[::1])"
)
def learn_sizes(
    columns: I64,
    shared: I64,
    kinds: I64,
    expected: F64,
    moments: F64,
    own_right: F64,
    delta: F64,
    covariance: F64,
    bias: F64,
) -> None:
    """Set the sigma of each group's displacements, bias (G,), to what all of its kind show beyond noise.

    expected (G,) : the sigma expected beforehand; within a kind the proportions stay.
    """
    groups, many = len(bias), moments.shape[1] - columns.shape[1]
    square, known, chance = np.zeros(groups), np.zeros(groups), np.zeros(groups)
    for g in range(groups):
        if bias[g] <= 0.0:
            continue
        kind, first = kinds[g], shared[g]
        own, share, noise = displacement_of(
            columns[g], first, bias[g], moments[g], own_right[g], delta, covariance
        )
        square[kind] += own / expected[g] ** 2
        known[kind] += share
        chance[kind] += noise / expected[g] ** 2
        for other in range(g):
            if shared[other] == first:
                first = -1  # counted with the other
        if first >= 0:
            for m in range(many):
                share, ratio = max(1.0 - covariance[first + m, first + m], 0.0), (bias[g] / expected[g]) ** 2
                square[kind] += ratio * delta[first + m] ** 2
                known[kind] += share * share
                chance[kind] += ratio * share * (1.0 - share)
    for g in range(groups):
        if bias[g] > 0.0:
            kind = kinds[g]
            excess = max(square[kind] - chance[kind], 0.0)
            bias[g] = expected[g] * np.sqrt((EXPECTED_WAVES + excess) / (EXPECTED_WAVES + known[kind]))
