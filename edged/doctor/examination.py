"""All checks for a configuration, one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from edged.config.reading import load
from edged.doctor.cameras import look_at_cameras
from edged.doctor.findings import Check, bad, ok, skip, warn
from edged.doctor.machine import ClockWatch, look_at_machine, look_at_ports
from edged.doctor.ourdaemon import our_daemon
from edged.doctor.pictures import take_pictures
from edged.doctor.plc import look_at_plc
from edged.doctor.robotmap import look_at_map
from edged.errors import ConfigError
from edged.setup.cellfiles import CellFiles, UnfinishedCell, doubts, exposed_secrets, read_any_cell
from edged.vision.geometry.camera import StereoRig


def examine(path: Path, *, trigger: bool = True, process: int | None = None) -> Iterator[Check]:
    """All checks for a configuration, as they are done. trigger : take test pictures too.

    process : of the daemon that runs it, where that is known.

    A cell without a rig or jobs is examined as far as that goes: its network comes before its calibration.
    Where its daemon runs, that is asked, and no picture is taken beside it.
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
        for doubt in doubts(cell):
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


def _mistakes(path: Path, error: ConfigError) -> Iterator[Check]:
    for problem in error.problems:
        yield bad("configuration", problem, "the daemon does not start", f"edit {path}")
