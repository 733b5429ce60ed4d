"""Display of cells for `edged watch`: a table of all cells on one screen, or one line per result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rich import box
from rich.console import ConsoleDimensions, Group, RenderableType
from rich.table import Table
from rich.text import Text

from edged.app.fleet import Document, News
from edged.domain.numerals import number_in
from edged.errors import printable

TABLE_LINES = 6
"""Lines besides rows and troubles: the table's head, the count of omitted cells, the cursor."""
MAX_TEXT = 200
STYLES = {
    "OK": "green",
    "READY": "green",
    "BUSY": "green",
    "SETUP": "yellow",
    "CAPTURE_FAULT": "bold red",
    "FAULT": "bold red",
}
GONE = "GONE"
WIDE = 100
"""Terminal width needed to show all columns of a cell on one line."""
MAX_NAME = 24
STATES = ("FAULT", GONE, "SETUP", "STARTING", "STOPPING", "?", "BUSY", "READY")
"""States in the order of the summary: those that need attention first."""


@dataclass(slots=True)
class CellView:
    """The latest messages of a cell. misses : consecutive results with the same status other than OK."""

    state: str = "?"
    error: str = ""
    setup: str = ""
    rate_hz: float | None = None
    target: Document = field(default_factory=dict)
    age_at_arrival_s: float = 0.0
    arrived_s: float = 0.0
    lost: int = 0
    misses: int = 0

    def take(self, news: News, now_s: float, utc_ns: int) -> None:
        """Update the view from a message; now_s : monotonic, utc_ns : of this machine."""
        document = news.document
        if news.kind == "alive":
            self.state = GONE if not document["alive"] else ("?" if self.state == GONE else self.state)
        elif news.kind == "state":
            self.state, self.error = _text(document, "state"), _text(document, "error")
            self.setup = _setup(document.get("setup"))
        elif news.kind == "health":
            self.rate_hz = number_in(document.get("rate_hz"))
        elif news.kind == "target":
            self.lost += _gap(self.target, document)
            alike = _text(self.target, "status") == _text(document, "status") != "OK"
            self.misses = self.misses + 1 if alike else 1
            # only the first result may be old; later ones use this machine's clock alone, as clocks differ
            exposed_ns = utc_ns if self.target else number_in(document.get("exposed_ns")) or utc_ns
            self.age_at_arrival_s = max(0.0, (utc_ns - exposed_ns) / 1e9)
            self.target, self.arrived_s = document, now_s

    def age_s(self, now_s: float) -> float | None:
        """Return the age of the last result; None without one."""
        return self.age_at_arrival_s + now_s - self.arrived_s if self.target else None


