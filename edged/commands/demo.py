"""`edged demo`: runs a virtual cell and the daemon on this machine, without any preparation."""

from __future__ import annotations

import asyncio
import json
import logging
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from edged.app.cell import load_cell, warm_up
from edged.app.daemon import Daemon
from edged.app.demoview import BeltView, demo_view
from edged.app.discovery import aravis_missing
from edged.app.process import serve, set_up_process
from edged.errors import UserError
from edged.files.atomic import write_file
from edged.files.jobs import save_job
from edged.files.outputs import make_folder
from edged.files.rig import save_rig
from edged.pipeline import prepare
from edged.plc.lines import answer_fields
from edged.ports import Publisher
from edged.robot.orientations import Brand
from edged.sim.belt import VirtualBelt
from edged.sim.cell import Truth, VirtualCell
from edged.sim.world import VirtualWorld
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import transform
from edged.vision.teaching.pair import teach
from edged.vision.teaching.region import Region

CELL = "demo"
BELT_SPACING_MM, BELT_EXPOSURE_S = 40.0, 200e-6
REGISTERED = transform(np.diag((1.0, -1.0, -1.0)), np.array((600.0, 0.0, 500.0)))
"""Pose of the left camera in the frame of the robot of `--brand`: 500 mm above its base, looking down."""


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """Options of the command line."""

    cycles: int = 0
    period_s: float = 0.25
    in_process: bool = False
    modbus_port: int = 1502
    zenoh_port: int = 7447
    web_port: int | None = None
    folder: Path | None = None
    as_json: bool = False
    stage: bool = False
    brand: str | None = None
    line_port: int = 1503
    belt: bool = False


def demo(options: DemoOptions) -> int:
    """Create a cell, teach it and run the daemon on it; 0 if every cycle found the part, else 1."""
    if options.brand is not None and options.brand not in set(Brand):
        raise UserError(f"--brand {options.brand}: expected {', '.join(Brand)}")
    set_up_process(logging.WARNING)
    console = Console(stderr=options.as_json)
    # a virtual GigE camera has no encoder
    gige = not (options.in_process or options.belt) and _aravis_is_here(console)
    if options.stage:
        return _stage(options, console, gige=gige)
    with _folder(options.folder) as folder, VirtualWorld(gige=gige) as world:
        path = prepare_cell(folder, world.cell, options, gige=gige)
        belt = _belt(world.cell)
        if options.belt:
            world.carry(belt)
        loaded = load_cell(path)
        warm_up(loaded)
        source = (
            "two GigE Vision cameras over UDP (127.0.0.1, 127.0.0.2)" if gige else "two in-process cameras"
        )
        console.print(f"virtual cell: {source}; configuration, rig and job in {folder}")
        if options.web_port is not None:
            console.print(f"status page: http://127.0.0.1:{options.web_port}")
        if options.brand is not None:
            console.print(
                _how_to_talk(options.brand, options.line_port, path), highlight=False, soft_wrap=True
            )
        daemons: list[Daemon] = []
        view = demo_view(
            world.cell, loaded.cell.config, console, cycles=options.cycles, finished=lambda: daemons[0].stop()
        )

        observers: list[Publisher] = [view]
        if (known := loaded.setup.belt) is not None and (robot := loaded.setup.robot_from_rig) is not None:
            observers.append(BeltView(world.cell, known, belt, robot, console))

        def build() -> Daemon:
            daemons.append(Daemon(path, loaded, observers=observers, world=world))
            return daemons[0]

        asyncio.run(serve(build))
        summary = view.summary()
    if options.as_json:
        print(json.dumps(summary.to_json()))
    return 0 if summary.cycles and summary.located == summary.cycles else 1


def _stage(options: DemoOptions, console: Console, *, gige: bool) -> int:
    """Run a cell with nothing prepared, to be set up on its page."""
    from edged.commands.stage import WEB_PORT, run_stage  # with the page's packages

    if options.cycles or options.as_json or options.brand is not None:
        raise UserError(
            "--stage runs until ctrl-C, and is set up on its page: no --cycles, no --json, no --brand"
        )
    ports = (options.web_port or WEB_PORT, options.modbus_port, options.zenoh_port)
    with _folder(options.folder) as folder, VirtualWorld(gige=gige, staged=True) as world:
        return run_stage(folder, world, console, ports=ports, period_s=options.period_s)


