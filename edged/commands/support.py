"""`edged support`: a bundle of all that remote support needs from a cell, in one file without secrets."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console

from edged.commands.saying import print_safe
from edged.doctor.examination import examine
from edged.errors import UserError
from edged.files.atomic import write_file
from edged.files.outputs import check_outputs
from edged.files.statefolder import page_folder
from edged.owners import as_owner
from edged.setup.cellfiles import read_any_cell
from edged.setup.machine import bundle


def support(config: Path, output: Path, cycle: int | None, console: Console) -> int:
    """Write the bundle, readable by its owner only. Raises `UserError`; no file is left then.

    cycle : number of a recording; None: the newest failed one with pictures.
    """
    if output.exists():
        raise UserError(f"{output}: exists; choose another name")
    check_outputs({"--output": output}, {"CONFIG": config})
    cell = read_any_cell(config, elsewhere=True)
    folder, recorder = page_folder(config), cell.config.recorder
    with as_owner(folder) as place:
        document = bundle.about(place, cell, datetime.now(UTC))
    members = bundle.failed_cycle(None if recorder is None else recorder.folder, cycle)
    document["checks"] = [check.to_json() for check in examine(config, trigger=False)]
    data = bundle.pack(document, members)
    write_file(output, data, mode=0o600)
    cycles = [Path(name).name for name in members if name.startswith("cycles/")]
    print_safe(
        f"{output}: {len(data) / 1024:.0f} KiB, {cycles[0] if cycles else 'no failed cycle is recorded'}",
        console,
    )
    print_safe(
        f"no password and no key is in it; names, addresses and pictures are. There: edged replay {output}",
        console,
    )
    return 0
