"""Teaching learns the part that was there, and refuses a region without one."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from helpers.brokenparts import half_disc
from helpers.cells import Flange, flange, pictures, pose, region_around, scene, small_rig
from helpers.tilted import lying

from edged.errors import ImageError, TeachError
from edged.pipeline import prepare
from edged.sim.render.scene import Disc, Hole, PaintedMark, Part, PolygonShape, RoundedBox, Slot, Surface
from edged.vision.geometry.rectification import Rectification, make_rectification
from edged.vision.geometry.rigid import apply, invert
from edged.vision.part.job import Job
from edged.vision.teaching.pair import teach
from edged.vision.teaching.region import CircleRegion, Region


@pytest.fixture(scope="module")
def flat() -> Flange:
    """The flange, square to the left camera."""
    return flange()


@pytest.fixture(scope="module")
def rectification(flat: Flange) -> Rectification:
    """The rectification of its rig."""
    return make_rectification(flat.rig)


@pytest.fixture(scope="module")
def job(flat: Flange, rectification: Rectification) -> Job:
    """The job that is taught from it."""
    return teach(flat.left, flat.right, rectification, flat.region, "flange", 7)


@pytest.mark.slow
def test_circles_are_named_by_falling_radius(job: Job) -> None:
    """c0 is the outline and the reference, c1 the bore, equal ones are in reading order, and there are no
    others."""
    assert [circle.name for circle in job.circles] == [f"c{k}" for k in range(len(job.circles))]
    radii = [circle.radius_mm for circle in job.circles]
    np.testing.assert_allclose(radii, [14.0, 4.0, 1.6, 1.6, 1.6, 1.6, 0.9], atol=0.01)
    assert job.reference == "c0"
    assert (job.name, job.number) == ("flange", 7)
    assert [circle.polarity for circle in job.circles] == [-1, 1, 1, 1, 1, 1, 1]
    rows = [circle.centre_mm[1] for circle in job.circles[2:6]]
    assert rows == sorted(rows)


@pytest.mark.slow
def test_places_are_those_of_the_drawing(job: Job, flat: Flange) -> None:
    """Every circle is at its place on the part, to 10 µm, and the pose is the true one."""
    places = np.array([(disc.x_mm, disc.y_mm, disc.radius_mm) for _, disc in flat.part.circles])
    for circle in job.circles:
        in_rig = apply(job.rig_from_part, circle.centre_mm)
        nearest = min(
            places,
            key=lambda p: float(
                np.linalg.norm(in_rig[:2] - flat.rig_from_part[:2, 3] - p[:2]) + abs(circle.radius_mm - p[2])
            ),
        )
        x, y, z = in_rig - flat.rig_from_part[:3, 3]
        assert math.hypot(x - nearest[0], y - nearest[1]) < 0.01
        assert abs(z) < 0.03
    np.testing.assert_allclose(job.rig_from_part, flat.rig_from_part, atol=0.006)
    np.testing.assert_allclose(job.rig_from_part[:3, :3], np.eye(3), atol=1e-3)


def test_limits_follow_from_the_depth(job: Job) -> None:
    """The part is inside its own depth limits, and the scale limits follow from these."""
    nearest, farthest = job.limits.depth_mm
    depth = job.rig_from_part[2, 3]
    assert nearest < depth < farthest
    assert job.search.scale_min == pytest.approx(depth / farthest)
    assert job.search.scale_max == pytest.approx(depth / nearest)


@pytest.mark.long
def test_teaching_twice_is_the_same(job: Job, flat: Flange, rectification: Rectification) -> None:
    """Teaching again from the same images gives exactly the same job."""
    again = teach(flat.left, flat.right, rectification, flat.region, "flange", 7)
    assert np.array_equal(again.rig_from_part, job.rig_from_part)
    for key, array in job.shape.to_arrays().items():
        assert np.array_equal(again.shape.to_arrays()[key], array)


@pytest.mark.long
def test_a_tilted_part_is_taught_in_its_own_frame() -> None:
    """For a part tilted by 8° z is the face's normal away from the cameras, and x the rig's, projected."""
    flat = flange()
    where = pose(turn_deg=40.0, tilt_deg=8.0)
    left, right = pictures(flat.rig, scene((flat.part, where)))
    region = region_around(flat.rig, where[:3, 3], 14.0)
    job = teach(left, right, make_rectification(flat.rig), region, "tilted")
    rotation = job.rig_from_part[:3, :3]
    assert rotation[:, 2] @ where[:3, 2] > math.cos(math.radians(0.1))
    assert (
        abs(rotation[1, 0] * rotation[2, 2] - rotation[2, 0] * rotation[1, 2]) < 1e-9
    )  # x in the plane of x and z
    assert np.linalg.norm(job.rig_from_part[:3, 3] - where[:3, 3]) < 0.01
    assert np.abs(np.array([circle.centre_mm[2] for circle in job.circles])).max() < 0.05


@pytest.mark.long
def test_a_face_leans_by_what_its_long_edges_say_too() -> None:
    """Four long edges hold the face of a plate whose two small holes would lean it by 0.3°."""
    flat = flange()
    half = PaintedMark(half_disc(-1.0, 1.0, 1.9, 0.4), 0.12)
    holes = (Hole("a", Disc(-1.0, 1.0, 1.5), 0.1), Hole("b", Disc(3.0, -1.0, 1.4), 0.1))
    plate = Part("plate", RoundedBox(0, 0, 28, 20), Surface(0.6, 0.05), holes, (half,))
    for seed in range(3):
        left, right = pictures(flat.rig, scene((plate, pose())), seed)
        job = teach(left, right, make_rectification(flat.rig), flat.region, "plate")
        assert len(job.edges) == 4
        lean = math.degrees(math.acos(min(1.0, float(job.rig_from_part[2, 2]))))
        assert lean < 0.1
        assert np.abs([circle.centre_mm[2] for circle in job.circles]).max() < 0.1


@pytest.mark.parametrize(
    ("region", "expected"),
    [
        (Region(1e5, 10, 50, 50), "outside"),
        (Region(-500, -500, 400, 400), "outside"),
        (Region(100, 100, 8, 200), "at least 16"),
        (Region(100, 100, -50, 50), "at least 16"),
        (Region(math.nan, 100, 50, 50), "X,Y,W,H"),
        (Region(100, 100, math.inf, 50), "X,Y,W,H"),
        (Region(5, 5, 60, 60), "no circle"),
    ],
)
def test_a_region_without_a_part_is_refused(
    flat: Flange, rectification: Rectification, region: Region, expected: str
) -> None:
    """A region outside, tiny, inside out, NaN or with an empty table is refused with what was expected."""
    with pytest.raises(TeachError, match=expected):
        teach(flat.left, flat.right, rectification, region, "x")


@pytest.mark.long
def test_images_of_which_one_shows_nothing_are_refused(flat: Flange, rectification: Rectification) -> None:
    """Blank, identical and swapped images are refused."""
    blank = np.full_like(flat.left, 60)
    with pytest.raises(TeachError, match="no circle"):
        teach(blank, flat.right, rectification, flat.region, "x")
    for left, right in ((flat.left, blank), (flat.left, flat.left)):
        with pytest.raises(TeachError, match="both cameras"):
            teach(left, right, rectification, flat.region, "x")
    with pytest.raises(TeachError):
        teach(flat.right, flat.left, rectification, flat.region, "x")


@pytest.mark.slow
def test_a_part_without_circles_is_taught_by_its_edges(rectification: Rectification, flat: Flange) -> None:
    """A plate with a window has eight edges and eight corners as drawn, to 15 µm; one is the reference and
    the origin."""
    plate = Part("plate", RoundedBox(0, 0, 22, 16), Surface(0.6), (Hole("window", RoundedBox(2, 1, 9, 7)),))
    left, right = pictures(flat.rig, scene((plate, pose())))
    job = teach(left, right, rectification, flat.region, "plate")
    assert not job.circles
    assert (len(job.edges), len(job.corners)) == (8, 8)
    assert job.kind_of(job.reference) == "corner"
    np.testing.assert_allclose(job.place_of(job.reference), 0.0, atol=1e-9)
    drawn = [(x, y) for x in (-11.0, 11.0) for y in (-8.0, 8.0)]
    drawn += [(2.0 + x, 1.0 + y) for x in (-4.5, 4.5) for y in (-3.5, 3.5)]
    part_from_rig = invert(pose())
    for corner in job.corners:
        x, y, z = apply(part_from_rig, apply(job.rig_from_part, job.place_of(corner.name)))
        assert min(math.hypot(x - u, y - v) for u, v in drawn) < 0.015
        assert abs(z) < 0.05
    lines = [(axis, place) for axis, places in enumerate(zip(*drawn, strict=True)) for place in set(places)]
    for edge in job.edges:
        ends = apply(part_from_rig, apply(job.rig_from_part, np.array([edge.start_mm, edge.end_mm])))
        axis, place = min(lines, key=lambda line: float(np.abs(ends[:, line[0]] - line[1]).max()))
        lines.remove((axis, place))
        assert np.abs(ends[:, axis] - place).max() < 0.015
    np.testing.assert_allclose(job.rig_from_part[:3, :3], np.eye(3), atol=5e-3)


def test_slots_notches_and_corners_are_learnt_beside_the_circles(
    rectification: Rectification, flat: Flange
) -> None:
    """A slot, a square window and a hole of a disc are taught as drawn, with names and polarities."""
    holes = (
        Hole("slot", Slot(4.0, -5.0, 8.0, 3.0, 0.4)),
        Hole("window", RoundedBox(-5.0, 4.0, 6.0, 5.0, 0.0, 0.2)),
        Hole("bore", Disc(5.0, 5.0, 3.0)),
    )
    part = Part("disc", Disc(0, 0, 13.0), Surface(0.6, 0.05), holes)
    left, right = pictures(flat.rig, scene((part, pose())))
    job = teach(left, right, rectification, flat.region, "disc")
    assert [circle.name for circle in job.circles] == ["c0", "c1"]
    (slot,) = job.slots
    assert (slot.name, slot.polarity) == ("s0", 1)
    np.testing.assert_allclose((slot.length_mm, slot.width_mm), (8.0, 3.0), atol=0.01)
    np.testing.assert_allclose(slot.centre_mm[:2], (4.0, -5.0), atol=0.01)
    assert slot.angle_rad == pytest.approx(0.4, abs=0.002)
    assert len(job.edges) == len(job.corners) == 4
    np.testing.assert_allclose([edge.length_mm for edge in job.edges], [6.0, 6.0, 5.0, 5.0], atol=0.25)
    middle = np.mean([job.place_of(corner.name) for corner in job.corners], axis=0)
    np.testing.assert_allclose(middle[:2], (-5.0, 4.0), atol=0.01)
    for edge in job.edges:  # the part is brighter than what is seen through its window
        along = edge.end_mm - edge.start_mm
        outwards = job.place_of(edge.name)[:2] - middle[:2]
        assert edge.polarity * float(outwards @ (-along[1], along[0])) > 0


@pytest.mark.slow
def test_one_circle_is_enough(rectification: Rectification, flat: Flange) -> None:
    """For a plate with one bore the bore is the reference and the plate's outline the shape."""
    plate = Part("plate", RoundedBox(0, 0, 24, 18), Surface(0.6, 0.05), (Hole("bore", Disc(3.0, -2.0, 5.0)),))
    left, right = pictures(flat.rig, scene((plate, pose())))
    job = teach(left, right, rectification, flat.region, "plate")
    assert [circle.polarity for circle in job.circles] == [1]
    np.testing.assert_allclose(job.rig_from_part[:2, 3], (11.0, -2.0), atol=0.01)
    assert job.shape.radius_px > 12.0 * flat.rig.left.fx / 205.0


