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

from edged.app.pagesource import ended
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
            answers, pipe = asyncio.StreamReader(MOST_LINE_BYTES), None
            try:
                pipe, _ = await asyncio.get_running_loop().connect_read_pipe(
                    lambda: asyncio.StreamReaderProtocol(answers), process.stdout
                )
                await _heard(process, answers)
                if refused := await self._reload():
                    await _heard(process, answers, UNDO)
                else:
                    await asyncio.to_thread(note_installed, state_folder(self._config))
            finally:
                for end in (pipe, process.stdin):
                    if end is not None:
                        end.close()
                await asyncio.shield(ended(process, 0.0))
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
            bufsize=0,
        )


async def _heard(process: subprocess.Popen[bytes], answers: asyncio.StreamReader, word: str = "") -> None:
    """Send the process a word, if any, and wait for its answer. Raises the error it reports, `LinkError`.

    No thread waits for it: one that cannot be killed, as its disk hangs, would keep this process from ending.
    """
    if word and process.stdin is not None:
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(f"{word}\n".encode())
    try:
        async with asyncio.timeout(MOST_S):
            line = await answers.readline()
        error = None if (answer := json.loads(line)) is None else error_of(**answer)
    except (TimeoutError, ValueError, KeyError, TypeError):
        error = LinkError(
            "the process that installs releases has ended, or hangs: the next start finishes it"
        )
    if error is not None:
        raise error
