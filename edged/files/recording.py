"""Recordings: one exposure with its result in one file, enough to reproduce the result bit for bit.

    FOLDER/cycles/000000042_20260131T235959.123456Z_OK_1a2b3c4d.zip   left.png, right.png, recording.json
    FOLDER/setups/1a2b3c4d/...                                        rig, jobs, configuration of that cycle

The first number counts recordings and continues after a restart, so that the order of files does not depend
on a clock that may jump; the last part is the fingerprint of the setup. Files are written atomically.
"""

from __future__ import annotations

import io
import json
import platform
import re
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np

from edged import __version__
from edged.domain.arrays import SIDES, Image, Side
from edged.domain.belt import Belt, BeltMoment, Source
from edged.domain.events import Snapshot
from edged.domain.frames import Frame, FramePair
from edged.domain.marks import MarksTrack
from edged.domain.numerals import json_of
from edged.errors import FileFormatError, ImageError
from edged.files.atomic import (
    MAX_DOCUMENT_BYTES,
    MAX_FILE_BYTES,
    make_folders,
    read_bytes,
    replace_folder,
    sync,
    write_atomically,
)
from edged.files.images import decode_image
from edged.files.jsonfields import JsonFields
from edged.files.zipmembers import open_zip, read_member
from edged.owners import file_to_read
from edged.payload import Json, snapshot_to_json

FORMAT = "edged-recording"
VERSION = 1
NAME = re.compile(
    r"(?P<index>[0-9]{9})_(?P<utc>[0-9]{8}T[0-9]{6}\.[0-9]{6}Z)_(?P<status>[A-Z_]+)_"
    r"(?P<fingerprint>[0-9a-f]{8})\.zip"
)
DOCUMENT = "recording.json"
PICTURES: dict[Side, str] = {side: f"{side}.png" for side in SIDES}
_DAMAGE = (zipfile.BadZipFile, zlib.error, KeyError, ValueError, EOFError, NotImplementedError, RuntimeError)
"""Errors raised when reading a damaged ZIP or its JSON."""
PNG_QUICK = (cv2.IMWRITE_PNG_COMPRESSION, 1)
"""Lossless at any level; higher ones take three times as long for a tenth less."""


MOST_COLUMNS = 512
"""Most columns of `cross`: 8 for each mark, see `edged.files.marks.MAX_TAUGHT`."""


@dataclass(frozen=True, slots=True)
class Entry:
    """Facts in a recording's file name, which a ring buffer needs without opening the file."""

    path: Path
    index: int
    recorded: datetime
    status: str
    fingerprint: str


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """The contents of one file.

    snapshot : as published (`payload.snapshot_to_json`).  versions : of the software that computed it.
    pair : None if there was no exposure (a camera fault). marks_before : state of the tracking of reference
    marks before the exposure; None without marks. belt, moment : the belt that carried the parts and its
    position; None as in `Snapshot`.
    """

    snapshot: Json
    versions: Mapping[str, str]
    pair: FramePair | None
    marks_before: MarksTrack | None = None
    belt: Belt | None = None
    moment: BeltMoment | None = None


def versions() -> dict[str, str]:
    """Versions of the software that a result depends on."""
    return {
        "edged": __version__,
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "opencv": cv2.__version__,
        "numba": version("numba"),
        "machine": platform.machine(),
    }


def encode(snapshot: Snapshot, pair: FramePair | None) -> bytes:
    """Content of the recording of one cycle."""
    frames = {} if pair is None else {"left": pair.left, "right": pair.right}
    document = {
        "format": FORMAT,
        "version": VERSION,
        "versions": versions(),
        "snapshot": snapshot_to_json(snapshot),
        "frames": {
            side: {
                "camera": frame.camera,
                "frame_id": frame.frame_id,
                "device_ns": frame.device_ns,
                "exposed_ns": frame.exposed_ns,
                **({} if frame.count is None else {"count": frame.count}),
            }
            for side, frame in frames.items()
        },
    }
    if snapshot.marks_before is not None:
        document["marks_before"] = _track_to_json(snapshot.marks_before)
    if snapshot.carried_by is not None:
        document["belt"] = asdict(snapshot.carried_by)
    if snapshot.belt is not None:
        document["belt_moment"] = asdict(snapshot.belt)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:  # PNG is compressed already
        for side, frame in frames.items():
            archive.writestr(_member(f"{side}.png"), _png(frame.image))
        archive.writestr(_member(DOCUMENT), json.dumps(document, allow_nan=False, indent=1))
    return buffer.getvalue()


def decode(data: bytes, place: str) -> Recording:
    """Parse the content of a recording. Raises `FileFormatError` that names place, member and expectation."""
    try:
        with open_zip(io.BytesIO(data)) as archive:
            wanted = {DOCUMENT, *PICTURES.values()} & set(archive.namelist())
            members = {name: _read(archive, name) for name in wanted}
        document = json_of(members[DOCUMENT])
    except _DAMAGE as error:
        raise FileFormatError(f"{place}: not a recording: {error}") from error
    snapshot = _snapshot_of(document, place)
    made_by, frames = (_table(document, key, place) for key in ("versions", "frames"))
    pair = None
    if frames:
        pair = FramePair(*(_frame(side, frames, members, place) for side in SIDES))
    before = None
    if "marks_before" in document:
        before = _track(_table(document, "marks_before", place), place)
    belt, moment = _belt(document, place)
    return Recording(snapshot, {str(k): str(v) for k, v in made_by.items()}, pair, before, belt, moment)


