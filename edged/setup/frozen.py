"""The base of what services of setting up answer; light enough for the worker process."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Frozen(BaseModel):
    """A model that does not change."""

    model_config = ConfigDict(frozen=True)
