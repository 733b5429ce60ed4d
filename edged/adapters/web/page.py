"""What the page shows, as values: no sockets here.

`Page` takes note of events and answers with JSON. Pictures are encoded when somebody asks for one, in the
asker's thread, from the pair that is kept of the newest exposure and of the last faults.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np

from edged.domain import CellState, Event, ExposureDone, FloatArray, FramePair, Snapshot, Status, Target
from edged.payload import Json, snapshot_to_json, state_to_json
from edged.vision.rectification import Rectification

HISTORY = 600
"""Cycles in the trends."""
FAULTS = 12
"""Last bad cycles, with their pictures: about 2.5 MB each."""
WIDTH_PX = 960
"""Of the pictures that are sent."""
QUALITY = 82
OUTLINE_POINTS = 72

Side = Literal["left", "right"]


@dataclass(frozen=True, slots=True)
class Sources:
    """Where the page gets what events do not tell; called on the event loop, at once.

    rectification : of the rig in use.  jobs : (number, name).  facts : groups of name to value, as they are
    shown.  registers : rows of address, name, value, unit, meaning; empty without a Modbus server.
    metrics : Prometheus' text.
    """

    rectification: Callable[[], Rectification]
    jobs: Callable[[], Sequence[tuple[int, str]]]
    facts: Callable[[], Mapping[str, Mapping[str, Any]]]
    registers: Callable[[], Sequence[tuple[int, str, float, str, str]]]
    metrics: Callable[[], bytes]


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A cycle with its pictures."""

    snapshot: Snapshot
    pair: FramePair | None


class Page:
    """The state of the page."""

    def __init__(self, cell: str, sources: Sources) -> None:
        self._cell = cell
        self._sources = sources
        self._state: CellState | None = None
        self._exposed: tuple[int, FramePair] | None = None
        self._last: Shown | None = None
        self._faults: deque[Shown] = deque(maxlen=FAULTS)
        self._history: deque[Json] = deque(maxlen=HISTORY)
        self._same_fault = ""

    # --- events ------------------------------------------------------------------------------

    def take(self, event: Event) -> bool:
        """Note an event; True when the page looks different now."""
        if isinstance(event, ExposureDone) and event.pair is not None:
            self._exposed = (event.cycle, event.pair)
            return False
        if isinstance(event, CellState):
            self._state = event
            return event.state != "BUSY"
        if not isinstance(event, Snapshot):
            return False
        pair = self._exposed[1] if self._exposed is not None and self._exposed[0] == event.cycle else None
        self._exposed = None
        self._last = Shown(event, pair)
        self._history.append(_trend(event))
        repeated = bool(event.error) and event.error == self._same_fault
        self._same_fault = event.error
        if event.status is not Status.OK and not repeated:
            self._faults.append(self._last)
        return True

    # --- answers -----------------------------------------------------------------------------

    @property
    def state(self) -> CellState | None:
        """The newest state of the cell."""
        return self._state

    def status(self) -> Json:
        """Everything but history, for /status.json and each update of the page."""
        last = self._last
        return {
            "cell": self._cell,
            "state": None if self._state is None else state_to_json(self._state),
            "result": None if last is None else snapshot_to_json(last.snapshot),
            "picture": None if last is None or last.pair is None else self._picture(last.snapshot),
            "facts": {group: dict(values) for group, values in self._sources.facts().items()},
            "jobs": [{"number": number, "name": name} for number, name in self._sources.jobs()],
            "faults": [_fault(shown) for shown in reversed(self._faults)],
        }

    def history(self, after: int = 0) -> list[Json]:
        """The trends from the cycle that follows `after`, oldest first."""
        return [point for point in self._history if point["cycle"] > after]

    def registers(self) -> list[Json]:
        """The Modbus map with the values that a client would read now."""
        return [
            {
                "address": address,
                "name": name,
                "value": value if math.isfinite(value) else None,
                "unit": unit,
                "help": help_,
            }
            for address, name, value, unit, help_ in self._sources.registers()
        ]

    def metrics(self) -> bytes:
        """Prometheus' text."""
        return self._sources.metrics()

    def pair(self, cycle: int) -> FramePair | None:
        """The images of the newest cycle or of one of the last faults."""
        for shown in (self._last, *self._faults):
            if shown is not None and shown.snapshot.cycle == cycle:
                return shown.pair
        return None

    def rectification(self) -> Rectification:
        """Of the rig in use."""
        return self._sources.rectification()

    def _picture(self, snapshot: Snapshot) -> Json:
        """Which picture, its size, and what to draw on it (0 to 1 over width and height)."""
        rectification = self._sources.rectification()
        width, height = rectification.size
        return {
            "cycle": snapshot.cycle,
            "width": width,
            "height": height,
            "marks": [
                {
                    "good": not target.reject,
                    **{side: outlines(target, rectification, side) for side in ("left", "right")},
                }
                for target in snapshot.targets
            ],
        }


