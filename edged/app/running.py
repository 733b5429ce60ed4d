"""The running cell: its components, and what servers and pages report about them."""

from __future__ import annotations

import math
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from edged import __version__
from edged.adapters.enip import EnipPublisher
from edged.adapters.history import CycleHistory, HistoryFigures
from edged.adapters.modbus import ModbusPublisher
from edged.adapters.plcmemory import PlcMemoryPublisher
from edged.adapters.recorder import Recorder
from edged.app.cameras import CellHead, camera_facts, camera_figures
from edged.app.cell import LoadedCell
from edged.cell.cycle import Cycle
from edged.cell.lease.session import SetupSession
from edged.domain.acceptance import Acceptance, AcceptanceState
from edged.domain.marks import MarksState
from edged.domain.overview import Overview, RigFigures
from edged.errors import without_folders
from edged.payload import Json, translatable
from edged.plc.registers import Number, Register
from edged.ports import Publisher
from edged.setup.cellfiles import CellFiles, UnfinishedCell
from edged.vision.geometry.uncertainty import calibration_covariance

GROUPS = {
    "modbus": "Modbus",
    "plc": "PLC",
    "ethernetip": "EtherNet/IP",
    "opcua": "OPC UA",
    "zenoh": "Zenoh",
    "recorder": "Recorder",
    "history": "History",
}
"""Group of the status page that shows a server's problem, by the name of its section."""


