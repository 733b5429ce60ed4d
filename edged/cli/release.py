"""Commands for signed releases."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from edged.cli.options import JsonOption, screen

release = typer.Typer(
    help="Signed releases of jobs and software for many cells. Needs the extra `fleet`.", no_args_is_help=True
)

RepositoryArgument = Annotated[Path, typer.Argument(metavar="REPOSITORY", help="folder of the repository")]
ConfigArgument = Annotated[Path, typer.Argument(metavar="CONFIG", help="configuration file of the cell")]
SignerOption = Annotated[Path, typer.Option("--key", help="private key that signs, or hsm:ID?label=TOKEN")]
PlaceOption = Annotated[
    str | None, typer.Option("--from", metavar="PLACE", help="another repository: https://..., or a folder")
]


@release.command("key")
def make_key(
    file: Annotated[Path, typer.Argument(help="private key to write; its public half is FILE.pub")],
    token: Annotated[
        str | None,
        typer.Option(
            metavar="hsm:ID?label=TOKEN", help="write the public half of this key in a PKCS #11 token instead"
        ),
    ] = None,
) -> None:
    """Make a key pair; the private half is encrypted with a passphrase."""
    from edged.commands.release import key

    raise typer.Exit(key(file, token, screen(soft_wrap=True)))


@release.command("root")
def make_root(
    repository: RepositoryArgument,
    key: Annotated[
        list[Path], typer.Option(help="of the root, several times: private ones sign, FILE.pub only counts")
    ],
    targets: Annotated[Path, typer.Option(help="public key that names the plants")],
    online: Annotated[Path, typer.Option(help="public key that publishes")],
    threshold: Annotated[int, typer.Option(min=1, help="so many keys of the root must sign")] = 2,
) -> None:
    """Make the root of trust, or a new version of it: the list of trusted keys."""
    from edged.commands.release import root

    raise typer.Exit(root(repository, key, threshold, targets, online, screen(soft_wrap=True)))


@release.command()
def countersign(repository: RepositoryArgument, key: SignerOption) -> None:
    """Sign the root with another of its keys."""
    from edged.commands.release import countersign as command

    raise typer.Exit(command(repository, key, screen(soft_wrap=True)))


@release.command()
def delegate(
    repository: RepositoryArgument,
    plant: Annotated[str, typer.Argument(help="name of the plant")],
    plant_key: Annotated[Path, typer.Option(help="public key of the plant")],
    key: SignerOption,
) -> None:
    """Allow a plant's key to sign that plant's releases, and nothing else."""
    from edged.commands.release import delegate as command

    raise typer.Exit(command(repository, plant, plant_key, key, screen(soft_wrap=True)))


@release.command()
def sign(
    repository: RepositoryArgument,
    plant: Annotated[str, typer.Argument(help="name of the plant")],
    name: Annotated[str, typer.Argument(help="name of the release")],
    key: SignerOption,
    jobs: Annotated[Path | None, typer.Option(help="folder with the jobs of the release")] = None,
    wheels: Annotated[
        Path | None,
        typer.Option(help="folder with wheels, edged's own among them: a release of software"),
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option(help="any file instead, which no cell takes by itself: a template of a cell"),
    ] = None,
    ring: Annotated[str | None, typer.Option(help="which cells take it: none, 1, 5%, 25%, all")] = None,
    cells: Annotated[Path | None, typer.Option(help="names of all cells of the plant, one a line")] = None,
    may_move: Annotated[
        float | None, typer.Option(metavar="MM", min=0, help="results on recorded cycles may move by so much")
    ] = None,
    note: Annotated[str | None, typer.Option(help="for people")] = None,
) -> None:
    """Sign a release with the plant's key, or assign a signed one to another ring."""
    from edged.commands.release import ReleaseSource, ReleaseTerms
    from edged.commands.release import sign as command

    source, terms = ReleaseSource(jobs, wheels, file), ReleaseTerms(ring, cells, may_move, note)
    raise typer.Exit(command(repository, plant, name, key, screen(soft_wrap=True), source, terms))


@release.command()
def publish(
    repository: RepositoryArgument,
    key: SignerOption,
    days: Annotated[
        float, typer.Option(min=0.01, help="cells believe it for so long; publish again before")
    ] = 14.0,
) -> None:
    """Publish signed releases to the cells; repeat it before the publication expires."""
    from edged.commands.release import publish as command

    raise typer.Exit(command(repository, key, days, screen(soft_wrap=True)))


@release.command()
def pull(
    config: ConfigArgument,
    place: PlaceOption = None,
    name: Annotated[str | None, typer.Option(help="this file of the plant instead, for people")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="where to write that file")] = None,
) -> None:
    """Verify and fetch the newest release for this cell; its page tries it. 1: there is none."""
    from edged.commands.release import pull as command

    raise typer.Exit(command(config, screen(soft_wrap=True), place=place, name=name, output=output))


@release.command()
def switch(
    config: ConfigArgument,
    unit: Annotated[str, typer.Option(help="service of the cell, which is restarted")] = "edged.service",
) -> None:
    """Switch to the software version that the cell's gate wants, and back if it does not start."""
    from edged.commands.release import switch as command

    raise typer.Exit(command(config, unit, screen(soft_wrap=True)))


@release.command()
def status(config: ConfigArgument, place: PlaceOption = None, as_json: JsonOption = False) -> None:
    """Show what is published and what this cell has. 1: the repository was not reached, or was refused."""
    from edged.commands.release import status as command

    raise typer.Exit(command(config, screen(soft_wrap=True), place=place, as_json=as_json))
