"""Files of rigs, arrays and images: they read back equal, others are refused by name."""

from __future__ import annotations

import json
import tracemalloc
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from edged.errors import FileFormatError, ImageError
from edged.files.arrays import pack_arrays, unpack_arrays
from edged.files.atomic import write_atomically
from edged.files.images import load_image
from edged.files.rig import load_rig, save_rig
from edged.vision.geometry.camera import CameraModel, StereoRig

CAMERA = CameraModel("division", 1280, 960, 3183.0, 3183.0, 646.1, 477.8, (-0.2416,))


@pytest.fixture
def rig() -> StereoRig:
    """A rig with every optional part."""
    right_from_left = np.eye(4)
    right_from_left[:3, 3] = (-95, -1.4, 55)
    rig = StereoRig(CAMERA, CAMERA, right_from_left, "demo")
    size = len(rig.parameter_names)
    return StereoRig(CAMERA, CAMERA, right_from_left, "demo", np.eye(4), np.diag(np.arange(1.0, size + 1)))


def test_a_rig_comes_back_as_it_was_written(tmp_path: Path, rig: StereoRig) -> None:
    """Every number of a rig reads back exactly, covariance included."""
    save_rig(tmp_path / "rig.json", rig, {"rms_px": 0.03})

    back = load_rig(tmp_path / "rig.json")

    assert (rig.left, rig.right, rig.calibration_id) == (back.left, back.right, back.calibration_id)
    for name in ("right_from_left", "robot_from_rig", "covariance"):
        assert np.array_equal(getattr(rig, name), getattr(back, name))


@pytest.mark.parametrize(
    "field, value, place",
    [
        ("left", None, "left"),
        ("left.fx", "wide", "left.fx"),
        ("left.fx", -1, "left.fx"),
        ("left.width", 0, "left.width"),
        ("left.model", "fisheye", "left.model"),
        ("left.distortion.kappa", None, "left.distortion.kappa"),
        ("right_from_left", [[1, 2], [3, 4]], "right_from_left"),
        ("right_from_left", (2 * np.eye(4)).tolist(), "right_from_left"),
        ("right_from_left", np.eye(4).tolist(), "one place"),
        ("right_from_left", "\u00e9", "right_from_left"),
        ("calibration_id", 7, "calibration_id"),
        ("covariance.matrix", [[1.0]], "covariance.matrix"),
        ("version", 99, "version"),
        ("format", "other", "not a rig"),
    ],
)
def test_each_flaw_of_a_rig_file_is_named(
    tmp_path: Path, rig: StereoRig, field: str, value, place: str
) -> None:
    """The message has file, field and expectation."""
    path = tmp_path / "rig.json"
    save_rig(path, rig)
    document = json.loads(path.read_text())
    *parents, last = field.split(".")
    node = document
    for parent in parents:
        node = node[parent]
    node[last] = value
    path.write_text(json.dumps(document))

    with pytest.raises(FileFormatError, match=place) as caught:
        load_rig(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff\x00", b'{"format": NaN}'])
def test_garbage_is_no_rig(tmp_path: Path, content: bytes) -> None:
    """A truncated or foreign file is refused with its name."""
    (tmp_path / "rig.json").write_bytes(content)

    with pytest.raises(FileFormatError, match=r"rig\.json"):
        load_rig(tmp_path / "rig.json")


def test_a_failed_write_leaves_the_old_file_and_no_litter(tmp_path: Path, monkeypatch) -> None:
    """A failed write leaves the old file, and no other."""
    target = tmp_path / "file"
    target.write_bytes(b"old")
    monkeypatch.setattr("os.fsync", lambda _fd: (_ for _ in ()).throw(OSError("disk full")))

    with pytest.raises(OSError, match="disk full"):
        write_atomically(target, b"new")

    assert ([b"old"], ["file"]) == ([target.read_bytes()], [path.name for path in tmp_path.iterdir()])


def test_arrays_come_back_and_any_flipped_bit_is_noticed(tmp_path: Path) -> None:
    """Arrays read back equal, and a file with a flipped bit is refused, or equal if the bit has no
    meaning."""
    path = tmp_path / "a.npz"
    arrays = {"points": np.arange(600.0).reshape(300, 2), "n": np.array(7, np.int32)}
    path.write_bytes(pack_arrays("shape", 1, arrays))
    back = unpack_arrays(path.read_bytes(), path, "shape", 1)
    assert all(np.array_equal(arrays[name], back[name]) for name in arrays)

    data = path.read_bytes()
    rng = np.random.default_rng(5)
    for _ in range(60):
        damaged = bytearray(data)
        damaged[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            loaded = unpack_arrays(path.read_bytes(), path, "shape", 1)
        except FileFormatError as error:
            assert str(path) in str(error)
        else:  # a bit that carries nothing, such as a time stamp of the zip
            assert all(np.array_equal(arrays[name], loaded[name]) for name in arrays)
    for size in range(0, len(data), 97):
        path.write_bytes(data[:size])
        with pytest.raises(FileFormatError):
            unpack_arrays(path.read_bytes(), path, "shape", 1)


def test_a_container_of_another_kind_or_version_is_refused(tmp_path: Path) -> None:
    """A container of another kind or version is refused with what was found and what is read."""
    path = tmp_path / "a.npz"
    path.write_bytes(pack_arrays("shape", 1, {"a": np.zeros(3)}))

    with pytest.raises(FileFormatError, match="expected 'recording'"):
        unpack_arrays(path.read_bytes(), path, "recording", 1)
    with pytest.raises(FileFormatError, match="version 1, this edged reads 2"):
        unpack_arrays(path.read_bytes(), path, "shape", 2)


@pytest.mark.parametrize(
    "claim",
    ["(6000000000,)", "(300000, 300000)", "(0, 10)", "(601,)", "(599,)", "(" + "9" * 40 + ",)", "(-600,)"],
)
def test_an_array_that_claims_another_size_is_refused(tmp_path: Path, claim: str) -> None:
    """An array with a false size is refused before its memory is reserved."""
    path = tmp_path / "a.npz"
    path.write_bytes(pack_arrays("shape", 1, {"points": np.arange(600.0)}))
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {claim}, }}"
    head = head.ljust(127 - 10) + "\n"
    length = len(head).to_bytes(2, "little")
    members["points.npy"] = b"\x93NUMPY\x01\x00" + length + head.encode() + np.arange(600.0).tobytes()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)

    tracemalloc.start()
    try:
        with pytest.raises(FileFormatError, match=r"a\.npz: not a shape file, or damaged: .*"):
            unpack_arrays(path.read_bytes(), path, "shape", 1)
        assert tracemalloc.get_traced_memory()[1] < 5e6
    finally:
        tracemalloc.stop()


