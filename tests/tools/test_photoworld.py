"""The path-traced world: its lamps, its marks, and the place of a part in its pictures."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import photoworld
import pytest
from helpers.cells import shrunk
from helpers.tilted import lying
from photoworld import FINISHES, LIGHTS, SHEET_MM, Setting, irradiance, panel
from solids import Design, Wall, circle, meshed, random_design
from solidworld import world_rig

from edged.vision.geometry.rigid import apply, invert

SETTING = replace(
    Setting.drawn("cast", np.random.default_rng(1)),
    light="dome", window=-1, table="dark", gap_mm=8.0, parallel=True, reflects=0.9, exposure=180.0,
    blur_px=0.6,
)  # fmt: skip


def test_irradiance_is_that_of_known_lamps() -> None:
    """A small panel overhead gives its area over its distance squared, and a dome nearly pi."""
    above = panel(np.array([0.0, 0.0, -100.0]), np.zeros(3), 4.0, 5.0)
    assert abs(irradiance(above) / (20.0 / 100.0**2) - 1) < 1e-3
    # it ends 5 degrees above the level, where what comes in counts little
    assert abs(irradiance(photoworld.dome([np.array([0.0, 0.0, 1.0])])) / math.pi - 1) < 0.02


@pytest.mark.parametrize("tilt_deg", [0.0, 45.0])
@pytest.mark.parametrize("light", LIGHTS)
def test_every_lamp_shines_down_on_the_part_and_stands_in_no_cameras_view(
    light: str, tilt_deg: float
) -> None:
    """For any pose light reaches the face, and no lamp is between the part and a camera."""
    rig, setting = world_rig(), replace(SETTING, light=light)
    for side_deg in (0.0, 100.0, 180.0, 290.0):
        where = lying(rig, tilt_deg, side_deg, 30.0)
        frame = photoworld.lamp_frame(where, where, setting, rig)
        eyes = [apply(invert(frame), eye[None])[0] for eye in photoworld.eyes_of(rig)]
        shining = photoworld.lamps(setting, eyes)
        assert irradiance(shining) > 0
        corners = shining.reshape(-1, 3)
        for eye in eyes:
            away = corners - (corners @ eye)[:, None] * eye / (eye @ eye)
            between = corners @ eye > 0
            assert np.linalg.norm(away[between], axis=1).min() > 10.0


@pytest.mark.long
@pytest.mark.parametrize("finish", FINISHES)
def test_marks_have_slopes_as_metal_has(finish: str) -> None:
    """The rms slope of marks is between 0.005 and 0.2."""
    height = photoworld.marks(finish, 0.2, 0.08, 0.3, 1)
    slopes = np.gradient(height, SHEET_MM / len(height))
    slope = math.sqrt(sum(float(np.mean(one**2)) for one in slopes))
    assert 0.005 < slope < 0.2


def test_places_on_faces_lie_on_faces() -> None:
    """Points on faces are at the height of the base or of a boss."""
    design = random_design(4)
    levels = np.array([z for z, looks_up, _, _ in design.levels() if looks_up])
    points = photoworld.face_points(meshed(design, nominal=False), np.random.default_rng(1))
    assert np.abs(points[:, 2:] - levels).min(axis=1).max() < 1e-9


def test_a_scene_has_lamps_table_and_every_kind_of_surface(tmp_path: Path) -> None:
    """A scene has lamps, table and every kind of surface, and a window only if asked for."""
    pytest.importorskip("mitsuba")
    mesh, rig = meshed(random_design(4), nominal=False), world_rig()
    scene = photoworld.scene_of(mesh, lying(rig, 20.0, 0.0, 0.0), SETTING, rig, tmp_path)
    assert {"face", "wall", "break", "under", "table", "lamps", "room"} <= set(scene)
    assert "window" not in scene
    wider = photoworld.scene_of(mesh, lying(rig, 20.0, 0.0, 0.0), replace(SETTING, window=1), rig, tmp_path)
    assert {"window"} == set(wider) - set(scene)


def test_a_part_is_seen_where_the_truth_says() -> None:
    """The middle of a thin white disc on a dark table is that of its rim, to a tenth of a pixel."""
    pytest.importorskip("mitsuba")
    rig, design = shrunk(world_rig(), 4), Design("P0", (Wall("base", circle(0, 0, 9), -1, True, 0.0, 0.05),))
    where = lying(rig, 10.0, 70.0, 20.0)
    turn = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    rim = apply(where, 9 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1))
    views = ((rig.left, np.eye(4)), (rig.right, np.asarray(rig.right_from_left)))
    for picture, (camera, from_rig) in zip(
        photoworld.pictures(meshed(design, nominal=False), where, SETTING, rig, 1), views, strict=True
    ):
        outline = photoworld.project(camera, from_rig, rim)
        y, x = np.nonzero(picture > 0.5 * np.median(picture[picture > 80]))
        middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
        found = 0.5 * np.array([x.min() + x.max(), y.min() + y.max()])
        np.testing.assert_allclose(found, middle, atol=1.0)
        np.testing.assert_allclose([x.mean(), y.mean()], _middle(outline), atol=0.1)


def _middle(points: np.ndarray) -> np.ndarray:
    """The centroid of a polygon (N, 2)."""
    ahead = np.roll(points, -1, axis=0)
    cross = points[:, 0] * ahead[:, 1] - points[:, 1] * ahead[:, 0]
    return np.asarray(((points + ahead) * cross[:, None]).sum(axis=0) / cross.sum() / 3)


def test_a_ply_file_holds_what_it_was_given(tmp_path: Path) -> None:
    """A triangle with its texture places is written as five numbers per corner, one byte and three numbers
    per face."""
    corners = np.arange(9.0).reshape(1, 3, 3)
    data = Path(
        photoworld.write_ply(tmp_path / "one.ply", corners, np.arange(6.0).reshape(1, 3, 2))
    ).read_bytes()
    head, _, body = data.partition(b"end_header\n")
    assert b"element vertex 3" in head
    vertices = np.frombuffer(body[:60], "<f4").reshape(3, 5)
    assert [[0, 1, 2, 0, 1], [3, 4, 5, 2, 3], [6, 7, 8, 4, 5]] == vertices.tolist()
    assert b"\x03" + np.array([0, 1, 2], "<i4").tobytes() == body[60:]
