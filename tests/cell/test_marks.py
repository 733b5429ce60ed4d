"""Reference marks in a running cell: corrections, knocks, recordings, replay, and cells without marks."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.markedcell import DEMO_MARKS, STILL, marked_cell, pair_at, prepared, teach
from helpers.schema_check import load_schema, violations
from helpers.scriptedhead import Ear, Head, locate_command, running
from helpers.waiting import until
from rich.console import Console

from edged import payload
from edged.adapters.modbus import ModbusSettings
from edged.adapters.modbus.cell import CellRegisters
from edged.app.cell import LoadedCell, load_cell
from edged.cell.cycle import Cycle
from edged.cell.twoexposures import MOST_MOVED_PX
from edged.commands.replay import replay
from edged.domain.arrays import SIDES
from edged.domain.cell import CellPhase
from edged.domain.events import Basis, Snapshot
from edged.domain.frames import FramePair
from edged.domain.marks import MarksState
from edged.domain.measurement import Reject, Status
from edged.files import recording
from edged.files.marks import marks_file
from edged.payload import snapshot_to_json
from edged.pictures.twoexposures import merge_exposures
from edged.pipeline import locate, prepare
from edged.plc import registers as reg
from edged.sim.cell import VirtualCell, demo_part, demo_rig, inside
from edged.sim.weather import Knock, Schedule, Weather

COLD = Schedule(((0.0, 0.0), (1e-9, -8.0)))
"""Eight kelvin colder at once; the cameras follow within the hour."""


class Reel(Head):
    """A head that gives these pairs in turn."""

    def __init__(self, pairs: Sequence[FramePair]) -> None:
        super().__init__()
        self.pairs = list(pairs)

    async def capture(self) -> FramePair:
        self.captures += 1
        return self.pairs.pop(0)


def measured(loaded: LoadedCell, pairs: Sequence[FramePair], then=None) -> list[Snapshot]:
    """One LOCATE for each pair. then : called with the cycle between the pairs."""
    ear = Ear()

    async def main() -> None:
        cycle = Cycle(Reel(pairs), replace(loaded.setup, period_s=None))
        async with running(cycle, ear):
            for number in range(1, len(pairs) + 1):
                command = locate_command(number)
                cycle.submit(command)
                await until(lambda command=command: ear.answers(command))
                if then is not None:
                    wanted = then(cycle)  # fingerprint
                    await until(lambda wanted=wanted: wanted in bases(ear))

    asyncio.run(main())
    return ear.snapshots()


def bases(ear: Ear) -> set[str]:
    """Fingerprints of all announced bases."""
    return {event.fingerprint for event in ear.events if isinstance(event, Basis)}


@cache
def drifted() -> tuple[VirtualCell, tuple[FramePair, ...]]:
    """Pairs of a cell that has been cold for hours."""
    cell = marked_cell(schedule=COLD)
    pair_at(cell, 0)
    return cell, tuple(pair_at(cell, second) for second in range(20_000, 20_004))


def truth(cell: VirtualCell, snapshot: Snapshot) -> np.ndarray:
    """(3,) true place of the part's reference point, in the frame of the calibrated rig."""
    found = cell.truth(snapshot.exposed_ns)
    assert found is not None
    return found.rig_from_part[:3, 3]


@pytest.mark.long
def test_without_marks_every_digit_is_what_the_pipeline_says(tmp_path: Path) -> None:
    """Without marks results equal the pipeline's exactly and mention no marks; only a marks file changes the
    fingerprint.
    """
    files = prepared(tmp_path)
    before = load_cell(files.config)
    _, pairs = drifted()
    (snapshot,) = measured(before, pairs[:1])
    assert isinstance(before.cell.rig.calibration_id, str)
    outcome = locate(pairs[0], before.cell.jobs[0], prepare(before.cell.rig))
    assert np.array_equal(outcome.targets[0].covariance, snapshot.targets[0].covariance)
    assert np.array_equal(outcome.targets[0].rig_from_part, snapshot.targets[0].rig_from_part)
    document = snapshot_to_json(snapshot)
    assert "marks" not in document
    assert "marks" not in document["timing_ms"]
    assert (None, MarksState.NONE) == (snapshot.marks_before, snapshot.marks.state)
    teach(files)
    assert load_cell(files.config).setup.fingerprint != before.setup.fingerprint
    marks_file(files.rig).unlink()
    assert load_cell(files.config).setup.fingerprint == before.setup.fingerprint


