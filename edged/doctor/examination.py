"""Runs all checks for a configuration in order."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from edged.app.discovery import probe_plc
from edged.config.plc import PlcSection
from edged.config.reading import load
from edged.doctor.cameras import look_at_cameras
from edged.doctor.findings import Check, bad, ok, skip, warn
from edged.doctor.machine import ClockWatch, look_at_machine, look_at_ports
from edged.doctor.ourdaemon import our_daemon
from edged.doctor.pictures import take_pictures
from edged.errors import ConfigError, ListenError, PlcFault
from edged.robot.errormap import error_map
from edged.robot.picking import frame_of
from edged.setup.cellfiles import CellFiles, UnfinishedCell, exposed_secrets, read_any_cell, warnings_for
from edged.vision.geometry.camera import StereoRig

MAP_NAME = "robot's error"
NOT_YET, RELOAD = "places are off as before it was made", "sudo systemctl reload edged"


def examine(path: Path, *, trigger: bool = True, process: int | None = None) -> Iterator[Check]:
    """Yield all checks for a configuration as they are made. trigger : take test pictures as well.

    process : id of the daemon that runs it, if known.

    A cell without a rig or jobs is examined as far as possible, as its network is set up before its
    calibration. If its daemon runs, it is queried instead, and no picture is taken.
    """
    clock = ClockWatch()
    try:
        config = load(path)
    except ConfigError as error:
        yield from _mistakes(path, error)
        return
    rig: StereoRig | None = None
    fingerprint = ""
    try:
        cell = read_any_cell(path)
    except ConfigError as error:
        yield from _mistakes(path, error)
        cell = None
    if isinstance(cell, UnfinishedCell):
        rig, fingerprint = cell.rig, cell.fingerprint
        for missing in cell.missing:
            yield warn(
                "configuration",
                f"not yet: {missing}",
                "the cell starts in SETUP, and does not measure",
                "set it up on its page, /setup; or edged calibrate and edged teach, then reload",
            )
    elif cell is not None:
        rig, fingerprint = cell.rig, cell.fingerprint
        jobs = f"{len(cell.jobs)} job(s), calibration {rig.calibration_id}"
        yield ok("configuration", jobs)
        for doubt in warnings_for(cell):
            yield warn("calibration", doubt, "lengths may be wrong", "edged calibrate; then edged verify")
    for secret in exposed_secrets(path, config):
        yield warn(
            "secrets",
            f"{secret.place}: every user of this machine may read {secret.file}",
            "a private key is theirs, a password's hash they can try guesses on",
            secret.remedy,
            "secrets" if secret.can_be_closed else "",
        )
    yield from look_at_machine(config)
    daemon = our_daemon(path, config, process)
    if daemon is not None:
        yield daemon.look(fingerprint)
    if isinstance(cell, CellFiles):
        yield from look_at_map(cell, is_used=daemon is None or daemon.loaded in ("", fingerprint))
    yield from look_at_ports(config, daemon)
    if config.plc is not None:
        yield look_at_plc(config.plc)
    if config.cameras.source == "aravis":
        yield from look_at_cameras(config, rig, daemon)
    if trigger and daemon is not None:
        yield skip("test pictures", "the daemon has the cameras: its page shows what they see")
    elif trigger:
        yield from take_pictures(config, rig)
    yield from clock.look()


def look_at_plc(section: PlcSection) -> Check:
    """Check that the PLC answers and has both images: connect, read, disconnect; nothing is written."""
    name = "PLC's memory"
    try:
        return ok(name, probe_plc(section))
    except ListenError as error:
        return bad(name, str(error), "the daemon does not start", "install it")
    except PlcFault as fault:
        return bad(
            name,
            str(fault),
            "the PLC gets nothing and commands nothing; the cell tries again for ever",
            f"ping {section.host}; what the PLC must permit: docs/how-to/plc-memory.md",
        )


def look_at_map(cell: CellFiles, *, is_used: bool) -> Iterator[Check]:
    """Check the quality of the robot's error map, and that taught parts lie within it; nothing without a map.

    is_used : no daemon is running with other files than these.
    """
    made = cell.rig.robot_map
    if made is None:
        return
    found, frame = error_map(made).figures, frame_of(cell.rig)
    text = (
        f"a map of degree {found.degree} by {found.points} points; one that was left out is off by "
        f"{1e3 * found.held_out_mm:.0f} um, {1e3 * found.alone_mm:.0f} by the registration alone"
    )
    beyond = [job.name for job in cell.jobs if not frame.is_mapped(job.rig_from_part[:3, 3])]
    touch = "edged register touch --map with points there, too"
    if beyond:
        names = ", ".join(beyond)
        yield warn(MAP_NAME, f"{text}; {names}: taught beyond it", "OUT_OF_MAP there", touch)
    elif not is_used:
        yield warn(MAP_NAME, f"{text}; the daemon runs without it", NOT_YET, RELOAD, "reload")
    else:
        yield ok(MAP_NAME, text)


def _mistakes(path: Path, error: ConfigError) -> Iterator[Check]:
    for problem in error.problems:
        yield bad("configuration", problem, "the daemon does not start", f"edit {path}")
