"""Connections of PLCs and robots as they were chosen on the page, in a file beside the rig.

The configuration is the administrator's, and the page cannot write it. What was chosen counts before it:
`rig.json` has `rig.connections.json`, with keys of `[modbus]` and `[opcua]`; a key that is null is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edged.config.chosen import choice_of, read_choice
from edged.config.fields import Section


class ChosenConnections(Section):
    """Keys of both sections. opcua : None: there is to be no such server."""

    modbus: dict[str, Any] = {}  # noqa: RUF012  (pydantic copies it)
    opcua: dict[str, Any] | None = {}  # noqa: RUF012  (likewise)

    def over(self, data: Mapping[str, Any]) -> dict[str, Any]:
        """A configuration's tables with what was chosen."""
        merged = dict(data)
        for name, chosen in (("modbus", self.modbus), ("opcua", self.opcua)):
            before = merged.pop(name, {})
            if chosen is None:
                continue
            both = {**before, **chosen} if isinstance(before, dict) else before
            if both:
                merged[name] = (
                    {key: value for key, value in both.items() if value is not None} if chosen else both
                )
        return merged


def connections_file(rig: Path) -> Path:
    """Where the choice for a cell is.

    >>> connections_file(Path("/etc/edged/rig.json")).name
    'rig.connections.json'
    """
    return rig.with_name(f"{rig.stem}.connections.json")


def read_connections(rig: Path) -> bytes | None:
    """Read the choice; None without one. Raises `ConfigError`."""
    return read_choice(connections_file(rig), "connections")


def connections_of(content: bytes, file: Path) -> ChosenConnections:
    """Parse a choice. Raises `ConfigError`."""
    without = "PLCs and robots connect as configured"
    return choice_of(ChosenConnections, content, file, "connections", without)
