"""`edged replay`: measures recorded exposures again and reports differences."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import cv2
from rich.console import Console
from rich.progress import track

from edged.errors import FileFormatError, UserError
from edged.files import recording
from edged.files.atomic import read_bytes, write_file
from edged.files.outputs import check_folder, make_folder
from edged.files.secrettext import without_secrets
from edged.payload import Json
from edged.setup.machine.bundle import opened
from edged.setup.recordings.regression import COMPARED, compare, decided, drawn, inspected
from edged.setup.recordings.setups import rig_and_job

SHOWN = 12


@dataclass(slots=True)
class Report:
    """Result of a replay, as written by --json."""

    versions: Mapping[str, str]
    same: int = 0
    different: list[Json] = field(default_factory=list)
    skipped: list[Json] = field(default_factory=list)

    def to_json(self) -> Json:
        """Return the report as one JSON object."""
        return {
            "versions": self.versions,
            "same": self.same,
            "different": self.different,
            "skipped": self.skipped,
        }


def replay(
    path: Path, as_json: bool, console: Console, export: Path | None = None, overlays: Path | None = None
) -> int:
    """Replay a recording, or all of a folder or bundle. 0: all are the same to the last bit; 1: not.

    export : folder for the recordings with their setups and the report, to attach to a bug report.
    overlays : folder for a picture (PNG) of each measured pair with the evidence.
    """
    with opened(path) as folder:
        return _replay(_files(folder), as_json, console, export, overlays)


def _replay(
    files: list[Path], as_json: bool, console: Console, export: Path | None, overlays: Path | None
) -> int:
    for folder in (export, overlays):
        if folder is not None:  # checked before the work, which may take an hour
            check_folder(folder)
            make_folder(folder)
    report = Report(recording.versions())
    for file in track(files, "replaying", console=Console(stderr=True), transient=True):
        try:
            taken = recording.load(file)
            if taken.pair is None:
                report.skipped.append({"file": file.name, "reason": "no images: " + _text(taken.snapshot)})
                continue
            setup = rig_and_job(file, taken.snapshot)
            inspection = inspected(taken, *setup)
            again = decided(taken, inspection, *setup)
            if overlays is not None and inspection is not None:
                _, png = cv2.imencode(".png", drawn(taken, inspection, *setup))
                write_file(overlays / f"{file.stem}.png", png.tobytes())
        except UserError as error:
            report.skipped.append({"file": file.name, "reason": str(error)})
            continue
        differences = [
            line for key in COMPARED for line in compare(key, taken.snapshot.get(key), again.get(key))
        ]
        if differences:
            report.different.append(
                {"file": file.name, "recorded_by": taken.versions, "differences": differences}
            )
        else:
            report.same += 1
    if export is not None:
        _export(files, export, report)
    if as_json:
        print(json.dumps(report.to_json()))
    else:
        _print(report, console)
    damaged = [entry for entry in report.skipped if not entry["reason"].startswith("no images")]
    return 1 if report.different or damaged else 0


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    for folder in (path, path.parent if path.name == "cycles" else path):
        if found := [entry.path for entry in recording.entries(folder)]:
            return found
    if not path.exists():
        raise FileFormatError(f"{path}: no such file or folder")
    raise FileFormatError(f"{path}: no recordings (expected a file, or a folder with cycles/*.zip)")


def _export(files: list[Path], target: Path, report: Report) -> None:
    """Write everything needed to reproduce the result elsewhere."""
    make_folder(target / "cycles")
    for file in files:
        write_file(target / "cycles" / file.name, read_bytes(file, "a recording"))
        if (parts := recording.NAME.fullmatch(file.name)) is not None:
            _export_setup(recording.setup_folder(file.parent.parent, parts["fingerprint"]), target)
    write_file(target / "report.json", json.dumps(report.to_json(), indent=1).encode())


def _export_setup(setup: Path, target: Path) -> None:
    copy = recording.setup_folder(target, setup.name)
    for file in sorted(setup.rglob("*")):
        if file.is_file():
            data = read_bytes(file, "a recording's setup")
            place = copy / file.relative_to(setup)
            make_folder(place.parent)
            # earlier versions recorded the password's hash in it
            write_file(place, without_secrets(data) if place == copy / "cell.toml" else data)


def _print(report: Report, console: Console) -> None:
    for entry in report.different:
        console.print(f"{entry['file']}: different", markup=False)
        changed = [
            f"{name} {old} -> {report.versions.get(name, 'none')}"
            for name, old in entry["recorded_by"].items()
            if report.versions.get(name) != old
        ]
        console.print(f"  recorded by {', '.join(changed) or 'the same versions'}", markup=False)
        for line in entry["differences"][:SHOWN]:
            console.print(f"  {line}", markup=False)
        if (more := len(entry["differences"]) - SHOWN) > 0:
            console.print(f"  and {more} more")
    for entry in report.skipped:
        console.print(f"{entry['file']}: not replayed: {entry['reason']}", markup=False)
    console.print(
        f"{report.same} the same to the last bit, {len(report.different)} different, "
        f"{len(report.skipped)} not replayed"
    )


def _text(snapshot: Json) -> str:
    return str(snapshot.get("error") or snapshot.get("status"))
