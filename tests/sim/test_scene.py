"""The renderer: its optics, its outlines, its sensor; and the virtual cell around it."""

from __future__ import annotations

import math
from dataclasses import replace
from statistics import NormalDist

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naive import sim as naive

from edged.domain.arrays import FloatArray
from edged.errors import ImageError
from edged.sim.cell import PAIR_WINDOW_NS, SIDES, PartMotion, VirtualCell, demo_part, demo_rig
from edged.sim.exposure import ExposureRequest
from edged.sim.render import lens, raster
from edged.sim.render.scene import (
    Checker,
    Disc,
    DiscGrid,
    Hole,
    PaintedMark,
    Part,
    PlacedPart,
    PolygonShape,
    RenderedView,
    RoundedBox,
    Scene,
    SceneLight,
    Sensor,
    Slot,
    Surface,
    Table,
    chessboard_plate,
    dots_plate,
    extent_mm,
)
from edged.sim.views import calibration_views, stereo_views
from edged.vision.geometry.camera import CameraModel
from edged.vision.geometry.rigid import rotation_matrix

DIVISION = CameraModel("division", 1280, 960, 3183.6, 3180.1, 645.8, 478.1, (-0.2416,))
BROWN = CameraModel("brown", 1280, 960, 3183.6, 3180.1, 645.8, 478.1, (-0.21, 0.14, 5e-4, -4e-4, 0.02))
SHARP = Sensor(psf_sigma_px=0.0)