@pytest.mark.slow
def test_a_cold_cell_measures_as_on_the_day_of_its_teaching(tmp_path: Path) -> None:
    """With marks the error is below 12 µm and 4 sigma, without them more than twice that.

    The published message fits the schema.
    """
    files = prepared(tmp_path)
    plain = load_cell(files.config)
    teach(files)
    cell, pairs = drifted()
    without = measured(plain, pairs)
    corrected = measured(load_cell(files.config), pairs)
    for first, second in zip(without, corrected, strict=True):
        assert (Status.OK, MarksState.CORRECTED, 8) == (second.status, second.marks.state, second.marks.seen)
        (target,) = second.targets
        error = target.position_mm - truth(cell, second)
        assert np.abs(error).max() < 0.012
        assert (np.abs(error) < 4 * target.sigma_mm).all()
        if first.status is Status.OK:
            assert np.abs(first.targets[0].position_mm - truth(cell, first)).max() > 2 * np.abs(error).max()
        message = payload.message("target", "cell", 1, snapshot_to_json(second), 1)
        assert "CORRECTED" == message["marks"]["state"]
        schema = load_schema()
        assert [] == violations(json.loads(json.dumps(message)), schema["$defs"]["target_message"], schema)
        assert second.timing_ms["marks"] > 0


@pytest.mark.long
def test_a_knocked_cell_gives_no_result_until_its_marks_agree_and_replays_to_the_bit(tmp_path: Path) -> None:
    """After a knock three results are refused, then they are within 4 sigma.

    A replay is bit-identical, and an edited recording is detected.
    """
    files = prepared(tmp_path / "cell")
    teach(files)
    loaded = load_cell(files.config)
    cell = marked_cell(Knock(3.0, "left", (0.15, -0.1, 0.0), (0.0, 5e-4, 0.0)))
    pairs = [pair_at(cell, second) for second in range(8)]
    snapshots = measured(loaded, pairs)
    states = [(snapshot.marks.state.name, snapshot.status) for snapshot in snapshots]
    assert [("CORRECTED", Status.OK)] * 3 == states[:3]
    assert [("KNOCKED", Status.LOW_QUALITY)] * 3 == states[3:6]
    assert [("CORRECTED", Status.OK)] * 2 == states[6:]
    assert all(Reject.CALIBRATION in snapshot.targets[0].reject for snapshot in snapshots[3:6])
    for snapshot in snapshots[6:]:
        error = snapshot.targets[0].position_mm - truth(cell, snapshot)
        assert (np.abs(error) < 4 * snapshot.targets[0].sigma_mm).all()
    folder = tmp_path / "recordings"
    recording.save_setup(folder, loaded.setup.fingerprint, loaded.cell.contents)
    for index, (snapshot, pair) in enumerate(zip(snapshots, pairs, strict=True)):
        recording.save(folder, index, datetime(2026, 1, 1, tzinfo=UTC), snapshot, pair)
    console = Console(quiet=True)
    assert 0 == replay(folder, False, console)
    file = recording.entries(folder)[4].path
    taken = recording.load(file)
    assert taken.marks_before is not None
    assert np.array_equal(taken.marks_before.covariance, snapshots[4].marks_before.covariance)
    moved = replace(snapshots[4], marks_before=snapshots[1].marks_before)
    recording.save(folder, 9, datetime(2026, 1, 1, tzinfo=UTC), moved, pairs[4])
    assert 1 == replay(folder, False, console)


@pytest.mark.slow
def test_a_reload_goes_on_with_the_same_marks_and_begins_anew_with_others(tmp_path: Path) -> None:
    """A reload with the same marks keeps their state, and one with other settings starts anew."""
    files = prepared(tmp_path)
    teach(files)
    loaded, again = load_cell(files.config), load_cell(files.config)
    files.config.write_text(files.config.read_text() + "\n[marks]\nrange_k = 5\n")
    other = load_cell(files.config)
    _, pairs = drifted()
    setups = [again, other, other]

    def then(cycle: Cycle) -> str:
        setup = setups.pop(0).setup
        cycle.exchange(replace(setup, period_s=None))
        return setup.fingerprint

    snapshots = measured(loaded, pairs[:3], then)
    known = [float(np.trace(snapshot.marks_before.covariance)) for snapshot in snapshots]
    assert known[1] < 0.5 * known[0]
    assert known[2] > 0.2 * known[0]


