"""A support bundle: a failed cycle that measures the same elsewhere, no secrets, and no hostile bundles."""

from __future__ import annotations

import io
import json
import shutil
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.commandline import exit_code
from helpers.recordedcell import exposures, record
from helpers.smallcell import SmallCell
from helpers.webcell import HASH
from rich.console import Console

from edged.config.chosenconnections import ChosenConnections, connections_file
from edged.domain.frames import FramePair
from edged.errors import FileFormatError
from edged.files import recording
from edged.files.secrettext import without_secrets
from edged.files.statefolder import page_folder
from edged.identity.audit import AuditEntry, AuditFile
from edged.identity.invite import Invite
from edged.identity.users import User, UserFile
from edged.setup.cellfiles import read_cell
from edged.setup.machine import bundle

QUIET = Console(quiet=True)
HASHES = [f"{HASH[:-4]}{end}" for end in ("AAAA", "BBBB", "CCCC", "DDDD", "EEEE", "FFFF", "GGGG")]
KEY = "-----BEGIN PRIVATE KEY-----\nMC4CAQAwBQYDK2VwBCIEIsecret{}\n-----END PRIVATE KEY-----\n"
PAGE = f"""
[web]
password_hash = "{HASHES[0]}"   # was {HASHES[1]}, the password is hunter22#
metrics_password_hash = '{HASHES[2]}'
certificate = "tls.pem"
key = "tls.key"
[opcua]
password_hash = "{HASHES[3]}"
certificate = "o.pem"
key = "o.key"
trusted = "trusted"
[modbus.tls]
certificate = "c.pem"
key = "m.key"
authority = "a.pem"
[recorder]
folder = "recordings"
"""


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[bytes]]:
    """Recordings of two good cycles, a miss, and a cycle without pictures."""
    folder = tmp_path_factory.mktemp("support")
    cell = SmallCell(folder / "cell", source="virtual-inprocess")
    config = cell.config
    pairs = exposures(cell.virtual, 2)
    dark = FramePair(
        *(replace(frame, image=np.zeros_like(frame.image)) for frame in (pairs[0].left, pairs[0].right))
    )
    record(config.parent / "recordings", read_cell(config), [*pairs, dark, None])
    place = config.parent
    zenoh = {"transport": {"auth": {"usrpwd": {"user": "cell", "password": "zenohpassword77"}}}}
    (place / "zenoh.json5").write_text(json.dumps(zenoh))
    (place / "zenoh.key").write_text("5ha4ed" * 8)
    for number, name in enumerate(("tls.key", "m.key", "o.key", "tls.pem", "c.pem", "a.pem", "o.pem")):
        (place / name).write_text(KEY.format(number) if name.endswith("key") else "")
    text = config.read_text().split("[zenoh]")[0]
    text += '[zenoh]\nconfig_file = "zenoh.json5"\nshared_key = "zenoh.key"\ncommands = "refused"\n'
    config.write_text(text + PAGE)
    setup = next((place / "recordings" / "setups").iterdir())
    with (setup / "cell.toml").open("a") as file:  # as earlier versions recorded it
        file.write(f'# the password was hunter22#, "{HASHES[4]}"\n')
    state = page_folder(config)
    UserFile(state / "users.json").put(User(name="Anna", role="engineer", password_hash=HASHES[5]))
    code = Invite(state).make("Bert")
    AuditFile(state).add(AuditEntry("Anna", "engineer", "10.0.0.7", "POST", "backup", "ok"))
    chosen = ChosenConnections(opcua={"password_hash": HASHES[6], "anonymous": True})
    connections_file(place / "rig.json").write_bytes(chosen.content() or b"")
    secrets = [*HASHES, "hunter22", "zenohpassword77", "5ha4ed" * 8, "secret0", "secret1", "secret2", code]
    return config, [secret.encode() for secret in secrets]


