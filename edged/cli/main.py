"""The command line: parses, calls `commands`, and turns errors into exit codes.

0: done. 1: it ran, and the answer is "no" (no target, check failed). 2: wrong usage or input; the
message goes to stderr and names the file, the field and what was expected.

Each command imports its modules only when it runs, so that `edged --help` stays quick.
"""

from __future__ import annotations

from typing import Annotated

import typer

from edged import __version__
from edged.cli import around, robot, service, setup

app = typer.Typer(
    name="edged",
    help="Where is the workpiece? Two GenICam cameras in, coordinates with a sigma out.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"edged {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="show the version")
    ] = False,
) -> None:
    pass


for _panel, _commands in (
    ("Make a rig and its jobs", setup.app),
    ("Make a rig and its jobs", robot.app),
    ("Run a cell", service.app),
    ("Try it, connect to it", around.app),
):
    for _command in _commands.registered_commands:
        _command.rich_help_panel = _panel
    for _group in _commands.registered_groups:
        _group.rich_help_panel = _panel
    app.add_typer(_commands)
