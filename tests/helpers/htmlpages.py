"""Parses a page for tests: whether it is well formed, its text, and the addresses it refers to."""

from __future__ import annotations

from html.parser import HTMLParser

VOID = {"meta", "link", "img", "input", "path", "rect", "circle", "polyline"}
"""Elements without an end tag: HTML's own, and those that our SVG closes by itself."""


class HtmlPage(HTMLParser):
    """Checks that every element is closed where it must be, and collects the text.

    open : elements that were not closed.  outside : every src and href.
    """

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""
        self.outside: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Record an element as open."""
        if tag not in VOID:
            self.open.append(tag)
        self.outside += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        """Close the innermost element."""
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        """Collect text, with entities resolved."""
        self.text += data
