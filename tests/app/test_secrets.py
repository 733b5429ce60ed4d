"""The secrets of a cell: the hash of its password, and who may read its files."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from helpers.cells import small_rig
from helpers.ports import free_port
from helpers.waiting import WHOLE_S
from helpers.webcell import HASH
from rich.console import Console

from edged.app.cell import load_cell
from edged.app.daemon import Daemon
from edged.app.running import Running
from edged.commands.check import check
from edged.commands.demo import DemoOptions, prepare_cell
from edged.commands.replay import replay
from edged.config.reading import load
from edged.doctor.examination import examine
from edged.errors import ConfigError
from edged.files import private, recording
from edged.files.private import write_private
from edged.files.secrettext import without_secrets
from edged.payload import encode
from edged.setup.cellfiles import exposed_secrets, read_cell
from edged.sim.cell import VirtualCell, demo_part
from edged.sim.world import VirtualWorld

OTHER = HASH[:-4] + "AAAA"
"""The hash of another password."""


@pytest.fixture(scope="module")
def taught(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a virtual cell."""
    folder = tmp_path_factory.mktemp("cell")
    prepare_cell(folder, VirtualCell(small_rig(), demo_part()), DemoOptions(), gige=False)
    return folder


@pytest.fixture
def config(taught: Path, tmp_path: Path) -> Path:
    """A copy of its configuration with a page for others, and a former password in a comment."""
    path = Path(shutil.copytree(taught, tmp_path / "cell")) / "cell.toml"
    web = f'\n[web]\nhost = "0.0.0.0"\npassword_hash = "{HASH}"   # was {OTHER}\n'
    path.write_text(path.read_text() + web)
    path.chmod(0o600)
    return path


@pytest.mark.slow
def test_no_hash_is_published(config: Path) -> None:
    """A published or shown configuration has no hash."""
    loaded = load_cell(config)
    parts: tuple[Any, ...] = (None, None, None)
    published = encode(Running(config, loaded, *parts).config_summary()).decode()

    assert "0.0.0.0" in published
    assert "argon2" not in published + repr(loaded.cell.config) + str(loaded.cell.config.model_dump())


@pytest.mark.slow
def test_another_password_is_the_same_cell(config: Path) -> None:
    """Another password does not change the fingerprint."""
    before = read_cell(config).fingerprint
    config.write_text(config.read_text().replace(HASH, OTHER))

    assert read_cell(config).fingerprint == before


@pytest.mark.slow
def test_a_recording_holds_the_configuration_without_its_hash(config: Path) -> None:
    """A recorded configuration has no hash, neither today's nor the former, loads, and fits no password."""
    text = read_cell(config).contents["cell.toml"]
    config.write_bytes(text)

    assert b"argon2id" not in text
    assert 2 == text.count(b"$argon2-left-out")
    assert "$argon2-left-out" == load(config).password_hash


@pytest.mark.parametrize(
    "text",
    ['[web]\npassword_hash = "\\u0024argon2id$v=19$x"\n', "[web]\npassword_hash = '$argon2'\n", "no toml"],
)
def test_a_text_that_still_tells_is_left_out_as_a_whole(text: str) -> None:
    """A text that still contains a hash, or cannot be read, is left out as a whole."""
    assert b"" == without_secrets(text.encode())


@pytest.mark.slow
def test_an_export_of_earlier_recordings_has_no_hash(config: Path, tmp_path: Path) -> None:
    """An export of older recordings, which contain a hash, has none."""
    name = "000000001_20260131T235959.123456Z_OK_1a2b3c4d.zip"
    setup = recording.setup_folder(tmp_path / "old", "1a2b3c4d")
    setup.mkdir(parents=True)
    shutil.copy(config, setup / "cell.toml")
    (tmp_path / "old" / "cycles").mkdir()
    (tmp_path / "old" / "cycles" / name).write_bytes(b"damaged")

    replay(tmp_path / "old", False, Console(quiet=True), tmp_path / "new")

    text = (recording.setup_folder(tmp_path / "new", "1a2b3c4d") / "cell.toml").read_text()
    assert 'host = "0.0.0.0"' in text
    assert "argon2id" not in text


@pytest.mark.slow
def test_a_wrong_hash_is_not_repeated_in_the_message(config: Path) -> None:
    """A wrong password_hash is refused without repeating its value, which may be the password."""
    config.write_text(config.read_text().replace(f'"{HASH}"', "4711"))
    with pytest.raises(ConfigError) as number:
        load(config)
    config.write_text(config.read_text().replace("4711", '"hunter22"'))
    with pytest.raises(ConfigError) as text:
        load(config)

    assert "password_hash" in str(number.value) and "password_hash" in str(text.value)
    assert "4711" not in str(number.value)
    assert "hunter22" not in str(text.value)


@pytest.mark.slow
def test_a_private_key_in_an_endpoint_is_refused_and_not_repeated(config: Path) -> None:
    """A private key in an endpoint is refused, without repeating it, with the place for keys."""
    text = config.read_text().replace(
        "[zenoh]", '[zenoh]\nconnect = ["tls/x:1#connect_private_key_base64=c2VjcmV0"]'
    )
    config.write_text(text)

    with pytest.raises(ConfigError, match=r"connect\.0: .*zenoh\.config_file") as refused:
        load(config)

    assert "c2VjcmV0" not in str(refused.value)


