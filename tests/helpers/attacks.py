"""Attacks on a release repository by someone who holds some of its keys, or none."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from securesystemslib.signer import CryptoSigner
from tuf.api.metadata import Metadata, TargetFile, Targets

from edged.setup.fleet.keys import signer_of
from helpers.releases import PASSPHRASE, Releases


def newest(releases: Releases) -> Path:
    """The plant's most recently signed metadata file."""
    files = (releases.repository / "metadata").glob("*.north.json")
    return max(files, key=lambda file: int(file.name.split(".")[0]))


def tampered_target(releases: Releases) -> None:
    """Flip one bit of each release file."""
    for file in (releases.repository / "targets" / "north").iterdir():
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 1
        file.write_bytes(data)


def tampered_ring(releases: Releases) -> None:
    """Change the ring of a release without signing the change."""
    file = newest(releases)
    file.write_text(file.read_text().replace('"ring":4', '"ring":3'))


def of_another_plant(releases: Releases) -> None:
    """The plant signs a release of another plant, with its own valid key."""
    file = newest(releases)
    signed: Metadata[Targets] = Metadata.from_file(str(file))
    target = TargetFile.from_data("south/evil.jobs.tar.gz", b"evil")
    target.unrecognized_fields["custom"] = next(iter(signed.signed.targets.values())).custom
    signed.signed.targets[target.path] = target
    resigned(file, signed, releases, "north")


def by_another_plant(releases: Releases) -> None:
    """Another plant's key signs this plant's releases."""
    file = newest(releases)
    resigned(file, Metadata.from_file(str(file)), releases, "south")


def expired(releases: Releases) -> None:
    """Let the timestamp expire, as when newer metadata is withheld."""
    file = releases.repository / "metadata" / "timestamp.json"
    stamp = Metadata[Any].from_file(str(file))
    stamp.signed.expires = datetime.now(UTC).replace(microsecond=0) - timedelta(seconds=1)
    resigned(file, stamp, releases, "online")


def by_one_root(releases: Releases) -> None:
    """A new root that names another publishing key, signed by only one of the two keys it requires."""
    file = releases.repository / "metadata" / "1.root.json"
    root = Metadata[Any].from_file(str(file))
    root.signed.version = 2
    resigned(file.with_name("2.root.json"), root, releases, "root1")


def resigned(file: Path, signed: Metadata[Any], releases: Releases, key: str) -> None:
    """Sign again with the given key."""
    signer: CryptoSigner = signer_of(releases.private(key), PASSPHRASE)
    signed.sign(signer)
    signed.to_file(str(file))
