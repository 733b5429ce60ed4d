"""Settings that people may choose on the page, by their dotted names, over those of the configuration.

The configuration is the administrator's, and the page cannot write it. What is chosen is in the file beside
the rig (`chosenconnections`), which the page hands over: the cell takes the names of `CHOOSABLE`, no others.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from edged.config.cameras import MODE_KEYS, TriggerSection
from edged.config.cell import CycleSection, DriftSection, RecorderSection

Scalar = bool | int | float | str
TRIGGER = "cameras.trigger"
CHOOSABLE: tuple[str, ...] = (
    *(f"cycle.{key}" for key in CycleSection.model_fields),
    *(f"{TRIGGER}.{key}" for key in TriggerSection.model_fields),
    *(
        f"cameras.{key}"
        for key in ("timeout_s", "max_skew_ms", "max_arrival_skew_ms", "chunks", "ptp", "exposure_ratio")
    ),
    *(f"cameras.{side}.{key}" for side in ("left", "right") for key in ("packet_size", "packet_delay_us")),
    *(f"drift.{key}" for key in DriftSection.model_fields),
    *(f"modbus.{key}" for key in ("validity_s", "heartbeat_s", "owner_s", "idle_s", "max_clients")),
    "opcua.max_clients",
    *(f"recorder.{key}" for key in RecorderSection.model_fields if key != "folder"),
    *(f"zenoh.{key}" for key in ("encoding", "trigger_timeout_s", "ros2_domain_id")),
)
"""Each a number, a word, or yes or no: nothing that opens a port, names a file or lets anybody in."""
OPTIONAL = ("opcua", "recorder")
"""Sections that a choice does not make where the configuration has none: what they need is not here."""


def refuse_unknown(chosen: Mapping[str, Scalar | None]) -> Mapping[str, Scalar | None]:
    """The same. Raises `ValueError` for a name that cannot be chosen."""
    if odd := sorted(chosen.keys() - set(CHOOSABLE)):
        raise ValueError(f"{odd[0]}: cannot be chosen on the page")
    return chosen


def over(chosen: Mapping[str, Scalar | None], data: Mapping[str, Any]) -> dict[str, Any]:
    """A configuration's tables with what was chosen; None leaves a key out."""
    merged = dict(data)
    for name, value in _with_mode(chosen).items():
        *sections, key = name.split(".")
        if sections[0] in OPTIONAL and sections[0] not in data:
            continue
        table: Any = merged
        for section in sections:
            inner = table.get(section, {})
            if not isinstance(inner, dict):
                break  # a mistake, which is said where the configuration is read
            table[section] = inner = dict(inner)
            table = inner
        else:
            if value is None:
                table.pop(key, None)
            else:
                table[key] = value
    return merged


def _with_mode(chosen: Mapping[str, Scalar | None]) -> dict[str, Scalar | None]:
    """With another trigger mode, what belongs to others is left out, too."""
    mode = chosen.get(f"{TRIGGER}.mode")
    own = MODE_KEYS.get(str(mode), set()) | {"mode"}
    others = TriggerSection.model_fields.keys() - own if mode is not None else set()
    return {**chosen, **{f"{TRIGGER}.{key}": None for key in others}}


def at(data: Mapping[str, Any], name: str) -> Any:
    """What stands under a dotted name; None where nothing does."""
    value: Any = data
    for part in name.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value
