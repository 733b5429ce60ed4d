"""What a browser may load of the pages: scripts, styles, drawings and texts, by their names below static/."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.resources import files
from pathlib import PurePosixPath

TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".ftl": "text/plain"}
"""By the end of the name; what ends otherwise (licences, check sums) is for who looks into the package."""
SHARED = ("setup/api.js", "setup/texts.js", "vendor/ui.js")
"""Scripts that the Run page has in common with those that set the cell up."""


def read_assets() -> dict[str, str]:
    """Names, such as "setup/main.js", to texts."""
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
    """Its media type; "" for what is not served."""
    return TYPES.get(PurePosixPath(name).suffix, "")


def in_shell(name: str) -> bool:
    """Whether it stands around the pages that set a cell up; a page comes when it is entered."""
    return name.startswith(("setup/", "vendor/")) and not name.startswith("setup/pages/")


def run_modules(assets: Iterable[str]) -> list[str]:
    """Scripts of the Run page, all at once likewise."""
    return sorted([*SHARED, *(name for name in assets if name.startswith("run/") and name.endswith(".js"))])


def modules(assets: Iterable[str]) -> list[str]:
    """Scripts of that shell: a browser is told of all at once, and need not find them."""
    return sorted(name for name in assets if name.endswith(".js") and in_shell(name))
