"""HTML from templates, with a common skeleton for the reports and the status page. All values are escaped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined


@dataclass(frozen=True, slots=True)
class HtmlTable:
    """Table of text cells: rows below a head, which may be empty."""

    rows: Sequence[Sequence[str]]
    head: Sequence[str] = ()


def render(template: str, package: str = "edged.report", **values: object) -> str:
    """Render a page. template : file in the package's templates, which may extend those of the reports.

    Text among the values is shown literally, whatever it contains; `markupsafe.Markup` is taken as HTML.
    Raises `jinja2.UndefinedError` if a value that the template needs is missing.
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