def test_pickled_objects_are_never_loaded(tmp_path: Path) -> None:
    """Pickled objects in a file are refused."""
    path = tmp_path / "a.npz"
    np.savez(path, __header__=np.array({"kind": "shape"}, dtype=object))

    with pytest.raises(FileFormatError):
        unpack_arrays(path.read_bytes(), path, "shape", 1)


def test_grey_images_load_and_others_say_what_they_are(tmp_path: Path) -> None:
    """8-bit grey is unchanged, colour and 16 bits are converted, others are refused with a remedy."""
    grey = np.random.default_rng(2).integers(0, 255, (20, 30), dtype=np.uint8)
    grey[0, 0] = 255
    for name in ("grey.png", "grey.bmp", "grey.tif"):
        cv2.imwrite(str(tmp_path / name), grey)
        assert np.array_equal(grey, load_image(tmp_path / name))
    cv2.imwrite(str(tmp_path / "three.png"), cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
    assert np.array_equal(grey, load_image(tmp_path / "three.png"))
    for bits in (10, 12, 14, 16):
        cv2.imwrite(str(tmp_path / "deep.tif"), grey.astype(np.uint16) << (bits - 8))
        assert np.array_equal(grey, load_image(tmp_path / "deep.tif"))
    colour = np.dstack([grey, 255 - grey, grey])
    cv2.imwrite(str(tmp_path / "colour.png"), colour)
    assert np.abs(load_image(tmp_path / "colour.png") - colour @ [0.114, 0.587, 0.299]).max() <= 0.51

    cv2.imwrite(str(tmp_path / "float.tif"), grey.astype(np.float32))
    (tmp_path / "text.png").write_text("no image")
    (tmp_path / "empty.png").touch()
    for name, message in [
        ("float.tif", "float32 pixels; save it with 8 or 16 bits"),
        ("text.png", "save it as PNG"),
        ("empty.png", "an empty file, expected an image"),
        ("none.png", "no such file"),
    ]:
        with pytest.raises(ImageError, match=message):
            load_image(tmp_path / name)
