"""`edged study`: whether a cell is fit to inspect a size, by capability on a master and by gauge R&R."""

from __future__ import annotations

import json
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console

from edged.commands.saying import print_safe
from edged.domain.numerals import decimal
from edged.errors import UserError
from edged.files.atomic import write_file
from edged.files.jobs import load_job
from edged.files.outputs import check_outputs
from edged.files.pairs import ImagePair
from edged.files.rig import load_rig
from edged.pipeline import PreparedRig, prepare
from edged.report.acceptance import ReportedTest
from edged.setup.acceptance.measuring import crossed, pairs_of, sizes_in, studied_folders
from edged.setup.acceptance.studying import StudiedSize, by_master, by_parts, made_at, study_page
from edged.vision.part.job import Job


def study(
    folder: Path,
    rig: Path,
    job: Path,
    of: StudiedSize,
    console: Console,
    *,
    reference: float | None = None,
    report: Path | None = None,
    as_json: bool = False,
) -> int:
    """Study the pairs in `folder`: master/ (with `reference`), parts/PART/PERSON/. 0: fit; 1: not or barely.

    of : named as in `edged verify --length`. Raises `UserError`.
    """
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
    values: dict[str, list[float]] = {}
    if master.is_dir():
        if reference is None:
            raise UserError(f"{master}: --reference MM says how large the master is")
        sizes = _sizes(prepared, taught, master, pairs_of(master), of.name)
        try:
            found, sigma_mm, test = by_master(sizes, reference, of)
        except ValueError as error:
            raise UserError(f"{master}: {error}") from error
        verdicts.append(found.good)
        tests.append(test)
        values["master"] = [value for value, _ in sizes]
        figures["type1"] = asdict(found) | {"good": found.good, "sigma_mm": sigma_mm}
    if parts.is_dir():
        by_both = _of_parts(prepared, taught, parts, of.name)
        try:
            gauge, test = by_parts(crossed(by_both, parts), of)
        except ValueError as error:
            raise UserError(f"{parts}: {error}") from error
        verdicts.append(gauge.good)
        tests.append(test)
        values |= {f"{part}, {person}": some for (part, person), some in by_both.items()}
        figures["grr"] = asdict(gauge) | {"good": gauge.good}
    good = False if False in verdicts else None if None in verdicts else True
    if report is not None:
        about = {
            "rig": f"{rig}, calibration {prepared.rig.calibration_id}",
            "job": f"{taught.number} {taught.name}",
            "made": made_at(datetime.now(UTC)),
        }
        write_file(report, study_page(good, of, about, tests, values))
    if as_json:
        print(json.dumps({"good": good, **figures}))
    else:
        for test in tests:
            print_safe(f"{test.name}: {test.verdict}", console)
            for name, value in test.figures.items():
                print_safe(f"  {name}: {value}", console)
    return 0 if good else 1


def parse_tolerance(text: str) -> tuple[float, float]:
    """Return both limits of LOW:HIGH, mm. Raises `UserError`."""
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


def _of_parts(rig: PreparedRig, job: Job, folder: Path, size: str) -> dict[tuple[str, str], list[float]]:
    """Return sizes by part and person, mm."""
    return {
        (part, person): [value for value, _ in _sizes(rig, job, folder / part / person, pairs, size)]
        for part, person, pairs in studied_folders(folder)
    }


def _sizes(
    rig: PreparedRig, job: Job, folder: Path, pairs: list[ImagePair], size: str
) -> list[tuple[float, float]]:
    """Return size and sigma of every pair. Raises `UserError` for a pair without a good part."""
    found, missing = sizes_in(rig, job, pairs, size)
    for name, why in missing.items():
        raise UserError(f"{folder}: {name}: {why}: take it again")
    return list(found.values())
