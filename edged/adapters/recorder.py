"""Records the last cycles, and every bad one, on disk (`edged.files.recording`), for later analysis.

All disk access happens on a thread of its own with a short queue. When the disk is slower than the cell, good
cycles are left out before bad ones; when it is full or broken the cell goes on measuring, and the log says so
once. A fault that lasts, or comes and goes, is recorded once.

Setting the clock must not delete recordings: their age is summed from one recording to the next, and no gap
between two counts for more than `MAX_GAP` of the limit.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import shutil
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import NamedTuple

from edged.config.cell import RecorderSection
from edged.domain.events import Event, ExposureDone, Snapshot
from edged.domain.frames import FramePair
from edged.domain.measurement import Status
from edged.errors import ImageError
from edged.files import recording
from edged.files.atomic import make_folders
from edged.files.disc import DiscGuard, DiscThread
from edged.logs import FaultMemory

log = logging.getLogger(__name__)

QUEUE_GOOD = 2
"""With this many queued writes a good cycle is left out, as it would only delay the next bad one."""
QUEUE_BAD = 8
MAX_GAP = 0.1
"""Longest step of the age, as a share of the limit. A weekend counts in full; a clock that jumps a month
ahead, or a month without recordings, counts for three days."""
DAY_S = 86400.0
MIB = 1024 * 1024


class _Kept(NamedTuple):
    """A recording on disk. at_s : its time on the clock that ages are counted on."""

    entry: recording.Entry
    size: int
    at_s: float


@dataclass(slots=True)
class RecorderFigures:
    """Counts since the start, for monitoring. problem : "" while all is well."""

    written: int = 0
    left_out: int = 0
    failed: int = 0
    kept: int = 0
    kept_bytes: int = 0
    problem: str = ""


class Recorder:
    """Writes recordings (`edged.ports.Publisher`).

    setup : returns fingerprint and files (content by relative name) of the configuration in use.
    """

    def __init__(
        self,
        settings: RecorderSection,
        setup: Callable[[], tuple[str, Mapping[str, bytes]]],
        utc_ns: Callable[[], int] = time.time_ns,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.figures = RecorderFigures()
        self._settings = settings
        self._setup = setup
        self._utc_ns = utc_ns
        self._writer = DiscThread("recorder")
        self._guard = DiscGuard(self.figures, settings.folder, "no recordings", "recording again")
        self._waiting = 0
        self._exposed: tuple[int, FramePair] | None = None
        self._faults = FaultMemory(monotonic_s)
        # used by the writer's thread only
        self._kept: dict[bool, deque[_Kept]] = {True: deque(), False: deque()}
        self._kept_bytes = 0
        self._next = 0
        self._age_s = 0.0  # the clock that ages are counted on; _seen: UTC at its last step
        self._seen: datetime | None = None
        self._has_stock = False

    async def start(self) -> None:
        """Clean up and count the recordings; the cell starts even if the folder cannot be used."""
        await asyncio.get_running_loop().run_in_executor(self._writer, self._guarded, self._take_stock)

    def announce(self, event: Event) -> None:
        """Keep the pair of an exposure until its result comes, then pass both to the writer."""
        if isinstance(event, ExposureDone) and event.pair is not None:
            self._exposed = (event.cycle, event.pair)
        if not isinstance(event, Snapshot):
            return
        self._guard.look()
        pair = None
        if self._exposed is not None and self._exposed[0] == event.cycle:
            pair = self._exposed[1]
        self._exposed = None
        if not self._faults.is_news(event):
            return
        if self._waiting >= (QUEUE_GOOD if event.status is Status.OK else QUEUE_BAD):
            self.figures.left_out += 1
            return
        self._waiting += 1
        fingerprint, files = self._setup()
        kept_files = files if fingerprint == event.fingerprint else {}
        loop = asyncio.get_running_loop()
        future = loop.run_in_executor(self._writer, self._guarded, self._write, event, pair, kept_files)
        future.add_done_callback(self._written)

    async def close(self) -> None:
        """Finish the running write, and drop the queued ones."""
        await self._writer.close(drop=True)

    def _written(self, future: asyncio.Future[None]) -> None:
        self._waiting -= 1
        if not future.cancelled():
            future.result()  # let a bug in the writer surface

    # --- in the writer's thread ----------------------------------------------------------------

    def _guarded(self, action: Callable[..., None], *arguments: object) -> None:
        """Run an action on the disk; report its failure, and go on."""
        with self._guard.access():
            try:
                action(*arguments)
            except (OSError, ImageError):
                self.figures.failed += 1
                raise

    def _take_stock(self) -> None:
        folder = self._settings.folder
        make_folders(folder)
        if removed := recording.sweep(folder):
            log.warning("%s: removed %d unfinished file(s) of an earlier run", folder, removed)
        self._kept, self._kept_bytes, self._seen = {True: deque(), False: deque()}, 0, None
        for entry in recording.entries(folder):
            self._keep(entry)
            self._next = max(self._next, entry.index + 1)
        self._has_stock = True
        self._see(self._now())
        self._make_room(0)
        self._forget_setups(recording.setups(folder))

    def _write(self, snapshot: Snapshot, pair: FramePair | None, files: Mapping[str, bytes]) -> None:
        if not self._has_stock:  # the disk was missing at the start: count the recordings on it now
            self._take_stock()
        settings, now = self._settings, self._now()
        self._see(now)
        size = 0 if pair is None else pair.left.image.nbytes + pair.right.image.nbytes
        if not self._make_room(size):
            raise OSError(0, f"less than {settings.min_free_mib} MiB are free, and nothing is left to remove")
        if snapshot.nearest is not None:
            snapshot.nearest.ask()  # it explains the miss in the recording, and delays no client here
        if files:
            recording.save_setup(settings.folder, snapshot.fingerprint, files)
        entry = recording.save(settings.folder, self._next, now, snapshot, pair)
        self._next += 1
        self._keep(entry)
        self.figures.written += 1
        self._make_room(0)

    def _make_room(self, size: int) -> bool:
        """Remove recordings beyond the limits; False if the disk is still too full."""
        settings = self._settings
        oldest_s = self._age_s - settings.max_age_days * DAY_S
        good, bad = self._kept[True], self._kept[False]
        removed = set()
        for ring, limit in ((good, settings.keep_good), (bad, settings.keep_bad)):
            while ring and (len(ring) > limit or ring[0].at_s < oldest_s):
                removed.add(self._remove_oldest(ring))
        while (good or bad) and self._too_much(size):
            removed.add(self._remove_oldest(good or bad))
        self._forget_setups(removed)
        self.figures.kept, self.figures.kept_bytes = len(good) + len(bad), self._kept_bytes
        return self._free_mib(size) >= settings.min_free_mib

    def _too_much(self, size: int) -> bool:
        too_large = self._kept_bytes + size > self._settings.max_mib * MIB
        return too_large or self._free_mib(size) < self._settings.min_free_mib

    def _free_mib(self, size: int) -> float:
        return (shutil.disk_usage(self._settings.folder).free - size) / MIB

    def _now(self) -> datetime:
        return datetime.fromtimestamp(self._utc_ns() / 1e9, UTC)

    def _see(self, utc: datetime) -> None:
        """Advance the clock of ages by the UTC elapsed since the last call, limited by `MAX_GAP`."""
        gap_s = 0.0 if self._seen is None else (utc - self._seen).total_seconds()
        self._age_s += min(max(gap_s, 0.0), MAX_GAP * self._settings.max_age_days * DAY_S)
        self._seen = utc

    def _keep(self, entry: recording.Entry) -> None:
        self._see(entry.recorded)
        size = entry.path.stat().st_size
        self._kept[entry.status == Status.OK].append(_Kept(entry, size, self._age_s))
        self._kept_bytes += size

    def _remove_oldest(self, ring: deque[_Kept]) -> str:
        entry, size, _ = ring[0]
        entry.path.unlink(missing_ok=True)  # if this fails, the recording stays counted
        ring.popleft()
        self._kept_bytes -= size
        return entry.fingerprint

    def _forget_setups(self, fingerprints: set[str]) -> None:
        """Delete those of these setups that no recording refers to, except the current one."""
        if not fingerprints:
            return
        used = {entry.fingerprint for ring in self._kept.values() for entry, _, _ in ring}
        with contextlib.suppress(OSError):  # it only costs a little space, and the next start tries again
            recording.forget_setups(self._settings.folder, fingerprints - used - {self._setup()[0]})
