"""`edged release`: signed releases for many cells, in a repository that is an ordinary folder."""

from __future__ import annotations

import functools
import getpass
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from rich.console import Console

from edged.commands.saying import print_safe
from edged.config.configuration import Config
from edged.config.reading import load, problem_of
from edged.errors import UserError, translated
from edged.files.atomic import MAX_FILE_BYTES, make_folders, read_bytes, write_file
from edged.files.outputs import check_folder, check_outputs
from edged.files.statefolder import page_folder
from edged.owners import as_owner
from edged.setup.fleet.offers import (
    DONE,
    FOLDER,
    RINGS,
    Offer,
    fetched_in,
    gate_in,
    is_fetched,
    jobs_in_release,
    packed_jobs,
    ring_of,
)
from edged.setup.releases.jobsfolder import jobs_in

try:
    from edged.setup.fleet.client import Client
    from edged.setup.fleet.hawkbit import Hawkbit
    from edged.setup.fleet.keys import is_in_token, make_key, public_key, public_of_token, signer_of
    from edged.setup.fleet.repository import Repository
    from edged.setup.fleet.versions import SystemdUnit, Versions, follow
except ModuleNotFoundError as missing:
    raise UserError(f"releases need another package: pip install 'edged[fleet]' ({missing})") from missing

PASSPHRASE_VARIABLE = "EDGED_PASSPHRASE"


def key(file: Path, token: str | None, console: Console) -> int:
    """Make a key encrypted with a passphrase from a prompt, or export the public half of a token's key."""
    check_outputs({"FILE": file})
    if token is not None:
        place = Path(token)
        if not is_in_token(place):
            raise UserError(f"--token {token}: expected hsm:ID?label=TOKEN")
        public_of_token(place, file, _passphrase(place))
        print_safe(f"{file}: the public half of {token}, to give away", console)
        return 0
    passphrase = _passphrase(file, again=True)
    public = make_key(file, passphrase)
    print_safe(f"{file}: the private half, keep it offline; {public}: the public one, to give away", console)
    return 0


def root(
    folder: Path, keys: Sequence[Path], threshold: int, targets: Path, online: Path, console: Console
) -> int:
    """Define the trusted keys. keys : of the root; public halves, or private ones, which sign at once."""
    check_folder(folder)
    signers = [_signer(file) for file in keys if file.suffix != ".pub"]
    public = [public_key(file.with_suffix(".pub")) for file in keys if not is_in_token(file)]
    public += [signer.public_key for signer in signers if signer.public_key not in public]
    file = Repository(folder).make_root(public, threshold, public_key(targets), public_key(online), signers)
    lacking = max(threshold - len(signers), 0)
    print_safe(
        f"{file}: {len(signers)} of {threshold} signatures" + _then(lacking, "edged release countersign"),
        console,
    )
    return 0


def countersign(folder: Path, file: Path, console: Console) -> int:
    """Sign the root with another of its keys."""
    lacking = Repository(folder).countersign(_signer(file))
    print_safe(
        f"{folder}: the root is signed with {file}" + _then(lacking, "edged release countersign"), console
    )
    return 0


def delegate(folder: Path, plant: str, plant_key: Path, file: Path, console: Console) -> int:
    """Let a key sign the releases of a plant."""
    Repository(folder).delegate(plant, public_key(plant_key), _signer(file))
    print_safe(f"{folder}: {plant_key} signs what is below {plant}/, and nothing else", console)
    return 0


@dataclass(frozen=True, slots=True)
class ReleaseSource:
    """What a release is made of, at most one of them: folders of jobs or wheels, or any file."""

    jobs: Path | None
    wheels: Path | None
    other: Path | None


@dataclass(frozen=True, slots=True)
class ReleaseTerms:
    """Which cells take a release, by how much results may move on recorded cycles, and a note for people."""

    ring: str | None
    cells: Path | None
    may_move_mm: float | None
    note: str | None