def pose(x: float, y: float, z: float, rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> FloatArray:
    """rig_from_something from a place in mm and a rotation vector."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_matrix(np.array(rotation))
    matrix[:3, 3] = (x, y, z)
    return matrix


def on_black(part: Part, rig_from_part: FloatArray) -> Scene:
    """A part on a black table."""
    return Scene(Table(Surface(0.0), pose(0, 0, 300)), (PlacedPart(part, rig_from_part),))


# --- optics ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("camera", [DIVISION, BROWN])
def test_lenses_agree_with_the_pipelines(camera: CameraModel) -> None:
    """The renderer's lens and the pipeline's are the same in both directions, to 1e-9 px."""
    y, x = np.mgrid[0:960:37, 0:1280:41].astype(float)
    pixels = np.stack([x, y], axis=-1)
    rays = lens.rays_of_pixels(camera, pixels)
    np.testing.assert_allclose(rays * camera.fx, camera.normalise(pixels) * camera.fx, rtol=0, atol=1e-9)
    np.testing.assert_allclose(lens.pixels_of_rays(camera, rays), camera.pixels(rays), rtol=0, atol=1e-9)
    np.testing.assert_allclose(lens.pixels_of_rays(camera, rays), pixels, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_lens_that_folds_is_refused() -> None:
    """A lens without a single ray for each pixel is refused."""
    with pytest.raises(ValueError, match="folds"):
        RenderedView(replace(BROWN, distortion=(-40.0, 0.0, 0.0, 0.0, 0.0)), np.eye(4))


# --- outlines --------------------------------------------------------------------------------------


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1))
@settings(max_examples=100)
def test_half_plane_coverage_is_the_area(distance: float, slope_x: float, slope_y: float) -> None:
    """The closed form equals a count of points in a pixel, and both sides of a line fill it."""
    slope_x, slope_y = slope_x + 0.2, slope_y + 0.1  # the count needs a line that is not all of the cell
    covered = raster.half_plane_coverage(distance, slope_x, slope_y)
    if math.hypot(slope_x, slope_y) > 0.05:
        assert covered == pytest.approx(naive.half_plane_coverage(distance, slope_x, slope_y), abs=0.005)
    assert covered + raster.half_plane_coverage(-distance, slope_x, slope_y) == pytest.approx(1.0)


EVERY_SHAPE = [
    Disc(0.4, -0.3, 2.1),
    Slot(0.3, 0.2, 4.2, 1.7, 0.7),
    RoundedBox(-0.2, 0.1, 4.5, 2.5, 0.6, -0.4),
    RoundedBox(0.2, 0.1, 2.5, 3.5),
    PolygonShape(((-2.0, -1.5), (2.2, -1.0), (0.4, 0.1), (1.5, 2.0), (-1.6, 1.2))),
    Checker(-1.5, -1.0, 0.7, 4, 3),
    DiscGrid(-1.2, -0.8, 0.35, 1.1, 3, 2),
]


def small_view() -> RenderedView:
    """A few pixels in a slanted view of (0, 0, 60) in the rig's frame."""
    camera = CameraModel("division", 32, 26, 300.0, 300.0, 15.0, 13.0, (-0.3,))
    camera_from_rig = pose(0, 0, 0, (0.1, 0.4, 0.1))
    camera_from_rig[:3, 3] = (0, 0, 60) - camera_from_rig[:3, :3] @ (0, 0, 60)
    return RenderedView(camera, camera_from_rig, SHARP)


def supersampled(view: RenderedView, scene: Scene, n: int = 8) -> FloatArray:
    """(H, W) mean of n x n rays per pixel through the naive renderer; the light must be even."""
    world = Scene(
        Table(scene.table.surface, view.camera_from_rig @ scene.table.rig_from_table),
        tuple(PlacedPart(placed.part, view.camera_from_rig @ placed.rig_from_part) for placed in scene.parts),
        scene.light,
    )
    offsets = (np.arange(n) + 0.5) / n - 0.5
    image = np.empty((view.camera.height, view.camera.width))
    for y, x in np.ndindex(image.shape):
        pixels = np.array([(x + dx, y + dy) for dy in offsets for dx in offsets])
        image[y, x] = np.mean([naive.radiance_at(world, ray) for ray in view.camera.normalise(pixels)])
    return image


@pytest.mark.long
@pytest.mark.parametrize("shape", EVERY_SHAPE, ids=lambda shape: type(shape).__name__)
def test_every_shape_covers_what_it_should(shape: object) -> None:
    """A rendered shape equals dense sampling of its definition, pixel by pixel."""
    view = small_view()
    scene = on_black(Part("part", shape, Surface(1.0)), pose(0.3, 0.1, 60.0, (0.1, 0.2, 0.5)))
    expected = supersampled(view, scene)
    assert 0.05 < expected.mean() < 0.9
    error = view.radiance(scene) - expected
    # 8 x 8 points know the area of a pixel that an edge cuts to half a row of them at worst
    assert np.abs(error).max() < 0.08
    assert np.sqrt(np.mean(error**2)) < 0.012
    assert abs(error.mean()) < 1e-3


@pytest.mark.long
def test_layers_marks_and_holes_are_painted_in_order() -> None:
    """Later parts hide earlier ones, marks lie on the face, holes show a darkened background."""
    lower = Part(
        "lower",
        RoundedBox(0, 0, 5, 4, 0.5),
        Surface(0.5),
        (Hole("h", Disc(-1, 0, 0.8), 0.4),),
        (PaintedMark(RoundedBox(1, 1, 1.5, 1), 0.9),),
    )
    upper = Part("upper", Disc(0, 0, 1.4), Surface(0.7), (Hole("s", Slot(0, 0, 1.6, 0.7, 0.3), 0.6),))
    scene = Scene(
        Table(Surface(0.2), pose(0, 0, 64)),
        (PlacedPart(lower, pose(0, 0, 62, (0.05, 0, 0.2))), PlacedPart(upper, pose(-0.8, 0.6, 60))),
        SceneLight(1.2),
    )
    view = small_view()
    expected = supersampled(view, scene)
    assert len(np.unique(np.round(expected, 6))) > 50
    error = view.radiance(scene) - expected
    assert np.abs(error).max() < 0.06
    assert abs(error.mean()) < 1e-3


def test_what_lies_still_is_seen_as_if_for_the_first_time() -> None:
    """A second picture of an unchanged scene is as the first; one with a moved, darker or other part is
    not."""
    disc = Part("p", Disc(0, 0, 2), Surface(0.5, 0.2))
    first = on_black(disc, pose(0.3, 0.1, 60))
    others = (
        on_black(disc, pose(0.3, 0.1, 60.01)),
        on_black(replace(disc, surface=Surface(0.5, 0.2, seed=1)), pose(0.3, 0.1, 60)),
        replace(first, light=SceneLight(0.8)),
    )
    view = small_view()
    for scene in (first, *others):
        for seen in (on_black(disc, pose(0.3, 0.1, 60)), scene, replace(scene)):
            assert np.array_equal(small_view().radiance(seen), view.radiance(seen))
            assert np.array_equal(small_view().render(seen), view.render(seen))
        assert scene is first or not np.array_equal(view.radiance(first), view.radiance(scene))


def test_the_light_may_fall_off() -> None:
    """The irradiance depends on the place in the rig's frame, on every layer."""
    scene = replace(
        on_black(Part("p", Disc(0, 0, 2), Surface(0.5)), pose(0.3, 0.1, 60, (0.1, 0.2, 0.5))),
        light=SceneLight(0.8, (0.1, -0.05)),
    )
    view = RenderedView(small_view().camera, np.eye(4), SHARP)
    for x, y in ((19, 16), (25, 20), (14, 18)):
        expected = naive.radiance_at(scene, view.camera.normalise(np.array([x, y], float)))
        assert view.radiance(scene)[y, x] == pytest.approx(expected, rel=1e-6)


def outline_px(view: RenderedView, disc: Disc, rig_from_part: FloatArray) -> FloatArray:
    """(N, 2) dense points of the exact image of a circle."""
    angles = np.linspace(0, 2 * np.pi, 100_001)
    rim = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], -1) * disc.radius_mm
    rim += np.array([disc.x_mm, disc.y_mm, 0.0])
    return view.project(rim @ rig_from_part[:3, :3].T + rig_from_part[:3, 3])


