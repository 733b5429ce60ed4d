"""Recordings that are kept with the history: which, how long, in the bucket, and through kills."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from helpers.s3server import S3Server
from helpers.snapshots import make_snapshot
from pyarrow.fs import FileSelector

from edged.domain.measurement import Status
from edged.errors import UserError
from edged.files import recording
from edged.files.history import bucket, kept
from edged.files.history.bucket import bucket_of
from edged.files.history.kept import SEEN, SENT, keep_recordings, kept_folder
from edged.files.history.packing import main

START = datetime(2026, 1, 31, 12, tzinfo=UTC)
FILES = {"rig.json": b"{}", "jobs/flange/job.toml": b"x"}


def recorded(folder: Path, *statuses: Status, first: int = 0, hour: int = 0) -> None:
    """Record a cycle for each status."""
    for index, status in enumerate(statuses, first):
        snapshot = make_snapshot(index, status)
        recording.save_setup(folder, snapshot.fingerprint, FILES)
        recording.save(folder, index, START + timedelta(hours=hour, seconds=index), snapshot, None)


def numbers(folder: Path) -> list[int]:
    """The numbers of a folder's recordings."""
    return [entry.index for entry in recording.entries(folder)]


def test_what_was_not_good_is_kept_and_every_nth_good_one(tmp_path: Path) -> None:
    """They stay when the recorder has removed its own, once each, with what they were measured by."""
    recorder, folder = tmp_path / "recorder", kept_folder(tmp_path / "history", "north", "left")
    recorded(recorder, Status.OK, Status.OK, Status.NO_TARGET, Status.OK, Status.OK)
    assert 3 == keep_recordings(recorder, folder, 4, 100)
    assert [0, 2, 4] == numbers(folder)
    assert 0 == keep_recordings(recorder, folder, 4, 100)
    for entry in recording.entries(recorder):
        entry.path.unlink()
    shutil.rmtree(recorder / "setups")
    recorded(recorder, Status.LOW_QUALITY, first=5)
    assert 1 == keep_recordings(recorder, folder, 4, 100)
    assert [0, 2, 4, 5] == numbers(folder)
    (setup,) = recording.setups(folder)
    assert b"x" == (recording.setup_folder(folder, setup) / "jobs" / "flange" / "job.toml").read_bytes()


def test_a_file_system_without_links_gets_copies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The content is the same; what the recorder removes meanwhile is left out."""
    recorder, folder = tmp_path / "recorder", tmp_path / "kept"
    recorded(recorder, Status.NO_TARGET, Status.NO_TARGET)

    def refused(target: Path, source: Path) -> None:
        if source.name.startswith("000000001"):
            source.unlink()
        raise OSError(18, "Invalid cross-device link")

    monkeypatch.setattr(Path, "hardlink_to", refused)
    assert 1 == keep_recordings(recorder, folder, 1, 100)
    (entry,) = recording.entries(folder)
    assert entry.path.read_bytes() == (recorder / "cycles" / entry.path.name).read_bytes()


def test_the_oldest_go_beyond_the_limit_and_do_not_come_again(tmp_path: Path) -> None:
    """What is still in the recorder's folder is looked at once. Another disc begins at number 0."""
    recorder, folder = tmp_path / "recorder", tmp_path / "kept"
    recorded(recorder, *[Status.NO_TARGET] * 3, first=7)
    for entry in recording.entries(recorder):
        with entry.path.open("ab") as file:
            file.truncate(600_000)  # a ZIP may have anything behind it, and here a hole
    assert 3 == keep_recordings(recorder, folder, 1, 1)
    assert [9] == numbers(folder)
    assert 0 == keep_recordings(recorder, folder, 1, 1)
    assert [9] == numbers(folder)
    shutil.rmtree(recorder)
    recorded(recorder, Status.NO_TARGET, hour=1)
    assert 1 == keep_recordings(recorder, folder, 1, 1)
    assert [0, 9] == numbers(folder)


def test_a_run_that_is_killed_is_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever was kept before is not kept twice, and nothing is left out."""
    recorder, folder = tmp_path / "recorder", tmp_path / "kept"
    recorded(recorder, *[Status.NO_TARGET] * 3)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(kept, "_write", killed)
        keep_recordings(recorder, folder, 1, 100)
    assert not (folder / SEEN).exists()
    (folder / "cycles" / ".torn").write_bytes(b"")
    assert 0 == keep_recordings(recorder, folder, 1, 100)
    assert [0, 1, 2] == numbers(folder)
    assert not (folder / "cycles" / ".torn").exists()


def killed(*_: object) -> None:
    """End the run here."""
    raise KeyboardInterrupt


@pytest.mark.long
def test_a_bucket_gets_each_once_with_its_setup(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A server that is away costs nothing but time; what is removed unsent is said."""
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "cell")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setattr(bucket, "ATTEMPTS", 1)
    server = S3Server(tmp_path / "server.log")
    recorder, history = tmp_path / "recorder", tmp_path / "history"
    folder = kept_folder(history, "north", "left")

    def run(most_mib: int = 100) -> None:
        main(
            [str(history), "north", "left", "400", "2000", server.address, str(recorder), "1", str(most_mib)]
        )

    recorded(recorder, Status.NO_TARGET)
    with pytest.raises(UserError, match="s3://cells/history"):
        run()
    assert [0] == numbers(folder)
    server.start()
    try:
        run()
        recorded(recorder, Status.NO_TARGET, first=1)
        run()
        client, base = bucket_of(server.address)
        place = f"{base}/plant=north/recordings/cell=left"
        for file in (path for path in folder.rglob("*") if path.is_file() and path.name not in {SEEN, SENT}):
            with client.open_input_file(f"{place}/{file.relative_to(folder)}") as there:
                assert file.read_bytes() == there.read()
        # nothing is sent again
        client.delete_file(f"{place}/cycles/{recording.entries(folder)[0].path.name}")
        run()
        assert 1 == len(client.get_file_info(FileSelector(f"{place}/cycles")))
    finally:
        server.kill()
    recorded(recorder, Status.NO_TARGET, first=2)
    capsys.readouterr()
    with pytest.raises(UserError):
        run(0)
    assert [] == numbers(folder)
    assert 1 == capsys.readouterr().err.count("is removed unsent")
    assert set() == recording.setups(folder)
