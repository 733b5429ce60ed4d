"""A configuration with its rig and jobs: the daemon starts with it, or names every reason why not."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from helpers.cells import small_rig

from edged.app.cell import load_cell
from edged.commands.demo import DemoOptions, prepare_cell
from edged.domain.cell import SetupSource
from edged.errors import ConfigError
from edged.files.jobs import job_of
from edged.setup import cellfiles
from edged.setup.cellfiles import UnfinishedCell, read_any_cell, read_cell
from edged.sim.cell import VirtualCell, demo_part
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import Rectification
from edged.vision.part.job import Job


@pytest.fixture(scope="module")
def taught(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a virtual cell whose job was taught twice."""
    folder = tmp_path_factory.mktemp("cell")
    for seed in (1, 2):
        prepare_cell(folder, VirtualCell(small_rig(), demo_part(), seed=seed), DemoOptions(), gige=False)
    return folder


@pytest.fixture
def folder(taught: Path, tmp_path: Path) -> Path:
    """A copy of it to damage."""
    return Path(shutil.copytree(taught, tmp_path / "cell"))


@pytest.mark.slow
def test_a_job_that_was_taught_again_is_one_job(folder: Path) -> None:
    """The older version that is kept beside a job is no second job, and does not change the fingerprint."""
    assert (folder / "jobs" / "flange.old").is_dir()
    cell = read_cell(folder / "cell.toml")
    shutil.rmtree(folder / "jobs" / "flange.old")

    assert [job.name for job in cell.jobs] == ["flange"]
    assert read_cell(folder / "cell.toml").fingerprint == cell.fingerprint


@pytest.mark.slow
def test_rig_and_job_mistakes_are_named_together(folder: Path) -> None:
    """A damaged rig, a damaged shape and a missing job are named in one report."""
    (folder / "rig.json").write_text("{")
    (folder / "jobs" / "flange" / "shape.npz").write_bytes(b"no zip")

    with pytest.raises(ConfigError) as caught:
        read_cell(folder / "cell.toml")

    text = "\n".join(caught.value.problems)
    assert {"rig.json", "shape.npz", "no usable job 'flange'"} <= {
        part for part in ("rig.json", "shape.npz", "no usable job 'flange'") if part in text
    }


@pytest.mark.slow
def test_mistakes_of_all_files_are_named_together(folder: Path) -> None:
    """A misspelt key, the damaged rig and the missing job are named together."""
    config = folder / "cell.toml"
    config.write_text(config.read_text().replace("[cycle]", "[cycle]\nperoid_s = 1"), "utf-8-sig")
    (folder / "rig.json").write_text("{")
    shutil.rmtree(folder / "jobs" / "flange")

    with pytest.raises(ConfigError) as caught:
        read_cell(config)

    text = "\n".join(caught.value.problems)
    assert all(part in text for part in ("peroid_s: unknown key", "rig.json", "no usable job 'flange'"))


@pytest.mark.slow
def test_two_jobs_with_one_number_are_refused(folder: Path) -> None:
    """Two jobs with one number are refused."""
    shutil.copytree(folder / "jobs" / "flange", folder / "jobs" / "twin")

    with pytest.raises(
        ConfigError, match=r"twin and flange both have the number 1: change `number` in the job.toml"
    ):
        read_cell(folder / "cell.toml")


@pytest.mark.slow
def test_the_fingerprint_follows_the_rig_and_the_jobs(folder: Path) -> None:
    """An edited limit or another calibration changes the fingerprint."""
    before = read_cell(folder / "cell.toml").fingerprint
    job = folder / "jobs" / "flange" / "job.toml"
    job.write_text(job.read_text().replace("max_sigma_mm = 0.2", "max_sigma_mm = 0.1"))

    assert read_cell(folder / "cell.toml").fingerprint != before


@pytest.mark.slow
@pytest.mark.parametrize(
    "gone, lacks, named",
    [
        (["rig.json"], SetupSource.NO_CALIBRATION, ["cell.rig"]),
        (["jobs"], SetupSource.NO_JOB, ["cell.jobs"]),
        (["jobs/flange", "jobs/flange.old"], SetupSource.NO_JOB, ["cell.job"]),
        (["jobs/flange"], SetupSource.NO_JOB, ["cell.job"]),
        (["rig.json", "jobs"], SetupSource.NO_CALIBRATION, ["cell.rig", "cell.jobs"]),
    ],
)
def test_a_cell_without_rig_or_jobs_is_not_finished(
    folder: Path, gone: list[str], lacks: SetupSource, named: list[str]
) -> None:
    """An unfinished cell names first what it lacks, and lists the missing files as a check does."""
    for name in gone:
        path = folder / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()

    cell = read_any_cell(folder / "cell.toml")
    with pytest.raises(ConfigError) as caught:
        read_cell(folder / "cell.toml")

    assert isinstance(cell, UnfinishedCell)
    assert (lacks, caught.value.problems) == (cell.lacks, [*cell.missing])
    assert set(named) == {line.partition(":")[0] for line in cell.missing}
    assert "rig.json" not in cell.contents or "rig.json" not in gone


