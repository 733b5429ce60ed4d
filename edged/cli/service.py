"""Commands that run and maintain a cell."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Annotated

import typer

from edged.cli.options import JsonOption, screen
from edged.cli.release import release
from edged.errors import UserError

app = typer.Typer()
app.add_typer(release, name="release")


@app.command()
def check(
    config: Annotated[Path, typer.Argument(help="configuration file")], as_json: JsonOption = False
) -> None:
    """Validate configuration, rig and jobs; report all mistakes at once."""
    from edged.commands.check import check as command

    raise typer.Exit(command(config, as_json=as_json))


@app.command()
def doctor(
    config: Annotated[Path, typer.Argument(help="configuration file")],
    trigger: Annotated[bool, typer.Option(help="take test pictures")] = True,
    daemon: Annotated[
        int | None,
        typer.Option(
            metavar="PID", min=1, help="process of the daemon that runs this cell; left out: looked for"
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Examine machine, network and cameras; show likely problems and the command that fixes each."""
    from edged.commands.doctor import doctor as command

    raise typer.Exit(command(config, as_json, screen(), trigger=trigger, daemon=daemon))


@app.command()
def run(
    config: Annotated[
        Path,
        typer.Argument(
            help="configuration file, see config/cell.toml; or a folder: a cell.toml is made there"
        ),
    ],
    page_user: Annotated[
        str | None,
        typer.Option(
            metavar="USER", help="the page is a service of its own and runs as this user (edged-page.service)"
        ),
    ] = None,
    trace: Annotated[
        Path | None,
        typer.Option(
            help="file for what each thread does in each cycle, written at the end: Trace Event JSON"
        ),
    ] = None,
) -> None:
    """Run the daemon until SIGTERM; SIGHUP reloads the configuration."""
    gc.disable()  # imports leave no garbage, and collections take a tenth of the start; `serve` enables it
    from edged.commands.run import run as command

    raise typer.Exit(command(config, page_user, trace))


@app.command()
def status(
    url: Annotated[str, typer.Option(help="status page of the cell")] = "http://127.0.0.1:8080",
    as_json: JsonOption = False,
) -> None:
    """Show the present state of a cell, from its status page. 0: ready; 1: not ready or not reached."""
    from edged.commands.status import status as command

    raise typer.Exit(command(url, as_json, screen()))


@app.command()
def replay(
    path: Annotated[
        Path, typer.Argument(help="a recording, a recorder's folder, or a bundle of `edged support`")
    ],
    as_json: JsonOption = False,
    export: Annotated[
        Path | None, typer.Option(help="folder to write the recordings, their setups and a report to")
    ] = None,
    overlays: Annotated[
        Path | None, typer.Option(help="folder for pictures: each pair with what was measured")
    ] = None,
) -> None:
    """Measure recorded cycles again; report any result that differs, even in a single bit."""
    from edged.commands.replay import replay as command

    raise typer.Exit(command(path, as_json, screen(), export, overlays))


@app.command()
def backup(
    config: Annotated[Path, typer.Argument(help="configuration file")],
    output: Annotated[Path, typer.Option("--output", "-o", help="archive to write, FILE.tar.gz")],
    force: Annotated[bool, typer.Option("--force", help="replace an archive of that name")] = False,
    sign: Annotated[
        Path | None, typer.Option("--sign", help="private key (Ed25519, PEM): sign it, in FILE.tar.gz.sig")
    ] = None,
) -> None:
    """Put configuration, rig, jobs and the register map into one checksummed archive."""
    from edged.commands.backup import backup as command

    raise typer.Exit(command(config, output, screen(soft_wrap=True), force=force, key=sign))


