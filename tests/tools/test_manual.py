"""The manual builds without a warning, every link is right, and it loads nothing from elsewhere."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import unquote, urlsplit

import manuallinks
import pytest

from edged.adapters.web.manualfiles import Manual, read_manual

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
LOADS = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src"}


def build(source: Path, site: Path) -> subprocess.CompletedProcess[str]:
    """Run tools/manual of a checkout."""
    return subprocess.run(
        [source / "tools" / "manual", site], capture_output=True, text=True, timeout=300, check=False
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The manual of this checkout, built in a temporary folder."""
    folder = tmp_path_factory.mktemp("manual") / "site"
    built = build(ROOT, folder)
    assert 0 == built.returncode, built.stderr
    return folder


def manual_of(site: Path) -> Manual:
    """The manual as the status page reads it."""
    manual = read_manual(site)
    assert manual is not None
    return manual


class _Html(HTMLParser):
    """What a page loads, its links and anchors, and what the policy forbids."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.inline: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "style":
            self.inline.append(tag)
        for name, value in attrs:
            if name == LOADS.get(tag) and value is not None:
                self.loads.append(value)
            elif (tag, name) == ("a", "href") and value is not None:
                self.links.append(value)
            elif name == "id" and value is not None:
                self.anchors.add(value)
            elif name.startswith("on"):
                self.inline.append(f"{tag} {name}")


def pages_of(site: Path) -> dict[str, _Html]:
    """Each built page except 404.html, whose addresses are right at a server's root only."""
    names = [name for name in manual_of(site).files if name.endswith(".html") and name != "404.html"]
    return {name: _Html((site / name).read_text()) for name in names}


@pytest.mark.slow
def test_every_page_of_the_manual_is_built(site: Path) -> None:
    """Each page of docs/ is built under its own name."""
    sources = {page.relative_to(ROOT / "docs") for page in PAGES}
    assert {str(page.with_suffix(".html")) for page in sources} == set(pages_of(site))


@pytest.mark.slow
def test_every_address_in_the_built_manual_is_there(site: Path) -> None:
    """Files and anchors that are loaded or linked exist."""
    pages = pages_of(site)
    missing = []
    for name, page in pages.items():
        for address in map(urlsplit, (*page.loads, *page.links)):
            if address.scheme:
                continue
            path = os.path.normpath(Path(name).parent / unquote(address.path)) if address.path else name
            entered = pages[path].anchors if path in pages else set()
            known = not address.fragment or address.fragment in entered or address.fragment == "__skip"
            if not (site / path).is_file() or not known:
                missing.append(f"{name}: {address.geturl()}")
    assert [] == missing


@pytest.mark.slow
def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    """No page names another host for what it loads, because a cell PC has no internet."""
    for name, page in pages_of(site).items():
        assert [] == [one for one in page.loads if urlsplit(one).netloc], name
        assert [] == page.inline, name
        assert 'class="mermaid"' not in (site / name).read_text(), name  # loads its program from elsewhere
    for sheet in site.rglob("*.css"):
        assert not re.search(r"(url\(|@import)\s*['\"]?(https?:)?//", sheet.read_text()), sheet


@pytest.mark.slow
def test_every_script_in_a_page_is_allowed_to_run(site: Path) -> None:
    """The policy has as many hashes as there are different inline scripts."""
    texts = [(site / name).read_text() for name in pages_of(site)]
    scripts = {script for text in texts for script in re.findall(r"<script>(.*?)</script>", text, re.DOTALL)}

    assert 0 < len(scripts) <= manual_of(site).policy.count("'sha256-")
    other = {tag for text in texts for tag in re.findall(r"<script\b[^>]*>", text)} - {"<script>"}
    assert [] == [tag for tag in other if "src=" not in tag and 'type="application/json"' not in tag]


@pytest.mark.slow
def test_the_search_knows_what_the_pages_say(site: Path) -> None:
    """The search index has a fault's name on the page of faults."""
    index = (site / "search" / "search_index.json").read_text()
    assert "reference/errors.html#faults-of-the-cameras" in index
    assert "StreamStalled" in index


@pytest.mark.long
def test_a_warning_ends_the_build(tmp_path: Path) -> None:
    """A link to a missing page or heading fails the build and is named."""
    for name in ("docs", "mkdocs.yml", "tools/manual", "tools/manuallinks.py", "edged/__init__.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, tmp_path / name)
    page = tmp_path / "docs" / "reference" / "errors.md"
    for link in ("nowhere.md", "files.md#nothing"):
        page.write_text(f"# Errors\n\n[there]({link})\n")
        built = build(tmp_path, tmp_path / "site")
        assert 0 != built.returncode
        assert f"'{link}'" in built.stderr


def test_files_of_the_repository_are_named_not_linked() -> None:
    """A link to a file of the repository becomes its name; other links stay."""
    config = SimpleNamespace(docs_dir=str(ROOT / "docs"))
    page = SimpleNamespace(file=SimpleNamespace(src_uri="reference/files.md"))
    given = "[cell](../../config/cell.toml) [x](../../config/nothing) [y](../index.md) ![z](../../README.md)"

    found = manuallinks.on_page_markdown(given, page=page, config=config)  # type: ignore[arg-type]  # what it reads of them
    assert "cell [x](../../config/nothing) [y](../index.md) ![z](../../README.md)" == found
