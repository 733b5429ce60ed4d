"""The base of what services of setting up answer; light enough for the worker process."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Frozen(BaseModel):
    """A model that does not change; made of values, or of the attributes of something that has the same."""

    model_config = ConfigDict(frozen=True, from_attributes=True)
