"""Texts of the pages rendered on the server, and the language of a request.

They are in Fluent files, static/PART.LANGUAGE.ftl, like the texts of the pages rendered in the browser.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from functools import partial
from importlib.resources import files
from typing import Protocol

from aiohttp import web
from fluent.runtime import FluentBundle, FluentResource
from fluent.syntax.ast import TextElement
from fluent.syntax.visitor import Transformer
from markupsafe import Markup, escape

COOKIE = "edged_language"
"""Cookie with the language chosen on this device; set by a script of the page (texts.js)."""
DEFAULT = "en"
_WEIGHT = re.compile(r"q=([01](?:\.[0-9]{0,3})?)")


class Say(Protocol):
    """Texts in one language: returns a text by its id, as HTML; values are escaped, except `Markup`."""

    def __call__(self, name: str, /, **values: object) -> Markup:
        """Return a text. Raises `KeyError` for an unknown id, and for a missing value."""


class Texts:
    """Texts of one part in every language: static/PART.LANGUAGE.ftl."""

    def __init__(self, part: str) -> None:
        self._bundles: dict[str, FluentBundle] = {}
        for entry in (files(__package__) / "static").iterdir():
            if found := re.fullmatch(rf"{part}\.(\w+)\.ftl", entry.name):
                self._bundles[found[1]] = _bundle(found[1], entry.read_text("utf-8"))

    @property
    def languages(self) -> Collection[str]:
        """Language tags, such as "de"."""
        return self._bundles.keys()

    def in_language(self, tag: str) -> Say:
        """Return the texts in one of `languages`."""
        return partial(_say, self._bundles[tag])


def language_of(request: web.Request, languages: Collection[str]) -> str:
    """Return the language chosen on this device, else the one that the browser prefers."""
    wanted = [request.cookies.get(COOKIE, ""), *_accepted(request.headers.get("Accept-Language", ""))]
    return next((tag for tag in wanted if tag in languages), DEFAULT)


def _accepted(header: str) -> list[str]:
    """Languages in Accept-Language (RFC 9110), "de-CH, de;q=0.9", without regions, most preferred first."""
    weighed = list[tuple[float, str]]()
    for part in header.split(","):
        tag, has_weight, rest = part.partition(";")
        weight = _WEIGHT.fullmatch(rest.strip())
        value = float(weight[1]) if weight else 0.0 if has_weight else 1.0
        if value > 0.0:
            weighed.append((value, tag.strip().lower().partition("-")[0]))
    return [tag for _, tag in sorted(weighed, key=lambda pair: -pair[0])]


class _Escape(Transformer):
    """Escapes the text of a file for HTML; values are escaped when they are filled in."""

    def visit_TextElement(self, node: TextElement) -> TextElement:  # noqa: N802  (named after the node)
        node.value = str(escape(node.value))
        return node


def _bundle(tag: str, text: str) -> FluentBundle:
    bundle = FluentBundle([tag], use_isolating=False)
    bundle.add_resource(_Escape().visit(FluentResource(text)))
    return bundle


def _say(bundle: FluentBundle, name: str, /, **values: object) -> Markup:
    pattern = bundle.get_message(name).value
    if pattern is None:
        raise KeyError(name)
    text, errors = bundle.format_pattern(pattern, {key: str(escape(value)) for key, value in values.items()})
    if errors:
        raise KeyError(name, *errors)
    return Markup(str(text))
