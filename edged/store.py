"""Files: rigs and array containers, written atomically, read with suspicion, never pickled."""

from __future__ import annotations

import ctypes
import errno
import hashlib
import io
import json
import math
import os
import shutil
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from edged.domain import FloatArray, Image
from edged.errors import FileFormatError, ImageError
from edged.vision.geometry.camera import DISTORTION_NAMES, CameraModel, StereoRig

RIG_FORMAT = "edged-rig"
RIG_VERSION = 1
MAX_FILE_BYTES = 64 * 1024 * 1024  # a rig is kilobytes, a model is megabytes: more is a wrong file


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file so that after a power cut either the old or the new content is there."""
    path = Path(path)
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)  # noqa: PTH101  (mkstemp makes it private; other users read rigs)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    _sync(path.parent)


def replace_folder(folder: Path, files: Mapping[str, bytes], keep: Path | None = None) -> bool:
    """Let a folder hold these files, by name, and no others; after a crash it is the former or the new one.

    keep : beside it, where a former folder that was not empty remains; what was there before is removed.
    Returns whether there was one. Raises `OSError`; then nothing has changed.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        for name, data in files.items():
            file = draft / name
            file.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(file, data)
        draft.chmod(0o755)  # mkdtemp makes it private
        in_use = folder.exists() and any(folder.iterdir())
        if in_use:
            if keep is not None and keep.exists():
                shutil.rmtree(keep)
            _exchange(draft, folder)
        else:
            draft.replace(folder)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise
    if in_use and keep is not None:
        draft.rename(keep)
    elif in_use:
        shutil.rmtree(draft, ignore_errors=True)
    _sync(folder.parent)
    return in_use


def _exchange(one: Path, other: Path) -> None:
    """Swap what two names mean, in one step: at no moment is either missing. Raises `OSError`.

    renameat2(2) with RENAME_EXCHANGE, of Linux. File systems of networks may not know it: there it is
    three steps, and a crash between them leaves `other` beside its name, as `one` with a dash.
    """
    at_fdcwd, rename_exchange = -100, 2
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.renameat2(at_fdcwd, os.fsencode(one), at_fdcwd, os.fsencode(other), rename_exchange) == 0:
        return
    number = ctypes.get_errno()
    if number not in (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP):
        raise OSError(number, os.strerror(number), str(one))
    aside = other.rename(one.with_name(f"{one.name}-"))
    try:
        one.rename(other)
    except BaseException:
        aside.rename(other)
        raise
    aside.rename(one)


def _sync(folder: Path) -> None:
    """Bring the names in a folder to the disc."""
    directory = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)


def read_bytes(path: Path, what: str) -> bytes:
    """Read a file of sane size, or raise `FileFormatError` that names it."""
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise FileFormatError(f"{path}: {size} bytes are too many for {what}")
        return path.read_bytes()
    except OSError as error:
        raise FileFormatError(f"{path}: cannot read {what}: {error.strerror or error}") from error


def load_image(path: Path) -> Image:
    """Read an 8-bit grey image (H, W) uint8; colour files are converted when all channels agree.

    Raises `ImageError` for what is no image, has another depth, or is really coloured.
    """
    path = Path(path)
    if not path.is_file():
        raise ImageError(f"{path}: no such file")
    return decode_image(path.read_bytes(), str(path))


