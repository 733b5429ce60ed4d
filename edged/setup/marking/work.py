"""Functions that the worker process runs for reference marks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.errors import UserError
from edged.files.marks import MARKS_NAME, marks_of, marks_text
from edged.files.rig import rig_of
from edged.payload import Json, marks_to_json
from edged.setup.inuse import RigInUse
from edged.setup.marks import first_look, noise_px, sigma_um, taught_in
from edged.setup.pairs import Progress
from edged.vision.marks.tracking import MarksSettings


def look_at_marks(
    rig: RigInUse, content: bytes, stated: tuple[str, float], images: tuple[Image, Image], exposed_ns: int
) -> Json:
    """Check the marks in `content` with a pair. stated : material and range, K."""
    taught = marks_of(content, Path(MARKS_NAME), rig_of(rig.content, rig.path))
    if taught is None:
        raise UserError("the marks were taught with another calibration: teach them again")
    dots, _, report = first_look(taught, MarksSettings(*stated), images, exposed_ns)
    places = (taught.pixels[0], taught.pixels[1], dots.pixels[0], dots.pixels[1])
    names = ("was_left", "was_right", "left", "right")
    return {
        **marks_to_json(report),
        "marks": [
            {"code": code, **{name: _seen(place[index]) for name, place in zip(names, places, strict=True)}}
            for index, code in enumerate(taught.codes)
        ],
    }


def teach_marks(rig: RigInUse, folder: Path, material: str, progress: Progress) -> Json:
    """Teach the marks in the pairs of a folder: return the marks file, and figures for people."""
    taught = taught_in(folder, rig_of(rig.content, rig.path), progress)
    return {
        "content": marks_text(taught),
        "codes": list(taught.codes),
        "exposures": taught.exposures,
        "noise_px": noise_px(taught),
        "sigma_um": sigma_um(taught, MarksSettings(material)).tolist(),
    }


def _seen(pixel: FloatArray) -> list[float] | None:
    return [round(float(value), 2) for value in pixel] if np.isfinite(pixel).all() else None
