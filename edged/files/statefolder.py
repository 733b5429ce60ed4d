"""Where a cell keeps what it writes itself: users, the audit, drafts and releases."""

from __future__ import annotations

import os
from pathlib import Path

INSTALLED = Path("/etc/edged")
STATE = Path("/var/lib")


def state_folder(config: Path) -> Path:
    """The state directory of a cell's service; without a service manager a folder beside its configuration.

    Of a configuration that is installed it is known to who runs a command in a shell, too. It may be missing.
    """
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if given:
        return Path(given)
    config = config.resolve()
    if config.parent == INSTALLED:
        return STATE / ("edged" if config.stem == "cell" else f"edged-{config.stem}")
    return config.parent / f".{config.stem}.state"
