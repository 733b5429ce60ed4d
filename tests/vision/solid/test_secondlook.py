"""A part that a first look does not find, or not without doubt, is looked for between its views."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from helpers.drawnparts import DEPTH_MM, from_file, images_of, place, rig

from edged.domain.arrays import F32, FloatArray
from edged.domain.measurement import Reject
from edged.vision.geometry.camera import StereoRig
from edged.vision.part.job import Job
from edged.vision.solid import locate, modes
from edged.vision.solid.edgemodel import EdgeModel
from edged.vision.solid.jobmodels import wanted_of
from edged.vision.solid.lock import LockedPose, Pyramids
from edged.vision.solid.modes import PartPlace, SearchedPart, find_places, pyramids_of
from edged.vision.solid.scan import view_set
from edged.vision.solid.visible import moved
from edged.vision.solid.weighing import weighed

DESIGN = 3


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    """The job of a drawn part, taught from its file alone."""
    return from_file(tmp_path_factory.mktemp("file"), DESIGN)


def turned(laid: LockedPose, x_deg: float = 0.0, z_deg: float = 0.0) -> FloatArray:
    """The pose of a part turned about its own axes, at its middle."""
    return moved(laid.model, laid.pose, np.radians([x_deg, 0.0, z_deg, 0.0, 0.0, 0.0]))


def test_the_second_look_has_the_views_between_those_of_the_first(job: Job) -> None:
    """No view of one look is one of the other's, and both lean about as far."""
    (model,) = wanted_of(job).models[:1]
    lean = math.radians(45.0)
    first, second = (
        view_set(model, rig().rig.left, 2, lean, DEPTH_MM, between).rotations for between in (False, True)
    )
    traces = np.einsum("aij,bij->ab", first, second)
    assert math.acos(0.5 * (traces.max() - 1.0)) > math.radians(3.0)
    assert np.arccos(second[:, 2, 2]).max() > lean - math.radians(8.0)


@pytest.mark.slow
def test_the_second_look_compares_at_twice_the_size(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    """Edges of thin parts that run into each other in the smallest pictures are apart in the next ones."""
    wanted = wanted_of(job)
    pyramids = pyramids_of(images_of(DESIGN, 5, 25.0), wanted)
    smallest: list[int] = []

    def no_starts(
        _: EdgeModel, __: StereoRig, pictures: Sequence[Sequence[F32]], *___: object
    ) -> list[FloatArray]:
        smallest.append(pictures[-1][0].shape[1])
        return []

    monkeypatch.setattr(modes, "starts_of", no_starts)
    for before in (None, []):
        find_places(wanted, pyramids, before)
    assert smallest[1] == pytest.approx(2 * smallest[0], abs=1)


@pytest.mark.long
@pytest.mark.parametrize("missed", ["nothing", "leaning"])
def test_a_part_missed_at_first_is_found(job: Job, missed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a first look gives no pose, or only a wrong one, the second one finds the part."""
    images = images_of(DESIGN, 5, 25.0)
    asked: list[Sequence[PartPlace] | None] = []

    def found(
        wanted: SearchedPart, pyramids: Pyramids, before: Sequence[PartPlace] | None = None
    ) -> list[PartPlace]:
        asked.append(before)
        if before is not None:
            return find_places(wanted, pyramids, before)
        if missed == "nothing":
            return []
        right = find_places(wanted, pyramids)[0].best
        wrong = turned(right, x_deg=12.0)
        return [PartPlace((LockedPose(right.model, wrong, 0.4 * right.agreeing),))]

    monkeypatch.setattr(locate, "find_places", found)
    (part,), _, _ = locate.locate_solid(images, job)
    assert part.target.reject is Reject.NONE
    assert len(asked) == 2
    assert asked[0] is None
    assert part.target.rig_from_model is not None
    assert np.linalg.norm(part.target.rig_from_model[:3, 3] - place(25.0)[:3, 3]) < 0.1


@pytest.mark.long
def test_only_a_pose_that_both_pictures_show_is_a_rival(job: Job) -> None:
    """A part is not in doubt by a pose that chance explains better; but by one that is taken for likely."""
    images = images_of(DESIGN, 5, 25.0)
    wanted = wanted_of(job)
    pyramids = pyramids_of(images, wanted)
    right = find_places(wanted, pyramids)[0].best
    wrong = turned(right, z_deg=60.0)
    of_chance = LockedPose(right.model, wrong, 0.7 * right.agreeing)
    found = weighed(pyramids, PartPlace((right, of_chance)), lambda _: ())
    assert found.certain > 0
    assert found.margin == math.inf
    near = turned(right, z_deg=3.5)
    rival = LockedPose(right.model, near, 0.9 * right.agreeing)
    itself = weighed(pyramids, PartPlace((rival,)), lambda _: ())
    again = weighed(pyramids, PartPlace((right, rival)), lambda _: ())
    assert (again.margin < math.inf) == (itself.certain > 0)
