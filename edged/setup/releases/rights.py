"""Access that a cell's configuration grants: addresses, networks, passwords, and Zenoh's own file.

A fingerprint does not protect it: it covers neither passwords nor the content of Zenoh's file, and the author
of an archive also writes its fingerprint and checksums.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edged.config.tomltext import toml_of
from edged.errors import FileFormatError
from edged.files.atomic import read_bytes

SERVERS = ("modbus", "ethernetip", "opcua", "plc", "web", "zenoh")
"""Sections of the configuration that grant access."""
SECRET = "password_hash"
ZENOH_FILE = "zenoh.config_file"
MAX_VALUE = 100
"""Number of characters of a value that are shown."""


@dataclass(frozen=True, slots=True, eq=False)
class Rights:
    """Options of `SERVERS` by dotted name, as they are written; None where the configuration cannot be read.

    zenoh : content of Zenoh's own file, b"" without one.
    """

    options: Mapping[str, Any] | None
    zenoh: bytes = b""

    def lines(self) -> list[str]:
        """One line for each option that is set; for a password only its name."""
        if self.options is None:
            return ["nothing that can be read: its configuration is no TOML"]
        return [_set(name, value) for name, value in self.options.items()]

    def changed_from(self, before: Rights) -> list[str]:
        """One line for each option that differs, and one for Zenoh's file if it does."""
        old, new = before.options or {}, self.options or {}
        found = []
        for name in sorted(old.keys() | new.keys()):
            if name in new and name not in old:
                found.append(f"{_set(name, new[name])}, was not set")
            elif name not in new:
                found.append(f"{name}, is not set now")
            elif old[name] != new[name]:
                found.append(
                    _set(name, new[name]) + ("" if _is_secret(name) else f", was {_shown(old[name])}")
                )
        if self.zenoh != before.zenoh:
            found.append(f"what is in {ZENOH_FILE}, {new.get(ZENOH_FILE, 'none')}")
        return found


def rights_in(files: Mapping[str, bytes], config: str) -> Rights:
    """Rights of a cell given its files by name."""
    options = _options(files[config])
    named = None if options is None else options.get(ZENOH_FILE)
    return Rights(options, files.get(named, b"") if isinstance(named, str) else b"")


def rights_at(config: Path) -> Rights | None:
    """Rights of a cell on disc; None without one. A configuration that cannot be read has no options."""
    if not config.is_file():
        return None
    try:
        options = _options(read_bytes(config, "a configuration"))
    except FileFormatError:
        return Rights(None)
    named = None if options is None else options.get(ZENOH_FILE)
    try:
        zenoh = read_bytes(config.parent / named, "Zenoh's file") if isinstance(named, str) else b""
    except (FileFormatError, ValueError):  # ValueError: a name with a null character
        zenoh = b""
    return Rights(options, zenoh)


def _options(text: bytes) -> dict[str, Any] | None:
    try:
        document = toml_of(text)
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError):
        return None
    return dict(_flat({name: document[name] for name in SERVERS if name in document}))


def _flat(table: Mapping[str, Any], place: str = "") -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for key, value in table.items():
        name = f"{place}{key}"
        found += _flat(value, f"{name}.") if isinstance(value, Mapping) else [(name, value)]
    return found


def _is_secret(name: str) -> bool:
    return name.endswith(SECRET)


def _set(name: str, value: Any) -> str:
    return name if _is_secret(name) else f"{name} = {_shown(value)}"


def _shown(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= MAX_VALUE else f"{text[:MAX_VALUE]}..."
