"""`teach`, `locate` and `check` on the command line: exit codes, messages, and no unwanted overwriting."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import typer
from helpers.cells import flange, frame_pair, small_rig
from helpers.commandline import exit_code
from rich.text import Text

from edged import __version__
from edged.cli.main import app
from edged.commands.demo import DemoOptions, prepare_cell
from edged.commands.exchanged import SWAPPED
from edged.doctor.examination import examine
from edged.domain.arrays import Image
from edged.domain.measurement import Status
from edged.files.jobs import load_job
from edged.pipeline import PreparedRig, locate, prepare
from edged.robot.orientations import zyx
from edged.sim.cell import VirtualCell, demo_part
from edged.sim.views import stereo_views
from edged.vision.part.job import Job

Edged = Callable[..., tuple[int, str, str]]
POSES = 5


@pytest.fixture
def edged(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Edged:
    """Call `edged ARGUMENTS`; returns exit code, stdout and stderr, unwrapped."""
    monkeypatch.setenv("COLUMNS", "400")

    def call(*arguments: object) -> tuple[int, str, str]:
        code, (out, err) = exit_code(*arguments), capsys.readouterr()
        assert "Traceback" not in err
        return code, out, err

    return call


@pytest.fixture(scope="module")
def cell() -> VirtualCell:
    """The demo's cell at half its resolution."""
    return VirtualCell(small_rig(), demo_part(), seed=11)


