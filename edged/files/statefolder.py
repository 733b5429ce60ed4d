"""The folders for what a cell and its page write themselves.

The cell's has the release before, what is being installed, recordings and the note of SETUP; the page's has
users, the audit, drafts and releases. Under systemd they are two, of two users; else they are the same.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from edged.files.atomic import write_atomically

INSTALLED = Path("/etc/edged")
STATE = Path("/var/lib")


def state_folder(config: Path) -> Path:
    """The state directory of a cell's service; without a service manager a folder beside its configuration.

    For an installed configuration a command in a shell finds it, too. It may be missing.
    """
    if (given := _given()) is not None:
        return given
    config = config.resolve()
    if config.parent == INSTALLED:
        return STATE / ("edged" if config.stem == "cell" else f"edged-{config.stem}")
    return config.parent / f".{config.stem}.state"


def page_folder(config: Path) -> Path:
    """The state directory of the page's service; where the cell starts its page itself, that of the cell.

    For an installed configuration a command in a shell finds it, too. It may be missing.
    """
    installed = config.resolve()
    if _given() is None and installed.parent == INSTALLED:
        return STATE / ("edged_page" if installed.stem == "cell" else f"edged_page-{installed.stem}")
    return state_folder(config)


def setup_note(config: Path) -> Path:
    """The file that names the holder of the cell: in the state directory, else beside the configuration."""
    given = _given()
    return config.resolve().parent / f".{config.stem}.setup" if given is None else given / "setup"


def _given() -> Path | None:
    """The directory that systemd gives a service."""
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(given) if given else None


@dataclass(frozen=True, slots=True)
class SetupNote:
    """A file that is there while a person has the cell; it holds the name.

    After a kill or a power cut the cell is in SETUP again, not ready.
    """

    path: Path

    def is_taken(self) -> bool:
        """Whether somebody has; True where that is not known."""
        try:
            return self.path.exists()
        except OSError:
            return True

    def note(self, name: str) -> None:
        """Somebody has. Raises `OSError`."""
        write_atomically(self.path, f"{name}\n".encode())

    def clear(self) -> None:
        """Nobody has. Raises `OSError`."""
        self.path.unlink(missing_ok=True)
