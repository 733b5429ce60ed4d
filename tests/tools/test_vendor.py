"""What the pages take from others is what was built once, of named versions, and all of it is served."""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
from pathlib import Path, PurePosixPath

import pytest

from edged.adapters.web.assets import in_shell, read_assets, type_of

ROOT = Path(__file__).resolve().parents[2]
STATIC = ROOT / "edged" / "adapters" / "web" / "static"
VENDORED = (STATIC / "vendor", ROOT / "tests" / "data" / "axe")
SHELL_BYTES = 150_000
"""What a browser loads at most before somebody can set a cell up."""


@pytest.mark.parametrize("folder", VENDORED, ids=lambda folder: folder.name)
def test_nobody_has_touched_what_is_vendored(folder: Path) -> None:
    """Every file is there with the SHA-256 that was noted when it was built, and no other."""
    noted = dict(reversed(line.split("  ")) for line in (folder / "SHA256SUMS").read_text().splitlines())
    found = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}
    del found["SHA256SUMS"]

    assert noted == found


@pytest.mark.slow
def test_the_same_versions_make_the_same_bytes() -> None:
    """tools/vendor-js builds the committed files again, from archives with known SHA-256."""
    if shutil.which("npm") is None:
        pytest.skip("no npm")
    reached = subprocess.run(["npm", "view", "htm", "version"], capture_output=True, timeout=60, check=False)
    if reached.returncode != 0:
        pytest.skip("npm reaches no packages")
    built = subprocess.run(
        [ROOT / "tools" / "vendor-js", "--check"], capture_output=True, text=True, timeout=120, check=False
    )

    assert (0, "") == (built.returncode, built.stdout), built.stderr


def test_each_package_comes_with_its_licence() -> None:
    """Name, version and terms of all that is inside, in the package that people install."""
    text = (STATIC / "vendor" / "LICENCES.txt").read_text()
    table = (ROOT / "tools" / "vendor-js").read_text().partition('PACKAGES="\n')[2].partition('"\n')[0]
    packages = [line.split() for line in table.splitlines()]

    assert {"preact", "htm", "@preact/signals", "@preact/signals-core", "@fluent/bundle"} == {
        name for name, _, _ in packages
    }
    for name, version, _ in packages:
        entry = text.partition(f"{name} {version}\n")[2]
        assert "license: " in entry[:200]


def test_a_script_is_served_by_its_name_and_a_licence_is_not() -> None:
    """Every script, style, drawing and text below static/, however deep."""
    names = {path.relative_to(STATIC).as_posix() for path in STATIC.rglob("*") if path.is_file()}

    assert {name for name in names if type_of(name)} == set(read_assets())
    assert "vendor/ui.js" in read_assets()
    assert "vendor/LICENCES.txt" not in read_assets()


def test_the_shell_is_small() -> None:
    """Scripts, styles and one language around the pages that set a cell up, and with them any one page."""
    assets = read_assets()
    sizes = {name: len(text.encode()) for name, text in assets.items()}
    shell = {name for name in sizes if in_shell(name) and not name.endswith(".ftl")}
    pages = {
        PurePosixPath(name).name.split(".")[0]
        for name in sizes
        if "/pages/" in name and name.endswith(".ftl")
    }

    assert len(pages) >= 6
    for page in pages:
        names, wanted = set(shell), [f"setup/pages/{page}.js"]
        while wanted:
            name = wanted.pop()
            if name not in names:
                names.add(name)
                wanted += [f"setup/pages/{other}.js" for other in re.findall(r'"\./(\w+)\.js"', assets[name])]
        texts = max(
            sizes[f"setup/{tag}.ftl"] + sizes[f"setup/pages/{page}.{tag}.ftl"] for tag in ("en", "de")
        )
        assert sum(sizes[name] for name in names) + texts <= SHELL_BYTES, page