@pytest.fixture(scope="module")
def pristine(cell: VirtualCell, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cell's folder with configuration, rig, job and a few pictures."""
    folder = tmp_path_factory.mktemp("cell")
    prepare_cell(folder, cell, DemoOptions(), gige=False)
    part = flange()
    for side, image in (("left", part.left), ("right", part.right)):
        cv2.imwrite(str(folder / f"{side}.png"), image)
    cv2.imwrite(str(folder / "blank.png"), np.full_like(part.left, 50))
    cv2.imwrite(str(folder / "small.png"), np.ascontiguousarray(part.left[:240, :320]))
    (folder / "text.png").write_text("no image")
    (folder / "empty.png").touch()
    return folder


@pytest.fixture
def folder(pristine: Path, tmp_path: Path) -> Path:
    """A copy that a test may spoil."""
    return Path(shutil.copytree(pristine, tmp_path / "cell"))


def pair_of(cell: VirtualCell, number: int) -> tuple[Image, Image]:
    """Pictures of one random pose."""
    views, world = stereo_views(cell.rig), cell.scene(cell.pose(number))
    left, right = (views[s].render(world, np.random.default_rng((number, len(s)))) for s in ("left", "right"))
    return left, right


# --- the pipeline ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def taught(pristine: Path, cell: VirtualCell) -> tuple[PreparedRig, Job]:
    """The rig and the job as the daemon has them."""
    return prepare(cell.rig), load_job(pristine / "jobs" / "flange")


@pytest.mark.slow
@pytest.mark.parametrize("number", range(POSES))
def test_the_part_is_located_anywhere(
    cell: VirtualCell, taught: tuple[PreparedRig, Job], number: int
) -> None:
    """At random poses the position is right to 0.02 mm and within 5 sigma, the rotation is right, and a
    repetition is bit-identical."""
    rig, job = taught
    where, pair = cell.pose(number), frame_pair(*pair_of(cell, number))
    outcome = locate(pair, job, rig)
    assert outcome.status is Status.OK
    target = outcome.targets[0]
    error = target.position_mm - where[:3, 3]
    assert np.abs(error).max() < 0.02
    assert (np.abs(error) < 5 * target.sigma_mm).all()
    assert np.trace(target.rig_from_part[:3, :3].T @ where[:3, :3]) > 1 + 2 * np.cos(np.radians(0.1))
    again = locate(pair, job, rig)
    assert np.array_equal(again.targets[0].rig_from_part, target.rig_from_part)
    assert np.array_equal(again.targets[0].covariance, target.covariance)
    assert again.targets[0].match == target.match


@pytest.mark.slow
def test_images_that_cannot_be_one_pair_are_no_result(
    cell: VirtualCell, taught: tuple[PreparedRig, Job]
) -> None:
    """The same image twice, swapped images, and a blank or black one never give OK."""
    rig, job = taught
    for number in range(2):
        left, right = pair_of(cell, number)
        blank, black = np.full_like(left, 60), np.zeros_like(left)
        for pair in ((left, left), (right, right), (right, left), (left, blank), (black, right)):
            assert locate(frame_pair(*pair), job, rig).status is not Status.OK


# --- locate ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_locate_prints_one_json_object(edged: Edged, pristine: Path) -> None:
    """The exit code is 0 and stdout holds one object with the manual's fields and the taught place."""
    arguments = ("--rig", pristine / "rig.json", "--job", pristine / "jobs" / "flange")
    code, out, err = edged("locate", *arguments, "--json", pristine / "left.png", pristine / "right.png")
    document = json.loads(out)
    assert (code, err, document["status"]) == (0, "", "OK")
    target = document["targets"][0]
    np.testing.assert_allclose(target["position_mm"], flange().rig_from_part[:3, 3], atol=0.02)
    assert len(target["circles"]) == 7
    assert set(document["timing_ms"]) == {"rectify", "find", "measure"}


@pytest.mark.slow
def test_locate_shows_a_table_and_writes_a_picture(edged: Edged, folder: Path) -> None:
    """The table lists every circle, and the picture shows both images side by side."""
    picture = folder / "overlay.png"
    arguments = ("--rig", folder / "rig.json", "--job", folder / "jobs" / "flange", "--overlay", picture)
    code, out, _ = edged("locate", *arguments, folder / "left.png", folder / "right.png")
    assert code == 0
    assert "status OK" in out
    assert all(f"c{k}" in out for k in range(7))
    height, width, _ = cv2.imread(str(picture)).shape
    assert width == 2560
    assert height > 960


@pytest.mark.slow
def test_locate_says_what_the_plc_would_read(edged: Edged, pristine: Path) -> None:
    """Position and A, B, C are in the robot's frame as in --json, and each table names its frame."""
    files = ("--rig", pristine / "rig.json", "--job", pristine / "jobs" / "flange")
    pair = (pristine / "left.png", pristine / "right.png")
    _, out, _ = edged("locate", *files, "--convention", "kuka_abc", *pair)
    _, document, _ = edged("locate", *files, "--json", *pair)
    pose = json.loads(document)["targets"][0]["pose_robot"]
    expected = [f"{value:.3f}" for value in (*pose["position_mm"], *zyx(np.array(pose["rotation"])))]

    assert "in the rig's frame" in out
    _, _, read = out.partition("as the PLC reads it: in the robot's frame, A, B, C kuka_abc")
    assert expected == [re.search(rf"│ {axis} │ +([-\d.]+)", read)[1] for axis in "XYZABC"]


@pytest.mark.slow
def test_locate_writes_points_as_file_and_picture(edged: Edged, folder: Path) -> None:
    """--ply and --cloud write a PLY with the right length and a picture; without a part they are empty."""
    arguments = ("--rig", folder / "rig.json", "--job", folder / "jobs" / "flange")
    ply, picture = folder / "points.ply", folder / "cloud.png"
    for stem, expected in (("left", 0), ("right", 1)):
        images = (folder / f"{stem}.png", folder / "right.png")
        code, _, _ = edged("locate", *arguments, "--ply", ply, "--cloud", picture, *images)
        assert code == expected
        header, _, body = ply.read_bytes().partition(b"end_header\n")
        count = int(header.decode().split("element vertex ")[1].split()[0])
        assert len(body) == 19 * count
        assert (count > 1000) == (expected == 0)
        assert cv2.imread(str(picture)).shape == (720, 1440, 3)


@pytest.mark.slow
def test_locate_says_no(edged: Edged, pristine: Path) -> None:
    """If there is no part, the exit code is 1 with NO_TARGET."""
    arguments = ("--rig", pristine / "rig.json", "--job", pristine / "jobs" / "flange", "--json")
    code, out, _ = edged("locate", *arguments, pristine / "blank.png", pristine / "blank.png")
    assert (code, json.loads(out)["status"], json.loads(out)["targets"]) == (1, "NO_TARGET", [])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"left": "small.png"}, "left image: 320x240, the rig was calibrated for 640x480"),
        ({"right": "small.png"}, "right image: 320x240"),
        ({"left": "text.png"}, r"text\.png: not an image"),
        ({"right": "empty.png"}, r"empty\.png: an empty file"),
        ({"left": "nowhere.png"}, r"nowhere\.png: no such file"),
        ({"left": "jobs"}, "jobs: is a folder"),
        ({"job": "jobs/nowhere"}, "nowhere: no such job folder"),
        ({"job": "left.png"}, "no such job folder"),
        ({"job": "jobs"}, r"job\.toml: cannot read"),
        ({"rig": "nowhere.json"}, r"nowhere\.json: cannot read"),
        ({"rig": "left.png"}, r"left\.png"),
        ({"rig": "jobs/flange/job.toml"}, r"job\.toml"),
        ({"overlay": "nowhere/picture.png"}, r"nowhere/picture\.png: there is no folder"),
    ],
)
def test_locate_refuses_what_it_cannot_use(
    edged: Edged, folder: Path, changed: dict[str, str], expected: str
) -> None:
    """The exit code is 2, stdout is empty, and stderr has one line naming the file and what was expected."""
    names = {"rig": "rig.json", "job": "jobs/flange", "left": "left.png", "right": "right.png"} | changed
    path = {key: folder / name for key, name in names.items()}
    extra = ("--overlay", path["overlay"]) if "overlay" in path else ()
    code, out, err = edged(
        "locate", "--rig", path["rig"], "--job", path["job"], "--json", *extra, path["left"], path["right"]
    )
    assert (code, out) == (2, "")
    assert re.search(expected, err)
    assert err.startswith("edged: ")


