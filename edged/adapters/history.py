"""Records each cycle as a row (`edged.files.history`), and has the rows packed by an unprivileged process.

A cycle only adds an entry to a queue. A separate thread writes the queued rows every `WRITE_S`; a row counts
as written when it is on disk. If the disk is full or broken the cell goes on measuring, rows are left out,
and the log says so once.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from edged.config.cell import HistorySection
from edged.domain.events import Event, Snapshot
from edged.files.disc import DiscGuard, ended
from edged.files.history.rows import FULL, OPEN, Spool, row_of, spool_folder
from edged.payload import Json

log = logging.getLogger(__name__)

WRITE_S = 1.0
"""Period of writing: a power failure loses this much at most."""
PACK_S = 3600.0
MOST_WAITING = 10_000
"""Most rows in memory: enough for more than a minute of a disk that hangs."""
MIB = 1024 * 1024


@dataclass(slots=True)
class HistoryFigures:
    """Counts since the start, for monitoring. problem : "" while all is well."""

    written: int = 0
    left_out: int = 0
    problem: str = ""


class CycleHistory:
    """Records cycles as rows (`edged.ports.Publisher`). packer : program that packs, and its environment."""

    def __init__(
        self,
        settings: HistorySection,
        cell: str,
        packer: tuple[Sequence[str], dict[str, str]],
        pack_s: float = PACK_S,
        started_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.figures = HistoryFigures()
        self._settings = settings
        self._started_ns = started_ns()
        self._folder = spool_folder(settings.folder, cell)
        self._packer, self._pack_s = packer, pack_s
        self._guard = DiscGuard(self.figures, settings.folder, "no history", "history is written again")
        self._waiting: queue.Queue[Snapshot] = queue.Queue(MOST_WAITING)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name="history", daemon=True)
        # used by that thread only
        self._spool = Spool(self._folder, self._started_ns)
        self._packing: subprocess.Popen[bytes] | None = None

    async def start(self) -> None:
        """Start the thread; the cell starts even if the folder cannot be used."""
        self._thread.start()

    def announce(self, event: Event) -> None:
        """Queue the result of a cycle."""
        if isinstance(event, Snapshot):
            self._guard.look()
            try:
                self._waiting.put_nowait(event)
            except queue.Full:
                self.figures.left_out += 1

    async def close(self) -> None:
        """Write the queued rows, and end the thread."""
        self._ends.set()
        await ended(self._thread)

    # --- in the thread ------------------------------------------------------------------------

    def _run(self) -> None:
        self._guarded(self._adopt)
        turn_s = time.monotonic() + self._pack_s
        while not self._ends.wait(WRITE_S):
            self._guarded(self._write)
            if self._spool.is_full or time.monotonic() >= turn_s:
                turn_s = time.monotonic() + self._pack_s
                self._guarded(self._pack)
        self._guarded(self._write)
        with contextlib.suppress(OSError):
            self._spool.turn_over()
        if self._packing is not None:  # it may be killed at any time, and is repeated
            self._packing.kill()
            self._packing.wait()

    def _guarded(self, action: Callable[[], None]) -> None:
        with self._guard.access():
            action()

    def _adopt(self) -> None:
        if self._spool.adopt() or self._has_more:
            self._start_packer()

    def _write(self) -> None:
        rows: list[Json] = []
        with contextlib.suppress(queue.Empty):
            while True:
                rows.append(row_of(self._waiting.get_nowait(), self._started_ns))
        if not rows:
            return
        try:
            free_mib = shutil.disk_usage(self._settings.folder).free / MIB
            if free_mib < self._settings.min_free_mib:
                raise OSError(0, f"less than {self._settings.min_free_mib} MiB are free")
            self._spool.write(rows)
        except OSError:
            self.figures.left_out += len(rows)
            raise
        self.figures.written += len(rows)

    def _pack(self) -> None:
        if self._spool.turn_over() or self._has_more:
            self._start_packer()
        self._drop_oldest()

    @property
    def _has_more(self) -> bool:
        """Whether there is work without rows: files to be sent to the bucket, recordings to be kept."""
        return bool(self._settings.bucket or self._settings.recordings_mib)

    def _start_packer(self) -> None:
        if self._packing is not None:
            if self._packing.poll() is None:
                return  # the next run packs the rest
            if self._packing.returncode:
                log.warning("history: the last packing failed (%d): rows wait", self._packing.returncode)
        program, environment = self._packer
        self._packing = subprocess.Popen(program, stdin=subprocess.DEVNULL, env=environment)

    def _drop_oldest(self) -> None:
        """Delete the oldest unpacked rows beyond the limit, in case packing does not work."""
        files = sorted(file for file in self._folder.iterdir() if file.suffix in (OPEN, FULL))
        size = sum(file.stat().st_size for file in files)
        for file in files[:-1]:
            if size <= self._settings.max_mib * MIB:
                return
            size -= file.stat().st_size
            log.error("history: %s is removed unpacked: there is no room for it", file.name)
            file.unlink(missing_ok=True)
