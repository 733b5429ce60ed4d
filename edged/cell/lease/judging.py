"""Judges light and focus of the live pictures, at most once a second, in the background."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from edged.cell.lease.notices import Notices
from edged.domain.arrays import SIDES, Image, Side
from edged.domain.frames import FramePair
from edged.domain.numerals import known
from edged.pictures.light import Advice, LightFigures, light_of
from edged.vision.edges.sharpness import Sharpness, cost_of_spread, sharpness

log = logging.getLogger(__name__)

PERIOD_S = 1.0
"""Shortest time between judgements; judging a pair takes an eighth of a second of one core."""


@dataclass(frozen=True, slots=True, eq=False)
class PictureQuality:
    """Light and sharpness of one picture. exposure_factor : factor on the exposure time, for `advice`."""

    light: LightFigures
    sharpness: Sharpness
    advice: Advice
    exposure_factor: float

    def to_json(self) -> dict[str, Any]:
        """Return the figures under their API names; null where there are too few edges to judge."""
        spread_px = self.sharpness.spread_px
        return {
            "clipped_share": self.light.clipped_share,
            "dark_share": self.light.dark_share,
            "noise_grey": self.light.noise_grey,
            "contrast_grey": self.light.contrast_grey,
            "bright_grey": self.light.bright_grey,
            "edge_spread_px": {
                "median": known(spread_px),
                "map": [[known(field) for field in row] for row in self.sharpness.fields_px.tolist()],
            },
            "sigma_z_factor": None if math.isnan(spread_px) else cost_of_spread(spread_px),
            "advice": {"code": str(self.advice), "exposure_factor": self.exposure_factor},
        }


def judge(image: Image, gain_db: float | None) -> PictureQuality:
    """Return the figures of a picture (H, W) uint8 taken with this gain."""
    light = light_of(image)
    advice, factor = light.advice(gain_db)
    return PictureQuality(light, sharpness(image, light.noise_grey), advice, factor)


class PictureJudge:
    """Judges live pairs; used on the event loop only.

    notices : get "quality". gains : known camera gains, dB.
    """

    def __init__(self, notices: Notices, gains: Callable[[], Mapping[Side, float]]) -> None:
        self._notices = notices
        self._gains = gains
        self._next_s = -math.inf
        self._task: asyncio.Task[None] | None = None
        self.latest: dict[str, Any] | None = None

    def look(self, number: int, pair: FramePair) -> None:
        """Start judging this pair unless one is being judged or was judged just before; returns at once."""
        if self._task is not None or time.monotonic() < self._next_s:
            return
        self._next_s = time.monotonic() + PERIOD_S
        self._task = asyncio.create_task(self._judge(number, pair), name="judge pictures")

    async def judged(self, number: int, pair: FramePair) -> dict[str, Any]:
        """Return the figures of both pictures of a pair, as JSON."""
        gains = self._gains()
        images = {"left": pair.left.image, "right": pair.right.image}
        document: dict[str, Any] = {"number": number}
        for side in SIDES:
            quality = await asyncio.to_thread(judge, images[side], gains.get(side))
            document[side] = quality.to_json()
        return document

    async def close(self) -> None:
        """Wait for the running judgement to end."""
        if self._task is not None:
            await asyncio.wait({self._task})

    async def _judge(self, number: int, pair: FramePair) -> None:
        try:
            self.latest = await self.judged(number, pair)
            self._notices.publish("quality", self.latest)
        finally:
            self._task = None