@pytest.mark.slow
def test_every_command_has_help_under_both_names(edged: Edged) -> None:
    """-h and --help are the same, also for subcommands."""
    for command in ((), ("teach",), ("calibrate",), ("register",), ("register", "touch"), ("rig", "convert")):
        short, long = (edged(*command, name) for name in ("-h", "--help"))
        assert (0, long[1]) == short[:2]


def test_help_is_shown_as_it_is_written() -> None:
    """No part of it is taken for markup, as a word in square brackets would be."""

    def helps(command: Any) -> Iterator[str]:
        yield command.help or ""
        yield from (parameter.help or "" for parameter in command.params)
        for one in getattr(command, "commands", {}).values():
            yield from helps(one)

    written = list(helps(typer.main.get_command(app)))
    assert written == [Text.from_markup(text).plain for text in written]


def test_missing_arguments_are_wrong_usage(edged: Edged) -> None:
    """The exit code is 2."""
    assert edged("locate")[0] == 2
    assert edged("teach", "--rig", "x")[0] == 2
    assert edged("nonsense")[0] == 2


# --- teach ----------------------------------------------------------------------------------------


def teach_arguments(folder: Path, **changed: object) -> list[object]:
    """Arguments of a successful teaching, with some of them changed."""
    r = flange().region
    values: dict[str, object] = {
        "rig": folder / "rig.json",
        "left": folder / "left.png",
        "right": folder / "right.png",
        "roi": f"{r.x},{r.y},{r.width},{r.height}",
        "name": "flange",
        "output": folder / "jobs" / "flange",
    } | changed
    return ["teach", *(item for key, value in values.items() for item in (f"--{key}", value))]