def _how_to_talk(brand: str, port: int, config: Path) -> str:
    """Return what to type to act as that robot, and the fields of the answer."""
    fields = ",".join(answer_fields(Brand(brand)))
    return f"""robot: printf '{brand},1,LOCATE,0\\n' | nc -q 2 127.0.0.1 {port}
       answers {fields}
       its program: edged registers --config {config}"""


def _belt(cell: VirtualCell) -> VirtualBelt:
    """Return a belt with parts through the middle of the cell, left to right, not quite along the rows."""
    rig_from_part = np.eye(4)
    rig_from_part[:3, 3] = cell.middle_mm
    direction = np.array([1.0, 0.15, 0.0])
    return VirtualBelt(
        direction, 200.0, 0.02, time.time_ns(), rig_from_part, BELT_SPACING_MM, BELT_EXPOSURE_S
    )


def _belt_text(rig: StereoRig, belt: VirtualBelt) -> str:
    """Return the configuration sections with the result that `edged belt` would find."""
    assert rig.robot_from_rig is not None
    step = belt.mm_per_count * belt.direction / np.linalg.norm(belt.direction)
    mm_per_count = ", ".join(f"{x:.9f}" for x in rig.robot_from_rig[:3, :3] @ step)
    first_mm = ", ".join(f"{x:.3f}" for x in (rig.robot_from_rig @ belt.rig_from_part)[:3, 3])
    exposure_us = 1e6 * belt.exposure_s
    return f"""
[cameras.left]
exposure_us = {exposure_us:g}
count = "EncoderValue"   # of the virtual belt

[cameras.right]
exposure_us = {exposure_us:g}

[belt]
mm_per_count = [{mm_per_count}]
first_mm = [{first_mm}]
speed_mm_s = {belt.speed_mm_s!r}
source = "camera"
jitter_ms = 0.01
"""


def region_of_part(rig: StereoRig, truth: Truth) -> Region:
    """Return the square around the largest circle, with a margin."""
    outline = max(truth.circles, key=lambda circle: circle.radius_mm)
    x, y = rig.left.project(outline.centre_mm[None])[0]
    half = 1.12 * outline.radius_mm * rig.left.fx / outline.centre_mm[2]
    return Region(x - half, y - half, 2 * half, 2 * half)


def prepare_cell(folder: Path, cell: VirtualCell, options: DemoOptions, *, gige: bool) -> Path:
    """Write rig, taught job and configuration of the virtual cell; return the configuration file."""
    make_folder(folder)
    rig = cell.rig if options.brand is None else replace(cell.rig, robot_from_rig=REGISTERED)
    save_rig(folder / "rig.json", rig)
    left, right, truth = cell.teach_pair()
    region = region_of_part(cell.rig, truth)
    job = teach(left, right, prepare(cell.rig).rectification, region, "flange")
    save_job(folder / "jobs" / "flange", job)
    source = "virtual" if gige else "virtual-inprocess"
    text = f"""# Written by `edged demo`: a virtual cell. Run it again with: edged run cell.toml
[cell]
name = "{CELL}"
rig = "rig.json"
jobs = "jobs"
job = "flange"

[cycle]
mode = "free"
period_s = {options.period_s!r}

[cameras]
source = "{source}"
timeout_s = 2.0
max_skew_ms = 25.0   # software triggers of a busy PC

[modbus]
port = {options.modbus_port}

[zenoh]
listen = ["tcp/127.0.0.1:{options.zenoh_port}"]
"""
    if options.web_port is not None:
        text += f"\n[web]\nport = {options.web_port}\n"
    if options.brand is not None:
        line = f'port = {options.line_port}\nbrand = "{options.brand}"\nallow_simulated = true'
        text += f"\n[modbus.socket]\n{line}\n"
    if options.belt:
        text += _belt_text(rig, _belt(cell))
    path = folder / "cell.toml"
    write_file(path, text.encode())
    return path


def _aravis_is_here(console: Console) -> bool:
    missing = aravis_missing()
    if missing:
        console.print(
            f"{missing}: the demo runs without GigE Vision, on cameras inside this process", highlight=False
        )
    return not missing


@contextmanager
def _folder(wanted: Path | None) -> Iterator[Path]:
    if wanted is not None:
        yield wanted.resolve()
        return
    with tempfile.TemporaryDirectory(prefix="edged-demo-") as temporary:
        yield Path(temporary)
