"""A release repository: properly signed releases are fetched, everything else is refused by name."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.attacks import (
    by_another_plant,
    by_one_root,
    expired,
    of_another_plant,
    tampered_ring,
    tampered_target,
)
from helpers.commandline import exit_code, printed
from helpers.nginx import Nginx
from helpers.prometheus import program
from helpers.releases import PASSPHRASE, Releases, served
from helpers.waiting import LIMIT_S, wait_until

from edged.files.statefolder import page_folder
from edged.setup.fleet.offers import STAGED, ring_of
from edged.setup.releases.jobsfolder import jobs_in


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, template: Path) -> Releases:
    """A repository with one published release for all."""
    releases = Releases(tmp_path_factory.mktemp("releases"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EDGED_PASSPHRASE", PASSPHRASE)
        releases.make()
        assert 0 == releases.sign(
            "first", "--jobs", template / "jobs", "--ring", "all", "--note", "new light"
        )
        assert 0 == releases.publish()
    return releases


@pytest.fixture
def releases(made: Releases, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Releases:
    """A copy for one test."""
    monkeypatch.setenv("EDGED_PASSPHRASE", PASSPHRASE)
    shutil.copytree(made.keys.parent, tmp_path / "fleet")
    return Releases(tmp_path / "fleet")


@pytest.fixture
def cell(releases: Releases, own_cell: Path) -> Path:
    """Configuration of a cell of plant "north"."""
    config = own_cell / "cell.toml"
    config.write_text(config.read_text() + releases.section())
    return config


def staged(cell: Path) -> dict[str, Any]:
    """The fetched release."""
    return dict(json.loads((page_folder(cell) / "fleet" / STAGED).read_bytes()))


def test_a_release_arrives_from_a_folder_as_it_was_signed(
    releases: Releases, cell: Path, template: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder is enough, without any network, and the fetched jobs are exactly the signed ones."""
    stick = shutil.copytree(releases.repository, tmp_path / "stick")
    shutil.rmtree(releases.repository / "targets")
    assert 0 == exit_code("release", "pull", cell, "--from", stick)
    assert (str(stick), "new light") == (staged(cell)["repository"], staged(cell)["offer"]["note"])
    capsys.readouterr()
    assert 0 == exit_code("release", "status", cell, "--from", stick, "--json")
    said = json.loads(capsys.readouterr().out)
    assert ("first", "all", 1) == tuple(said["published"][0][key] for key in ("name", "ring", "number"))
    assert said["fetched"]["path"] == "north/first.jobs.tar.gz"
    assert jobs_in(template / "jobs") == jobs_in(cell.parent / "jobs")


@pytest.mark.slow
def test_a_release_arrives_from_a_static_https_server_that_the_cell_trusts(
    releases: Releases, cell: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """The cell fetches over HTTPS, and refuses a server whose certificate it does not trust."""
    with served(releases.repository, tmp_path / "tls") as url:
        config = cell.read_text()
        cell.write_text(config.replace(str(releases.repository), url, 1))
        assert 2 == exit_code("release", "pull", cell)
        assert "certificate verify failed" in printed(capsys)
        monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "tls" / "ca.pem"))
        assert 0 == exit_code("release", "pull", cell)
        assert url == staged(cell)["repository"]
        capsys.readouterr()
    assert 2 == exit_code("release", "pull", cell)
    assert f"{url}: metadata: cannot be read" in printed(capsys)


@pytest.fixture
def nginx(releases: Releases, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Nginx]:
    """A real web server for the repository, which is killed afterwards; this process trusts it."""
    server = Nginx(releases.repository, tmp_path / "nginx")
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "nginx" / "tls" / "ca.pem"))
    yield server
    server.kill()


