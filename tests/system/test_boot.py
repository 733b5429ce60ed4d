"""The units of `systemd/` under a real systemd: one boot of a throwaway machine, one verdict per step.

`scenario.py` has the steps. Skipped with the reason if tools/throwaway cannot boot a machine.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from system.scenario import STEPS, WATCHDOG_S

from edged.adapters.aravis import aravis_missing
from edged.commands.demo import DemoOptions, prepare_cell
from edged.commands.warm import warm
from edged.sim.cell import VirtualCell, demo_part, demo_rig

ROOT = Path(__file__).parent.parent.parent
CANNOT = 77

WATCHDOG = f"""WatchdogSec={WATCHDOG_S:g}
TimeoutAbortSec=2
"""
DROP_IN = f"""# The sandbox hides /tmp and /home, where a checkout may be.
[Service]
ProtectHome=tmpfs
BindReadOnlyPaths={ROOT} {sys.prefix}
"""
UNITS = "edged.service", "edged@.service", "edged-page.service", "edged-page@.service"

PROGRAM = f"""#!/bin/sh
exec {sys.prefix}/bin/python {ROOT}/tests/system/hangable.py "$@"
"""
PYTHON = f"""#!/bin/sh
exec {sys.prefix}/bin/python "$@"
"""


def tree(folder: Path) -> None:
    """What an installed machine has and this one lacks: units, program, configuration, compiled kernels."""
    units = folder / "etc/systemd/system"
    units.mkdir(parents=True)
    for name in UNITS:
        shutil.copy(ROOT / "systemd" / name, units)
        drop_in = units / f"{name}.d" / "test.conf"
        drop_in.parent.mkdir()
        own = f"Environment=PYTHONPATH={ROOT}\n" + ("" if "page" in name else WATCHDOG)
        drop_in.write_text(DROP_IN + own)
    groups = folder / "etc/sysusers.d"
    groups.mkdir()
    shutil.copy(ROOT / "systemd/edged-sysusers.conf", groups / "edged.conf")
    program = folder / "opt/edged/current/bin/edged"
    program.parent.mkdir(parents=True)
    for place, text in ((program, PROGRAM), (program.with_name("python"), PYTHON)):
        place.write_text(text)
        place.chmod(0o755)
    etc = folder / "etc/edged"
    options = DemoOptions(period_s=0.5, modbus_port=1502, zenoh_port=7447, web_port=8080)
    path = prepare_cell(etc, VirtualCell(demo_rig(), demo_part()), options, gige=not aravis_missing())
    text = path.read_text().replace('name = "demo"', 'name = "service"')
    # a test machine may be slow: neither late images nor old results are the subject here
    text = text.replace("timeout_s = 2.0", "timeout_s = 10.0").replace(
        "max_skew_ms = 25.0", "max_skew_ms = 1000.0"
    )
    text = text.replace("[modbus]", "[modbus]\nvalidity_s = 30.0")
    path.write_text(text + '\n[recorder]\nfolder = "/var/lib/edged/recordings"\nmin_free_mib = 0\n')
    for name, ports in (("left", (1503, 7448, 8081)), ("right", (1504, 7449, 8082))):
        other = text.replace('"virtual"', '"virtual-inprocess"')
        for old, new in zip((1502, 7447, 8080), ports, strict=True):
            other = other.replace(str(old), str(new))
        (etc / f"{name}.toml").write_text(other)
    kernels = os.environ.get("NUMBA_CACHE_DIR")
    if kernels:
        warm(only_if_needed=True)
        shutil.copytree(kernels, program.parent.parent / "kernels")


def played(scenario: str, put: Path, out: Path, make: Callable[[], None]) -> dict[str, dict[str, Any]]:
    """The verdict of each step by name. make : fills the folder `put`, which is laid over the machine's."""
    throwaway = [str(ROOT / "tools/throwaway"), "--put", str(put), "--out", str(out), "--timeout", "540"]
    throwaway += ["--see", str(ROOT), "--see", sys.prefix]
    probe = subprocess.run([*throwaway, "--", "true"], capture_output=True, text=True, check=False)
    if probe.returncode == CANNOT:
        pytest.skip(probe.stderr.strip())
    make()
    python = "/usr/bin/env", f"PYTHONPATH={ROOT}/tests", f"{sys.prefix}/bin/python"
    command = [*throwaway, "--", *python, "-m", f"system.{scenario}"]
    subprocess.run([*command, "/out/verdicts.json"], capture_output=True, timeout=600, check=False)
    print((out / "output.txt").read_text())
    return dict(json.loads((out / "verdicts.json").read_text()))


@pytest.fixture(scope="session")
def verdicts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """The verdict of each step by name."""
    put = tmp_path_factory.mktemp("tree")
    return played("scenario", put, tmp_path_factory.mktemp("out"), lambda: tree(put))


@pytest.mark.long
@pytest.mark.parametrize("step", [step.__name__ for step in STEPS])
def test_the_service_under_systemd(step: str, verdicts: dict[str, dict[str, Any]]) -> None:
    """Each step of the scenario is good; the step's docstring states what is checked."""
    assert step in verdicts, "a step before it failed"
    assert verdicts[step]["good"], verdicts[step]["detail"]
