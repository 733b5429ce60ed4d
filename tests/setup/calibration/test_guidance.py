"""Guidance between views: the calibration's quality, the board's next place, and the final rig."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from helpers.boardpairs import BOARD, RIG, SPEC, drawn, pairs
from helpers.boards import board_poses, synthetic_views
from rich.console import Console

from edged.commands.calibrate import calibrate
from edged.domain.arrays import SIDES
from edged.files.rig import rig_of
from edged.setup.calibration.drafts import keep_pair, views_of
from edged.setup.calibration.guidance import guide, outlines_of
from edged.setup.calibration.shown import off_px
from edged.setup.calibration.views import Looked, Views
from edged.setup.calibration.work import moved_um, solution_of
from edged.setup.pairs import Pair, Picture
from edged.vision.calibration.calibrate import calibrate_stereo
from edged.vision.calibration.nextbestview import plan_views


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Views]:
    """Six pairs in a draft's folder, and their views."""
    folder = tmp_path_factory.mktemp("draft")
    for place in ("pictures", "small"):
        (folder / place).mkdir()
    looks = {}
    for number, pair in enumerate(pairs(6), 1):
        (left, right), *_ = keep_pair(folder, f"view_{number:03}", *pair, [BOARD])
        looks[f"view_{number:03}"] = left, right
    return folder / "pictures", views_of(folder / "pictures", list(looks), [BOARD], looks)


def some(views: Views, count: int) -> Views:
    """The first pairs."""
    chosen = Views(views.boards)
    chosen.add([Pair.of_images(f"v{number}", *pair) for number, pair in enumerate(pairs(6)[:count])])
    return chosen


@pytest.mark.slow
def test_too_few_views_say_so_and_ask_for_the_next_tilt(kept: tuple[Path, Views]) -> None:
    """With too few views the trouble has the solver's code, and each view asks for another tilt."""
    one, two = guide(some(kept[1], 1), "division"), guide(some(kept[1], 2), "division")

    assert one.trouble is not None
    assert ("few_views", 1) == (one.trouble.code, one.trouble.params["found"])
    assert (None, None) == (one.sigma_um, one.more_views)
    assert one.ghosts[0].code != two.ghosts[0].code


@pytest.mark.long
def test_each_view_is_worth_what_the_ghost_promised(kept: tuple[Path, Views]) -> None:
    """A pair taken at the ghost has its outline, and lowers sigma to about the predicted value."""
    _, views = kept
    before = guide(views, "division", goal_um=1.0)
    assert before.sigma_um is not None
    ghost = before.ghosts[0]
    assert ghost.sigma_um is not None
    assert ghost.right is not None
    assert 3 == len(before.ghosts)
    assert (ghost.sigma_um < before.sigma_um).all()
    assert before.more_views is None or before.more_views > 1

    plan = plan_views(calibrate_stereo(views.found, *views.sizes), 12)
    assert plan is not None
    pose = next(one.left_from_board for one in plan.suggestions if one.code == ghost.code)
    assert off_px(ghost.outlines, np.array(outlines_of(RIG, BOARD, pose))) < 1.0
    views.add([Pair.of_images("asked", *drawn(pose, seed=9))])
    after = guide(views, "division", taken=[ghost.outlines])
    views.remove("asked")
    assert after.sigma_um is not None
    assert pytest.approx(np.linalg.norm(ghost.sigma_um), rel=0.2) == np.linalg.norm(after.sigma_um)
    assert ghost.code not in [one.code for one in after.ghosts]


@pytest.mark.long
def test_sigma_is_believed_the_more_views_there_are() -> None:
    """With few views the usual mark noise is stated, and with many the observed one."""

    def excess(count: int) -> float:
        seen = synthetic_views(RIG, BOARD, board_poses(RIG, BOARD, count, 1), 0.004, 1)
        views, none = Views([BOARD]), Picture("none", lambda: np.zeros((1, 1), np.uint8))
        for one in seen:
            left, right = (
                Looked((640, 480), f"{one.name}{side}".encode(), none.read(), [one.found(side)])
                for side in SIDES
            )
            views.put(Pair(one.name, none, none), left, right)
        plan = plan_views(calibrate_stereo(seen, *views.sizes), 0)
        assert plan is not None
        return float(np.linalg.norm(guide(views, "division").sigma_um) / np.linalg.norm(1e3 * plan.sigma_mm))

    assert excess(4) > 1.8
    assert 1 < excess(16) < 1.5


@pytest.mark.long
def test_a_draft_and_the_command_give_the_same_rig_to_the_last_bit(
    kept: tuple[Path, Views], tmp_path: Path
) -> None:
    """From the same pictures both write the same rig file, byte for byte."""
    pictures, views = kept
    output = tmp_path / "rig.json"
    calibrate(pictures, SPEC, output, "division", None, Console(file=io.StringIO()))
    told: list[str] = []

    solution = solution_of(views, "division", {}, former=RIG, progress=lambda stage, *_: told.append(stage))

    assert output.read_bytes() == solution.rig
    assert solution.calibration_id.encode() in solution.report
    assert {"bundle adjustment", "measuring the marks and edges", "holding views out", "the report"} <= set(
        told
    )
    shown = solution.figures["views"]
    assert isinstance(shown, dict)
    assert list(views.thumbnails) == list(shown)
    for figures in shown.values():
        assert isinstance(figures, dict)
        assert 0 < figures["rms_px"] <= figures["heldout_px"] < 1.0
    moved = solution.figures["moved_um"]
    assert isinstance(moved, dict)
    rig = rig_of(solution.rig, output)
    again = moved_um(calibrate_stereo(views.found, *views.sizes), rig)
    assert again is not None
    assert 0 < moved["rms"] < moved["max"]
    assert again["max"] < moved["rms"], "its own first solution lies nearer than the truth"


@pytest.mark.slow
def test_points_move_by_as_much_as_the_rig_did() -> None:
    """With a longer baseline points move by its share, and other cameras are not compared."""
    from dataclasses import replace

    views = Views([BOARD])
    views.add([Pair.of_images(f"v{number}", *pair) for number, pair in enumerate(pairs(6))])
    found = calibrate_stereo(views.found, *views.sizes)
    wider = found.rig.right_from_left.copy()
    wider[:3, 3] *= 1 + 1e-4
    moved = moved_um(found, replace(found.rig, right_from_left=wider))

    assert moved is not None
    depth_mm = board_poses(RIG, BOARD, 1, seed=3)[0][2, 3]
    assert pytest.approx(1e-4 * depth_mm * 1e3, rel=0.3) == moved["rms"]
    small = replace(found.rig, left=replace(found.rig.left, width=320))
    assert moved_um(found, small) is None
