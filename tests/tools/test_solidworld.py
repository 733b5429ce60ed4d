"""Random parts: closed, with their breaks, equal in triangles, STEP file and truth, drawn at their place."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from benching import wilson
from helpers.tilted import lying
from solids import UP, Design, Wall, box, circle, flattened, meshed, polygon, random_design
from solidstep import step_text
from solidtruth import part_json
from solidworld import BreakLook, Look, World, pictures, world_rig, write_set

from edged.domain.arrays import FloatArray
from edged.files.images import load_image
from edged.files.step import read_step
from edged.sim.render.lens import project
from edged.vision.geometry.rigid import apply
from edged.vision.teaching.cadmodel import CadModel, RoundSurface, curves_towards, open_sides


def volume(model: CadModel) -> float:
    """The volume within a closed surface in mm³."""
    a, b, c = (model.points_mm[model.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6


def plain_look() -> Look:
    """A white face, black walls and breaks, and a black table, so that only the face is seen."""
    black = BreakLook(0.0, 0.0, 0.0, 1.0, 0.5)
    return Look(
        albedo=0.8, contrast=0.0, feature_mm=1.0, wall=0.0, wall_swing=0.0, wall_azimuth_rad=0.0, bore=1.0,
        breaks=(black, black), beneath=0.0, table=0.0, table_contrast=0.0, table_feature_mm=1.0, gap_mm=5.0,
        gradient_per_mm=(0.0, 0.0), levels=(1.0, 1.0), blur_px=(0.6, 0.6), blur_px_per_mm=0.03, focus_mm=0.0,
    )  # fmt: skip


@pytest.mark.parametrize("number", range(7))
def test_a_random_part_is_one_closed_body_and_its_breaks_take_material_away(number: int) -> None:
    """The surface is closed and oriented outwards, and breaks make the volume smaller."""
    design = random_design(number)
    nominal, real = (meshed(design, nominal=one).model for one in (True, False))
    assert [(0, 1), (0, 1)] == [open_sides(one.triangles) for one in (nominal, real)]
    is_broken = any(wall.break_mm > 0 for wall in design.walls)
    assert (volume(real) < volume(nominal)) == is_broken
    assert 0 < volume(real)


@pytest.mark.long
@pytest.mark.parametrize("number", [2, 4])
def test_a_step_file_says_what_the_triangles_say(number: int, tmp_path: Path) -> None:
    """Circles and straight edges of STEP file and triangles are equal to a nanometre."""
    pytest.importorskip("cascadio")
    design = random_design(number)
    (tmp_path / "part.step").write_text(step_text(design))
    models = read_step(tmp_path / "part.step"), meshed(design, nominal=True).model
    found = [curves_towards(model, UP) for model in models]
    circles = [
        sorted(np.round([c.radius_mm, *c.centre_mm], 6).tolist() for c in one.circles) for one in found
    ]
    lengths = [sorted(float(np.linalg.norm(e.end_mm - e.start_mm)) for e in one.edges) for one in found]
    np.testing.assert_allclose(circles[0], circles[1], atol=2e-6)
    np.testing.assert_allclose(lengths[0], lengths[1], atol=1e-6)


def test_an_offset_outline_is_as_far_away_everywhere() -> None:
    """An offset outline has the offset's distance everywhere, at corners between its sides."""
    for outline in (circle(1, 2, 3), box(0, 0, 9, 5, 1), box(0, 0, 9, 4, 2)):
        inner, outer = (one.points(outline.pieces()) for one in (outline, outline.offset(0.3)))
        np.testing.assert_allclose(np.linalg.norm(outer - inner, axis=1), 0.3, atol=1e-9)
    ell = polygon([(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)])
    wider = [(-0.3, -0.3), (5.3, -0.3), (5.3, 2.3), (2.3, 2.3), (2.3, 4.3), (-0.3, 4.3)]
    np.testing.assert_allclose(ell.offset(0.3).corners, wider, atol=1e-12)
    flat = flattened(6, 4).offset(-0.3)
    assert (3.7, 5.7) == (round(flat.corners[0][0], 9), round(float(np.hypot(*flat.corners[0])), 9))


