"""Options shared by several commands."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.console import Console

BrandOption = Annotated[
    str,
    typer.Option(
        "--brand",
        help="ur, kuka, fanuc, yaskawa, abb, staubli, kawasaki, doosan, mitsubishi, epson, denso, techman",
    ),
]
RigOption = Annotated[Path, typer.Option("--rig", help="calibrated rig, written by `edged calibrate`")]
JsonOption = Annotated[bool, typer.Option("--json", help="print one JSON object and nothing else on stdout")]


def screen(*, stderr: bool = False, soft_wrap: bool = False) -> Console:
    """Return the console that a command prints to; rich is imported only then."""
    from rich.console import Console

    return Console(stderr=stderr, soft_wrap=soft_wrap)