def test_images_that_do_not_fit_the_rig_are_refused(flat: Flange, rectification: Rectification) -> None:
    """An image of another size is refused with its side and both sizes."""
    with pytest.raises(ImageError, match=r"left image: 320x480.*640x480"):
        teach(flat.left[:, :320], flat.right, rectification, flat.region, "x")
    with pytest.raises(ImageError, match="right image"):
        teach(flat.left, flat.right[:100], rectification, flat.region, "x")


@pytest.mark.long
def test_holes_of_a_perforated_table_are_none_of_the_part() -> None:
    """Holes of a perforated table are not taught, neither with a region nor with the whole picture."""
    rig = prepare(small_rig())
    where = lying(rig.rig, 0.0, 0.0, 0.0)
    lower, upper = where.copy(), where.copy()
    lower[:3, 3] += 6.0 * where[:3, 2]
    spots = [(x, y) for x in range(-48, 49, 5) for y in range(-40, 41, 5)]
    sheet = Part(
        "sheet", RoundedBox(0, 0, 200, 200), Surface(albedo=0.7),
        tuple(Hole(f"hole{k}", Disc(x, y, 1.4), 0.05) for k, (x, y) in enumerate(spots)),
    )  # fmt: skip
    disc = Part(
        "disc", Disc(0, 0, 13.0), Surface(albedo=0.35),
        (Hole("bore", Disc(-4, 3, 3.0), 0.05), Hole("pin", Disc(6, 4, 2.2), 0.05)),
    )  # fmt: skip
    left, right = pictures(rig.rig, scene((sheet, lower), (disc, upper)))
    x, y = rig.rig.left.project(where[None, :3, 3])[0]
    around = CircleRegion(float(x), float(y), 1.25 * 13.0 * rig.rig.left.fx / float(where[2, 3]))
    for region in (None, around):
        job = teach(left, right, rig.rectification, region, "disc")
        radii = {round(circle.radius_mm, 1) for circle in job.circles}
        assert {2.2, 3.0} <= radii <= {2.2, 3.0, 13.0}, radii


