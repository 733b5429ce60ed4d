"""Pictures for people: small JPEGs of both cameras, only while there are subscribers.

`edged/<cell>/preview/left` and `.../right`, with a JSON attachment that identifies the exposure.
They have their own thread and the lowest priority, and are dropped on congestion: a picture never delays a
coordinate.
"""

from __future__ import annotations

import time

import zenoh

from edged.adapters.zenoh.worker import JobThread
from edged.domain.arrays import SIDES
from edged.domain.events import ExposureDone
from edged.domain.frames import Frame
from edged.payload import encode
from edged.pictures.encoding import jpeg

PERIOD_S = 0.2
WIDTH_PX = 640
QUALITY = 80  # per cent


class Preview:
    """Both preview topics of a cell on a Zenoh session."""

    def __init__(self, session: zenoh.Session, base: str) -> None:
        self._publishers = {
            side: session.declare_publisher(
                f"{base}/preview/{side}",
                encoding=zenoh.Encoding.IMAGE_JPEG,
                priority=zenoh.Priority.BACKGROUND,
                congestion_control=zenoh.CongestionControl.DROP,
            )
            for side in SIDES
        }
        self._zid = str(session.zid())
        self._worker = JobThread("zenoh-preview", 1)
        self._offered_s = float("-inf")

    def start(self) -> None:
        """Start the thread."""
        self._worker.start()

    def offer(self, event: ExposureDone) -> None:
        """Offer the images of an exposure, which are encoded at most once in `PERIOD_S`."""
        now_s = time.monotonic()
        pair = event.pair
        if pair is None or now_s - self._offered_s < PERIOD_S:
            return
        self._offered_s = now_s

        def send() -> None:
            for side, frame in zip(SIDES, (pair.left, pair.right), strict=True):
                publisher = self._publishers[side]
                status = publisher.matching_status
                if getattr(status, "matching", status):  # the stub says bool, but it is a MatchingStatus
                    caption = _caption(self._zid, event.cycle, frame)
                    publisher.put(jpeg(frame.image, QUALITY, WIDTH_PX), attachment=encode(caption))

        self._worker.post(send)

    def stop(self, timeout_s: float) -> None:
        """End the thread."""
        self._worker.stop(timeout_s)


def _caption(zid: str, cycle: int, frame: Frame) -> dict[str, int | str]:
    """Session, exposure, and the size of the camera's image, as a preview may be smaller."""
    height_px, width_px = frame.image.shape
    return {
        "session": zid,
        "cycle": cycle,
        "exposed_ns": frame.exposed_ns,
        "frame_id": frame.frame_id,
        "width_px": width_px,
        "height_px": height_px,
    }
