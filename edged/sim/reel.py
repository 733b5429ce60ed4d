"""Pictures of a folder as two virtual cameras show them: both halves of a pair at one exposure."""

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
    """The pairs in turn, again and again. shown : pictures by side, as many of each.

    Not by a camera's own frame number: that begins anew where one was switched off, and left and right would
    show different pairs from then on. Thread-safe: cameras expose from threads of their own.
    """

    def __init__(self, shown: Mapping[Side, Sequence[Image]]) -> None:
        self._shown = shown
        self._moments: deque[_Moment] = deque(maxlen=HISTORY)
        self._born = 0
        self._lock = threading.Lock()

    def exposure(self, side: Side) -> Callable[[ExposureRequest], Image]:
        """The function that a virtual camera calls for its images."""
        images = self._shown[side]

        def expose(request: ExposureRequest) -> Image:
            image = images[self._number(side, request) % len(images)]
            return image[: request.height, : request.width]

        return expose

    def _number(self, side: str, request: ExposureRequest) -> int:
        """Which pair this exposure sees: that of the other side's exposure at this time, or the next one."""
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