def sign(
    folder: Path,
    plant: str,
    name: str,
    file: Path,
    console: Console,
    source: ReleaseSource,
    terms: ReleaseTerms,
) -> int:
    """Sign a release, or a new ring of a signed one."""
    jobs, wheels, other, ring = source.jobs, source.wheels, source.other, terms.ring
    if sum(made is not None for made in (jobs, wheels, other)) > 1:
        raise UserError("expected one of --jobs, --wheels and --file")
    if ring is not None and ring not in RINGS:
        raise UserError(f"--ring {ring}: expected one of {', '.join(RINGS)}")
    repository, data = Repository(folder), None
    parts: Mapping[str, bytes] = {}
    software = f"{plant}/{name}.cdx.json"
    is_software = wheels is not None or (jobs is None and repository.has(plant, software))
    path = f"{plant}/{name}" if other is not None else f"{plant}/{name}.jobs.tar.gz"
    if is_software:
        path = software
    custom: dict[str, Any] = {} if ring is None else {"ring": RINGS.index(ring)}
    if jobs is not None:
        data = packed_jobs(jobs_in(jobs))
        jobs_in_release(data, str(jobs))
    elif wheels is not None:
        from edged.setup.fleet.bom import bill_of  # CycloneDX, where wheels are signed alone

        data, parts = bill_of(wheels)
    elif other is not None:
        data = read_bytes(other, "a file of a release", MAX_FILE_BYTES)
    elif not (folder / "targets").is_dir() or ring is None:
        raise UserError("expected --jobs, --wheels or --file, or --ring of what is signed already")
    if data is not None:
        kind = "software" if wheels is not None else "file" if other is not None else "jobs"
        custom |= {"kind": kind, "name": name, "ring": custom.get("ring", 0)}
    if terms.cells is not None:
        custom["cells"] = tuple(sorted(read_bytes(terms.cells, "a list of cells").decode().split()))
    if terms.may_move_mm is not None:
        custom["may_move_um"] = round(1000 * terms.may_move_mm)
    if terms.note is not None:
        custom["note"] = terms.note
    try:
        offer = repository.sign(plant, _signer(file), path, data, custom, parts)
    except ValidationError as error:
        raise UserError(f"{name}: {problem_of(error.errors()[0], Offer)}") from error
    print_safe(
        f"{path}: number {offer.number}, ring {RINGS[offer.ring]}{_then(1, 'edged release publish')}", console
    )
    return 0


def publish(folder: Path, file: Path, days: float, console: Console) -> int:
    """Publish to the cells what is signed."""
    seen = Repository(folder).publish(_signer(file), days)
    roles = ", ".join(
        f"{name.removesuffix('.json')} {meta.version}" for name, meta in sorted(seen.meta.items())
    )
    print_safe(
        f"{folder}: published, snapshot {seen.version} ({roles}), until {seen.expires:%Y-%m-%d %H:%M} UTC",
        console,
    )
    return 0


def pull(config: Path, console: Console, *, place: str | None, name: str | None, output: Path | None) -> int:
    """Fetch the next release due for this cell, for its gate; or any file of its plant.

    place : a repository other than the configured one, such as a USB stick. 0: fetched, or already there;
    1: there is none.
    """
    if (name is None) != (output is None):
        raise UserError("expected --name NAME and --output FILE, or neither")
    check_outputs({"--output": output})
    stated = load(config)
    source, token = _source(config, stated, place), _token(stated)
    section, cell = stated.fleet, stated.cell.name
    with _kept(config) as kept:
        client = source(kept)
        offers = client.offers()
        if name is not None and output is not None:
            path = next((path for path, offer in offers.items() if offer.name == name), name)
            data = client.fetch(path)
            write_file(output, data)
            print_safe(f"{output}: {path}, verified, {len(data)} bytes", console)
            return 0
        given = None if section is None else section.ring
        kinds = ("jobs",) if section is None or section.software is None else ("jobs", "software")
        due: dict[str, tuple[str, Offer]] = {
            offer.kind: (path, offer) for path, offer in offers.items()
            if offer.kind in kinds and ring_of(cell, offer.name, offer.cells, given) <= offer.ring
        }  # fmt: skip
        if section is not None and section.hawkbit is not None:
            server = Hawkbit(section.hawkbit, token, cell, kept)
            due = server.due({path: o for path, o in offers.items() if o.kind in kinds}, client.digest)
        if not due:
            print_safe(f"{cell}: no release for it yet, of {len(offers)}", console)
            return 1
        new = [(path, offer) for path, offer in due.values() if not is_fetched(kept / FOLDER, path, offer)]
        if not new:
            fetched = ", ".join(sorted(path for path, _ in due.values()))
            print_safe(f"{cell}: {fetched} is fetched already", console)
            return 0
        path, offer = min(new, key=lambda release: release[1].number)
        gate = gate_in(kept / FOLDER)
        if gate is not None and gate.step not in DONE and gate.staged.offer.kind != offer.kind:
            print_safe(f"{cell}: {path} comes after {gate.staged.path}, which is {gate.step}", console)
            return 0
        if offer.kind == "jobs":
            client.stage(path, offer)
    if offer.kind == "software" and section is not None and section.software is not None:
        # not as the page's user: it is verified again in a folder that only root can write
        _install(source, section.software, path, offer)
        with _kept(config) as kept:
            source(kept).stage(path, offer)
    print_safe(f"{cell}: {path} is verified and fetched: the gate tries it on recorded cycles next", console)
    return 0


def _token(stated: Config) -> str:
    """Return the token that identifies the cell to hawkBit; "" without one. Raises `UserError`."""
    section = stated.fleet
    if section is None or section.hawkbit_token is None:
        return ""
    return read_bytes(section.hawkbit_token, "a token of hawkBit", 4096).decode(errors="replace").strip()