@pytest.mark.slow
@pytest.mark.parametrize("radius_mm", [0.9, 4.0, 14.0])
def test_edges_are_where_they_project_to(radius_mm: float) -> None:
    """Row by row the left and the right edge of a rendered disc lie on its projected outline to 0.003 px."""
    view = stereo_views(demo_rig(), SHARP)["right"]
    disc, place = Disc(2.0, -1.0, radius_mm), pose(9, 1, 204, (0.03, -0.04, 1.0))
    image = view.radiance(on_black(Part("disc", disc, Surface(1.0)), place)).astype(np.float64)
    curve = outline_px(view, disc, place)
    top, bottom = curve[:, 1].argmin(), curve[:, 1].argmax()
    first, last = sorted((top, bottom))
    middle = round(float(curve[:, 0].mean()))
    for branch in (curve[first : last + 1], np.concatenate([curve[last:-1], curve[: first + 1]])):
        if branch[0, 1] > branch[-1, 1]:
            branch = branch[::-1]
        # ∫ x dy along the outline within each row of pixels, by the trapezium rule
        area = np.concatenate([[0], np.cumsum(np.diff(branch[:, 1]) * (branch[1:, 0] + branch[:-1, 0]) / 2)])
        rows = np.arange(math.ceil(branch[0, 1] + 1), math.floor(branch[-1, 1] - 1))
        at = np.interp(np.stack([rows - 0.5, rows + 0.5]), branch[:, 1], area)
        exact = at[1] - at[0]
        is_left = branch[:, 0].mean() < middle
        covered = image[rows, :middle].sum(axis=1) if is_left else image[rows, middle:].sum(axis=1)
        rendered = middle - 0.5 - covered if is_left else middle - 0.5 + covered
        steep = np.abs(np.interp(rows, branch[:, 1], np.gradient(branch[:, 0], branch[:, 1]))) < 1
        assert steep.sum() > 0.6 * rows.size
        assert np.abs(rendered - exact)[steep].max() < 0.003


