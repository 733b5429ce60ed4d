"""Section for the signed releases that a cell fetches by itself."""

from __future__ import annotations

import re
from datetime import time
from pathlib import Path
from typing import Self

from pydantic import Field, field_validator, model_validator

from edged.config.fields import FilePath, Name, Section

_WINDOW = re.compile(r"([01][0-9]|2[0-3]):([0-5][0-9])-([01][0-9]|2[0-3]):([0-5][0-9])")


class FleetSection(Section):
    """Signed releases, which `edged release pull` fetches and the cell tries before it uses them."""

    repository: str = Field(description="https://HOST/FOLDER, or the absolute path of a folder")
    plant: Name = Field(description="whose releases: the name that the repository delegates to")
    root: FilePath = Field(description="the repository's 1.root.json, brought here by a trusted way")
    ring: int | None = Field(
        None, ge=1, le=4, description="1 first to 4 last; left out: as the release's list of cells says"
    )
    hawkbit: str | None = Field(
        None,
        pattern=r"^https://[^/\s?#@]+/[^/\s?#]+/?$",
        description="https://HOST/TENANT of a hawkBit that assigns releases instead of their rings",
    )
    hawkbit_token: FilePath | None = Field(
        None, description='file with "TargetToken ..." or "GatewayToken ..."; expected with hawkbit'
    )
    software: FilePath | None = Field(
        None, description="where tools/install puts versions, /opt/edged; left out: software is not taken"
    )
    window: str | None = Field(
        None, description='"22:00-05:00", local time: releases become active then; left out: at any time'
    )

    @field_validator("repository")
    @classmethod
    def _is_place(cls, text: str) -> str:
        if not (re.match(r"https://[^/\s]", text) or Path(text).is_absolute()):
            raise ValueError("expected https://HOST/FOLDER, or the absolute path of a folder")
        return text

    @model_validator(mode="after")
    def _has_token(self) -> Self:
        if (self.hawkbit is None) != (self.hawkbit_token is None):
            raise ValueError("expected hawkbit and hawkbit_token, or neither")
        return self

    @field_validator("window")
    @classmethod
    def _is_window(cls, text: str | None) -> str | None:
        if text is not None and _WINDOW.fullmatch(text) is None:
            raise ValueError('expected two times of day, as "22:00-05:00"')
        return text

    def is_open(self, now: time) -> bool:
        """Whether a time of day lies within the window.

        >>> night = FleetSection(repository="/usb", plant="north", root=Path("r"), window="22:00-05:00")
        >>> [night.is_open(time(hour)) for hour in (4, 5, 21, 22)]
        [True, False, False, True]
        """
        found = None if self.window is None else _WINDOW.fullmatch(self.window)
        if found is None:
            return True
        begin, end = (time(int(found[i]), int(found[i + 1])) for i in (1, 3))
        return begin <= now < end if begin <= end else now >= begin or now < end