def decode_image(data: bytes, place: str) -> Image:
    """`load_image` of bytes; place : what a message calls them."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if image is None:
        raise ImageError(f"{place}: not an image that can be read (PNG, TIFF, BMP and JPEG are)")
    if image.dtype != np.uint8:
        raise ImageError(f"{place}: {image.dtype} pixels, expected 8-bit grey")
    if image.ndim == 3:
        colour = image[..., :3]
        if np.ptp(colour.astype(np.int16), axis=2).max() > 0:
            raise ImageError(f"{place}: a colour image, expected 8-bit grey")
        image = colour[..., 0]
    return np.ascontiguousarray(image, dtype=np.uint8)


# --- rig.json ---------------------------------------------------------------------------------


def save_rig(path: Path, rig: StereoRig, quality: Mapping[str, Any] | None = None) -> None:
    """Write a rig as JSON. quality : figures of the calibration, kept for people."""
    document = {
        "format": RIG_FORMAT,
        "version": RIG_VERSION,
        "calibration_id": rig.calibration_id,
        "units": "mm, px (integer = pixel centre), distortion in normalised coordinates; "
        "x_right = right_from_left x_left",
        "left": _camera_to_json(rig.left),
        "right": _camera_to_json(rig.right),
        "right_from_left": rig.right_from_left.tolist(),
        "robot_from_rig": None if rig.robot_from_rig is None else rig.robot_from_rig.tolist(),
        "flange_from_rig": None if rig.flange_from_rig is None else rig.flange_from_rig.tolist(),
        "registration_covariance": None
        if rig.registration_covariance is None
        else rig.registration_covariance.tolist(),
        "covariance": None
        if rig.covariance is None
        else {"parameters": list(rig.parameter_names), "matrix": rig.covariance.tolist()},
        "quality": dict(quality or {}),
    }
    write_atomically(path, (json.dumps(document, indent=1) + "\n").encode())


def keep_old_rig(path: Path) -> Path | None:
    """Copy a rig that is about to be replaced beside it, under its own calibration id.

    That id is in every result the rig ever gave. Returns the copy, or None where there is no rig.
    """
    if not path.exists():
        return None
    data = read_bytes(path, "a rig")
    try:
        identity = str(json.loads(data)["calibration_id"])
    except (ValueError, TypeError, KeyError, RecursionError):
        identity = "old"
    safe = "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "-" for c in identity)[:60]
    kept = path.with_name(f"{path.stem}.{safe}{path.suffix}")
    write_atomically(kept, data)
    return kept


def load_rig(path: Path) -> StereoRig:
    """Read a rig; every flaw is a `FileFormatError` that names the file, the field and the expectation."""
    path = Path(path)
    try:
        document = json.loads(read_bytes(path, "a rig"))
    except ValueError as error:
        raise FileFormatError(f"{path}: not JSON: {error}") from error
    if not isinstance(document, dict) or document.get("format") != RIG_FORMAT:
        raise FileFormatError(f'{path}: not a rig file (expected "format": "{RIG_FORMAT}")')
    if document.get("version") != RIG_VERSION:
        raise FileFormatError(f"{path}: version {document.get('version')!r}, this edged reads {RIG_VERSION}")
    reader = _Fields(path, document)
    left, right = _camera_from_json(reader.sub("left")), _camera_from_json(reader.sub("right"))
    right_from_left = reader.transform("right_from_left")
    if float(np.linalg.norm(right_from_left[:3, 3])) <= 0:
        raise FileFormatError(f"{path}: right_from_left: both cameras are in one place")
    robot = None if document.get("robot_from_rig") is None else reader.transform("robot_from_rig")
    flange = None if document.get("flange_from_rig") is None else reader.transform("flange_from_rig")
    if robot is not None and flange is not None:
        raise reader.error("flange_from_rig", "a rig is fixed to the robot's base or to its flange, not both")
    identity = document.get("calibration_id")
    if not isinstance(identity, str) or not identity:
        raise FileFormatError(f"{path}: calibration_id: expected a name, got {identity!r}")
    registration = None
    if document.get("registration_covariance") is not None:
        registration = reader.array("registration_covariance", (6, 6))
        _check_covariance(registration, f"{path}: registration_covariance")
    rig = StereoRig(left, right, right_from_left, identity, robot, None, registration, flange)
    stored = document.get("covariance")
    if stored is None:
        return rig
    size = len(rig.parameter_names)
    covariance = reader.sub("covariance").array("matrix", (size, size))
    if stored.get("parameters") != list(rig.parameter_names):
        raise FileFormatError(f"{path}: covariance.parameters: expected {list(rig.parameter_names)}")
    _check_covariance(covariance, f"{path}: covariance.matrix")
    return replace(rig, covariance=covariance)


def load_rig_quality(path: Path) -> dict[str, Any]:
    """The figures that `save_rig` kept for people; {} where there are none."""
    try:
        quality = json.loads(read_bytes(Path(path), "a rig")).get("quality")
    except (ValueError, AttributeError) as error:
        raise FileFormatError(f"{path}: not a rig file: {error}") from error
    return quality if isinstance(quality, dict) else {}


def _check_covariance(matrix: FloatArray, place: str) -> None:
    if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-30) or (np.diag(matrix) < 0).any():
        raise FileFormatError(f"{place}: not a covariance (symmetric, positive)")


def _camera_to_json(camera: CameraModel) -> dict[str, Any]:
    return {
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "distortion": dict(zip(DISTORTION_NAMES[camera.model], camera.distortion, strict=True)),
    }


def _camera_from_json(reader: _Fields) -> CameraModel:
    model = reader.document.get("model")
    if model not in DISTORTION_NAMES:
        raise reader.error("model", f"expected one of {sorted(DISTORTION_NAMES)}, got {model!r}")
    distortion = reader.sub("distortion")
    fx, fy = reader.number("fx"), reader.number("fy")
    if fx <= 0 or fy <= 0:
        raise reader.error("fx", f"focal lengths must be positive, got {fx}, {fy}")
    return CameraModel(
        model,
        reader.integer("width"),
        reader.integer("height"),
        fx,
        fy,
        reader.number("cx"),
        reader.number("cy"),
        tuple(distortion.number(name) for name in DISTORTION_NAMES[model]),
    )


class _Fields:
    """Reads typed fields of a JSON object and names the place when one is wrong."""

    def __init__(self, path: Path, document: dict[str, Any], prefix: str = "") -> None:
        self.path, self.document, self.prefix = path, document, prefix

    def error(self, name: str, problem: str) -> FileFormatError:
        return FileFormatError(f"{self.path}: {self.prefix}{name}: {problem}")

    def sub(self, name: str) -> _Fields:
        value = self.document.get(name)
        if not isinstance(value, dict):
            raise self.error(name, f"expected an object, got {type(value).__name__}")
        return _Fields(self.path, value, f"{self.prefix}{name}.")

    def number(self, name: str) -> float:
        value = self.document.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise self.error(name, f"expected a number, got {value!r}")
        return float(value)

    def integer(self, name: str) -> int:
        value = self.document.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 < value < 100_000:
            raise self.error(name, f"expected a size in pixels, got {value!r}")
        return value

    def array(self, name: str, shape: tuple[int, ...]) -> FloatArray:
        try:
            value = np.array(self.document.get(name), dtype=np.float64)
        except (TypeError, ValueError):
            raise self.error(name, f"expected numbers in the shape {shape}") from None
        if value.shape != shape or not np.isfinite(value).all():
            raise self.error(name, f"expected finite numbers in the shape {shape}, got {value.shape}")
        return value

    def transform(self, name: str) -> FloatArray:
        value = self.array(name, (4, 4))
        rotation = value[:3, :3]
        rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) and np.linalg.det(rotation) > 0
        if not rigid or not np.allclose(value[3], (0, 0, 0, 1)):
            raise self.error(name, "expected a rigid 4x4 transform (rotation and translation)")
        return value


# --- array containers ---------------------------------------------------------------------------


def pack_arrays(kind: str, version: int, arrays: Mapping[str, npt.NDArray[Any]]) -> bytes:
    """Named arrays as one checksummed .npz (a zip of .npy; no pickle)."""
    buffer = io.BytesIO()
    header = json.dumps({"kind": kind, "version": version, "sha256": _digest(arrays)})
    np.savez_compressed(buffer, __header__=np.array(header), **dict(arrays))  # type: ignore[arg-type]
    return buffer.getvalue()


def load_arrays(path: Path, kind: str, version: int) -> dict[str, npt.NDArray[Any]]:
    """Read a file of `pack_arrays`; damage, another kind or version is a `FileFormatError`."""
    path = Path(path)
    data = read_bytes(path, f"a {kind}")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            unpacked = sum(member.file_size for member in archive.infolist())
            if unpacked > MAX_FILE_BYTES:
                raise FileFormatError(f"{path}: unpacks to {unpacked} bytes, too many for a {kind}")
            for member in archive.infolist():
                _check_claim(archive, member)
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        header = json.loads(str(arrays.pop("__header__")[()]))
        found = (header["kind"], header["version"], header["sha256"])
    except FileFormatError:
        raise
    except Exception as error:
        raise FileFormatError(f"{path}: not a {kind} file, or damaged: {error}") from error
    if found[0] != kind:
        raise FileFormatError(f"{path}: a {found[0]!r} file, expected {kind!r}")
    if found[1] != version:
        raise FileFormatError(f"{path}: {kind} version {found[1]!r}, this edged reads {version}")
    if found[2] != _digest(arrays):
        raise FileFormatError(f"{path}: checksum does not match: the file is damaged")
    return arrays


def _check_claim(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> None:
    """numpy makes room for what an array's header claims before it reads: that must be what is there."""
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"{member.filename}: unknown version of the .npy format {version}")
        read = np.lib.format.read_array_header_1_0 if version[0] == 1 else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file)
        # python integers: no claim is too large to be counted
        if math.prod(shape, start=dtype.itemsize) != member.file_size - file.tell():
            raise ValueError(f"{member.filename}: claims {shape} {dtype}, which is not what the file holds")


def _digest(arrays: Mapping[str, npt.NDArray[Any]]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name}:{array.dtype.str}:{array.shape};".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