@pytest.mark.parametrize("sensor", [SHARP, Sensor()])
def test_moments_of_a_disc_are_exact(sensor: Sensor) -> None:
    """Area and centroid of a rendered disc are those of its projected outline, with any blur."""
    view = stereo_views(demo_rig(), sensor)["left"]
    disc, place = Disc(0, 0, 14.0), pose(9, 1, 204, (0.03, -0.04, 1.0))
    image = view.radiance(on_black(Part("disc", disc, Surface(1.0)), place)).astype(np.float64)
    x, y = (outline_px(view, disc, place) - (700, 500)).T
    cross = x[:-1] * y[1:] - x[1:] * y[:-1]
    area = cross.sum() / 2
    centroid = (((x[:-1] + x[1:]) * cross).sum() / 6 / area, ((y[:-1] + y[1:]) * cross).sum() / 6 / area)
    perimeter = np.hypot(np.diff(x), np.diff(y)).sum()
    assert abs(image.sum() - abs(area)) / perimeter < 2e-4  # mean displacement of the edge in px
    found = ((image.sum(axis=0) @ (np.arange(1280) - 700)), (image.sum(axis=1) @ (np.arange(960) - 500)))
    np.testing.assert_allclose(np.array(found) / image.sum(), centroid, rtol=0, atol=2e-4)


@pytest.mark.parametrize(("psf_sigma_px", "within"), [(0.3, 0.01), (0.6, 0.003), (1.5, 0.0006)])
@pytest.mark.parametrize("turn_rad", [0.0, 0.01, 0.4, math.pi / 2])
def test_an_edge_is_blurred_before_pixels_sample_it(
    psf_sigma_px: float, within: float, turn_rad: float
) -> None:
    """Each pixel at a straight edge has the blurred edge's mean over its area."""
    camera = CameraModel("division", 48, 40, 900.0, 900.0, 23.3, 19.6, (0.0,))
    view = RenderedView(camera, np.eye(4), Sensor(psf_sigma_px=psf_sigma_px))
    ahead = np.array([math.cos(turn_rad), math.sin(turn_rad)])
    half_plane = Part("edge", RoundedBox(-20.0, 0.0, 40.0, 60.0), Surface(1.0))
    place = pose(0.137, -0.071, 90, (0.0, 0.0, turn_rad))
    image = view.radiance(on_black(half_plane, place))
    nodes, weights = np.polynomial.legendre.leggauss(12)
    x, y = np.meshgrid(np.arange(48.0), np.arange(40.0))
    edge = view.project(place[:3, 3])
    normal = NormalDist(sigma=psf_sigma_px)
    exact = np.zeros((40, 48))
    for v, across in zip(nodes / 2, weights / 2, strict=True):
        for u, along in zip(nodes / 2, weights / 2, strict=True):
            beyond = (x + u - edge[0]) * ahead[0] + (y + v - edge[1]) * ahead[1]
            exact += across * along * np.vectorize(normal.cdf)(-beyond)
    np.testing.assert_allclose(image, exact, rtol=0, atol=within)


def test_the_blur_sees_beyond_the_border() -> None:
    """A smaller sensor's picture is a window of a larger one's, up to its last pixel."""
    large = RenderedView(CameraModel("division", 120, 100, 900.0, 900.0, 60.0, 50.0, (-0.2,)), np.eye(4))
    small = RenderedView(CameraModel("division", 60, 50, 900.0, 900.0, 40.0, 30.0, (-0.2,)), np.eye(4))
    scene = Scene(
        Table(Surface(0.4, 0.3, 1.0), pose(0, 0, 100)), (PlacedPart(demo_part(), pose(-4, -5, 90)),)
    )
    np.testing.assert_allclose(small.radiance(scene), large.radiance(scene)[20:70, 20:80], rtol=0, atol=1e-6)


