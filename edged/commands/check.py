"""`edged check`: checks whether a configuration can run with its rig and its jobs."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from edged.errors import ConfigError
from edged.setup.cellfiles import UnfinishedCell, exposed_secrets, read_any_cell, warnings_for


def check(path: Path, *, as_json: bool) -> int:
    """Print the findings; 0 if the cell would measure, 2 if not.

    If only the rig or the jobs are missing and there is no other mistake, the daemon still starts, in SETUP.
    """
    try:
        cell = read_any_cell(path)
    except ConfigError as error:
        return _refused(path, error, as_json=as_json)
    if isinstance(cell, UnfinishedCell):
        return _refused(path, ConfigError(str(path), [*cell.missing]), as_json=as_json, starts_in_setup=True)
    config, rig = cell.config, cell.rig
    warnings = [*warnings_for(cell), *(str(secret) for secret in exposed_secrets(path, config))]
    jobs = [{"number": job.number, "name": job.name} for job in cell.jobs]
    if as_json:
        print(
            json.dumps(
                {
                    "ok": True,
                    "file": str(path),
                    "problems": [],
                    "warnings": warnings,
                    "cell": config.cell.name,
                    "fingerprint": cell.fingerprint,
                    "calibration": rig.calibration_id,
                    "robot_frame": rig.robot_from_rig is not None,
                    "jobs": jobs,
                }
            )
        )
        return 0
    print(f"{path}: good" if not warnings else f"{path}: it would run; {len(warnings)} to look at")
    print(f"  cell         {config.cell.name}, fingerprint {cell.fingerprint}")
    frame = "robot" if rig.robot_from_rig is not None else "rig (not registered to a robot)"
    if rig.flange_from_rig is not None:
        frame = "robot, of commands that say where the flange is"
    if rig.robot_map is not None:
        frame = f"robot, by a map of its error of degree {rig.robot_map.degree}"
    print(f"  rig          {rig.calibration_id}; coordinates in the frame: {frame}")
    print("  jobs         " + ", ".join(f"{job['number']} {job['name']}" for job in jobs))
    when = f"every {config.cycle.period_s:g} s" if config.cycle.mode == "free" else "on command"
    print(f"  cameras      {config.cameras.source}, {when}")
    bounds = [config.limits.bounds(), *(bound for job in cell.jobs for bound in job.picking.bounds)]
    if count := sum(len(bound.boxes) + len(bound.keep_out) for bound in bounds):
        where = "rig (not registered to a robot)" if frame.startswith("rig") else "robot"
        print(f"  limits       {count} boxes and keep-out zones, in the frame: {where}")
    for warning in warnings:
        print(f"  warning      {warning}")
    return 0


def _refused(path: Path, error: ConfigError, *, as_json: bool, starts_in_setup: bool = False) -> int:
    if as_json:
        document = {"ok": False, "file": str(path), "problems": error.problems, "setup": starts_in_setup}
        print(json.dumps(document))
        return 2
    sys.stderr.write(f"edged: {error}\n")
    if starts_in_setup:
        sys.stderr.write("nothing else is wrong: the daemon would start, in SETUP, and measure nothing\n")
    return 2
