"""Evaluates a study of a size: how fit the cell is, and the report page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from edged import __version__
from edged.domain.arrays import FloatArray
from edged.report.acceptance import ReportedTest, acceptance_page
from edged.setup.acceptance.studies import Capability, GaugeStudy, capability, gauge_study, guard_bands

WORDS = {True: "fit", False: "NOT FIT", None: "conditionally fit"}
PER_LINE = 10
"""Measurements in a line of the page; a printed page would cut off longer lines."""


@dataclass(frozen=True, slots=True)
class StudiedSize:
    """A size by its name in the job, and the limits of its tolerance, mm."""

    name: str
    low_mm: float
    high_mm: float

    @property
    def tolerance_mm(self) -> float:
        """Full width of the tolerance."""
        return self.high_mm - self.low_mm


def by_master(
    sizes: Sequence[tuple[float, float]], reference_mm: float, of: StudiedSize
) -> tuple[Capability, float, ReportedTest]:
    """Capability, rms of the stated sigma, and the report of both. sizes : values and sigmas, mm.

    Raises as `capability`.
    """
    found = capability(np.array([value for value, _ in sizes]), reference_mm, of.tolerance_mm)
    sigma_mm = float(np.sqrt(np.mean([sigma**2 for _, sigma in sizes])))
    inside = guard_bands(of.low_mm, of.high_mm, float(np.hypot(sigma_mm, found.bias_mm)))
    band = (
        f"{inside[0]:.4f} to {inside[1]:.4f} mm" if inside[0] < inside[1] else "none: sigma takes all of it"
    )
    figures = {
        "measurements": f"{found.repeats}, of a master of {reference_mm:.4f} mm",
        "mean, bias": f"{found.mean_mm:.4f} mm, {1e3 * found.bias_mm:+.1f} um"
        + (" (may be chance)" if found.bias_is_chance else ""),
        "standard deviation": f"{1e3 * found.deviation_mm:.2f} um; stated sigma {1e3 * sigma_mm:.2f} um",
        "Cg, Cgk": f"{found.cg:.2f}, {found.cgk:.2f} (1.33 and more is capable)",
        "a part is proved good within": band,
    }
    return found, sigma_mm, ReportedTest("type 1, one master", WORDS[found.good], "", figures)


def by_parts(values_mm: FloatArray, of: StudiedSize) -> tuple[GaugeStudy, ReportedTest]:
    """Gauge R&R study and its report. values_mm (parts, people, trials). Raises as `gauge_study`."""
    found = gauge_study(values_mm, of.tolerance_mm)
    figures = {
        "parts, people, trials": f"{found.parts}, {found.operators}, {found.trials}",
        "repeatability": f"{1e3 * found.repeatability_mm:.2f} um",
        "reproducibility": f"{1e3 * found.reproducibility_mm:.2f} um",
        "parts": f"{1e3 * found.part_mm:.1f} um",
        "%GRR of the tolerance": f"{found.of_tolerance:.1f} (10 and less is fit, over 30 is not)",
        "%GRR of all variation": f"{found.of_variation:.1f}",
        "distinct categories": f"{found.distinct}",
    }
    return found, ReportedTest("gauge R&R", WORDS[found.good], "", figures)


def study_page(
    good: bool | None,
    of: StudiedSize,
    about: Mapping[str, str],
    tests: Sequence[ReportedTest],
    values_mm: Mapping[str, Sequence[float]],
) -> bytes:
    """The HTML page to sign. about : of which cell, by whom. values_mm : all measurements, by name."""
    rows = {
        f"{name}, from {start + 1}" if len(values) > PER_LINE else name: " ".join(
            f"{value:.4f}" for value in values[start : start + PER_LINE]
        )
        for name, values in values_mm.items()
        for start in range(0, len(values), PER_LINE)
    }
    head = {
        "size": f"{of.name}, {of.low_mm:g} to {of.high_mm:g} mm",
        **about,
        "in kind": "AIAG MSA, ISO 14253-1; no conformity is claimed",
    }
    measured = ReportedTest("all measurements", "mm", "", rows)
    return acceptance_page(
        "Study of a size", f"The gauge is {WORDS[good]}", head, [*tests, measured]
    ).encode()


def made_at(when: datetime) -> str:
    """A time, UTC, and the version that measured."""
    return f"{when:%Y-%m-%d %H:%M} UTC, edged {__version__}"
