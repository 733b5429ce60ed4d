"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

BrandOption = Annotated[
    str,
    typer.Option(
        "--brand",
        help="ur, kuka, fanuc, yaskawa, abb, staubli, kawasaki, doosan, mitsubishi, epson, denso, techman",
    ),
]
RigOption = Annotated[Path, typer.Option("--rig", help="calibrated rig, written by `edged calibrate`")]
JsonOption = Annotated[bool, typer.Option("--json", help="print one JSON object and nothing else on stdout")]
