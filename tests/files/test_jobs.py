"""Job folders: a saved job reads back equal, every kind of damage is named, nothing is lost."""

from __future__ import annotations

import itertools
import math
import re
import shutil
import threading
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from edged.domain.picking import Bounds, Box, Order, Picking
from edged.errors import FileFormatError
from edged.files.arrays import pack_arrays
from edged.files.jobs import job_files, job_folders, job_of, load_job, save_job
from edged.vision.part.job import (
    CircleFeature,
    CornerFeature,
    EdgeFeature,
    Job,
    MeasurementSpec,
    ResultLimits,
    SlotFeature,
)
from edged.vision.part.traced import TracedCurve, to_arrays
from edged.vision.shape.model import ShapeLevel, ShapeModel
from edged.vision.shape.search import SearchParams

EVERY_OPTION = SearchParams(
    angle_start_rad=-0.5,
    angle_extent_rad=1.0,
    scale_min=0.8,
    scale_max=1.3,
    min_score=0.75,
    max_matches=5,
    max_overlap=0.25,
    polarity="local",
    min_contrast=3.5,
    scale_y_min=0.7,
    scale_y_max=1.1,
    sub_pixel="stretch",
    allow_partial=False,
)


def make_job(
    name: str = "flange",
    number: int = 3,
    limits: ResultLimits | None = None,
    search: SearchParams | None = None,
) -> Job:
    """A job with awkward numbers, made without images."""
    rng = np.random.default_rng(0)
    angles = rng.uniform(-np.pi, np.pi, (2, 60))
    levels = tuple(
        ShapeLevel(rng.normal(0, 50 / 2**k, (60, 2)), np.column_stack([np.cos(angles[k]), np.sin(angles[k])]))
        for k in range(2)
    )
    radius = float(np.linalg.norm(levels[0].points, axis=1).max())
    rig_from_part = np.eye(4)
    rig_from_part[:3, 3] = (1 / 3, -7e-13, 205.1)
    return Job(
        name,
        number,
        ShapeModel(levels, np.array([640.25, 1 / 7]), radius, 12.5),
        (
            CircleFeature("c0", np.zeros(3), 13.999787267214886, -1),
            CircleFeature("c1", np.array([0.1, 1e-17, -1 / 3]), 4.0, 1, double=True),
        ),
        "c0",
        rig_from_part,
        limits or ResultLimits((180.5, 230.0), radius_tolerance_mm=0.05),
        search or SearchParams(scale_min=1 / 1.12, scale_max=1 / 0.88, polarity="same"),
    )


def assert_same(one: Job, two: Job) -> None:
    """Check that all fields of both jobs are equal, arrays bit by bit."""
    assert (one.name, one.number, one.reference, one.limits) == (
        two.name,
        two.number,
        two.reference,
        two.limits,
    )
    assert np.array_equal(one.rig_from_part, two.rig_from_part)
    for a, b in zip(one.circles, two.circles, strict=True):
        assert (a.name, a.radius_mm, a.polarity, a.double) == (b.name, b.radius_mm, b.polarity, b.double)
        assert np.array_equal(a.centre_mm, b.centre_mm)
    arrays = two.shape.to_arrays()
    assert one.shape.to_arrays().keys() == arrays.keys()
    for key, array in one.shape.to_arrays().items():
        assert np.array_equal(array, arrays[key])
    for field in fields(SearchParams):
        value, other = getattr(one.search, field.name), getattr(two.search, field.name)
        assert value == (pytest.approx(other, rel=1e-5) if isinstance(other, float) else other)


