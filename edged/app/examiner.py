"""Runs `edged doctor` for the page, started by the cell as its own user."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from pathlib import Path

from edged.app.unprivileged import NICER, environment
from edged.config.configuration import Config
from edged.connections import Rate
from edged.errors import CommandRefused, translated
from edged.files.private import close_to_others
from edged.setup.cellfiles import exposed_secrets

MOST_S = 60.0
MOST_CHECKS, MOST_LETTERS = 200, 2000
AGAIN_S, AT_ONCE = 5.0, 6.0
"""Rate limit of examinations: a burst of `AT_ONCE`, then one every `AGAIN_S`.

Each fixed finding asks for one, and each takes a second of one processor.
"""


class Examiner:
    """Runs one examination at a time, in another process of lower priority; used on the event loop."""

    def __init__(self, config: Path) -> None:
        self._config = config
        self._turn = asyncio.Lock()
        self._rate = Rate(1 / AGAIN_S, burst=AT_ONCE)

    async def examine(self) -> list[dict[str, str]]:
        """Return the findings of `edged doctor --json`, without taking a picture. Raises `CommandRefused`."""
        if self._turn.locked() or not self._rate.take():
            raise CommandRefused("this machine is being examined, or was a moment ago")
        async with self._turn:
            return await asyncio.to_thread(self._examined)

    def _examined(self) -> list[dict[str, str]]:
        doctor = [sys.executable, "-m", "edged", "doctor", str(self._config), "--json", "--no-trigger"]
        try:
            ended = subprocess.run(
                ["nice", "-n", str(NICER), *doctor, "--daemon", str(os.getpid())],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                env=environment(),
                start_new_session=True,
                timeout=MOST_S,
                check=False,
            )
            checks = json.loads(ended.stdout)["checks"][:MOST_CHECKS]
            return [{str(key): str(text)[:MOST_LETTERS] for key, text in check.items()} for check in checks]
        except subprocess.TimeoutExpired:
            raise CommandRefused(f"edged doctor has not ended within {MOST_S:g} s") from None
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise CommandRefused(f"edged doctor cannot be run: {error}") from error


def close_secrets(path: Path, config: Config) -> None:
    """Close files with secrets to other users of this machine. path : of the configuration.

    Raises `CommandRefused` for a file that this process may not change.
    """
    for secret in exposed_secrets(path, config):
        if not secret.can_be_closed:
            raise CommandRefused(f"{secret}")
        with translated(CommandRefused, f"{secret.file}"):
            close_to_others(secret.file)
