"""`edged demo --stage`: a virtual cell without rig and job, to be set up on its page with simulated hands."""

from __future__ import annotations

import asyncio
import secrets
from pathlib import Path

from rich.console import Console

from edged.app.cell import LoadedCell, load_any_cell, warm_up
from edged.app.daemon import Daemon
from edged.app.process import serve
from edged.domain.cell import SetupSource
from edged.files.outputs import make_folder
from edged.files.private import write_private
from edged.files.statefolder import page_folder
from edged.identity.passwords import hash_password
from edged.identity.users import User, UserFile
from edged.owners import as_owner
from edged.setup.releases.installing import finish_installation
from edged.setup.stage.routes import StageRoutes
from edged.sim.world import VirtualWorld

CELL = "stage"
WEB_PORT = 8080
USER = "me"
"""The user who sets the stage up: an engineer."""

STEPS = """\
A virtual cell {with_what}: set it up on its page, up to a part to be picked.
  1  open    http://127.0.0.1:{port}/setup
  2  log in  name {name}, password {password}   (made for this run)
  3  take the cell; the stage at the foot of each page does what hands do: wave, hold the board, lay the part
Rig, jobs and drafts go to {folder}; ctrl-C ends it."""


def run_stage(
    folder: Path, world: VirtualWorld, console: Console, *, ports: tuple[int, int, int], period_s: float
) -> int:
    """Run the daemon until ctrl-C. ports : web, Modbus, Zenoh."""
    if world.stage is None:
        raise ValueError("the world has no stage")
    password = secrets.token_urlsafe(9)
    path = write_cell(folder, password, ports=ports, period_s=period_s, gige=world.addresses is not None)
    finish_installation(path)
    loaded = load_any_cell(path)
    warm_up(loaded)
    routes = StageRoutes(world.stage)
    console.print(
        STEPS.format(
            with_what=_what_it_has(loaded), port=ports[0], name=USER, password=password, folder=folder
        ),
        highlight=False,
        soft_wrap=True,
    )
    asyncio.run(
        serve(lambda: Daemon(path, loaded, observers=[routes], world=world, routes=[routes, routes.robot]))
    )
    return 0


def _what_it_has(loaded: LoadedCell) -> str:
    """Describe what an earlier run has left in this folder."""
    lacks, count = loaded.setup.lacks, len(loaded.setup.jobs)
    if lacks is SetupSource.NO_CALIBRATION:
        return "without a calibration and without a job"
    if lacks is SetupSource.NO_JOB:
        return "with the calibration of this folder, and without a job"
    return f"with the calibration and the {count} job{'' if count == 1 else 's'} of this folder"


def write_cell(
    folder: Path, password: str, *, ports: tuple[int, int, int], period_s: float, gige: bool
) -> Path:
    """Write the configuration and its user only; earlier rigs and jobs in the folder stay."""
    make_folder(folder)
    web, modbus, zenoh = ports
    hashed = hash_password(password)
    source = "virtual" if gige else "virtual-inprocess"
    text = f"""# Written by `edged demo --stage`, anew at each start. Its cameras are virtual.
[cell]
name = "{CELL}"
rig = "rig.json"
jobs = "jobs"

[cycle]
mode = "free"
period_s = {period_s!r}

[cameras]
source = "{source}"
timeout_s = 2.0
max_skew_ms = 50.0   # software triggers of a busy PC: so far apart both see one moment of the stage

[modbus]
port = {modbus}

[zenoh]
listen = ["tcp/127.0.0.1:{zenoh}"]

[recorder]
folder = "recordings"
keep_good = 50
keep_bad = 50

[web]
port = {web}
commissioning = true
password_hash = "{hashed}"
"""
    path = folder / "cell.toml"
    engineer = User(name=USER, role="engineer", password_hash=hashed)
    with as_owner(folder) as place:
        write_private(place / path.name, text.encode())
        UserFile(page_folder(path) / "users.json").put(engineer)
    return path
