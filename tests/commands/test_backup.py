"""Backups: a restored cell is the same, and no archive can write elsewhere or anything unexpected."""

from __future__ import annotations

import gzip
import io
import re
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.cells import small_rig
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from typer.testing import CliRunner

from edged.cli.main import app
from edged.commands.backup import backup, restore
from edged.commands.demo import DemoOptions, prepare_cell
from edged.config.reading import load
from edged.errors import ConfigError, FileFormatError, UserError
from edged.identity.passwords import hash_password
from edged.setup.cellfiles import read_cell
from edged.setup.releases import archive as module
from edged.setup.releases.archive import Backup, pack, unpack
from edged.sim.cell import VirtualCell, demo_part

QUIET = Console(quiet=True)
Archive = tuple[Path, bytes]


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Configuration file of a cell with rig and job."""
    folder = tmp_path_factory.mktemp("cell")
    return prepare_cell(folder, VirtualCell(small_rig(), demo_part()), DemoOptions(), gige=False)


@pytest.fixture(scope="module")
def archive(cell: Path, tmp_path_factory: pytest.TempPathFactory) -> Archive:
    """A backup of the cell: the file, and its bytes."""
    file = tmp_path_factory.mktemp("backup") / "cell.tar.gz"
    assert 0 == backup(cell, file, QUIET)
    return file, file.read_bytes()


def contents(folder: Path) -> dict[str, bytes]:
    """Content of every file below a folder."""
    return {
        file.relative_to(folder).as_posix(): file.read_bytes() for file in folder.rglob("*") if file.is_file()
    }


@pytest.mark.slow
def test_a_restored_cell_is_the_same_cell(cell: Path, archive: Archive, tmp_path: Path) -> None:
    """Every file and the fingerprint are identical in another folder."""
    assert 0 == restore(archive[0], tmp_path / "new" / "cell", QUIET)

    restored = contents(tmp_path / "new" / "cell")
    assert restored.pop("registers.csv").startswith(b"address,")
    assert contents(cell.parent) == restored
    again = read_cell(tmp_path / "new" / "cell" / "cell.toml").fingerprint
    assert read_cell(cell).fingerprint == again
    assert ["cell"] == [entry.name for entry in (tmp_path / "new").iterdir()]


@pytest.mark.slow
def test_a_pair_that_a_job_was_taught_from_is_in_it_where_there_is_room(
    cell: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pictures of jobs are included if there is space; otherwise they are left out, which is reported."""
    folder = Path(shutil.copytree(cell.parent, tmp_path / "cell"))
    (folder / "jobs" / "flange" / "taught").mkdir()
    picture = folder / "jobs" / "flange" / "taught" / "left.png"
    picture.write_bytes(bytes(300_000))
    whole = module.make(folder / "cell.toml").backup
    assert picture.read_bytes() == whole.files["jobs/flange/taught/left.png"]
    size = sum(map(len, whole.files.values()))
    monkeypatch.setattr(module, "MAX_BYTES", 2 * (size - 100_000))
    part = module.make(folder / "cell.toml").backup
    assert {"jobs/flange/taught/left.png"} == whole.files.keys() - part.files.keys()
    assert "1 pictures that jobs were taught from" in part.left_out["cell.jobs"]
    assert whole.fingerprint == part.fingerprint