# --- surfaces and sensor -----------------------------------------------------------------------------


def test_texture_is_attached_to_the_part() -> None:
    """Both cameras see the same texture at the same point of the part."""
    rng = np.random.default_rng(1)
    place = pose(9, 1, 204, (0.03, -0.04, 1.0))
    scene = on_black(Part("p", Disc(0, 0, 14), Surface(0.5, 0.2, 0.8)), place)
    points = np.append(rng.uniform(-8, 8, (500, 2)), np.zeros((500, 1)), axis=1)
    seen = []
    for view in stereo_views(demo_rig()).values():
        pixels = view.project(points @ place[:3, :3].T + place[:3, 3]).astype(np.float32)[None]
        seen.append(cv2.remap(view.radiance(scene).copy(), pixels, None, cv2.INTER_CUBIC).ravel())
    assert seen[0].std() > 0.05
    assert np.corrcoef(seen)[0, 1] > 0.98


@pytest.mark.parametrize(
    ("lay", "along", "across"),
    [
        ({"lay_rad": 0.0}, (0.5, 0.0), (0.0, 0.5)),
        ({"lay_rad": 0.5 * math.pi}, (0.0, 0.5), (0.5, 0.0)),
        ({"around_mm": (-6.0, 0.0)}, (0.0, 0.5), (0.5, 0.0)),
        ({"around_mm": (0.0, 40.0)}, (0.5, 0.0), (0.0, 0.5)),
    ],
)
def test_a_lay_runs_straight_or_in_arcs(lay: dict, along: tuple, across: tuple) -> None:
    """Around the middle of the face grey values correlate along the lay, and not across it."""
    part = Part("p", Disc(0, 0, 14), Surface(0.5, 0.2, 0.5, stretch=12.0, **lay))
    place, view = pose(9, 1, 204, (0.0, 0.0, 0.0)), stereo_views(demo_rig())["left"]
    picture = view.radiance(on_black(part, place)).copy()
    grid = np.stack(np.meshgrid(np.linspace(-1.5, 1.5, 20), np.linspace(-1.5, 1.5, 20)), axis=-1).reshape(
        -1, 2
    )

    def seen(offset: tuple) -> np.ndarray:
        points = np.append(grid + offset, np.zeros((len(grid), 1)), axis=1)
        pixels = view.project(points @ place[:3, :3].T + place[:3, 3]).astype(np.float32)[None]
        return cv2.remap(picture, pixels, None, cv2.INTER_CUBIC).ravel()

    assert np.corrcoef(seen((0.0, 0.0)), seen(along))[0, 1] > 0.7
    assert abs(np.corrcoef(seen((0.0, 0.0)), seen(across))[0, 1]) < 0.4


def test_the_sensor_does_as_its_twin() -> None:
    """Shot noise, read noise, gain, rounding and saturation equal the plain formula."""
    rng = np.random.default_rng(2)
    radiance = rng.uniform(0, 1.4, (20, 30)).astype(np.float32)
    chance = rng.integers(0, 65536, radiance.shape, np.uint16)
    quantiles = rng.standard_normal(65536).astype(np.float32)
    sensor = Sensor()
    image = np.empty(radiance.shape, np.uint8)
    electrons = sensor.white / 255 * 0.7 * sensor.full_well_e
    grey_per_electron = 255 / sensor.full_well_e * 10 ** (3.0 / 20)
    raster.expose(radiance, chance, quantiles, electrons, 12.0, grey_per_electron, sensor.black, image)
    twin = naive.sensor_expose(
        radiance.astype(float), quantiles[chance].astype(float), sensor, 0.7 * sensor.nominal_exposure_us, 3.0
    )
    assert np.abs(image.astype(int) - twin).max() <= 1  # float32 may round another way
    assert (image != twin).mean() < 0.01


