"""Connections of PLCs and robots as they were chosen on the page, in a file beside the rig.

The configuration is the administrator's, and the page cannot write it. What was chosen counts before it:
`rig.json` has `rig.connections.json`, with keys of `[modbus]` and `[opcua]`; a key that is null is left out.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from edged.config.fields import Section
from edged.errors import ConfigError
from edged.owners import file_to_read

MAX_BYTES = 64 * 1024


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
    file = connections_file(rig)
    try:
        with file_to_read(file) as opened:
            content = opened.read(MAX_BYTES + 1)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ConfigError(str(file), [f"{file.name}: cannot be read: {error.strerror or error}"]) from error
    if len(content) > MAX_BYTES:
        raise ConfigError(str(file), [f"{file.name}: larger than 64 KiB: no chosen connections"])
    return content


def connections_of(content: bytes, file: Path) -> ChosenConnections:
    """Parse a choice. Raises `ConfigError`."""
    try:
        return ChosenConnections.model_validate(json.loads(content))
    except (ValueError, RecursionError) as error:
        # written by the page: an error means a damaged file, not a typing error
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else "not JSON"
        remedy = "remove it, and PLCs and robots connect as configured"
        raise ConfigError(str(file), [f"{file.name}: no chosen connections: {why}; {remedy}"]) from error
