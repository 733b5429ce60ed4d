"""If a command cannot write its output, there is one clear line and exit code 2."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args, get_type_hints

import cv2
import pytest
import typer
from helpers import commandline
from helpers.boardpairs import SPEC, pairs
from helpers.cells import flange, small_rig
from helpers.histories import make_fleet
from helpers.recordedcell import record
from helpers.releases import PASSPHRASE, Releases

from edged.cli.main import app
from edged.commands.demo import DemoOptions, prepare_cell
from edged.domain.frames import FramePair
from edged.setup.cellfiles import read_cell
from edged.sim.cell import VirtualCell, demo_part

Command = Callable[[str], tuple[int, list[str]]]
TEACH = "teach --rig rig.json --left left.png --right right.png --name new"
LOCATE = "locate --rig rig.json --job jobs/flange left.png right.png"
OUTPUTS = {
    ("accept", "output"): "accept pictures --rig rig.json --job jobs/flange -o {}/out",
    ("backup", "output"): "backup cell.toml -o {}/cell.tar.gz",
    ("board", "output"): "board chessboard:11x8:15 -o {}/board.pdf",
    ("calibrate", "output"): f"calibrate pictures --board {SPEC} -o {{}}/rig.json",
    ("calibrate", "report"): f"calibrate pictures --board {SPEC} -o new.json --report {{}}/rig.html",
    ("cameras", "report"): "cameras --report {}/cameras.json --minutes 0.1",
    ("demo", "folder"): "demo --in-process --cycles 1 --folder {}/cell",
    ("grab", "output"): "grab cell.toml -o {}/pictures",
    ("history", "week"): "history --in history --week {}/week.html",
    ("locate", "cloud"): f"{LOCATE} --cloud {{}}/cloud.png",
    ("locate", "overlay"): f"{LOCATE} --overlay {{}}/seen.png",
    ("locate", "ply"): f"{LOCATE} --ply {{}}/cloud.ply",
    ("register hand-eye", "output"): "register hand-eye pictures --rig rig.json --poses poses.csv "
    f"--board {SPEC} --brand kuka -o {{}}/rig.json",
    (
        "register marks",
        "output",
    ): "register marks --rig rig.json --former rig.json --former-marks touched.csv -o {}/rig.json",
    ("register touch", "output"): "register touch --rig rig.json --points touched.csv -o {}/rig.json",
    ("release key", "file"): "release key {}/root.key",
    ("release pull", "output"): "release pull fleet.toml --name notes -o {}/notes",
    ("release root", "repository"): "release root {}/repository --key fleet/keys/root1.key "
    "--targets fleet/keys/targets.pub --online fleet/keys/online.pub --threshold 1",
    ("registers", "output"): "registers --format twincat -o {}/client",
    ("replay", "export"): "replay recordings --export {}/copies",
    ("replay", "overlays"): "replay recordings --overlays {}/pictures",
    ("restore", "output"): "restore cell.tar.gz -o {}/cell",
    ("rig convert", "target"): "rig convert rig.json {}/rig.yaml --to opencv",
    ("run", "trace"): "run cell.toml --trace {}/trace.json",
    ("study", "report"): "study pictures --rig rig.json --job jobs/flange --size c0 --tolerance 1:2 "
    "--report {}/study.html",
    ("support", "output"): "support cell.toml -o {}/help.zip",
    ("teach", "output"): f"{TEACH} -o {{}}/new",
    ("teach", "report"): f"{TEACH} -o new --report {{}}/new.html",
}
"""A command for each option that writes, with a placeholder for its path."""
REPOSITORIES = {(f"release {name}", "repository") for name in ("countersign", "delegate", "publish", "sign")}
"""Folders made by another command, into which these write."""
INPUTS = {
    *(("belt", name) for name in ("images", "rig")),
    *((f"release {name}", "key") for name in ("countersign", "delegate", "publish", "root", "sign")),
    *(("release root", name) for name in ("targets", "online")),
    ("release delegate", "plant_key"),
    *(("release sign", name) for name in ("cells", "file", "jobs", "wheels")),
    *((f"release {name}", "config") for name in ("pull", "status", "switch")),
    ("support", "config"),
    *(("sim", name) for name in ("config", "images")),
    *(("watch", name) for name in ("authority", "certificate", "key", "shared_key")),
    *((name, "config") for name in ("audit", "backup", "check", "doctor", "grab", "registers", "run")),
    ("web invite", "config"),
    *(("teach", name) for name in ("rig", "left", "right", "step", "dxf", "contour")),
    *((name, "rig") for name in ("golden", "grasp touch", "locate", "verify")),
    *((name, "job") for name in ("golden", "grasp touch", "locate", "verify")),
    *((name, side) for name in ("golden", "grasp touch", "locate", "verify") for side in ("left", "right")),
    *(("marks teach", name) for name in ("rig", "directory")),
    *(("marks status", name) for name in ("rig", "left", "right")),
    *(("accept", name) for name in ("directory", "rig", "job", "length_job", "sign")),
    *(("study", name) for name in ("directory", "rig", "job")),
    *((f"register {name}", "rig") for name in ("hand-eye", "marks", "self-test", "touch")),
    *(("register marks", name) for name in ("former", "former_marks")),
    *((f"register {name}", part) for name in ("hand-eye", "self-test") for part in ("directory", "poses")),
    ("calibrate", "directory"),
    ("register touch", "points"),
    ("replay", "path"),
    ("restore", "archive"),
    ("restore", "verify"),
    ("backup", "sign"),
    ("rig convert", "source"),
}
"""All other path parameters of commands, which are only read."""


def kinds_in(kind: Any) -> Iterator[Any]:
    """A type, and the types it is composed of."""
    yield kind
    for inner in get_args(kind):
        yield from kinds_in(inner)


def paths_of(group: typer.Typer, above: str = "") -> Iterator[tuple[str, str]]:
    """Each command, with each of its path parameters."""
    for command in group.registered_commands:
        assert command.callback is not None
        name = f"{above} {command.name or command.callback.__name__}".strip()
        for parameter, kind in get_type_hints(command.callback).items():
            if Path in kinds_in(kind):
                yield name, parameter
    for inner in group.registered_groups:
        assert inner.typer_instance is not None
        names = (inner.name, inner.typer_instance.info.name)
        yield from paths_of(
            inner.typer_instance, next((name for name in names if isinstance(name, str)), above)
        )


def test_every_option_that_writes_is_tried() -> None:
    """Every path parameter is either read, or listed above."""
    assert set() == INPUTS & OUTPUTS.keys()
    assert INPUTS | OUTPUTS.keys() | REPOSITORIES == {*paths_of(app)}


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cell's folder with everything that the commands above read."""
    path = tmp_path_factory.mktemp("cell")
    prepare_cell(path, VirtualCell(small_rig(), demo_part(), seed=11), DemoOptions(), gige=False)
    part = flange()
    for side, image in (("left", part.left), ("right", part.right)):
        cv2.imwrite(str(path / f"{side}.png"), image)
    (path / "pictures").mkdir()
    (path / "recordings").mkdir()
    record(path / "recordings", read_cell(path / "cell.toml"), [FramePair.of_images(part.left, part.right)])
    for number, pair in enumerate(pairs()):
        for side, image in zip(("left", "right"), pair, strict=True):
            cv2.imwrite(str(path / "pictures" / f"{number}_{side}.png"), image)
    places = ("1,0,200,1,0,0", "9,0,200,9,0,0", "1,9,200,1,9,0")
    (path / "touched.csv").write_text("\n".join(places))
    (path / "poses.csv").write_text("".join(f"{number},{number},0,0,0,0,{number}\n" for number in range(6)))
    make_fleet(path / "history", 1, 0, cycles=2)
    releases = Releases(path / "fleet")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(path)
        patch.setenv("EDGED_PASSPHRASE", PASSPHRASE)
        releases.make()
        assert 0 == releases.sign("notes", "--file", path / "poses.csv")
        assert 0 == releases.publish()
        (path / "fleet.toml").write_text((path / "cell.toml").read_text() + releases.section())
        assert 0 == exit_code("backup cell.toml -o cell.tar.gz", patch)
    return path


