"""Hidden edges and merged edges of a part, from its CAD model."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.cells import small_rig
from helpers.stlfiles import ring
from helpers.tilted import lying
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.domain.arrays import FloatArray
from edged.files.step import read_step
from edged.vision.curves.outlines import Curve, CurveOutline, Face, project_outline
from edged.vision.part.body import MAX_TRIANGLES, PartBody
from edged.vision.part.curvevisibility import curve_visibility, hidden_samples
from edged.vision.part.zbuffer import hidden_points
from edged.vision.teaching.cadbody import body_of
from edged.vision.teaching.cadmodel import CadModel, curves_towards, welded

CAD = Path(__file__).parent.parent.parent / "data" / "cad"


@functools.cache
def body(part: str) -> PartBody:
    """The body of a part, in the frame of its file."""
    found = body_of(read_step(CAD / f"{part}.step"), np.eye(4))
    assert found is not None
    return found


def cast(body: PartBody, points_mm: FloatArray, eye_mm: FloatArray, behind_mm: float) -> FloatArray:
    """(N,) whether a ray from each point to the eye meets a triangle that is at least so far away.

    T. Moeller, B. Trumbore, "Fast, Minimum Storage Ray-Triangle Intersection", 1997.
    """
    a, b, c = (body.points_mm[body.triangles[:, k]] for k in range(3))
    hidden = np.zeros(len(points_mm), bool)
    for n, point in enumerate(points_mm):
        ray = eye_mm - point
        ray = ray / np.linalg.norm(ray)
        across = np.cross(ray, c - a)
        volume = np.einsum("ij,ij->i", b - a, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("ij,ij->i", point - a, across) / volume
            normal = np.cross(point - a, b - a)
            v = normal @ ray / volume
            away = np.einsum("ij,ij->i", c - a, normal) / volume
            hidden[n] = ((u >= 0) & (v >= 0) & (u + v <= 1) & (away > behind_mm)).any()
    return hidden


@pytest.mark.long
@settings(max_examples=6)
@given(lean=st.floats(0.3, 1.0), side=st.floats(0, 6.3), part=st.sampled_from(["D2", "D4"]))
def test_what_is_hidden_is_what_rays_meet(lean: float, side: float, part: str) -> None:
    """From any side up to 57° the hidden edges are those whose rays meet the part, up to a pixel of the
    buffer."""
    one = body(part)
    eye = 200.0 * np.array(
        [math.sin(lean) * math.cos(side), math.sin(lean) * math.sin(side), -math.cos(lean)]
    )
    points = one.points_mm[one.lines[:, :2]].mean(axis=1)[::29]
    found = hidden_points(one.points_mm, one.triangles, points, eye)
    met = cast(one, points, eye, 0.6)
    assert np.mean(met & ~found) < 0.01
    assert np.mean(found & ~met) < 0.15


@pytest.mark.slow
def test_a_hub_covers_the_holes_behind_it() -> None:
    """At 45°, along a line through two holes, one is fully visible and half of the other is hidden."""
    holes = [c for c in curves_towards(read_step(CAD / "D4.step"), -np.eye(3)[2]).circles
             if c.hole and abs(c.radius_mm - 1.5) < 0.01]  # fmt: skip
    shares = []
    for hole in holes:
        angle = np.linspace(0, 2 * np.pi, 100)
        around = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
        rim = hole.centre_mm + hole.radius_mm * around
        outwards = hole.centre_mm * [1, 1, 0] / np.linalg.norm(hole.centre_mm[:2])
        for sign in (1.0, -1.0):
            eye = 200.0 * (sign * outwards - [0, 0, 1]) / math.sqrt(2)
            one = body("D4")
            shares.append(float(hidden_points(one.points_mm, one.triangles, rim, eye).mean()))
    assert max(shares[0::2]) < 0.02
    assert min(shares[1::2]) > 0.4


def test_nothing_is_hidden_from_a_camera_amid_the_part() -> None:
    """From an eye amid the part nothing is hidden, and nothing fails."""
    one = body("D4")
    for eye in (np.zeros(3), one.points_mm[0], np.full(3, 1.0)):
        assert not hidden_points(one.points_mm, one.triangles, one.points_mm, eye).any()


def rim(radius_mm: float, height_mm: float) -> tuple[Curve, CurveOutline]:
    """A circle of a part, and samples of it."""
    curve = Curve("c", "circle", np.array([0.0, 0.0, radius_mm]), -1, height_mm=height_mm)
    one = curve.spread(200, 0.0)
    return curve, CurveOutline(one.points.copy(), one.normals.copy(), np.zeros((200, 0)))


@pytest.mark.parametrize(("break_mm", "low", "high"), [(0.0, 0.0, 0.0), (0.1, 0.9, 1.0), (2.0, 0.0, 0.0)])
def test_the_lower_edge_of_a_chamfer_is_seen_with_the_upper_one(
    break_mm: float, low: float, high: float
) -> None:
    """Seen from above, the lower edge of a chamfer merges with the upper one; a sharp edge and a wide
    chamfer do not merge."""
    corners = ring(90, 10.0 + 2 * break_mm, 4.0, 5.0)
    top = np.abs(corners[..., 2]) < 1e-9
    outer = np.linalg.norm(corners[..., :2], axis=2) > 9.0
    corners[..., 2] *= -1.0  # the part's z points away from the cameras
    if break_mm:  # the outer rim as a cone on top of a wall
        wall = corners.copy()[90 * 2 : 90 * 4]
        corners[top & outer, :2] *= 10.0 / (10.0 + 2 * break_mm)
        wall[..., 2] = np.where(wall[..., 2] < 1e-9, break_mm, wall[..., 2])
        cone = corners[90 * 2 : 90 * 4].copy()
        cone[..., 2] = np.where(cone[..., 2] > 1e-9, break_mm, cone[..., 2])
        corners = np.concatenate([corners[: 90 * 2], cone, wall, corners[90 * 4 :]])
    points, triangles = welded(corners)
    one = body_of(CadModel(points, triangles, np.arange(len(triangles)), ()), np.eye(4))
    assert one is not None
    pose = lying(small_rig(), 0.0, 0.0, 0.0)
    _, outline = rim(10.0, 0.0)
    seen = project_outline(small_rig(), "left", Face(pose[:3, 3], pose[:3, :3].T), outline)
    sight = curve_visibility(one, small_rig(), "left", pose, outline, seen)
    assert low <= sight.merged.mean() <= high
    assert not sight.hidden.any()


def test_both_cameras_are_asked() -> None:
    """At 45° to the side, what the hub hides from one camera differs from what it hides from the other."""
    pose = lying(small_rig(), 45.0, 0.0, 0.0)
    one = body("D4")
    points = one.points_mm[one.lines[:, 0]]
    points = points[np.abs(points[:, 2]) < 0.3]
    left, right = hidden_samples(one, small_rig(), pose, points)
    assert 0.02 < np.mean(left != right) < 0.5


def test_a_body_is_the_same_again_from_its_arrays() -> None:
    """A body read from its arrays is the same to a nanometre, with equal triangles."""
    again = PartBody.from_arrays(body("D1").to_arrays())
    assert np.abs(again.points_mm - body("D1").points_mm).max() < 2e-6
    assert np.array_equal(again.triangles, body("D1").triangles)
    assert np.array_equal(again.lines, body("D1").lines)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("points_mm", np.full((9, 3), np.nan, np.float32), "points_mm: impossible"),
        ("points_mm", np.full((9, 3), 1e9, np.float32), "points_mm: impossible"),
        ("points_mm", np.zeros((9, 2), np.float32), r"points_mm: float32 \(9, 2\)"),
        ("points_mm", np.zeros((9, 3)), "points_mm: float64"),
        ("triangles", np.full((9, 3), 10**9, np.uint32), "triangles: of points that are not there"),
        ("triangles", np.zeros((1, 3), np.uint32), "triangles: 1, expected 4 to"),
        ("triangles", np.zeros((MAX_TRIANGLES + 1, 3), np.uint32), f"triangles: {MAX_TRIANGLES + 1}"),
        ("lines", np.full((9, 4), 10**6, np.uint32), "lines: of points or triangles"),
        ("lines", np.zeros((3 * MAX_TRIANGLES + 1, 4), np.uint32), f"lines: {3 * MAX_TRIANGLES + 1}"),
        ("lines", None, "lines: missing"),
    ],
)
def test_a_hostile_body_is_refused(name: str, value: FloatArray | None, said: str) -> None:
    """A wrong array is refused with its name and what is wrong."""
    arrays = body("D3").to_arrays()
    if value is None:
        del arrays[name]
    else:
        arrays[name] = value
    with pytest.raises(ValueError, match=said):
        PartBody.from_arrays(arrays)


@pytest.mark.slow
def test_a_part_of_too_many_triangles_has_no_body() -> None:
    """A part with too many triangles has no body."""
    points, triangles = welded(ring(2000, 30.0, 20.0, 5.0, rows=24))
    assert len(triangles) > MAX_TRIANGLES
    assert body_of(CadModel(points, triangles, np.arange(len(triangles)), ()), np.eye(4)) is None


def test_edge_breaks_are_kept_and_checked() -> None:
    """The breaks that a pair has shown are kept in the arrays, and wrong ones are refused."""
    plain = body("D3")
    widths = np.linspace(0.0, 0.5, len(plain.lines))
    broken = replace(plain, breaks_mm=widths, sigma_break_mm=0.01, merged_mm=0.3)
    again = PartBody.from_arrays(broken.to_arrays())
    assert again.breaks_mm is not None
    assert np.abs(again.breaks_mm - widths).max() < 1e-6
    assert (0.01, 0.3) == pytest.approx((again.sigma_break_mm, again.merged_mm))
    assert 0.0 == PartBody.from_arrays(replace(broken, merged_mm=0.0).to_arrays()).merged_mm
    assert PartBody.from_arrays(plain.to_arrays()).breaks_mm is None
    arrays = broken.to_arrays()
    for wrong in (
        np.full_like(arrays["breaks_mm"], np.nan),
        -arrays["breaks_mm"] - 1,
        arrays["breaks_mm"][:-1],
    ):
        with pytest.raises(ValueError, match="breaks_mm"):
            PartBody.from_arrays(arrays | {"breaks_mm": wrong})
    for wrong in (-arrays["merged_mm"], arrays["merged_mm"] * np.nan, np.zeros((2, 1), np.float32)):
        with pytest.raises(ValueError, match="breaks_mm"):
            PartBody.from_arrays(arrays | {"merged_mm": wrong})
