"""HTML from templates: one skeleton for the reports and the status page. The engine escapes every value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined


@dataclass(frozen=True, slots=True)
class HtmlTable:
    """Rows of cells of text below their head, which may be empty."""

    rows: Sequence[Sequence[str]]
    head: Sequence[str] = ()


def render(template: str, package: str = "edged.report", **values: object) -> str:
    """A page. template : a file in the package's templates, which may extend those of the reports.

    A text among the values comes out as it is, whatever it contains; `markupsafe.Markup` is HTML already.
    Raises `jinja2.UndefinedError` for a value that the template needs and does not get.
    """
    return _environment(package).get_template(template).render(values)


@cache
def _environment(package: str) -> Environment:
    return Environment(
        loader=ChoiceLoader([PackageLoader(name) for name in dict.fromkeys((package, "edged.report"))]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
