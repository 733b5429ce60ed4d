"""The texts of the pages that the cell writes itself, and in which language somebody gets them.

They stand in .ftl files, as those of the pages that a browser writes; of Fluent only texts of one line with
values (`{ $name }`) are read here.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from functools import partial
from importlib.resources import files
from typing import Protocol

from aiohttp import web
from markupsafe import Markup, escape

COOKIE = "edged_language"
"""What was chosen on this device: a page's script writes it (texts.js)."""
OTHERWISE = "en"
_TEXT = re.compile(r"^([a-z][a-z0-9-]*) = (.+)$", re.MULTILINE)
_VALUE = re.compile(r"\{ \$(\w+) \}")
_WEIGHT = re.compile(r"q=([01](?:\.\d{0,3})?)")


class Say(Protocol):
    """One language: a text by its id, as HTML; each value comes out as it is, `Markup` as HTML."""

    def __call__(self, name: str, /, **values: object) -> Markup:
        """Raises `KeyError` for an id that is not there, and for a value that is missing."""


class Texts:
    """Of one part, static/PART.LANGUAGE.ftl."""

    def __init__(self, part: str) -> None:
        self._by_language: dict[str, dict[str, str]] = {}
        for entry in (files(__package__) / "static").iterdir():
            name, _, kind = entry.name.rpartition(".")
            if kind == "ftl" and name.startswith(f"{part}."):
                self._by_language[name.removeprefix(f"{part}.")] = dict(
                    _TEXT.findall(entry.read_text("utf-8"))
                )

    @property
    def languages(self) -> Collection[str]:
        """Tags, such as "de"."""
        return self._by_language.keys()

    def in_language(self, tag: str) -> Say:
        """How it is said in one of `languages`."""
        return partial(_say, self._by_language[tag])


def language_of(request: web.Request, languages: Collection[str]) -> str:
    """Which of them somebody gets: as chosen on this device, else as their browser would like."""
    wanted = [request.cookies.get(COOKIE, ""), *_liked(request.headers.get("Accept-Language", ""))]
    return next((tag for tag in wanted if tag in languages), OTHERWISE)


def _liked(header: str) -> list[str]:
    """Of Accept-Language (RFC 9110), "de-CH, de;q=0.9", without regions, the dearest first."""
    weighed = list[tuple[float, str]]()
    for part in header.split(","):
        tag, has_weight, rest = part.partition(";")
        weight = _WEIGHT.fullmatch(rest.strip())
        value = float(weight[1]) if weight else 0.0 if has_weight else 1.0
        if value > 0.0:
            weighed.append((value, tag.strip().lower().partition("-")[0]))
    return [tag for _, tag in sorted(weighed, key=lambda one: -one[0])]


def _say(texts: dict[str, str], name: str, /, **values: object) -> Markup:
    return Markup(_VALUE.sub(lambda found: str(escape(values[found[1]])), str(escape(texts[name]))))
