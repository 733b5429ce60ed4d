"""A thread that runs small jobs in order."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable

import zenoh

from edged.adapters.zenoh.session import plain

log = logging.getLogger(__name__)


class JobThread:
    """A thread that runs small jobs in order; a full queue drops its oldest job, never its newest.

    It is a daemon thread: should a call of Zenoh ever hang, the process can still end.
    """

    def __init__(self, name: str, length: int) -> None:
        self._jobs: deque[Callable[[], None]] = deque(maxlen=length)
        self._changed = threading.Condition()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self.dropped = 0
        self.failed = 0

    def start(self) -> None:
        """Start the thread, with the jobs posted so far."""
        self._thread.start()

    def post(self, job: Callable[[], None]) -> None:
        """Queue a job; returns at once."""
        with self._changed:
            self.dropped += len(self._jobs) == self._jobs.maxlen
            self._jobs.append(job)
            self._changed.notify()

    def stop(self, timeout_s: float) -> None:
        """Run the queued jobs, then end the thread; give up after the time-out."""
        with self._changed:
            self._stopping = True
            self._changed.notify()
        if self._thread.ident is not None:
            self._thread.join(timeout_s)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._jobs or self._stopping)
                if not self._jobs:
                    return
                job = self._jobs.popleft()
            try:
                job()
            except zenoh.ZError as error:
                self.failed += 1
                if self.failed == 1:
                    log.warning("%s: %s (further ones are counted)", self._thread.name, plain(error))
            except Exception:  # one message that cannot be encoded must not stop all later ones
                self.failed += 1
                log.exception("%s: a message was lost to a bug", self._thread.name)
