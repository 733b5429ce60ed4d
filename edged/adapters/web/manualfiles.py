"""Files of the built manual: which there are, with which headers each is sent, and which scripts may run.

Responsible for: serving only files of the manual, by their own names, and letting a browser load and run
nothing else. Not responsible for who may see it (`server`), nor for building it (`tools/manual`).
"""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

FOLDER = Path(__file__).parent / "manual"
"""Folder that the manual is built into; missing in a checkout where it was not built."""

TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".map": "application/json",
    ".xml": "application/xml",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".gz": "application/gzip",
}
"""Our own table, since the system's differs from machine to machine."""
UNKNOWN_TYPE = "application/octet-stream"

INLINE_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)
NAMED_BY_CONTENT = re.compile(r"\.[0-9a-f]{8}\.min\.(css|js)$")
"""Names of files that never change: their hash is part of the name."""


@dataclass(frozen=True, slots=True)
class Manual:
    """A built manual.

    files : by the path below /manual/.  policy : its Content-Security-Policy.
    """

    files: Mapping[str, Path]
    policy: str

    def headers(self, path: str) -> dict[str, str]:
        """Headers of the file at this path: type, caching, policy."""
        lasting = NAMED_BY_CONTENT.search(path) is not None
        return {
            "Content-Type": TYPES.get(Path(path).suffix, UNKNOWN_TYPE),
            "Cache-Control": "private, max-age=31536000, immutable" if lasting else "private, no-cache",
            "Content-Security-Policy": self.policy,
        }


def is_built(folder: Path) -> bool:
    """Whether there is a manual; checked for each page, as it may be built meanwhile."""
    return (folder / "index.html").is_file()


def read_manual(folder: Path) -> Manual | None:
    """The manual built into a folder; None where there is none."""
    files = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    if "index.html" not in files:
        return None
    pages = [path.read_text("utf-8") for name, path in files.items() if name.endswith(".html")]
    return Manual(files, _policy({script for page in pages for script in INLINE_SCRIPT.findall(page)}))


def _policy(inline_scripts: set[str]) -> str:
    """Policy that allows our own files, and the scripts inside the pages by their hashes.

    It allows more than the status page's policy because the search runs in a worker, style sheets hold icons
    as data, and columns of tables are aligned by attributes.
    """
    hashes = sorted(b64encode(sha256(script.encode()).digest()).decode() for script in inline_scripts)
    allowed = " ".join(f"'sha256-{digest}'" for digest in hashes)
    return (
        f"default-src 'none'; script-src 'self' {allowed}; worker-src 'self'; style-src 'self'; "
        "style-src-attr 'unsafe-inline'; img-src 'self' data:; connect-src 'self'; form-action 'self'; "
        "frame-ancestors 'none'; base-uri 'none'"
    )
