"""`edged grab`: pairs of a board that is moved, and pairs already taken are kept."""

from __future__ import annotations

import asyncio
import io
import itertools
import os
import re
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from edged.commands import grab as module
from edged.commands.demo import DemoOptions, prepare_cell
from edged.commands.grab import Grab, ViewChange, grab
from edged.domain.arrays import Image
from edged.domain.frames import Frame, FramePair
from edged.errors import CaptureError, FrameTimeout, UserError
from edged.files.pairs import find_pairs
from edged.sim.cell import VirtualCell, demo_part, demo_rig


def board(x: float, seed: int, gain: float = 1.0) -> Image:
    """A chessboard at a place in a noisy picture, with this brightness."""
    columns, rows = np.meshgrid(np.arange(320) - x, np.arange(240))
    inside = (columns > 40) & (columns < 200) & (rows > 40) & (rows < 200)
    grey = np.where(inside & ((columns // 20 + rows // 20) % 2 > 0), 200.0, 60.0)
    noise = np.random.default_rng(seed).normal(0, 3, grey.shape)
    return np.clip(np.rint(gain * cv2.GaussianBlur(grey, (0, 0), 0.8) + noise), 0, 255).astype(np.uint8)


def pair_at(x: float, seed: int = 0, gain: float = 1.0) -> FramePair:
    """Both cameras see the board at this place."""
    images = board(x, 2 * seed, gain), board(x - 9, 2 * seed + 1, gain)
    left, right = (Frame(side, 1, image, 0, 0) for side, image in zip(("left", "right"), images, strict=True))
    return FramePair(left, right)


class Head:
    """Plays a script of exposures, faults and interrupts."""

    def __init__(self, script: Iterable[float | BaseException]) -> None:
        self.script: Iterator[tuple[int, float | BaseException]] = enumerate(script)
        self.closed = False

    async def open(self) -> None:
        """Do nothing."""

    async def capture(self) -> FramePair:
        """Next entry of the script."""
        seed, what = next(self.script)
        if isinstance(what, BaseException):
            raise what
        return pair_at(what, seed)

    async def close(self) -> None:
        """Note that it was closed."""
        self.closed = True


@pytest.fixture(autouse=True)
def _hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LOOK_AGAIN_S", 0.0)


def session(folder: Path, count: int) -> tuple[Grab, io.StringIO]:
    """A session for a folder, and its output."""
    said = io.StringIO()
    return Grab(folder, "pair", count, Console(file=said, width=200)), said


def test_a_pair_is_taken_when_the_view_changed_and_rests(tmp_path: Path) -> None:
    """No pair is taken while the board moves, nor twice at the same place."""
    places = [0.0, 0.0, 0.0, 0.0, 10.0, 20.0, 21.0, 40.0, 40.0, 40.0, 55.0, 55.0]
    grabbing, said = session(tmp_path, 3)
    asyncio.run(grabbing.run(Head(places), grabbing.resting))

    assert [0.0, 40.0, 55.0] == [
        min((0.0, 40.0, 55.0), key=lambda x: float(np.mean(np.abs(board(x, 99) - image))))
        for image in (
            cv2.imread(str(pair.left), cv2.IMREAD_UNCHANGED).astype(float) for pair in find_pairs(tmp_path)
        )
    ]
    assert "waiting until the view has changed and rests" in said.getvalue()


def test_noise_and_flicker_are_no_movement_and_half_a_pixel_is() -> None:
    """Flicker by 10 % counts as rest, creeping by half a pixel does not."""
    resting, creeping = ViewChange(), ViewChange()
    assert [False, True] == [resting.rests_anew(pair_at(0.0, k, 1 - 0.1 * k)) for k in range(2)]
    assert not any(creeping.rests_anew(pair_at(0.5 * k, k)) for k in range(10))


def test_a_view_that_never_rests_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ends after a time limit with advice, and keeps pairs already taken."""
    monkeypatch.setattr(module, "PATIENCE_S", 0.3)
    grabbing, said = session(tmp_path, 2)
    asyncio.run(grabbing.run(Head(itertools.cycle([0.0, 30.0])), grabbing.resting))

    assert grabbing.taken == 0
    assert "move the board, then keep it still" in said.getvalue()


@pytest.mark.parametrize(
    "end", [KeyboardInterrupt(), FrameTimeout("left", "unplugged")], ids=["ctrl-C", "cable"]
)
def test_what_was_taken_stays(tmp_path: Path, end: BaseException) -> None:
    """After Ctrl-C or a camera fault both pairs taken are complete, and the head is closed."""
    head = Head([0.0, 30.0, *([end] * 9)])
    grabbing, _ = session(tmp_path, 20)
    with pytest.raises(type(end)):
        asyncio.run(grabbing.run(head, grabbing.at_once))

    assert ["pair_00", "pair_01"] == [pair.name for pair in find_pairs(tmp_path)]
    assert head.closed
    assert "2 of 20 pair(s)" in grabbing.summary


def test_one_lost_frame_ends_nothing(tmp_path: Path) -> None:
    """A lost frame is reported, and the pair is taken again."""
    grabbing, said = session(tmp_path, 2)
    lost: CaptureError = FrameTimeout("left", "no image")
    asyncio.run(grabbing.run(Head([0.0, lost, 30.0]), grabbing.at_once))

    assert 2 == len(find_pairs(tmp_path))
    assert "no image; trying again" in said.getvalue()


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    """Numbers continue after the highest one, also after gaps and half a pair."""
    for name in ("pair_00_left", "pair_07_right", "other_99_left"):
        (tmp_path / f"{name}.png").write_bytes(b"old")
    grabbing, _ = session(tmp_path, 1)
    asyncio.run(grabbing.run(Head([0.0]), grabbing.at_once))

    names = {path.name for path in tmp_path.iterdir()}
    assert names >= {"pair_08_left.png", "pair_08_right.png"}
    assert b"old" == (tmp_path / "pair_00_left.png").read_bytes()
    assert 5 == len(names)


def test_a_terminal_is_asked_before_each_pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Enter takes a pair, `q` ends."""
    reader, writer = os.pipe()
    os.write(writer, b"\n")
    grabbing, said = session(tmp_path, 5)
    with os.fdopen(reader) as answers, os.fdopen(writer, "wb", buffering=0) as hand:
        monkeypatch.setattr("sys.stdin", answers)
        later = threading.Timer(0.2, hand.write, [b"q\n"])
        later.start()
        asyncio.run(grabbing.run(Head([0.0] * 5), grabbing.asked))
        later.join()

    assert 1 == len(find_pairs(tmp_path))
    assert 2 == len(re.findall("press Enter", said.getvalue()))


@pytest.mark.slow
def test_a_folder_that_cannot_be_written_is_found_before_the_cameras_are(tmp_path: Path) -> None:
    """A file in place of the folder is an error before any camera is opened."""
    options = DemoOptions(modbus_port=1, zenoh_port=2)
    prepare_cell(tmp_path, VirtualCell(demo_rig(), demo_part()), options, gige=True)
    (tmp_path / "out").write_text("a file")
    with pytest.raises(UserError, match="out: is a file, expected a folder"):
        grab(tmp_path / "cell.toml", tmp_path / "out", 1, "pair", Console())


@pytest.mark.slow
def test_grab_saves_pairs_for_calibrate_and_teach(tmp_path: Path) -> None:
    """Pictures have the names that other commands expect, and are lossless."""
    prepare_cell(tmp_path, VirtualCell(demo_rig(), demo_part()), DemoOptions(), gige=False)
    assert 0 == grab(tmp_path / "cell.toml", tmp_path / "out", 2, "part", Console(stderr=True))
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["part_00_left.png", "part_00_right.png", "part_01_left.png", "part_01_right.png"]
    image = cv2.imread(str(tmp_path / "out" / names[0]), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert image.shape == (960, 1280)