@dataclass(slots=True, eq=False)
class Running:
    """The components of a running cell.

    path : of the configuration. loaded, head : replaced by a reload. reload : reads the configuration again;
    returns why it was refused, or "". staged : its world is a stage. servers : by the name of their section.
    problems : why wanted servers do not run, by the name of their section.
    """

    path: Path
    loaded: LoadedCell
    cycle: Cycle
    head: CellHead
    reload: Callable[[], Awaitable[str]]
    staged: bool = False
    servers: dict[str, Publisher] = field(default_factory=dict)
    problems: dict[str, str] = field(default_factory=dict)

    @property
    def files(self) -> CellFiles | UnfinishedCell:
        """The files that the cell runs with."""
        return self.loaded.cell

    @property
    def session(self) -> SetupSession:
        """The lease and the cameras in SETUP."""
        return self.cycle.session

    def modbus(self) -> ModbusPublisher | None:
        """The Modbus server that runs, if any."""
        modbus = self.servers.get("modbus")
        return modbus if isinstance(modbus, ModbusPublisher) else None

    def plc(self) -> PlcMemoryPublisher | None:
        """The PLC whose memory is read and written, if any."""
        plc = self.servers.get("plc")
        return plc if isinstance(plc, PlcMemoryPublisher) else None

    def ethernetip(self) -> EnipPublisher | None:
        """The EtherNet/IP adapter that runs, if any."""
        ethernetip = self.servers.get("ethernetip")
        return ethernetip if isinstance(ethernetip, EnipPublisher) else None

    def registers(self) -> list[tuple[Register, Number]]:
        """Each register with its value; none if Modbus is off."""
        modbus = self.modbus()
        return [] if modbus is None else list(modbus.values())

    def fingerprint(self) -> str:
        """Digest of everything that results depend on."""
        return self.loaded.setup.fingerprint

    def recorded(self) -> tuple[str, Mapping[str, bytes]]:
        """Fingerprint and files, as stored with recordings."""
        return self.fingerprint(), self.files.contents

    def jobs(self) -> list[tuple[int, str]]:
        """Number and name of each job."""
        return [(job.number, job.name) for job in self.loaded.setup.jobs.values()]

    def config_summary(self) -> dict[str, Any]:
        """Answer to `edged/<cell>/config`; a password hash appears as asterisks only."""
        return {
            "version": __version__,
            "fingerprint": self.loaded.setup.fingerprint,
            "calibration": self.loaded.setup.calibration_id,
            "config": self.files.config.model_dump(mode="json"),
        }

    def facts(self) -> dict[str, dict[str, Any]]:
        """Facts about the cell's components for the status page, by group."""
        config, setup = self.files.config, self.loaded.setup
        registered = translatable("not-registered", "no: results are in the rig's frame")
        if setup.robot_from_rig is not None:
            registered = translatable("registered", "yes")
        if setup.flange_from_rig is not None:
            registered = translatable("on-flange", "on the flange: commands say where it is")
        groups: dict[str, dict[str, Any]] = {
            "Software": {"version": __version__, "configuration": setup.fingerprint},
            "Calibration": {
                "id": setup.calibration_id or translatable("none-yet", "none yet"),
                "registered to the robot": registered,
                **self._drift_facts(),
            },
            "Cameras": {"source": config.cameras.source, **camera_facts(self.head)},
        }
        zenoh, recorder = (self.servers.get(name) for name in ("zenoh", "recorder"))
        if (modbus := self.modbus()) is not None:
            groups["Modbus"] = {"port": modbus.port, "clients": modbus.clients}
            if modbus.line_port:
                groups["Modbus"]["lines for robots on"] = modbus.line_port
            if modbus.refused_writers:
                groups["Modbus"]["may not write, and tried"] = ", ".join(modbus.refused_writers)
        if (plc := self.plc()) is not None:
            groups["PLC"] = {"address": plc.place}
            if plc.problem:
                groups["PLC"]["problem"] = translatable("own-words", without_folders(plc.problem))
        if (ethernetip := self.ethernetip()) is not None:
            groups["EtherNet/IP"] = {"scanner": ethernetip.scanner or translatable("none", "none")}
        if (opcua := config.opcua) is not None and "opcua" in self.servers:
            groups["OPC UA"] = {
                "port": opcua.port,
                "commands": translatable("with-password", "with a password")
                if opcua.password_hash
                else translatable("none", "none"),
            }
        if zenoh is not None:
            groups["Zenoh"] = {
                "listens on": ", ".join(config.zenoh.listen) or translatable("nothing", "nothing")
            }
        if isinstance(recorder, Recorder):
            kept = recorder.figures
            groups["Recorder"] = {
                "kept": translatable(
                    "recordings",
                    f"{kept.kept} cycles, {kept.kept_bytes / 1e6:.0f} MB",
                    cycles=str(kept.kept),
                    megabytes=f"{kept.kept_bytes / 1e6:.0f}",
                ),
                "skipped": kept.left_out,
                "failed": kept.failed,
            }
            if kept.problem:
                groups["Recorder"]["problem"] = translatable("own-words", without_folders(kept.problem))
        if (written := self.history()) is not None:
            groups["History"] = {"written": written.written, "skipped": written.left_out}
            if written.problem:
                groups["History"]["problem"] = translatable("own-words", without_folders(written.problem))
        for name, problem in self.problems.items():
            if name in GROUPS:
                groups.setdefault(GROUPS[name], {})["problem"] = translatable(
                    "own-words", without_folders(problem)
                )
        return groups

    def _drift_facts(self) -> dict[str, Json | str]:
        drift = self.cycle.drift
        verdict = drift.verdict.name.lower()
        return {
            "verdict": translatable(verdict, verdict),
            "rows, mean": _figure(drift.rows_px, ".3f", "px"),
            "known length, mean": _figure(drift.length_percent, "+z.3f", "%"),
        }

    def history(self) -> HistoryFigures | None:
        """Figures of the history; None if none is written."""
        found = self.servers.get("history")
        return found.figures if isinstance(found, CycleHistory) else None

    def figures(self) -> dict[str, tuple[str, float]]:
        """Figures of the components for /metrics: name to (help text, value)."""
        drift = self.cycle.drift
        result: dict[str, tuple[str, float]] = {
            "calibration_verdict": (
                "0 the calibration holds, 1 it drifts, 2 results are refused",
                drift.verdict,
            ),
            "rows_mean_pixels": ("mean row difference of corresponding points", drift.rows_px),
            "known_length_error_ratio": ("mean deviation of the known length", drift.length_percent / 100),
            **camera_figures(self.head),
            "servers_failing": ("servers that are configured and could not start", len(self.problems)),
        }
        marks = self.cycle.marks
        if marks.state is not MarksState.NONE:
            result |= {
                "marks_state": (
                    "reference marks: " + ", ".join(f"{state.value} {state.name}" for state in MarksState),
                    marks.state,
                ),
                "marks_valid": ("1 while the reference marks let results be given", marks.valid),
                "marks_seen": ("reference marks used in the last exposure", marks.seen),
                "marks_excluded": ("reference marks that disagree with the others", len(marks.excluded)),
                "marks_fit": ("squared misfit of the marks over what is expected", _or_nan(marks.fit)),
                "marks_left_moved_metres": ("how far the left camera moved", _or_nan(marks.left_mm) / 1000),
                "marks_right_moved_metres": (
                    "how far the right camera moved",
                    _or_nan(marks.right_mm) / 1000,
                ),
            }
        if (accepted := self.cycle.acceptance) != Acceptance():
            states = ", ".join(f"{state.value} {state.name}" for state in AcceptanceState)
            result |= {
                "acceptance_state": (f"acceptance test: {states}", accepted.state(time.time_ns())),
                "acceptance_due_seconds": ("UTC since 1970, when it is due again", accepted.due_ns / 1e9),
            }
        if (mapped := self.cycle.robot_map).degree:
            result |= {
                "robot_map_degree": ("of the map of the robot's error", mapped.degree),
                "robot_map_points": ("places that were touched for it", mapped.points),
                "robot_map_alone_metres": (
                    "rms of places that were left out, by the registration alone",
                    mapped.alone_mm / 1000,
                ),
                "robot_map_held_out_metres": ("the same with the map", mapped.held_out_mm / 1000),
                "robot_map_noise_metres": ("one sigma of what it does not tell", mapped.noise_mm / 1000),
            }
        if (written := self.history()) is not None:
            result["history_left_out"] = ("cycles that the history lacks", written.left_out)
        recorder = self.servers.get("recorder")
        if (modbus := self.modbus()) is not None:
            result["modbus_clients"] = ("Modbus clients that are connected", modbus.clients)
        if (plc := self.plc()) is not None:
            result["plc_reached"] = ("1 while the memory of the PLC is read and written", not plc.problem)
        if (ethernetip := self.ethernetip()) is not None:
            result["ethernetip_running"] = (
                "1 while a scanner writes, and its controller runs",
                ethernetip.is_running,
            )
        if isinstance(recorder, Recorder):
            kept = recorder.figures
            result |= {
                "recordings": ("recordings on disk", kept.kept),
                "recordings_bytes": ("size of all recordings", kept.kept_bytes),
                "recordings_left_out": ("cycles skipped since the start: the disk was slower", kept.left_out),
                "recordings_failed": ("recordings that could not be written since the start", kept.failed),
            }
        return result

    def overview(self) -> Overview:
        """Overview for the person who sets the cell up."""
        loaded, drift, rig = self.loaded, self.cycle.drift, None
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
                self._calibration_sigma_um(),
            )
        modbus = self.modbus()
        missing = loaded.cell.missing if isinstance(loaded.cell, UnfinishedCell) else ()
        lacking = {line.partition(":")[0] for line in missing}
        return Overview(
            missing=tuple(
                name
                for name, lines in (("rig", {"cell.rig"}), ("jobs", {"cell.jobs", "cell.job"}))
                if lines & lacking
            ),
            rig=rig,
            plc_owner="" if modbus is None else modbus.owner,
            auto_lock=self.session.lease.locked,
            stage=self.staged,
        )

    def _calibration_sigma_um(self) -> tuple[float, float, float] | None:
        """Sigma of X, Y, Z due to the calibration, rig frame, µm, rms over taught places; None if unknown."""
        loaded = self.loaded
        if loaded.rig is None or loaded.rig.rig.covariance is None or not isinstance(loaded.cell, CellFiles):
            return None
        points_mm = np.array([job.rig_from_part[:3, 3] for job in loaded.cell.jobs])
        variances = np.einsum("nii->ni", calibration_covariance(loaded.rig.rig, points_mm))
        x, y, z = 1e3 * np.sqrt(variances.mean(axis=0))
        return float(x), float(y), float(z)


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _figure(value: float, digits: str, unit: str) -> Json | str:
    if math.isnan(value):
        return "–"
    text = format(value, digits)
    return translatable("figure", f"{text} {unit}", value=text, unit=unit)