def fleet_view(
    cells: dict[str, CellView], known: int, problem: str, now_s: float, size: ConsoleDimensions
) -> RenderableType:
    """Fit all cells on one screen: a summary if there are many, those that need attention, then the others.

    Cells of equal urgency are sorted by name. cells : those to show. known : number of all cells.
    """
    rows = sorted(cells.items(), key=lambda item: (_urgency(item[1]), item[0]))
    troubles = [f"{name}: {printable(text)}" for name, cell in rows for text in _troubles(cell)]
    crowded = len(rows) + len(troubles) + TABLE_LINES > size.height
    parts: list[RenderableType] = [Text(problem, style="bold red")] if problem else []
    if not cells:
        parts.append(Text("no cell in this state" if known else "no cell yet", style="dim"))
    left_out = 0
    if crowded:
        parts.append(_summary(cells))
        free_lines = max(2, size.height - TABLE_LINES - len(parts) - problem.count("\n"))
        shown = min(len(troubles), max(1, free_lines // 3))
        left_out = max(0, len(rows) - (free_lines - shown))
        rows = rows[: free_lines - shown]
        troubles = [
            text if len(text) <= size.width else f"{text[: size.width - 1]}…" for text in troubles[:shown]
        ]
    if rows:
        narrow = crowded and size.width < WIDE
        parts.append(_table(rows, now_s, one_line=crowded, narrow=narrow))
    if left_out:
        parts.append(Text(f"and {left_out} more: --cell 'NAME*' and --state show some of them", style="dim"))
    parts += [Text(text, style="bold red") for text in troubles]
    return Group(*parts)


def _summary(cells: Mapping[str, CellView]) -> Text:
    counted = Counter(cell.state for cell in cells.values())
    results = Counter(_text(cell.target, "status") for cell in cells.values() if cell.target)
    order = sorted(counted, key=lambda state: (STATES.index(state) if state in STATES else 0, state))
    text = Text(f"{len(cells)} cells:", style="bold")
    for state in order:
        text.append(f"  {counted[state]} ").append_text(_styled(state))
    text.append("  last results:")
    for status, count in results.most_common():
        text.append(f"  {count} ").append_text(_styled(status))
    return text


def _urgency(cell: CellView) -> int:
    """Return 0 for a cell that needs attention now, up to 3 for one that is well."""
    if cell.error or cell.state in (GONE, "FAULT"):
        return 0
    if cell.setup or _drift(cell.target):
        return 1
    return 2 if _text(cell.target, "status") not in ("", "OK") else 3


def _troubles(cell: CellView) -> list[str]:
    drift = _drift(cell.target)
    error = cell.error or _text(cell.target, "error")
    return [text for text in (error, cell.setup, _drift_text(drift) if drift else "") if text]


def _setup(document: object) -> str:
    """Return why a cell is in SETUP."""
    if not isinstance(document, dict):
        return ""
    source = _text(document, "source").lower().replace("_", " ")
    if source == "person":
        return f"setup by {_text(document, 'by') or 'nobody: it was never ended'}"
    return f"setup: {source} yet"


def _table(rows: Sequence[tuple[str, CellView]], now_s: float, *, one_line: bool, narrow: bool) -> Table:
    """Return a table that fits 80 columns.

    one_line : each cell takes one line, and long text is cut. narrow : only the essential columns.
    """
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    longest = max(len(name) for name, _ in rows)
    table.add_column(
        "cell",
        overflow="ellipsis" if one_line else "fold",
        no_wrap=one_line,
        min_width=min(longest, MAX_NAME) if one_line else None,
    )
    for heading in ("state", *([] if narrow else ["job"]), "result"):
        table.add_column(heading, overflow="ellipsis" if one_line else "fold", no_wrap=one_line)
    table.add_column("X Y Z mm", justify="right", no_wrap=True)
    lost = any(cell.lost for _, cell in rows)
    drifting = not narrow and any(_drift(cell.target) for _, cell in rows)
    more = [
        name
        for name, there in (("Hz", not narrow), ("age s", True), ("drift", drifting), ("lost", lost))
        if there
    ]
    for heading in ("σ mm", *more):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, cell in rows:
        pose = _pose(cell.target)[1]
        status = _text(cell.target, "status")
        table.add_row(
            name,
            _styled(cell.state),
            *([] if narrow else [Text(_text(cell.target, "job"))]),
            _styled(status).append(" sim" if cell.target.get("simulated") else "", style="yellow"),
            _place(cell),
            _largest(pose.get("sigma_mm")),
            *([] if narrow else [_shown(cell.rate_hz, "{:.1f}")]),
            _shown(cell.age_s(now_s), "{:.1f}"),
            *([_styled(_text(_drift(cell.target), "verdict"))] if drifting else []),
            *([str(cell.lost)] if lost else []),
        )
    return table


def _place(cell: CellView) -> str:
    """Return the part's position, or the number of consecutive equal misses."""
    frame, pose = _pose(cell.target)
    if pose:
        return f"{_triple(pose.get('position_mm'), '{:.3f}')} {frame}"
    return f"{cell.misses} in a row" if cell.misses > 1 else ""


def _styled(word: str) -> Text:
    return Text(word, style=STYLES.get(word, "yellow"))


def line_of(news: News) -> str:
    """Return a result as one line."""
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


def _text(document: Document, name: str) -> str:
    """Return a field as short text without control characters, which could control the terminal."""
    value = document.get(name)
    return printable("" if value is None else str(value)[:MAX_TEXT])


def _drift(document: Document) -> Document:
    """Return the result's note on a calibration that does not hold; {} if it holds."""
    drift = document.get("drift")
    known = isinstance(drift, dict) and drift.get("verdict") not in (None, "HOLDS")
    return drift if known and isinstance(drift, dict) else {}


def _drift_text(drift: Document) -> str:
    rows, length = _shown(drift.get("rows_px"), "{:.2f}"), _shown(drift.get("length_percent"), "{:+.2f}")
    verdict = _text(drift, "verdict").lower()
    return f"calibration {verdict}: rows {rows} px, known length {length} %"


def _first(document: Document) -> Document:
    """Return the best target of a result; {} if it has none."""
    targets = document.get("targets")
    first = targets[0] if isinstance(targets, list) and targets else {}
    return first if isinstance(first, dict) else {}


def _pose(document: Document) -> tuple[str, Document]:
    """Return frame and pose of the best target, in the robot's frame if known."""
    first = _first(document)
    robot = first.get("pose_robot")
    return ("robot", robot) if isinstance(robot, dict) else ("rig", first)


def _triple(values: object, form: str) -> str:
    if not isinstance(values, list) or len(values) != 3:
        return "-"
    return " ".join(_shown(value, form) for value in values)


def _largest(values: object) -> str:
    """Return the largest of three sigmas, which decides whether a robot may grip."""
    numbers = [number_in(value) for value in values] if isinstance(values, list) else []
    known = [number for number in numbers if number is not None]
    return _shown(max(known), "{:.4f}") if numbers and len(known) == len(numbers) else ""


def _shown(value: object, form: str) -> str:
    number = number_in(value)
    return "-" if number is None else form.format(number)


def _gap(old: Document, new: Document) -> int:
    """Return the number of results lost between two from the same run of the daemon."""
    before, after = old.get("sequence"), new.get("sequence")
    if not isinstance(before, int) or not isinstance(after, int):
        return 0
    return max(0, after - before - 1) if old.get("started_ns") == new.get("started_ns") else 0
