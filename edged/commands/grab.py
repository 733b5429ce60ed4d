"""`edged grab`: saves pairs from the configured cameras, each written to disc before the next is taken."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from rich.console import Console

from edged.app.cameras import head_of
from edged.config.reading import load
from edged.domain.arrays import FloatArray, Image
from edged.domain.frames import FramePair
from edged.errors import CaptureError, FileFormatError, translated
from edged.files.atomic import write_atomically
from edged.files.outputs import check_folder, make_folder
from edged.files.pairs import next_number
from edged.owners import as_owner
from edged.sim.world import VirtualWorld

BLOCK_PX = 16
"""Block size; pictures are compared by block means, which noise of 3 grey values changes by 0.2."""
MOVING_GREY, MOVING_SHARE = 2.5, 0.002
"""Limits for rest, exceeded between two exposures by a board that moves by a third of a pixel."""
CHANGED_GREY, CHANGED_SHARE = 10.0, 0.02
"""Limits for a changed view, exceeded relative to the last pair when the board lies elsewhere."""
LOOK_AGAIN_S = 0.2
PATIENCE_S = 60.0
MAX_FAULTS = 5
"""Consecutive failed captures before grabbing ends; a single lost frame is the network's fault."""


class GrabHead(Protocol):
    """The part of a stereo head that grabbing needs."""

    async def open(self) -> None:
        """Connect."""

    async def capture(self) -> FramePair:
        """Return one pair."""

    async def close(self) -> None:
        """Disconnect."""


@dataclass(slots=True)
class ViewChange:
    """Detects when the view has changed since the last pair and is at rest."""

    _taken: tuple[FloatArray, FloatArray] | None = None
    _before: tuple[FloatArray, FloatArray] | None = None

    def rests_anew(self, pair: FramePair) -> bool:
        """Whether a pair differs from the last one taken and equals the one before it."""
        now = _blocks(pair.left.image), _blocks(pair.right.image)
        before, self._before = self._before, now
        if self._taken is not None and not _differ(now, self._taken, CHANGED_GREY, CHANGED_SHARE):
            return False
        return before is not None and not _differ(now, before, MOVING_GREY, MOVING_SHARE)

    def take(self, pair: FramePair) -> None:
        """Note that this pair was taken; the next must differ from it."""
        self._taken = _blocks(pair.left.image), _blocks(pair.right.image)


def _blocks(image: Image) -> FloatArray:
    """Return block means, divided by the overall brightness because lamps flicker."""
    height, width = image.shape
    size = max(1, width // BLOCK_PX), max(1, height // BLOCK_PX)
    means = cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA).astype(np.float64)
    return np.asarray(means * (100.0 / max(float(means.mean()), 1.0)))


def _differ(
    before: tuple[FloatArray, FloatArray], now: tuple[FloatArray, FloatArray], grey: float, share: float
) -> bool:
    """Whether more than this share of either camera's blocks differ by more than `grey` grey values."""
    return any(
        a.shape != b.shape or float(np.mean(np.abs(a - b) > grey)) > share
        for a, b in zip(before, now, strict=True)
    )


def grab(config: Path, output: Path, count: int, name: str, console: Console) -> int:
    """Save pairs as NAME_NN_left.png, NAME_NN_right.png; 0 if all were taken, else 1.

    On a terminal a person is asked before each pair, unless it is a single one; otherwise a pair is taken
    whenever the view has changed and is at rest. Numbers continue after those in the folder; nothing is
    overwritten, and pairs already taken are kept if a later one fails.
    """
    section = load(config).cameras
    check_folder(output)
    make_folder(output)
    session = Grab(output, name, count, console)
    when = session.at_once if count == 1 else session.asked if sys.stdin.isatty() else session.resting
    try:
        if section.source.startswith("virtual"):
            when = session.at_once  # each exposure shows a new scene
            with VirtualWorld(gige=section.source == "virtual") as world:
                asyncio.run(session.run(head_of(section, world), when))
        else:
            asyncio.run(session.run(head_of(section), when))
    except KeyboardInterrupt:
        console.print("ended by ctrl-C", highlight=False)
    finally:
        console.print(session.summary, highlight=False, markup=False, soft_wrap=True)
    return 0 if session.taken == count else 1


