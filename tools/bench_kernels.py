#!/usr/bin/env python3
"""Measure what own code gains over numpy, numba or OpenCV.

    tools/bench kernels [--json FILE]

Each row compares one of our functions with its replacement, in turn on the same data in the same run, in
processor time of one thread: the shortest of many rounds each. "off" is by how much results differ, or what
they miss. Loading is measured in new processes, some with numba's own cache; all read the same files.
"""

from __future__ import annotations

import itertools
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import cv2
import numpy as np
import numpy.typing as npt
from benching import bench_parser, finish

from edged.domain.arrays import FloatArray
from edged.vision.edges.contours import ramer
from edged.vision.edges.subpixel import tops
from edged.vision.kernels.jit import kernel
from edged.vision.kernels.median import median

Indices = npt.NDArray[np.int64]
ROUNDS = 60
LOADS = 3

# loads the kernels from a cache; prints the seconds spent on them and their number
LOAD = """
import importlib, pkgutil, sys, time, types
import numba
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher

if sys.argv[1] == "numba":
    plain = types.ModuleType("edged.vision.kernels.jitcache")
    plain.QuickCache, plain.load_quickly = FunctionCache, lambda: None
    sys.modules[plain.__name__] = plain
spent_s, many, compile_it = 0.0, 0, Dispatcher.compile

def timed(self, signature):
    global spent_s, many
    start_s = time.process_time()
    result = compile_it(self, signature)
    spent_s, many = spent_s + time.process_time() - start_s, many + 1
    return result

Dispatcher.compile = timed
import edged.vision
from edged.vision.kernels.jit import load_all
for module in pkgutil.walk_packages(edged.vision.__path__, "edged.vision."):
    load_all(importlib.import_module(module.name))
print(spent_s, many)
"""


@dataclass(frozen=True)
class Row:
    """One comparison. ours_us, theirs_us : of one call on all of the row's data."""

    what: str
    instead: str
    ours_us: float
    theirs_us: float
    off: str

    @property
    def ratio(self) -> float:
        """Duration of the replacement, in multiples of ours."""
        return self.theirs_us / self.ours_us


def shortest_us(*works: Callable[[], object]) -> list[float]:
    """Shortest processor time of each work; they are run in turn."""
    best = [np.inf] * len(works)
    for work in works:
        work()
    for _ in range(ROUNDS):
        for k, work in enumerate(works):
            start_ns = time.process_time_ns()
            work()
            best[k] = min(best[k], (time.process_time_ns() - start_ns) / 1e3)
    return best


# --- the median -----------------------------------------------------------------------------------


@kernel("void(f8[:, ::1], f8[::1])")
def medians(rows: FloatArray, found: FloatArray) -> None:
    """The median of each row, by counting."""
    for n in range(len(rows)):
        found[n] = median(rows[n])


@kernel("void(f8[:, ::1], f8[::1])")
def numpy_medians(rows: FloatArray, found: FloatArray) -> None:
    """The median of each row, by the selection that numba uses for np.median."""
    for n in range(len(rows)):
        found[n] = np.median(rows[n])


def median_row(count: int) -> Row:
    """Medians of as many samples as a curve has; new ones each time, as a processor learns repeated data."""
    rows = np.random.default_rng(0).normal(size=(2000, count))
    ours, theirs = np.empty(len(rows)), np.empty(len(rows))
    times = shortest_us(lambda: medians(rows, ours), lambda: numpy_medians(rows, theirs))
    return Row(f"median of {count}", "np.median in a kernel", *times, f"{np.abs(ours - theirs).max():.0e}")


# --- logarithm and exponential of a hill ----------------------------------------------------------


@kernel("void(f8[:, ::1], f8[::1], f8[::1])", any_order=True)
def library_tops(three: FloatArray, fraction: FloatArray, peak: FloatArray) -> None:
    """`tops` with the logarithm and the exponential of the mathematical library."""
    before, here, after = three[0], three[1], three[2]
    for n in range(len(peak)):
        rise, fall = np.log(before[n] / here[n]), np.log(after[n] / here[n])
        place = 0.5 * (rise - fall) / (rise + fall)
        fraction[n], peak[n] = place, here[n] * np.exp(-0.25 * (rise - fall) * place)


