"""A hook of MkDocs (`mkdocs.yml`): links from the manual to files of the repository become their names.

They can be followed in docs/ in the repository; the manual on a cell PC has no such files.
"""

from __future__ import annotations

import os.path
import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.pages import Page

LINK = re.compile(r"(?<!!)\[(?P<text>[^\]]*)\]\((?P<target>\.\./[^)\s#]*)\)")


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, **_rest: object) -> str:
    """The page without links to files that are in the repository and not in docs/."""
    docs = Path(config.docs_dir)
    folder = docs / Path(page.file.src_uri).parent

    def named(link: re.Match[str]) -> str:
        target = Path(os.path.normpath(folder / link["target"]))
        leads_out = not target.is_relative_to(docs) and target.exists()
        return link["text"] if leads_out else link[0]

    return LINK.sub(named, markdown)