@dataclass(slots=True)
class Grab:
    """A session that saves pairs from one head into a folder."""

    output: Path
    name: str
    count: int
    console: Console
    taken: int = 0
    skew_ms: float = 0.0
    movement: ViewChange = field(default_factory=ViewChange)

    @property
    def summary(self) -> str:
        """Number of pairs taken, the folder, and the largest skew."""
        number = f"{self.taken}" if self.taken == self.count else f"{self.taken} of {self.count}"
        return f"{number} pair(s) in {self.output}, skew up to {self.skew_ms:.2f} ms"

    async def run(self, head: GrabHead, when: Callable[[GrabHead], Awaitable[FramePair | None]]) -> None:
        """Take pairs until there are enough or `when` returns None. Raises `CaptureError`."""
        try:
            await head.open()
            while self.taken < self.count:
                pair = await when(head)
                if pair is None:
                    return
                self._keep(pair)
        finally:
            await head.close()

    async def at_once(self, head: GrabHead) -> FramePair | None:
        """Return the next exposure."""
        return await self._captured(head)

    async def asked(self, head: GrabHead) -> FramePair | None:
        """Return the next exposure after Enter; None after `q`, or when standard input ends."""
        self._say(f"{self.taken + 1} of {self.count}: place the board, then press Enter (q Enter: end)")
        line = await _line(sys.stdin.fileno())
        if not line or line.strip().lower() in ("q", "quit"):
            return None
        return await self._captured(head)

    async def resting(self, head: GrabHead) -> FramePair | None:
        """Return the next exposure whose view has changed and is at rest; None after `PATIENCE_S`."""
        if self.taken:
            self._say(f"{self.taken + 1} of {self.count}: waiting until the view has changed and rests")
        until_s = asyncio.get_running_loop().time() + PATIENCE_S
        while asyncio.get_running_loop().time() < until_s:
            pair = await self._captured(head)
            if self.movement.rests_anew(pair):
                return pair
            await asyncio.sleep(LOOK_AGAIN_S)
        self._say(
            f"in {PATIENCE_S:.0f} s the view never changed and rested: move the board, then keep it still"
        )
        return None

    async def _captured(self, head: GrabHead) -> FramePair:
        """Return a pair, after at most `MAX_FAULTS` tries. Raises the last `CaptureError`."""
        for _ in range(MAX_FAULTS - 1):
            try:
                return await head.capture()
            except CaptureError as error:
                self._say(f"{error}; trying again")
                await asyncio.sleep(LOOK_AGAIN_S)
        return await head.capture()

    def _keep(self, pair: FramePair) -> None:
        """Write a pair under the next free number. Raises `FileFormatError`; nothing is written then."""
        stem = f"{self.name}_{next_number(self.output, self.name):02d}"
        pictures = {"left": pair.left.image, "right": pair.right.image}
        encoded = {side: cv2.imencode(".png", image)[1].tobytes() for side, image in pictures.items()}
        with (
            translated(FileFormatError, f"{self.output}: cannot be written"),
            as_owner(self.output) as folder,
        ):
            _write_all(folder, {f"{stem}_{side}.png": png for side, png in encoded.items()})
        self.movement.take(pair)
        self.taken += 1
        skew_ms = abs(pair.left.exposed_ns - pair.right.exposed_ns) * 1e-6
        self.skew_ms = max(self.skew_ms, skew_ms)
        if self.count > 1:
            self._say(f"{self.taken} of {self.count}: {stem}, skew {skew_ms:.2f} ms")

    def _say(self, text: str) -> None:
        self.console.print(text, highlight=False, markup=False, soft_wrap=True)


def _write_all(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write all files or none. files : contents by name. Raises `OSError`."""
    written: list[Path] = []
    try:
        for name, data in files.items():
            write_atomically(folder / name, data)
            written.append(folder / name)
    except BaseException:
        for path in written:
            path.unlink(missing_ok=True)
        raise


async def _line(descriptor: int) -> str:
    """Return the next line of a file, "" at its end; a cancelled call leaves no pending reader."""
    loop = asyncio.get_running_loop()
    heard = b""
    while not heard.endswith(b"\n"):
        ready = asyncio.Event()
        loop.add_reader(descriptor, ready.set)
        try:
            await ready.wait()
        finally:
            loop.remove_reader(descriptor)
        more = os.read(descriptor, 4096)
        if not more:
            break
        heard += more
    return heard.decode(errors="replace")