def tops_row() -> Row:
    """Peaks as a blurred step gives them, at every place between two samples."""
    rng = np.random.default_rng(0)
    places, width = rng.uniform(-0.5, 0.5, 4096), rng.uniform(0.9, 1.6, 4096)
    three = rng.uniform(10, 200, 4096) * np.exp(
        -0.5 * ((np.arange(-1.0, 2.0)[:, None] - places) / width) ** 2
    )
    ours, theirs = np.empty((2, 4096)), np.empty((2, 4096))
    times = shortest_us(lambda: tops(three, *ours), lambda: library_tops(three, *theirs))
    off = np.abs(ours[0] - theirs[0]).max()
    return Row("tops of 4096 hills, series", "np.log, np.exp in a kernel", *times, f"{off:.0e} samples")


# --- cutting a contour ----------------------------------------------------------------------------


def opencv_corners(points: FloatArray, tolerance_px: float) -> Indices:
    """`ramer` by OpenCV, which returns the points themselves, in single precision."""
    chain = points.astype(np.float32)
    kept = cv2.approxPolyDP(chain[:, None], tolerance_px, closed=False)[:, 0]
    return np.flatnonzero(np.isin(chain.view(np.complex64), kept.view(np.complex64)))


def farthest_px(points: FloatArray, corners: Indices) -> float:
    """Largest distance of a point from the chord over it."""
    farthest = 0.0
    for a, b in itertools.pairwise(corners):
        along = (points[b] - points[a]) / np.linalg.norm(points[b] - points[a])
        away = points[a : b + 1] - points[a]
        farthest = max(farthest, float(np.abs(away[:, 0] * along[1] - away[:, 1] * along[0]).max()))
    return farthest


def ramer_row() -> Row:
    """Arcs of all radii with the noise of edges, cut at one pixel as `split` does."""
    rng = np.random.default_rng(0)
    chains = []
    for _ in range(300):
        phase, radius = np.linspace(0, rng.uniform(1.0, 6.0), 400), rng.uniform(10.0, 200.0)
        arc = radius * np.column_stack([np.cos(phase), np.sin(phase)])
        chains.append(arc + rng.normal(0, 0.3, arc.shape))
    times = shortest_us(
        lambda: [ramer(chain, 1.0) for chain in chains],
        lambda: [opencv_corners(chain, 1.0) for chain in chains],
    )
    ours, theirs = (
        max(farthest_px(chain, cut(chain, 1.0)) for chain in chains) for cut in (ramer, opencv_corners)
    )
    return Row(
        "300 contours cut at 1 px", "cv2.approxPolyDP", *times, f"{ours:.2f} and {theirs:.2f} px at most"
    )


# --- loading --------------------------------------------------------------------------------------


def loading_row() -> Row:
    """All kernels of the core from the cache on disk."""
    spent_us: dict[str, list[float]] = {"ours": [], "numba": []}
    kernels = 0
    for cache in ("numba", *["ours", "numba"] * LOADS):  # the first one may have to compile
        done = subprocess.run(
            [sys.executable, "-c", LOAD, cache], capture_output=True, text=True, check=True, timeout=600
        )
        seconds, number = done.stdout.split()
        spent_us[cache].append(float(seconds) * 1e6)
        kernels = int(number)
    ours, theirs = min(spent_us["ours"]), min(spent_us["numba"])
    return Row(f"{kernels} kernels loaded", "numba's FunctionCache", ours, theirs, "same code")


def main() -> int:
    """Run everything and print one table."""
    parser = bench_parser(__doc__)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rows = [
        *(median_row(count) for count in (60, 300, 1000)),
        tops_row(),
        ramer_row(),
        loading_row(),
    ]
    print("| what | instead | ours µs | theirs µs | ratio | off |\n|---|---|---:|---:|---:|---|")
    for row in rows:
        print(
            f"| {row.what} | {row.instead} | {row.ours_us:.0f} | {row.theirs_us:.0f} "
            f"| {row.ratio:.2f} | {row.off} |"
        )
    finish(options, [{**asdict(row), "ratio": row.ratio} for row in rows])
    return 0


if __name__ == "__main__":
    sys.exit(main())
