"""`edged` with two ways to hang, to test the watchdog.

python tests/system/hangable.py run /etc/edged/cell.toml

SIGUSR1: the next measurement never ends; the event loop and its servers go on.
SIGUSR2: the event loop itself stops.
"""

from __future__ import annotations

import signal
import threading
from typing import Any

import edged.app.cell
from edged.__main__ import main

hang = threading.Event()
locate = edged.app.cell.locate


def locate_or_hang(*arguments: Any) -> Any:
    """The pipeline, until SIGUSR1."""
    if hang.is_set():
        stand_still()
    return locate(*arguments)


def stand_still() -> None:
    """For ever."""
    threading.Event().wait()


edged.app.cell.locate = locate_or_hang
signal.signal(signal.SIGUSR1, lambda *_: hang.set())
signal.signal(signal.SIGUSR2, lambda *_: stand_still())
main()
