"""Features that a camera lacks and a cell may need, described in the words of its maker's menu.

None of them is a fault: if the configuration requests one, the set-up of the camera refuses it by name.
"""

from __future__ import annotations

from dataclasses import dataclass

from edged.adapters.aravis.exposure import gain_scale
from edged.adapters.aravis.features import Features
from edged.adapters.aravis.names import EXPOSURE_ACTIVE, FRAME_RATE, PTP, PTP_MODE, RAW_GAIN, TEMPERATURE

TRIGGER_SOURCE, CHUNK_SELECTOR = "TriggerSource", "ChunkSelector"
OUTPUT_SOURCES = ("LineSource", "SyncOutSource")
OFFERED = 8
"""Most choices that are listed by name: some enumerations have forty."""


@dataclass(frozen=True, slots=True)
class MissingFeature:
    """A feature that a camera lacks. code : of a text in the page's languages.

    menu : what the camera's menu offers instead; "" if nothing.
    """

    code: str
    text: str
    menu: str = ""

    def __str__(self) -> str:
        return f"{self.text} ({self.menu})" if self.menu else self.text


def missing_features(features: Features, *, clock: bool) -> tuple[MissingFeature, ...]:
    """Return the features that this camera lacks. clock : whether its clock can be read."""
    sources = features.choices(TRIGGER_SOURCE) if features.exists("TriggerMode") else []
    output = features.first(*OUTPUT_SOURCES)
    shown = features.choices(output) if output else []
    chunks = features.choices(CHUNK_SELECTOR)
    offered = _offers(features, TRIGGER_SOURCE, sources)
    by_action = any(source.startswith("Action") for source in sources)
    raw = f"{features.title(RAW_GAIN)} in steps of its own" if features.exists(RAW_GAIN) else ""
    found = (
        ("software-trigger", "trigger by software", offered, "Software" in sources),
        ("line-trigger", "trigger by a line", offered, any(name.startswith("Line") for name in sources)),
        (
            "action-trigger",
            "trigger by action command",
            "its description has no ActionDeviceKey" if by_action else offered,
            by_action and features.exists("ActionDeviceKey"),
        ),
        (
            "exposure-output",
            "output that shows the exposure",
            _offers(features, output, shown),
            any(word in shown for word in EXPOSURE_ACTIVE),
        ),
        (
            "chunk-exposure",
            "exposure time with each image",
            _offers(features, CHUNK_SELECTOR, chunks),
            "ExposureTime" in chunks,
        ),
        ("gain-db", "gain in dB", raw, gain_scale(features) is not None),
        ("frame-rate", "frame rate", "", bool(features.first(*FRAME_RATE))),
        ("ptp", "PTP", "", bool(features.first(*PTP, PTP_MODE))),
        ("clock", "clock that can be read", "", clock),
        ("temperature", "temperature", "", bool(features.first(*TEMPERATURE))),
    )
    return tuple(MissingFeature(code, text, menu) for code, text, menu, has in found if not has)


def _offers(features: Features, name: str, choices: list[str]) -> str:
    if not choices:
        return ""
    more = f" and {len(choices) - OFFERED} more" if len(choices) > OFFERED else ""
    return f"{features.title(name)} offers {', '.join(choices[:OFFERED])}{more}"