@pytest.fixture(scope="module")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A saved job."""
    folder = tmp_path_factory.mktemp("jobs") / "flange"
    save_job(folder, make_job())
    return folder


@pytest.fixture
def folder(pristine: Path, tmp_path: Path) -> Path:
    """A copy that a test may damage."""
    return Path(shutil.copytree(pristine, tmp_path / "flange"))


def edit(folder: Path, pattern: str, replacement: str) -> None:
    """Change job.toml as a person might; the pattern must be there."""
    path = folder / "job.toml"
    text, count = re.subn(pattern, replacement, path.read_text(), count=1, flags=re.MULTILINE)
    assert count == 1
    path.write_text(text)


@pytest.mark.parametrize(
    ("limits", "search"), [(None, None), (ResultLimits((150.0, 151.0), form_tolerance_mm=0.1), EVERY_OPTION)]
)
def test_a_job_comes_back(tmp_path: Path, limits: ResultLimits | None, search: SearchParams | None) -> None:
    """A saved and loaded job has the same numbers, and saved again the same bytes of job.toml."""
    job = make_job(limits=limits, search=search)
    save_job(tmp_path / "jobs" / "one", job)
    loaded = load_job(tmp_path / "jobs" / "one")
    assert_same(job, loaded)
    save_job(tmp_path / "two", loaded)
    assert (tmp_path / "two" / "job.toml").read_bytes() == (
        tmp_path / "jobs" / "one" / "job.toml"
    ).read_bytes()


def traced_job() -> Job:
    """A job with two outlines that are no features."""
    points = np.array([[0.0, 0.5, 3.25], [1.0, 0.5, 3.25], [1.5, 2.0, 3.25]])
    return replace(make_job(), traced=(TracedCurve(points, 1), TracedCurve(-points[:2], -1)))


def test_outlines_that_are_no_features_come_back(tmp_path: Path) -> None:
    """Points and polarity of traced outlines read back equal."""
    save_job(tmp_path / "one", traced_job())
    found = load_job(tmp_path / "one").traced
    assert [(one.points_mm.tolist(), one.polarity) for one in found] == [
        (one.points_mm.tolist(), one.polarity) for one in traced_job().traced
    ]


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("points_mm", np.zeros((5, 2), np.float32), "traced_points_mm: float32 (5, 2), expected float32"),
        ("points_mm", np.zeros((5, 3)), "traced_points_mm: float64"),
        ("points_mm", np.full((5, 3), np.nan, np.float32), "traced_points_mm: expected up to 20000 within"),
        ("points_mm", np.zeros((5, 3), np.float32), "traced_points_mm: expected no point twice"),
        ("curves", np.array([[4, 1], [2, 1]], np.int32), "traced_curves: expected two points or more"),
        ("curves", np.array([[4, 1], [1, 1]], np.int32), "traced_curves: expected two points or more"),
        ("curves", np.array([[3, 1], [2, 0]], np.int32), "traced_curves: expected two points or more"),
        ("curves", np.array([[3, 1], [-3, 1]], np.int32), "traced_curves: expected two points or more"),
        ("curves", None, "traced_curves: missing"),
    ],
)
def test_damaged_outlines_are_named(tmp_path: Path, name: str, value: object, expected: str) -> None:
    """A damaged traced array is named with what was expected."""
    arrays = {"traced_" + key: array for key, array in to_arrays(traced_job().traced).items()}
    arrays["traced_" + name] = value
    arrays |= traced_job().shape.to_arrays()
    files = job_files(traced_job())
    shape = pack_arrays("edged-shape", 1, {key: one for key, one in arrays.items() if one is not None})
    with pytest.raises(FileFormatError, match=re.escape(expected)):
        job_of(files | {"shape.npz": shape}, tmp_path)


@pytest.mark.parametrize("order", [order for order in Order if order is not Order.POCKET])
def test_which_part_comes_first_comes_back(folder: Path, tmp_path: Path, order: Order) -> None:
    """Each order reads back; a job without one, as in older files, uses the score."""
    edit(folder, r'^order = "score"', f'order = "{order}"')
    save_job(tmp_path / "again", load_job(folder))
    assert order is load_job(tmp_path / "again").picking.order
    edit(folder, r"^\[picking\].*$", "")
    edit(folder, r"^order = .*$", "")
    assert Order.SCORE is load_job(folder).picking.order


def test_where_the_robot_may_go_comes_back(folder: Path, tmp_path: Path) -> None:
    """Boxes and keep-out zones read back; a job without them has none."""
    assert () == load_job(folder).picking.bounds
    box = Box("bin-1", (-1 / 3, 0.0, -1e-7), (100.0, 50.5, 1e5))
    bounds = (Bounds((box, replace(box, name="b2")), (replace(box, name="clamp"),)),)
    save_job(tmp_path / "one", replace(load_job(folder), picking=Picking(Order.TOPMOST, bounds)))
    assert Picking(Order.TOPMOST, bounds) == load_job(tmp_path / "one").picking


def test_a_box_without_room_is_named(folder: Path) -> None:
    """A zone without volume is refused with its file and place."""
    zone = '[[limits.keep_out]]\nname = "a"\nmin_mm = [0, 0, 5]\nmax_mm = [9, 9, 5]\n\n[search]'
    edit(folder, r"^\[search\]", zone)
    with pytest.raises(FileFormatError, match=r"job\.toml: limits\.keep_out\.0: min_mm .* must be less than"):
        load_job(folder)


GRASP = """[[grasp]]
name = "inner"
position_mm = [1.0, -2.5, 3]
rotation_deg = [10.0, -20.0, 30.0]
approach_mm = 40
symmetry = 3

