"""A new job or rig compared with the active one on recorded cycles: what gets worse is found."""

from __future__ import annotations

import math
import re
import shutil
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
from helpers.recordedcell import exposures, record
from helpers.smallcell import SmallCell
from hypothesis import given
from hypothesis import strategies as st

from edged.domain.arrays import FloatArray
from edged.domain.frames import FramePair
from edged.files import recording
from edged.files.jobs import save_job
from edged.files.rig import rig_text
from edged.setup.cellfiles import CellFiles, read_cell
from edged.setup.recordings import comparing
from edged.setup.recordings.comparing import (
    APART_SIGMAS,
    CycleComparison,
    Found,
    GoodPart,
    TriedCycle,
    compare,
    motion_of,
    try_on,
)
from edged.setup.recordings.regression import compare as differences
from edged.setup.recordings.setups import Contents, affected_jobs, digest_of, measured_by, successors
from edged.setup.releases.jobsfolder import renamed
from edged.vision.geometry.rigid import apply, rotation_matrix, transform

CYCLES = 7


class Cell(NamedTuple):
    """A cell with recordings, all of them good."""

    folder: Path
    config: Path
    files: CellFiles


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    """Recordings of the part in seven places."""
    folder = tmp_path_factory.mktemp("regression")
    small = SmallCell(folder / "cell", source="virtual-inprocess")
    files = read_cell(small.config)
    record(folder / "recordings", files, exposures(small.virtual, CYCLES))
    return Cell(folder / "recordings", small.config, files)


def tried(
    cell: Cell, candidate: Contents, *, of_rig: bool, active: Contents | None = None
) -> CycleComparison:
    """The comparison, as the worker makes it."""
    before, after = (
        measured_by(active or cell.files.contents, Path("active")),
        measured_by(candidate, Path("new")).in_place_of(successors(active or cell.files.contents, candidate)),
    )
    entries = recording.entries(cell.folder)
    return compare([try_on(one, before, after) for one in entries], of_rig=of_rig)


TEXT, SHAPE = "jobs/flange/job.toml", "jobs/flange/shape.npz"


def called(contents: Contents, name: str, number: int, **limits: float) -> Contents:
    """The files with their job renamed, renumbered, and with other limits."""
    text = renamed({"job.toml": contents[TEXT]}, name=name, number=number)["job.toml"].decode()
    for limit, value in limits.items():
        text = re.sub(rf"^{limit} = \S+", f"{limit} = {value}", text, flags=re.MULTILINE)
    others = {key: data for key, data in contents.items() if key not in {TEXT, SHAPE}}
    return {**others, f"jobs/{name}/job.toml": text.encode(), f"jobs/{name}/shape.npz": contents[SHAPE]}


def with_job(cell: Cell, tmp_path: Path, **changes: Any) -> Contents:
    """The cell's files with its job changed, as a page would write it."""
    folder = tmp_path / "flange"
    shutil.copytree(cell.config.parent / "jobs" / "flange", folder)
    save_job(folder, replace(cell.files.jobs[0], **changes))
    changed = {f"jobs/flange/{one}": (folder / one).read_bytes() for one in ("job.toml", "shape.npz")}
    return {**cell.files.contents, **changed}


@pytest.mark.long
def test_the_same_job_and_rig_give_the_same_bits(cell: Cell) -> None:
    """Measured again with the same job and rig, nothing differs, is lost or moves."""
    retold = {**cell.files.contents, "rig.json": cell.files.contents["rig.json"] + b"\n"}
    for active in (cell.files.contents, retold):
        result = tried(cell, cell.files.contents, of_rig=True, active=active)
        assert CYCLES == len(result.compared)
        for one in result.compared:
            assert (True, True, 0) == (one.was_good, one.is_good, one.lost)
            assert one.apart is not None
            assert 0.0 == one.apart.sigmas == np.abs(one.apart.by_mm).max()
        assert result.motion is not None
        assert 0.0 == np.abs(result.motion.shift_mm).max() == np.abs(result.motion.turn_rad).max()
    assert digest_of(cell.files.contents) != digest_of(retold)


