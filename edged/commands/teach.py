"""`edged teach`: a job from one stereo pair."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from edged.errors import TeachError
from edged.jobs import save_job
from edged.pipeline import prepare
from edged.store import load_image, load_rig
from edged.vision.teaching import Region
from edged.vision.teaching import teach as teach_job


def parse_region(text: str) -> Region:
    """Read "X,Y,W,H" (px of the raw left image)."""
    try:
        x, y, width, height = (float(part) for part in text.split(","))
    except ValueError:
        raise TeachError(
            f"--roi {text!r}: expected X,Y,W,H in pixels of the left image, for example 560,220,460,460"
        ) from None
    return Region(x, y, width, height)


def teach(
    rig: Path,
    left: Path,
    right: Path,
    roi: str,
    name: str,
    output: Path,
    console: Console,
    *,
    number: int = 1,
) -> int:
    """Teach a job and write its folder; nothing is written when that fails."""
    region = parse_region(roi)
    _check_name(name)
    prepared = prepare(load_rig(rig))
    job = teach_job(load_image(left), load_image(right), prepared.rectification, region, name, number)
    save_job(output, job)
    x, y, z = job.rig_from_part[:3, 3]
    console.print(f"job {job.number} {job.name!r} written to {output}")
    console.print(f"  reference {job.reference} at ({x:.3f}, {y:.3f}, {z:.3f}) mm in the rig frame")
    for circle in job.circles:
        cx, cy, _ = circle.centre_mm
        kind = "hole" if circle.polarity > 0 else "disc"
        console.print(
            f"  {circle.name}: {kind} of radius {circle.radius_mm:.3f} mm "
            f"at ({cx:.3f}, {cy:.3f}) mm in the part frame"
        )
    console.print(
        f"  shape model: {len(job.shape.levels[0].points)} points on {len(job.shape.levels)} levels"
    )
    return 0


def _check_name(name: str) -> None:
    allowed = name and name[0].isalnum() and all(c.isalnum() or c in "_.-" for c in name) and name.isascii()
    if not allowed or len(name) > 64:
        raise TeachError(
            f"--name {name!r}: expected up to 64 letters, digits, '_', '.' or '-', "
            "beginning with a letter or digit"
        )