def test_noise_is_shot_noise() -> None:
    """The variance is that of counted electrons plus read noise plus rounding, with the true mean."""
    view = RenderedView(CameraModel("division", 200, 150, 900.0, 900.0, 100.0, 75.0, (0.0,)), np.eye(4))
    for albedo in (0.1, 0.5, 0.9):
        scene = Scene(Table(Surface(albedo), pose(0, 0, 100)))
        image = view.render(scene, np.random.default_rng(3)).astype(float)
        grey_per_electron = 255 / 12_000
        variance = albedo * 220 * grey_per_electron + (12 * grey_per_electron) ** 2 + 1 / 12
        assert image.mean() == pytest.approx(3 + 220 * albedo, abs=5 * math.sqrt(variance / image.size))
        assert image.var() == pytest.approx(variance, rel=0.05)


def test_exposure_and_gain_scale_the_signal() -> None:
    """Twice the exposure time, or 6.02 dB, is twice the signal above black; too much saturates."""
    view = RenderedView(CameraModel("division", 60, 50, 900.0, 900.0, 30.0, 25.0, (0.0,)), np.eye(4))
    scene = Scene(Table(Surface(0.4), pose(0, 0, 100)))
    assert view.render(scene)[25, 30] == 3 + 88
    assert view.render(scene, exposure_us=4000.0)[25, 30] == 3 + 176
    assert view.render(scene, gain_db=20 * math.log10(2))[25, 30] == 3 + 176
    assert view.render(scene, exposure_us=10_000.0).min() == 255


