"""Small files that claim, or unpack to, more than a PC holds are refused early, with a sentence."""

from __future__ import annotations

import bz2
import functools
import gzip
import io
import json
import os
import re
import shutil
import struct
import subprocess
import sys
import tarfile
import zipfile
import zlib
from collections.abc import Callable

import cv2
import ezdxf
import numpy as np
import pytest
from helpers import boundedreading

from edged.config.tomltext import MAX_KEY_PARTS, toml_of
from edged.files.imagesizes import claimed_size

MIB = 1 << 20
DOCUMENT = {
    "format": "edged-recording",
    "version": 1,
    "versions": {},
    "snapshot": {"status": "OK", "job": "a", "job_number": 1, "cycle": 1},
    "frames": {side: {"frame_id": 0, "device_ns": 0, "exposed_ns": 0} for side in ("left", "right")},
}


BOMB_BYTES = 320 * MIB
"""More than the reading process may take (`boundedreading.ROOM_BYTES`)."""


def deflated(count: int) -> bytes:
    """This many zeros, deflated without a header, from repeated pieces, because compressing them all takes
    seconds."""
    packer = zlib.compressobj(9, wbits=-zlib.MAX_WBITS)
    rest = packer.compress(bytes(count % MIB)) + packer.flush(zlib.Z_FULL_FLUSH)
    piece = packer.compress(bytes(MIB)) + packer.flush(zlib.Z_FULL_FLUSH)
    return rest + count // MIB * piece + packer.flush()


def zeros(count: int) -> bytes:
    """This many zeros, in zlib's format."""
    return b"\x78\xda" + deflated(count) + struct.pack(">I", count % 65521 << 16 | 1)


def png(width: int, height: int, pixels: bytes, colours: int = 0, depth: int = 8) -> bytes:
    """A PNG. pixels : deflated, each row behind a zero."""
    head = struct.pack(">IIBBBBB", width, height, depth, colours, 0, 0, 0)
    parts = ((b"IHDR", head), (b"IDAT", pixels), (b"IEND", b""))
    chunks = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def tiff(width: int, height: int, tile: int) -> bytes:
    """The header of a tiled TIFF."""
    numbers = ((256, width), (257, height), (258, 8), (259, 8), (262, 1), (277, 1), (322, tile), (323, tile))
    entries = [struct.pack("<HHII", tag, 4, 1, value) for tag, value in (*numbers, (324, 8), (325, 8))]
    return b"II*\0" + struct.pack("<IH", 8, len(entries)) + b"".join(entries) + bytes(4)


def jpeg(width: int, height: int) -> bytes:
    """A small JPEG whose header states another size."""
    small = cv2.imencode(".jpg", np.zeros((8, 8), np.uint8))[1].tobytes()
    size = struct.pack(">HH", 8, 8)
    assert 1 == small.count(b"\xff\xc0\x00\x0b\x08" + size)
    return small.replace(b"\x0b\x08" + size, b"\x0b\x08" + struct.pack(">HH", height, width))


def zipped(members: dict[str, bytes]) -> bytes:
    """A ZIP of these members."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return out.getvalue()


@functools.cache
def bzip2(count: int) -> bytes:
    """This many zeros, in bzip2's format."""
    return bz2.compress(bytes(count))


def lying(name: str, method: int) -> bytes:
    """A ZIP with a large member of zeros that states a size of a hundred."""
    data = bzip2(BOMB_BYTES) if method == zipfile.ZIP_BZIP2 else deflated(BOMB_BYTES)
    head = struct.pack("<5H3I", 20, 0, method, 0, 33, zlib.crc32(bytes(BOMB_BYTES)), len(data), 100)
    local = b"PK\3\4" + head + struct.pack("<2H", len(name), 0) + name.encode() + data
    directory = b"PK\1\2" + struct.pack("<H", 20) + head + struct.pack("<5H2I", len(name), 0, 0, 0, 0, 0, 0)
    directory += name.encode()
    return local + directory + struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 1, 1, len(directory), len(local), 0)


def recording_of(picture: bytes) -> bytes:
    """A recording with this picture on both sides."""
    return zipped(
        {"left.png": picture, "right.png": picture, "recording.json": json.dumps(DOCUMENT).encode()}
    )