@pytest.mark.slow
def test_without_a_word_the_job_with_the_lowest_number_is_the_first(folder: Path) -> None:
    """If no job is named, the one with the lowest number is active; a cell without jobs is unfinished."""
    config = folder / "cell.toml"
    config.write_text(config.read_text().replace('job = "flange"', ""))
    shutil.copytree(folder / "jobs" / "flange", folder / "jobs" / "a_lid")
    text = (folder / "jobs" / "a_lid" / "job.toml").read_text().replace('name = "flange"', 'name = "lid"')
    (folder / "jobs" / "a_lid" / "job.toml").write_text(text.replace("number = 1", "number = 5"))
    assert (1, 2) == (load_cell(config).setup.active_job, len(read_cell(config).jobs))
    for job in ("flange", "flange.old", "a_lid"):
        shutil.rmtree(folder / "jobs" / job)
    cell = read_any_cell(config)
    assert isinstance(cell, UnfinishedCell)
    assert (SetupSource.NO_JOB, f"cell.jobs: {folder / 'jobs'}: holds no job") == (
        cell.lacks,
        cell.missing[0],
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "spoil",
    [
        lambda folder: (folder / "rig.json").write_text("{"),
        lambda folder: (folder / "jobs" / "flange" / "shape.npz").write_bytes(b"no zip"),
        lambda folder: (folder / "jobs" / "flange").rename(folder / "jobs" / "lid"),
        lambda folder: (shutil.rmtree(folder / "jobs"), (folder / "jobs").write_text("a file")),
        lambda folder: ((folder / "rig.json").unlink(), (folder / "jobs" / "flange" / "shape.npz").unlink()),
        lambda folder: (
            (folder / "rig.json").unlink(),
            (folder / "cell.toml").write_text(
                (folder / "cell.toml").read_text() + '\n[web]\ncertificate = "none.pem"\nkey = "none.pem"\n'
            ),
        ),
        lambda folder: (
            (folder / "rig.json").unlink(),
            (folder / "cell.toml").write_text(
                (folder / "cell.toml").read_text().replace("[cycle]", "[cycle]\nperoid_s = 1")
            ),
        ),
    ],
    ids=["rig", "shape", "other job", "jobs is a file", "half a job", "certificate", "key"],
)
def test_any_other_mistake_is_one_in_a_cell_that_is_not_finished_too(folder: Path, spoil: Callable) -> None:
    """A damaged file is named as a problem in an unfinished cell, too, and the daemon does not start."""
    spoil(folder)
    if (folder / "jobs" / "lid").is_dir():
        text = (folder / "jobs" / "lid" / "job.toml").read_text()
        (folder / "jobs" / "lid" / "job.toml").write_text(text.replace('name = "flange"', 'name = "lid"'))

    with pytest.raises(ConfigError) as caught:
        read_any_cell(folder / "cell.toml")

    with pytest.raises(ConfigError) as strict:
        read_cell(folder / "cell.toml")
    assert strict.value.problems == caught.value.problems


@pytest.mark.slow
def test_files_of_the_machine_are_missed_before_the_start(folder: Path) -> None:
    """Missing certificates, keys and Zenoh's file are named by their keys, except if the cell runs
    elsewhere."""
    config = folder / "cell.toml"
    text = config.read_text().replace("[zenoh]", '[zenoh]\nconfig_file = "z.json5"')
    text += '\n[modbus.tls]\ncertificate = "c.pem"\nkey = "k.pem"\nauthority = "a.pem"\n'
    config.write_text(text + '\n[web]\ncertificate = "c.pem"\nkey = "k.pem"\n')
    (folder / "c.pem").write_text("")

    with pytest.raises(ConfigError) as caught:
        read_cell(config)

    places = [problem.partition(":")[0] for problem in caught.value.problems]
    assert ["modbus.tls.key", "modbus.tls.authority", "web.key", "zenoh.config_file"] == places
    assert read_cell(config, elsewhere=True).config.cell.name == "demo"


