"""`edged watch`: live results of every cell that is reachable over Zenoh."""

from __future__ import annotations

import json
import queue
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

from rich import box
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from edged.app.fleet import Document, News, is_cell_name, news_of_cells
from edged.errors import UserError

REFRESH_S = 0.25
SILENCE_HINT_S = 3.0
MAX_TEXT = 200
STYLES = {"OK": "green", "READY": "green", "BUSY": "green", "CAPTURE_FAULT": "bold red", "FAULT": "bold red"}
GONE = "GONE"


@dataclass(slots=True)
class CellView:
    """What is known of one cell."""

    state: str = "?"
    error: str = ""
    rate_hz: float | None = None
    target: Document = field(default_factory=dict)
    age_at_arrival_s: float = 0.0
    arrived_s: float = 0.0
    lost: int = 0

    def take(self, news: News, now_s: float, utc_ns: int) -> None:
        """Take a message in; now_s : monotonic, utc_ns : of this machine."""
        document = news.document
        if news.kind == "alive":
            self.state = GONE if not document["alive"] else ("?" if self.state == GONE else self.state)
        elif news.kind == "state":
            self.state, self.error = _text(document, "state"), _text(document, "error")
        elif news.kind == "health":
            self.rate_hz = _number(document.get("rate_hz"))
        elif news.kind == "target":
            self.lost += _gap(self.target, document)
            # after the first one, which may be old, only this machine's clock counts: clocks differ
            exposed_ns = utc_ns if self.target else _number(document.get("exposed_ns")) or utc_ns
            self.age_at_arrival_s = max(0.0, (utc_ns - exposed_ns) / 1e9)
            self.target, self.arrived_s = document, now_s

    def age_s(self, now_s: float) -> float | None:
        """Age of the last result."""
        return self.age_at_arrival_s + now_s - self.arrived_s if self.target else None


def watch(connect: list[str], cell: str | None, as_json: bool, count: int | None, console: Console) -> int:
    """Show results until ctrl-C, or until `count` results have come.

    On a terminal a table of cells; elsewhere one line per result; with `as_json` the messages
    themselves, one JSON object a line. Raises `UserError` for endpoints or names that cannot be.
    """
    if cell is not None and not is_cell_name(cell):
        raise UserError(f"--cell {cell!r}: expected the name of a cell (letters, digits, '_', '.', '-')")
    with news_of_cells(connect, cell) as inbox:
        stream = _stream(inbox, connect)
        try:
            if as_json:
                _print_json(stream, count)
            elif console.is_terminal:
                _show_table(stream, count, console)
            else:
                _print_lines(stream, count, console)
        except KeyboardInterrupt:
            pass  # the usual way to leave
    return 0


def _stream(inbox: queue.Queue[News], connect: list[str]) -> Iterator[News | None]:
    """News as it comes; None when there was none for a while. Says so when nobody is there."""
    started_s, silent = time.monotonic(), True
    while True:
        try:
            news = inbox.get(timeout=REFRESH_S)
        except queue.Empty:
            if silent and time.monotonic() - started_s > SILENCE_HINT_S:
                silent = False
                places = ", ".join(connect)
                sys.stderr.write(f"edged: nothing from {places} yet: does a cell run and listen there?\n")
            yield None
        else:
            silent = False
            yield news


def _results(stream: Iterator[News | None], count: int | None) -> Iterator[News | None]:
    """The stream, ended after `count` results."""
    left = count
    for news in stream:
        yield news
        if news is not None and news.kind == "target" and left is not None:
            left -= 1
            if left == 0:
                return


def _print_json(stream: Iterator[News | None], count: int | None) -> None:
    for news in _results(stream, count):
        if news is not None and news.kind == "target":
            sys.stdout.write(json.dumps(news.document) + "\n")
            sys.stdout.flush()


def _print_lines(stream: Iterator[News | None], count: int | None, console: Console) -> None:
    for news in _results(stream, count):
        if news is not None and news.kind == "target":
            console.print(_line(news), markup=False, highlight=False, soft_wrap=True)


def _show_table(stream: Iterator[News | None], count: int | None, console: Console) -> None:
    cells: dict[str, CellView] = {}
    drawn_s = 0.0
    with Live(_table(cells, 0.0), console=console, auto_refresh=False) as live:
        for news in _results(stream, count):
            now_s = time.monotonic()
            if news is not None:
                cells.setdefault(news.cell, CellView()).take(news, now_s, time.time_ns())
            if now_s - drawn_s >= REFRESH_S:
                live.update(_table(cells, now_s), refresh=True)
                drawn_s = now_s
        live.update(_table(cells, time.monotonic()), refresh=True)


