"""A registration pose by pose: any robot data get a verdict, and only true ones are good."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.rigs import make_rig
from helpers.snapshots import make_target, make_transform
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.domain.arrays import FloatArray
from edged.domain.measurement import Outcome, Reject, Status
from edged.domain.registration import Method, Obstacle
from edged.robot.orientations import Convention, rotation_of
from edged.setup.registration.sampling import RegistrationSampling
from edged.vision.boards.board import parse_boards
from edged.vision.geometry.rigid import apply, invert, rotation_matrix, transform

(BOARD,) = parse_boards("chessboard:9x6:4.0")
ROBOT_FROM_RIG = make_transform((2.9, 0.3, -0.2), (420.0, -60.0, 510.0))
FLANGE_FROM_BOARD = make_transform((0.2, 0.1, -0.5), (12.0, 5.0, 80.0))
NOTHING = (Obstacle.TOO_FEW, Obstacle.TURN_MORE, Obstacle.NOT_GOOD, Obstacle.OTHER_READING)


def sampling(method: Method = Method.HAND_EYE) -> RegistrationSampling:
    """Sampling for fixed cameras."""
    return RegistrationSampling(make_rig(), method, "eye-to-hand", BOARD, 0.1)


def boards(number: int, seed: int = 1) -> list[FloatArray]:
    """rig_from_board, turned in every direction."""
    random = np.random.default_rng(seed)
    return [
        transform(
            rotation_matrix(random.uniform(-0.4, 0.4, 3)), random.uniform((-20, -20, 200), (20, 20, 240))
        )
        for _ in range(number)
    ]


WORD = st.one_of(
    st.sampled_from([0, 1, -1, 2**31 - 1, -(2**31), 90_000, 180_000]), st.integers(-(2**31), 2**31 - 1)
)


@pytest.mark.long
@given(st.lists(st.tuples(*[WORD] * 6), min_size=6, max_size=9), st.sampled_from(Convention))
@settings(max_examples=20, derandomize=True)
def test_whatever_the_flange_says_has_a_verdict(words: list[tuple[int, ...]], convention: Convention) -> None:
    """Any FLANGE words with a well-seen board give an obstacle, no exception and no registration."""
    one = sampling()
    for numbers, view in zip(words, boards(len(words)), strict=True):
        x, y, z, *angles = (number / 1000 for number in numbers)
        one.poses.append(transform(rotation_of(convention, *angles), np.array([x, y, z])))
        one.views.append(view)
        one.shown.append(())  # without them no other reading is tried, which would be slow
    step = one.solve()
    assert step.obstacle in NOTHING
    assert step.registered is None


@given(st.lists(st.tuples(*[WORD] * 3), min_size=4, max_size=9))
@settings(max_examples=60, derandomize=True)
def test_whatever_was_touched_has_a_verdict(words: list[tuple[int, ...]]) -> None:
    """Any FLANGE words for touched points give an obstacle, and no registration."""
    one, random = sampling(Method.TOUCH), np.random.default_rng(2)
    for numbers in words:
        one.poses.append(transform(np.eye(3), np.array(numbers) / 1000))
        one.views.append(random.uniform((-40, -40, 160), (40, 40, 240)))
        one.shown.append(())
    step = one.solve()
    assert step.obstacle in NOTHING
    assert step.registered is None


@pytest.mark.parametrize("noise_mm", [0.0, 0.02])
def test_true_poses_are_good_and_their_sigma_is_that_of_the_board(noise_mm: float) -> None:
    """True poses are good, and the error at the boards' middle is consistent with the stated sigma."""
    one, random = sampling(), np.random.default_rng(3)
    for view in boards(10):
        pose = ROBOT_FROM_RIG @ view @ invert(FLANGE_FROM_BOARD)
        pose[:3, 3] += random.normal(0, noise_mm, 3)
        one.poses.append(pose)
        one.views.append(view)
        one.shown.append(())
    step = one.solve()
    assert (None, 10) == (step.obstacle, step.registration.used)
    assert step.registered is not None
    found = step.registered.rig.robot_from_rig
    middle = np.mean([view[:3, 3] for view in one.views], axis=0)
    error_mm = np.abs(apply(found, middle) - apply(ROBOT_FROM_RIG, middle))
    assert (error_mm <= 4 * np.array(step.registration.sigma[:3]) + 1e-6).all()
    assert max(step.registration.sigma[:3]) <= 2.5 * noise_mm + 1e-6  # for ten poses, by Student's t


def test_it_must_be_clear_which_part_was_touched() -> None:
    """Without a part, with a bad one, or with two, no sample is added."""
    one, tip = sampling(Method.TOUCH), np.eye(4)
    bad, good = make_target(reject=Reject.TOLERANCE), make_target()
    for targets in ((), (bad,), (good, good)):
        step = one.add_part(Outcome(Status.OK, targets), tip, ())
        assert (Obstacle.NOT_SEEN, 0) == (step.obstacle, step.registration.samples)
    assert one.add_part(Outcome(Status.OK, (good, bad)), tip, ()).obstacle is None
