"""Connections of PLCs and robots, and other settings, chosen on the page and kept in a file beside the rig.

The configuration belongs to the administrator, and the page cannot write it. Choices override it:
`rig.json` has `rig.connections.json`, with keys of `[modbus]` and `[opcua]`, and `settings` by their dotted
names (`chosensettings`); a null value removes the key.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator

from edged.config import chosensettings
from edged.config.chosen import choice_of, read_choice
from edged.config.fields import Section

Settings = Annotated[
    dict[str, chosensettings.Scalar | None],
    AfterValidator(lambda names: dict(chosensettings.refuse_unknown(names))),
]


class ChosenConnections(Section):
    """Chosen keys of both sections, and settings. opcua : None: there is to be no such server."""

    modbus: dict[str, Any] = {}  # noqa: RUF012  (pydantic copies it)
    opcua: dict[str, Any] | None = {}  # noqa: RUF012  (likewise)
    settings: Settings = {}  # noqa: RUF012  (likewise)

    @property
    def connects(self) -> bool:
        """Whether it changes how PLCs and robots connect."""
        return bool(self.modbus) or self.opcua != {}

    def over(self, data: Mapping[str, Any]) -> dict[str, Any]:
        """Tables of a configuration, with the choice applied."""
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
        return chosensettings.over(self.settings, merged)

    def content(self) -> bytes | None:
        """Content for the file; None if nothing is chosen."""
        chosen = self.model_dump(mode="json")
        if not self.connects:
            del chosen["modbus"], chosen["opcua"]
        if not self.settings:
            del chosen["settings"]
        return (json.dumps(chosen, indent=2) + "\n").encode() if chosen else None


def connections_file(rig: Path) -> Path:
    """Path of the file with the choice for a cell.

    >>> connections_file(Path("/etc/edged/rig.json")).name
    'rig.connections.json'
    """
    return rig.with_name(f"{rig.stem}.connections.json")


def read_connections(rig: Path) -> bytes | None:
    """Read the choice; None without one. Raises `ConfigError`."""
    return read_choice(connections_file(rig), "connections")


def connections_of(content: bytes | None, file: Path) -> ChosenConnections:
    """Parse a choice; an empty one without content. Raises `ConfigError`."""
    if content is None:
        return ChosenConnections()
    without = "PLCs and robots connect as configured, and all else is as configured"
    return choice_of(ChosenConnections, content, file, "connections", without)


def chosen_connections(rig: Path) -> ChosenConnections:
    """Read and parse the choice for a cell. Raises `ConfigError`."""
    return connections_of(read_connections(rig), connections_file(rig))


def with_password_of(content: bytes | None, now: bytes | None, file: Path) -> bytes | None:
    """An earlier choice with the current password, so that a replaced one does not come back.

    content : of the earlier file; now : of the current one. Raises `ConfigError`.
    """
    chosen, other = (connections_of(data, file) for data in (content, now))
    password = (other.opcua or {}).get("password_hash")
    if not chosen.opcua or password is None:
        return content
    return chosen.model_copy(update={"opcua": {**chosen.opcua, "password_hash": password}}).content()
