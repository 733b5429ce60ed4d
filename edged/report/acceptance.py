"""Report page of an acceptance test or a study, to be archived, printed and signed by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from edged.files.pdf import Text, one_page
from edged.report.page import HtmlTable, render

A4_MM = (210.0, 297.0)
LEFT_MM, TOP_MM, STEP_MM, LETTER_MM = 18.0, 22.0, 5.0, 3.4
WIDE = 100
"""Number of letters per line on the page."""


@dataclass(frozen=True, slots=True)
class ReportedTest:
    """One test in the report. verdict : a word. why : the reason if it failed, else "". figures : by name."""

    name: str
    verdict: str
    why: str
    figures: Mapping[str, str]


def acceptance_page(title: str, verdict: str, about: Mapping[str, str], tests: Sequence[ReportedTest]) -> str:
    """Render the HTML page. about : lines for its head, such as the cell and the due date."""
    return render(
        "acceptance.html",
        title=title,
        heading=title,
        verdict=verdict,
        about=HtmlTable([*about.items()]),
        tests=[
            {
                "heading": f"{test.name}: {test.verdict}",
                "why": test.why,
                "figures": HtmlTable([*test.figures.items()]),
            }
            for test in tests
        ],
    )


def acceptance_pdf(
    title: str, verdict: str, about: Mapping[str, str], tests: Sequence[ReportedTest]
) -> bytes:
    """Render one A4 page with the content of the HTML page; whatever does not fit is cut off."""
    lines: list[tuple[float, str]] = [(1.5, title), (1.2, verdict), (1.0, "")]
    lines += [(1.0, f"{name}: {value}") for name, value in about.items()]
    for test in tests:
        lines += [(1.0, ""), (1.2, f"{test.name}: {test.verdict}")]
        lines += [(1.0, part) for part in _wrapped(test.why)]
        lines += [(1.0, f"   {name}: {value}") for name, value in test.figures.items()]
    lines += [(1.0, ""), (1.0, ""), (1.0, "Name, date, signature: " + 60 * "_")]
    texts, y = [], TOP_MM
    for size, line in lines:
        texts += [Text(LEFT_MM, y, size * LETTER_MM, line)] if line and y < A4_MM[1] - STEP_MM else []
        y += STEP_MM * size
    return one_page(A4_MM, (), texts, title)


def _wrapped(text: str) -> list[str]:
    """Wrap a text into lines of the page."""
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) >= WIDE:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines if text else []
