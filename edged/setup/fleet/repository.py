"""A repository of signed releases in a folder by The Update Framework; for a web server or a USB stick.

    metadata/1.root.json, 1.targets.json, 3.PLANT.json, 7.snapshot.json, timestamp.json
    targets/PLANT/SHA256.NAME

Each plant signs its releases with its own key, and cannot sign those of another plant. Cells see signed
releases once they are published. Source: The Update Framework Specification 1.0.34.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from securesystemslib.signer import Signer, SSlibKey
from tuf.api.exceptions import RepositoryError
from tuf.api.metadata import (
    DelegatedRole,
    Delegations,
    Metadata,
    MetaFile,
    Role,
    Root,
    Signed,
    Snapshot,
    TargetFile,
    Targets,
    Timestamp,
)
from tuf.api.serialization import DeserializationError

from edged.errors import FileFormatError, UserError, translated
from edged.files.atomic import make_folders, read_bytes, write_file
from edged.setup.fleet.offers import Offer

ROOT, TARGETS, SNAPSHOT, TIMESTAMP = (role.type for role in (Root, Targets, Snapshot, Timestamp))
METADATA, FILES, CUSTOM = "metadata", "targets", "edged"
SIGNED_DAYS = 365
"""Validity of metadata that is signed offline."""
PLANT = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
S = TypeVar("S", bound=Signed)


class Repository:
    """A repository in a folder. Methods that write raise `UserError` that names the file."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._metadata = folder / METADATA

    def make_root(
        self, keys: Sequence[SSlibKey], threshold: int, targets: SSlibKey, online: SSlibKey,
        signers: Sequence[Signer],
    ) -> Path:  # fmt: skip
        """Create or replace the root, which states the valid keys. Return its file.

        keys : of the root. threshold : how many of them must sign. targets : key that delegates to plants.
        online : key that publishes.
        """
        if not 1 <= threshold <= len(keys):
            raise UserError(
                f"{self._folder}: the root has {len(keys)} keys: of these {threshold} cannot sign"
            )
        root = Root(version=self._version(ROOT) + 1)
        root.expires = _in_days(SIGNED_DAYS)
        root.roles = {role: Role([], 1) for role in (ROOT, TARGETS, SNAPSHOT, TIMESTAMP)}
        root.roles[ROOT].threshold = threshold
        for role, own in ((ROOT, keys), (TARGETS, [targets]), (SNAPSHOT, [online]), (TIMESTAMP, [online])):
            for key in own:
                root.add_key(key, role)
        signed = Metadata(root)
        for signer in signers:
            signed.sign(signer, append=True)
        return self._write(signed)

    def countersign(self, signer: Signer) -> int:
        """Sign the newest root with one more key; return how many signatures are still missing."""
        root = self._load(ROOT)
        if signer.public_key.keyid not in root.signed.roles[ROOT].keyids:
            raise UserError(f"{self._newest(ROOT)}: this key is not among those of the root")
        root.sign(signer, append=True)
        self._write(root)
        return int(root.signed.get_verification_result(ROOT, root.signed_bytes, root.signatures).missing)

    def delegate(self, plant: str, key: SSlibKey, signer: Signer) -> None:
        """Allow one key, and no other, to sign the releases of a plant."""
        if not PLANT.fullmatch(plant) or plant in (ROOT, TARGETS, SNAPSHOT, TIMESTAMP):
            raise UserError(f"{plant!r}: expected a name of letters, digits and _ . -, and none of TUF's own")
        targets = Metadata(Targets()) if self._newest(TARGETS) is None else self._load(TARGETS)
        if targets.signed.delegations is None:
            targets.signed.delegations = Delegations({}, {})
        delegations = targets.signed.delegations
        roles = delegations.roles or {}
        roles[plant] = DelegatedRole(plant, [], 1, True, paths=[f"{plant}/*"])
        delegations.roles = roles
        targets.signed.add_key(key, plant)
        self._sign(targets, signer, TARGETS, self._load(ROOT).signed)

    def sign(
        self, plant: str, signer: Signer, path: str, data: bytes | None, custom: dict[str, Any],
        parts: Mapping[str, bytes] = MappingProxyType({}),
    ) -> Offer:  # fmt: skip
        """Sign a target of a plant, and return its offer. data : None to change only its metadata.

        custom : fields of `Offer`, without number and time. parts : further targets that belong to it, by
        name.
        """
        if not PLANT.fullmatch(path.removeprefix(f"{plant}/")):
            raise UserError(f"{path}: expected a name of letters, digits and _ . -")
        there = self._plant(plant)
        known = there.signed.targets.get(path)
        offers = {
            name: offer_of(target) for name, target in there.signed.targets.items() if not is_part(target)
        }
        if data is None and known is None:
            raise UserError(
                f"{self._folder}: {plant} has signed no {path}: there is {', '.join(offers) or 'none'}"
            )
        target = known if known is not None and data is None else TargetFile.from_data(path, data or b"")
        if known is not None and target.hashes != known.hashes:
            raise UserError(f"{self._folder}: {path} is signed with another content: choose another name")
        now, former = datetime.now(UTC).isoformat(timespec="seconds"), offers.get(path)
        number = max((offer.number for offer in offers.values()), default=0) + 1
        stated = {"number": number, "created": now} if former is None else former.model_dump(mode="json")
        offer = Offer.model_validate({**stated, **custom})
        target.unrecognized_fields["custom"] = {CUSTOM: offer.model_dump(mode="json")}
        there.signed.targets[path] = target
        files = [] if data is None else [(target, data)]
        for name, content in parts.items():
            part = TargetFile.from_data(f"{plant}/{name}", content)
            there.signed.targets[part.path] = part
            files.append((part, content))
        self._sign(there, signer, plant, self._load(TARGETS).signed)
        for target, content in files:
            place = self._folder / FILES / target.get_prefixed_paths()[0]
            if not (place.is_file() and place.stat().st_size == len(content)):  # named by its hash
                _write_in(place.parent, place.name, content)
        return offer

    def has(self, plant: str, path: str) -> bool:
        """Whether a plant has signed a target of this path."""
        return path in self._plant(plant).signed.targets

    def publish(self, signer: Signer, days: float) -> Snapshot:
        """Publish what is signed, valid for so many days; the timestamp is last. Return the snapshot."""
        root, targets = self._load(ROOT), self._load(TARGETS)
        self._check(root, ROOT, root.signed)
        self._check(targets, TARGETS, root.signed)
        plants = list((targets.signed.delegations.roles or {}) if targets.signed.delegations else {})
        meta = {f"{TARGETS}.json": MetaFile(targets.signed.version)}
        for plant in plants:
            if self._newest(plant) is None:
                raise UserError(f"{self._folder}: {plant} has signed nothing yet: edged release sign")
            there = self._load(plant)
            self._check(there, plant, targets.signed)
            meta[f"{plant}.json"] = MetaFile(there.signed.version)
        snapshot = Metadata(Snapshot(meta=meta))
        self._sign(snapshot, signer, SNAPSHOT, root.signed, days)
        stamp = Metadata(Timestamp(snapshot_meta=MetaFile(snapshot.signed.version)))
        self._sign(stamp, signer, TIMESTAMP, root.signed, days)
        return snapshot.signed

    # --- files --------------------------------------------------------------------------------------

    def _plant(self, plant: str) -> Metadata[Targets]:
        if self._newest(plant) is not None:
            return self._load(plant)
        return Metadata(Targets())

    def _newest(self, role: str) -> Path | None:
        """Metadata file of a role with the highest version; None without any."""
        if role == TIMESTAMP:
            return stamp if (stamp := self._metadata / "timestamp.json").is_file() else None
        found = re.compile(rf"([0-9]{{1,9}})\.{re.escape(role)}\.json")
        files = [*self._metadata.iterdir()] if self._metadata.is_dir() else []
        numbered = [(int(match[1]), file) for file in files if (match := found.fullmatch(file.name))]
        return max(numbered)[1] if numbered else None

    def _version(self, role: str) -> int:
        """Newest version of a role's metadata; 0 without any."""
        return 0 if self._newest(role) is None else int(self._load(role).signed.version)

    def _load(self, role: str) -> Metadata[Any]:
        file = self._newest(role)
        if file is None:
            raise UserError(f"{self._metadata}: no {role}.json: not a repository, or not finished")
        return metadata_at(file)

    def _sign(
        self,
        signed: Metadata[Any],
        signer: Signer,
        role: str,
        by: Root | Targets,
        days: float = SIGNED_DAYS,
    ) -> None:
        signed.signed.version = self._version(role) + 1
        signed.signed.expires = _in_days(days)
        signed.sign(signer)
        self._check(signed, role, by)
        self._write(signed, role)

    def _check(self, signed: Metadata[Any], role: str, by: Root | Targets) -> None:
        try:
            by.verify_delegate(role, signed.signed_bytes, signed.signatures)
        except (RepositoryError, ValueError) as error:
            raise UserError(
                f"{self._metadata}: {role}.json: {error}: signed with a key that does not count"
            ) from error

    def _write(self, signed: Metadata[Any], role: str = ROOT) -> Path:
        name = "timestamp.json" if role == TIMESTAMP else f"{signed.signed.version}.{role}.json"
        return _write_in(self._metadata, name, signed.to_bytes())


