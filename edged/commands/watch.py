"""`edged watch`: shows live results of every cell reachable over Zenoh."""

from __future__ import annotations

import json
import math
import queue
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TextIO

from rich.console import Console, RenderableType
from rich.live import Live

from edged.app.fleet import ClientTls, Fleet, News, is_cell_name, is_name_pattern, news_of_cells
from edged.commands.fleetview import STATES, CellView, fleet_view, line_of
from edged.config.zenoh import check_endpoint
from edged.errors import UserError, printable
from edged.files.private import read_shared_key

REFRESH_S = 0.25
SILENCE_HINT_S = 3.0
LOOK_S = 1.0
MOST_DOUBTS = 3
"""Limit of doubts on the screen; if there are many, the first few suffice."""


@dataclass(frozen=True, slots=True)
class WatchOptions:
    """Options of the command line.

    cell : a name, or a pattern with * and ?; None: all. states : the table shows only cells in one of them;
    () : all. count : end after this number of results. timeout_s : end after this time. shared_key : file;
    only messages signed with it are shown.
    """

    connect: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    cell: str | None = None
    states: tuple[str, ...] = ()
    count: int | None = None
    timeout_s: float | None = None
    as_json: bool = False
    tls: ClientTls | None = None
    shared_key: Path | None = None


def watch(options: WatchOptions, console: Console) -> int:
    """Show results until ctrl-C or until `count` results have come; 1 if `timeout_s` passed before that.

    Prints a table of cells on a terminal, otherwise one line per result; with `as_json` the messages
    themselves, one JSON object per line. Raises `UserError` for invalid endpoints, names, states or
    certificates.
    """
    _check(options)
    name = options.cell if options.cell is not None and is_cell_name(options.cell) else None
    key = None if options.shared_key is None else read_shared_key(options.shared_key)
    with news_of_cells(options.connect, name, options.tls, key) as fleet:
        table = console.is_terminal and not options.as_json
        link = Link(", ".join(options.connect), None if table else sys.stderr)
        doubts = Doubts(fleet.doubts, None if table else sys.stderr)
        stream = _stream(fleet, link, doubts, options.cell or "*")
        results = Results(stream, options.count, options.timeout_s)
        try:
            if options.as_json:
                _print_json(results)
            elif table:
                _show_table(results, link, doubts, options.states, console)
            else:
                _print_lines(results, console)
        except KeyboardInterrupt:  # the usual way to leave
            return 0
        finally:
            doubts.look(at_once=True)
    return 1 if results.missing else 0


def _check(options: WatchOptions) -> None:
    if options.cell is not None and not is_name_pattern(options.cell):
        raise UserError(
            f"--cell {options.cell!r}: expected a cell's name (letters, digits, '_', '.', '-'), in which "
            "* and ? stand for others"
        )
    for endpoint in options.connect:
        try:
            check_endpoint(endpoint)
        except ValueError as error:
            raise UserError(f"--connect {endpoint!r}: {error}") from None
    for state in options.states:
        if state not in STATES:
            raise UserError(f"--state {state!r}: expected one of {', '.join(STATES)}")
    tls = options.tls
    if tls is not None:
        if (tls.certificate is None) != (tls.key is None):
            raise UserError("--certificate and --key belong together: expected both or none")
        plain = [place for place in options.connect if not place.startswith(("tls/", "quic/"))]
        if plain:
            raise UserError(
                f"--connect {plain[0]}: expected tls/HOST:PORT with a certificate or an authority"
            )


class Link:
    """Monitors the connection to other sessions. stream : where changes are printed; None: nowhere."""

    def __init__(self, places: str, stream: TextIO | None) -> None:
        self._places = places
        self._stream = stream
        self._started_s = self._looked_s = time.monotonic()
        self._was_there = False
        self.problem = ""

    def look(self, links: Callable[[], int]) -> None:
        """Count the connections, at most once a second, and update the problem."""
        now_s = time.monotonic()
        if now_s - self._looked_s < LOOK_S:
            return
        self._looked_s = now_s
        problem = ""
        if links():
            self._was_there = True
        elif self._was_there:
            problem = f"the connection to {self._places} is gone: nothing new is seen until it is back"
        elif now_s - self._started_s > SILENCE_HINT_S:
            problem = f"nothing from {self._places} yet: does a cell or router run and listen there?"
        if self._stream is not None and problem != self.problem:
            self._stream.write(f"edged: {problem or f'connected to {self._places}'}\n")
        self.problem = problem


class Doubts:
    """Cells whose messages may not all be their own. stream : where changes are printed; None: nowhere."""

    def __init__(self, doubts: Callable[[], list[str]], stream: TextIO | None) -> None:
        self._doubts = doubts
        self._stream = stream
        self._looked_s = 0.0
        self.sentences: list[str] = []

    def look(self, *, at_once: bool = False) -> None:
        """Print new doubts, at most once a second."""
        now_s = time.monotonic()
        if now_s - self._looked_s < LOOK_S and not at_once:
            return
        self._looked_s = now_s
        before, self.sentences = self.sentences, [printable(text) for text in self._doubts()]
        if self._stream is not None:
            for text in self.sentences:
                if text not in before:
                    self._stream.write(f"edged: {text}\n")


class Results:
    """The stream, ended after `count` results or `timeout_s`. missing : results still to come of `count`."""

    def __init__(self, stream: Iterator[News | None], count: int | None, timeout_s: float | None) -> None:
        self._stream = stream
        self._end_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
        self.missing = count

    def __iter__(self) -> Iterator[News | None]:
        for news in self._stream:
            if time.monotonic() > self._end_s:
                return
            yield news
            if news is not None and news.kind == "target" and self.missing is not None:
                self.missing -= 1
                if self.missing == 0:
                    return


def _stream(fleet: Fleet, link: Link, doubts: Doubts, pattern: str) -> Iterator[News | None]:
    """Yield news of the selected cells as it arrives; None for other cells, or `REFRESH_S` without news."""
    while True:
        link.look(fleet.links)
        doubts.look()
        try:
            news = fleet.inbox.get(timeout=REFRESH_S)
        except queue.Empty:
            yield None
        else:
            yield news if fnmatchcase(news.cell, pattern) else None


def _print_json(results: Results) -> None:
    for news in results:
        if news is not None and news.kind == "target":
            sys.stdout.write(json.dumps(news.document) + "\n")
            sys.stdout.flush()


def _print_lines(results: Results, console: Console) -> None:
    for news in results:
        if news is not None and news.kind == "target":
            console.print(line_of(news), markup=False, highlight=False, soft_wrap=True)


def _show_table(
    results: Results, link: Link, doubts: Doubts, states: Sequence[str], console: Console
) -> None:
    cells: dict[str, CellView] = {}
    drawn_s = 0.0

    def shown(now_s: float) -> RenderableType:
        wanted = {name: cell for name, cell in cells.items() if not states or cell.state in states}
        problems = [*([link.problem] if link.problem else []), *doubts.sentences[:MOST_DOUBTS]]
        return fleet_view(wanted, len(cells), "\n".join(problems), now_s, console.size)

    with Live(shown(0.0), console=console, auto_refresh=False) as live:
        for news in results:
            now_s = time.monotonic()
            if news is not None:
                cells.setdefault(news.cell, CellView()).take(news, now_s, time.time_ns())
            if now_s - drawn_s >= REFRESH_S:
                live.update(shown(now_s), refresh=True)
                drawn_s = now_s
        live.update(shown(time.monotonic()), refresh=True)
