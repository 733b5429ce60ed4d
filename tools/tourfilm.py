"""The two-minute tour: the newcomer's clicks (`newcomerclicks`) as an animated SVG, remade by `tools/tour`.

Each picture shows the page when it was clicked, with the place of the click. Only the changes from the
picture before are stored, as WebP. Style sheets show them one after the other, so that it plays wherever an
image may be used, without a script. Readers who prefer no motion see its first picture.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import sys
import tempfile
import time
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import bench_newcomer
import cv2
import numpy as np
from newcomerclicks import SIZE

from edged.domain.arrays import Image
from edged.files.atomic import write_file

TOUR = Path(__file__).resolve().parent.parent / "docs" / "tour.svg"
MOST_BYTES = 1_500_000
WIDTH, HEIGHT, CAPTION = 960, 675, 45
"""Size of a picture in px, and height of the caption below it."""
WHOLE_S = 120.0
QUALITIES = (60, 50, 42, 35, 28, 22)
"""WebP qualities; the best one that is small enough is used."""
LOOK_S, LONGER = 6.0, 1.35
"""Interval of pictures while nobody clicks, and its growth, as each takes longer on a slow machine."""
CELL = 5
"""Pictures are compared by the means of squares of this many px."""
NOISE_GREY = 12
"""Least difference that counts as a change, as two pictures of a camera are never identical."""
CAPTIONS = {
    "log in": "Log in by name and password",
    "take the cell": "Take the cell: it answers no PLC meanwhile",
    "open the stage": "The virtual stage: these buttons are your hands",
    "cameras": "Wave before the left camera: left and right are told apart",
    "light": "Light and focus, judged with a board before the cameras",
    "calibrate": "Hold the board where it is drawn: views are taken by themselves",
    "check": "Check the calibration with one fresh pair",
    "teach": "Teach the part: one pair, and the proposal is taken",
    "try": "Try it: the part anywhere, and 30 pictures while it lies still",
    "robot": "Register the robot by touching points, proved by one more",
    "go live": "Give the cell back: a PLC reads a VALID result",
}


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A picture of the page. click : place of the next click, px of the picture; None: no click."""

    picture: Image
    click: tuple[float, float] | None


