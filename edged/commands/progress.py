"""Progress display in the terminal: a bar for many steps, a spinner for a single one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from edged.setup.pairs import Progress as Told
from edged.setup.pairs import silent


@contextmanager
def shown_on(console: Console) -> Iterator[Told]:
    """Show progress while open; nothing if the console is not a terminal."""
    if not console.is_terminal:
        yield silent  # otherwise rich would write an empty line for each stage
        return
    with ExitStack() as shown:
        yield _Shown(console, shown)


class _Shown:
    """The bar or the spinner of one stage at a time."""

    def __init__(self, console: Console, shown: ExitStack) -> None:
        self._console = console
        self._shown = shown
        self._bar: Progress | None = None

    def __call__(self, stage: str, done: int, total: int) -> None:
        if done == 0:
            self._begin(stage, total)
        elif self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=done)

    def _begin(self, stage: str, total: int) -> None:
        self._shown.close()
        self._bar = None
        if total == 0:
            self._shown.enter_context(self._console.status(stage))
            return
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        self._bar = self._shown.enter_context(Progress(*columns, console=self._console, transient=True))
        self._bar.add_task(stage, total=total)
