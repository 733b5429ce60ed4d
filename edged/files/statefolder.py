"""State folders of a cell and its web page.

The cell's folder has the previous release, the one being installed, recordings and the note of SETUP; the
page's has users, the audit log, drafts and releases. Under systemd they are two folders, owned by two users;
otherwise they are the same.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from edged.files.atomic import write_atomically

INSTALLED = Path("/etc/edged")
STATE = Path("/var/lib")


def state_folder(config: Path) -> Path:
    """State folder of a cell's service; without a service manager a folder beside its configuration.

    For an installed configuration, commands run in a shell find it, too. It may not exist.
    """
    if (given := _given()) is not None:
        return given
    config = config.resolve()
    if config.parent == INSTALLED:
        return STATE / ("edged" if config.stem == "cell" else f"edged-{config.stem}")
    return config.parent / f".{config.stem}.state"


def page_folder(config: Path) -> Path:
    """State folder of the page's service; the cell's if the cell starts its page itself.

    For an installed configuration, commands run in a shell find it, too. It may not exist.
    """
    installed = config.resolve()
    if _given() is None and installed.parent == INSTALLED:
        return STATE / ("edged_page" if installed.stem == "cell" else f"edged_page-{installed.stem}")
    return state_folder(config)


def setup_note(config: Path) -> Path:
    """File that names the holder of the cell: in the state directory, else beside the configuration."""
    given = _given()
    return config.resolve().parent / f".{config.stem}.setup" if given is None else given / "setup"


def _given() -> Path | None:
    """The state directory that systemd passes to a service; None outside of systemd."""
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(given) if given else None


@dataclass(frozen=True, slots=True)
class SetupNote:
    """A file that exists while a person holds the cell, with the holder's name in it.

    It makes the cell start in SETUP, not ready, after a kill or a power cut.
    """

    path: Path

    def is_taken(self) -> bool:
        """Whether the cell is held; True if that cannot be determined."""
        try:
            return self.path.exists()
        except OSError:
            return True

    def note(self, name: str) -> None:
        """Record the holder's name. Raises `OSError`."""
        write_atomically(self.path, f"{name}\n".encode())

    def clear(self) -> None:
        """Record that nobody holds the cell. Raises `OSError`."""
        self.path.unlink(missing_ok=True)
