"""Charts as inline SVG for reports, readable on paper and in black and white."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from markupsafe import Markup

from edged.domain.arrays import FloatArray

_LEFT, _RIGHT, _TOP, _BOTTOM = 58.0, 14.0, 12.0, 40.0  # space for the axes, px; _LEFT is a minimum
_TITLE, _LETTER = 24.0, 6.6  # width of the upright title, and of a digit in the size of report.css, px
_HALF = 480.0  # two charts of this width fit side by side, on screen and on A4
_MAX_NAMES, _MAX_LETTERS = 12, 10  # along an axis
# from light to dark, even steps of lightness: reads in grey, too (after ColorBrewer's "Blues")
_RAMP = ("#f0f6fc", "#cfe2f3", "#a6cbe6", "#73aed6", "#418bc3", "#1f66a8", "#0b3f78")
INK, GREY, ACCENT, WARN = "#1b1f24", "#424a53", "#1f66a8", "#b3541e"


@dataclass(slots=True)
class Chart:
    """Chart with two axes in the data's units; y grows downwards if its range is (high, low).

    x, y : (from, to) of the data.  equal : same scale on both axes, as for images.
    names : names of the unit steps along x, in place of numbers.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    x_label: str
    y_label: str
    width: float = 460.0
    height: float = 270.0
    equal: bool = False
    names: Sequence[str] = ()
    _marks: list[Markup] = field(default_factory=list)
    _left: float = field(init=False, default=_LEFT)

    def __post_init__(self) -> None:
        longest = max(len(label(value)) for value in ticks(*self.y))
        self._left = max(_LEFT, _TITLE + longest * _LETTER + 7.0)
        if self.equal:
            inner = self.width - self._left - _RIGHT
            self.height = inner * abs(self.y[1] - self.y[0]) / abs(self.x[1] - self.x[0]) + _TOP + _BOTTOM

    def to_x(self, value: float) -> float:
        """Convert x of the data to px in the chart."""
        inner = self.width - self._left - _RIGHT
        return self._left + (value - self.x[0]) / (self.x[1] - self.x[0]) * inner

    def to_y(self, value: float) -> float:
        """Convert y of the data to px in the chart."""
        bottom = self.height - _BOTTOM
        return bottom + (value - self.y[0]) / (self.y[1] - self.y[0]) * (_TOP - bottom)

    def points(self, xy: FloatArray, colour: str = ACCENT, radius: float = 2.0) -> None:
        """Draw small circles at (N, 2)."""
        mark = Markup('<circle cx="{:.1f}" cy="{:.1f}" r="{}" fill="{}" stroke="none" fill-opacity="0.75"/>')
        self._marks += [mark.format(self.to_x(u), self.to_y(v), radius, colour) for u, v in xy]

    def strokes(self, starts: FloatArray, ends: FloatArray, width: float = 0.8) -> None:
        """Draw short lines from (N, 2) to (N, 2), as one path."""
        path = "".join(
            f"M{self.to_x(a):.1f} {self.to_y(b):.1f}L{self.to_x(c):.1f} {self.to_y(d):.1f}"
            for (a, b), (c, d) in zip(starts, ends, strict=True)
        )
        mark = Markup('<path d="{}" stroke="{}" stroke-width="{}" fill="none"/>')
        self._marks.append(mark.format(path, ACCENT, width))

    def line(self, xy: FloatArray, colour: str = INK, dashed: bool = False) -> None:
        """Draw a polyline through (N, 2)."""
        path = " ".join(f"{self.to_x(u):.1f},{self.to_y(v):.1f}" for u, v in xy)
        mark = Markup(
            '<polyline points="{}" fill="none" stroke="{}" stroke-width="1.2" stroke-dasharray="{}"/>'
        )
        self._marks.append(mark.format(path, colour, "5 4" if dashed else "none"))

    def rectangle(self, x: tuple[float, float], y: tuple[float, float], colour: str) -> None:
        """Draw a filled box."""
        (u, w), (v, z) = sorted(map(self.to_x, x)), sorted(map(self.to_y, y))
        mark = Markup('<rect x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}" fill="{}"/>')
        self._marks.append(mark.format(u, v, w - u, z - v, colour))

    def text(self, x: float, y: float, words: str, colour: str = INK) -> None:
        """Write text centred at a place of the data."""
        self._marks.append(_words(self.to_x(x), self.to_y(y) + 3.5, words, colour=colour))

    def figure(self, caption: str) -> Markup:
        """Render the chart with axes as HTML."""
        page = Markup(
            '<figure class="{kind}"><svg xmlns="http://www.w3.org/2000/svg" '
            'viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" height="{height:.0f}" role="img">'
            "{marks}</svg>"
            "<figcaption>{caption}</figcaption></figure>"
        )
        marks = Markup().join([*self._axes(), *self._marks])
        kind = "half" if self.width <= _HALF else "whole"
        return page.format(kind=kind, width=self.width, height=self.height, marks=marks, caption=caption)

    def _axes(self) -> list[Markup]:
        left, right, bottom = self._left, self.width - _RIGHT, self.height - _BOTTOM
        middle_x, middle_y = 0.5 * (left + right), 0.5 * (_TOP + bottom)
        frame = Markup('<rect x="{}" y="{}" width="{:.1f}" height="{:.1f}" fill="#fff" stroke="#8c959f"/>')
        upright = Markup('<g transform="translate(13 {:.1f}) rotate(-90)">{}</g>')
        tick = Markup('<path d="M{:.1f} {:.1f}{}" stroke="#8c959f"/>')
        parts = [
            frame.format(f"{left:.1f}", _TOP, right - left, bottom - _TOP),
            _words(middle_x, self.height - 6, self.x_label),
            upright.format(middle_y, _words(0, 0, self.y_label)),
        ]
        for value in () if self.names else ticks(*self.x):
            u = self.to_x(value)
            parts += [tick.format(u, bottom, "v4"), _words(u, bottom + 16, label(value))]
        every = max(1, -(-len(self.names) // _MAX_NAMES))
        for i, name in list(enumerate(self.names))[::every]:
            short = name if len(name) <= _MAX_LETTERS else f"…{name[1 - _MAX_LETTERS :]}"
            parts.append(_words(self.to_x(i + 0.5), bottom + 16, short))
        for value in ticks(*self.y):
            v = self.to_y(value)
            parts += [tick.format(left, v, "h-4"), _words(left - 7, v + 4, label(value), "end")]
        return parts


def _words(x: float, y: float, text: str, anchor: str = "middle", colour: str = GREY) -> Markup:
    mark = Markup('<text x="{:.1f}" y="{:.1f}" text-anchor="{}" fill="{}">{}</text>')
    return mark.format(x, y, anchor, colour, text)


def ticks(start: float, end: float, about: int = 5) -> list[float]:
    """Round tick values (1, 2 or 5 times a power of ten apart) between two ends, in either order."""
    low, high = min(start, end), max(start, end)
    if not high > low:
        return [low]
    raw = (high - low) / about
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * next(m for m in (1.0, 2.0, 5.0, 10.0) if m * power >= raw * (1 - 1e-9))
    first = int(np.ceil(low / step - 1e-9))
    return [float(n * step) for n in range(first, int(np.floor(high / step + 1e-9)) + 1)]


def label(value: float) -> str:
    """Number of a tick as text, without rounding noise."""
    return f"{value:.6g}".replace("-", "−")


def symmetric_limit(values: FloatArray) -> float:
    """Round limit whose range from -limit to limit contains all values."""
    largest = float(np.max(np.abs(values), initial=0.0))
    if not largest > 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(largest))
    return float(next(m for m in (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0) if m * power >= largest) * power)


def colour(share: float) -> str:
    """Colour of a value, 0 for the smallest to 1 for the largest of a map."""
    return _RAMP[min(int(share * len(_RAMP)), len(_RAMP) - 1)]


def field_map(
    chart: Chart, x_edges: FloatArray, y_edges: FloatArray, values: FloatArray, text: Callable[[float], str]
) -> None:
    """Draw a map of values (rows, columns) with their numbers; NaN stays empty."""
    known = values[np.isfinite(values)]
    low, span = (float(known.min()), float(np.ptp(known))) if known.size else (0.0, 0.0)
    for row, y in enumerate(pairwise(y_edges)):
        for column, x in enumerate(pairwise(x_edges)):
            value = values[row, column]
            if np.isfinite(value):
                share = (value - low) / span if span > 0 else 0.5
                chart.rectangle(x, y, colour(share))
                chart.text(sum(x) / 2, sum(y) / 2, text(float(value)), "#fff" if share > 0.55 else INK)


def bars(names: Sequence[str], values: FloatArray, axis: str, parts: FloatArray | None = None) -> Chart:
    """Chart of vertical bars with their names. parts (N,) : a second value, as a line across each bar."""
    highest = values if parts is None else np.concatenate([values, parts])
    top = 1.05 * float(max(highest.max(), 1e-12))
    chart = Chart((0.0, float(len(names))), (0.0, top), "view", axis, 940.0, 230.0, names=names)
    for i, value in enumerate(values):
        chart.rectangle((i + 0.15, i + 0.85), (0.0, float(value)), _RAMP[3])
        if parts is not None:
            chart.line(np.array([[i + 0.15, parts[i]], [i + 0.85, parts[i]]]), WARN)
    return chart
