"""Measures recorded cycles with the installed version, with the rig and jobs that the cell has now.

`python -m edged.setup.recordings.again CONFIG MOST`: JSON lines, newest cycle first, of the last MOST with
pictures. A software release is tried with it in its own environment, so the output must be the same in each
version: number, at, job, and either skipped with detail, or shown, as in a snapshot.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from edged.domain.events import CommandKind
from edged.errors import EdgedError, FileFormatError
from edged.files import recording
from edged.payload import Json
from edged.pipeline import inspect
from edged.setup.cellfiles import read_cell
from edged.setup.recordings.comparing import TriedCycle, found_in
from edged.setup.recordings.regression import shown
from edged.setup.recordings.setups import MeasuredBy, measured_by


def measured_again(config: Path, most: int) -> Iterator[Json]:
    """Measure the last recorded cycles now. Raises `EdgedError` if the cell cannot run with its files."""
    cell = read_cell(config)
    folder = None if cell.config.recorder is None else cell.config.recorder.folder
    if folder is None:
        return
    by = measured_by(cell.contents, config)
    for entry in recording.entries(folder)[::-1]:
        try:
            taken = recording.load(entry.path)
        except FileFormatError:
            continue  # damaged: no version can read it
        if taken.pair is not None and not _is_grab(taken.snapshot):
            yield _line(entry, taken, by)
            most -= 1
            if not most:
                return


def _is_grab(snapshot: Json) -> bool:
    command = snapshot.get("command")
    return isinstance(command, dict) and command.get("kind") == CommandKind.GRAB.name


def _line(entry: recording.Entry, taken: recording.Recording, by: MeasuredBy) -> Json:
    head: Json = {"number": entry.index, "at": entry.recorded.isoformat(timespec="milliseconds")}
    head["job"] = str(taken.snapshot["job"])[:200]
    job = by.job_for(by.number_for(taken.snapshot), taken.snapshot)
    if job is None or taken.pair is None:
        return {**head, "skipped": "no_job", "detail": ""}
    try:
        found = shown(taken, inspect(taken.pair, job, by.rig), by.rig, job, drifts=False)
    except EdgedError as error:  # pictures of other cameras
        return {**head, "skipped": "damaged", "detail": str(error)}
    return {**head, "shown": found}


def tried(before: Sequence[Json], after: Sequence[Json]) -> list[TriedCycle]:
    """Pair the results of two versions for the same cycles. Raises `FileFormatError`."""
    later = {line["number"]: line for line in after}
    cycles = []
    for line in before:
        other, head = later.get(line["number"]), (line["number"], line["at"], line["job"])
        if other is None:  # recorded or removed between the two runs
            continue
        if "shown" not in line:  # the present version cannot measure it
            cycles.append(TriedCycle(*head, skipped=line["skipped"], detail=line["detail"]))
            continue
        if "shown" not in other:
            raise FileFormatError(f"cycle {line['number']} cannot be measured: {other['detail'] or 'no job'}")
        cycles.append(TriedCycle(*head, before=found_in(line["shown"]), after=found_in(other["shown"])))
    return cycles


if __name__ == "__main__":
    try:
        for _line_found in measured_again(Path(sys.argv[1]), int(sys.argv[2])):
            print(json.dumps(_line_found), flush=True)
    except EdgedError as _error:
        sys.exit(str(_error))