LAN, TLS = "tcp/0.0.0.0:7447", "tls/0.0.0.0:7447"
MTLS = {"transport": {"link": {"tls": {"enable_mtls": True}}}}
DENY = {"enabled": True, "default_permission": "deny", "rules": [], "subjects": [], "policies": []}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("own", "section", "expected"),
    [
        ({}, "", ""),
        ({}, f'listen = ["{LAN}"]', f"zenoh: listen: over {LAN} "),
        ({}, f'connect = ["{LAN}"]', f"zenoh: connect: over {LAN} "),
        ({}, f'listen = ["{LAN}"]\ncommands = "refused"', ""),
        ({}, f'listen = ["{LAN}"]\ncommands = "anyone"', ""),
        ({"listen": {"endpoints": [LAN]}}, "", f"zenoh: listen: over {LAN} "),
        ({"mode": "peer", "listen": {"endpoints": {"peer": [LAN]}}}, "", f"zenoh: listen: over {LAN} "),
        ({"listen": {"endpoints": ["tcp/127.0.0.1:7447"]}}, f'listen = ["{LAN}"]', ""),
        (MTLS, f'listen = ["{TLS}"]\nconnect = ["quic/fleet.example:7447"]', ""),
        (MTLS, f'listen = ["{TLS}", "{LAN}"]', f"zenoh: listen: over {LAN} "),
        ({"transport": {"link": {"tls": {}}}}, f'listen = ["{TLS}"]', f"zenoh: listen: over {TLS} "),
        ({"access_control": DENY}, f'listen = ["{LAN}"]', ""),
        ({"access_control": {**DENY, "enabled": False}}, f'listen = ["{LAN}"]', "zenoh: listen: "),
        (
            {"access_control": {**DENY, "default_permission": "allow"}},
            f'listen = ["{LAN}"]',
            "zenoh: listen: ",
        ),
        ({"scouting": {"multicast": {"enabled": True}}}, "", "zenoh: connect: over scouting/multicast "),
        ({"lisen": 3}, "", "zenoh.config_file: "),
    ],
)
def test_zenohs_own_file_guards_commands_or_the_cell_does_not_start(
    own: dict[str, object], section: str, expected: str, folder: Path
) -> None:
    """Zenoh's own file must have certificates on both sides, or access control that denies by default, for
    every endpoint that others reach."""
    (folder / "zenoh.json5").write_text(json.dumps(own))
    config = folder / "cell.toml"
    head, _, tail = config.read_text().partition("[zenoh]\n")
    rest = tail.partition("\n\n")[2]
    config.write_text(f'{head}[zenoh]\nconfig_file = "zenoh.json5"\n{section}\n\n{rest}')

    if not expected:
        assert read_cell(config).config.zenoh.config_file == folder / "zenoh.json5"
        return
    with pytest.raises(ConfigError) as caught:
        read_cell(config)
    (problem,) = caught.value.problems
    assert problem.startswith(expected)
    assert "zenoh.json5" in problem


@pytest.mark.slow
@pytest.mark.parametrize("name", ["zenoh-acl-example.json5", "zenoh-router-example.json5"])
def test_the_example_files_guard_commands(name: str, folder: Path) -> None:
    """The example files of config/ guard commands."""
    config, examples = folder / "cell.toml", Path(__file__).parents[2] / "config"
    shutil.copy(examples / name, folder)
    config.write_text(config.read_text().replace("[zenoh]", f'[zenoh]\nconfig_file = "{name}"'))

    assert read_cell(config).config.zenoh.commands == "guarded"


@pytest.mark.slow
def test_what_is_recorded_is_what_is_measured_by(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files that are replaced after they were read do not change what the cell uses and records."""
    before = read_cell(folder / "cell.toml")
    calibrated, taught = (folder / "rig.json").read_bytes(), folder / "jobs" / "flange"
    real = cellfiles.make_rectification

    def replaced(rig: StereoRig) -> Rectification:
        (folder / "rig.json").write_bytes(calibrated.replace(rig.calibration_id.encode(), b"another"))
        (folder / "cell.toml").write_text((folder / "cell.toml").read_text() + "# another\n")
        return real(rig)

    def replaced_job(files: Mapping[str, bytes], entry: Path) -> Job:
        (taught / "job.toml").write_text((taught / "job.toml").read_text().replace("0.2", "0.1"))
        return job_of(files, entry)

    monkeypatch.setattr(cellfiles, "make_rectification", replaced)
    monkeypatch.setattr(cellfiles, "job_of", replaced_job)
    cell = read_cell(folder / "cell.toml")

    assert before.rig.calibration_id == cell.rig.calibration_id
    assert (before.fingerprint, before.contents) == (cell.fingerprint, cell.contents)
