"""Installs releases from the page in a separate process (`edged.setup.releases.installing`)."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

from edged.app.unprivileged import UNPRIVILEGED_PREFIX, environment
from edged.codec.plainerrors import error_of
from edged.errors import LinkError, SetupRefused, UserError
from edged.files.statefolder import state_folder
from edged.setup.releases.installing import UNDO, note_installed

log = logging.getLogger(__name__)

MOST_S = 90.0
"""Limit for reading and writing a release; a hundred jobs take a few seconds."""
MOST_LINE_BYTES = 64 * 1024


class Installer:
    """Installs one release at a time; used on the event loop.

    config : path of the cell's configuration. reload : reads it again; returns why it was refused, or "".
    """

    def __init__(self, config: Path, reload: Callable[[], Awaitable[str]]) -> None:
        self._config = config
        self._reload = reload
        self._turn = asyncio.Lock()

    async def install(self, memory: int) -> None:
        """Run the cell with a release. memory : sealed memory with its archive.

        Raises `EdgedError`, `OSError`; the cell then runs as before, with its previous files. After a
        `LinkError` it runs with either the old or the new files, from the next start at the latest.
        """
        if self._turn.locked():
            raise SetupRefused("another release is being installed")
        async with self._turn:
            process = await asyncio.to_thread(self._started, memory)
            try:
                await _heard(process)
                if refused := await self._reload():
                    await _heard(process, UNDO)
                else:
                    await asyncio.to_thread(note_installed, state_folder(self._config))
            finally:
                await asyncio.shield(asyncio.to_thread(_ended, process))
        if refused:
            raise UserError(f"the cell cannot run with it, and goes on as before: {refused}")

    def _started(self, memory: int) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "edged.setup.releases.installing", str(self._config), str(memory)]
        return subprocess.Popen(
            [*UNPRIVILEGED_PREFIX, *command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=[memory],
            env=environment(),
            start_new_session=True,
        )


async def _heard(process: subprocess.Popen[bytes], word: str = "") -> None:
    """Send the process a word, if any, and wait for its answer. Raises the error it reports, `LinkError`."""

    def exchange() -> bytes:
        if process.stdin is None or process.stdout is None:
            raise ValueError("it has no pipes")
        with contextlib.suppress(BrokenPipeError):
            if word:
                process.stdin.write(f"{word}\n".encode())
                process.stdin.flush()
        return process.stdout.readline(MOST_LINE_BYTES)

    try:
        async with asyncio.timeout(MOST_S):
            line = await asyncio.to_thread(exchange)
        error = None if (answer := json.loads(line)) is None else error_of(**answer)
    except (TimeoutError, ValueError, KeyError, TypeError):
        error = LinkError(
            "the process that installs releases has ended, or hangs: the next start finishes it"
        )
    if error is not None:
        raise error


def _ended(process: subprocess.Popen[bytes]) -> None:
    """Kill the process and close its pipes: it has reported all it does, or it hangs."""
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()