[[grasp]]
name = "outer"
position_mm = [0, 0, 0]
retreat_mm = 7.5
"""


def test_how_a_tool_takes_the_part_comes_back(folder: Path, tmp_path: Path) -> None:
    """A grasp gets defaults for left-out keys, and reads back equal."""
    assert () == load_job(folder).picking.grasps
    edit(folder, r"^\[\[circle\]\]", GRASP + "\n[[circle]]")
    job = load_job(folder)
    inner, outer = job.picking.grasps
    expected = Rotation.from_euler("xyz", (10.0, -20.0, 30.0), degrees=True).as_matrix()
    np.testing.assert_allclose(inner.part_from_tcp[:3, :3], expected, atol=1e-12)
    np.testing.assert_allclose(inner.rig_from_tcp, job.rig_from_part @ inner.part_from_tcp, atol=1e-9)
    assert ([1.0, -2.5, 3.0], 40.0, 40.0, 3) == (
        inner.part_from_tcp[:3, 3].tolist(),
        inner.approach_mm,
        inner.retreat_mm,
        inner.symmetry,
    )
    assert ("outer", 50.0, 7.5, 1) == (outer.name, outer.approach_mm, outer.retreat_mm, outer.symmetry)
    assert np.array_equal(np.eye(4), outer.part_from_tcp)
    save_job(tmp_path / "again", job)
    for one, two in zip(load_job(tmp_path / "again").picking.grasps, job.picking.grasps, strict=True):
        assert (one.name, one.approach_mm, one.retreat_mm, one.symmetry) == (
            two.name,
            two.approach_mm,
            two.retreat_mm,
            two.symmetry,
        )
        np.testing.assert_allclose(one.part_from_tcp, two.part_from_tcp, atol=1e-12)


@pytest.mark.parametrize(
    ("pattern", "replacement", "expected"),
    [
        (r'^name = "outer"', 'name = "inner"', "two grasps have one name"),
        (r"^symmetry = 3", "symmetry = -1", r"grasp\.0\.symmetry: expected at least 0"),
        (r"^symmetry = 3", "symmetry = 2.5", r"grasp\.0\.symmetry"),
        (r"^approach_mm = 40", "approach_mm = -1", r"grasp\.0\.approach_mm: expected at least 0"),
        (r"^retreat_mm = 7.5", "retreat_mm = inf", r"grasp\.1\.retreat_mm"),
        (r"^rotation_deg = .*", "rotation_deg = [0, 0]", r"grasp\.0\.rotation_deg"),
        (r"^position_mm = \[0.*", "position_mm = [0, 0, 1e9]", r"grasp\.1\.position_mm\.2"),
        (r"^position_mm = \[0.*", "", r"grasp\.1\.position_mm: missing"),
        (r"^approach_mm = 40", "aproach_mm = 40", r"grasp\.0\.aproach_mm: unknown key"),
    ],
)
def test_a_mistake_in_a_grasp_is_named(folder: Path, pattern: str, replacement: str, expected: str) -> None:
    """A wrong grasp is refused with file, number, key and what was expected."""
    edit(folder, r"^\[\[circle\]\]", GRASP + "\n[[circle]]")
    edit(folder, pattern, replacement)
    with pytest.raises(FileFormatError, match=rf"job\.toml: .*{expected}"):
        load_job(folder)


TRAY = """
[picking.tray]
first_mm = [400, 50, 700]
columns = 4
row_end_mm = [520, 50, 700]
rows = 2
column_end_mm = [400, 80, 700]
tolerance_mm = 12
"""


def test_a_tray_comes_back(folder: Path, tmp_path: Path) -> None:
    """A tray reads back as it was written, also without a direction with one pocket."""
    edit(folder, r'^order = "score".*$', 'order = "pocket"' + TRAY)
    edit(folder, r"^max_matches = .*$", "max_matches = 8")
    job = load_job(folder)
    tray = job.picking.tray
    assert tray is not None
    assert (Order.POCKET, (4, 2, 1), 8, 12.0) == (
        job.picking.order,
        tray.counts,
        tray.pockets,
        tray.tolerance_mm,
    )
    assert ((520.0, 50.0, 700.0), (400.0, 80.0, 700.0), tray.first_mm) == tray.ends_mm
    save_job(tmp_path / "again", job)
    assert job.picking.tray == load_job(tmp_path / "again").picking.tray


@pytest.mark.parametrize(
    ("pattern", "replacement", "expected"),
    [
        (r"^columns = 4", "", "row_end_mm is where columns end"),
        (r"^row_end_mm = .*$", "", "row_end_mm is where columns end"),
        (r"^columns = 4", "columns = 60", "at most 64 pockets, this one has 120"),
        (r"^columns = 4", "columns = 6", "max_matches is 8, and a layer of the tray has 12 pockets"),
        (r"^tolerance_mm = 12", "tolerance_mm = 16", "pockets are 30 mm apart"),
        (r"^column_end_mm = .*$", "column_end_mm = [400, 50, 700]", "pockets are 0 mm apart"),
        (r"^first_mm = .*$", "first_mm = [400, 50]", r"picking\.tray\.first_mm"),
        (r"^rows = 2", "rows = 2\nlines = 3", r"picking\.tray\.lines: unknown key"),
    ],
)
def test_a_mistake_in_a_tray_is_named(folder: Path, pattern: str, replacement: str, expected: str) -> None:
    """A wrong tray is refused with the file and what was expected."""
    edit(folder, r'^order = "score".*$', 'order = "pocket"' + TRAY)
    edit(folder, r"^max_matches = .*$", "max_matches = 8")
    edit(folder, pattern, replacement)
    with pytest.raises(FileFormatError, match=rf"job\.toml: .*{expected}"):
        load_job(folder)


def test_pockets_are_an_order_of_a_tray_alone(folder: Path) -> None:
    """The order "pocket" without a tray is refused."""
    edit(folder, r'^order = "score"', 'order = "pocket"')
    with pytest.raises(FileFormatError, match=r"needs \[picking\.tray\]"):
        load_job(folder)


def test_an_order_that_does_not_exist_is_named(folder: Path) -> None:
    """An unknown order is refused with the file, the place, the known ones and what was found."""
    edit(folder, r'^order = "score"', 'order = "rightmost"')
    with pytest.raises(
        FileFormatError, match=r"job\.toml: picking\.order: expected 'score', .* got 'rightmost'"
    ):
        load_job(folder)


def test_how_far_a_part_may_lie_tilted_comes_back(folder: Path, tmp_path: Path) -> None:
    """A tilt reads back; a job without one, as in older files, has none, and it may be added."""
    assert load_job(folder).tilt_rad is None
    edit(folder, r"^# tilt_deg = 45", "tilt_deg = 37.5")
    tilted = load_job(folder)
    assert tilted.tilt_rad == pytest.approx(math.radians(37.5), rel=1e-12)
    save_job(tmp_path / "again", tilted)
    assert load_job(tmp_path / "again").tilt_rad == pytest.approx(math.radians(37.5), rel=1e-5)
    edit(folder, r"^tilt_deg = .*$", "")
    assert load_job(folder).tilt_rad is None


@pytest.mark.parametrize("beside", ['sub_pixel = "similarity"', "scale_y = [0.9, 1.1]"])
def test_a_tilt_stands_alone(folder: Path, beside: str) -> None:
    """A tilt together with a setting that contradicts it is refused with both names."""
    key = beside.partition(" ")[0]
    edit(folder, rf"^(# )?{key} = [^#\n]*", beside + "  ")
    assert load_job(folder)
    edit(folder, r"^# tilt_deg = 45", "tilt_deg = 45")
    with pytest.raises(FileFormatError, match=rf"tilt_deg.*{key}"):
        load_job(folder)


def featured() -> Job:
    """A job with one feature of each kind and a measurement of each kind."""
    edges = (
        EdgeFeature("e0", np.array([0.0, 1 / 3, 0.1]), np.array([9.0, 1 / 3, 0.1]), 1),
        EdgeFeature("e1", np.array([9.0, 0.0, 0.1]), np.array([9.1, 7.0, 0.1]), -1),
    )
    return replace(
        make_job(),
        edges=edges,
        slots=(SlotFeature("s0", np.array([1 / 7, 2.0, 0.0]), math.radians(30.0), 9.0, 4.0, 1),),
        corners=(CornerFeature("k0", ("e0", "e1")),),
        reference="k0",
        measurements=(
            MeasurementSpec("r", "radius", ("c1",), 4.0, 0.01),
            MeasurementSpec("l", "distance", ("c0", "k0"), 42.0),
            MeasurementSpec("square", "angle", ("e0", "e1"), math.radians(90.0), math.radians(0.5)),
            MeasurementSpec("w", "width", ("s0",)),
            MeasurementSpec("len", "length", ("s0",), 9.0, 0.05),
            MeasurementSpec("flat", "flatness", (), None, 0.02),
        ),
        witness="l",
    )


def test_all_features_and_measurements_come_back(tmp_path: Path) -> None:
    """Edges, slots, corners, sizes and the witness read back equal; angles go through degrees."""
    job = featured()
    save_job(tmp_path / "job", job)
    again = load_job(tmp_path / "job")
    assert (again.reference, again.witness, again.corners) == ("k0", "l", job.corners)
    for one, two in zip(again.edges, job.edges, strict=True):
        assert (one.name, one.polarity) == (two.name, two.polarity)
        assert np.array_equal(one.start_mm, two.start_mm)
        assert np.array_equal(one.end_mm, two.end_mm)
    (one,), (two,) = again.slots, job.slots
    assert (one.name, one.length_mm, one.width_mm, one.polarity) == ("s0", 9.0, 4.0, two.polarity)
    assert one.angle_rad == pytest.approx(two.angle_rad)
    for spec, other in zip(again.measurements, job.measurements, strict=True):
        assert (spec.name, spec.kind, spec.of) == (other.name, other.kind, other.of)
        for value, wanted in ((spec.nominal, other.nominal), (spec.tolerance, other.tolerance)):
            assert (value is None) == (wanted is None)
            assert value is None or value == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("pattern", "replacement", "expected"),
    [
        (r'^edges = \["e0", "e1"\]$', 'edges = ["e0", "e7"]', "'e7' is none of the edges"),
        (r"^end_mm = \[9\.1, 7.*$", "end_mm = [5.0, 0.0, 0.1]", "parallel"),
        (r"^end_mm = \[9\.1, 7.*$", "end_mm = [9.0, 0.0, 0.1]", r"edge\.1.*apart"),
        (r"^end_mm = \[9\.1, 7.*$", "end_mm = [9.1, 7.0, 4.0]", r"edge\.1.*one height"),
        (r"^width_mm = .*$", "width_mm = 9.5", r"slot\.0.*must exceed"),
        (r"^reference = .*$", 'reference = "e0"', "none of the circles, slots and corners"),
        (r"^witness = .*$", 'witness = "x"', "witness 'x' is none of the measurements"),
        (r"^witness = .*$", 'witness = "square"', "witness 'square' must be a length"),
        (r'^of = \["c0", "k0"\]$', 'of = ["c0"]', "must name 2 features"),
        (r'^of = \["c0", "k0"\]$', 'of = ["c0", "c0"]', "must name 2 features"),
        (r'^of = \["c1"\]$', 'of = ["s0"]', "'s0' is no circle"),
        (r"^nominal_deg = .*$", "nominal_mm = 90.0", "nominal_deg"),
        (r"^nominal_deg = .*$", "", "tolerance_deg needs nominal_deg"),
        (r'^name = "len"$', 'name = "w"', "two measurements"),
    ],
)
def test_a_mistake_in_a_feature_is_named(
    tmp_path: Path, pattern: str, replacement: str, expected: str
) -> None:
    """A feature with an unknown reference, without size, or with the wrong kind of measurement is refused."""
    save_job(tmp_path / "flange", featured())
    edit(tmp_path / "flange", pattern, replacement)
    with pytest.raises(FileFormatError, match=expected):
        load_job(tmp_path / "flange")


def test_people_may_edit_limits(folder: Path) -> None:
    """Edited limits are used, also with comments and left-out defaults."""
    edit(folder, r"^max_sigma_mm = .*$", "max_sigma_mm = 0.01  # tight")
    edit(folder, r"^max_rms_px = .*$", "")
    edit(folder, r"^angle_extent_deg = .*$", "angle_extent_deg = 90")
    job = load_job(folder)
    assert job.limits.max_sigma_mm == 0.01
    assert job.limits.max_rms_px == 0.5
    assert job.search.angle_extent_rad == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("pattern", "replacement", "expected"),
    [
        (r"^format = .*$", 'format = "edged-rig"', "format"),
        (r"^version = .*$", "version = 2", "version"),
        (r"^name = .*$", 'name = "../evil"', "name"),
        (r"^number = .*$", "number = 0", "number"),
        (r"^number = .*$", "number = 70000", "number"),
        (r"^number = .*$", "", "number"),
        (r"^reference = .*$", 'reference = "c9"', "c9"),
        (r"^min_score = .*$", "min_score = 1.5", r"search\.min_score"),
        (r"^min_score = .*$", "min_score = nan", r"search\.min_score"),
        (r"^min_scores? = .*$", "min_skore = 0.5", r"search\.min_skore"),
        (r"^scale = .*$", "scale = [1.2, 0.8]", r"search.*scale"),
        (r"^scale = .*$", "scale = [1.2]", r"search\.scale"),
        (r"^# scale_y = .*$", "scale_y = [1.2, 1.0]", r"search.*scale_y"),
        (r"^sub_pixel = .*$", 'sub_pixel = "exact"', r"search\.sub_pixel"),
        (r"^# tilt_deg = 45", "tilt_deg = 0", r"search\.tilt_deg"),
        (r"^# tilt_deg = 45", "tilt_deg = 45.1", r"search\.tilt_deg"),
        (r"^# tilt_deg = 45", "tilt_deg = nan", r"search\.tilt_deg"),
        (r"^polarity = \"same\".*$", 'polarity = "any"', r"search\.polarity"),
        (r"^depth_mm = .*$", "depth_mm = [230, 180]", r"limits.*depth_mm"),
        (r"^depth_mm = .*$", "depth_mm = [0, inf]", r"limits\.depth_mm"),
        (r"^max_rms_px = .*$", "max_rms_px = -1", r"limits\.max_rms_px"),
        (r"^max_rms_px = .*$", 'max_rms_px = "wide"', r"limits\.max_rms_px"),
        (r"^radius_mm = .*$", "radius_mm = 0", r"circle\.0\.radius_mm"),
        (r"^name = \"c1\"$", 'name = "c0"', "two features"),
        (r"^polarity = -1$", "polarity = 0", r"circle\.0\.polarity"),
        (r"^centre_mm = .*$", "centre_mm = [1, 2]", r"circle\.0\.centre_mm"),
        (r"^    \[1\.0, 0\.0, 0\.0,", "    [1.1, 0.0, 0.0,", "rig_from_part"),
        (r"^    \[1\.0, 0\.0, 0\.0,", "    [1.0, 0.0,", "rig_from_part"),
        (r"^\[search\].*$", "[search", "TOML"),
        (r"^reference = .*$", "reference = " + "[" * 20_000, "TOML"),
    ],
)
def test_a_mistake_is_named(folder: Path, pattern: str, replacement: str, expected: str) -> None:
    """The message has the file, the dotted field, and what was wrong."""
    edit(folder, pattern, replacement)
    with pytest.raises(FileFormatError, match=expected) as caught:
        load_job(folder)
    assert str(folder / "job.toml") in str(caught.value)


def test_several_mistakes_are_named_at_once(folder: Path) -> None:
    """All mistakes in a job are named together."""
    edit(folder, r"^min_score = .*$", "min_score = 7")
    edit(folder, r"^max_sigma_mm = .*$", "max_sigma_mm = 0")
    with pytest.raises(FileFormatError, match=r"(?s)limits\.max_sigma_mm.*search\.min_score"):
        load_job(folder)


def test_missing_and_foreign_files_are_named(folder: Path, tmp_path: Path) -> None:
    """A missing folder, a file in its place, a missing job.toml or shape, and a file that is no text are
    named."""
    with pytest.raises(FileFormatError, match="nowhere: no such job folder"):
        load_job(tmp_path / "nowhere")
    with pytest.raises(FileFormatError, match="no such job folder"):
        load_job(folder / "job.toml")
    (folder / "shape.npz").rename(folder / "elsewhere.npz")
    with pytest.raises(FileFormatError, match=r"shape\.npz"):
        load_job(folder)
    (folder / "elsewhere.npz").rename(folder / "shape.npz")
    (folder / "job.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileFormatError, match=r"job\.toml: line 1: not UTF-8"):
        load_job(folder)
    (folder / "job.toml").unlink()
    with pytest.raises(FileFormatError, match=r"job\.toml: cannot read"):
        load_job(folder)


@pytest.mark.long
@settings(max_examples=150)
@given(data=st.data())
def test_a_damaged_shape_is_an_error_or_the_same_shape(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Bytes changed, cut off or inserted anywhere give an error with the file's name, or the same shape."""
    base = tmp_path_factory.getbasetemp() / "fuzzed"
    if not base.exists():
        save_job(base, make_job())
        shutil.copy(base / "shape.npz", base / "good.npz")
    good = (base / "good.npz").read_bytes()
    place = data.draw(st.integers(0, len(good) - 1))
    how = data.draw(st.sampled_from(["change", "cut", "insert", "drop"]))
    junk = data.draw(st.binary(min_size=1, max_size=40))
    bad = {
        "change": good[:place] + junk + good[place + len(junk) :],
        "cut": good[:place],
        "insert": good[:place] + junk + good[place:],
        "drop": good[:place] + good[place + len(junk) :],
    }[how]
    (base / "shape.npz").write_bytes(bad)
    try:
        job = load_job(base)
    except FileFormatError as error:
        assert str(base / "shape.npz") in str(error)
    else:
        assert_same(job, make_job())


