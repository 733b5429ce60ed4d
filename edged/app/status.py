"""What a running cell says of its parts: facts for people, figures for /metrics, rows of registers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from edged import __version__
from edged.adapters.modbus import ModbusPublisher
from edged.adapters.recorder import Recorder
from edged.app.cameras import camera_facts, camera_figures
from edged.app.cell import LoadedCell
from edged.cell.cycle import Cycle
from edged.cell.stereohead import StereoHead
from edged.payload import Json, said
from edged.plc.registers import Number, Register
from edged.ports import Publisher
from edged.setup.cellfiles import CellFiles, UnfinishedCell
from edged.vision.geometry.uncertainty import calibration_covariance

if TYPE_CHECKING:  # a cell without the page does not load it
    from edged.adapters.web import Overview


GROUPS = {"modbus": "Modbus", "opcua": "OPC UA", "zenoh": "Zenoh", "recorder": "Recorder"}
"""Where the status page says what is wrong with a server."""


@dataclass(frozen=True, slots=True, eq=False)
class Running:
    """The parts of a running cell; servers by the name of their section. staged : its world is a stage.

    problems : why servers do not run that are wanted, by the name of their section.
    """

    loaded: LoadedCell
    cycle: Cycle
    head: StereoHead
    servers: Mapping[str, Publisher]
    staged: bool = False
    problems: Mapping[str, str] = field(default_factory=dict)


def register_rows(modbus: Publisher | None) -> list[tuple[Register, Number]]:
    """Each register with its value; none where Modbus is off."""
    if not isinstance(modbus, ModbusPublisher):
        return []
    return list(modbus.values())


def facts(running: Running) -> dict[str, dict[str, Any]]:
    """What the status page says of the parts, group by group."""
    config, setup = running.loaded.cell.config, running.loaded.setup
    registered = said("not-registered", "no: results are in the rig's frame")
    if setup.robot_from_rig is not None:
        registered = said("registered", "yes")
    if setup.flange_from_rig is not None:
        registered = said("on-flange", "on the flange: commands say where it is")
    groups: dict[str, dict[str, Any]] = {
        "Software": {"version": __version__, "configuration": setup.fingerprint},
        "Calibration": {
            "id": setup.calibration_id or said("none-yet", "none yet"),
            "registered to the robot": registered,
            **_drift_facts(running),
        },
        "Cameras": {"source": config.cameras.source, **camera_facts(running.head)},
    }
    modbus, zenoh, recorder = (running.servers.get(name) for name in ("modbus", "zenoh", "recorder"))
    if isinstance(modbus, ModbusPublisher):
        groups["Modbus"] = {"port": modbus.port, "clients": modbus.clients}
        if modbus.line_port:
            groups["Modbus"]["lines for robots on"] = modbus.line_port
        if modbus.refused_writers:
            groups["Modbus"]["may not write, and tried"] = ", ".join(modbus.refused_writers)
    if (opcua := config.opcua) is not None and "opcua" in running.servers:
        groups["OPC UA"] = {
            "port": opcua.port,
            "commands": said("with-password", "with a password")
            if opcua.password_hash
            else said("none", "none"),
        }
    if zenoh is not None:
        groups["Zenoh"] = {"listens on": ", ".join(config.zenoh.listen) or said("nothing", "nothing")}
    if isinstance(recorder, Recorder):
        kept = recorder.figures
        groups["Recorder"] = {
            "kept": said(
                "recordings",
                f"{kept.kept} cycles, {kept.kept_bytes / 1e6:.0f} MB",
                cycles=str(kept.kept),
                megabytes=f"{kept.kept_bytes / 1e6:.0f}",
            ),
            "skipped": kept.left_out,
            "failed": kept.failed,
        }
        if kept.problem:
            groups["Recorder"]["problem"] = said("own-words", kept.problem)
    for name, problem in running.problems.items():
        if name in GROUPS:
            groups.setdefault(GROUPS[name], {})["problem"] = said("own-words", problem)
    return groups


def _drift_facts(running: Running) -> dict[str, Json | str]:
    drift = running.cycle.drift
    verdict = drift.verdict.name.lower()
    return {
        "verdict": said(verdict, verdict),
        "rows, mean": _figure(drift.rows_px, ".3f", "px"),
        "known length, mean": _figure(drift.length_percent, "+.3f", "%"),
    }


def _figure(value: float, digits: str, unit: str) -> Json | str:
    if math.isnan(value):
        return "–"
    text = format(value, digits)
    return said("figure", f"{text} {unit}", value=text, unit=unit)


def figures(running: Running) -> dict[str, tuple[str, float]]:
    """Figures of the parts for /metrics."""
    drift = running.cycle.drift
    result: dict[str, tuple[str, float]] = {
        "calibration_verdict": (
            "0 the calibration holds, 1 it drifts, 2 results are refused",
            drift.verdict,
        ),
        "rows_mean_pixels": ("mean row difference of corresponding points", drift.rows_px),
        "known_length_error_ratio": ("mean deviation of the known length", drift.length_percent / 100),
        **camera_figures(running.head),
        "servers_failing": ("servers that are configured and could not start", len(running.problems)),
    }
    modbus, recorder = running.servers.get("modbus"), running.servers.get("recorder")
    if isinstance(modbus, ModbusPublisher):
        result["modbus_clients"] = ("Modbus clients that are connected", modbus.clients)
    if isinstance(recorder, Recorder):
        kept = recorder.figures
        result |= {
            "recordings": ("recordings on disk", kept.kept),
            "recordings_bytes": ("size of all recordings", kept.kept_bytes),
            "recordings_left_out": (
                "cycles skipped since the start: the disk was slower",
                kept.left_out,
            ),
            "recordings_failed": ("recordings that could not be written since the start", kept.failed),
        }
    return result


def overview(running: Running) -> Overview:
    """What who sets the cell up sees first; only a cell with the page asks."""
    from edged.adapters.web import Overview, RigFigures

    loaded, drift, rig = running.loaded, running.cycle.drift, None
    calibrated = loaded.cell.rig
    if calibrated is not None:
        on_flange = calibrated.flange_from_rig is not None
        registered = calibrated.robot_from_rig is not None
        rig = RigFigures(
            calibrated.calibration_id,
            "on_flange" if on_flange else "yes" if registered else "no",
            drift.verdict.name.lower(),
            drift.rows_px,
            drift.length_percent,
            _calibration_sigma_um(loaded),
        )
    missing = loaded.cell.missing if isinstance(loaded.cell, UnfinishedCell) else ()
    lacking = {line.partition(":")[0] for line in missing}
    modbus = running.servers.get("modbus")
    return Overview(
        missing=tuple(
            name
            for name, lines in (("rig", {"cell.rig"}), ("jobs", {"cell.jobs", "cell.job"}))
            if lines & lacking
        ),
        rig=rig,
        plc_owner=modbus.owner if isinstance(modbus, ModbusPublisher) else "",
        auto_lock=running.cycle.session.lease.locked,
        stage=running.staged,
    )


def _calibration_sigma_um(loaded: LoadedCell) -> tuple[float, float, float] | None:
    """Of X, Y, Z in the rig's frame, rms over where the jobs' parts were taught; None: not known."""
    if loaded.rig is None or loaded.rig.rig.covariance is None or not isinstance(loaded.cell, CellFiles):
        return None
    points_mm = np.array([job.rig_from_part[:3, 3] for job in loaded.cell.jobs])
    variances = np.einsum("nii->ni", calibration_covariance(loaded.rig.rig, points_mm))
    x, y, z = 1e3 * np.sqrt(variances.mean(axis=0))
    return float(x), float(y), float(z)


def job_list(loaded: LoadedCell) -> list[tuple[int, str]]:
    """Number and name of each job."""
    return [(job.number, job.name) for job in loaded.setup.jobs.values()]


def sigma_limits(loaded: LoadedCell) -> dict[int, float]:
    """What each job allows a coordinate's sigma to be, mm, by its number."""
    cell = loaded.cell
    return {job.number: job.limits.max_sigma_mm for job in cell.jobs} if isinstance(cell, CellFiles) else {}


def config_summary(loaded: LoadedCell) -> dict[str, Any]:
    """What `edged/<cell>/config` answers; asterisks say that there is a password's hash, and no more."""
    return {
        "version": __version__,
        "fingerprint": loaded.setup.fingerprint,
        "calibration": loaded.setup.calibration_id,
        "config": loaded.cell.config.model_dump(mode="json"),
    }