def exit_code(command: str, monkeypatch: pytest.MonkeyPatch) -> int:
    """Exit code of a command, run without line wrapping."""
    monkeypatch.setenv("COLUMNS", "400")
    monkeypatch.setenv("EDGED_PASSPHRASE", PASSPHRASE)
    return commandline.exit_code(*command.split())


@pytest.fixture
def run(cell: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Run a command in the cell's folder; returns its exit code and output lines."""
    monkeypatch.chdir(cell)

    def said(command: str) -> tuple[int, list[str]]:
        code, out = exit_code(command, monkeypatch), capsys.readouterr()
        return code, [line for line in (out.err + out.out).splitlines() if line.strip()]

    return said


def without_rights(folder: Path) -> Path:
    """A folder in which no one, not even root, can create files."""
    if os.geteuid() == 0:
        return Path("/sys/kernel")
    folder.mkdir(mode=0o555)
    return folder


def a_file(folder: Path) -> Path:
    """A file in place of a folder."""
    folder.write_text("")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("where", ["no rights", "a file"])
@pytest.mark.parametrize("output", OUTPUTS, ids=" ".join)
def test_where_nothing_can_be_written_one_line_says_so(
    output: tuple[str, str], where: str, cell: Path, tmp_path: Path, run: Command
) -> None:
    """One line names the path as typed and the reason, and nothing is written."""
    place = (without_rights if where == "no rights" else a_file)(tmp_path / "place")
    before = {path for path in cell.rglob("*") if "__pycache__" not in path.parts}
    code, lines = run(OUTPUTS[output].format(place))

    assert (2, 1) == (code, len(lines)), lines
    assert lines[0].startswith(f"edged: {place}/")
    assert before == {path for path in cell.rglob("*") if "__pycache__" not in path.parts}


@pytest.mark.long
@pytest.mark.parametrize("output", OUTPUTS, ids=" ".join)
def test_a_folder_that_is_not_there_is_made_or_named(
    output: tuple[str, str], tmp_path: Path, run: Command
) -> None:
    """A missing output folder is made; for a file, one line names the missing folder."""
    place = tmp_path / "missing"
    code, lines = run(OUTPUTS[output].format(place))

    if place.exists():
        assert "Traceback" not in "\n".join(lines)
        return
    assert (2, 1) == (code, len(lines)), lines
    assert lines[0].startswith(f"edged: {place}/")
    assert f"there is no folder {place}" in lines[0]
