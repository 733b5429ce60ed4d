"""The draft of settings that are chosen but not in force yet: checked, then activated or discarded.

There is one draft for all of a cell's settings, including connections of PLCs and robots, in a file of the
page.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, JsonValue, ValidationError

from edged.adapters.web.routes import Problem
from edged.config.chosenconnections import ChosenConnections, chosen_connections
from edged.config.configuration import Config
from edged.config.reading import config_with, problem_of, read
from edged.errors import ConfigError, FileFormatError, UserError
from edged.files.atomic import read_bytes, write_atomically
from edged.setup.documents import Frozen, now_text
from edged.setup.history import Kept, Text
from edged.setup.inuse import CellInUse
from edged.setup.releases.differences import Difference, changed_options
from edged.setup.releases.service import Activation, Mandate

FILE = "settings-draft.json"
MAX_BYTES = 64 * 1024
PASSWORD = "opcua.password_hash"


class Drafted(Kept):
    """File of the draft. chosen : as it would be in `rig.connections.json`."""

    format: Literal["edged-settings-draft"] = "edged-settings-draft"
    version: Literal[1] = 1
    revision: Annotated[int, Field(ge=1)]
    created: Text
    author: Text
    chosen: dict[str, JsonValue]


class WrongSetting(Frozen):
    """Why the cell cannot run with a draft. name : of the setting or the section; "" if not known."""

    name: str
    text: str


class SettingsDraftDocument(Frozen):
    """The draft of settings. changes : against settings in force. problems : empty if it is valid."""

    revision: int
    created: str
    author: str
    changes: list[Difference]
    problems: list[WrongSetting]


class SettingsDraft:
    """The settings draft of a cell; methods that are not coroutines read files: call them in a thread."""

    def __init__(self, cell: CellInUse, activation: Activation) -> None:
        self._cell = cell
        self._activation = activation
        self._turn = asyncio.Lock()

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the cell."""
        return self._cell.files.fingerprint

    @property
    def _file(self) -> Path:
        return self._cell.folder / FILE

    def chosen(self) -> ChosenConnections:
        """All choices in the draft, or those in force if there is no draft. Raises `UserError`."""
        drafted = self._drafted()
        return self._in_force() if drafted is None else self._chosen_in(drafted)

    def configured(self) -> Config:
        """The configuration without any chosen settings and connections. Raises `ConfigError`."""
        return config_with(read(self._cell.path), self._cell.path, None)

    def document(self) -> SettingsDraftDocument | None:
        """The draft, checked; None without one. Raises `UserError`."""
        drafted = self._drafted()
        if drafted is None:
            return None
        chosen, in_force = self._chosen_in(drafted), self._cell.files.config
        wanted: Mapping[str, Any]
        try:
            config = config_with(read(self._cell.path), self._cell.path, chosen.content())
            wanted, problems = config.model_dump(), config.missing_files()
        except ConfigError as error:
            wanted, problems = chosen.over(self.configured().model_dump()), error.problems
        changes = changed_options(in_force.model_dump(), wanted)
        if _password(chosen) != _password(self._in_force()):
            changes = [*changes, Difference(code="password", name=PASSWORD)]
        return SettingsDraftDocument(
            revision=drafted.revision,
            created=drafted.created,
            author=drafted.author,
            changes=changes,
            problems=[_wrong(problem) for problem in problems],
        )

    async def change(
        self,
        change: Callable[[ChosenConnections], ChosenConnections],
        author: str,
        revision: int | None = None,
    ) -> None:
        """Change the draft, or begin it; it is deleted if it equals the settings in force.

        change : makes the new choices from the present ones, in a thread. revision : that was seen, 0 for no
        draft, None for any. Raises `Problem` for another, `UserError`, `OSError`.
        """
        async with self._turn:
            await asyncio.to_thread(self._change, change, author, revision)
        self._cell.notices.publish("settings", {"id": "settings"})

    def _change(
        self, change: Callable[[ChosenConnections], ChosenConnections], author: str, revision: int | None
    ) -> None:
        drafted = self._drafted()
        if revision is not None and revision != (0 if drafted is None else drafted.revision):
            raise Problem(412, "stale", "somebody else has changed it since")
        wanted = change(self.chosen())
        content = wanted.content()
        if wanted == self._in_force():
            self._file.unlink(missing_ok=True)
            return
        made = Drafted(
            revision=1 if drafted is None else drafted.revision + 1,
            created=now_text(),
            author=author,
            chosen={} if content is None else json.loads(content),
        )
        write_atomically(self._file, made.model_dump_json(indent=1).encode(), mode=0o600)

    async def discard(self) -> None:
        """Discard the draft, even if it cannot be read. Raises `OSError`."""
        async with self._turn:
            await asyncio.to_thread(self._file.unlink, missing_ok=True)
        self._cell.notices.publish("settings", {"id": "settings"})

    async def activate(self, by: Mandate) -> None:
        """Activate the draft as a release. Raises `UserError` if invalid, and as `Activation.activate`."""
        async with self._turn:
            found = await asyncio.to_thread(self.document)
            if found is None:
                raise UserError("nothing is chosen that is not in force")
            if found.problems:
                raise UserError("; ".join(wrong.text for wrong in found.problems))
            wanted = await asyncio.to_thread(self.chosen)
            await self._activation.activate_connections(wanted.content(), by)
            await asyncio.to_thread(self._file.unlink, missing_ok=True)
        self._cell.notices.publish("settings", {"id": "settings"})

    def _in_force(self) -> ChosenConnections:
        return chosen_connections(self._cell.files.config.cell.rig)

    def _drafted(self) -> Drafted | None:
        """Read the draft's file; None without one. Raises `FileFormatError`."""
        if not self._file.is_file():
            return None
        try:
            return Drafted.model_validate_json(read_bytes(self._file, "a draft", MAX_BYTES))
        except ValidationError as error:
            raise self._damaged(problem_of(error.errors()[0], Drafted)) from error

    def _chosen_in(self, drafted: Drafted) -> ChosenConnections:
        try:
            return ChosenConnections.model_validate(drafted.chosen)
        except ValidationError as error:
            raise self._damaged(problem_of(error.errors()[0], ChosenConnections)) from error

    def _damaged(self, why: str) -> FileFormatError:
        return FileFormatError(f"{self._file}: {why}: discard the draft of the settings")


def _password(chosen: ChosenConnections) -> object:
    return (chosen.opcua or {}).get("password_hash")


def _wrong(problem: str) -> WrongSetting:
    """Split a line of `ConfigError` into the setting's name and the text."""
    name, colon, _ = problem.partition(": ")
    return WrongSetting(name=name if colon and " " not in name else "", text=problem)
