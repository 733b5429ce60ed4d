"""Plain-loop twins of the kernels of `vision/edges`: slow, but simple enough to trust."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import FloatArray, Image
from naive.stereo import cubic_value


def edge_along_normal(
    image: Image,
    point: FloatArray,
    normal: FloatArray,
    reach_px: float,
    polarity: int,
    sigma_px: float,
    step_px: float,
) -> tuple[float, float, bool]:
    """Offset and slope of the strongest edge across one point (NaN where there is none), and whether the
    sensor clips within 2.5 px of it."""
    inner, radius = math.ceil(reach_px / step_px) + 1, math.ceil(3.5 * sigma_px / step_px)
    height, width = image.shape

    def grey(place: int) -> float:
        x, y = point + place * step_px * normal
        return cubic_value(image, x, y)

    for place in (-inner - radius, inner + radius):
        x, y = point + place * step_px * normal
        if not (1 <= x < width - 2 and 1 <= y < height - 2):
            return math.nan, math.nan, False
    taps = [i * math.exp(-0.5 * (i * step_px / sigma_px) ** 2) for i in range(-radius, radius + 1)]
    gain = sum(i * step_px * tap for i, tap in zip(range(-radius, radius + 1), taps, strict=True))
    slopes = [
        sum(tap * grey(s + i) for i, tap in zip(range(-radius, radius + 1), taps, strict=True)) / gain
        for s in range(-inner, inner + 1)
    ]
    best, found = 0.0, (math.nan, math.nan)
    for s in range(1, 2 * inner):
        sign = polarity or (-1 if slopes[s] < 0 else 1)
        before, here, after = (sign * slope for slope in slopes[s - 1 : s + 2])
        if here > 0 and here >= before and here > after:
            hill = min(before, after) > 0.25 * here  # a Gaussian is a parabola in its logarithm
            values = [math.log(v) if hill else v for v in (before, here, after)]
            c, b, a = np.linalg.solve([[1, -1, 1], [1, 0, 0], [1, 1, 1]], values)  # c + b x + a x²
            fraction, top = -b / (2 * a), c - b * b / (4 * a)
            peak = math.exp(top) if hill else top
            offset = (s - inner + fraction) * step_px
            weight = peak * math.exp(-0.5 * (offset / reach_px) ** 2)
            if abs(offset) <= reach_px and weight > best:
                best, found = weight, (offset, math.copysign(peak, slopes[s]))
    if math.isnan(found[0]):
        return *found, False
    beside = range(int(found[0] / step_px - 2.5 / step_px), math.ceil(found[0] / step_px + 2.5 / step_px) + 1)
    greys = [grey(place) for place in beside if abs(place) <= inner + radius]
    return *found, max(greys) >= 254.5 or min(greys) <= 0.5


def ramer(points: list[list[float]], tolerance: float) -> list[int]:
    """Indices kept by the recursive subdivision of U. Ramer (1972)."""

    def between(a: int, b: int) -> list[int]:
        (ax, ay), (bx, by) = points[a], points[b]
        length = math.hypot(bx - ax, by - ay)
        farthest, where = tolerance, None
        for n in range(a + 1, b):
            px, py = points[n][0] - ax, points[n][1] - ay
            gap = abs(px * (by - ay) - py * (bx - ax)) / length if length > 1e-9 else math.hypot(px, py)
            if gap > farthest:
                farthest, where = gap, n
        return [] if where is None else [*between(a, where), where, *between(where, b)]

    return [0, *between(0, len(points) - 1), len(points) - 1]


def misfit(points: FloatArray) -> float:
    """Largest distance to the better of the best line and the circle of I. Kåsa (1976)."""
    centred = points - points.mean(axis=0)
    normal = np.linalg.svd(centred)[2][1]
    line = max(abs(float(point @ normal)) for point in centred)
    design = np.column_stack([centred, np.ones(len(centred))])
    (d, e, f), _, _, singular = np.linalg.lstsq(design, -(centred**2).sum(axis=1), rcond=None)
    if singular[-1] < 1e-9 * singular[0]:
        return line
    centre, radius = np.array([-d / 2, -e / 2]), math.sqrt(d * d / 4 + e * e / 4 - f)
    return min(line, max(abs(math.dist(point, centre) - radius) for point in centred))


def link(thin: npt.NDArray[np.uint8]) -> list[tuple[list[list[int]], bool]]:
    """Chains of set pixels, each with whether it is closed: first from their ends, then the rest."""
    height, width = thin.shape
    steps = [(-1, 0), (0, -1), (0, 1), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1)]
    used: set[tuple[int, int]] = set()
    chains: list[tuple[list[list[int]], bool]] = []

    def around(y: int, x: int) -> list[tuple[int, int]]:
        places = [(y + dy, x + dx) for dy, dx in steps]
        return [(v, u) for v, u in places if 0 <= v < height and 0 <= u < width and thin[v, u]]

    def walk(place: tuple[int, int] | None) -> list[list[int]]:
        chain: list[list[int]] = []
        while place is not None:
            used.add(place)
            chain.append(list(place))
            place = next((other for other in around(*place) if other not in used), None)
        return chain

    for loops in (False, True):
        for y in range(height):
            for x in range(width):
                if not thin[y, x] or (y, x) in used or (not loops and len(around(y, x)) > 1):
                    continue
                chain = walk((y, x))
                near = max(abs(chain[-1][0] - y), abs(chain[-1][1] - x)) <= 1
                closed = loops and near and len(chain) > 7
                if loops and not closed:
                    other = next((place for place in around(y, x) if place not in used), None)
                    if other is not None:
                        chain = chain[::-1] + walk(other)
                chains.append((chain, closed))
    return chains


def all_edges(
    profiles: FloatArray, together: int, reach: int, step_px: float
) -> list[list[tuple[float, float]]]:
    """Offset and slope of every extremum within `reach` steps, for each sample of a closed curve.

    profiles (N, S). Strongest first, five at most; those weaker than 0.35 of the strongest are left out."""
    count, length = profiles.shape
    radius = round(3 / step_px)
    taps = [i * step_px * math.exp(-0.5 * (i * step_px) ** 2) for i in range(-radius, radius + 1)]
    gain = sum(i * step_px * tap for i, tap in zip(range(-radius, radius + 1), taps, strict=True))
    found = []
    for n in range(count):
        around = [(n - together // 2 + j) % count for j in range(together)]
        mean = np.mean([profiles[j] for j in around], axis=0)
        slopes = {
            s: sum(tap * mean[length // 2 + s + i - radius] for i, tap in enumerate(taps)) / gain
            for s in range(-reach - 1, reach + 2)
        }
        edges = []
        for s in range(-reach, reach + 1):
            before, here, after = (abs(slopes[s + k]) for k in (-1, 0, 1))
            if math.isfinite(here) and here >= before and here > after:
                bent = before - 2 * here + after
                edges.append((step_px * (s + 0.5 * (before - after) / bent), slopes[s]))
        edges.sort(key=lambda edge: -abs(edge[1]))
        least = max(0.35 * abs(edges[0][1]), 2.0) if edges else 0.0
        found.append([edge for edge in edges[:5] if abs(edge[1]) >= least])
    return found
