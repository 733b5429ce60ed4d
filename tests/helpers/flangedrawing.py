"""The demo's flange as a DXF drawing."""

from __future__ import annotations

import math
from pathlib import Path

import ezdxf

from edged.sim.cell import demo_part


def flange_drawing(folder: Path, *, units: int = 4, scale: float = 1.0, is_open: bool = False) -> Path:
    """Draw its face, y up, so that what is below in the image is drawn below.

    units : $INSUNITS. is_open : adds a loose line from (30, 5) to (40, 5).
    """
    document = ezdxf.new(units=units)
    space = document.modelspace()
    space.add_circle((100, 50), 14 * scale)
    half = math.degrees(math.asin(1.1 / 4.0))
    space.add_arc((100, 50), 4 * scale, half, 360 - half)
    at = 4 * math.cos(math.radians(half))
    for start, end in (((at, 1.1), (6.2, 1.1)), ((6.2, 1.1), (6.2, -1.1)), ((6.2, -1.1), (at, -1.1))):
        ends = [(100 + scale * x, 50 + scale * y) for x, y in (start, end)]
        space.add_line(*ends)
    for name, disc in demo_part().circles:
        if name.startswith("bolt"):
            space.add_circle((100 + scale * disc.x_mm, 50 - scale * disc.y_mm), scale * disc.radius_mm)
    if is_open:
        space.add_line((30, 5), (40, 5))
    path = folder / "flange.dxf"
    document.saveas(path)
    return path