def _line(news: News) -> str:
    document = news.document
    frame, pose = _pose(document)
    place = ""
    if pose:
        sigma = _triple(pose.get("sigma_mm"), "{:.4f}")
        place = f"  {_triple(pose.get('position_mm'), '{:9.3f}')} mm ({frame})  sigma {sigma}"
    cycle, status, job, error = (_text(document, name) for name in ("cycle", "status", "job", "error"))
    drift = _drift(document)
    error += _drift_text(drift) if drift else ""
    return f"{news.cell}  cycle {cycle:>6s}  {status:13s} {job}{place}  {error}".rstrip()


def _table(cells: dict[str, CellView], now_s: float) -> Table:
    """Fits 80 columns; errors go below, where they have room."""
    errors = [
        f"{name}: {error}"
        for name, cell in sorted(cells.items())
        if (error := cell.error or _text(cell.target, "error"))
    ]
    drifting = {name: drift for name, cell in sorted(cells.items()) if (drift := _drift(cell.target))}
    errors += [f"{name}: {_drift_text(drift)}" for name, drift in drifting.items()]
    table = Table(
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
        caption=Text("\n".join(errors) if cells else "no cell yet", style="bold red" if errors else "dim"),
        caption_justify="left",
    )
    for heading in ("cell", "state", "job", "result"):
        table.add_column(heading, overflow="fold")
    table.add_column("X Y Z mm", justify="right", no_wrap=True)
    lost = any(cell.lost for cell in cells.values())
    for heading in ("σ mm", "Hz", "age s", *(["drift"] if drifting else []), *(["lost"] if lost else [])):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, cell in sorted(cells.items()):
        frame, pose = _pose(cell.target)
        status = _text(cell.target, "status")
        table.add_row(
            name,
            _styled(cell.state),
            Text(_text(cell.target, "job")),
            _styled(status).append(" sim" if cell.target.get("simulated") else "", style="yellow"),
            f"{_triple(pose.get('position_mm'), '{:.3f}')} {frame}" if pose else "",
            _largest(pose.get("sigma_mm")),
            _shown(cell.rate_hz, "{:.1f}"),
            _shown(cell.age_s(now_s), "{:.1f}"),
            *([_styled(_text(drifting.get(name, {}), "verdict"))] if drifting else []),
            *([str(cell.lost)] if lost else []),
        )
    return table


def _styled(word: str) -> Text:
    return Text(word, style=STYLES.get(word, "yellow"))


def _text(document: Document, name: str) -> str:
    """A field as a short text without control characters: what others publish must not steer a terminal."""
    value = document.get(name)
    text = "" if value is None else str(value)[:MAX_TEXT]
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _drift(document: Document) -> Document:
    """What a result says of a calibration that does not hold; {} while it does."""
    drift = document.get("drift")
    known = isinstance(drift, dict) and drift.get("verdict") not in (None, "HOLDS")
    return drift if known and isinstance(drift, dict) else {}


def _drift_text(drift: Document) -> str:
    rows, length = _shown(drift.get("rows_px"), "{:.2f}"), _shown(drift.get("length_percent"), "{:+.2f}")
    verdict = _text(drift, "verdict").lower()
    return f"calibration {verdict}: rows {rows} px, known length {length} %"


def _first(document: Document) -> Document:
    """The best target of a result, {} if it has none."""
    targets = document.get("targets")
    first = targets[0] if isinstance(targets, list) and targets else {}
    return first if isinstance(first, dict) else {}


def _pose(document: Document) -> tuple[str, Document]:
    """Frame and pose of the best target: the robot's frame where it is known."""
    first = _first(document)
    robot = first.get("pose_robot")
    return ("robot", robot) if isinstance(robot, dict) else ("rig", first)


def _triple(values: object, form: str) -> str:
    if not isinstance(values, list) or len(values) != 3:
        return "-"
    return " ".join(_shown(value, form) for value in values)


def _largest(values: object) -> str:
    """The largest of three sigmas: the one that decides whether a robot may grip."""
    numbers = [_number(value) for value in values] if isinstance(values, list) else []
    known = [number for number in numbers if number is not None]
    return _shown(max(known), "{:.4f}") if numbers and len(known) == len(numbers) else ""


def _shown(value: object, form: str) -> str:
    number = _number(value)
    return "-" if number is None else form.format(number)


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _gap(old: Document, new: Document) -> int:
    """How many results were lost between two that came from one run of one daemon."""
    before, after = old.get("sequence"), new.get("sequence")
    if not isinstance(before, int) or not isinstance(after, int):
        return 0
    return max(0, after - before - 1) if old.get("started_ns") == new.get("started_ns") else 0
