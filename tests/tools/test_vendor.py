"""The pages' third-party files are as they were built, from named versions, and all of them are served."""

from __future__ import annotations

import hashlib
import posixpath
import re
import shutil
import subprocess
from pathlib import Path, PurePosixPath

import pytest
from helpers.waiting import LIMIT_S

from edged.adapters.web.assets import in_shell, read_assets, run_modules, type_of

ROOT = Path(__file__).resolve().parents[2]
STATIC = ROOT / "edged" / "adapters" / "web" / "static"
VENDORED = (STATIC / "vendor", ROOT / "tests" / "data" / "axe")
SHELL_BYTES = 150_000
"""The most that a browser loads until a cell can be set up."""
PAGE_BYTES = 88_000
"""The most that it loads for one step, in the longest language: a Japanese character takes three bytes."""
RUN_BYTES = 109_000
"""The most that it loads to show a running cell."""


@pytest.mark.parametrize("folder", VENDORED, ids=lambda folder: folder.name)
def test_nobody_has_touched_what_is_vendored(folder: Path) -> None:
    """Every file has the SHA-256 that was noted when it was built, and there is no other file."""
    noted = dict(reversed(line.split("  ")) for line in (folder / "SHA256SUMS").read_text().splitlines())
    found = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}
    del found["SHA256SUMS"]

    assert noted == found


@pytest.mark.long
def test_the_same_versions_make_the_same_bytes() -> None:
    """tools/vendor-js builds the committed files again, from archives with known SHA-256."""
    if shutil.which("npm") is None:
        pytest.skip("no npm")
    try:
        subprocess.run(["npm", "view", "htm", "version"], capture_output=True, timeout=LIMIT_S, check=True)
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired):
        pytest.skip("npm reaches no packages")
    built = subprocess.run(
        [ROOT / "tools" / "vendor-js", "--check"], capture_output=True, text=True, timeout=120, check=False
    )

    assert (0, "") == (built.returncode, built.stdout), built.stderr


def test_each_package_comes_with_its_licence() -> None:
    """LICENCES.txt has the name, version and licence of each vendored package."""
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
    """Every script, style, drawing and text below static/ is served by its name, and no licence."""
    names = {path.relative_to(STATIC).as_posix() for path in STATIC.rglob("*") if path.is_file()}

    assert {name for name in names if type_of(name)} == set(read_assets())
    assert "vendor/ui.js" in read_assets()
    assert "vendor/LICENCES.txt" not in read_assets()


def imports(name: str, script: str) -> set[str]:
    """The names of the modules that a module imports."""
    folder = PurePosixPath(name).parent
    return {posixpath.normpath(folder / other) for other in re.findall(r'from "([./]+[\w/]+\.js)"', script)}


def test_the_shell_is_small_and_so_is_each_page() -> None:
    """The common files with the first page, and each page, in the longest language, are within their
    limits."""
    assets = read_assets()
    sizes = {name: len(text.encode()) for name, text in assets.items()}
    texts = {name: size for name, size in sizes.items() if name.endswith(".ftl")}
    shell = sum(size for name, size in sizes.items() if in_shell(name) and name not in texts)
    shell += max(size for name, size in texts.items() if in_shell(name))
    pages = {
        name.removesuffix(".en.ftl")
        for name in texts
        if not in_shell(name) and name.startswith("setup/") and name.endswith(".en.ftl")
    }
    loaded = dict.fromkeys(pages, 0)
    for page in pages:
        names, wanted = set[str](), [f"{page}.js"]
        while wanted:
            name = wanted.pop()
            if name not in names and not in_shell(name):
                names.add(name)
                wanted += imports(name, assets[name])
        own = max(size for name, size in texts.items() if name.startswith(f"{page}."))
        loaded[page] = sum(sizes[name] for name in names) + own + sizes[f"{page}.css"]

    assert shell + loaded["setup/cell/welcome"] <= SHELL_BYTES
    assert {} == {page: size for page, size in loaded.items() if size > PAGE_BYTES}


def test_the_run_page_is_light() -> None:
    """The Run page names all its files to the browser at once, and they are within the limit."""
    assets = read_assets()
    scripts = run_modules(assets)
    imported = set[str]()
    for name in scripts:
        imported |= imports(name, assets[name])
    tags = [name.split(".")[-2] for name in assets if name.startswith("run/run.") and name.endswith(".ftl")]
    texts = max(len((assets[f"setup/{tag}.ftl"] + assets[f"run/run.{tag}.ftl"]).encode()) for tag in tags)

    assert len(tags) == 5

    assert imported <= set(scripts)
    assert sum(len(assets[name].encode()) for name in [*scripts, "run/run.css"]) + texts <= RUN_BYTES
