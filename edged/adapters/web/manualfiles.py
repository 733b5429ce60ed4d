"""The built manual as files: which there are, how each is sent, and which scripts of it may run.

Responsible for: that only files of the manual are sent, by their own names, and that a browser loads and runs
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
"""Where it is built; not there in a checkout whose manual was not."""

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
"""Our own table: the machine's differs from one to the next."""
UNKNOWN_TYPE = "application/octet-stream"

INLINE_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)
NAMED_BY_CONTENT = re.compile(r"\.[0-9a-f]{8}\.min\.(css|js)$")
"""Such a file never changes: another content has another name."""


@dataclass(frozen=True, slots=True)
class Manual:
    """A built manual.

    files : by the path below /manual/.  policy : its Content-Security-Policy.
    """

    files: Mapping[str, Path]
    policy: str

    def headers(self, path: str) -> dict[str, str]:
        """How the file at this path is sent: type, cache, policy."""
        lasting = NAMED_BY_CONTENT.search(path) is not None
        return {
            "Content-Type": TYPES.get(Path(path).suffix, UNKNOWN_TYPE),
            "Cache-Control": "private, max-age=31536000, immutable" if lasting else "private, no-cache",
            "Content-Security-Policy": self.policy,
        }


def is_built(folder: Path) -> bool:
    """Whether a manual is there; asked at each page, as it may be built meanwhile."""
    return (folder / "index.html").is_file()


def read_manual(folder: Path) -> Manual | None:
    """What was built into a folder; None where nothing was."""
    files = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    if "index.html" not in files:
        return None
    pages = [path.read_text("utf-8") for name, path in files.items() if name.endswith(".html")]
    return Manual(files, _policy({script for page in pages for script in INLINE_SCRIPT.findall(page)}))


def _policy(inline_scripts: set[str]) -> str:
    """Our own files, and the scripts that stand in the pages, by their hashes.

    Beyond the status page's own policy: the search is a worker, icons are data in style sheets, and a table's
    columns are aligned by attributes.
    """
    hashes = sorted(b64encode(sha256(script.encode()).digest()).decode() for script in inline_scripts)
    allowed = " ".join(f"'sha256-{digest}'" for digest in hashes)
    return (
        f"default-src 'none'; script-src 'self' {allowed}; worker-src 'self'; style-src 'self'; "
        "style-src-attr 'unsafe-inline'; img-src 'self' data:; connect-src 'self'; form-action 'self'; "
        "frame-ancestors 'none'; base-uri 'none'"
    )
