"""The note that a person has the cell: after a kill or a power cut it is in SETUP again, not ready."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from edged.files.atomic import write_atomically


@dataclass(frozen=True, slots=True)
class SetupNote:
    """A file that is there while a person has the cell; it holds the name."""

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
