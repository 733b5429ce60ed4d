"""Brings the generated parts of the documents up to date.

    tools/reference           writes every page whose code has changed
    tools/reference --check   writes nothing; 1 if a page is not current, and says which

A part lies between `<!-- generated: NAME -->` and `<!-- end -->`; the text around it is written by people.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from referencepages import cli, configuration, errors, files, library, packages, payloads, registers
from referencepages.markdown import ROOT

PAGES: dict[str, Mapping[str, Callable[[], str]]] = {
    "docs/reference/cli.md": cli.PARTS,
    "docs/reference/configuration.md": configuration.PARTS,
    "docs/reference/registers.md": registers.PARTS,
    "docs/reference/payloads.md": payloads.PARTS,
    "docs/reference/files.md": files.PARTS,
    "docs/reference/errors.md": errors.PARTS,
    "docs/reference/library.md": library.PARTS,
    "docs/explanation/architecture.md": packages.ARCHITECTURE,
    "CONTRIBUTING.md": packages.CONTRIBUTING,
}
PART = re.compile(r"(?<=<!-- generated: )(?P<name>[a-z-]+) -->\n.*?(?=<!-- end -->)", re.DOTALL)


def current(text: str, parts: Mapping[str, Callable[[], str]]) -> str:
    """The page with its parts as the code has them now. Raises `ValueError` unless each has one place."""
    found = [part["name"] for part in PART.finditer(text)]
    if sorted(found) != sorted(parts):
        raise ValueError(f"expected the parts {sorted(parts)}, found {sorted(found)}")
    return PART.sub(lambda part: f"{part['name']} -->\n\n{parts[part['name']]()}\n\n", text)


def main(arguments: list[str] | None = None, root: Path = ROOT) -> int:
    """Write, or check, every page of a checkout."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="write nothing; 1 when a page is not current")
    check = parser.parse_args(arguments).check
    stale = 0
    for name, parts in PAGES.items():
        path = root / name
        before = path.read_text("utf-8")
        after = current(before, parts)
        if after == before:
            continue
        stale += 1
        if check:
            print(f"{path}: not current; run tools/reference", file=sys.stderr)
        else:
            path.write_text(after, "utf-8")
            print(f"{path}: written", file=sys.stderr)
    return int(check and stale > 0)
