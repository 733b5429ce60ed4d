"""Drafts of settings: beside the settings in force, checked with reasons, released, discarded."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import pytest
from helpers.cellinuse import StillCell

from edged.adapters.web.routes import Problem
from edged.config.chosenconnections import ChosenConnections
from edged.config.chosensettings import Scalar
from edged.errors import FileFormatError, UserError
from edged.setup.releases.releasefolder import ReleaseFolder
from edged.setup.releases.service import Activation, Mandate
from edged.setup.settingsdraft import FILE, SettingsDraft

ANNA = Mandate("Anna", "as the plant asked")


class DraftedCell:
    """A cell and the draft of its settings."""

    def __init__(self, folder: Path) -> None:
        self.running = StillCell(folder / "cell.toml")
        self.cell = self.running.in_use()
        self.folder = self.cell.folder
        self.folder.mkdir(parents=True, exist_ok=True)
        self.releases = ReleaseFolder(self.folder / "releases")
        self.told: list[str] = []
        self.cell.notices.listen(lambda kind, _: self.told.append(kind))
        self.draft = SettingsDraft(self.cell, Activation(self.releases, self.cell))

    def change(self, revision: int | None = None, **settings: Scalar | None) -> None:
        """Choose exactly these settings; two underscores stand for a dot."""
        named = {name.replace("__", "."): value for name, value in settings.items()}
        changed = lambda before: before.model_copy(update={"settings": named})  # noqa: E731  (short)
        run(self.draft.change(changed, "Anna", revision))


def run(work: Coroutine[Any, Any, None]) -> None:
    """Run a coroutine to its end."""
    asyncio.run(work)


@pytest.fixture
def drafted(own_cell: Path) -> DraftedCell:
    """A cell of the test's own."""
    return DraftedCell(own_cell)


@pytest.mark.slow
def test_what_is_chosen_is_in_force_when_it_is_released(drafted: DraftedCell) -> None:
    """A chosen setting takes effect at the release; then there is no draft any more, and a way back."""
    timeout_s = drafted.cell.files.config.cameras.timeout_s
    drafted.change(cameras__timeout_s=3.0)
    document = drafted.draft.document()
    assert document is not None
    assert [("cameras.timeout_s", timeout_s, 3.0)] == [
        (change.name, change.before, change.after) for change in document.changes
    ]
    assert ([], "Anna", 1) == (document.problems, document.author, document.revision)
    assert timeout_s == StillCell(drafted.running.path).files.config.cameras.timeout_s
    assert 0o600 == (drafted.folder / FILE).stat().st_mode & 0o777

    run(drafted.draft.activate(ANNA))

    assert (None, 3.0) == (drafted.draft.document(), drafted.cell.files.config.cameras.timeout_s)
    assert ["as the plant asked", "as it was found"] == [release.note for release in drafted.releases.all()]
    assert ["settings"] * 2 == drafted.told
    with pytest.raises(UserError, match="nothing is chosen"):
        run(drafted.draft.activate(ANNA))


def test_what_the_cell_cannot_run_with_is_said_by_name_and_not_released(drafted: DraftedCell) -> None:
    """A wrong combination is named by setting and not released; the draft stays, and is good once it is
    corrected."""
    drafted.change(drift__warn_rows_px=9.0)
    document = drafted.draft.document()
    assert document is not None
    (problem,) = document.problems
    assert "drift" == problem.name
    assert "warn_rows_px 9 is beyond" in problem.text
    assert "drift.warn_rows_px" in [change.name for change in document.changes]
    with pytest.raises(UserError, match="warn_rows_px 9 is beyond"):
        run(drafted.draft.activate(ANNA))
    drafted.change(drift__warn_rows_px=0.3, cycle__period_s="soon")
    document = drafted.draft.document()
    assert document is not None
    assert ["cycle.period_s"] == [problem.name for problem in document.problems]
    assert [] == drafted.releases.all()


def test_a_draft_that_nobody_has_seen_is_not_overwritten(drafted: DraftedCell) -> None:
    """A change based on an older draft is refused, a change back to the values in force removes the draft,
    and a damaged draft can be discarded."""
    drafted.change(revision=0, cameras__timeout_s=3.0)
    with pytest.raises(Problem, match="somebody else has changed it"):
        drafted.change(revision=0, cameras__timeout_s=4.0)
    drafted.change(revision=1, cameras__timeout_s=5.0)
    assert {"cameras.timeout_s": 5.0} == drafted.draft.chosen().settings
    drafted.change(revision=2)
    assert None is drafted.draft.document()
    drafted.change(cameras__timeout_s=3.0)
    for damage in (
        b"{",
        b"[]",
        b'{"chosen": 3}',
        (drafted.folder / FILE).read_bytes().replace(b"timeout_s", b"x"),
    ):
        (drafted.folder / FILE).write_bytes(damage)
        with pytest.raises(FileFormatError, match=r"settings-draft\.json.*discard"):
            drafted.draft.document()
    run(drafted.draft.discard())
    assert None is drafted.draft.document()


def test_another_password_is_said_and_not_shown(drafted: DraftedCell) -> None:
    """A changed password is listed as a change; its hash is not shown."""
    hashed = "$argon2id$v=19$m=8,t=1,p=1$c2FsdHNhbHQ$aGFzaGhhc2hoYXNoaGFzaA"
    server = {"port": 4842, "anonymous": True, "password_hash": hashed}
    run(drafted.draft.change(lambda _: ChosenConnections(opcua=server), "Anna"))
    document = drafted.draft.document()
    assert document is not None
    assert "password" in [change.code for change in document.changes]
    assert "argon2id" not in document.model_dump_json()
