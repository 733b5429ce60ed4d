"""A body laid on the teaching pair of its part, and edge breaks that its file does not have."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.drawnparts import images_of, place, rig
from solids import random_design
from solidworld import drawn, write_drawing

from edged.domain.arrays import FloatArray
from edged.files.step import read_step
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import invert, transform
from edged.vision.solid.bestfit import best_fit
from edged.vision.solid.breaks import FittedBody, lay_with_breaks
from edged.vision.solid.edgemodel import EdgeModel, model_of
from edged.vision.solid.forms import PosedPair, contradiction, with_breaks
from edged.vision.solid.lock import Pyramids
from edged.vision.solid.params import BREAKS
from edged.vision.solid.profileresiduals import ProfileResiduals
from edged.vision.teaching.cadbody import body_of
from edged.vision.teaching.cadrevision import Displaced, explains_more


def drawing_of(folder: Path, design: int) -> EdgeModel:
    """The edges of its file, without breaks."""
    write_drawing(folder, random_design(design))
    body = body_of(read_step(folder / f"P{design}.step"), np.eye(4))
    assert body is not None
    return model_of(body)


def laid_from(folder: Path, design: int, seed: int, deeper_mm: float) -> tuple[FittedBody, FloatArray]:
    """The body laid from this far below its place, and the error of its pose."""
    start = place(0.0) @ transform(np.eye(3), np.array([0.0, 0.0, deeper_mm]))
    laid = lay_with_breaks(images_of(design, seed), drawing_of(folder, design), start)
    assert laid is not None
    return laid, invert(place(0.0)) @ laid.fit.pose


def width_mm(laid: FittedBody) -> float:
    """The median width of the breaks."""
    return float(np.median(laid.model.breaks_mm[laid.model.breaks_mm > 0]))


@pytest.mark.long
@pytest.mark.parametrize(("design", "seed", "break_mm"), [(4, 5, 0.394), (84, 1, 0.475)])
def test_a_part_taught_by_the_lower_edges_of_its_breaks_is_laid_where_it_is(
    tmp_path: Path, design: int, seed: int, break_mm: float
) -> None:
    """A part taught by the lower edges of its breaks, with the file's radii one break below the face, is
    laid at its place.

    A width half as large, 0.17 mm too deep, would shift few profiles.
    """
    laid, error = laid_from(tmp_path, design, seed, break_mm)
    assert error[2, 3] == pytest.approx(0.0, abs=0.05)
    assert width_mm(laid) == pytest.approx(break_mm, abs=0.03)


@pytest.mark.long
def test_a_part_without_breaks_has_none(tmp_path: Path) -> None:
    """A textured part without breaks is laid without breaks."""
    laid, error = laid_from(tmp_path, 214, 5, 0.0)
    assert not laid.model.breaks_mm.any()
    assert error[2, 3] == pytest.approx(0.0, abs=0.02)


@pytest.mark.long
def test_a_part_whose_file_has_all_breaks_is_laid_without(tmp_path: Path) -> None:
    """If the file already has all breaks, the part is laid without further ones."""
    drawn_model = drawing_of(tmp_path, 214)
    model = replace(drawn_model, breakable=np.zeros_like(drawn_model.breakable))
    laid = lay_with_breaks(images_of(214, 5), model, place(0.0))
    assert laid is not None
    assert not laid.model.breaks_mm.any()
    assert (invert(place(0.0)) @ laid.fit.pose)[2, 3] == pytest.approx(0.0, abs=0.02)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 3])
def test_breaks_that_show_contradict_a_sharp_edge(tmp_path: Path, seed: int) -> None:
    """Breaks that were invisible at teaching and now show contradict a model with sharp edges."""
    sharp, at = drawing_of(tmp_path, 202), place(10.0)
    left, right = drawn(random_design(202), at, np.random.default_rng((seed, 202, 0)), teaching=False)[0]
    images = StereoImages.of(rig().rectification, left, right)
    pyramids = Pyramids(images.rig, images.raw, 1)
    found = []
    for model in (sharp, with_breaks(sharp, 0.175)):
        fit = best_fit(model, pyramids, images, at)
        assert fit is not None
        found.append(contradiction(model, PosedPair(images, pyramids, fit.pose)))
    assert found[0] > BREAKS.most_misfit > found[1]


@pytest.mark.long
def test_both_edges_of_breaks_leave_half_of_what_one_leaves(tmp_path: Path) -> None:
    """With both edges of the breaks the profiles leave least; a width too narrow leaves more, and so does
    a place aside."""
    model, images = drawing_of(tmp_path, 4), images_of(4, 5)
    view = PosedPair(images, Pyramids(images.rig, images.raw, 1), place(0.0))
    leaves = ProfileResiduals.of(with_breaks(model, 0.0), [view])
    right, narrow, none = (leaves.gain(with_breaks(model, mm), [view]) for mm in (0.394, 0.2, 0.0))
    assert right.is_certain
    assert right.mean > narrow.mean > none.mean == pytest.approx(0.0, abs=1e-9)
    aside = replace(view, pose=view.pose @ transform(np.eye(3), np.array([0.3, 0.0, 0.0])))
    assert leaves.gain(with_breaks(model, 0.394), [aside]).mean < narrow.mean


@pytest.mark.long
def test_a_hole_is_moved_only_where_that_leaves_less_of_the_pair(tmp_path: Path) -> None:
    """A hole that is 0.3 mm aside in the file is moved back, one at its place is not moved."""
    drawn_model, images = drawing_of(tmp_path, 4), images_of(4, 5)
    model = with_breaks(drawn_model, 0.394)
    view = PosedPair(images, Pyramids(images.rig, images.raw, 1), place(0.0))
    wall = next(wall for wall in random_design(4).walls if wall.name == "hole0")
    middle = np.append(np.mean(wall.outline.corners, axis=0), wall.top)
    on = np.linalg.norm((model.start - middle)[:, :2], axis=1) < 4.0
    chain = int(np.bincount(model.chain[on & (np.abs(model.start[:, 2] - wall.top) < 1e-6)]).argmax())
    its = (model.chain == chain)[:, None]
    aside = np.array([0.3, 0.0, 0.0])
    other = replace(model, start=model.start + its * aside, end=model.end + its * aside)
    back = Displaced(-0.3, 0.0, 0.0)
    assert explains_more(other, view, chain, 1.0, middle + aside, back)
    assert not explains_more(model, view, chain, 1.0, middle, back)
    assert not explains_more(model, view, chain, 1.0, middle, Displaced(0.07, 0.07, 0.0))