def crowded() -> bytes:
    """The directory of a ZIP with very many members, without their data."""
    rest = (20, 20, 0, 0, 0, 0, 0, 0, 0, 8, 0, 0, 0, 0, 0, 0)
    entry = b"PK\1\2" + struct.pack("<6H3I5H2I", *rest)
    directory = b"".join(entry + b"%08d" % number for number in range(800_000))
    return directory + struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 65535, 65535, len(directory), 0, 0)


def tarred(size: int) -> bytes:
    """An archive of one file of zeros."""
    member = tarfile.TarInfo("cell.toml")
    member.size = size
    # gzip's members follow one another
    return gzip.compress(member.tobuf()) + gzip.compress(bytes(MIB)) * (size // MIB + 1)


def drawing(kind: str) -> bytes:
    """A DXF drawing in a small file."""
    document = ezdxf.new(units=4)
    space = document.modelspace()
    points = [(number % 7, 0.001 * number) for number in range(12_000)]
    match kind:
        case "fit points":
            space.add_spline(fit_points=points)
        case "many splines":
            for _ in range(100):
                space.add_spline(fit_points=points[:900])
        case "placed polyline":
            document.blocks.new("part").add_lwpolyline(points)
        case "placed hatch":
            document.blocks.new("part").add_hatch().paths.add_polyline_path(points)
    if "placed" in kind:
        for number in range(400):
            space.add_blockref("part", (number, 0))
    out = io.StringIO()
    document.write(out)
    return out.getvalue().encode()


def yaml() -> bytes:
    """Nested YAML lists, each with ten aliases of the list before."""
    lists = [f"a{level}: &a{level} [{','.join([f'*a{level - 1}'] * 10)}]" for level in range(1, 9)]
    named = [f"{name}: *a8" for name in ("M1", "M2", "D1", "D2", "R", "T", "image_size")]
    return "\n".join(["a0: &a0 [1,1,1,1,1,1,1,1,1,1]", *lists, *named]).encode()


def rig(width: int) -> bytes:
    """A rig for enormous pictures."""
    camera = {
        "model": "division", "width": width, "height": width, "fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0,
        "distortion": {"kappa": 0.0},
    }  # fmt: skip
    shifted = [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    head = {"format": "edged-rig", "version": 1, "calibration_id": "a"}
    return json.dumps({**head, "left": camera, "right": camera, "right_from_left": shifted}).encode()


OBJECTS = b"[" + b"{}," * (10 * MIB) + b"{}]"
BOMBS: list[tuple[str, str, Callable[[], bytes], str]] = [
    ("picture", "png", lambda: png(20_000, 20_000, zeros(20_001 * 20_000)), "20000x20000 pixels"),
    ("picture", "png of 64 bits", lambda: png(8_000, 8_000, zeros(64_001 * 8_000), 6, 16), "512000000 bytes"),
    ("picture", "jpeg", lambda: jpeg(65_000, 65_000), "65000x65000 pixels"),
    ("picture", "tiff of one tile", lambda: tiff(8, 8, 32_000), "32000x32000 pixels"),
    ("picture", "pgm", lambda: b"P5\n# a camera's\n40000 40000\n255\n", "40000x40000 pixels"),
    ("recording", "pictures", lambda: recording_of(png(20_000, 20_000, zeros(20_001 * 20_000))), "pixels"),
    ("recorded picture", "pictures", lambda: recording_of(png(30_000, 30_000, b"")), "30000x30000 pixels"),
    ("recording", "bzip2", lambda: lying("recording.json", zipfile.ZIP_BZIP2), "or deflated"),
    (
        "snapshot",
        "deflated",
        lambda: lying("recording.json", zipfile.ZIP_DEFLATED),
        "recording.json",
    ),
    ("recording", "objects", lambda: zipped({"recording.json": OBJECTS}), ".json: .* at most 4194304"),
    ("snapshot", "directory", crowded, "directory: expected at most 65536 bytes"),
    ("shape", "bzip2", lambda: lying("a.npy", zipfile.ZIP_BZIP2), "a.npy: expected it stored"),
    ("rig", "objects", lambda: b'{"format":"edged-rig","x":' + OBJECTS + b"}", "too many for a rig"),
    ("rig", "pixels", lambda: rig(99_999), "left.width: 99999x99999: expected at most 67108864"),
    ("opencv", "aliases", yaml, "[0-9]+ values: expected camera parameters, at most 50000"),
    ("table", "one line", lambda: b"1," * (15 * MIB), "line 1: 31457280 letters: expected at most 10000"),
    ("table", "empty lines", lambda: b"\n" * (60 * MIB), "at most 33554432"),
    ("model", "corners", lambda: b"solid\n" + b"vertex 1 1 1\n" * (4 * MIB) + b"endsolid", "no facet"),
    ("configuration", "key", lambda: b".".join([b"a"] * 20_000) + b"=1", "line 1: .* more than 16 parts"),
    ("archive", "zeros", lambda: tarred(280 * MIB), "unpacks to more than 256 MiB"),
    ("drawing", "fit points", lambda: drawing("fit points"), "spline through 12000 points: expected at most"),
    ("drawing", "splines", lambda: drawing("many splines"), "20000 points that splines are drawn through"),
    ("drawing", "polyline", lambda: drawing("placed polyline"), "more than 500000 points"),
    ("drawing", "hatch", lambda: drawing("placed hatch"), "no closed outline"),
]


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The outcome of reading each bomb, by its name, which is also the file's name."""
    folder = tmp_path_factory.mktemp("bombs")
    words: list[str] = []
    for reader, what, bomb, _ in BOMBS:
        path = folder / name_of(reader, what)
        path.write_bytes(bomb())
        words += [reader, str(path)]
    ended = subprocess.run(
        [sys.executable, boundedreading.__file__, *words],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"},
        timeout=600,
        check=True,
    )
    shutil.rmtree(folder)
    lines = [json.loads(line) for line in ended.stdout.splitlines()]
    return {
        name_of(reader, what): line.get("refused", f"failed: {line}")
        for (reader, what, _, _), line in zip(BOMBS, lines, strict=True)
    }


def name_of(reader: str, what: str) -> str:
    """The name of a bomb."""
    return f"{reader}: {what}"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "expected"), [pytest.param(name_of(*one[:2]), one[3], id=name_of(*one[:2])) for one in BOMBS]
)
def test_a_bomb_is_refused_before_it_unpacks(name: str, expected: str, outcomes: dict[str, str]) -> None:
    """Within 300 MiB and 20 s each bomb is refused with the file and what was expected."""
    assert re.search(rf"/{name}\b.*{expected}", outcomes[name], re.DOTALL), outcomes[name]


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif", ".pgm", ".ppm"])
@pytest.mark.parametrize("shape", [(7, 11), (7, 11, 3), (7, 11, 4)])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_the_size_of_a_picture_is_known_without_it(
    suffix: str, shape: tuple[int, ...], kind: type[np.uint8 | np.uint16]
) -> None:
    """The claimed size is right for everything that OpenCV writes, and not less than the unpacked size."""
    if suffix in (".pgm", ".ppm"):  # one is grey, the other has no transparency
        shape = (7, 11) if suffix == ".pgm" else (7, 11, 3)
    written, data = cv2.imencode(suffix, np.ones(shape, kind))
    back = cv2.imdecode(np.asarray(data), cv2.IMREAD_UNCHANGED)
    claimed = claimed_size(data.tobytes())

    assert written
    assert back is not None
    assert claimed is not None
    assert (11, 7) == (claimed.width, claimed.height)
    assert claimed.unpacked_bytes >= back.nbytes


@pytest.mark.parametrize(
    "data", [b"", b"GIF89a", b"\x89PNG\r\n\x1a\n", b"BM", b"II*\0\xff\xff\xff\xff", b"P5 7"]
)
def test_a_damaged_head_says_no_size(data: bytes) -> None:
    """A damaged header, or one of an unknown format, gives no size."""
    assert claimed_size(data) is None


def test_only_keys_are_counted() -> None:
    """Only the parts of keys are counted, not dots in numbers and texts, and a key may have the most
    parts."""
    dots = "." * 100
    key = ".".join(["a"] * MAX_KEY_PARTS)

    assert {"text": dots, "numbers": [1.0] * 100} == toml_of(
        f'text = "{dots}"  # {dots}\nnumbers = [{", ".join(["1.0"] * 100)}]'
    )
    assert 1 == len(toml_of(f"{key} = 1"))