def _install(source: Callable[[Path], Client], folder: Path, path: str, offer: Offer) -> None:
    """Fetch the wheels of a software release and create its environment. Raises `UserError`."""
    with translated(UserError, f"{folder}: software cannot be installed"):
        client = source(folder)
        files = folder / FOLDER / "wheels"
        wheels = client.fetch_wheels(path, files)
        Versions(folder).install(offer.name, client.digest(path), wheels, files)


def switch(config: Path, unit: str, console: Console) -> int:
    """Switch to the version that the gate of the cell's page wants, or back. 1: failed, else 0."""
    section = load(config).fleet
    if section is None or section.software is None:
        raise UserError(f"{config}: [fleet] software is missing: /opt/edged")
    with translated(UserError, f"{section.software}: the version cannot be switched"):
        done = follow(Versions(section.software), page_folder(config), SystemdUnit(unit))
    if done is None:
        print_safe(f"{config}: its gate wants no other version", console)
        return 0
    print_safe(f"{done.order.to}: {done.state}{f': {done.why}' if done.why else ''}", console)
    return int(done.state == "failed")


def status(config: Path, console: Console, *, place: str | None, as_json: bool) -> int:
    """Show what is published and what this cell has of it. 0: the repository is good; 1: it is not."""
    stated, problem, offers = load(config), "", dict[str, Offer]()
    section, cell = stated.fleet, stated.cell.name
    try:
        source = _source(config, stated, place)
        with _kept(config) as kept:
            offers = source(kept).offers()
    except UserError as error:
        problem = str(error)
    with _kept(config) as kept:
        there, gate = fetched_in(kept / FOLDER), gate_in(kept / FOLDER)
    given = None if section is None else section.ring
    published = [
        {"path": path, **offer.model_dump(mode="json", exclude={"cells"}), "ring": RINGS[offer.ring],
         "ring_of_cell": RINGS[ring_of(cell, offer.name, offer.cells, given)], "cells": len(offer.cells)}
        for path, offer in offers.items()
    ]  # fmt: skip
    if as_json:
        fetched = None if there is None else there.model_dump(mode="json", exclude={"offer": {"cells"}})
        step = None if gate is None else {
            "release": gate.staged.offer.name, "step": gate.step, "why": gate.why, "at": gate.at,
            "before": gate.before, "wanted": gate.wanted,
        }  # fmt: skip
        document = {
            "cell": cell,
            "published": published,
            "fetched": fetched,
            "gate": step,
            "problem": problem or None,
        }
        print(json.dumps(document))
        return int(bool(problem))
    for offer in published:
        own = (
            ""
            if offer["kind"] == "file"
            else f", ring {offer['ring']}; this cell is in ring {offer['ring_of_cell']}"
        )
        print_safe(
            f"{offer['number']:5}  {offer['created']}  {offer['path']}{own}  {offer['note']}".rstrip(),
            console,
        )
    if problem:
        sys.stderr.write(f"edged: {problem}\n")
    if there is not None:
        print_safe(f"{cell}: fetched {there.path} from {there.repository}", console)
    said = (
        "no release yet"
        if gate is None
        else f"{gate.staged.offer.name} is {gate.step} since {gate.at}: {gate.why}"
    )
    print_safe(f"{cell}: {said}", console)
    return int(bool(problem))


@contextmanager
def _kept(config: Path) -> Iterator[Path]:
    """Open the page's folder, acting as its owner. Raises `UserError`."""
    folder = page_folder(config)
    with translated(UserError, f"{folder}: releases cannot be kept there"):
        if not folder.is_dir():
            make_folders(folder)
        with as_owner(folder) as place:
            yield place


def _source(config: Path, stated: Config, place: str | None) -> Callable[[Path], Client]:
    """Return a function that opens the releases of the cell's plant, given the folder to keep them in.

    Call this before switching to another user, who can read neither the configuration nor the files beside
    it.
    """
    section = stated.fleet
    if section is None:
        raise UserError(f"{config}: [fleet] is missing: repository, plant and root")
    chosen = section.repository if place is None else place
    if not chosen.startswith("https://"):
        if "://" in chosen:
            raise UserError(f"{chosen}: expected https://HOST/FOLDER, or a folder")
        chosen = str(Path(chosen).absolute())
    root = read_bytes(section.root, "a root of releases")
    return functools.partial(Client, chosen, section.plant, root)


def _signer(file: Path) -> Any:
    return signer_of(file, _passphrase(file))


def _passphrase(file: Path, *, again: bool = False) -> str:
    given = os.environ.get(PASSPHRASE_VARIABLE)
    if given is not None:
        return given
    if not sys.stdin.isatty():
        raise UserError(
            f"{file}: needs its passphrase or PIN, expected in {PASSPHRASE_VARIABLE}, or a terminal to ask"
        )
    first = getpass.getpass(f"passphrase or PIN of {file}: ", stream=sys.stderr)
    if again and first != getpass.getpass("once more: ", stream=sys.stderr):
        raise UserError(f"{file}: these are two passphrases: nothing was made")
    return first


def _then(lacking: int, command: str) -> str:
    return f"; next: {command}" if lacking else ""
