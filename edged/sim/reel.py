"""Recorded picture pairs played back by two virtual cameras, with both halves of a pair in one exposure."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from edged.domain.arrays import Image, Side
from edged.sim.cell import HISTORY, PAIR_WINDOW_NS
from edged.sim.exposure import ExposureRequest


@dataclass(slots=True)
class _Moment:
    number: int
    exposed_ns: int
    seen: dict[str, tuple[int, int]] = field(default_factory=dict)  # camera: frame id, exposed_ns


class PairReel:
    """Plays pairs in turn, in an endless loop. shown : pictures by side, the same number of each.

    Pairs are matched by time, not by the cameras' frame ids: these restart when a camera is switched off, and
    left and right would show different pairs from then on. Thread-safe: cameras expose from their own
    threads.
    """

    def __init__(self, shown: Mapping[Side, Sequence[Image]]) -> None:
        self._shown = shown
        self._moments: deque[_Moment] = deque(maxlen=HISTORY)
        self._born = 0
        self._lock = threading.Lock()

    def exposure(self, side: Side) -> Callable[[ExposureRequest], Image]:
        """Image function for a virtual camera."""
        images = self._shown[side]

        def expose(request: ExposureRequest) -> Image:
            image = images[self._number(side, request) % len(images)]
            return image[: request.height, : request.width]

        return expose

    def _number(self, side: str, request: ExposureRequest) -> int:
        """Number of the pair for this exposure: that of the other side's at this time, or the next."""
        frame = (request.frame_id, request.exposed_ns)
        with self._lock:
            for moment in reversed(self._moments):
                near = abs(request.exposed_ns - moment.exposed_ns) <= PAIR_WINDOW_NS
                if near and moment.seen.get(side, frame) == frame:
                    moment.seen[side] = frame
                    return moment.number
            self._moments.append(_Moment(self._born, request.exposed_ns, {side: frame}))
            self._born += 1
            return self._born - 1
