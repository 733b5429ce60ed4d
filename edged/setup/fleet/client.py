"""A cell's view of a repository, verified by python-tuf's client; on a web server or in a folder.

The client keeps the newest metadata that it has seen, so that an older repository is refused. No target is
read before its hash is checked.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit

from tuf.api.exceptions import (
    BadVersionNumberError,
    DownloadError,
    DownloadHTTPError,
    DownloadLengthMismatchError,
    ExpiredMetadataError,
    LengthOrHashMismatchError,
    RepositoryError,
    SlowRetrievalError,
    UnsignedMetadataError,
)
from tuf.api.metadata import TargetFile
from tuf.ngclient import FetcherInterface, Updater, UpdaterConfig
from urllib3.exceptions import HTTPError

from edged.errors import UserError
from edged.files.atomic import make_folders, read_bytes, write_atomically
from edged.setup.fleet.offers import FOLDER, STAGED, STAGED_OF, Offer, Staged, file_of, jobs_in_release
from edged.setup.fleet.repository import FILES, METADATA, is_part, metadata_at, offer_of
from edged.setup.fleet.wheelset import Wheel, wheels_in

CHUNK_BYTES = 1 << 20
CONFIG = UpdaterConfig(targets_max_length=5_000_000, max_delegations=1000)
"""Limits: with each release, a plant's metadata grow by its list of cells (`tools/bench fleet --plan`)."""
WHY = (
    (ExpiredMetadataError, "is old: what it says is no more in force, or somebody holds news back"),
    (BadVersionNumberError, "is older than what this cell has seen"),
    (UnsignedMetadataError, "is not signed by those who may"),
    (LengthOrHashMismatchError, "was changed: it is not what was signed"),
    (DownloadLengthMismatchError, "was changed: it is longer than what was signed"),
    (SlowRetrievalError, "answers too slowly"),
    (DownloadError, "is not whole"),
)


class Client:
    """Verified releases of one plant. folder : of the page, where the newest metadata is kept.

    place : https://..., or the path of a folder. root : the initial trusted root. Raises `UserError`, naming
    place and file, if the repository cannot be trusted.
    """

    def __init__(self, place: str, plant: str, root: bytes, folder: Path) -> None:
        self._place, self._plant = place.rstrip("/"), plant
        self._kept = folder / FOLDER
        make_folders(self._kept / METADATA)
        url = self._place if "://" in place else f"file://{quote(self._place)}"
        fetcher = FolderFetcher() if url.startswith("file:") else None
        with self._explained(METADATA):
            self._updater = Updater(
                str(self._kept / METADATA),
                f"{url}/{METADATA}/",
                target_base_url=f"{url}/{FILES}/",
                fetcher=fetcher,
                config=CONFIG,
                bootstrap=root,
            )
            self._updater.refresh()

    def offers(self) -> dict[str, Offer]:
        """All releases of the plant by path, in the order of their numbers."""
        found = {path: offer_of(target) for path, target in self._targets().items() if not is_part(target)}
        return dict(sorted(found.items(), key=lambda item: item[1].number))

    def fetch(self, path: str) -> bytes:
        """Download the content of a target."""
        target, draft = self._targets().get(path), self._kept / ".fetched"
        if target is None:
            raise UserError(f"{self._place}: {self._plant} has published no {path}")
        try:
            with self._explained(f"{FILES}/{path}"):
                self._updater.download_target(target, str(draft))
            return read_bytes(draft, "a release", target.length)
        finally:
            draft.unlink(missing_ok=True)

    def digest(self, path: str) -> str:
        """SHA-256 of a target."""
        return str(self._targets()[path].hashes["sha256"])

    def fetch_wheels(self, path: str, folder: Path) -> tuple[Wheel, ...]:
        """Fill a folder with exactly the wheels of a software release; present ones are not fetched again."""
        wheels = wheels_in(self.fetch(path), f"{self._place}: {path}")
        make_folders(folder)
        targets = self._targets()
        for wheel in wheels:
            target = targets.get(wheel.target(self._plant))
            if target is None or target.hashes["sha256"] != wheel.sha256:
                raise UserError(f"{self._place}: {path}: {wheel.file} is not signed")
            file = str(folder / wheel.file)
            with self._explained(f"{FILES}/{target.path}"):
                if self._updater.find_cached_target(target, file) is None:
                    self._updater.download_target(target, file)
        for other in folder.iterdir():
            if other.name not in {wheel.file for wheel in wheels}:
                other.unlink()
        return wheels

    def stage(self, path: str, offer: Offer) -> Staged:
        """Fetch a release of jobs or software, check that it can be read, and stage it for the gate."""
        data = self.fetch(path)
        (jobs_in_release if offer.kind == "jobs" else wheels_in)(data, f"{self._place}: {path}")
        staged = Staged(
            offer=offer, path=path, sha256=self._targets()[path].hashes["sha256"], repository=self._place
        )
        # the note is written last, so that the content it names exists
        write_atomically(self._kept / file_of(staged), data, is_state=True)
        for note in (STAGED, STAGED_OF.format(kind=offer.kind)):
            write_atomically(self._kept / note, staged.model_dump_json(indent=1).encode(), is_state=True)
        for other in self._kept.iterdir():
            if other.name.endswith((".tar.gz", ".cdx.json")) and other.name != file_of(staged):
                other.unlink(missing_ok=True)
        return staged

    def _targets(self) -> dict[str, TargetFile]:
        """Targets that the plant has signed and is allowed to sign."""
        with self._explained(f"{METADATA}/{self._plant}.json"):
            # loads the plant's metadata, and stores it once it is verified
            self._updater.get_targetinfo(f"{self._plant}/.")
            file = self._kept / METADATA / f"{self._plant}.json"
            if not file.is_file():
                raise UserError(f"{self._place}: {METADATA}/targets.json delegates nothing to {self._plant}")
            targets: dict[str, TargetFile] = metadata_at(file).signed.targets
            for path, target in targets.items():
                if self._updater.get_targetinfo(path) != target:
                    file = Path(METADATA, file.name)
                    raise UserError(f"{self._place}: {file}: {path} is not delegated to {self._plant}")
        return targets

    @contextmanager
    def _explained(self, file: str) -> Iterator[None]:
        """Translate errors of TUF and of its transport into messages for the cell's operators."""
        try:
            yield
        except (RepositoryError, DownloadError, HTTPError) as error:
            cause = error.__cause__ or error
            why = next((words for kind, words in WHY if isinstance(error, kind)), "is not what it should be")
            if isinstance(cause, HTTPError | OSError):
                why = "cannot be read"
            raise UserError(f"{self._place}: {file}: {why} ({cause or type(error).__name__})") from error
        except OSError as error:
            raise UserError(f"{self._place}: {file}: cannot be read ({error})") from error


class FolderFetcher(FetcherInterface):
    """Fetcher for a repository in a folder, for example on a USB stick."""

    def _fetch(self, url: str) -> Iterator[bytes]:
        try:
            with Path(unquote(urlsplit(url).path)).open("rb") as file:
                while some := file.read(CHUNK_BYTES):
                    yield some
        except FileNotFoundError as error:
            raise DownloadHTTPError(f"{url} is missing", 404) from error