def _belt(document: Json, place: str) -> tuple[Belt | None, BeltMoment | None]:
    """The belt and its position at the exposure. Raises `FileFormatError`."""
    belt = moment = None
    try:
        if "belt" in document:
            values: dict[str, Any] = {**document["belt"]}
            x, y, z = map(_number, values.pop("step_mm"))
            a, b, c = map(_number, values.pop("first_mm"))
            if values.pop("source") not in get_args(Source) or values["counts"] < 1 or not any((x, y, z)):
                raise ValueError("expected what `[belt]` of a configuration has")
            for name in values:
                _number(values[name])
            belt = Belt((x, y, z), (a, b, c), source=document["belt"]["source"], **values)
        if "belt_moment" in document:
            moment = BeltMoment(**{name: _number(of) for name, of in document["belt_moment"].items()})
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise FileFormatError(f"{place}: belt: {error}") from error
    return belt, moment


def _number(value: Any) -> float:
    """Number of a JSON value. Raises `TypeError`, `OverflowError`."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"expected a number, got {value!r}")
    return float(value)


def _track_to_json(track: MarksTrack) -> Json:
    """All fields of a track, without loss of precision."""
    return {
        field.name: value.tolist() if isinstance(value, np.ndarray) else value
        for field in fields(track)
        for value in [getattr(track, field.name)]
    }


def _track(document: dict[str, Any], place: str) -> MarksTrack:
    """Parse the track written by `_track_to_json`. Raises `FileFormatError`."""
    reader = JsonFields(Path(place), document, "marks_before.")
    cross = document.get("cross")
    columns = len(cross[0]) if isinstance(cross, list) and cross and isinstance(cross[0], list) else 0
    if columns > MOST_COLUMNS or columns % 8:
        raise reader.error("cross", f"{columns} columns: expected 8 for each mark, at most {MOST_COLUMNS}")
    counts = {}
    for name, most in (("exposed_ns", 2**63 - 1), ("wait", 1000), ("searched", 1000), ("blank", 1000)):
        value = document.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
            raise reader.error(name, f"expected a whole number from 0 to {most}, got {value!r}")
        counts[name] = value
    knocked = document.get("knocked")
    if not isinstance(knocked, bool):
        raise reader.error("knocked", f"expected true or false, got {knocked!r}")
    return MarksTrack(
        reader.array("displacement", (14,)),
        reader.covariance("covariance", 14),
        reader.array("cross", (14, columns)),
        reader.array("maps", (14,)),
        knocked=knocked,
        **counts,
    )


def _snapshot_of(document: Any, place: str) -> Json:
    """The snapshot in a recording's document, with the fields that every caller needs checked."""
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise FileFormatError(f'{place}: not a recording (expected "format": "{FORMAT}")')
    if document.get("version") != VERSION:
        raise FileFormatError(f"{place}: version {document.get('version')!r}, this edged reads {VERSION}")
    snapshot = _table(document, "snapshot", place)
    for key, kind in (("status", str), ("job", str), ("job_number", int), ("cycle", int)):
        if not isinstance(snapshot.get(key), kind):
            raise FileFormatError(f"{place}: snapshot.{key}: expected {kind.__name__}")
    return snapshot


def load_snapshot(path: Path) -> tuple[Json, bool]:
    """Load the snapshot of one recording, and whether it has pictures, without reading those.

    Raises `FileFormatError`.
    """
    members, names = _members_of(path, (DOCUMENT,))
    try:
        document = json_of(members[DOCUMENT])
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: not a recording: {error}") from error
    return _snapshot_of(document, str(path)), names.issuperset(PICTURES.values())


def load_picture(path: Path, side: Side) -> Image:
    """Load one picture of a recording. Raises `FileFormatError`."""
    name = PICTURES[side]
    data = _members_of(path, (name,))[0][name]
    try:
        return decode_image(data, f"{path}/{name}")
    except ImageError as error:
        raise FileFormatError(str(error)) from error


def _members_of(path: Path, wanted: Iterable[str]) -> tuple[dict[str, bytes], set[str]]:
    """Contents of the wanted members of a file, each of limited size, and the names of all members."""
    try:
        if not path.is_file() or path.stat().st_size > MAX_FILE_BYTES:
            raise FileFormatError(f"{path}: no file of a recording")
        with file_to_read(path) as file, open_zip(file) as archive:
            return {name: _read(archive, name) for name in wanted}, set(archive.namelist())
    except (*_DAMAGE, OSError) as error:
        raise FileFormatError(f"{path}: not a recording: {error}") from error


