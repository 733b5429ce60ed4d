"""Wheels without a build: each contains only a path file to existing sources."""

from __future__ import annotations

import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]


def packages_of_tests() -> list[str]:
    """Folders of the packages installed for these tests."""
    return [place for place in sys.path if place.endswith("-packages")]


def make_wheel(
    folder: Path, name: str = "edged", version: str = "0.2.0", needs: str = "", paths: Sequence[str] = ()
) -> Path:
    """A wheel whose path file points to this checkout, or to other paths."""
    info, is_own = f"{name}-{version}.dist-info", name == "edged"
    about = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\nLicense: MIT\n"
    files = {
        f"{name}_next.pth": "\n".join(paths or ((str(ROOT), *packages_of_tests()) if is_own else ())),
        f"{info}/METADATA": about + (f"Requires-Dist: {needs}\n" if needs else ""),
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: tests\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/entry_points.txt": "[console_scripts]\nedged = edged.__main__:main\n" if is_own else "",
    }
    listed = "".join(f"{file},,\n" for file in (*files, f"{info}/RECORD"))
    folder.mkdir(exist_ok=True)
    file = folder / f"{name}-{version}-py3-none-any.whl"
    with zipfile.ZipFile(file, "w") as archive:
        for place, text in {**files, f"{info}/RECORD": listed}.items():
            archive.writestr(place, text)
    return file
