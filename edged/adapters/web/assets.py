"""Files that a browser loads for the pages: scripts, styles, drawings, texts, by name below static/."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.resources import files
from pathlib import PurePosixPath

TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".ftl": "text/plain"}
"""Media types by suffix; files with others (licences, check sums) are not served."""
SHARED = ("setup/shared/api.js", "setup/shared/fetched.js", "setup/shared/texts.js", "vendor/ui.js")
"""Scripts that the Run page shares with the set-up pages."""


def read_assets() -> dict[str, str]:
    """Return contents by name, such as "setup/main.js"."""
    found: dict[str, str] = {}
    folders = [(files(__package__) / "static", "")]
    while folders:
        folder, place = folders.pop()
        for entry in folder.iterdir():
            name = f"{place}{entry.name}"
            if entry.is_dir():
                folders.append((entry, f"{name}/"))
            elif type_of(name):
                found[name] = entry.read_text("utf-8")
    return found


def type_of(name: str) -> str:
    """Return the media type; "" for files that are not served."""
    return TYPES.get(PurePosixPath(name).suffix, "")


def in_shell(name: str) -> bool:
    """Whether a file is loaded with the first set-up page; files of one page are loaded when it is opened."""
    folder = PurePosixPath(name).parent.as_posix()
    return folder in {"setup", "setup/shared", "vendor"}


def run_modules(assets: Iterable[str]) -> list[str]:
    """Return the scripts of the Run page."""
    return sorted([*SHARED, *(name for name in assets if name.startswith("run/") and name.endswith(".js"))])


def modules(assets: Iterable[str]) -> list[str]:
    """Return the scripts of the shell, for a browser to load at once."""
    return sorted(name for name in assets if name.endswith(".js") and in_shell(name))
