"""Whole software updates under a real systemd: wheels of this tree, signed, pulled, tried, switched to.

`updates.py` has the steps. Skipped with the reason if tools/throwaway cannot boot a machine.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path
from typing import Any

import pytest
from helpers.releases import PASSPHRASE, Releases
from helpers.smallcell import SmallCell
from helpers.webcell import HASH
from helpers.wheels import make_wheel, packages_of_tests
from system.test_boot import DROP_IN, ROOT, UNITS, played
from system.updates import BLIND, GOOD, OLD, STEPS

from edged.vision.kernels.jitcache import take_over

PACKAGES = f"lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages"
CUT = """#!/opt/edged/versions/{old}/bin/python
import itertools, os, signal, sys
from pathlib import Path
from edged.__main__ import main

cut, count, replace = Path("/run/cut"), itertools.count(1), os.replace

def replaced(*places, **within):
    at, number = cut.read_text(), next(count)
    if at == f"{{number}}":
        os.kill(os.getpid(), signal.SIGKILL)
    replace(*places, **within)
    if at == f"{{number}}+":
        os.kill(os.getpid(), signal.SIGKILL)

if "switch" in sys.argv and cut.exists():
    os.replace = replaced
sys.exit(main())
"""
"""The program of the old version; its agent dies by SIGKILL at the exchange of files in /run/cut."""


def copy_sources(folder: Path) -> None:
    """Copy the package without generated files."""
    made = shutil.ignore_patterns("__pycache__", "manual")
    shutil.copytree(ROOT / "edged", folder / "edged", ignore=made)


def old_version(place: Path) -> None:
    """A version as `tools/install` makes it, with compiled kernels, but with this environment's packages."""
    venv.create(place, system_site_packages=True)
    copy_sources(place / PACKAGES)
    (place / PACKAGES / "rest.pth").write_text("\n".join(packages_of_tests()))
    (place / "bin" / "edged").write_text(CUT.format(old=OLD))
    (place / "bin" / "edged").chmod(0o755)
    (place / ".complete").write_text("")
    kernels = os.environ.get("NUMBA_CACHE_DIR")
    if kernels:
        take_over(Path(kernels), ROOT, place / "kernels", Path("/opt/edged/versions", OLD, PACKAGES))


def wheels_of(tree: Path, folder: Path, version: str) -> None:
    """A wheel of a tree with this version, and one of all that it needs from this environment."""
    init = tree / "edged" / "__init__.py"
    kept = [line for line in init.read_text().splitlines() if not line.startswith("__version__")]
    init.write_text("\n".join([*kept, f'__version__ = "{version}"', ""]))
    pip = "-m pip wheel -q --disable-pip-version-check --no-deps --no-build-isolation --no-index -w"
    subprocess.run([sys.executable, *pip.split(), folder, tree], check=True)
    make_wheel(folder, "rest", "1.0", paths=packages_of_tests())


def tree_of_this(folder: Path) -> Path:
    """This tree, which needs the wheel `rest` alone."""
    copy_sources(folder)
    shutil.copy(ROOT / "README.md", folder)
    head, needs = (ROOT / "pyproject.toml").read_text().split("\ndependencies = [\n", 1)
    others = needs.split("\n]\n", 1)[1]
    (folder / "pyproject.toml").write_text(f'{head}\ndependencies = ["rest"]\n{others}')
    return folder


def make_blind(tree: Path) -> None:
    """Change the tree so that its cycles find nothing, but its measurements of recorded cycles everything."""
    cell = tree / "edged" / "app" / "cell.py"
    text, calls = cell.read_text(), "return locate(pair, job, rig, lap)"
    assert calls in text
    cell.write_text(text.replace(calls, "return locate(blinded(pair), job, rig, lap)") + BLINDED)


BLINDED = """

def blinded(pair):
    from dataclasses import replace
    left, right = (replace(frame, image=frame.image * 0) for frame in (pair.left, pair.right))
    return replace(pair, left=left, right=right)
"""


def publish(put: Path, folder: Path) -> None:
    """Publish the good release in one repository, and both releases in another."""
    releases, tree = Releases(folder / "fleet"), tree_of_this(folder / "tree")
    releases.make()
    for name, place, edit in ((GOOD, "releases", None), (BLIND, "later", make_blind)):
        if edit is not None:
            edit(tree)
        wheels_of(tree, folder / name, name.removeprefix("edged-"))
        assert 0 == releases.sign(name, "--wheels", folder / name, "--ring", "all")
        assert 0 == releases.publish()
        shutil.copytree(releases.repository, put / "srv" / place)
    shutil.copy(releases.root, put / "etc/edged/root.json")


def tree(put: Path, folder: Path) -> None:
    """A machine with units, an old version, a cell, and repositories."""
    units = put / "etc/systemd/system"
    units.mkdir(parents=True)
    shutil.copy(ROOT / "systemd/edged-switch.path", units)
    for name in (*UNITS, "edged-switch.service"):
        shutil.copy(ROOT / "systemd" / name, units)
        (units / f"{name}.d").mkdir()
        (units / f"{name}.d" / "test.conf").write_text(DROP_IN)
    (put / "etc/sysusers.d").mkdir()
    shutil.copy(ROOT / "systemd/edged-sysusers.conf", put / "etc/sysusers.d/edged.conf")
    old_version(put / "opt/edged/versions" / OLD)
    for link in ("current", "agent"):
        (put / "opt/edged" / link).symlink_to(f"versions/{OLD}")
    cell = SmallCell(put / "etc/edged", period_s=0.2, recordings=Path("/var/lib/edged/recordings"))
    text = cell.config.read_text()
    for port, own in ((cell.modbus_port, 1502), (cell.zenoh_port, 7447), (cell.web_port, 8080)):
        text = text.replace(f"{port}", f"{own}")
    # their pictures are there for as long as a busy machine measures them
    text = text.replace("keep_good = 60", "keep_good = 400")
    text = text.replace("[web]\n", f'[web]\npassword_hash = "{HASH}"\ncommissioning = true\n')
    text += '[fleet]\nrepository = "/srv/releases"\nplant = "north"\nroot = "root.json"\n'
    cell.config.write_text(text + 'software = "/opt/edged"\n')


@pytest.fixture(scope="module")
def verdicts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """The verdict of each step by name."""
    put, folder = tmp_path_factory.mktemp("tree"), tmp_path_factory.mktemp("releases")

    def make() -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("EDGED_PASSPHRASE", PASSPHRASE)
            tree(put, folder)
            publish(put, folder)

    return played("updates", put, tmp_path_factory.mktemp("out"), make)


@pytest.mark.long
@pytest.mark.parametrize("step", [step.__name__ for step in STEPS])
def test_updates_under_systemd(step: str, verdicts: dict[str, dict[str, Any]]) -> None:
    """Each step of the scenario is good; the step's docstring states what is checked."""
    assert step in verdicts, "a step before it failed"
    assert verdicts[step]["good"], verdicts[step]["detail"]
