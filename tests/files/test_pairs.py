"""Pairs in a folder: both halves of each, or every mistake together."""

from __future__ import annotations

from pathlib import Path

import pytest

from edged.errors import ImageError
from edged.files.pairs import ImagePair, find_pairs


def touch(folder: Path, *names: str) -> None:
    """Make empty files."""
    for name in names:
        (folder / name).touch()


def test_pairs_are_sorted_by_name_and_other_files_are_left_alone(tmp_path: Path) -> None:
    """Two pictures of one name are a pair in any format; other files and pictures without a name are
    ignored."""
    touch(tmp_path, "b_left.png", "b_right.PNG", "a_1_left.tif", "a_1_right.bmp")
    touch(tmp_path, "notes_left.txt", "left.png", "_left", "c_middle.png")

    pairs = find_pairs(tmp_path)

    assert [
        ImagePair("a_1", tmp_path / "a_1_left.tif", tmp_path / "a_1_right.bmp"),
        ImagePair("b", tmp_path / "b_left.png", tmp_path / "b_right.PNG"),
    ] == pairs


def test_numbers_in_names_are_counted(tmp_path: Path) -> None:
    """Numbers in names are sorted by value, so v2 comes before v10."""
    names = ["2", "2b", "10", "v1_9", "v1_10", "v2_1", "v02_1", "w"]
    touch(tmp_path, *(f"{name}_{side}.png" for name in names for side in ("left", "right")))

    assert ["2", "2b", "10", "v1_9", "v1_10", "v02_1", "v2_1", "w"] == [
        pair.name for pair in find_pairs(tmp_path)
    ]


def test_every_mistake_is_named_at_once(tmp_path: Path) -> None:
    """A half without its other half, and a half that exists twice, are all named."""
    touch(tmp_path, "a_left.png", "b_left.bmp", "b_left.png", "b_right.png", "c_right.png")

    with pytest.raises(ImageError) as caught:
        find_pairs(tmp_path)

    message = str(caught.value)
    assert [
        f"{tmp_path}: incomplete pairs",
        "  b_left.png: b_left.bmp is another picture of the same name",
        "  a_left.png: a_right is missing",
        "  c_right.png: c_left is missing",
    ] == message.splitlines()


@pytest.mark.parametrize("content", ["missing", "empty", "file"])
def test_a_folder_without_pairs_is_refused(content: str, tmp_path: Path) -> None:
    """A missing folder, an empty one and a file are refused with different messages."""
    place = tmp_path / "place"
    if content == "empty":
        place.mkdir()
    elif content == "file":
        place.touch()

    with pytest.raises(ImageError, match="no pictures" if content == "empty" else "not a folder"):
        find_pairs(place)