def test_a_broken_wall_is_made_of_cones_and_a_sharp_one_of_cylinders() -> None:
    """The chamfer of a disc is a cone of 45 degrees, and its wall a cylinder."""
    design = Design("disc", (Wall("base", circle(0, 0, 10), -1, True, 0.0, 5.0, 0.4),))
    slopes = {
        one.slope for one in meshed(design, nominal=False).model.surfaces if isinstance(one, RoundSurface)
    }
    assert {round(slope, 9) for slope in slopes} == {0.0, -1.0}


@pytest.mark.long
def test_the_face_is_drawn_where_the_truth_says() -> None:
    """Middle and area of a white face amid black walls are those of its projected rim, on both sides.

    The rim is where the chamfer leaves the face; a hundredth of a pixel is the samples' error.
    """
    rig, design = world_rig(), Design("disc", (Wall("base", circle(0, 0, 9), -1, True, 0.0, 5.0, 0.4),))
    where = lying(rig, 30.0, 70.0, 20.0)
    truth = part_json(design, where, 30.0, rig)["circles"][0]
    assert ("base@face", 8.6) == (truth["name"], round(truth["radius_mm"], 9))
    turn = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    rim = apply(where, truth["radius_mm"] * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1))
    views = ((rig.left, np.eye(4)), (rig.right, np.asarray(rig.right_from_left)))
    for picture, (camera, from_rig) in zip(
        pictures(World(design, where, plain_look(), 1), rig), views, strict=True
    ):
        area, middle = area_and_middle(project(camera, from_rig, rim))
        light = np.where(picture > 6, picture - 3.0, 0.0)
        y, x = np.mgrid[0 : light.shape[0], 0 : light.shape[1]]
        found = np.array([(light * x).sum(), (light * y).sum()]) / light.sum()
        np.testing.assert_allclose(found, middle, atol=0.02)
        assert abs(light.sum() / light[light > 0.9 * np.median(light[light > 0])].mean() / area - 1) < 5e-3


def area_and_middle(points: FloatArray) -> tuple[float, FloatArray]:
    """Area and centroid of a polygon (N, 2)."""
    ahead = np.roll(points, -1, axis=0)
    cross = points[:, 0] * ahead[:, 1] - points[:, 1] * ahead[:, 0]
    return abs(float(cross.sum())) / 2, np.asarray(
        ((points + ahead) * cross[:, None]).sum(axis=0) / cross.sum() / 3
    )


@pytest.mark.long
def test_a_set_has_what_a_bench_reads(tmp_path: Path) -> None:
    """A set has cameras, a drawing, a teaching pair with its pose, and a scene without the part."""
    write_set(tmp_path, [2], 0, 1, 1)
    assert (tmp_path / "rig.json").exists()
    assert (tmp_path / "step" / "P2.step").exists()
    taught = json.loads((tmp_path / "teach" / "teach_P2.json").read_text())["parts"]
    assert ["P2"] == [part["design"] for part in taught]
    (decoy,) = (tmp_path / "scenes").glob("*.json")
    assert [] == json.loads(decoy.read_text())["parts"]
    left = load_image(decoy.with_name(decoy.stem + "_left.png"))
    assert (960, 1280) == left.shape


def test_confidence_bounds_are_those_of_the_table() -> None:
    """The bounds for 14 of 18, 0 of 10 and 0 of 0 are right (Wilson 1927; values by R's binom.wilson)."""
    np.testing.assert_allclose(wilson(14, 18), (0.5478, 0.9100), atol=5e-4)
    np.testing.assert_allclose(wilson(0, 10), (0.0, 0.2775), atol=5e-4)
    assert (0.0, 1.0) == wilson(0, 0)
