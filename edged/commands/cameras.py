"""`edged cameras`: what is on the network."""

from __future__ import annotations

import json
from dataclasses import asdict

from rich.console import Console
from rich.table import Table

from edged.app.discovery import aravis_missing, list_cameras
from edged.errors import UserError


def cameras(as_json: bool, console: Console) -> int:
    """List every GenICam camera that answers; 0 when there is one, else 1."""
    if missing := aravis_missing():
        raise UserError(missing)
    found = list_cameras()
    if as_json:
        print(json.dumps([asdict(info) for info in found]))
    elif found:
        table = Table("serial", "vendor", "model", "address", "protocol", "use")
        for info in found:
            table.add_row(
                info.serial, info.vendor, info.model, info.address, info.protocol, info.control or "not asked"
            )
        console.print(table)
    else:
        console.print(
            "no camera answers: cable, power, and is a port of this machine in the camera's network?"
        )
    return 0 if found else 1