@pytest.mark.long
def test_swapped_pictures_are_told_as_such(edged: Edged, folder: Path) -> None:
    """Each command that takes a pair reports swapped pictures, but not empty ones."""
    rig, job = ("--rig", folder / "rig.json"), ("--job", folder / "jobs" / "flange")
    exchanged = folder / "right.png", folder / "left.png"
    blank = folder / "blank.png", folder / "blank.png"
    assert (1, True) == told_swapped(edged("locate", *rig, *job, *exchanged))
    _, out, err = edged("locate", *rig, *job, "--json", *exchanged)
    assert ("NO_TARGET", True) == (json.loads(out)["status"], SWAPPED in err)
    assert (1, False) == told_swapped(edged("locate", *rig, *job, *blank))
    assert (1, True) == told_swapped(edged("verify", *rig, *job, "--length", "c0=28", *exchanged))
    sides = {
        "left": exchanged[0],
        "right": exchanged[1],
        "output": folder / "jobs" / "other",
        "name": "other",
    }
    arguments = teach_arguments(folder, **sides)
    region = arguments.index("--roi")
    assert (2, True) == told_swapped(edged(*arguments[:region], *arguments[region + 2 :]))
    rig_file = folder / "rig.json"
    rig_file.write_text(rig_file.read_text().replace('"robot_from_rig": null', f'"robot_from_rig": {UNIT}'))
    touched = ("--pose", "1,2,3,0,0,0", "--brand", "kuka", "--name", "jaw")
    assert (1, True) == told_swapped(edged("grasp", "touch", *rig, *job, *touched, *exchanged))


UNIT = np.eye(4).tolist()


def told_swapped(answer: tuple[int, str, str]) -> tuple[int, bool]:
    """Exit code, and whether swapped pictures were reported."""
    code, out, err = answer
    return code, SWAPPED in f"{out}{err}"


@pytest.mark.slow
def test_teach_writes_a_job_and_says_what_it_learnt(edged: Edged, folder: Path) -> None:
    """The exit code is 0, every circle is listed, the job loads, and the former one is kept."""
    before = (folder / "jobs" / "flange" / "job.toml").read_bytes()
    code, out, err = edged(*teach_arguments(folder, number=4))
    assert (code, out) == (0, "")
    for number, (kind, radius_mm) in enumerate((("disc", 14.0), ("hole", 4.0), ("hole", 1.6))):
        found = re.search(rf"c{number}: {kind} of radius ([0-9.]+) mm", err)
        assert found is not None
        assert abs(float(found[1]) - radius_mm) < 0.01
    assert load_job(folder / "jobs" / "flange").number == 4
    assert "the job that was there is" in err
    assert (folder / "jobs" / "flange.old" / "job.toml").read_bytes() == before


@pytest.mark.slow
def test_numbers_of_jobs_do_not_collide(edged: Edged, folder: Path) -> None:
    """A second job gets the next number, and a used number is refused with a free one suggested."""
    second = folder / "jobs" / "second"
    code, _, err = edged(*teach_arguments(folder, output=second, name="second", number=1))
    assert code == 2
    assert "flange; 2 is free" in " ".join(err.split())
    assert edged(*teach_arguments(folder, output=second, name="second"))[0] == 0
    assert load_job(second).number == 2


@pytest.mark.slow
def test_an_edited_tolerance_survives_teaching_again(edged: Edged, folder: Path) -> None:
    """A limit edited in the job is kept in the new one and reported."""
    path = folder / "jobs" / "flange" / "job.toml"
    path.write_text(path.read_text().replace("max_sigma_mm = 0.2", "max_sigma_mm = 0.04"))
    code, _, err = edged(*teach_arguments(folder))

    assert code == 0
    assert "kept: limits.max_sigma_mm = 0.04 (teaching would set 0.2)" in " ".join(err.split())
    assert load_job(folder / "jobs" / "flange").limits.max_sigma_mm == 0.04


@pytest.mark.slow
def test_a_region_that_cuts_the_part_is_a_warning(edged: Edged, folder: Path) -> None:
    """The warning is on the terminal, in JSON and in the report with the region, and the job is written."""
    r = flange().region
    narrow, report = f"{r.x},{r.y},{0.8 * r.width},{r.height}", folder / "report.html"
    code, out, err = edged(*teach_arguments(folder, roi=narrow, report=report), "--json")

    assert code == 0
    assert "Warning: The region cuts c0, a disc of radius 14.0" in " ".join(err.split())
    assert json.loads(out)["warnings"][0].startswith("The region cuts c0")
    page = report.read_text()
    assert str(folder) not in page
    for told in ("rig.json, demo", "left.png, right.png", f"edged {__version__}", " UTC, "):
        assert told in page
    assert "The region cuts c0" in page
    assert "what is cut red" in page


