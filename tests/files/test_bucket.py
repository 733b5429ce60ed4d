"""History in an S3 bucket (moto's server, over HTTP): nothing is lost or doubled, whichever process is
killed."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.commandline import exit_code, printed
from helpers.s3server import S3Server

from edged.config.cell import HistorySection
from edged.errors import UserError
from edged.files.history import bucket
from edged.files.history.bucket import SENT
from edged.files.history.packing import day_file, pack
from edged.files.history.query import ask
from edged.files.history.rows import Spool, spool_folder

DAY_NS = 86_400 * 10**9
START_NS = 1_769_860_800 * 10**9
"""2026-01-31, noon."""
COUNTS = "SELECT day, count(*), count(DISTINCT cycle) FROM cycles GROUP BY ALL ORDER BY ALL"


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[S3Server]:
    """A server that is not started yet, and credentials for it."""
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "cell")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setattr(bucket, "ATTEMPTS", 1)
    server = S3Server(tmp_path / "server.log")
    yield server
    server.kill()


def spooled(folder: Path, day: int, first: int, count: int) -> None:
    """Write rows of a day that wait to be packed."""
    spool = Spool(spool_folder(folder, "left"), first)
    at_ns = START_NS + day * DAY_NS
    spool.write(
        [
            {"started_ns": 1, "cycle": cycle, "at_ns": at_ns + cycle, "status": "OK"}
            for cycle in range(first, first + count)
        ]
    )
    spool.turn_over()


@pytest.mark.long
def test_what_is_packed_comes_into_the_bucket_whoever_is_killed(
    server: S3Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """After a missing server, a killed packer and a killed server the next run completes the bucket, each
    row once."""
    folder = tmp_path / "history"

    def packed() -> int:
        return pack(folder, "north", "left", 400, 2000, server.address)

    spooled(folder, 0, 1, 5)
    with pytest.raises(UserError, match="s3://cells/history"):
        packed()
    assert [("2026-01-31", 5, 5)] == ask([folder], COUNTS)[1]
    server.start()
    with monkeypatch.context() as patch:
        patch.setattr(bucket, "write_atomically", killed)
        with pytest.raises(KeyboardInterrupt):
            packed()
    assert [("2026-01-31", 5, 5)] == ask([server.address], COUNTS)[1]
    assert not day_file(folder, "north", "2026-01-31", "left").with_name(SENT).exists()
    spooled(folder, 0, 6, 5)
    spooled(folder, 1, 11, 5)
    assert 10 == packed()
    both = [("2026-01-31", 10, 10), ("2026-02-01", 5, 5)]
    assert both == ask([server.address], COUNTS)[1]
    assert 0 == exit_code("history", COUNTS, "--in", server.address, "--json")
    assert both == [tuple(row.values()) for row in json.loads(capsys.readouterr().out)]
    # another disc, or a day that was removed here: what the bucket has of it stays
    shutil.rmtree(day_file(folder, "north", "2026-01-31", "left").parent)
    spooled(folder, 0, 100, 2)
    packed()
    assert ("2026-01-31", 12, 12) == ask([server.address], COUNTS)[1][0]
    server.kill()
    spooled(folder, 2, 16, 5)
    # the cell's own process, as it is started beside it
    program = [sys.executable, "-m", "edged.files.history.packing", str(folder), "north", "left", "1", "2000"]
    done = subprocess.run([*program, server.address], capture_output=True, text=True, check=False)
    # one day is to stay, and those that the bucket has are gone
    assert (1, [("2026-02-02", 5, 5)]) == (done.returncode, ask([folder], COUNTS)[1])
    assert "history: s3://cells/history" in done.stderr
    server.start()
    assert 0 == packed()
    assert [("2026-02-02", 5, 5)] == ask([server.address], COUNTS)[1]


def killed(*_: object) -> None:
    """End the packer here."""
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    "address",
    ["s3://me:secret@cells/history", "http://cells/x", "s3://cells/x?secret_key=1", "s3://c/../x", "s3://"],
)
def test_an_address_holds_a_place_and_nothing_secret(
    address: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """An address with a secret or without a place is refused with the expected form, by the command, too."""
    with pytest.raises(UserError, match="expected s3://BUCKET/PREFIX"):
        bucket.checked(address)
    if address.startswith("s3"):
        assert 2 == exit_code("history", "SELECT 1", "--in", address)
        assert "expected s3://" in printed(capsys)
    if "@" in address:
        with pytest.raises(ValueError, match="bucket"):
            HistorySection(folder=tmp_path, bucket=address)


def test_days_that_the_bucket_lacks_stay_while_there_is_room(
    server: S3Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Days that the bucket lacks are kept while there is room; without room the oldest is removed, and
    logged."""
    for day in range(3):
        spooled(tmp_path, day, 5 * day + 1, 5)
    with pytest.raises(UserError):
        pack(tmp_path, "north", "left", 1, 2000, server.address)
    assert 3 == len(ask([tmp_path], COUNTS)[1])
    with pytest.raises(UserError):
        pack(tmp_path, "north", "left", 1, 0, server.address)
    assert 1 == len(ask([tmp_path], COUNTS)[1])
    assert "is removed unsent" in capsys.readouterr().err
