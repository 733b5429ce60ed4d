"""Values that cross the link between the cell and its page are the same on the other side."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.fieldtypes import reachable
from helpers.ports import free_port
from helpers.smallcell import SmallCell
from helpers.snapshots import make_snapshot
from helpers.webcell import HASH

from edged.domain.cell import CellPhase, CellState
from edged.domain.events import Event, ExposureDone
from edged.domain.frames import Frame, FramePair
from edged.domain.marks import MarksReport, MarksState
from edged.domain.measurement import Match, Nearest, NearMiss
from edged.identity.passwords import hash_password
from edged.link.pictures import PictureRing, SharedPictures
from edged.link.summary import CellSummary, FilesInUse, PageTask, ProgramStep
from edged.link.values import CODEC, TYPES
from edged.payload import snapshot_to_json
from edged.setup.cellfiles import HIDDEN_HASH, CellFiles, cell_of, files_in_use, read_any_cell, read_cell

ROOTS = (*typing.get_args(Event), CellSummary, FilesInUse, PageTask, ProgramStep)


def carried(value: object) -> Any:
    """A value as the other process gets it."""
    images: list[Any] = []
    return CODEC.decode(CODEC.encode(value, images), images)


def test_every_type_of_an_event_may_cross() -> None:
    """Every type of an event, the summary or a step, however deep, can cross the link."""
    found: set[type] = set()
    for root in ROOTS:
        reachable(root, found)
    assert set() == found - set(TYPES)


def test_a_result_is_the_same_in_every_digit() -> None:
    """A result is the same in every digit, with all its arrays."""
    snapshot = make_snapshot()
    assert snapshot_to_json(snapshot) == snapshot_to_json(carried(snapshot))


def test_a_state_is_the_same() -> None:
    """A state is the same, with its enumerations."""
    marks = MarksReport(MarksState.CONTRADICTED, False, 7, 8, (41,), 30.5, 0.012, 0.25, "one was moved")
    state = CellState(CellPhase.READY, True, True, "flange", 1, 0, marks=marks)
    assert state == carried(state)
    assert CellPhase.READY is carried(state).state


def test_a_near_miss_that_is_known_need_not_be_asked_for() -> None:
    """A known near miss crosses with its answer, an unknown one without asking for it."""
    miss = NearMiss(Match(1.0, 2.0, 0.0, 1.0, 1.0, 0.4), 0.6)
    known = Nearest(lambda: miss)
    known.ask()
    told = carried(dataclasses.replace(make_snapshot(), nearest=known)).nearest
    assert told.answered
    assert 0.4 == told.answer.match.score
    assert not carried(dataclasses.replace(make_snapshot(), nearest=Nearest(lambda: miss))).nearest.answered


@pytest.mark.slow
@pytest.mark.parametrize("lacks", ["", "NO_JOB", "NO_CALIBRATION"])
def test_the_files_of_a_cell_are_the_same(tmp_path: Path, lacks: str) -> None:
    """The files of a cell are the same, also without rig or jobs, with the same fingerprint."""
    cell = SmallCell(tmp_path)
    before: Mapping[str, Callable[[], object]] = {
        "": lambda: None,
        "NO_JOB": lambda: (cell.folder / "jobs").rename(tmp_path / "kept"),
        "NO_CALIBRATION": lambda: (cell.folder / "rig.json").unlink(),
    }
    before[lacks]()
    found = read_any_cell(cell.config)
    told = cell_of(carried(files_in_use(found)))
    assert type(found) is type(told)
    assert found.config == told.config
    assert (found.fingerprint, found.contents) == (told.fingerprint, told.contents)
    if isinstance(found, CellFiles) and isinstance(told, CellFiles):
        assert [job.name for job in found.jobs] == [job.name for job in told.jobs]
        assert found.rig.calibration_id == told.rig.calibration_id


@pytest.mark.slow
def test_no_secret_but_the_pages_own_crosses(tmp_path: Path) -> None:
    """Only the page's own secrets cross the link."""
    cell = SmallCell(tmp_path)
    other, token = hash_password("another horse"), hash_password("a token of Prometheus")
    hashes = f'password_hash = "{HASH}"\nmetrics_password_hash = "{token}"'
    text = cell.config.read_text().replace("[web]", f"[web]\n{hashes}", 1)
    keys = 'certificate = "c"\nkey = "k"\ntrusted = "t"\n'
    cell.config.write_text(f'{text}\n[opcua]\nport = {free_port()}\npassword_hash = "{other}"\n{keys}')
    files = carried(files_in_use(read_cell(cell.config, elsewhere=True)))
    told = cell_of(files).config
    assert told.web is not None
    assert HASH == told.web.password_hash.get_secret_value()
    assert token == told.web.metrics_password_hash.get_secret_value()
    assert told.opcua is not None
    assert HIDDEN_HASH == told.opcua.password_hash.get_secret_value()
    for secret in (HASH, token, other):
        assert not any(secret.encode() in content for content in files.contents.values())
    assert other not in files.config


# --- pictures -----------------------------------------------------------------------------------------


def pair(value: int, size: tuple[int, int] = (40, 60)) -> FramePair:
    """Two pictures of one grey."""
    left, right = (Frame(side, 1, np.full(size, value, np.uint8), 1, 2) for side in ("left", "right"))
    return FramePair(left, right)


def sent(ring: PictureRing, shared: SharedPictures, event: object) -> Callable[[], Any]:
    """Send an event; a call of the result receives it."""
    images: list[Any] = []
    data = CODEC.encode(event, images)
    placed, memory = ring.place(images)
    if memory is not None:
        shared.map(memory)
    return lambda: CODEC.decode(data, shared.copy(placed))


def test_pictures_go_through_shared_memory() -> None:
    """Pictures cross by shared memory with every grey value, also after they became larger."""
    ring, shared = PictureRing(), SharedPictures()
    for value, size in ((7, (40, 60)), (8, (40, 60)), (9, (400, 600)), (10, (4, 4))):
        event = sent(ring, shared, ExposureDone(value, None, pair(value, size)))()
        assert size == event.pair.left.image.shape
        assert {value} == set(event.pair.left.image.ravel()) | set(event.pair.right.image.ravel())


def test_a_pair_that_is_fetched_too_late_is_missing_and_not_another() -> None:
    """A pair that is fetched too late is missing, not replaced by another one."""
    ring, shared = PictureRing(), SharedPictures()
    arrivals = [sent(ring, shared, ExposureDone(cycle, None, pair(cycle))) for cycle in range(6)]
    pairs = [arrive().pair for arrive in arrivals]
    assert [None, None] == pairs[:2]
    assert [2, 3, 4, 5] == [told.left.image[0, 0] for told in pairs[2:]]
