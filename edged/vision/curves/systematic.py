"""Systematic edge shifts along a curve: their shapes, and estimates of their size in a picture.

The surroundings of an edge displace it over whole arcs, on all curves of one kind alike. Texture, tool marks
and rounded rims do so in space, so that both cameras see the same; gloss and shading do so differently in
each camera; and each camera sees that side of a hole's or a disc's wall that is turned to it. A strip of
wall that is narrower than the blur cannot be separated from the edge, whatever the operator; it moves the
edge by its share of the contrast times its width (0.03 to 0.2 px), and only along the arc where it is seen
at a glancing angle, which follows from the pose.

The size of the shifts is estimated from the samples: two cameras see one circle under different angles, and
several circles share one plane, so that most shifts contradict each other. Their variance is that of the
estimated shifts, relative to how well the samples determine each of them, with one wave of the expected
variance added; shifts that no sample shows (both cameras see a hole too small) are then taken to be as large
as those that do show.
Sources: C. R. Rao, "Estimation of Variance and Covariance Components in Linear Models", JASA 67, 1972
(squares against their expectations); D. J. C. MacKay, "Bayesian Interpolation", Neural Computation 4, 1992
(how much of a parameter is determined).
"""

from __future__ import annotations

import numpy as np

from edged.domain.arrays import F64, I64
from edged.vision.curves.params import FIT
from edged.vision.curves.samples import JointSolution, Memory, Samples
from edged.vision.kernels.jit import kernel

# numba freezes globals when it compiles: kernels read these by name
DOUBT_PX = FIT.doubt_px
EXPECTED_WAVES = FIT.expected_waves
WAVE_SIGMAS = FIT.wave_sigmas
WALL_SIGMA = FIT.wall_sigma
WALL_SLANT = FIT.wall_slant
ALIKE = FIT.alike


@kernel("void(f8[:, ::1], f8[:, ::1])")
def fill_waves(normals: F64, waves: F64) -> None:
    """Fill (N, 5): up to two waves around a curve by the direction of its normals (N, 2) in the image.

    An error of the circle has this form, and so has a displacement, as light and view have one direction in
    the image. Each wave has a mean square of 1 around a closed curve.
    """
    root2 = np.sqrt(2.0)
    for n in range(len(normals)):
        cosine, sine = normals[n, 0], normals[n, 1]
        waves[n, 0], waves[n, 1], waves[n, 2] = 1.0, root2 * cosine, root2 * sine
        waves[n, 3], waves[n, 4] = root2 * (cosine * cosine - sine * sine), 2.0 * root2 * cosine * sine


FAMILIES = np.repeat([0, 1], [2 * len(FIT.wave_sigmas), 2])
"""Family of each column of `fill_shifts`: 0 waves, 1 walls; the sigma of each is estimated per picture."""


@kernel("void(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, :, ::1])")
def fill_shifts(normals: F64, gain: F64, slant: F64, shifts: F64) -> None:
    """Fill shifts (2, N, 12), left and right image: shapes of displacements of a curve, for a sigma of 1.

    First waves that displace the curve in space and hence in both images alike, then waves that displace it
    in opposite senses, then the walls of holes and of discs. `FAMILIES` numbers these.
    normals (N, 2) : outwards, in the left image.  gain (2, N) : motion along the normals of both images per
    motion of the curve along its own normal.
    slant (2, N) : tangent of the angle between the plane's normal and the ray from each camera, positive
    where the ray runs outwards: a hole's wall is seen there, a disc's wall where it is negative.
    """
    many = len(WAVE_SIGMAS)
    waves = np.empty((len(normals), many))
    fill_waves(normals, waves)
    for n in range(len(normals)):
        middle = max(abs(0.5 * (gain[0, n] + gain[1, n])), 1e-9)
        for side in range(2):
            scale, half, found = gain[side, n] / middle, 0.5 - side, shifts[side, n]
            for m in range(many):
                wave = waves[n, m] * WAVE_SIGMAS[m]
                found[m], found[many + m] = wave * scale, half * wave * scale
            for wall in range(2):
                tangent = slant[side, n] if wall == 0 else -slant[side, n]
                seen = max(tangent / WALL_SLANT, 0.0)
                found[2 * many + wall] = 0.0
                if seen != 0.0:  # True for NaN, too; skips the costly exponential
                    found[2 * many + wall] = WALL_SIGMA * seen * np.exp(1.0 - seen) * scale


@kernel("f8[::1](f8[::1], i8[::1])")
def shrunk(expected_px: F64, kinds: I64) -> F64:
    """(K,) expected sigmas, raised so that none is far below the rms of its kind; kinds (K,), below K."""
    count = len(kinds)
    square, many, result = np.zeros(count), np.zeros(count), np.empty(count)
    for k in range(count):
        square[kinds[k]] += expected_px[k] ** 2
        many[kinds[k]] += 1.0
    for k in range(count):
        mean = square[kinds[k]] / many[kinds[k]]
        result[k] = np.sqrt(expected_px[k] ** 2 + ALIKE**2 * mean)
    return result