@pytest.mark.long
def test_teach_says_what_a_tilt_takes(edged: Edged, folder: Path) -> None:
    """--tilt is stored in the job, and the number of views and the resulting depth are reported."""
    code, out, err = edged(*teach_arguments(folder, tilt=45))
    assert (code, out) == (0, "")
    found = re.search(r"tilted by up to 45°: looked for in (\d+) views; it spans ([0-9.]+) mm", err)
    assert found is not None
    assert 10 < int(found[1]) < 50
    assert abs(float(found[2]) - 28 * math.sin(math.pi / 4)) < 0.3
    assert "leaves the" not in err
    assert load_job(folder / "jobs" / "flange").tilt_rad == pytest.approx(math.pi / 4)
    code, _, err = edged(*teach_arguments(folder))
    assert code == 0
    assert "kept: search.tilt_deg = 45" in err
    edged(*teach_arguments(folder, tilt=30))
    assert load_job(folder / "jobs" / "flange").tilt_rad == pytest.approx(math.pi / 6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"roi": "1,2,3"}, "--region '1,2,3': expected X,Y,W,H"),
        ({"roi": "a,b,c,d"}, "expected X,Y,W,H"),
        ({"roi": "nan,0,100,100"}, "expected X,Y,W,H"),
        ({"roi": "5000,0,100,100"}, "outside the 640x480 image"),
        ({"roi": "100,100,4,4"}, "at least 16 px"),
        ({"roi": "5,5,60,60"}, "no circle"),
        ({"name": "../evil"}, "name '../evil': expected"),
        ({"name": ""}, "name '': expected"),
        ({"name": "ü"}, "name 'ü': expected"),
        ({"number": 0}, "--number"),
        ({"tilt": 0}, "tilt 0: expected more than 0 and at most 45"),
        ({"tilt": 60}, "tilt 60: expected"),
        ({"tilt": "nan"}, "tilt nan: expected"),
        ({"tilt": -30}, "tilt -30: expected"),
        ({"tilt": "steep"}, "--tilt"),
        ({"left": "small.png"}, "left image: 320x240"),
        ({"right": "blank.png"}, "none of them in the right one"),
        ({"left": "nowhere.png"}, "no such file"),
        ({"rig": "nowhere.json"}, r"nowhere\.json: cannot read"),
    ],
)
def test_a_teaching_that_fails_changes_nothing(
    edged: Edged, folder: Path, changed: dict[str, object], expected: str
) -> None:
    """The exit code is 2, the option or file is named, and the existing job is unchanged."""
    files = {
        key: folder / str(value) if key in ("left", "right", "rig") else value
        for key, value in changed.items()
    }
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    code, out, err = edged(*teach_arguments(folder, **files))
    assert (code, out) == (2, "")
    assert re.search(expected, err)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


@pytest.mark.slow
def test_teach_does_not_write_over_something_else(edged: Edged, folder: Path) -> None:
    """An output that is a file or a folder of pictures is refused and unchanged."""
    (folder / "photos").mkdir()
    (folder / "photos" / "cat.png").write_bytes(b"meow")
    for output in (folder / "photos", folder / "left.png", folder / "left.png" / "job"):
        before = (folder / "left.png").read_bytes()
        code, _, err = edged(*teach_arguments(folder, output=output))
        assert code == 2
        assert str(output) in err
        assert (folder / "left.png").read_bytes() == before
    assert [path.name for path in (folder / "photos").iterdir()] == ["cat.png"]


# --- check ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_check_says_good(edged: Edged, pristine: Path) -> None:
    """The exit code is 0 with rig, jobs and cameras named, also in JSON."""
    code, out, _ = edged("check", pristine / "cell.toml")
    assert code == 0
    assert "good" in out
    assert "1 flange" in out
    code, out, err = edged("check", pristine / "cell.toml", "--json")
    document = json.loads(out)
    assert (code, err, document["ok"], document["problems"]) == (0, "", True, [])
    assert document["jobs"] == [{"number": 1, "name": "flange"}]