@dataclass(slots=True, eq=False)
class Film:
    """Pictures of a newcomer's set-up, step by step, as reported by `newcomerclicks.set_up`."""

    shots: list[Shot] = field(default_factory=list)
    steps: list[tuple[str, int]] = field(default_factory=list)
    _looked_s: float = 0.0
    _pause_s: float = LOOK_S

    def see(self, png: bytes, click: tuple[float, float] | None = None) -> None:
        """Add a picture, at a click or in between."""
        whole = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
        picture = cv2.resize(whole, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        place = None if click is None else (click[0] * WIDTH / SIZE[0], click[1] * HEIGHT / SIZE[1])
        self.shots.append(Shot(np.asarray(picture), place))
        self._looked_s = time.monotonic()
        self._pause_s = self._pause_s * LONGER if click is None else LOOK_S

    def is_due(self) -> bool:
        """Whether a picture is wanted though nobody clicks."""
        return time.monotonic() - self._looked_s > self._pause_s

    def end(self, step: str) -> None:
        """End a step."""
        self.steps.append((step, len(self.shots)))


def changed(before: Image, after: Image) -> list[tuple[int, int, int, int]]:
    """Left, top, right, bottom of each changed area."""
    small = (-(-WIDTH // CELL), -(-HEIGHT // CELL))
    first, second = (
        cv2.resize(picture, small, interpolation=cv2.INTER_AREA).astype(np.int16)
        for picture in (before, after)
    )
    other = (np.abs(second - first).max(axis=2) > NOISE_GREY).astype(np.uint8)
    count, _, stats, _ = cv2.connectedComponentsWithStats(cv2.dilate(other, np.ones((3, 3), np.uint8)))
    return [
        (CELL * x, CELL * y, min(CELL * (x + width), WIDTH), min(CELL * (y + height), HEIGHT))
        for x, y, width, height in stats[1:count, :4].tolist()
    ]


def svg_of(film: Film, quality: int) -> str:
    """The animation as SVG. quality : of its pictures, 1 to 100."""
    each_s = WHOLE_S / len(film.shots)
    shown = film.shots[0].picture
    images, clicks, rules = [], [], []
    for number, shot in enumerate(film.shots):
        at = 100.0 * number / len(film.shots)
        parts = changed(shown, shot.picture) if number else [(0, 0, WIDTH, HEIGHT)]
        shown = shown.copy()
        for count, (left, top, right, bottom) in enumerate(parts):
            name = f"i{number}-{count}"
            part = shot.picture[top:bottom, left:right]
            _, data = cv2.imencode(".webp", part, [cv2.IMWRITE_WEBP_QUALITY, quality])
            text = base64.b64encode(data.tobytes()).decode()
            images.append(
                f'<image id="{name}" x="{left}" y="{top}" width="{right - left}" height="{bottom - top}" '
                f'href="data:image/webp;base64,{text}"/>'
            )
            shown[top:bottom, left:right] = part
            if number:
                rules.append(_from(name, at))
        if shot.click is not None:
            x, y = shot.click
            clicks.append(f'<circle id="c{number}" class="click" cx="{x:.0f}" cy="{y:.0f}" r="16"/>')
            rules.append(_between(f"c{number}", at + 30 / len(film.shots), at + 100 / len(film.shots)))
    captions, first = [], 0
    for place_of, (step, end) in enumerate(film.steps):
        start, stop = 100 * first / len(film.shots), 100 * end / len(film.shots)
        captions.append(
            f'<text id="t{place_of}" x="14" y="{HEIGHT + 29}">{place_of + 1}  {escape(CAPTIONS[step])}</text>'
        )
        rules.append(_between(f"t{place_of}", start, stop))
        first = end
    bar = f'<rect id="bar" y="{HEIGHT}" width="{WIDTH}" height="3"/>'
    total = len(film.shots) * each_s
    style = (
        f"text{{font:600 19px system-ui,sans-serif;fill:#fff}}#bar{{fill:#6cb1f5;transform-origin:0 0;"
        f"animation:bar {total:g}s linear infinite}}@keyframes bar{{from{{transform:scaleX(0)}}}}"
        ".click{fill:#f2bd5288;stroke:#8a5a00;stroke-width:3}"
        f"image+image,circle,text{{visibility:hidden;animation:{total:g}s step-end infinite}}"
        "#t0{visibility:visible}"
        + "".join(rules)
        + "@media(prefers-reduced-motion:reduce){*{animation-play-state:paused!important}}"
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT + CAPTION}" role="img">'
        "<title>Setting up the virtual stage by clicks, from an empty folder to a VALID result</title>"
        f"<style>{style}</style>"
        f'<rect width="{WIDTH}" height="{HEIGHT + CAPTION}" fill="#16191f"/>'
        f"{''.join(images)}{''.join(clicks)}{bar}{''.join(captions)}</svg>\n"
    )


def _from(name: str, start: float) -> str:
    """Keyframes: visible from a share of the time on, %."""
    return f"#{name}{{animation-name:{name}}}@keyframes {name}{{{start:.3f}%,to{{visibility:visible}}}}"


def _between(name: str, start: float, stop: float) -> str:
    """Keyframes: visible between two shares of the time, %."""
    ends = f"{stop:.3f}%,to{{visibility:hidden}}" if stop < 99.99 else "to{visibility:visible}"
    return f"#{name}{{animation-name:{name}}}@keyframes {name}{{{start:.3f}%{{visibility:visible}}{ends}}}"


def main() -> int:
    """Set up the stage as the bench does, and write the film."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, default=TOUR)
    options = parser.parse_args()
    film = Film()
    way = bench_newcomer.newcomer_parser().parse_args(
        ["--browser", "--parts", "1", "--seed", str(options.seed)]
    )
    way.film = film
    with tempfile.TemporaryDirectory(prefix="edged-tour-") as folder:
        found = asyncio.run(bench_newcomer.newcomer_of(way, Path(folder)))
    for quality in QUALITIES:
        text = svg_of(film, quality).encode()
        if len(text) <= MOST_BYTES:
            break
    else:
        print(f"tools/tour: {len(text)} bytes at the least quality", file=sys.stderr)
        return 1
    write_file(options.output, text)
    print(
        f"{options.output.name}: {len(text) / 1e6:.2f} MB, {len(film.shots)} pictures of quality {quality}, "
        f"{found['clicks']} clicks"
    )
    return 0