@pytest.fixture(scope="module")
def made(kept: tuple[Path, list[bytes]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The support bundle of that cell."""
    output = tmp_path_factory.mktemp("made") / "help.zip"
    assert 0 == exit_code("support", kept[0], "-o", output)
    return output


def all_bytes(data: bytes) -> Iterator[bytes]:
    """A file, and everything packed in it, recursively."""
    yield data
    if data.startswith(b"PK\3\4"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for name in archive.namelist():
                yield name.encode()
                yield from all_bytes(archive.read(name))


@pytest.mark.slow
def test_a_bundle_measures_the_same_elsewhere(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its newest failed cycle with pictures replays bit-identically elsewhere."""
    there = Path(shutil.copy(made, tmp_path / "elsewhere.zip"))
    capsys.readouterr()
    assert 0 == exit_code("replay", there, "--json", "--export", tmp_path / "out")
    told = json.loads(capsys.readouterr().out)
    assert (1, [], []) == (told["same"], told["different"], told["skipped"])
    (entry,) = recording.entries(tmp_path / "out")
    assert ("NO_TARGET", 2) == (entry.status, entry.index)
    assert 0o600 == made.stat().st_mode & 0o777


@pytest.mark.slow
def test_another_cycle_is_asked_for_by_its_number(
    kept: tuple[Path, list[bytes]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """--cycle chooses a good cycle, whose replay equals that of the recordings; an unknown number is
    refused."""
    output = tmp_path / "a.zip"
    assert 0 == exit_code("support", kept[0], "-o", output, "--cycle", "1")
    assert ["OK"] == [
        name.split("_")[2] for name in bundle.unpack(output.read_bytes(), "a")[1] if "cycles/" in name
    ]
    capsys.readouterr()
    reports = []
    for place in (recording.entries(kept[0].parent / "recordings")[1].path, output):
        exit_code("replay", place, "--json")
        reports.append(json.loads(capsys.readouterr().out))
    assert reports[0] == reports[1]
    assert not reports[0]["skipped"]
    assert 2 == exit_code("support", kept[0], "-o", output)
    assert 2 == exit_code("support", kept[0], "-o", tmp_path / "b.zip", "--cycle", "77")
    assert not (tmp_path / "b.zip").exists()


@pytest.mark.slow
def test_no_secret_is_in_any_byte_of_it(kept: tuple[Path, list[bytes]], made: Path) -> None:
    """It holds no secrets of configuration, comments, choices, keys, users or invitation, but audit and
    findings."""
    parts = list(all_bytes(made.read_bytes()))
    assert [] == [secret for secret in kept[1] if any(secret in part for part in parts)]
    assert not any(b"argon2id" in part or b"PRIVATE KEY" in part for part in parts)
    document, _ = bundle.unpack(made.read_bytes(), "made")
    assert ["Anna"] == [record["user"] for record in document["audit"]["records"]]
    assert "secrets" in {check["name"] for check in document["checks"]}
    assert document["versions"] == recording.versions()
    assert "[cell]" in document["configuration"]


def test_comments_go_and_nothing_else() -> None:
    """A # within quotes stays, and text that cannot be parsed safely is dropped entirely."""
    text = b'a = "x # y" # z\nb = """\n# in it\n""" # out\nc = \'# "\'\n# d = 1\n'
    assert b'a = "x # y"\nb = """\n# in it\n"""\nc = \'# "\'\n\n' == without_secrets(text, comments=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["../evil", "setups/1a2b3c4d/../../../evil", "setups/1a2b3c4d//evil", "/tmp/evil", "cycles/evil.sh", "x"],
)
def test_a_member_that_leads_elsewhere_is_refused(name: str, made: Path, tmp_path: Path) -> None:
    """It is refused with exit code 2, though the document lists it with its digest, and no file is
    written."""
    document, members = bundle.unpack(made.read_bytes(), "made")
    hostile = tmp_path / "in" / "hostile.zip"
    hostile.parent.mkdir()
    hostile.write_bytes(bundle.pack(document | {"files": {}}, members | {name: b"x"}))
    assert 2 == exit_code("replay", hostile)
    assert ["in"] == [path.name for path in tmp_path.iterdir()]


@pytest.mark.slow
@pytest.mark.parametrize(
    "change",
    [
        lambda files: {name: b"" if name.endswith("rig.json") else data for name, data in files.items()},
        lambda files: {name: data for name, data in files.items() if not name.endswith("rig.json")},
        lambda files: {**files, "support.json": b"[" * 100_000},
        lambda files: {**files, "support.json": b'{"format": "edged-support", "version": 9}'},
    ],
)
def test_a_changed_bundle_is_refused_as_a_whole(
    change: Callable[[dict[str, bytes]], dict[str, bytes]], made: Path, tmp_path: Path
) -> None:
    """Changed or missing members and an invalid document give exit code 2."""
    with zipfile.ZipFile(made) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    changed = tmp_path / "changed.zip"
    with zipfile.ZipFile(changed, "w") as archive:
        for name, data in change(files).items():
            archive.writestr(name, data)
    assert 2 == exit_code("replay", changed)


@pytest.mark.long
def test_a_bomb_is_not_unpacked() -> None:
    """Many members, each of an allowed size, are refused if they are too large in total."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(6):
            archive.writestr(f"setups/1a2b3c4d/{number}", bytes(60 * 2**20))
        archive.writestr("support.json", "{}")
    with pytest.raises(FileFormatError, match="expected at most"):
        bundle.unpack(buffer.getvalue(), "bomb")


def test_what_still_holds_a_secret_is_not_packed() -> None:
    """Data that still contain a secret are never packed."""
    for data in (HASH.encode(), KEY.encode()):
        with pytest.raises(Exception, match="no bundle is made"):
            bundle.pack({}, {"setups/1a2b3c4d/x": data})
