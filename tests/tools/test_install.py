"""Installation as root by hashes of packages, and what an uninstallation leaves."""

from __future__ import annotations

import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest
from helpers.waiting import WHOLE_S
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
UNITS = ("edged.service", "edged@.service", "edged-page.service", "edged-page@.service")
SWITCH = ("edged-switch.service", "edged-switch.path")
LOCKS = sorted((ROOT / "requirements").glob("*.txt"))
PIN = re.compile(r"^([A-Za-z0-9._-]+)==(\S+)(?: ; ([^\\\n]+?))? \\$", re.MULTILINE)


def pins(name: str) -> dict[str, str]:
    """The pinned version of each package in one of the files."""
    text = (ROOT / "requirements" / f"{name}.txt").read_text()
    return {canonicalize_name(package): version for package, version, _ in PIN.findall(text)}


def project() -> dict[str, object]:
    """The contents of pyproject.toml."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


@pytest.mark.parametrize("lock", LOCKS, ids=lambda lock: lock.stem)
def test_every_package_has_one_version_and_its_hashes(lock: Path) -> None:
    """Each entry is NAME==VERSION with SHA-256 hashes, and there is nothing else."""
    text = re.sub(r"(?m)^ *#.*\n", "", lock.read_text())
    entries = text.replace("\\\n", "").splitlines()

    assert entries
    for entry in entries:
        head, *hashes = entry.split(" --hash=")
        assert re.fullmatch(r"\s*[a-z0-9-]+==([0-9]+!)?[\w.]+( ; .+)?\s*", head), entry
        assert hashes
        for one in hashes:
            assert re.fullmatch(r"sha256:[0-9a-f]{64}\s*", one), entry


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("run", lambda p: p["project"]["dependencies"]),
        ("dev", lambda p: p["project"]["dependencies"] + p["project"]["optional-dependencies"]["dev"]),
        ("dev", lambda p: p["build-system"]["requires"]),
        ("build", lambda p: p["build-system"]["requires"]),
        ("ros2", lambda p: p["project"]["optional-dependencies"]["ros2"]),
        ("opcua", lambda p: p["project"]["optional-dependencies"]["opcua"]),
        ("s7", lambda p: p["project"]["optional-dependencies"]["s7"]),
        ("melsec", lambda p: p["project"]["optional-dependencies"]["melsec"]),
        ("witness", lambda p: p["project"]["optional-dependencies"]["witness"]),
        ("history", lambda p: p["project"]["optional-dependencies"]["history"]),
        ("fleet", lambda p: p["project"]["optional-dependencies"]["fleet"]),
        ("tokens", lambda p: p["project"]["optional-dependencies"]["tokens"]),
        ("manual", lambda _: ["mkdocs-material"]),
        ("aravis", lambda p: p["project"]["optional-dependencies"]["aravis"]),
    ],
)
def test_the_locks_are_those_of_pyproject(name: str, wanted) -> None:
    """Every requirement has a version in the lock that fits it (if not: `tools/lock`)."""
    locked = pins(name)
    wrong = [
        text
        for text in wanted(project())
        if not Requirement(text).specifier.contains(locked.get(canonicalize_name(Requirement(text).name), ""))
    ]

    assert [] == wrong


def test_the_locks_agree() -> None:
    """A package has the same version in all locks."""
    tested = pins("dev")

    for name in ("run", "build", "manual", "opcua", "s7", "melsec"):
        assert pins(name).items() <= tested.items(), name
    # what is there already stays as it is
    assert [] == [name for name, version in pins("witness").items() if tested.get(name, version) != version]


def test_the_tool_that_builds_is_pinned() -> None:
    """pyproject.toml pins the build tool to the version in the lock."""
    (builder,) = project()["build-system"]["requires"]

    assert f"setuptools=={pins('build')['setuptools']}" == builder


def test_nothing_is_installed_without_hashes() -> None:
    """pip installs from requirements/ by hashes, or what was just built here."""
    calls = []
    for script in (ROOT / "tools" / name for name in ("install", "setup.sh")):
        text = re.sub(r"\\\n\s*", "", script.read_text())
        calls += [
            line.strip() for line in text.splitlines() if re.search(r"pip (install|download|wheel)\b", line)
        ]
        calls += [line.strip() for line in text.splitlines() if re.search(r"^\s*pip_install ", line)]

    assert 8 <= len(calls)
    for call in calls:
        if call.startswith("pip_install()"):
            continue
        hashed = "--require-hashes" in call or '"${hashed[@]}"' in call
        local = "--no-deps" in call and ("--no-index" in call or "--no-build-isolation -e ." in call)
        assert hashed or local, call


# --- uninstallation, below a folder --------------------------------------------------------------


@pytest.fixture
def image(tmp_path: Path) -> Path:
    """An installation with three enabled cells below a folder, with files of others."""
    units = tmp_path / "etc/systemd/system"
    wants = units / "multi-user.target.wants"
    state = (tmp_path / "var/lib" / name for name in ("edged-left", "edged_page", "edged_page-left"))
    for folder in (wants, tmp_path / "etc/edged", tmp_path / "opt/edged", *state):
        folder.mkdir(parents=True)
    for name in (*UNITS, *SWITCH, "other.service"):
        (units / name).write_text("[Unit]\n")
    for link, unit in (
        ("edged.service", "edged.service"),
        ("edged@left.service", "edged@.service"),
        ("edged@right.service", "edged@.service"),
        ("edged-switch.path", "edged-switch.path"),
        ("other.service", "other.service"),
    ):
        (wants / link).symlink_to(f"/etc/systemd/system/{unit}")
    (tmp_path / "etc/edged/left.toml").write_text("")
    return tmp_path


def install(image: Path, *arguments: str) -> None:
    """Run tools/install below a folder."""
    environment = {**os.environ, "EDGED_ROOT_DIR": str(image)}
    subprocess.run([ROOT / "tools/install", *arguments], env=environment, check=True, timeout=WHOLE_S)


def test_an_uninstallation_leaves_no_cell_enabled(image: Path) -> None:
    """After an uninstallation no cell is enabled; other units are, and the cells' files stay."""
    install(image, "--uninstall")

    left = {path.relative_to(image).as_posix() for path in image.rglob("*") if not path.is_dir()}
    units = "etc/systemd/system"
    assert {
        f"{units}/other.service",
        f"{units}/multi-user.target.wants/other.service",
        "etc/edged/left.toml",
    } == left