@pytest.mark.long
@pytest.mark.skipif(not program("nginx"), reason="no nginx")
def test_a_server_that_is_killed_while_it_sends_leaves_nothing_half(
    nginx: Nginx, cell: Path, releases: Releases, capsys: pytest.CaptureFixture[str]
) -> None:
    """A target that ends early is refused by name, and the next pull brings the whole one."""
    cell.write_text(cell.read_text().replace(str(releases.repository), nginx.url, 1))
    kept = page_folder(cell) / "fleet"
    nginx.start(bytes_per_s=1000)
    codes: list[int] = []
    pull = threading.Thread(target=lambda: codes.append(exit_code("release", "pull", cell)))
    pull.start()
    # the plant's metadata is kept before its target is asked for, which is sent for a minute
    wait_until(lambda: (kept / "metadata" / "north.json").exists())
    nginx.kill()
    pull.join(LIMIT_S)
    assert [2] == codes
    assert f"{nginx.url}: targets/north/first.jobs.tar.gz: " in printed(capsys)
    assert ["metadata"] == [entry.name for entry in kept.iterdir()]
    nginx.start()
    assert 0 == exit_code("release", "pull", cell)
    assert nginx.url == staged(cell)["repository"]


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("attack", "expected"),
    [
        (tampered_target, "targets/north/first.jobs.tar.gz: was changed"),
        (tampered_ring, "metadata/north.json: is not signed by those who may"),
        (of_another_plant, "metadata/north.json: south/evil.jobs.tar.gz is not delegated to north"),
        (by_another_plant, "metadata/north.json: is not signed by those who may"),
        (expired, "metadata: is old"),
        (by_one_root, "metadata: is not signed by those who may"),
    ],
)
def test_what_is_not_as_it_was_signed_is_refused_and_its_place_named(
    attack: Callable[[Releases], None], expected: str, releases: Releases, cell: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Nothing is fetched, and the error names the invalid file."""
    attack(releases)
    assert 2 == exit_code("release", "pull", cell)
    assert f"{releases.repository}: {expected}" in printed(capsys)
    assert not (page_folder(cell) / "fleet" / STAGED).exists()


def test_an_older_repository_than_the_cell_has_seen_is_refused(
    releases: Releases, cell: Path, tmp_path: Path, template: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An older state with valid signatures is refused as a roll-back."""
    before = shutil.copytree(releases.repository, tmp_path / "before")
    assert 0 == releases.sign("second", "--jobs", template / "jobs", "--ring", "all")
    assert 0 == releases.publish()
    assert 0 == exit_code("release", "pull", cell)
    capsys.readouterr()
    assert 2 == exit_code("release", "pull", cell, "--from", before)
    assert f"{before}: metadata: is older than what this cell has seen" in printed(capsys)
    assert "second" == staged(cell)["offer"]["name"]


@pytest.mark.long
def test_a_root_counts_once_enough_of_its_keys_have_signed(
    releases: Releases, cell: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A new root counts once two of the old root's keys have signed it."""
    keys = [argument for key in ("root1", "root2", "root3") for argument in ("--key", releases.public(key))]
    counts = ("--targets", releases.public("targets"), "--online", releases.public("south"))
    assert 0 == exit_code("release", "root", releases.repository, *keys, *counts)
    assert 2 == releases.run("publish", key="south")
    assert "root.json: root was signed by 0/2 keys" in printed(capsys)
    assert 2 == releases.run("countersign", key="north")
    assert [0, 0] == [releases.run("countersign", key=key) for key in ("root1", "root3")]
    assert 2 == releases.publish()
    assert 0 == releases.run("publish", key="south")
    assert 0 == exit_code("release", "pull", cell)


def test_a_key_opens_by_its_passphrase_alone_and_is_never_replaced(
    releases: Releases, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The private key is encrypted with mode 600, and never overwritten."""
    file = releases.private("north")
    assert file.read_bytes().startswith(b"-----BEGIN ENCRYPTED PRIVATE KEY-----")
    assert 0o600 == file.stat().st_mode & 0o777
    assert 2 == exit_code("release", "key", file)
    monkeypatch.setenv("EDGED_PASSPHRASE", "wrong horse battery")
    assert 2 == releases.sign("first", "--ring", "1")
    assert f"{file}: no private key with this passphrase" in printed(capsys)


# --- rings ----------------------------------------------------------------------------------------


@pytest.mark.long
def test_rings_hold_one_cell_then_5_then_25_percent_then_all() -> None:
    """Of 500 cells the rings hold 1, 25, 125 and 500, beginning with another cell for each release."""
    cells = [f"cell-{number:03}" for number in range(500)]
    rings = [ring_of(cell, "r7", cells) for cell in cells]
    assert (1, 25, 125, 500) == tuple(sum(ring <= most for ring in rings) for most in (1, 2, 3, 4))
    first = {next(cell for cell in cells if ring_of(cell, f"r{number}", cells) == 1) for number in range(20)}
    assert 15 < len(first)
    assert 4 == ring_of("unknown", "r7", cells)
    assert 2 == ring_of("cell-000", "r7", cells, given=2)


@pytest.mark.long
def test_a_cell_takes_a_release_once_its_ring_is_reached(
    releases: Releases, cell: Path, template: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A cell gets the release once its ring is reached, which only the plant's key can widen."""
    cells = tmp_path / "cells"
    cells.write_text("\n".join(f"other-{number}" for number in range(20)))
    ring = ("--ring", "1", "--cells", cells)
    assert 0 == releases.sign("second", "--jobs", template / "jobs", *ring)
    assert 0 == releases.publish()
    assert 0 == exit_code("release", "pull", cell)
    assert "first" == staged(cell)["offer"]["name"]
    assert [0, 0] == [releases.sign("second", "--ring", "all"), releases.publish()]
    assert 0 == exit_code("release", "pull", cell)
    assert ("second", 2) == (staged(cell)["offer"]["name"], staged(cell)["offer"]["number"])
    cell.write_text(cell.read_text() + "ring = 1\n")
    assert [0, 0] == [releases.sign("first", "--ring", "none"), releases.publish()]
    assert 0 == exit_code("release", "pull", cell)
    assert "is fetched already" in printed(capsys)


def test_a_name_keeps_its_content(
    releases: Releases, tmp_path: Path, template: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A used name cannot be signed with other content, and invalid jobs are not signed."""
    other = shutil.copytree(template / "jobs", tmp_path / "jobs")
    text = next(other.iterdir()) / "job.toml"
    text.write_text(text.read_text() + "\n# another\n")
    assert 2 == releases.sign("first", "--jobs", other, "--ring", "1")
    assert "north/first.jobs.tar.gz is signed with another content" in printed(capsys)
    (next(other.iterdir()) / "shape.npz").write_bytes(b"none")
    assert [2, 2] == [
        releases.sign("third", "--jobs", other),
        releases.sign("a/b", "--jobs", template / "jobs"),
    ]


def test_any_file_of_the_plant_arrives_verified_and_no_cell_takes_it_by_itself(
    releases: Releases, cell: Path, tmp_path: Path
) -> None:
    """Other files are fetched by name only, verified."""
    (tmp_path / "station.toml").write_text("[cell]\n")
    assert 0 == releases.sign("station.toml", "--file", tmp_path / "station.toml")
    assert 0 == releases.publish()
    assert 2 == exit_code("release", "pull", cell, "--name", "other.toml", "-o", tmp_path / "new.toml")
    assert 0 == exit_code("release", "pull", cell, "--name", "station.toml", "-o", tmp_path / "new.toml")
    assert "[cell]\n" == (tmp_path / "new.toml").read_text()
    assert 0 == exit_code("release", "pull", cell)
    assert "first" == staged(cell)["offer"]["name"]
