"""`edged study`: is the cell fit to inspect a size? Capability by a master, and gauge R&R."""

from __future__ import annotations

import json
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from rich.console import Console

from edged import __version__
from edged.commands.saying import say
from edged.domain.numerals import decimal
from edged.errors import UserError
from edged.files.atomic import write_file
from edged.files.jobs import load_job
from edged.files.outputs import check_outputs
from edged.files.pairs import ImagePair
from edged.files.rig import load_rig
from edged.pipeline import PreparedRig, prepare
from edged.report.acceptance import ReportedTest, acceptance_page
from edged.setup.acceptance.measuring import crossed, pairs_of, sizes_in, studied_folders
from edged.setup.acceptance.studies import Capability, GaugeStudy, capability, gauge_study, guard_bands
from edged.vision.part.job import Job

WORDS = {True: "fit", False: "NOT FIT", None: "conditionally fit"}


def study(
    folder: Path,
    rig: Path,
    job: Path,
    size: str,
    limits: tuple[float, float],
    console: Console,
    *,
    reference: float | None = None,
    report: Path | None = None,
    as_json: bool = False,
) -> int:
    """Study what `folder` has: master/ (with `reference`), parts/PART/PERSON/. 0: fit; 1: not, or hardly.

    size : as in `edged verify --length`. limits : of the tolerance, mm. Raises `UserError`.
    """
    low, high = limits
    check_outputs({"--report": report})
    prepared, taught = prepare(load_rig(rig)), load_job(job)
    master, parts = folder / "master", folder / "parts"
    if not (master.is_dir() or parts.is_dir()):
        raise UserError(
            f"{folder}: expected master/ with pairs of one part, or parts/PART/PERSON/ with pairs"
        )
    tests: list[ReportedTest] = []
    verdicts: list[bool | None] = []
    figures: dict[str, object] = {}
    if master.is_dir():
        if reference is None:
            raise UserError(f"{master}: --reference MM says how large the master is")
        found, sigma_mm = _of_master(prepared, taught, master, size, reference, high - low)
        verdicts.append(found.good)
        tests.append(_master_test(found, sigma_mm, low, high))
        figures["type1"] = asdict(found) | {"good": found.good, "sigma_mm": sigma_mm}
    if parts.is_dir():
        gauge = _of_parts(prepared, taught, parts, size, high - low)
        verdicts.append(gauge.good)
        tests.append(_parts_test(gauge))
        figures["grr"] = asdict(gauge) | {"good": gauge.good}
    good = False if False in verdicts else None if None in verdicts else True
    if report is not None:
        about = {
            "size": f"{size}, {low:g} to {high:g} mm",
            "rig": f"{rig}, calibration {prepared.rig.calibration_id}",
            "job": f"{taught.number} {taught.name}",
            "made": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, edged {__version__}",
            "in kind": "AIAG MSA, ISO 14253-1; no conformity is claimed",
        }
        page = acceptance_page("Study of a size", f"The gauge is {WORDS[good]}", about, tests)
        write_file(report, page.encode())
    if as_json:
        print(json.dumps({"good": good, **figures}))
    else:
        for test in tests:
            say(f"{test.name}: {test.verdict}", console)
            for name, value in test.figures.items():
                say(f"  {name}: {value}", console)
    return 0 if good else 1


def parse_tolerance(text: str) -> tuple[float, float]:
    """Both limits of LOW:HIGH, mm. Raises `UserError`."""
    low, _, high = text.partition(":")
    try:
        limits = decimal(low), decimal(high)
    except ValueError:
        limits = 0.0, 0.0
    if not limits[0] < limits[1]:
        raise UserError(
            f"--tolerance {text!r}: expected LOW:HIGH in mm, the lower limit first, e.g. 7.99:8.02"
        )
    return limits


def _of_master(
    rig: PreparedRig, job: Job, folder: Path, size: str, reference: float, tolerance: float
) -> tuple[Capability, float]:
    found = _sizes(rig, job, folder, pairs_of(folder), size)
    try:
        by_scatter = capability(np.array([value for value, _ in found]), reference, tolerance)
    except ValueError as error:
        raise UserError(f"{folder}: {error}") from error
    return by_scatter, float(np.sqrt(np.mean([sigma**2 for _, sigma in found])))


def _of_parts(rig: PreparedRig, job: Job, folder: Path, size: str, tolerance: float) -> GaugeStudy:
    values: dict[tuple[str, str], list[float]] = {}
    for part, person, pairs in studied_folders(folder):
        found = _sizes(rig, job, folder / part / person, pairs, size)
        values[part, person] = [value for value, _ in found]
    try:
        return gauge_study(crossed(values, folder), tolerance)
    except ValueError as error:
        raise UserError(f"{folder}: {error}") from error


def _sizes(
    rig: PreparedRig, job: Job, folder: Path, pairs: list[ImagePair], size: str
) -> list[tuple[float, float]]:
    """Size and sigma of every pair. Raises `UserError` for one without a good part: none is left out."""
    found, missing = sizes_in(rig, job, pairs, size)
    for name, why in missing.items():
        raise UserError(f"{folder}: {name}: {why}: take it again")
    return list(found.values())


def _master_test(found: Capability, sigma_mm: float, low: float, high: float) -> ReportedTest:
    inside = guard_bands(low, high, float(np.hypot(sigma_mm, found.bias_mm)))
    band = (
        f"{inside[0]:.4f} to {inside[1]:.4f} mm" if inside[0] < inside[1] else "none: sigma takes all of it"
    )
    return ReportedTest(
        "type 1, one master",
        WORDS[found.good],
        "",
        {
            "measurements": f"{found.repeats}",
            "mean, bias": f"{found.mean_mm:.4f} mm, {1e3 * found.bias_mm:+.1f} um"
            + (" (may be chance)" if found.bias_is_chance else ""),
            "standard deviation": f"{1e3 * found.deviation_mm:.2f} um; stated sigma {1e3 * sigma_mm:.2f} um",
            "Cg, Cgk": f"{found.cg:.2f}, {found.cgk:.2f} (1.33 and more is capable)",
            "a part is proved good within": band,
        },
    )


def _parts_test(found: GaugeStudy) -> ReportedTest:
    return ReportedTest(
        "gauge R&R",
        WORDS[found.good],
        "",
        {
            "parts, people, trials": f"{found.parts}, {found.operators}, {found.trials}",
            "repeatability": f"{1e3 * found.repeatability_mm:.2f} um",
            "reproducibility": f"{1e3 * found.reproducibility_mm:.2f} um",
            "parts": f"{1e3 * found.part_mm:.1f} um",
            "%GRR of the tolerance": f"{found.of_tolerance:.1f} (10 and less is fit, over 30 is not)",
            "%GRR of all variation": f"{found.of_variation:.1f}",
            "distinct categories": f"{found.distinct}",
        },
    )
