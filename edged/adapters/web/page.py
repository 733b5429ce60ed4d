"""Content of the status page: its state as JSON, and its pictures.

Pictures are encoded on request, in the caller's thread, from the pairs of the newest cycles and of the last
faults.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Protocol

import cv2
import numpy as np
from cv2.typing import MatLike

from edged.adapters.web.marks import budget, outlines
from edged.domain.arrays import SIDES, Side
from edged.domain.cell import CellPhase, CellState
from edged.domain.events import CommandKind, Event, ExposureDone, Snapshot
from edged.domain.frames import FramePair
from edged.domain.measurement import Match, Nearest, NearMiss, NotMeasured, Status, Target
from edged.domain.numerals import known
from edged.domain.overview import Overview
from edged.logs import RELAPSE_S
from edged.payload import Json, reject_names, snapshot_to_json, state_to_json, translatable
from edged.pictures.captions import REASONS, why_nothing
from edged.pictures.encoding import jpeg
from edged.plc.registers import Number, Register
from edged.plc.registers.readings import meaning_of, text_of
from edged.robot.orientations import Convention
from edged.robot.reading import reading_of
from edged.vision.geometry.rectification import Rectification

HISTORY = 600
"""Cycles kept for the trends."""
FAULTS = 12
"""Bad cycles kept with their pictures, about 2.5 MB each."""
FAULT_BYTES = 64 * 1024 * 1024
"""Limit on the bytes of those pictures; with cameras of many megapixels the oldest faults lose theirs."""
RECENT, SPARE = 8, 2
"""Last cycles of any kind listed with their pictures, and how many more are kept for late requests."""
RECENT_BYTES = 32 * 1024 * 1024
"""Limit on the bytes of those pictures; the newest cycle always keeps its own."""
WIDTH_PX = 960
"""Default width of the pictures sent."""
THUMBNAIL_PX = 200
QUALITY = 82


class PageSources(Protocol):
    """Data that events do not carry; called on the event loop, where all but `registers` return at once."""

    def rectification(self) -> Rectification:
        """Rectification of the rig in use."""

    def jobs(self) -> Sequence[tuple[int, str]]:
        """Number and name of each job."""

    def facts(self) -> Mapping[str, Mapping[str, Any]]:
        """Names and values by group; a value is shown as is, from `payload.translatable`, or a list."""

    async def registers(self) -> Sequence[tuple[Register, Number]]:
        """Each register with its value; empty without a Modbus server. Raises `LinkError`."""

    def convention(self) -> Convention:
        """Convention by which A, B, C give an orientation to the PLC."""

    def overview(self) -> Overview:
        """Overview of the cell for the people who set it up."""

    def fingerprint(self) -> str:
        """Digest of the configuration and files that results depend on."""

    def limits(self) -> Mapping[int, float]:
        """Largest sigma allowed for a coordinate, mm, by job number."""


@dataclass(frozen=True, slots=True, eq=False)
class ShownCycle:
    """A cycle with its pictures. times : how often the same fault occurred; last_ns : when it last did."""

    snapshot: Snapshot
    pair: FramePair | None
    times: int = 1
    last_ns: int = 0


class StatusPage:
    """The state of the page."""

    def __init__(self, cell: str, sources: PageSources) -> None:
        self._cell = cell
        self._sources = sources
        self._state: CellState | None = None
        self._exposed: tuple[int, FramePair] | None = None
        self._last: ShownCycle | None = None
        self._faults: deque[ShownCycle] = deque(maxlen=FAULTS)
        self._recent: deque[ShownCycle] = deque(maxlen=RECENT + SPARE)
        self._history: deque[Json] = deque(maxlen=HISTORY)
        self._pictured_ns = 0
        self._drawn: tuple[ShownCycle, Json] | None = None

    # --- events ------------------------------------------------------------------------------

    def take(self, event: Event) -> bool:
        """Take an event into account; True when the page has changed."""
        if isinstance(event, ExposureDone) and event.pair is not None:
            self._exposed = (event.cycle, event.pair)
            return False
        if isinstance(event, CellState):
            self._state = event
            return event.state is not CellPhase.BUSY
        if not isinstance(event, Snapshot):
            return False
        pair = self._exposed[1] if self._exposed is not None and self._exposed[0] == event.cycle else None
        self._exposed = None
        if pair is not None:
            self._pictured_ns = event.exposed_ns or event.published_ns
        self._last = ShownCycle(event, pair, last_ns=event.published_ns)
        self._history.append(_trend(event))
        if pair is not None:
            self._recent.append(self._last)
            while len(self._recent) > 1 and sum(_size(shown) for shown in self._recent) > RECENT_BYTES:
                self._recent.popleft()
        if event.status is not Status.OK and not self._is_counted(event):
            self._faults.append(self._last)
            self._forget_pictures()
        return True

    def _is_counted(self, event: Snapshot) -> bool:
        """Count a fault that recurs within `RELAPSE_S` in its entry in the list; False if there is none.

        The entry keeps the pictures of the first occurrence.
        """
        key = _fault_key(event)
        for index in range(len(self._faults) - 1, -1, -1):
            shown = self._faults[index]
            if _fault_key(shown.snapshot) == key:
                if event.published_ns - shown.last_ns > RELAPSE_S * 1e9:
                    return False
                self._faults[index] = replace(shown, times=shown.times + 1, last_ns=event.published_ns)
                return True
        return False

    def _forget_pictures(self) -> None:
        """Drop the pictures of the oldest faults where together they exceed `FAULT_BYTES`."""
        size = 0
        for index in range(len(self._faults) - 1, -1, -1):
            shown = self._faults[index]
            if shown.pair is not None:
                size += _size(shown)
                if size > FAULT_BYTES and index < len(self._faults) - 1:
                    self._faults[index] = replace(shown, pair=None)
                    if shown.snapshot.nearest is not None:
                        shown.snapshot.nearest.forget()

    # --- answers -----------------------------------------------------------------------------

    @property
    def has_error(self) -> bool:
        """Whether the cell reports an error."""
        return self._state is not None and self._state.error != ""

    @property
    def state(self) -> CellState | None:
        """The newest state of the cell."""
        return self._state

    def jobs(self) -> Sequence[tuple[int, str]]:
        """Number and name of each job."""
        return self._sources.jobs()

    def questions(self) -> list[Nearest]:
        """Open queries to run outside the event loop, so that `status` can say why nothing was found."""
        shown = (*self._faults, *([] if self._last is None else [self._last]))
        return [nearest for it in shown if (nearest := it.snapshot.nearest) is not None and nearest.open]

    def status(self) -> Json:
        """Everything except the history, for /status.json and each update of the page."""
        last = self._last
        return {
            "cell": self._cell,
            "state": None if self._state is None else state_to_json(self._state),
            "result": None if last is None else snapshot_to_json(last.snapshot),
            "why": [] if last is None else _why(last.snapshot),
            "angles": None if last is None else self._angles(last.snapshot),
            "budget": None if last is None else self._budget(last.snapshot),
            "picture": None if last is None or last.pair is None else self._picture(last),
            "pictured_ns": self._pictured_ns,
            "facts": {group: dict(values) for group, values in self._sources.facts().items()},
            "jobs": [{"number": number, "name": name} for number, name in self.jobs()],
            "faults": [_fault(shown) for shown in reversed(self._faults)],
            "recent": [_recent(shown) for shown in reversed(self._recent)][:RECENT],
        }

    def cycle(self, number: int) -> Json | None:
        """Details of a cycle, with what to draw on its pictures; None if its pictures are no longer kept."""
        shown = self._kept(number)
        if shown is None:
            return None
        return {**_fault(shown), "job": shown.snapshot.job, "picture": self._draw(shown)}

    def _angles(self, snapshot: Snapshot) -> Json:
        """A, B, C and their sigmas in degrees as the PLC reads them; good targets first."""
        convention = self._sources.convention()
        ordered = sorted(snapshot.targets, key=lambda target: bool(target.reject))
        return {
            "convention": convention.name.lower(),
            "of": [_angles(target, snapshot, convention) for target in ordered],
        }

    def _budget(self, snapshot: Snapshot) -> Json | None:
        """Error budget of the first target, a good one if there is one; None where it is not known."""
        target = min(snapshot.targets, key=lambda target: bool(target.reject), default=None)
        if target is None:
            return None
        limit_mm = self._sources.limits().get(snapshot.job_number)
        return budget(target, snapshot.robot_from_rig, snapshot.registration_covariance, limit_mm)

    def history(self, after: int = 0) -> list[Json]:
        """Points of the trends for the cycles after `after`, oldest first."""
        return [point for point in self._history if point["cycle"] > after]

    async def registers(self) -> list[Json]:
        """The Modbus map with the values that a client would read at this moment."""
        return [
            {
                "address": register.address,
                "name": register.name,
                "value": known(value),
                # a browser's numbers have 53 bits, fewer than a time in ns needs
                "text": text_of(register, value),
                "unit": register.unit,
                "meaning": meaning_of(register, value),
                "help": register.help,
            }
            for register, value in await self._sources.registers()
        ]

    def pair(self, cycle: int) -> FramePair | None:
        """Images of a cycle; None unless it is one of the newest or of the last faults."""
        shown = self._kept(cycle)
        return None if shown is None else shown.pair

    def _kept(self, cycle: int) -> ShownCycle | None:
        """A cycle by its number; None if its pictures are no longer kept."""
        for shown in (*self._recent, *self._faults):
            if shown.snapshot.cycle == cycle and shown.pair is not None:
                return shown
        return None

    def rectification(self) -> Rectification:
        """Rectification of the rig in use."""
        return self._sources.rectification()

    def _picture(self, shown: ShownCycle) -> Json:
        """Number and size of the picture, and what to draw on it; computed once for all viewers."""
        if self._drawn is None or self._drawn[0] is not shown:
            self._drawn = shown, self._draw(shown)
        return self._drawn[1]

    def _draw(self, shown: ShownCycle) -> Json:
        rectification = self._sources.rectification()
        width, height = rectification.size
        marks = [
            {"good": not target.reject, **{side: outlines(target, rectification, side) for side in SIDES}}
            for target in shown.snapshot.targets
        ]
        return {"cycle": shown.snapshot.cycle, "width": width, "height": height, "marks": marks}


def picture(pair: FramePair, rectification: Rectification, side: Side, width_px: int | None = None) -> bytes:
    """JPEG of one rectified image; of the raw image where the rig does not fit it (it was just exchanged).

    width_px : largest width; None: WIDTH_PX.
    """
    width_px = WIDTH_PX if width_px is None else width_px
    frame = pair.side(side)
    camera = rectification.rig.camera(side)
    image, shrink = frame.image, frame.image.shape[1] // width_px
    maps: tuple[MatLike, MatLike] | None = None
    if image.shape == (camera.height, camera.width):
        if width_px >= rectification.size[0]:
            shrink, maps = 1, rectification.maps_left if side == "left" else rectification.maps_right
        else:
            shrink, maps = _display_maps(rectification, side, width_px)
    if shrink > 1:
        size = (image.shape[1] // shrink, image.shape[0] // shrink)
        whole = image[: size[1] * shrink, : size[0] * shrink]
        image = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.uint8)
    if maps is not None:
        image = np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR), np.uint8)
    return jpeg(image, QUALITY)


@lru_cache(maxsize=4)
def _display_maps(
    rectification: Rectification, side: Side, width_px: int
) -> tuple[int, tuple[MatLike, MatLike]]:
    """Factor by which to shrink the raw image first, and the maps from the shrunk image to the picture.

    Rectifying straight to the size shown takes a fifth of the work of rectifying at full size. Shrinking by a
    whole number first keeps the sampling step below two pixels, which avoids aliasing.
    """
    width, height = rectification.size
    scale = min(1.0, width_px / width)
    size = (round(width * scale), round(height * scale))
    shrink = int(1 / scale)
    x, y = (
        (cv2.resize(plane, size, interpolation=cv2.INTER_LINEAR) + 0.5) / shrink - 0.5
        for plane in (rectification.maps_left if side == "left" else rectification.maps_right)
    )
    return shrink, (x, y)


def _trend(snapshot: Snapshot) -> Json:
    """One point of the trends; only a good result has a sigma, a score and an epipolar residual."""
    point: Json = {"cycle": snapshot.cycle, "time_ns": snapshot.published_ns, "status": str(snapshot.status)}
    if snapshot.status is not Status.CAPTURE_FAULT:
        point["total_ms"] = snapshot.timing_ms.get("total")
    if snapshot.status is Status.OK:
        best = snapshot.targets[0]
        point |= {
            "sigma_mm": float(max(best.sigma_mm)),
            "score": best.match.score,
            "epipolar_px": best.epipolar_rms_px,
        }
    if math.isfinite(snapshot.drift.rows_px):
        point["drift_px"] = snapshot.drift.rows_px
    return point


def _why(snapshot: Snapshot) -> list[Json]:
    """Reasons why a cycle is bad; empty for a good one and for one that only took pictures."""
    if snapshot.error:
        return [translatable("ERROR", snapshot.error, number=snapshot.error_code)]
    if snapshot.status is Status.NO_TARGET:
        grabbed = snapshot.command is not None and snapshot.command.kind is CommandKind.GRAB
        if grabbed or (snapshot.nearest is not None and not snapshot.nearest.answered):
            return []
        return _why_nothing(snapshot.dismissed, None if snapshot.nearest is None else snapshot.nearest.answer)
    rejected = [target.reject for target in snapshot.targets]
    return [
        translatable(bit.name or "", words)
        for bit, words in REASONS.items()
        if any(reject & bit for reject in rejected)
    ]


def _why_nothing(dismissed: Sequence[NotMeasured], nearest: NearMiss | None) -> list[Json]:
    lines = why_nothing(dismissed, nearest)
    if dismissed:
        return [
            translatable("SEEN", line, **_place(part.match), reject=reject_names(part.reject))
            for line, part in zip(lines, dismissed, strict=True)
        ]
    if nearest is not None:
        needed = f"{nearest.needed_score:.2f}"
        return [translatable("NEAREST", line, **_place(nearest.match), needed=needed) for line in lines]
    return [translatable("NOTHING", line) for line in lines]


def _place(match: Match) -> Json:
    return {"x_px": f"{match.x_px:.0f}", "y_px": f"{match.y_px:.0f}", "score": f"{match.score:.2f}"}


def _angles(target: Target, snapshot: Snapshot, convention: Convention) -> Json | None:
    """Angles of one target and their sigmas; None where the pose or its covariance is not finite."""
    if not (np.isfinite(target.rig_from_part).all() and np.isfinite(target.covariance).all()):
        return None
    reading = reading_of(target, snapshot.robot_from_rig, snapshot.registration_covariance, convention)
    return {"deg": reading.angles_deg.tolist(), "sigma_deg": reading.sigma_deg.tolist()}


def _size(shown: ShownCycle) -> int:
    """Bytes of the pictures of a cycle."""
    return 0 if shown.pair is None else shown.pair.left.image.nbytes + shown.pair.right.image.nbytes


def _fault_key(snapshot: Snapshot) -> tuple[object, ...]:
    """Key of a fault in the list: number and camera of an error, or status, job and reasons of a miss."""
    if snapshot.error:
        return snapshot.error_code, snapshot.error.partition(":")[0]
    refused = {target.reject for target in snapshot.targets} | {part.reject for part in snapshot.dismissed}
    return snapshot.status, snapshot.job, frozenset(refused)


def _recent(shown: ShownCycle) -> Json:
    snapshot = shown.snapshot
    return {"cycle": snapshot.cycle, "time_ns": snapshot.published_ns, "status": str(snapshot.status)}


def _fault(shown: ShownCycle) -> Json:
    snapshot = shown.snapshot
    return {
        "cycle": snapshot.cycle,
        "time_ns": snapshot.published_ns,
        "times": shown.times,
        "last_ns": shown.last_ns,
        "status": str(snapshot.status),
        "why": _why(snapshot),
        "has_picture": shown.pair is not None,
    }
