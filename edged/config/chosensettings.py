"""Settings that people may choose on the page, by their dotted names; they override the configuration.

The configuration belongs to the administrator, and the page cannot write it. Choices are in the file beside
the rig (`chosenconnections`), which the page sends: the cell accepts only the names in `CHOOSABLE`.
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
"""Each is a number, a word or a boolean: nothing that opens a port, names a file or grants access."""
OPTIONAL = ("opcua", "recorder")
"""Sections that a choice does not create if the configuration lacks them: required keys are not here."""


def refuse_unknown(chosen: Mapping[str, Scalar | None]) -> Mapping[str, Scalar | None]:
    """Return the choice unchanged. Raises `ValueError` for a name that cannot be chosen."""
    if odd := sorted(chosen.keys() - set(CHOOSABLE)):
        raise ValueError(f"{odd[0]}: cannot be chosen on the page")
    return chosen


def over(chosen: Mapping[str, Scalar | None], data: Mapping[str, Any]) -> dict[str, Any]:
    """Tables of a configuration, with the choice applied; None removes a key."""
    merged = dict(data)
    for name, value in _with_mode(chosen).items():
        *sections, key = name.split(".")
        if sections[0] in OPTIONAL and sections[0] not in data:
            continue
        table: Any = merged
        for section in sections:
            inner = table.get(section, {})
            if not isinstance(inner, dict):
                break  # a mistake, which is reported where the configuration is read
            table[section] = inner = dict(inner)
            table = inner
        else:
            if value is None:
                table.pop(key, None)
            else:
                table[key] = value
    return merged


def _with_mode(chosen: Mapping[str, Scalar | None]) -> dict[str, Scalar | None]:
    """Choice that, with a trigger mode, also removes the keys that belong to other modes."""
    mode = chosen.get(f"{TRIGGER}.mode")
    own = MODE_KEYS.get(str(mode), set()) | {"mode"}
    others = TriggerSection.model_fields.keys() - own if mode is not None else set()
    return {**chosen, **{f"{TRIGGER}.{key}": None for key in others}}


def at(data: Mapping[str, Any], name: str) -> Any:
    """Value under a dotted name; None if there is none."""
    value: Any = data
    for part in name.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value