def rig_of_another_scale(rig: dict[str, Any]) -> None:
    """Make it ten times too large, as with a board of a tenth of its stated size."""
    for row in rig["right_from_left"][:3]:
        row[3] *= 10.0


def rig_to_repeat(rig: dict[str, Any]) -> None:
    """Give it the verdict of only three views."""
    rig["quality"] = {"verdict": {"grade": "repeat", "why": ["3 views\x1b", "2"], "add": ""}}


def rig_of_something_else(rig: dict[str, Any]) -> None:
    """Give it an unknown content under `quality`."""
    rig["quality"] = {"verdict": ["repeat"]}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (rig_of_another_scale, "rig.json: its cameras stand 1100 mm apart: measure it"),
        (
            rig_to_repeat,
            "rig.json: the calibration's verdict was repeat: 3 views\N{REPLACEMENT CHARACTER}; 2",
        ),
        (rig_of_something_else, None),
    ],
)
def test_check_says_what_to_look_at(
    edged: Edged, folder: Path, spoil: Callable[[dict[str, Any]], None], told: str | None
) -> None:
    """A doubtful rig is a warning instead of "good", also in JSON and in the doctor."""
    path = folder / "rig.json"
    rig = json.loads(path.read_text())
    spoil(rig)
    path.write_text(json.dumps(rig))
    code, out, _ = edged("check", folder / "cell.toml")
    document = json.loads(edged("check", folder / "cell.toml", "--json")[1])

    assert 0 == code
    assert (told is None) == (": good\n" in out)
    assert (told or "good") in out
    assert bool(told) == any(warning.startswith(told or "") for warning in document["warnings"])
    found = [check for check in examine(folder / "cell.toml", trigger=False) if check.name == "calibration"]
    assert bool(told) == any(told in check.finding for check in found if told)


@pytest.mark.slow
def test_two_jobs_of_one_name_are_a_mistake(edged: Edged, folder: Path) -> None:
    """Two jobs of the same name are refused."""
    shutil.copytree(folder / "jobs" / "flange", folder / "jobs" / "other")
    text = (folder / "jobs" / "other" / "job.toml").read_text()
    (folder / "jobs" / "other" / "job.toml").write_text(text.replace("number = 1", "number = 2"))
    code, _, err = edged("check", folder / "cell.toml")

    assert 2 == code
    assert "other and flange both have the name 'flange': change `name`" in err


@pytest.mark.slow
def test_check_names_every_mistake_at_once(edged: Edged, folder: Path) -> None:
    """A missing rig, a damaged job and an unknown active job are all reported, with exit code 2."""
    text = (folder / "cell.toml").read_text()
    text = text.replace('"rig.json"', '"nowhere.json"').replace('job = "flange"', 'job = "bracket"')
    (folder / "cell.toml").write_text(text)
    job = folder / "jobs" / "flange" / "job.toml"
    job.write_text(re.sub(r"(?m)^min_score = .*$", "min_score = 9", job.read_text()))
    code, out, err = edged("check", folder / "cell.toml")
    assert (code, out) == (2, "")
    for expected in ("cell.rig", r"nowhere\.json", "cell.job", "bracket", r"search\.min_score"):
        assert re.search(expected, err)
    code, out, err = edged("check", folder / "cell.toml", "--json")
    assert (code, err) == (2, "")
    assert len(json.loads(out)["problems"]) == 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("content", "expected"),
    [("[cell", "TOML"), ("", "cell"), ("[cell]\nnmae = 'x'\n", "nmae"), (None, "cannot")],
)
def test_check_of_an_unusable_file(edged: Edged, folder: Path, content: str | None, expected: str) -> None:
    """Invalid TOML, an empty or missing file, and an unknown key give exit code 2 and the file's name."""
    path = folder / "other.toml"
    if content is not None:
        path.write_text(content)
    code, _, err = edged("check", path)
    assert code == 2
    assert "other.toml" in err
    assert expected in err