def test_rendering_repeats() -> None:
    """Equal seeds give equal pictures, other seeds other noise."""
    view = stereo_views(demo_rig())["left"]
    scene = on_black(demo_part(), pose(8, 0, 204))
    first, again, other = (view.render(scene, np.random.default_rng(seed)) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.1


@given(st.sampled_from(EVERY_SHAPE), st.floats(-5, 5), st.floats(-5, 5))
@settings(max_examples=200)
def test_extent_holds_the_shape(shape: object, u: float, v: float) -> None:
    """No point of a shape lies outside of its extent."""
    if naive.shape_covers(shape, u, v):
        assert math.hypot(u, v) <= extent_mm(shape) + 1e-9


# --- the cell --------------------------------------------------------------------------------------


@pytest.fixture
def cell() -> VirtualCell:
    """The demo's cell."""
    return VirtualCell(demo_rig(), demo_part(), seed=7)


def request(frame_id: int, exposed_ns: int, width: int = 1280, height: int = 960) -> ExposureRequest:
    """An exposure with nominal settings."""
    return ExposureRequest(frame_id, exposed_ns, exposed_ns, 2000.0, 0.0, width, height)


def seen_by(cell: VirtualCell, camera: str, frame_id: int, exposed_ns: int) -> int:
    """The number of the scene that an exposure sees, from the smallest picture."""
    cell.exposure(camera)(request(frame_id, exposed_ns, 16, 16))
    truth = cell.truth_of_frame(camera, frame_id)
    assert truth is not None
    return truth.number


S = 1_000_000_000
MS = 1_000_000


@pytest.mark.slow
def test_both_cameras_see_one_scene(cell: VirtualCell) -> None:
    """Two exposures a few ms apart see one scene, whatever their ids and whichever comes first."""
    assert seen_by(cell, "left", 1, 1 * S) == seen_by(cell, "right", 41, 1 * S + 8 * MS) == 0
    assert seen_by(cell, "right", 42, 2 * S) == seen_by(cell, "left", 2, 2 * S + 3 * MS) == 1


@pytest.mark.slow
def test_a_restarted_camera_pairs_again(cell: VirtualCell) -> None:
    """After restarted ids, or an absence, the next common trigger is a pair."""
    assert seen_by(cell, "left", 1, 1 * S) == seen_by(cell, "right", 1, 1 * S + MS) == 0
    assert [seen_by(cell, "left", k, k * S) for k in (2, 3)] == [1, 2]
    assert seen_by(cell, "right", 1, 4 * S) == seen_by(cell, "left", 4, 4 * S + MS) == 3


def test_a_repeated_request_sees_the_same(cell: VirtualCell) -> None:
    """A repeated request gives the same picture, with the same noise."""
    first, again = (cell.exposure("left")(request(1, S)) for _ in range(2))
    np.testing.assert_array_equal(first, again)


@pytest.mark.slow
def test_triggers_faster_than_the_window_move_the_part(cell: VirtualCell) -> None:
    """A camera never sees one scene twice, however fast it is triggered."""
    assert [seen_by(cell, "left", k, S + k * MS) for k in range(4)] == [0, 1, 2, 3]


def test_truth_is_found_by_time(cell: VirtualCell) -> None:
    """The truth is that of the nearest exposure; without a near one there is none."""
    assert cell.truth(S) is None
    for k in (1, 2):
        seen_by(cell, "right", k, k * S)
    near = cell.truth(2 * S + PAIR_WINDOW_NS)
    assert near is not None
    assert near.number == 1
    assert cell.truth(2 * S + PAIR_WINDOW_NS + 1) is None
    assert cell.truth_of_frame("left", 1) is None


@pytest.mark.slow
def test_scenes_follow_from_the_seed() -> None:
    """Equal seeds give equal cells, and the part moves within its range and turns all the way round."""
    cells = [VirtualCell(demo_rig(), demo_part(), seed=seed) for seed in (1, 1, 2)]
    poses = [[cell.pose(k) for k in range(40)] for cell in cells]
    np.testing.assert_array_equal(poses[0], poses[1])
    assert not np.allclose(poses[0], poses[2])
    stack, motion = np.array(poses[0]), PartMotion()
    assert (np.abs(stack[:, :3, 3] - motion.centre_mm) <= (*motion.shift_mm, motion.depth_mm)).all()
    assert np.arccos(stack[:, 2, 2]).max() <= motion.tilt_rad
    turns = np.arctan2(stack[:, 1, 0], stack[:, 0, 0])
    assert np.histogram(turns, 4, (-np.pi, np.pi))[0].min() > 3


@pytest.mark.slow
def test_the_picture_shows_the_truth(cell: VirtualCell) -> None:
    """The outer circle of the truth projects to the rim of the bright part in both pictures."""
    views = stereo_views(cell.rig)
    for camera in SIDES:
        image = cell.exposure(camera)(request(1, S))
        truth = cell.truth(S)
        assert truth is not None
        outer = truth.circles[0]
        assert outer.name == "outer"
        assert outer.normal[2] < 0
        assert outer.radius_mm == 14.0
        np.testing.assert_allclose(outer.centre_mm, truth.rig_from_part[:3, 3])
        rim = outline_px(views[camera], Disc(0, 0, 14.0), truth.rig_from_part)[::2000]
        centre = rim.mean(axis=0)
        inside, outside = (np.round(centre + k * (rim - centre)).astype(int) for k in (0.97, 1.03))
        assert image[inside[:, 1], inside[:, 0]].min() > image[outside[:, 1], outside[:, 0]].max()


@pytest.mark.slow
def test_teaching_is_square_to_the_left_camera(cell: VirtualCell) -> None:
    """The taught part has the axes of the rig, and is whole in both pictures."""
    left, right, truth = cell.teach_pair()
    np.testing.assert_array_equal(truth.rig_from_part[:3, :3], np.eye(3))
    for image in (left, right):
        frame = np.concatenate(
            [image[:5].ravel(), image[-5:].ravel(), image[:, :5].ravel(), image[:, -5:].ravel()]
        )
        assert frame.max() < 100 < image.max()


def test_a_smaller_image_is_a_window(cell: VirtualCell) -> None:
    """A smaller size is the corner of the sensor; a larger one is an error."""
    whole, part = (cell.exposure("left")(request(1, S, *size)) for size in ((1280, 960), (640, 100)))
    np.testing.assert_array_equal(part, whole[:100, :640])
    with pytest.raises(ImageError, match="1281x960"):
        cell.exposure("left")(request(2, S, 1281, 960))


@pytest.mark.long
def test_a_part_too_large_is_refused() -> None:
    """A part that is too large is refused at once."""
    with pytest.raises(ValueError, match="fits nowhere"):
        VirtualCell(demo_rig(), Part("plate", Disc(0, 0, 50), Surface(0.5)))
    with pytest.raises(ValueError, match="fits nowhere"):
        next(calibration_views(demo_rig(), chessboard_plate(11, 8, 40.0), 1))


@pytest.mark.long
def test_history_is_bounded(cell: VirtualCell) -> None:
    """Only the last 1024 truths are kept."""
    for k in range(1100):
        cell.moment("left", request(k, k * S))
    assert 1024 == sum(cell.truth(k * S, tolerance_ns=0) is not None for k in range(1100))
    assert cell.truth(0) is None


# --- calibration plates ------------------------------------------------------------------------------


@pytest.mark.long
def test_chessboard_corners_are_where_the_truth_says() -> None:
    """OpenCV finds the corners of rendered boards at their projections, and the first square is dark."""
    rig, plate = demo_rig(), chessboard_plate(11, 8, 4.0)
    assert plate.points_mm.shape == (88, 3)
    np.testing.assert_array_equal(plate.points_mm[[0, 1, 11]], [(0, 0, 0), (4, 0, 0), (0, 4, 0)])
    views = stereo_views(rig)
    for shot in calibration_views(rig, plate, 2, seed=3):
        points = plate.points_mm @ shot.rig_from_plate[:3, :3].T + shot.rig_from_plate[:3, 3]
        for camera, image in (("left", shot.left), ("right", shot.right)):
            expected = views[camera].project(points)
            corners = expected.astype(np.float32)[:, None] + 1.5
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
            cv2.cornerSubPix(image, corners, (6, 6), (-1, -1), stop)
            assert np.sqrt(np.mean((corners[:, 0] - expected) ** 2)) < 0.05
            # the first square, up left of the first corner, is dark
            square = views[camera].project(
                np.array([-2.0, -2.0, 0.0]) @ shot.rig_from_plate[:3, :3].T + shot.rig_from_plate[:3, 3]
            )
            x, y = np.round(square).astype(int)
            assert image[y, x] < 40


@pytest.mark.long
def test_dots_are_where_the_truth_says() -> None:
    """The centroid of every dot, seen straight on, is its projected centre, and the corner beside the
    first is cut."""
    plate = dots_plate(7, 7, 5.0)
    view = stereo_views(demo_rig(), SHARP)["left"]
    place = pose(0, 0, 205)
    image = view.radiance(on_black(plate.part, place)).astype(float)
    centres = view.project(plate.points_mm + np.array([0.0, 0.0, 205.0]))
    for point, centre in zip(plate.points_mm, centres, strict=True):
        x, y = np.round(centre).astype(int)
        window = 0.82 - image[y - 28 : y + 29, x - 28 : x + 29]
        offsets = np.arange(-28, 29)
        found = (
            window.sum(axis=0) @ offsets + x * window.sum(),
            window.sum(axis=1) @ offsets + y * window.sum(),
        )
        assert np.abs(np.array(found) / window.sum() - centre).max() < 0.02, point
    beside_first, beside_last = view.project(np.array([(-17.9, -17.9, 205.0), (17.9, 17.9, 205.0)]))
    assert image[tuple(np.round(beside_first[::-1]).astype(int))] == pytest.approx(0.06, abs=1e-6)
    assert image[tuple(np.round(beside_last[::-1]).astype(int))] == pytest.approx(0.82, abs=1e-6)