@pytest.mark.slow
def test_files_from_elsewhere_move_beside_the_configuration(cell: Path, tmp_path: Path) -> None:
    """External files are stored beside the configuration, whose paths are adapted; keys are not included."""
    here = tmp_path / "etc"
    here.mkdir()
    (here / "tls.key").write_text("secret")
    (tmp_path / "fleet.json5").write_text("{}")
    text = cell.read_text().replace(
        'rig = "rig.json"', f"rig = '{cell.parent / 'rig.json'}'   # of the left table"
    )
    text = text.replace('jobs = "jobs"', f'jobs = "{cell.parent}/jobs"')
    text = text.replace("[zenoh]", f'[zenoh]\nconfig_file = "{tmp_path}/fleet.json5"')
    (here / "left.toml").write_text(text + '\n[web]\ncertificate = "tls.pem"\nkey = "tls.key"\n')

    assert 0 == backup(here / "left.toml", tmp_path / "a.tar.gz", QUIET)
    assert 1 == restore(tmp_path / "a.tar.gz", tmp_path / "new", QUIET), "it cannot start without its key"

    config = load(tmp_path / "new" / "left.toml")
    places = (config.cell.rig, config.cell.jobs, config.zenoh.config_file)
    assert tuple(tmp_path / "new" / name for name in ("rig.json", "jobs", "fleet.json5")) == places
    assert 'rig = "rig.json"   # of the left table' in (tmp_path / "new" / "left.toml").read_text()
    taken = unpack((tmp_path / "a.tar.gz").read_bytes(), "there")
    assert {"web.certificate", "web.key"} == set(taken.left_out)
    assert not any(b"secret" in data for data in taken.files.values())