def metadata_at(file: Path) -> Metadata[Any]:
    """Load metadata from a file. Raises `FileFormatError`."""
    try:
        return Metadata[Any].from_bytes(read_bytes(file, "metadata of releases"))
    except (DeserializationError, RepositoryError) as error:
        raise FileFormatError(f"{file}: not metadata of releases: {error}") from error


def is_part(target: TargetFile) -> bool:
    """Whether a target is a part of a release, that is a wheel, and not a release itself."""
    return target.unrecognized_fields.get("custom") is None and target.path.endswith(".whl")


def offer_of(target: TargetFile) -> Offer:
    """Offer in a target's custom metadata. Raises `FileFormatError` for one without a valid offer."""
    custom = target.unrecognized_fields.get("custom")
    try:
        return Offer.model_validate(custom[CUSTOM] if isinstance(custom, dict) else custom)
    except (KeyError, ValueError) as error:
        raise FileFormatError(f"{target.path}: not a release of edged: {error}") from error


def _in_days(days: float) -> datetime:
    return (datetime.now(UTC) + timedelta(days=days)).replace(microsecond=0)


def _write_in(folder: Path, name: str, data: bytes) -> Path:
    with translated(FileFormatError, f"{folder}: cannot be made"):
        make_folders(folder)
    write_file(folder / name, data)
    return folder / name
