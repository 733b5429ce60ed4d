"""`edged registers`: the Modbus map and programs for robots and PLCs, from the schema that encodes it."""

from __future__ import annotations

import ipaddress
import re
import socket
import sys
from pathlib import Path

from edged.config.configuration import Config
from edged.config.reading import load
from edged.errors import UserError
from edged.files.atomic import write_file
from edged.files.jobs import job_folders, load_job
from edged.files.outputs import make_folder
from edged.robot.orientations import Convention
from edged.robots.formats import FORMATS, ProgramCell, written

DISCARD = 9
"""Port used to find the route to a host; nothing is sent."""


def registers(fmt: str | None, folder: Path | None, config: Path | None = None, name: str = "") -> int:
    """Print a format of one file, or write the files of a format into a folder and print their names.

    fmt : None is the map, or with a configuration the program for its robot's brand. config : of the cell
    that the program is for. name : see `ProgramCell`.
    Raises `UserError` for an unknown format, for several files without a folder, for a folder with a single
    file, and for a configuration without the server that the program talks to.
    """
    cell = ProgramCell(name=name)
    if config is not None:
        loaded = load(config)
        fmt = fmt or _format_of_brand(loaded)
        cell = program_cell(loaded, fmt, name)
    fmt = fmt or "md"
    files = written(fmt, cell)
    if (len(files) == 1) != (folder is None):
        needs = "is one file: print it into one with >" if folder else "is several files: --output FOLDER"
        raise UserError(f"--format {fmt} {needs}")
    if folder is None:
        sys.stdout.writelines(files.values())
        return 0
    make_folder(folder)
    for file, text in files.items():
        write_file(folder / file, text.encode())
        print(folder / file)
    return 0


def _format_of_brand(config: Config) -> str:
    line = config.modbus.socket
    if line is None:
        raise UserError("--config: there is no [modbus.socket] with a brand: say --format")
    if line.brand == "ur":
        return "urscript"
    found = (fmt for fmt, form in FORMATS.items() if form.brand == line.brand)
    if (fmt := next(found, None)) is None:
        raise UserError(f"--config: there is no program for {line.brand}: say --format")
    return fmt


def program_cell(config: Config, fmt: str, name: str = "") -> ProgramCell:
    """Return what a program must know of a configuration's cell. Raises `UserError`."""
    modbus = config.modbus
    if not modbus.enabled:
        raise UserError("--config: modbus.enabled is false: no program reaches this cell")
    brand = FORMATS[fmt].brand if fmt in FORMATS else None
    if brand is not None and modbus.socket is None:
        raise UserError(f"--config: --format {fmt} talks in lines of text: [modbus.socket] is missing")
    if fmt == "urscript" and modbus.port != 502:
        raise UserError(f"--config: modbus.port is {modbus.port}, and a UR robot knows 502 only")
    folder = config.cell.jobs
    loaded = map(load_job, job_folders(folder)) if folder.is_dir() else ()
    jobs = [(job.number, job.name) for job in loaded]
    return ProgramCell(
        address=_address(modbus.host, modbus.writers),
        line_port=ProgramCell().line_port if modbus.socket is None else modbus.socket.port,
        modbus_port=modbus.port,
        unit_id=modbus.unit_id,
        base_address=modbus.base_address,
        is_low_first=modbus.word_order == "low",
        convention=Convention[modbus.convention.upper()],
        jobs=tuple(f"{number} {re.sub('[^A-Za-z0-9_. -]', '_', job)}" for number, job in sorted(jobs)),
        name=name,
    )


def _address(host: str, writers: list[str]) -> str:
    """Return the cell's address for a program: `host`, or this machine's on the route to the first writer.

    Raises `UserError` if only this machine can reach the cell, and for a name or an IPv6 address, which not
    every controller accepts.
    """
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        raise UserError(f"--config: modbus.host is a name, {host!r}: programs need an IPv4 address") from None
    if address.is_unspecified:
        networks = [ipaddress.ip_network(writer) for writer in writers]
        outside = [network for network in networks if network.version == 4 and not network.is_loopback]
        if not outside:
            raise UserError("--config: modbus.writers names no robot or PLC: nobody could command this cell")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as way:
            try:
                way.connect((str(outside[0].network_address), DISCARD))
            except OSError as error:
                raise UserError(
                    f"--config: modbus.host is {host}, and there is no way to {outside[0]}: {error.strerror}"
                ) from error
            address = ipaddress.ip_address(way.getsockname()[0])
    if address.version != 4:
        raise UserError(f"--config: modbus.host is {host}: programs need an IPv4 address")
    return str(address)