@kernel("void(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1])")
def fill_slants(points: F64, normals: F64, face: F64, pose: F64, slant: F64) -> None:
    """Fill slant (N,) of one camera for `fill_shifts`.

    points (N, 3), normals (N, 2) : samples of curves and their normals in a face (4, 3).  pose (4, 4) :
    camera_from_rig.
    """
    eye = np.zeros(3)
    for i in range(3):
        for j in range(3):
            eye[i] -= pose[j, i] * pose[j, 3]
    for n in range(len(points)):
        outward, away = 0.0, 0.0
        for i in range(3):
            ray = face[3, i] - eye[i]
            for axis in range(3):
                ray += points[n, axis] * face[axis, i]
            outward += ray * (normals[n, 0] * face[0, i] + normals[n, 1] * face[1, i])
            away += ray * face[2, i]
        slant[n] = outward / max(abs(away), 1e-9)


@kernel(
    "void(Samples, Memory, JointSolution, i8, i8, f8[:, ::1])",
    tuples=(Samples, Memory, JointSolution),
    any_order=True,
)
def shift_of(
    samples: Samples, memory: Memory, solution: JointSolution, curve: int, shared: int, found: F64
) -> None:
    """Add a curve's estimated displacement to found (F, 3). shared : as in `Samples`, or -1 to leave it out.

    A wave is determined by the share g by which the samples reduce its prior variance; its estimate is g
    times the value in the samples. The mean square of the estimate is g² v for a displacement of variance v,
    and g (1 - g) bias² for noise alone; found gets, for each family, the sums of the squares, of g², and of
    g (1 - g) bias². Used are the moments and own_right of the curve's design (C) and waves (A), the
    covariance (A, A) of the displacement if its unknowns were known, the solution and its covariance.
    """
    columns, families, bias = samples.columns[curve], samples.families, solution.bias[curve]
    inverse, moments, own_right = memory.inverse[curve], memory.moments[curve], memory.own_right[curve]
    delta, covariance = solution.delta, solution.covariance
    wide, size, many = len(columns), len(own_right), len(inverse)
    # displacement = inverse (own_right - moments x solution): its variance includes the errors of both
    place, factor = np.full(size, -1), np.ones(size)
    for i in range(wide):
        place[i] = columns[i]
    for m in range(many if shared >= 0 else 0):
        place[wide + m], factor[wide + m] = shared + m, bias[families[m]]
    step, known = np.zeros(size), np.zeros((size, size))  # of its unknowns; 0 where there is none
    for i in range(size):
        if place[i] < 0:
            continue
        step[i] = factor[i] * delta[place[i]]
        for j in range(size):
            if place[j] >= 0:
                known[i, j] = factor[i] * factor[j] * covariance[place[i], place[j]]
    gain = np.empty(size)
    for m in range(many):
        sigma = bias[families[m]]
        value, variance = 0.0, inverse[m, m]
        gain[:] = 0.0
        for k in range(many):
            part, row = inverse[m, k], moments[wide + k]
            value += part * own_right[wide + k]
            for i in range(size):
                gain[i] -= part * row[i]
        for i in range(size):
            row, spread = known[i], 0.0
            for j in range(size):
                spread += row[j] * gain[j]
            variance += gain[i] * spread
            value += gain[i] * step[i]
        share = max(1.0 - variance / (sigma * sigma), 0.0)
        found[families[m], 0] += value * value
        found[families[m], 1] += share * share
        found[families[m], 2] += share * (1.0 - share) * sigma * sigma


@kernel("void(Samples, Memory, JointSolution)", tuples=(Samples, Memory, JointSolution))
def estimate_variance_components(samples: Samples, memory: Memory, solution: JointSolution) -> None:
    """Set the sigmas of each curve's shifts, bias (K, F), to what all curves of its kind show beyond noise.

    expected (K, F) : the prior sigmas; their proportions within a kind are kept.
    """
    shared, kinds, families, expected = samples.shared, samples.kinds, samples.families, samples.expected
    delta, covariance, bias = solution.delta, solution.covariance, solution.bias
    curves, many = len(kinds), len(families)
    total, own = np.zeros((curves, expected.shape[1], 3)), np.zeros((expected.shape[1], 3))
    for k in range(curves):
        own[:] = 0.0
        first = shared[k]
        shift_of(samples, memory, solution, k, first, own)
        for other in range(k):
            if shared[other] == first:
                first = -1  # already counted with the other curve
        for m in range(many if first >= 0 else 0):
            f, square = families[m], bias[k, families[m]] ** 2
            share = max(1.0 - covariance[first + m, first + m], 0.0)
            own[f, 0] += square * delta[first + m] ** 2
            own[f, 1] += share * share
            own[f, 2] += square * share * (1.0 - share)
        for f in range(len(own)):
            total[kinds[k], f, 0] += own[f, 0] / expected[k, f] ** 2
            total[kinds[k], f, 1] += own[f, 1]
            total[kinds[k], f, 2] += own[f, 2] / expected[k, f] ** 2
    for k in range(curves):
        for f in range(expected.shape[1]):
            square, known, chance = total[kinds[k], f]
            excess = max(square - chance, 0.0)
            bias[k, f] = expected[k, f] * np.sqrt((EXPECTED_WAVES + excess) / (EXPECTED_WAVES + known))