def outlines(target: Target, rectification: Rectification, side: Side) -> Json:
    """The measured circles (lists of x, y) and the axes of a target in one rectified image, 0 to 1."""
    phase = np.linspace(0.0, 2 * np.pi, OUTLINE_POINTS)
    circles = []
    for circle in target.circles:
        across = np.cross(circle.normal, [0.0, 1.0, 0.0])
        across /= np.linalg.norm(across)
        along = np.cross(circle.normal, across)
        rim = circle.centre_mm + circle.radius_mm * (
            np.cos(phase)[:, None] * across + np.sin(phase)[:, None] * along
        )
        circles.append(_seen(rim, rectification, side))
    size = max((circle.radius_mm for circle in target.circles), default=5.0)
    pose = target.rig_from_part
    ends = np.stack([pose[:3, 3], pose[:3, 3] + size * pose[:3, 0], pose[:3, 3] + size * pose[:3, 1]])
    return {"circles": circles, "axes": _seen(ends, rectification, side)}


def _seen(points_mm: FloatArray, rectification: Rectification, side: Side) -> list[list[float]]:
    """Points (N, 3) of the rig in a rectified image."""
    rectified = points_mm @ rectification.rectified_from_left.T
    centre = rectification.centre_left_px
    if side == "right":
        rectified = rectified - [rectification.baseline_mm, 0.0, 0.0]
        centre = rectification.centre_right_px
    pixels = rectification.focal_px * rectified[:, :2] / rectified[:, 2:] + centre
    return [[round(float(x), 5), round(float(y), 5)] for x, y in (pixels + 0.5) / rectification.size]


def picture(pair: FramePair, rectification: Rectification, side: Side) -> bytes:
    """A JPEG of one rectified image; the raw one where the rig does not fit (it was just exchanged)."""
    frame = pair.left if side == "left" else pair.right
    camera = rectification.rig.left if side == "left" else rectification.rig.right
    image = frame.image
    if image.shape == (camera.height, camera.width):
        rectify = rectification.left_image if side == "left" else rectification.right_image
        image = rectify(image)
    scale = WIDTH_PX / image.shape[1]
    if scale < 1:
        image = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    encoded, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    if not encoded:
        raise ValueError(f"an image of the shape {image.shape} cannot be a JPEG")
    return data.tobytes()


def _trend(snapshot: Snapshot) -> Json:
    """One point of the trends; a result that is not good has no position."""
    point: Json = {
        "cycle": snapshot.cycle,
        "time_ns": snapshot.published_ns,
        "status": str(snapshot.status),
        "total_ms": snapshot.timing_ms.get("total"),
    }
    if snapshot.status is Status.OK:
        best = snapshot.targets[0]
        point |= {
            "position_mm": [float(value) for value in best.position_mm],
            "score": best.match.score,
            "epipolar_px": best.epipolar_rms_px,
        }
    return point


def _fault(shown: Shown) -> Json:
    snapshot = shown.snapshot
    reasons = sorted({name for t in snapshot_to_json(snapshot)["rejected"] for name in t["reject"]})
    return {
        "cycle": snapshot.cycle,
        "time_ns": snapshot.published_ns,
        "status": str(snapshot.status),
        "text": snapshot.error or ", ".join(reasons).lower().replace("_", " ") or "nothing found",
        "has_picture": shown.pair is not None,
    }