def test_systemd_is_told_of_every_cell(image: Path, tmp_path: Path) -> None:
    """Every enabled or running cell is disabled by name."""
    script = (ROOT / "tools/install").read_text().partition('if [ "${1:-}" = --pack ]')[0]
    told = tmp_path / "told"
    stub = f"""
        systemd_runs() {{ true; }}
        systemctl() {{
            echo "$*" >>{told}
            [ "$1" != list-units ] || printf 'edged@%s.service loaded active running cell\\n' hand left
        }}
        uninstall
    """
    environment = {**os.environ, "EDGED_ROOT_DIR": str(image)}
    subprocess.run(["bash", "-c", script + stub], env=environment, check=True, timeout=WHOLE_S)

    (disabled,) = (line for line in told.read_text().splitlines() if line.startswith("disable"))
    cells = [
        "edged-switch.path",
        "edged.service",
        *(f"edged@{name}.service" for name in ("hand", "left", "right")),
    ]
    assert ["disable", "--now", *cells] == disabled.split()


def test_a_purge_leaves_nothing(image: Path) -> None:
    """After a purge nothing of edged is left, nor of its pages."""
    install(image, "--purge")
    assert [] == [path.name for path in image.rglob("*edged*")]


@pytest.mark.parametrize("unit", UNITS)
def test_a_daemon_may_read_what_the_installation_writes(unit: str) -> None:
    """The unit is in the groups of its configuration and of its files for the page."""
    made = [
        line.split()[1]
        for line in (ROOT / "systemd/edged-sysusers.conf").read_text().splitlines()
        if line.startswith("g ")
    ]
    text = (ROOT / "systemd" / unit).read_text()
    (groups,) = re.findall(r"(?m)^SupplementaryGroups=(.*)$", text)
    (group,) = re.findall(r"(?m)^Group=(.*)$", text)

    assert ["edged-config", "edged-link"] == made
    assert "edged-config" in groups.split()
    assert "edged-link" == group
