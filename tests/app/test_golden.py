"""The golden part of a cell on disc: kept, read again, and refused once its basis has changed."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.cells import small_rig
from helpers.smallcell import TOKEN
from helpers.snapshots import make_snapshot, make_target, make_transform

from edged.app.cell import LoadedCell, load_cell, with_golden, with_registration
from edged.commands.demo import DemoOptions, prepare_cell
from edged.doctor.examination import look_at_map
from edged.doctor.findings import CheckResult
from edged.domain.events import Snapshot
from edged.domain.golden import GoldenState
from edged.domain.measurement import Outcome, Status
from edged.domain.robotmap import RobotMap
from edged.errors import UserError
from edged.files.golden import golden_file, load_golden
from edged.files.rig import load_rig, save_rig
from edged.robot.errormap import hull_of
from edged.setup.cellfiles import read_cell, warnings_for
from edged.setup.releases.archive import make
from edged.sim.cell import VirtualCell

ROBOT_FROM_RIG = make_transform((2.8, 0.3, -0.4), (400.0, -700.0, 900.0))


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cell on disc with a registration to a robot."""
    path = prepare_cell(
        tmp_path_factory.mktemp("cell"), VirtualCell(small_rig(), TOKEN), DemoOptions(), gige=False
    )
    _registered(path, ROBOT_FROM_RIG)
    return path


def _registered(path: Path, robot_from_rig: object) -> None:
    rig = path.with_name("rig.json")
    save_rig(rig, replace(load_rig(rig), robot_from_rig=robot_from_rig))