def _read(archive: zipfile.ZipFile, name: str) -> bytes:
    most_bytes = MAX_DOCUMENT_BYTES if name == DOCUMENT else MAX_FILE_BYTES
    return read_member(archive, archive.getinfo(name), most_bytes)


def load(path: Path) -> Recording:
    """Read one recording. Raises `FileFormatError`."""
    return decode(read_bytes(path, "a recording"), str(path))


def save(folder: Path, index: int, recorded: datetime, snapshot: Snapshot, pair: FramePair | None) -> Entry:
    """Write one recording into FOLDER/cycles. Raises `OSError`."""
    utc = recorded.astimezone(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
    cycles = folder / "cycles"
    make_folders(cycles)
    path = cycles / f"{index:09d}_{utc}_{snapshot.status}_{snapshot.fingerprint}.zip"
    write_atomically(path, encode(snapshot, pair))
    return Entry(path, index, recorded, str(snapshot.status), snapshot.fingerprint)


def entries(folder: Path) -> list[Entry]:
    """The recordings of a folder, oldest first; other files are ignored."""
    found = (_entry(path) for path in (folder / "cycles").glob("*.zip"))
    return sorted((entry for entry in found if entry is not None), key=lambda entry: entry.index)


def find(folder: Path, index: int) -> Entry | None:
    """The recording with this number; None if there is none."""
    found = (_entry(path) for path in (folder / "cycles").glob(f"{index:09d}_*.zip"))
    return next((entry for entry in found if entry is not None), None)


def _entry(path: Path) -> Entry | None:
    parts = NAME.fullmatch(path.name)
    if parts is None:
        return None
    try:
        recorded = datetime.strptime(parts["utc"], "%Y%m%dT%H%M%S.%fZ").replace(tzinfo=UTC)
    except ValueError:  # a date that does not exist: not a file of ours
        return None
    return Entry(path, int(parts["index"]), recorded, parts["status"], parts["fingerprint"])


def save_setup(folder: Path, fingerprint: str, files: Mapping[str, bytes]) -> None:
    """Store the setup of this fingerprint unless it is there already. Raises `OSError`."""
    target = setup_folder(folder, fingerprint)
    if not target.is_dir():
        replace_folder(target, files)


def forget_setups(folder: Path, fingerprints: Iterable[str]) -> None:
    """Remove setups that no recording needs any longer, each atomically. Raises `OSError`."""
    unused = [place for name in fingerprints if (place := setup_folder(folder, name)).is_dir()]
    if unused and (folder / "cycles").is_dir():
        sync(folder / "cycles")  # the removal of the recordings must reach the disc first
    for place in unused:
        aside = Path(tempfile.mkdtemp(prefix=f".{place.name}.", dir=place.parent))
        place.replace(aside)
        sync(place.parent)
        shutil.rmtree(aside, ignore_errors=True)  # `sweep` removes what is left


def setup_folder(folder: Path, fingerprint: str) -> Path:
    """Folder of the rig, jobs and configuration of a fingerprint."""
    return folder / "setups" / fingerprint


def setups(folder: Path) -> set[str]:
    """Fingerprints of the stored setups."""
    return {path.name for path in (folder / "setups").glob("[0-9a-f]*") if path.is_dir()}


def sweep(folder: Path) -> int:
    """Remove temporary files and folders left by an interrupted writer; returns how many."""
    left = [*(folder / "cycles").glob(".*"), *(folder / "setups").glob(".*")]
    for path in left:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
    return len(left)


def _member(name: str) -> zipfile.ZipInfo:
    """A member with a fixed date: ZIP has none before 1980, and a PC without a battery starts in 1970."""
    member = zipfile.ZipInfo(name)
    member.external_attr = 0o644 << 16
    return member


def _png(image: Image) -> bytes:
    encoded, data = cv2.imencode(".png", image, PNG_QUICK)
    if not encoded:
        raise ImageError(f"an image of shape {image.shape} cannot be written as PNG")
    return data.tobytes()


def _table(document: Mapping[str, Any], key: str, place: str) -> dict[str, Any]:
    value = document.get(key)
    if not isinstance(value, dict):
        raise FileFormatError(f"{place}: {key}: expected an object")
    return value


def _frame(side: Side, frames: Mapping[str, Any], members: Mapping[str, bytes], place: str) -> Frame:
    facts = _table(frames, side, place)
    numbers = [facts.get(key) for key in ("frame_id", "device_ns", "exposed_ns")]
    if not all(isinstance(number, int) for number in numbers):
        raise FileFormatError(f"{place}: frames.{side}: expected integers frame_id, device_ns, exposed_ns")
    count = facts.get("count")
    if not isinstance(count, int | None):
        raise FileFormatError(f"{place}: frames.{side}.count: expected an integer")
    name = PICTURES[side]
    if name not in members:
        raise FileFormatError(f"{place}: {name} is missing")
    try:
        image = decode_image(members[name], f"{place}/{name}")
    except ImageError as error:
        raise FileFormatError(str(error)) from error
    frame_id, device_ns, exposed_ns = (int(number) for number in numbers if number is not None)
    return Frame(str(facts.get("camera", side)), frame_id, image, device_ns, exposed_ns, count=count)
