"""Replay: pairs stay pairs in any order of calls; a bad picture is named."""

from __future__ import annotations

import errno
from pathlib import Path

import cv2
import numpy as np
import pytest

from edged.adapters.replay import ReplayCamera, replay_cameras
from edged.cell.stereohead import HeadSettings, StereoHead
from edged.domain.arrays import Image
from edged.errors import CameraUnreachable, FrameIncomplete, FrameTimeout, ImageError
from edged.files import images


def picture(value: int, shape: tuple[int, int] = (12, 16)) -> Image:
    """An image with one grey value."""
    return np.full(shape, value, np.uint8)


def write_pairs(folder: Path, names: list[str]) -> None:
    """Write pairs; pair k has grey 10 k + 1 left and 10 k + 2 right."""
    for k, name in enumerate(names):
        cv2.imwrite(str(folder / f"{name}_left.png"), picture(10 * k + 1))
        cv2.imwrite(str(folder / f"{name}_right.png"), picture(10 * k + 2))


async def test_pairs_are_shown_in_the_order_of_their_names_and_again(tmp_path: Path) -> None:
    """Pairs are shown in the order of their names and again from the start, with rising ids and times."""
    write_pairs(tmp_path, ["a", "b", "c"])
    (tmp_path / "notes.txt").write_text("not an image")
    (tmp_path / "a_left.json").write_text("{}")
    head = StereoHead(*replay_cameras(tmp_path))
    pairs = [await head.capture() for _ in range(7)]
    await head.close()

    assert [1, 11, 21, 1, 11, 21, 1] == [int(pair.left.image[0, 0]) for pair in pairs]
    assert [2, 12, 22, 2, 12, 22, 2] == [int(pair.right.image[0, 0]) for pair in pairs]
    assert list(range(1, 8)) == [pair.left.frame_id for pair in pairs]
    assert all(pair.left.exposed_ns == pair.right.exposed_ns for pair in pairs)
    assert (np.diff([pair.exposed_ns for pair in pairs]) > 0).all()


async def test_a_side_that_missed_an_exposure_catches_up(tmp_path: Path) -> None:
    """After an exposure of one camera alone, and after reopening, both show the same pair again."""
    write_pairs(tmp_path, ["a", "b", "c", "d"])

    async def shoot(*cameras: ReplayCamera) -> list[int]:
        for camera in cameras:
            await camera.trigger()
        return [(await camera.frame()).frame_id for camera in cameras]

    left, right = replay_cameras(tmp_path)
    await left.open()
    await right.open()
    both = await shoot(left, right)
    alone = await shoot(left)
    after = await shoot(left, right)
    await shoot(left)
    await right.close()
    await right.open()
    reopened = await shoot(right, left)

    assert ([1, 1], [2], [3, 3]) == (both, alone, after)
    assert reopened[0] == reopened[1] > 3


async def test_a_camera_that_is_closed_or_was_not_triggered_says_so(tmp_path: Path) -> None:
    """There is no image without open and trigger, and each trigger gives one image."""
    write_pairs(tmp_path, ["a"])
    left, _ = replay_cameras(tmp_path)
    with pytest.raises(CameraUnreachable, match="not open"):
        await left.trigger()
    await left.open()
    await left.trigger()
    await left.frame()
    with pytest.raises(FrameTimeout, match="no exposure"):
        await left.frame()
    await left.close()
    await left.close()


@pytest.mark.parametrize("name", ["nowhere", ""])
def test_a_folder_without_pairs_is_refused(tmp_path: Path, name: str) -> None:
    """An empty and a missing folder are refused."""
    with pytest.raises(ImageError, match=r"not a folder|no pictures"):
        replay_cameras(tmp_path / name)


def test_a_first_pair_of_two_sizes_is_refused(tmp_path: Path) -> None:
    """A pair with images of two sizes is refused with both sizes."""
    cv2.imwrite(str(tmp_path / "a_left.png"), picture(1))
    cv2.imwrite(str(tmp_path / "a_right.png"), picture(2, (10, 16)))

    with pytest.raises(ImageError, match=r"a_right\.png: 16x10 pixels, expected 16x12"):
        replay_cameras(tmp_path)


async def test_a_later_bad_file_is_a_fault_and_the_film_goes_on(tmp_path: Path) -> None:
    """A wrong size, float pixels and damage are `FrameIncomplete` with the file's name; the next pair is
    served."""
    write_pairs(tmp_path, ["a", "b", "c", "d", "e"])
    cv2.imwrite(str(tmp_path / "b_left.png"), picture(7, (20, 20)))
    (tmp_path / "c_right.png").write_bytes(b"\x89PNG broken")
    (tmp_path / "d_right.png").unlink()
    cv2.imwrite(str(tmp_path / "d_right.tif"), np.zeros((12, 16), np.float32))
    head = StereoHead(*replay_cameras(tmp_path), HeadSettings(min_backoff_s=0.0))
    results = [(await head.capture()).left.frame_id]
    for _ in range(3):
        with pytest.raises(FrameIncomplete) as caught:
            await head.capture()
        results.append(str(caught.value))
    results.append((await head.capture()).left.frame_id)
    await head.close()
    first, size, damage, floats, last = results

    assert (1, 5) == (first, last)
    assert "b_left.png: 20x20 pixels, expected 16x12" in size
    assert "camera right" in damage
    assert "c_right.png" in damage
    assert "d_right.tif: float32 pixels" in floats


async def test_a_picture_that_cannot_be_read_now_is_a_fault_and_no_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If a file cannot be opened now, the frame is FrameIncomplete, and the next exposure works."""
    write_pairs(tmp_path, ["a", "b"])
    left, _ = replay_cameras(tmp_path)

    def exhausted(_path: Path) -> int:
        raise OSError(errno.EMFILE, "Too many open files")

    await left.open()
    await left.trigger()
    with monkeypatch.context() as patch:
        patch.setattr(images, "file_to_read", exhausted)
        with pytest.raises(FrameIncomplete, match="Too many open files"):
            await left.frame()
    await left.trigger()
    assert 2 == (await left.frame()).frame_id
