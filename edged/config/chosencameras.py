"""Cameras chosen on the page, in a file beside the rig that was calibrated with them.

The configuration belongs to the administrator; which camera is left, and how it is exposed, belongs to the
rig, and is stored with it: `rig.json` has `rig.cameras.json`. Its values override `[cameras.left]` and
`[cameras.right]`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from edged.config.chosen import choice_of, read_choice
from edged.config.fields import Section
from edged.domain.arrays import SIDES, Side

UNCHOSEN: Mapping[Side, str] = {"left": "to-be-chosen-left", "right": "to-be-chosen-right"}
"""Placeholder devices until cameras are chosen: no camera answers to them."""
NAME = "rig.cameras.json"
"""Name of the file in recordings, whatever the rig's file is called."""


class ChosenCamera(Section):
    """Choice for one camera; None: as configured. device : serial or address; serial : expected there."""

    device: str | None = Field(None, min_length=1, max_length=64)
    serial: str | None = Field(None, max_length=64)
    exposure_us: float | None = Field(None, gt=0, le=10_000_000)
    gain_db: float | None = Field(None, ge=-10, le=60)

    def stated(self) -> dict[str, str | float]:
        """Values that were chosen, by the names of the configuration."""
        return self.model_dump(exclude_none=True)


class ChosenCameras(Section):
    """Choice for both cameras."""

    left: ChosenCamera = ChosenCamera()
    right: ChosenCamera = ChosenCamera()

    def over(self, cameras: Mapping[str, Any]) -> dict[str, Any]:
        """Section `cameras` of a configuration, with the choice applied."""
        merged = dict(cameras)
        for side in SIDES:
            before = merged.get(side, {})
            stated = getattr(self, side).stated()
            merged[side] = {**before, **stated} if isinstance(before, dict) else before
        return merged


def chosen_file(rig: Path) -> Path:
    """Path of the file with the choice for a rig.

    >>> chosen_file(Path("/etc/edged/rig.json")).name
    'rig.cameras.json'
    """
    return rig.with_name(f"{rig.stem}.cameras.json")


def read_chosen(rig: Path) -> bytes | None:
    """Read the choice; None without one. Raises `ConfigError`."""
    return read_choice(chosen_file(rig), "cameras")


def chosen_of(content: bytes, file: Path) -> ChosenCameras:
    """Parse a choice. Raises `ConfigError`."""
    return choice_of(ChosenCameras, content, file, "cameras", "the cameras are as they are configured")


def with_changes(before: bytes | None, file: Path, changes: Mapping[Side, Mapping[str, Any]]) -> bytes:
    """Content of the file after further choices. Raises `ConfigError`.

    before : content so far. changes : keys of the configuration's `[cameras.left]` and `[cameras.right]`.
    """
    old = ChosenCameras() if before is None else chosen_of(before, file)
    document = {side: {**getattr(old, side).stated(), **changes.get(side, {})} for side in SIDES}
    content = (json.dumps(document, indent=2) + "\n").encode()
    chosen_of(content, file)
    return content
