"""What live pictures show: where the board is, whether it rests, and what is awaited."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.boardpairs import BOARD, RIG, drawn, pairs
from helpers.boards import board_poses, draw_board, right_pose
from helpers.rigs import make_rig

from edged.domain.arrays import FloatArray
from edged.setup.calibration.guidance import (
    ANYWHERE_S,
    FIRST_SHARE,
    IN_PLACE_S,
    Ghost,
    GhostSelector,
    first_ghosts,
    held_share,
    nearness,
    outlines_of,
    wait_reason,
)
from edged.setup.calibration.shown import (
    GAP_S,
    IN_GHOST,
    STILL_S,
    STILL_SHARE,
    Seen,
    Stillness,
    Watched,
    corners_in_space,
    diagonal_px,
    is_same,
    off_px,
    watch,
)
from edged.vision.boards.board import outline_mm, parse_board
from edged.vision.geometry.rigid import apply

POSE = board_poses(RIG, BOARD, 1, seed=3)[0]
TRUE = np.array(outlines_of(RIG, BOARD, POSE))


def watched(outlines: FloatArray = TRUE) -> Watched:
    """A look that found these outlines."""
    left, right = (Seen(outline, "", "", clipped=False) for outline in outlines)
    return Watched(left, right, (640, 480))


def ghost(outlines: FloatArray) -> Ghost:
    """A ghost at these outlines."""
    return Ghost(outlines[0], outlines[1], None, "", "")


@pytest.mark.parametrize("turned", range(4))
def test_a_board_in_space_is_where_it_was_whichever_corner_comes_first(turned: int) -> None:
    """The corners in space are right, whichever corner each picture begins with."""
    for number, pose in enumerate(board_poses(RIG, BOARD, 6, seed=3)):
        outlines = np.array(outlines_of(RIG, BOARD, pose))
        right = np.roll(outlines[1] if turned < 3 else outlines[1][::-1], turned, axis=0)
        corners = corners_in_space(RIG, np.array([outlines[0], right]))
        assert np.abs(corners - apply(pose, outline_mm(BOARD))).max() < 0.01, number


def test_what_no_order_explains_is_no_board_in_space() -> None:
    """Outlines of two different poses give no corners in space."""
    first, other = board_poses(RIG, BOARD, 2, seed=3)
    left, right = outlines_of(RIG, BOARD, first)[0], outlines_of(RIG, BOARD, other)[1]
    assert np.isnan(corners_in_space(RIG, np.array([left, right]))).all()


def test_an_outline_is_where_the_board_is() -> None:
    """In both pictures the outline is right to a pixel."""
    found = watch(*pairs(1)[0], [BOARD])

    assert found.is_seen
    assert off_px(found.outlines, TRUE) < 1.0
    assert not found.left.clipped


@pytest.mark.slow
def test_a_large_picture_is_looked_at_in_half_the_size() -> None:
    """The outlines are in pixels of the full picture."""
    rig, board = make_rig(), parse_board("chessboard:8x6:5")
    pose = board_poses(rig, board, 1, seed=3)[0]
    left = draw_board(board, rig.left, pose, noise=1.5)
    right = draw_board(board, rig.right, right_pose(rig, pose), noise=1.5)

    found = watch(left, right, [board])

    assert (1280, 960) == found.size
    assert off_px(found.outlines, np.array(outlines_of(rig, board, pose))) < 1.5


@pytest.mark.slow
def test_why_there_is_none() -> None:
    """Too dark, too bright and no board are told apart, with the detector's reason."""
    left, right = pairs(1)[0]

    for picture, expected in (
        (left // 60, "dark"),
        (np.full_like(left, 255), "bright"),
        (left * 0 + 90, "not_found"),
    ):
        found = watch(picture, right, [BOARD])
        assert expected == found.left.missing
        assert found.left.reason
        assert not found.is_seen
        assert "no_board_left" == wait_reason(found, still=True, ghost=None, others=[])


def test_glare_on_the_board_is_told() -> None:
    """Saturated whites on the board are reported."""
    left, right = pairs(1)[0]
    bright = np.clip(left.astype(np.int64) * 2, 0, 255).astype(np.uint8)

    found = watch(bright, right, [BOARD])

    assert (True, False) == (found.left.clipped, found.right.clipped)


@pytest.mark.slow
def test_without_a_board_it_is_recognised() -> None:
    """Kind and size are recognised, in units of its pitch, and the board is found at once."""
    found = watch(*pairs(1)[0], [])

    assert "chessboard:8x6:1" == str(found.recognised)
    assert found.is_seen


def test_still_is_what_does_not_move_for_a_while() -> None:
    """A board is still only after it has rested for STILL_S, and no longer once it is lost."""
    stillness = Stillness()
    times = np.arange(0.0, 1.3, 0.2)

    told = [stillness.look(time_s, watched()) for time_s in times]

    assert [time_s >= STILL_S for time_s in times] == told
    assert not stillness.look(1.4, None)
    assert not stillness.look(1.5, watched())


@pytest.mark.parametrize(("moved_px", "still"), [(0.5 * STILL_SHARE * 640, True), (3.0, False)])
def test_a_hand_may_tremble(moved_px: float, still: bool) -> None:
    """A small tremble counts as still, a larger one in either picture does not."""
    stillness = Stillness()
    for number in range(8):
        outlines = TRUE + np.array([[[0.0, 0.0]], [[moved_px * (-1) ** number, 0.0]]])
        told = stillness.look(0.15 * number, watched(outlines))

    assert still is told


def test_nobody_knows_what_happened_in_a_gap() -> None:
    """Two looks far apart in time are not still."""
    stillness = Stillness()
    stillness.look(0.0, watched())

    assert not stillness.look(GAP_S + 0.1, watched())


def test_the_ghost_fills_as_the_board_comes_nearer() -> None:
    """Nearness is 1 at the ghost, whichever corner is first, falls with the distance, and is 0 far away."""
    diagonal = diagonal_px(TRUE)

    near = [nearness(watched(TRUE + share * diagonal), ghost(TRUE)) for share in (0.0, 0.05, 0.1, 1.0)]

    assert [1.0] == near[:1]
    assert near[0] > near[1] > near[2] > near[3] == 0.0
    assert 1.0 == nearness(watched(np.roll(TRUE, 1, axis=1)), ghost(TRUE))


def test_a_pair_is_taken_in_the_ghost_or_where_none_was() -> None:
    """A still pair is taken within the ghost or where there is no view yet, and nowhere else."""
    diagonal = diagonal_px(TRUE)
    beside, far = TRUE + 0.1 * diagonal, TRUE + 0.6 * diagonal

    def waits(**changed: object) -> str:
        wanted: dict = {"still": True, "ghost": ghost(TRUE), "others": [beside], **changed}
        return wait_reason(watched(), **wanted)

    assert nearness(watched(beside), ghost(TRUE)) > IN_GHOST
    assert "" == waits()
    assert "moving" == waits(still=False)
    assert "same" == waits(others=[TRUE + 1.0, far])
    assert "elsewhere" == waits(ghost=ghost(far))
    assert "" == waits(ghost=ghost(far), others=[far])
    assert "" == waits(ghost=None, others=[])


def test_a_ghost_beside_a_view_is_no_trap() -> None:
    """Close to both, a board is taken if it is nearer to the ghost than to the view."""
    step = 0.08 * diagonal_px(TRUE) / np.sqrt(2.0)
    wanted, nearer = ghost(TRUE + step), watched(TRUE + 0.55 * step)

    def waits(share: float, offered: Ghost = wanted) -> str:
        return wait_reason(watched(TRUE + share * step), still=True, ghost=offered, others=[TRUE])

    assert not is_same(wanted.outlines, [TRUE])
    assert is_same(nearer.outlines, [TRUE])
    assert ("same", "same", "", "") == (waits(0.0), waits(0.45), waits(0.55), waits(1.0))
    assert "same" == waits(0.55, ghost(TRUE + 0.6 * step)), "a view may be taken of a place that repeats one"


@pytest.mark.parametrize(
    ("seen", "still", "expected_s"),
    [
        (TRUE, True, IN_PLACE_S),
        (TRUE + 200.0, True, ANYWHERE_S),
        (None, False, ANYWHERE_S),
        (TRUE, False, None),
    ],
)
def test_another_ghost_is_offered_where_no_view_comes_of_one(
    seen: FloatArray | None, still: bool, expected_s: float | None
) -> None:
    """Another ghost is offered soon if the board rests in it, later if it rests elsewhere or is not seen, and
    never while it moves.

    Ghosts come in turn, and the best one first once others are known."""
    patience, ghosts = GhostSelector(), [ghost(TRUE), ghost(TRUE + 1.0)]
    look = watched() if seen is None else watched(seen)
    if seen is None:
        look = replace(look, right=Seen(None, "not_found", "", clipped=False))
    offered = {}
    for at_s in np.arange(0.0, 2.5 * ANYWHERE_S, 0.5):
        patience.look(at_s, ghosts, look, still=still)
        offered[float(at_s)] = patience.offered(ghosts)

    changes = [at_s for at_s in list(offered)[1:] if offered[at_s] is not offered[at_s - 0.5]]
    assert (expected_s is None) == (not changes)
    if expected_s is not None:
        assert expected_s == changes[0]
        assert len(changes) > 1
        assert {id(one) for one in ghosts} == {id(one) for one in offered.values()}
    others = [ghost(TRUE + 2.0), *ghosts]
    assert others[0] is patience.offered(others)


def test_before_any_calibration_there_is_a_ghost_in_the_left_picture() -> None:
    """Four tilts come in turn, fully within the left picture, and the right picture has no ghost."""
    found = [first_ghosts(BOARD, (640, 480), views)[0] for views in range(5)]

    assert 4 == len({one.code for one in found})
    assert found[0].code == found[4].code
    for one in found:
        assert one.right is None
        assert (one.left > 0).all()
        assert (one.left < (640, 480)).all()
        assert 1.0 == nearness(watched(np.array([one.left, TRUE[1]])), one)


def test_the_first_ghosts_are_as_far_as_the_board_is_held() -> None:
    """The first ghosts are as large as the board appears, or of a usual size if it is not seen."""
    far = watched(np.array([one.mean(axis=0) + 0.7 * (one - one.mean(axis=0)) for one in TRUE]))
    assert pytest.approx(0.7 * held_share(watched())) == held_share(far)
    assert FIRST_SHARE == held_share(replace(far, right=Seen(None, "dark", "", clipped=False)))
    sizes = [
        diagonal_px(first_ghosts(BOARD, (640, 480), 0, held_share(one))[0].outlines)
        for one in (far, watched())
    ]
    assert pytest.approx(0.7, rel=0.05) == sizes[0] / sizes[1]


@pytest.mark.slow
def test_a_board_at_an_angle_looks_as_its_ghost() -> None:
    """A board held at its ghost fills it by more than 0.98."""
    left, right = outlines_of(RIG, BOARD, POSE)

    assert nearness(watch(*drawn(POSE), [BOARD]), Ghost(left, right, None, "", "")) > 0.98
