"""What the map of a robot's error is worth, and whether parts lie in it."""

from __future__ import annotations

from collections.abc import Iterator

from edged.doctor.findings import Check, ok, warn
from edged.robot.errormap import error_map
from edged.robot.picking import frame_of
from edged.setup.cellfiles import CellFiles

NAME = "robot's error"
NOT_YET, RELOAD = "places are off as before it was made", "sudo systemctl reload edged"


def look_at_map(cell: CellFiles, *, is_used: bool) -> Iterator[Check]:
    """A finding where the rig has a map. is_used : no daemon runs by other files than these."""
    made = cell.rig.robot_map
    if made is None:
        return
    found, frame = error_map(made).figures, frame_of(cell.rig)
    text = (
        f"a map of degree {found.degree} by {found.points} points; one that was left out is off by "
        f"{1e3 * found.held_out_mm:.0f} um, {1e3 * found.alone_mm:.0f} by the registration alone"
    )
    beyond = [job.name for job in cell.jobs if not frame.is_mapped(job.rig_from_part[:3, 3])]
    touch = "edged register touch --map with points there, too"
    if beyond:
        names = ", ".join(beyond)
        yield warn(NAME, f"{text}; {names}: taught beyond it", "OUT_OF_MAP there", touch)
    elif not is_used:
        yield warn(NAME, f"{text}; the daemon runs without it", NOT_YET, RELOAD, "reload")
    else:
        yield ok(NAME, text)
