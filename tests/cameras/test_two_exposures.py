"""Two exposures in a cycle with the real Aravis over real UDP, and the allowed configurations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.gigecell import HEIGHT, LEFT, RIGHT, WIDTH, Cell, closing, running
from helpers.needs import needs_aravis
from pydantic import ValidationError

from edged.app.cameras import camera_facts, head_of
from edged.config.cameras import CamerasSection
from edged.config.configuration import Config
from edged.domain.arrays import Image
from edged.sim.exposure import ExposureRequest
from edged.sim.gige.faults import Quirk

LONG_US = 4000.0


def section(**cameras: Any) -> CamerasSection:
    """A configuration with two exposures."""
    sides = {
        side: {"device": address, "exposure_us": LONG_US}
        for side, address in (("left", LEFT), ("right", RIGHT))
    }
    return CamerasSection.model_validate(
        {"source": "aravis", "timeout_s": 5.0, "max_skew_ms": 1000.0, "exposure_ratio": 8, **sides, **cameras}
    )


def glint(request: ExposureRequest) -> Image:
    """A grey disc with a glint of four times white, on a dark table."""
    y, x = np.mgrid[: request.height, : request.width]
    radius = np.hypot(x - WIDTH / 2, y - HEIGHT / 2)
    light = 0.1 + 0.4 * (radius < 90) + 4.0 * (radius < 25)
    noise = np.random.default_rng(request.frame_id).normal(0.0, 1.0, light.shape)
    return np.clip(np.rint(255 * light * request.exposure_us / LONG_US + noise), 0, 255).astype(np.uint8)


@needs_aravis()
@pytest.mark.slow
@pytest.mark.parametrize("quirks", [(), (Quirk.LATE_EXPOSURE,)])
async def test_a_glint_and_a_dark_table_are_seen_in_one_pair(quirks: tuple[Quirk, ...]) -> None:
    """One pair shows a glint and a dark table, also with firmware that takes an exposure one frame late,
    and states how it was exposed."""
    cell = Cell(quirks=quirks)
    cell.left.exposure = cell.right.exposure = glint
    with running(cell):
        async with closing(head_of(section())) as head:
            pairs, facts = [await head.capture() for _ in range(3)], camera_facts(head)

    for pair in pairs:
        for image in pair.images:
            assert 254 > image[HEIGHT // 2, WIDTH // 2] > 150
            assert 8 < np.median(image[:20]) < 18
        assert pair.exposed_bound_ns is not None
        assert pair.exposed_bound_ns > 1_000_000  # it reaches to both
    assert any(part["text"].startswith("exposed for 4000 and 500 µs, ") for part in facts["left"])


@pytest.mark.parametrize(
    ("cameras", "expected"),
    [
        ({"right": {"device": RIGHT}}, "needs left.exposure_us and right.exposure_us"),
        ({"trigger": {"mode": "line"}}, "needs trigger.mode"),
        ({"trigger": {"mode": "chain", "first_line": "Line1"}}, "needs trigger.mode"),
        ({"exposure_ratio": 1.5}, "greater than or equal to 2"),
        ({"source": "replay", "folder": Path("pairs")}, "were exposed already"),
    ],
)
def test_what_two_exposures_cannot_be_taken_with_is_a_mistake(cameras: dict[str, Any], expected: str) -> None:
    """Two exposures without a stated exposure, with an external trigger, a ratio below 2 or a replay are
    refused.
    """
    with pytest.raises(ValidationError, match=expected):
        section(**cameras)


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        ({"cycle": {"mode": "free", "idle_s": 0.5}}, "idle_s: only with mode"),
        ({"cycle": {"idle_s": 0.5}, "trigger": {"mode": "line"}}, "idle_s: needs exposures that edged makes"),
        (
            {"cycle": {"mode": "external"}, "exposure_ratio": 8, "trigger": {"mode": "action"}},
            "not with cycle.mode",
        ),
    ],
)
def test_exposures_that_others_make_are_neither_doubled_nor_wasted(
    document: dict[str, Any], expected: str
) -> None:
    """idle_s is refused in free mode and with an external trigger, two exposures with an external cycle."""
    cameras = {name: value for name, value in document.items() if name != "cycle"}
    with pytest.raises(ValidationError, match=expected):
        Config.model_validate(
            {
                "cell": {"name": "cell", "rig": Path("rig.json"), "jobs": Path("jobs")},
                "cycle": document["cycle"],
                "cameras": {
                    **section().model_dump(exclude_unset=True, exclude={"exposure_ratio"}),
                    **cameras,
                },
            }
        )
