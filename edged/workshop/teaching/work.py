"""What the worker process can do for drafts of jobs: by name, with a `Progress` before the arguments."""

from __future__ import annotations

from pathlib import Path

from edged.commissioning.outlines import Line, line
from edged.commissioning.pairs import Progress
from edged.commissioning.teaching import proposing
from edged.commissioning.teaching.proposing import Order
from edged.files.images import load_image
from edged.vision.teaching.foreground import parts_at


def propose_region(_progress: Progress, pictures: Path) -> Line | None:
    """Around what is most likely the part of a draft's pair."""
    return proposing.propose_region(pictures)


def regions_at(_progress: Progress, pictures: Path, x: float, y: float) -> tuple[Line, ...]:
    """Around each thing that a point of the left picture is inside of, the largest first."""
    return tuple(line(one) for one in parts_at(load_image(pictures / "left.png"), x, y))


def see_part(progress: Progress, order: Order) -> proposing.Seen:
    """What a draft's pair and region teach."""
    return proposing.see(order, progress)