@pytest.mark.long
def test_the_registers_say_what_the_marks_say(tmp_path: Path) -> None:
    """Registers hold the state, the marks and the cameras' displacement; a knock has a state of its own."""
    files = prepared(tmp_path)
    teach(files)
    cell = marked_cell(Knock(1.0, "right", (0.2, 0.0, 0.0)))
    snapshots = measured(load_cell(files.config), [pair_at(cell, second) for second in range(2)])
    shown = reg.marks_values(snapshots[0].marks)
    assert (1, 1, 8, 8, 0, 65535) == tuple(
        int(shown[name])
        for name in ("M_STATE", "M_VALID", "M_SEEN", "M_TAUGHT", "M_EXCLUDED", "M_FIRST_EXCLUDED")
    )
    knocked = reg.marks_values(snapshots[1].marks)
    assert (3, 0) == (knocked["M_STATE"], knocked["M_VALID"])
    assert 1000 < knocked["M_RIGHT"] < 4000
    modbus = CellRegisters(ModbusSettings(), None, time.monotonic)
    assert [0, 1] == list(modbus.read(reg.REFERENCE_MARKS.address, 2))
    modbus.take(snapshots[1])
    assert [3, 0] == list(modbus.read(reg.REFERENCE_MARKS.address, 2))


@pytest.mark.slow
def test_marks_of_another_calibration_correct_nothing_and_say_so(tmp_path: Path) -> None:
    """Marks of another calibration correct nothing, and the results stay valid."""
    files = prepared(tmp_path)
    teach(files)
    document = json.loads(marks_file(files.rig).read_bytes())
    marks_file(files.rig).write_text(json.dumps({**document, "calibration_id": "older"}))
    loaded = load_cell(files.config)
    (snapshot,) = measured(loaded, drifted()[1][:1])
    assert (MarksState.OTHER_CALIBRATION, None) == (snapshot.marks.state, snapshot.marks_before)
    assert snapshot.marks.valid


@pytest.mark.long
@pytest.mark.parametrize("knocked", ["heal", "refuse"])
def test_a_knock_in_setup_is_found_by_the_first_exposure_after_it(tmp_path: Path, knocked: str) -> None:
    """Captures in SETUP do not affect the track; results return after three agreeing exposures, or never."""
    files = prepared(tmp_path, f'\n[marks]\non_knock = "{knocked}"\n')
    teach(files)
    cell = marked_cell(Knock(50.0, "left", (0.2, 0.0, 0.0)))
    seconds = (0, 60, 61, 62, 63, 64, 65, 66)
    pairs, ear = [pair_at(cell, second) for second in seconds], Ear()
    setup = replace(load_cell(files.config).setup, period_s=None)

    async def main() -> None:
        cycle = Cycle(Reel(pairs), setup)
        async with running(cycle, ear):

            async def located(number: int) -> None:
                command = locate_command(number)
                cycle.submit(command)
                await until(lambda: ear.answers(command))

            await located(1)
            token = await cycle.session.enter_setup("Anna")
            await cycle.session.capture(token)
            await cycle.session.leave_setup(token)
            await until(lambda: ear.state() is CellPhase.READY)
            for number in range(2, 7):
                await located(number)

    asyncio.run(main())
    states = [(snapshot.marks.state, snapshot.status is Status.OK) for snapshot in ear.snapshots()]
    assert states[0] == (MarksState.CORRECTED, True)
    assert states[1:4] == [(MarksState.KNOCKED, False)] * 3
    after = (MarksState.CORRECTED, True) if knocked == "heal" else (MarksState.KNOCKED, False)
    assert states[4:] == [after] * 2


@pytest.mark.slow
@pytest.mark.parametrize("hit", ["left", "right", "rig"])
def test_a_knock_between_two_exposures_of_one_cycle_is_no_picture(hit: str) -> None:
    """A knock between the two exposures counts as motion beyond the limit; without one there is none."""
    rig = demo_rig()
    lies = replace(inside(DEMO_MARKS), shift_mm=(0.0, 0.0), depth_mm=0.0, tilt_rad=0.0, turn_rad=0.0)
    weather = Weather(rig, STILL, (Knock(1.5, hit, (0.2, 0.0, 0.0)),), 3)
    cell = VirtualCell(rig, demo_part(), seed=3, marks=DEMO_MARKS, weather=weather, motion=lies)
    pair_at(cell, 0)
    long, short = pair_at(cell, 1), pair_at(cell, 2)
    merged = [
        merge_exposures(long.side(side).image, np.round(short.side(side).image / 4.0).astype(np.uint8), 4.0)
        for side in SIDES
    ]
    assert max(picture.moved_px for picture in merged) > MOST_MOVED_PX
    still = pair_at(cell, 3)
    again = merge_exposures(short.left.image, np.round(still.left.image / 4.0).astype(np.uint8), 4.0)
    assert again.moved_px < MOST_MOVED_PX
