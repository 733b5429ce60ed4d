"""What every topic of setting up sends: documents with a `Trouble` where something is in the way."""

from __future__ import annotations

from pydantic import Field

from edged.setup.frozen import Frozen


class Trouble(Frozen):
    """What keeps something from being done. code, params : as of a problem.  text : in English."""

    code: str
    text: str
    params: dict[str, str | float] = Field(default={})


class DraftHead(Frozen):
    """What the documents of all drafts have in common. active : the cell runs by what came of it."""

    id: str
    revision: int
    created: str
    author: str
    can_undo: bool
    can_redo: bool
    active: bool


class DraftSummary(Frozen):
    """A draft in a list. trouble : why it cannot be read; then only its id is known."""

    id: str
    created: str = ""
    author: str = ""
    active: bool = False
    trouble: str | None = None