@pytest.mark.long
@settings(max_examples=80)
@given(text=st.text(max_size=200), place=st.integers(0, 1500))
def test_a_damaged_job_file_is_an_error_or_a_job(
    text: str, place: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Any text anywhere in job.toml gives a `FileFormatError` with the file's name, or a valid job."""
    base = tmp_path_factory.getbasetemp() / "scribbled"
    if not base.exists():
        save_job(base, make_job())
        shutil.copy(base / "job.toml", base / "good.toml")
    good = (base / "good.toml").read_text()
    (base / "job.toml").write_bytes((good[:place] + text + good[place:]).encode("utf-8", "surrogatepass"))
    try:
        assert isinstance(load_job(base), Job)
    except FileFormatError as error:
        assert "job.toml" in str(error)


def test_every_older_job_is_kept(tmp_path: Path) -> None:
    """Saving keeps each former job beside the new one, the latest with the highest number."""
    kept = [save_job(tmp_path / "flange", make_job(number=number)) for number in (1, 2, 3, 4)]
    names = ["flange.old", "flange.2.old", "flange.3.old"]
    assert [None, *(tmp_path / name for name in names)] == kept
    assert [1, 2, 3] == [load_job(tmp_path / name).number for name in names]
    assert load_job(tmp_path / "flange").number == 4
    assert job_folders(tmp_path) == [tmp_path / "flange"]


def test_a_job_that_is_saved_again_as_it_is_makes_no_generation(tmp_path: Path) -> None:
    """Saving an unchanged job makes no generation."""
    for _ in range(3):
        assert save_job(tmp_path / "flange", make_job()) is None
    assert [path.name for path in tmp_path.iterdir()] == ["flange"]


def test_no_job_is_saved_under_a_name_that_is_not_read(tmp_path: Path) -> None:
    """A job cannot be saved under a name that ends in .old, which a cell does not read."""
    with pytest.raises(FileFormatError, match=r"flange\.old: what ends in \.old is a job that was replaced"):
        save_job(tmp_path / "flange.old", make_job())
    assert [] == [*tmp_path.iterdir()]


def test_a_former_job_is_put_back_as_the_manual_says(tmp_path: Path) -> None:
    """The manual's two commands put a former job back, and today's becomes the latest generation."""
    for number in (1, 2, 3):
        save_job(tmp_path / "jobs" / "flange", make_job(number=number))
    manual = (Path(__file__).parents[2] / "docs/how-to/recover.md").read_text()
    moves = re.findall(
        r"^sudo mv /etc/edged/(jobs/flange\S*) /etc/edged/(jobs/flange\S*)", manual, re.MULTILINE
    )
    assert 2 == len(moves)
    for source, target in moves:
        (tmp_path / source).rename(tmp_path / target)

    assert load_job(tmp_path / "jobs" / "flange").number == 2
    assert {"flange", "flange.old", "flange.3.old"} == {path.name for path in (tmp_path / "jobs").iterdir()}
    assert load_job(tmp_path / "jobs" / "flange.3.old").number == 3


def test_what_is_no_job_is_not_overwritten(tmp_path: Path) -> None:
    """A folder with other things in it, or a file, is not overwritten."""
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.png").write_bytes(b"meow")
    (tmp_path / "file").write_text("text")
    for name in ("photos", "file"):
        with pytest.raises(FileFormatError, match=f"{name}: exists and is not a job folder"):
            save_job(tmp_path / name, make_job())
    with pytest.raises(FileFormatError, match="is a file, expected a folder"):
        save_job(tmp_path / "file" / "flange", make_job())
    assert (tmp_path / "photos" / "cat.png").read_bytes() == b"meow"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "photos"]