@pytest.mark.slow
def test_faint_holes_tell_how_a_dark_part_with_a_bright_insert_lies() -> None:
    """Holes of a dark part, with edges a tenth as strong as those of its bright bore, are taught, too."""
    rig = prepare(small_rig())
    face = lying(rig.rig, 0.0, 0.0, 0.0)
    table = face.copy()
    table[:3, 3] += 6.0 * face[:3, 2]
    holes = {(8.0, 2.0): 1.6, (-3.0, 8.0): 1.6, (-6.0, -6.0): 2.2}
    cover = Part(
        "cover", Disc(0, 0, 13.0), Surface(albedo=0.12),
        (*(Hole(f"hole{k}", Disc(*place, radius), 0.03) for k, (place, radius) in enumerate(holes.items())),
         Hole("bore", Disc(0, 0, 5.0), 0.9)),
    )  # fmt: skip
    sheet = Part("sheet", RoundedBox(0, 0, 200, 200), Surface(albedo=0.9))
    job = teach(*pictures(rig.rig, scene((sheet, table), (cover, face))), rig.rectification, None, "cover")
    found = {round(circle.radius_mm, 1) for circle in job.circles}
    assert {1.6, 2.2, 5.0} <= found, found


@pytest.mark.slow
def test_a_circle_a_little_off_the_face_of_the_largest_is_a_feature_too() -> None:
    """A boss 0.22 mm above the largest face is taught as a circle at its own height, to 0.03 mm."""
    rig = prepare(small_rig())
    face = lying(rig.rig, 0.0, 0.0, 0.0)
    raised = face.copy()
    raised[:3, 3] -= 0.22 * face[:3, 2]
    disc = Part("disc", Disc(0, 0, 13.0), Surface(albedo=0.6), (Hole("hole", Disc(-5.0, -4.0, 2.0), 0.05),))
    boss = Part("boss", Disc(4.0, 3.0, 4.0), Surface(albedo=0.3))
    job = teach(*pictures(rig.rig, scene((disc, face), (boss, raised))), rig.rectification, None, "disc")
    found = {round(circle.radius_mm, 1): circle.centre_mm[2] for circle in job.circles}
    assert {2.0, 4.0, 13.0} == set(found)
    assert found[13.0] - found[4.0] == pytest.approx(0.22, abs=0.03)