@pytest.mark.slow
def test_a_job_of_another_name_and_number_has_the_same_cycles(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Earlier results are reused, and only the new job is measured. A renumbered job is matched by its
    name, a renamed one by its number.
    """
    measured = []
    counted = comparing.inspect
    monkeypatch.setattr(comparing, "inspect", lambda *args: measured.append(args) or counted(*args))
    contents = cell.files.contents
    for name, number in (("flange", 9), ("cover", 1)):
        active = called(contents, name, number)
        strict = called(contents, name, number, max_rms_px=1e-6)
        assert {number} == affected_jobs(active, strict)
        measured.clear()
        result = tried(cell, strict, of_rig=False, active=active)
        assert (CYCLES, CYCLES) == (len(measured), len(result.compared))
        assert all(one.was_good and not one.is_good for one in result.compared)


def test_what_changes_no_measurement_concerns_no_cycle(cell: Cell) -> None:
    """Name, number, remarks, copies and retiring concern no cycle; a byte of the shape or a limit does."""
    contents = cell.files.contents
    copied = {**contents, **called(contents, "cover", 2)}
    for active, candidate in (
        (contents, called(contents, "cover", 1)),
        (contents, called(contents, "flange", 9)),
        (contents, called(contents, "cover", 9)),
        (contents, copied),
        (copied, contents),
        (copied, called(contents, "cover", 2)),
    ):
        assert set() == affected_jobs(active, candidate)
    assert {1: 9} == successors(contents, called(contents, "cover", 9))
    assert {2: 2} == successors(copied, called(contents, "cover", 2))
    remarked = {**contents, TEXT: contents[TEXT] + b"# Anna's own words\n"}
    assert set() == affected_jobs(contents, remarked)
    assert digest_of(contents) == digest_of(remarked) == digest_of(called(contents, "cover", 9))

    shape = bytearray(contents[SHAPE])
    shape[len(shape) // 2] ^= 1
    for changed in ({**contents, SHAPE: bytes(shape)}, called(contents, "flange", 1, max_rms_px=0.4)):
        assert digest_of(contents) != digest_of(changed)
        assert {1} == affected_jobs(contents, changed)
        # the copy is unchanged: what it measures is not affected
        assert {1} == affected_jobs(copied, {**copied, **changed})
    # a replacement under another name and number is not exempt by either alone
    for name, number in (("cover", 1), ("flange", 9)):
        assert {1} == affected_jobs(contents, called(contents, name, number, max_rms_px=0.4))
    assert {1: 9} == successors(contents, called(contents, "flange", 9, max_rms_px=0.4))


@pytest.mark.slow
def test_a_feature_that_was_moved_is_caught(cell: Cell, tmp_path: Path) -> None:
    """With a circle taught two millimetres too large every good cycle becomes bad."""
    circle = cell.files.jobs[0].circles[0]
    wrong = replace(circle, radius_mm=circle.radius_mm + 2.0)
    result = tried(cell, with_job(cell, tmp_path, circles=(wrong,)), of_rig=False)
    assert CYCLES == sum(one.was_good and not one.is_good for one in result.compared)


def test_places_that_move_are_told_in_both_sigmas(cell: Cell, tmp_path: Path) -> None:
    """A reference point moved by a tenth of a millimetre is reported in both sigmas, while cycles stay
    good."""
    job = cell.files.jobs[0]
    moved = transform(np.eye(3), np.array([0.1, 0.0, 0.0]))
    circle = replace(job.circles[0], centre_mm=job.circles[0].centre_mm)
    changed = with_job(cell, tmp_path, circles=(circle,), part_from_model=moved, report="model")
    result = tried(cell, changed, of_rig=False)
    for one in result.compared:
        assert one.apart is not None
        assert 0.1 == pytest.approx(float(np.linalg.norm(one.apart.by_mm)), rel=1e-6)
        assert one.is_apart == (one.apart.sigmas >= APART_SIGMAS)
    assert any(one.is_apart for one in result.compared)


@pytest.mark.slow
def test_the_common_motion_of_a_new_rig_is_told_apart(cell: Cell) -> None:
    """The common turn from a moved principal point is reported once, leaving at most a tenth. A wrong
    baseline is no motion and is left entirely.
    """
    rig = cell.files.rig
    turn = transform(rotation_matrix(np.array([0.0, 0.002, 0.0])), np.zeros(3))
    # the left camera is the rig's frame: another principal point turns all that it sees
    turned = replace(rig, left=replace(rig.left, cx=rig.left.cx + 0.002 * rig.left.fx))
    turned = replace(turned, right_from_left=rig.right_from_left @ turn, calibration_id="turned")
    result = tried(cell, {**cell.files.contents, "rig.json": rig_text(turned)}, of_rig=True)
    assert result.motion is not None
    told = [one.apart for one in result.compared if one.apart is not None]
    assert CYCLES == len(told)
    (moved,) = np.linalg.norm(result.motion.of(np.array([[10.0, 0.0, 205.0]])), axis=1)
    assert moved > 0.3  # 0.002 rad at 205 mm
    assert max(float(np.linalg.norm(one.by_mm)) for one in told) < 0.1 * moved

    relation = rig.right_from_left.copy()
    relation[:3, 3] *= 1.02
    wide = replace(rig, right_from_left=relation, calibration_id="wide")
    result = tried(cell, {**cell.files.contents, "rig.json": rig_text(wide)}, of_rig=True)
    assert CYCLES == sum(one.was_good and not one.is_good for one in result.compared)


def test_what_cannot_be_tried_says_why(cell: Cell, tmp_path: Path) -> None:
    """Damaged recordings, ones without pictures and unknown jobs are skipped with a reason."""
    folder = tmp_path / "recordings"
    shutil.copytree(cell.folder, folder)
    entries = recording.entries(folder)
    entries[0].path.write_bytes(b"damaged")
    record(folder, cell.files, [None])
    setup = measured_by(cell.files.contents, Path("active"))
    without = replace(setup, jobs={})
    entries = recording.entries(folder)
    both = [try_on(one, setup, setup) for one in entries]
    assert ["damaged", *[""] * (CYCLES - 1), "no_pictures"] == [one.skipped for one in both]
    assert ["no_job"] * (CYCLES - 1) == [try_on(one, setup, without).skipped for one in entries[1:CYCLES]]


# --- comparison only --------------------------------------------------------------------------


def place(x: float, y: float = 0.0, z: float = 200.0, sigma: float = 0.01) -> GoodPart:
    """A part that is not turned."""
    return GoodPart(np.array([x, y, z]), np.eye(3), np.diag([sigma**2] * 3 + [1e-6] * 3), None)


def cycle(number: int, before: Sequence[GoodPart], after: Sequence[GoodPart]) -> TriedCycle:
    """A cycle that is good where there is a part."""

    def found(places: Sequence[GoodPart]) -> Found:
        return Found("OK" if places else "NO_TARGET", () if places else ("NOT_FOUND",), tuple(places))

    return TriedCycle(number, "", "flange", before=found(before), after=found(after))


def test_parts_are_compared_with_themselves() -> None:
    """Parts are matched with the nearest one, each once, in any order; a missing one is lost."""
    result = compare([cycle(1, [place(0), place(50)], [place(50.01), place(0)])], of_rig=False)
    (one,) = result.compared
    assert one.apart is not None
    assert 1 / math.sqrt(2) == pytest.approx(one.apart.sigmas, rel=1e-6)
    assert (0, False) == (one.lost, one.is_apart)
    (one,) = compare([cycle(1, [place(0), place(50)], [place(0)])], of_rig=False).compared
    assert (1, True) == (one.lost, one.is_apart)


def test_a_turn_counts_but_about_the_free_axis() -> None:
    """A rotation counts in its own sigmas, except about a round part's axis."""
    first = place(0)
    turned = replace(first, rotation=rotation_matrix(np.array([0.0, 0.0, 0.02])))
    (one,) = compare([cycle(1, [first], [turned])], of_rig=False).compared
    assert one.apart is not None
    assert 0.02 / math.sqrt(2e-6) == pytest.approx(one.apart.sigmas, rel=1e-4)
    assert math.degrees(0.02) == pytest.approx(one.apart.turned_deg, rel=1e-4)
    round_one = replace(first, free_axis=np.array([0.0, 0.0, 1.0]))
    (one,) = compare([cycle(1, [round_one], [turned])], of_rig=False).compared
    assert one.apart is not None
    assert 0.0 == pytest.approx(one.apart.sigmas, abs=1e-9)


MILLIMETRES = st.floats(-1.0, 1.0)


@given(
    shift=st.tuples(MILLIMETRES, MILLIMETRES, MILLIMETRES),
    turn=st.tuples(*[st.floats(-0.003, 0.003)] * 3),
    outlier=st.floats(2.0, 40.0),
)
def test_a_shared_motion_is_found_whatever_single_points_do(
    shift: tuple[float, float, float], turn: tuple[float, float, float], outlier: float
) -> None:
    """The motion of the majority is found to a few µm, with one point in nine elsewhere."""
    grid = np.array([[x, y, 200.0 + 0.1 * x * y] for x in (-30.0, 0.0, 30.0) for y in (-20.0, 0.0, 20.0)])
    moved: FloatArray = apply(transform(rotation_matrix(np.array(turn)), np.array(shift)), grid)
    wrong = moved.copy()
    wrong[4] += outlier
    motion = motion_of(grid, wrong)
    assert motion is not None
    off = np.linalg.norm(motion.of(grid) - (moved - grid), axis=1)
    assert off.max() < 0.01  # second order of the turn: 0.003² of 200 mm, two µm


def test_few_places_tell_no_motion() -> None:
    """Two places give no motion, three a shift, and places at one spot no rotation."""
    grid = np.array([[0.0, 0.0, 200.0], [40.0, 0.0, 200.0], [0.0, 40.0, 200.0]])
    assert None is motion_of(grid[:2], grid[:2] + 1.0)
    motion = motion_of(grid, grid + np.array([1.0, 2.0, 3.0]))
    assert motion is not None
    assert [1.0, 2.0, 3.0] == pytest.approx(motion.shift_mm.tolist())
    assert [0.0, 0.0, 0.0] == motion.turn_rad.tolist()
    spot = np.random.default_rng(1).normal(0, 0.1, (20, 3)) + np.array([0, 0, 200.0])
    motion = motion_of(spot, spot + np.random.default_rng(2).normal(0, 0.01, (20, 3)))
    assert motion is not None
    assert [0.0, 0.0, 0.0] == motion.turn_rad.tolist()


def test_pictures_of_other_cameras_are_no_bug(cell: Cell, tmp_path: Path) -> None:
    """A pair that does not fit the rig is skipped as damaged."""
    folder = tmp_path / "recordings"
    entry = recording.entries(cell.folder)[0]
    taken = recording.load(entry.path)
    assert taken.pair is not None
    small = FramePair(
        *(replace(one, image=one.image[:100].copy()) for one in (taken.pair.left, taken.pair.right))
    )
    record(folder, cell.files, [None])
    data = recording.entries(folder)[0].path
    shutil.copy(entry.path, data)
    setup = measured_by(cell.files.contents, Path("active"))
    with zipfile.ZipFile(data) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(data, "w") as archive:
        for name, content in members.items():
            picture = content
            if name.endswith(".png"):
                picture = cv2.imencode(".png", small.left.image)[1].tobytes()
            archive.writestr(name, picture)
    assert "damaged" == try_on(recording.entries(folder)[0], setup, setup).skipped


def test_an_offset_is_not_measured_again() -> None:
    """Offsets are ignored, as they depend on a golden part that no recording has."""
    part = {"score": 0.9, "position_mm": [1.0, 2.0, 3.0]}
    assert [] == [*differences("targets", [{**part, "offset": {"position_mm": [0.1, 0.0, 0.0]}}], [part])]
    assert ["targets[0].score: 0.9 -> 0.8 (-0.1)"] == [
        *differences("targets", [{**part, "offset": None}], [{**part, "score": 0.8}])
    ]