@pytest.fixture
def cell(original: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    shutil.copytree(original.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / original.name


def seen(loaded: LoadedCell, *, parts: int = 1) -> Snapshot:
    """A good snapshot of the cell's job."""
    setup = loaded.setup
    target = replace(make_target(), rig_from_part=make_transform((0.1, 0.0, 0.4), (3.0, 2.0, 250.0)))
    return replace(
        make_snapshot(targets=(target,) * parts, robot_from_rig=setup.robot_from_rig),
        fingerprint=setup.fingerprint,
        calibration_id=setup.calibration_id,
    )


def state_of(loaded: LoadedCell) -> GoldenState:
    """The golden state of the cell's job."""
    golden = loaded.setup.jobs[1].golden
    return GoldenState.NONE if golden is None else golden.state


def test_a_kept_part_is_in_use_at_once_and_after_a_restart(cell: Path) -> None:
    """A kept part is used at once and after a restart, with the same offset; fingerprint and backup do not
    change."""
    loaded = load_cell(cell)
    assert GoldenState.NONE is state_of(loaded)
    kept = with_golden(loaded, seen(loaded))
    again = load_cell(cell)
    assert (GoldenState.HELD, GoldenState.HELD) == (state_of(kept), state_of(again))
    assert loaded.setup.fingerprint == kept.setup.fingerprint == again.setup.fingerprint
    snapshot = seen(loaded)
    moved = replace(snapshot.targets[0], rig_from_part=make_transform((0.0, 0.1, 0.9), (9.0, -2.0, 251.0)))
    offsets = []
    for one in (kept, again):
        golden = one.setup.jobs[1].golden
        assert golden is not None
        outcome = golden.applied(Outcome(Status.OK, (moved,)), snapshot.robot_from_rig, None)
        found = outcome.targets[0].offset
        assert found is not None
        offsets.append(found)
    np.testing.assert_array_equal(offsets[0].robot, offsets[1].robot)
    np.testing.assert_array_equal(offsets[0].covariance, offsets[1].covariance)
    assert [] == warnings_for(again.cell)
    assert not any("golden" in name for name in make(cell).backup.files)


def _edited(name: str, old: str, new: str) -> Callable[[Path], None]:
    def edit(path: Path) -> None:
        file = path.parent / name
        text, count = re.subn(old, new, file.read_text(), count=1)
        assert 1 == count
        file.write_text(text)

    return edit


CHANGES: dict[str, tuple[Callable[[Path], None], GoldenState, str]] = {
    "registration": (
        lambda path: _registered(path, make_transform((2.8, 0.3, -0.4), (400.0, -700.0, 900.001))),
        GoldenState.OTHER_REGISTRATION,
        "registered to the robot anew",
    ),
    "no registration": (
        lambda path: _registered(path, None),
        GoldenState.OTHER_REGISTRATION,
        "registered to the robot anew",
    ),
    "calibration": (
        _edited("rig.json", r'"calibration_id": "', '"calibration_id": "other-'),
        GoldenState.OTHER_CALIBRATION,
        "kept with the calibration",
    ),
    "a job taught anew": (
        _edited("jobs/flange/job.toml", r"radius_mm = (\d+)", r"radius_mm = \g<1>1"),
        GoldenState.OTHER_PART,
        "another part",
    ),
    "a limit": (
        _edited("jobs/flange/job.toml", r"min_support = 0.3", "min_support = 0.35"),
        GoldenState.HELD,
        "",
    ),
    "a torn file": (
        lambda path: golden_file(path, 1).write_bytes(golden_file(path, 1).read_bytes()[:300]),
        GoldenState.DAMAGED,
        "not JSON",
    ),
}


@pytest.mark.parametrize("what", CHANGES)
def test_a_golden_part_holds_as_long_as_what_it_was_kept_with(cell: Path, what: str) -> None:
    """After each change the golden part has the expected state, and a warning gives the reason if it does not
    hold.
    """
    change, state, why = CHANGES[what]
    loaded = load_cell(cell)
    with_golden(loaded, seen(loaded))
    change(cell)
    again = load_cell(cell)
    assert state is state_of(again)
    said = [line for line in warnings_for(again.cell) if line.startswith("golden/1.json")]
    assert (1 if why else 0) == len(said)
    assert not why or (why in said[0] and state.name in said[0])


def test_a_registration_by_the_robots_own_program_ends_a_golden_part(cell: Path) -> None:
    """A registration by the robot's program ends a golden part without a reload."""
    loaded = load_cell(cell)
    kept = with_golden(loaded, seen(loaded))
    _registered(cell, make_transform((0.0, 0.0, 0.1), (1.0, 2.0, 3.0)))
    assert GoldenState.OTHER_REGISTRATION is state_of(with_registration(kept))


def test_what_cannot_be_kept_changes_nothing(cell: Path) -> None:
    """Several parts, none, other files than those in use, or a full disc are refused and change nothing."""
    loaded = load_cell(cell)
    with_golden(loaded, seen(loaded))
    place = golden_file(cell, 1)
    before = place.read_bytes()
    snapshot = seen(loaded)
    for why, bad in {
        "2 good parts": seen(loaded, parts=2),
        "no good part": replace(snapshot, targets=(), status=Status.NO_TARGET),
        "exchanged meanwhile": replace(snapshot, fingerprint="0"),
    }.items():
        with pytest.raises(UserError, match=why):
            with_golden(loaded, bad)
    assert before == place.read_bytes()
    assert 1 == load_golden(place).number
    shutil.rmtree(place.parent)
    place.parent.write_text("in the way")
    with pytest.raises(UserError, match="golden"):
        with_golden(loaded, snapshot)


def test_a_map_of_the_robots_error_is_in_force_with_its_registration(cell: Path) -> None:
    """A map of the robot's error is in each cycle's frame and the fingerprint; an older golden part gives
    no offset."""
    before = with_golden(load_cell(cell), seen(load_cell(cell)))
    assert before.setup.frame(None)[0].error_map is None
    places = np.random.default_rng(1).uniform(50, 150, (16, 3))
    rig = cell.with_name("rig.json")
    plain = load_rig(rig)
    save_rig(rig, replace(plain, robot_map=RobotMap(places, places + 0.2, 1, hull_of(places))))
    for loaded in (with_registration(before), load_cell(cell)):
        error_map = loaded.setup.frame(None)[0].error_map
        assert error_map is not None
        assert (1, 16) == (loaded.setup.map_figures.degree, loaded.setup.map_figures.points)
        shift = error_map.at(np.full(3, 100.0))
        assert shift is not None
        np.testing.assert_allclose(shift.shift_mm, 0.2, atol=1e-9)
        assert before.setup.fingerprint != loaded.setup.fingerprint
        golden = loaded.setup.jobs[1].golden
        assert golden is not None
        assert GoldenState.OTHER_REGISTRATION is golden.state
    (found,) = look_at_map(read_cell(cell), is_used=True)
    assert "a map of degree 1 by 16 points" in found.finding
    assert (CheckResult.WARN, "OUT_OF_MAP there") == (found.verdict, found.consequence), (
        "the part lies elsewhere"
    )
    at = replace(plain, robot_map=None).robot_from_rig @ load_cell(cell).cell.jobs[0].rig_from_part
    around = at[:3, 3] + places - 100.0
    save_rig(rig, replace(plain, robot_map=RobotMap(around, around + 0.2, 1, hull_of(around))))
    for is_used, verdict in ((True, CheckResult.OK), (False, CheckResult.WARN)):
        (found,) = look_at_map(read_cell(cell), is_used=is_used)
        assert verdict is found.verdict
    save_rig(rig, plain)
    assert [] == list(look_at_map(read_cell(cell), is_used=True))
    assert with_registration(load_cell(cell)).setup.frame(None)[0].error_map is None