@pytest.mark.slow
def test_a_cell_that_does_not_load_is_no_backup(cell: Path, tmp_path: Path) -> None:
    """The mistakes are named, and no archive is left."""
    for name, data in contents(cell.parent).items():
        (tmp_path / "broken" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "broken" / name).write_bytes(data[: len(data) // 2] if name.endswith("npz") else data)

    with pytest.raises(ConfigError, match=r"shape\.npz"):
        backup(tmp_path / "broken" / "cell.toml", tmp_path / "a.tar.gz", QUIET)

    assert not (tmp_path / "a.tar.gz").exists()


@pytest.mark.slow
def test_nothing_is_overwritten_without_force(cell: Path, archive: Archive, tmp_path: Path) -> None:
    """An archive or folder is overwritten only with --force, which keeps the former files."""
    with pytest.raises(UserError, match="--force"):
        backup(cell, archive[0], QUIET)
    assert archive[0].read_bytes() == archive[1]
    (tmp_path / "cell").mkdir()
    (tmp_path / "cell" / "rig.json").write_bytes(b"former")
    with pytest.raises(UserError, match="--force"):
        restore(archive[0], tmp_path / "cell", QUIET)
    assert {"rig.json": b"former"} == contents(tmp_path / "cell")

    assert 0 == restore(archive[0], tmp_path / "cell", QUIET, force=True)
    restored = contents(tmp_path / "cell")
    assert 0 == restore(archive[0], tmp_path / "cell", QUIET, force=True)

    assert {"rig.json": b"former"} == contents(tmp_path / "cell.before-restore-1")
    assert restored == contents(tmp_path / "cell.before-restore-2") == contents(tmp_path / "cell")
    assert 3 == len(list(tmp_path.iterdir()))


@pytest.fixture
def used_folder(cell: Path, tmp_path: Path) -> Path:
    """A folder of two cells with their own rigs, jobs and keys, and other files."""
    etc = tmp_path / "edged"
    shutil.copytree(cell.parent, etc)
    shutil.copytree(etc / "jobs", etc / "jobs-left")
    shutil.copy(etc / "rig.json", etc / "rig-left.json")
    left = cell.read_text().replace('"rig.json"', '"rig-left.json"').replace('"jobs"', '"jobs-left"')
    (etc / "left.toml").write_text(left)
    (etc / "tls").mkdir(mode=0o750)
    (etc / "tls" / "left.key").write_text("key")
    (etc / "tls" / "left.key").chmod(0o600)
    (etc / "now").symlink_to("tls")
    etc.chmod(0o775)
    return etc


@pytest.mark.slow
def test_only_this_cells_files_make_room(archive: Archive, used_folder: Path) -> None:
    """Other cells, keys and links in the folder are unchanged, and jobs taught since are kept aside."""
    shutil.copytree(used_folder / "jobs" / "flange", used_folder / "jobs" / "since")
    (used_folder / "rig.json").write_text("spoilt")
    before = {file: file.lstat() for file in used_folder.rglob("*")}

    assert 0 == restore(archive[0], used_folder, QUIET, force=True)

    others = [
        file
        for file in before
        if file.relative_to(used_folder).parts[0] in ("left.toml", "rig-left.json", "jobs-left", "tls", "now")
    ]
    assert 8 <= len(others)
    for file in others:
        assert (before[file].st_mode, before[file].st_uid) == (file.lstat().st_mode, file.lstat().st_uid)
        assert file.is_dir() or before[file].st_ino == file.lstat().st_ino
    assert 0o775 == used_folder.stat().st_mode & 0o777
    assert not (used_folder / "jobs" / "since").exists()
    kept = contents(used_folder.with_name("edged.before-restore-1"))
    assert b"spoilt" == kept["rig.json"]
    assert {"cell.toml", "rig.json", "jobs"} == {name.partition("/")[0] for name in kept}
    assert {"jobs/since/job.toml", "jobs/since/shape.npz"} <= kept.keys()


@pytest.mark.slow
@pytest.mark.parametrize("shared", ['rig = "rig.json"', 'jobs = "jobs"', 'jobs = "."'])
def test_what_another_cell_stands_on_is_not_changed(archive: Archive, used_folder: Path, shared: str) -> None:
    """If another cell uses a file that would change, the restore is refused; identical content is no
    conflict."""
    key = shared.partition(" ")[0]
    left = (used_folder / "left.toml").read_text()
    (used_folder / "left.toml").write_text(re.sub(rf'(?m)^{key} = "[^"]*"', shared, left))
    assert 0 == restore(archive[0], used_folder, QUIET, force=True)

    for name in ("rig.json", "jobs/flange/job.toml"):
        with (used_folder / name).open("a") as file:
            file.write("\n")
    before = contents(used_folder)
    with pytest.raises(UserError, match=rf"cell\.{key} of left\.toml is .*another folder"):
        restore(archive[0], used_folder, QUIET, force=True)
    assert before == contents(used_folder)


@pytest.mark.slow
def test_a_link_to_elsewhere_makes_room_and_is_not_followed(archive: Archive, used_folder: Path) -> None:
    """A link is replaced, and the folder it leads to is unchanged."""
    elsewhere = used_folder.with_name("elsewhere")
    (used_folder / "jobs").rename(elsewhere)
    (used_folder / "jobs").symlink_to(elsewhere)
    (elsewhere / "note").write_text("mine")
    before = contents(elsewhere)

    assert 0 == restore(archive[0], used_folder, QUIET, force=True)

    assert before == contents(elsewhere)
    assert not (used_folder / "jobs").is_symlink()
    assert (used_folder.with_name("edged.before-restore-1") / "jobs").is_symlink()


@pytest.mark.slow
def test_a_backup_that_names_a_folder_outside_takes_nothing_away(archive: Archive, used_folder: Path) -> None:
    """A configuration that points to a folder outside of the archive removes nothing there."""
    taken = unpack(archive[1], "there")
    toml = taken.files["cell.toml"].replace(b'jobs = "jobs"', b'jobs = "."')
    hostile = used_folder.with_name("hostile.tar.gz")
    hostile.write_bytes(pack(replace(taken, files={**taken.files, "cell.toml": toml})))

    assert 1 == restore(hostile, used_folder, QUIET, force=True)

    assert (used_folder / "tls" / "left.key").is_file()
    assert (used_folder / "left.toml").is_file()


@pytest.mark.slow
def test_secrets_are_for_their_owner_alone(cell: Path, tmp_path: Path) -> None:
    """Archive and restored configuration have mode 600, and the hash in them is mentioned.

    With the hash a restored cell works at once; other files are readable as before.
    """
    hashed = hash_password("correct horse")
    here = Path(shutil.copytree(cell.parent, tmp_path / "etc"))
    (here / "zenoh.json5").write_text("{}")
    text = cell.read_text().replace("[zenoh]", '[zenoh]\nconfig_file = "zenoh.json5"')
    (here / "cell.toml").write_text(text + f'\n[web]\npassword_hash = "{hashed}"\n')
    output = io.StringIO()

    assert 0 == backup(here / "cell.toml", tmp_path / "a.tar.gz", Console(file=output, width=1000))
    assert "hash of a password" in output.getvalue()
    assert 0o600 == (tmp_path / "a.tar.gz").stat().st_mode & 0o777

    assert 0 == restore(tmp_path / "a.tar.gz", tmp_path / "new", QUIET)
    new = tmp_path / "new"
    assert hashed == load(new / "cell.toml").password_hash
    modes = {name: (new / name).stat().st_mode & 0o007 for name in ("cell.toml", "zenoh.json5", "rig.json")}
    assert {"cell.toml": 0, "zenoh.json5": 0, "rig.json": 4} == modes


@pytest.mark.slow
def test_a_restore_that_fails_changes_nothing(archive: Archive, tmp_path: Path) -> None:
    """After a failing write the folder is as before, without drafts beside it."""
    taken = unpack(archive[1], "there")
    blocked = tmp_path / "blocked.tar.gz"
    # "rig.json" is written before "rig.json/more", which needs a folder of that name
    blocked.write_bytes(pack(replace(taken, files={**taken.files, "rig.json/more": b""})))
    (tmp_path / "cell").mkdir()
    (tmp_path / "cell" / "old").write_bytes(b"old")

    with pytest.raises(FileFormatError, match="cannot be written"):
        restore(blocked, tmp_path / "cell", QUIET, force=True)

    assert {"old": b"old"} == contents(tmp_path / "cell")
    assert {"blocked.tar.gz", "cell"} == {entry.name for entry in tmp_path.iterdir()}


@pytest.mark.slow
@settings(max_examples=60)
@given(st.data())
def test_damage_is_found(archive: Archive, data: st.DataObject) -> None:
    """A cut or changed archive has the same content, or gives one kind of error that names the file."""
    cut = data.draw(st.integers(0, len(archive[1])))
    damaged = bytearray(archive[1][:cut])
    for _ in range(data.draw(st.integers(0, 4))):
        if damaged:
            damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    try:
        taken = unpack(bytes(damaged), "there")
    except FileFormatError as error:
        assert str(error).startswith("there")
    else:
        assert unpack(archive[1], "there").files == taken.files


def tar(*members: tarfile.TarInfo, data: bytes = b"") -> bytes:
    """An archive made without edged."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        for info in members:
            info.size = len(data) if info.isreg() else 0
            archive.addfile(info, io.BytesIO(data))
    return gzip.compress(buffer.getvalue())


def link(name: str, target: str, kind: bytes = tarfile.SYMTYPE) -> tarfile.TarInfo:
    """A member that is a link."""
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, target
    return info


@pytest.mark.parametrize(
    "name",
    [
        "../evil",
        "/etc/evil",
        "jobs/../../evil",
        "jobs//evil",
        ".evil",
        "jobs/.evil",
        "a\\..\\evil",
        "a\nb",
        "x/",
    ],
)
def test_a_name_that_leads_elsewhere_is_refused(name: str, tmp_path: Path) -> None:
    """The error names the path and what was expected, and nothing is written."""
    hostile = tmp_path / "in" / "hostile.tar.gz"
    hostile.parent.mkdir()
    hostile.write_bytes(tar(tarfile.TarInfo("manifest.json"), tarfile.TarInfo(name), data=b"{}"))

    with pytest.raises(FileFormatError, match="expected a relative path") as refused:
        restore(hostile, tmp_path / "in" / "cell", QUIET, force=True)

    assert str(hostile) in str(refused.value)
    assert [hostile] == [entry for entry in tmp_path.rglob("*") if entry.is_file()]


@pytest.mark.parametrize(
    "member",
    [
        link("rig.json", "/etc/passwd"),
        link("rig.json", "../../x", tarfile.LNKTYPE),
        link("rig.json", "", tarfile.FIFOTYPE),
        link("rig.json", "", tarfile.CHRTYPE),
        link("jobs", "", tarfile.DIRTYPE),
    ],
    ids=["symbolic link", "hard link", "pipe", "device", "folder"],
)
def test_only_plain_files_are_taken(member: tarfile.TarInfo) -> None:
    """Members that are not plain files, such as links, are refused."""
    with pytest.raises(FileFormatError, match="expected a plain file"):
        unpack(tar(member), "there")


def _with(change: Callable[[dict[str, bytes]], object], taken: Backup) -> bytes:
    """An archive whose members do not match its manifest."""
    with tarfile.open(fileobj=io.BytesIO(gzip.decompress(pack(taken)))) as archive:
        members = {info.name: archive.extractfile(info).read() for info in archive}
    change(members)
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        for name, data in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            archive.addfile(info, io.BytesIO(data))
    return gzip.compress(buffer.getvalue())


def _edit(old: bytes, new: bytes) -> Callable[[dict[str, bytes]], object]:
    return lambda m: m.update({"manifest.json": m["manifest.json"].replace(old, new)})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda m: m.pop("rig.json"), "rig.json: missing in the archive"),
        (lambda m: m.update({"more": b""}), "more: missing in manifest.json"),
        (lambda m: m.update({"rig.json": b"{}"}), "rig.json: checksum does not match"),
        (lambda m: m.pop("manifest.json"), "manifest.json is missing"),
        (lambda m: m.update({"manifest.json": b"[]"}), 'expected "format"'),
        (_edit(b'"config": "cell.toml"', b'"config": "x"'), "config: 'x' is not in the archive"),
        (_edit(b'"version": 1', b'"version": 9'), "version 9, this edged reads 1"),
    ],
)
def test_what_does_not_fit_the_manifest_is_named(
    archive: Archive, change: Callable[[dict[str, bytes]], object], expected: str
) -> None:
    """The error names the member and the problem."""
    with pytest.raises(FileFormatError, match=expected):
        unpack(_with(change, unpack(archive[1], "there")), "there")


def test_an_archive_made_to_fill_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Unpacking stops at the size limit, however small the archive."""
    monkeypatch.setattr(module, "MAX_BYTES", 2**20)
    bomb = tar(tarfile.TarInfo("manifest.json"), data=bytes(2**24))
    assert len(bomb) < 2**16

    with pytest.raises(FileFormatError, match="more than 1 MiB"):
        unpack(bomb, "there")


@pytest.mark.slow
def test_a_backup_of_another_version_says_what_differs(archive: Archive, tmp_path: Path) -> None:
    """An unknown key is named with exit code 1, but the files are restored."""
    taken = unpack(archive[1], "there")
    files = dict(taken.files) | {"registers.csv": b"address\n"}
    files["cell.toml"] += b"\n[laser]\npower = 3\n"
    (tmp_path / "old.tar.gz").write_bytes(pack(replace(taken, files=files)))

    run = CliRunner().invoke(app, ["restore", str(tmp_path / "old.tar.gz"), "-o", str(tmp_path / "new")])

    assert 1 == run.exit_code
    assert "laser: unknown key" in run.output
    assert "Modbus map of this version is another one" in run.output
    assert (tmp_path / "new" / "cell.toml").is_file()


@pytest.mark.slow
def test_the_commands_check_without_writing(cell: Path, tmp_path: Path) -> None:
    """`edged restore FILE` alone only describes the archive."""
    runner = CliRunner()
    made = runner.invoke(app, ["backup", str(cell), "-o", str(tmp_path / "a.tar.gz")])
    checked = runner.invoke(app, ["restore", str(tmp_path / "a.tar.gz")])

    assert (0, 0) == (made.exit_code, checked.exit_code)
    assert "every checksum is right" in checked.output
    assert read_cell(cell).fingerprint in checked.output
    assert ["a.tar.gz"] == [entry.name for entry in tmp_path.iterdir()]


def _said(archive: Path, output: Path | None, *, force: bool = False) -> str:
    """Output of `edged restore`."""
    said = io.StringIO()
    restore(archive, output, Console(file=said, width=1000), force=force)
    return said.getvalue()


def _changed(archive: Archive, change: Callable[[str], str], folder: Path) -> Path:
    """A forged archive: another configuration with a matching manifest."""
    taken = unpack(archive[1], "there")
    toml = change(taken.files["cell.toml"].decode()).encode()
    hostile = folder / "hostile.tar.gz"
    hostile.write_bytes(pack(replace(taken, files={**taken.files, "cell.toml": toml})))
    return hostile


def test_a_replaced_password_is_not_called_the_same(cell: Path, tmp_path: Path) -> None:
    """Differences not covered by the fingerprint, such as a password, are named but not shown."""
    first, second = hash_password("correct horse"), hash_password("battery staple")
    here = Path(shutil.copytree(cell.parent, tmp_path / "etc"))
    (here / "zenoh.json5").write_text("{}")
    text = cell.read_text().replace("[zenoh]", '[zenoh]\nconfig_file = "zenoh.json5"')
    (here / "cell.toml").write_text(text + f'\n[web]\npassword_hash = "{first}"\n')
    assert 0 == backup(here / "cell.toml", tmp_path / "a.tar.gz", QUIET)
    data = (tmp_path / "a.tar.gz").read_bytes()
    hostile = _changed((tmp_path, data), lambda toml: toml.replace(first, second), tmp_path)
    same = _said(tmp_path / "a.tar.gz", here, force=True)
    assert "other than before" not in same

    said = _said(hostile, here, force=True)

    assert "other than before: web.password_hash" in said
    assert "zenoh.config_file" not in said
    assert "argon2" not in said
    assert "the same" not in said
    (here / "zenoh.json5").write_text('{"access_control": {}}')
    assert "other than before: what is in zenoh.config_file, zenoh.json5" in _said(hostile, here, force=True)


def test_what_an_archive_lets_others_do_is_named(archive: Archive, tmp_path: Path) -> None:
    """Opened addresses, networks and passwords are listed, and differences to an existing folder named."""
    hashed = hash_password("correct horse")
    opening = f'\n[modbus]\nhost = "0.0.0.0"\nwriters = ["0.0.0.0/0"]\n[web]\npassword_hash = "{hashed}"\n'

    def opened(toml: str) -> str:
        return re.sub(r"(?ms)^\[modbus\].*?(?=^\[|\Z)", "", toml) + opening

    hostile = _changed(archive, opened, tmp_path)
    checked = _said(hostile, None)
    for expected in ('modbus.host = "0.0.0.0"', 'modbus.writers = ["0.0.0.0/0"]', "web.password_hash"):
        assert expected in checked
    assert 0 == restore(archive[0], tmp_path / "cell", QUIET)
    said = _said(hostile, tmp_path / "cell", force=True)
    assert 'other than before: modbus.writers = ["0.0.0.0/0"], was not set' in said
    assert "argon2" not in checked + said


def test_an_archive_steers_no_terminal(archive: Archive, tmp_path: Path) -> None:
    """Control characters in names, values and errors are not printed."""
    taken = unpack(archive[1], "there")
    toml = (
        taken.files["cell.toml"]
        + b'\n[web]\nhost = "\\u001b[2J\\u009b2J\\u202e"\n[laser]\n"\\u001b[8m" = 1\n'
    )
    left_out = {"web.key\x1b[2J": "\x1b]0;x\x07"}
    hostile = tmp_path / "hostile.tar.gz"
    hostile.write_bytes(pack(replace(taken, files={**taken.files, "cell.toml": toml}, left_out=left_out)))
    listed = _edit(b'"files": {', b'"files": {"\\u001b[2J": {},')
    (tmp_path / "listed.tar.gz").write_bytes(_with(listed, taken))
    for name in ("hostile.tar.gz", "listed.tar.gz"):
        run = subprocess.run(
            [sys.executable, "-m", "edged", "restore", str(tmp_path / name), "-o", str(tmp_path / "new")],
            capture_output=True,
            text=True,
            check=False,
        )
        assert run.returncode in (1, 2)
        assert "[2J" in run.stdout + run.stderr
        assert not {"\x1b", "\x9b", "\x07", "\u202e"} & {*run.stdout, *run.stderr}