def test_a_save_that_fails_leaves_the_old_job(folder: Path) -> None:
    """If the shape cannot be written, the former job is untouched and no other file is left."""
    broken = replace(make_job(number=9), shape=None)
    with pytest.raises(AttributeError):
        save_job(folder, broken)
    assert load_job(folder).number == 3
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


def test_the_folder_may_be_the_working_directory(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A job can be saved to the working directory."""
    monkeypatch.chdir(folder)
    save_job(Path(), make_job(number=5))
    assert load_job(folder).number == 5


@pytest.mark.long
def test_a_job_is_read_whole_while_it_is_saved(tmp_path: Path) -> None:
    """While a job is saved repeatedly text and shape that are read belong to one job."""
    folder = tmp_path / "flange"
    jobs = {}
    for number in (1, 2):
        job = make_job(number=number)
        jobs[number] = replace(job, shape=replace(job.shape, contrast=10.0 + number))
    save_job(folder, jobs[1])
    stopped = threading.Event()

    def teach() -> None:
        for number in itertools.cycle(jobs):
            if stopped.is_set():
                return
            save_job(folder, jobs[number])

    teacher = threading.Thread(target=teach)
    teacher.start()
    try:
        read = [load_job(folder) for _ in range(300)]
    finally:
        stopped.set()
        teacher.join()

    assert {1, 2} == {job.number for job in read}
    assert [] == [job.number for job in read if job.shape.contrast != 10.0 + job.number]