# --- who may read ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_secret_that_every_user_may_read_is_named(config: Path) -> None:
    """The configuration with its hash and each private key are named if every user may read them."""
    text = config.read_text() + 'certificate = "tls.pem"\nkey = "tls.key"\n'
    config.write_text(text + '[modbus.tls]\ncertificate = "c.pem"\nkey = "m.key"\nauthority = "a.pem"\n')
    for name in ("tls.pem", "tls.key", "c.pem", "m.key", "a.pem"):
        (config.parent / name).write_text("")
        (config.parent / name).chmod(0o644)

    config.chmod(0o644)
    found = exposed_secrets(config, load(config))
    config.chmod(0o640)
    (config.parent / "m.key").chmod(0o600)
    closed = exposed_secrets(config, load(config))

    assert ["modbus.tls.key", "web.key", "web.password_hash"] == [secret.place for secret in found]
    assert ["web.key"] == [secret.place for secret in closed]
    assert all(str(secret.file) in secret.remedy and "chmod" in secret.remedy for secret in found)


@pytest.mark.slow
def test_keys_and_passwords_of_zenohs_own_file_are_secrets_too(config: Path) -> None:
    """The private keys of Zenoh's own file, and the file itself if it has a password, count as secrets."""
    own, key = config.parent / "zenoh.json5", config.parent / "own.key"
    config.write_text(config.read_text().replace("[zenoh]", '[zenoh]\nconfig_file = "zenoh.json5"'))
    found = []
    for content in (
        {"transport": {"link": {"tls": {"listen_private_key": str(key), "listen_certificate": str(own)}}}},
        {"transport": {"auth": {"usrpwd": {"user": "cell", "password": "x", "dictionary_file": str(key)}}}},
        {"transport": {}},
        {"lisen": 3},
    ):
        for file, text in ((own, json.dumps(content)), (key, "")):
            file.write_text(text)
            file.chmod(0o644)
        found.append([secret.file.name for secret in exposed_secrets(config, load(config))])

    assert [["own.key"], ["own.key", "zenoh.json5"], [], []] == found


@pytest.mark.slow
def test_a_shared_key_that_everybody_may_read_is_named(config: Path) -> None:
    """A shared key that every user may read is named, and the cell is refused."""
    key = config.parent / "zenoh.key"
    key.write_bytes(b"0" * 64)
    config.write_text(config.read_text().replace("[zenoh]", '[zenoh]\nshared_key = "zenoh.key"'))
    key.chmod(0o644)
    (found,) = [one for one in exposed_secrets(config, load(config)) if one.place == "zenoh.shared_key"]
    with pytest.raises(ConfigError, match=r"zenoh\.shared_key: .*every user of this machine may read it"):
        read_cell(config)
    key.chmod(0o600)

    assert key == found.file
    read_cell(config)


@pytest.mark.slow
def test_without_a_hash_everybody_may_read_the_configuration(taught: Path) -> None:
    """A configuration without a hash may be readable."""
    (taught / "cell.toml").chmod(0o644)

    assert [] == exposed_secrets(taught / "cell.toml", load(taught / "cell.toml"))


@pytest.mark.slow
def test_check_doctor_and_daemon_say_it(
    config: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    """Check, doctor and daemon name a readable secret with the remedy, and the cell runs."""
    text = config.read_text().replace('host = "0.0.0.0"', f"port = {free_port()}")
    text = text.replace("port = 1502", "enabled = false").replace("[zenoh]", "[zenoh]\nenabled = false")
    config.write_text(text)
    config.chmod(0o644)
    (line,) = map(str, exposed_secrets(config, load(config)))

    assert (0, 0) == (check(config, as_json=True), check(config, as_json=False))
    document, _, text = capsys.readouterr().out.partition("\n")
    assert [line] == json.loads(document)["warnings"]
    assert line in text

    (told,) = (found for found in examine(config, trigger=False) if found.name == "secrets")
    assert ("warn", True) == (told.verdict, "chmod" in told.remedy)

    async def started_and_reloaded() -> None:
        with VirtualWorld(gige=False, rig=small_rig()) as world:
            daemon = Daemon(config, load_cell(config), world=world)
            running = asyncio.create_task(daemon.run())
            await asyncio.sleep(0)  # the start goes first
            try:
                async with asyncio.timeout(WHOLE_S):
                    assert await daemon.reload()
            finally:
                daemon.stop()
                await running

    with caplog.at_level(logging.WARNING, "edged.app.daemon"):
        asyncio.run(started_and_reloaded())
    assert {line} == {record.getMessage() for record in caplog.records if record.name == "edged.app.daemon"}


DAEMONS = os.getegid()


@pytest.mark.parametrize(
    ("is_root", "daemons", "former", "expected"),
    [
        (False, None, None, 0o600),
        (False, DAEMONS, None, 0o600),
        (True, DAEMONS, None, 0o640),
        (True, None, None, 0o600),
        # others could not read the former one: it keeps its mode
        (False, None, 0o660, 0o660),
        (True, DAEMONS, 0o600, 0o600),
        # they could: no more, unless the daemon is one of them
        (False, None, 0o664, 0o600),
        (True, DAEMONS, 0o644, 0o640),
        (True, None, 0o644, 0o644),
    ],
)
def test_a_private_file_is_its_owners_or_also_the_daemons(
    is_root: bool,
    daemons: int | None,
    former: int | None,
    expected: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A private file is readable for its owner, and for the daemon if that could read the former one."""
    like = tmp_path / "former"
    if former is not None:
        like.write_bytes(b"")
        like.chmod(former)
    monkeypatch.setattr(private, "_config_group", lambda: daemons)
    monkeypatch.setattr("os.geteuid", lambda: 0 if is_root else 1000)

    write_private(tmp_path / "new", b"secret", like=like)

    assert (expected, b"secret") == (
        (tmp_path / "new").stat().st_mode & 0o777,
        (tmp_path / "new").read_bytes(),
    )
    assert ("chmod 600" if daemons is None else "chmod 640") in private.chmod_command(like)