@app.command()
def restore(
    archive: Annotated[Path, typer.Argument(help="written by `edged backup`")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="folder to put it in; without it the archive is checked"),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="replace this cell's files in a folder; they are kept beside it")
    ] = False,
    verify: Annotated[
        Path | None,
        typer.Option("--verify", help="public key (Ed25519, PEM): refuse what its owner has not signed"),
    ] = None,
) -> None:
    """Check a backup and put it into a folder. 0: done; 1: done, but it would not start."""
    from edged.commands.backup import restore as command

    raise typer.Exit(command(archive, output, screen(soft_wrap=True), force=force, signed_by=verify))


@app.command()
def support(
    config: Annotated[Path, typer.Argument(help="configuration file")],
    output: Annotated[Path, typer.Option("--output", "-o", help="bundle to write, FILE.zip")],
    cycle: Annotated[
        int | None, typer.Option(min=0, help="number of a recording; left out: the newest that was not good")
    ] = None,
) -> None:
    """Write a bundle for remote support: a failed cycle, findings, versions, audit; no secrets."""
    from edged.commands.support import support as command

    raise typer.Exit(command(config, output, cycle, screen(soft_wrap=True)))


@app.command()
def history(
    places: Annotated[
        list[str],
        typer.Option("--in", help="folder of a cell's history, or with those of many, or s3://...; repeat"),
    ],
    sql: Annotated[str | None, typer.Argument(help="a SELECT over the table `cycles`")] = None,
    week: Annotated[
        Path | None, typer.Option("--week", help="FILE.html: write the report of seven days")
    ] = None,
    compare: Annotated[
        bool, typer.Option("--compare", help="compare the cells of seven days, job by job")
    ] = False,
    until: Annotated[
        str | None, typer.Option(help="the last of the seven days; left out: the newest with cycles")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Query what cells measured: in SQL, as a report, or compared with each other. 1: a cell differs."""
    if (sql is not None) + (week is not None) + compare != 1:
        raise UserError("expected either SQL, --week or --compare")
    try:
        from edged.commands import history as command
    except ImportError as error:
        raise UserError(f"history: needs another package: pip install 'edged[history]' ({error})") from error

    console = screen(soft_wrap=True)
    folders = [place if place.startswith("s3://") else Path(place) for place in places]
    if week is not None:
        raise typer.Exit(command.week(folders, until, week, console))
    if compare:
        raise typer.Exit(command.compared(folders, until, as_json, console))
    raise typer.Exit(command.question(sql or "", folders, as_json, console))


@app.command()
def password() -> None:
    """Ask for a password and print its hash, for `web.password_hash` or `opcua.password_hash`."""
    from edged.commands.web import password as command

    raise typer.Exit(command())


@app.command()
def audit(
    config: Annotated[Path, typer.Argument(help="configuration file of the cell")],
    last: Annotated[int, typer.Option(help="print so many records at most", min=0)] = 50,
    as_json: JsonOption = False,
    against: Annotated[
        str | None,
        typer.Option(help="compare with the journal: `journal`, or a file of `journalctl --output=json`"),
    ] = None,
) -> None:
    """Show who did what on the page. 0: the chain holds; 1: it does not, or the journal differs."""
    from edged.commands.audit import audit as command

    raise typer.Exit(command(config, screen(soft_wrap=True), as_json=as_json, last=last, against=against))


web = typer.Typer(help="Users of the page on which a cell is set up.", no_args_is_help=True)
app.add_typer(web, name="web")


@web.command("invite")
def web_invite(
    config: Annotated[Path, typer.Argument(help="configuration file of the cell")],
    name: Annotated[str, typer.Argument(help="of who may use it: a new one, or a user's")],
) -> None:
    """Print a one-time code that makes a person an engineer: the first one, or one without a password."""
    from edged.commands.web import invite

    raise typer.Exit(invite(config, name))


@app.command()
def warm(
    if_needed: Annotated[
        bool, typer.Option("--if-needed", help="do nothing when the kernels are cached")
    ] = False,
) -> None:
    """Compile the numerical kernels once, so that the daemon starts quickly."""
    from edged.commands.warm import warm as command

    raise typer.Exit(command(only_if_needed=if_needed))