@pytest.mark.slow
def test_a_plate_without_circles_and_corners_is_taught_by_where_its_edges_would_meet() -> None:
    """Its corners are rounded by 4 mm, so no two edges meet; the reference is where the longest two would."""
    rig = prepare(small_rig())
    plate = Part("plate", RoundedBox(0, 0, 24, 18, 4.0), Surface(albedo=0.6))
    where = lying(rig.rig, 0.0, 0.0, 0.0)
    job = teach(*pictures(rig.rig, scene((plate, where))), rig.rectification, None, "plate")
    assert (0, 4, 1) == (len(job.circles), len(job.edges), len(job.corners))
    corner = np.abs((invert(where) @ job.rig_from_part)[:2, 3])
    np.testing.assert_allclose(corner, (12.0, 9.0), atol=0.02)


@pytest.mark.slow
def test_a_few_glints_do_not_hide_a_part() -> None:
    """Each camera sees glints elsewhere, stronger than any edge of the part, which is taught by its own."""
    rig = prepare(small_rig())
    where = lying(rig.rig, 0.0, 0.0, 0.0)
    corners = ((-12.0, -9.0), (12.0, -9.0), (12.0, 9.0), (-12.0, 9.0))
    plate = Part("plate", PolygonShape(corners), Surface(albedo=0.2))
    left, right = pictures(rig.rig, scene((plate, where), table=Surface(albedo=0.1)))
    outline = rig.rig.left.project(apply(where, np.array([(*corner, 0.0) for corner in corners])))
    low, high = outline.min(axis=0) - 15.0, outline.max(axis=0) + 15.0
    for picture, middle, down in ((left, outline.mean(axis=0), 25), (right, [480, 240], -20)):
        for k in range(-1, 2):
            place = (int(middle[0]) + 30 * k, int(middle[1]) + down)
            cv2.circle(picture, place, 8, 255, -1, cv2.LINE_AA)
    region = Region(*(float(value) for value in (*low, *(high - low))))
    job = teach(left, right, rig.rectification, region, "plate")
    assert len(job.edges) == 4
    assert float(job.rig_from_part[:3, 2] @ where[:3, 2]) > math.cos(math.radians(0.2))
