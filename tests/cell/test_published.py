"""Published events do not change afterwards, whatever is measured next."""

from __future__ import annotations

import asyncio
import functools
import pickle
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from helpers.cells import flange, frame_pair, pictures, pose, scene
from helpers.scriptedhead import Ear, Head, running
from helpers.snapshots import make_snapshot, make_transform
from helpers.waiting import until
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.cell.cycle import Cycle
from edged.cell.loaded import LoadedJob, Setup
from edged.domain.events import Event, Snapshot
from edged.domain.frames import FramePair
from edged.domain.measurement import Outcome
from edged.errors import FrameTimeout
from edged.pipeline import PreparedRig, locate, prepare
from edged.vision.part.job import Job
from edged.vision.teaching.pair import teach

PICTURES = ("straight", "turned", "tilted", "empty", "unplugged")


@functools.cache
def taught() -> tuple[PreparedRig, Job]:
    """The flange's job and its rig."""
    cell = flange()
    rig = prepare(cell.rig)
    return rig, teach(cell.left, cell.right, rig.rectification, cell.region, "flange")


@functools.cache
def exposure(picture: str) -> FramePair:
    """A pair for this kind of picture; always the same arrays."""
    cell = flange()
    if picture == "empty":
        return frame_pair(*pictures(cell.rig, scene()))
    where = {"straight": pose(), "turned": pose(turn_deg=70.0), "tilted": pose(tilt_deg=8.0)}[picture]
    return frame_pair(*pictures(cell.rig, scene((cell.part, where))))


class _Recalling(Ear):
    """Records each event, and its serialised bytes when it was announced."""

    def __init__(self) -> None:
        super().__init__()
        self.bits: list[bytes] = []

    def announce(self, event: Event) -> None:
        super().announce(event)
        self.bits.append(bits_of(event))


def bits_of(event: Event) -> bytes:
    """All of an event, except the lazily computed nearest match."""
    return pickle.dumps(replace(event, nearest=None) if isinstance(event, Snapshot) else event)


class _Pictures(Head):
    """Shows the pictures in turn, then repeats the last one."""

    def __init__(self, shown: list[str]) -> None:
        super().__init__()
        self._shown = shown

    async def capture(self) -> FramePair:
        picture = self._shown[min(self.captures, len(self._shown) - 1)]
        self.captures += 1
        if picture == "unplugged":
            raise FrameTimeout("left", "unplugged")
        return exposure(picture)


def published(shown: list[str]) -> _Recalling:
    """Events that a free-running cell with the whole pipeline announces for these pictures."""
    rig, job = taught()

    def locate_job(pair: FramePair, lap: Callable[[str], None]) -> Outcome:
        return locate(pair, job, rig, lap)

    setup = Setup(
        jobs={1: LoadedJob("flange", 1, locate_job)},
        active_job=1,
        period_s=0.0,
        calibration_id="cal",
        fingerprint="f00d",
        simulated=True,
        robot_from_rig=make_transform((0.1, 0.2, 0.3), (400.0, 0.0, 300.0)),
        registration_covariance=1e-6 * np.eye(6),
    )
    ear = _Recalling()

    async def main() -> None:
        async with running(Cycle(_Pictures(shown), setup), ear):
            await until(lambda: len(ear.snapshots()) >= len(shown))

    asyncio.run(main())
    return ear


@pytest.mark.long
@settings(max_examples=4)
@given(shown=st.lists(st.sampled_from(PICTURES), min_size=2, max_size=5))
def test_later_cycles_leave_what_was_published_as_it_was(shown: list[str]) -> None:
    """Results, images and states are bit-identical after further cycles."""
    ear = published(shown)

    assert ear.bits == [bits_of(event) for event in ear.events]


@pytest.mark.slow
def test_no_array_of_a_snapshot_can_be_written() -> None:
    """Every array of a snapshot is read-only."""
    (snapshot, *_) = published(["straight"]).snapshots()
    (target,) = snapshot.targets
    arrays = [target.rig_from_part, target.covariance, target.circles[0].centre_mm, target.position_mm]

    for array in (*arrays, snapshot.robot_from_rig, snapshot.registration_covariance):
        assert array is not None
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def test_features_of_every_kind_are_sealed() -> None:
    """Arrays of circles, edges, slots and corners are read-only."""
    snapshot: Snapshot = make_snapshot()
    (target,) = snapshot.targets

    parts = (*target.circles, *target.edges, *target.slots, *target.corners)
    assert 4 == len(parts)
    assert not any(part.covariance.flags.writeable for part in parts)
