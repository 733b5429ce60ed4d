"""Edges, slots, corners and sizes against the drawing; every reason to refuse a part; points in space."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.cells import PLACE_MM, frame_pair, pictures, pose, region_around, scene, small_rig
from helpers.flatparts import METAL, PLATE, Cell, cell, only

from edged import pipeline
from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Outcome, Reject, Status
from edged.files.ply import VERTEX, encode_ply
from edged.pictures.overlay import RED, TITLE_HEIGHT_PX, WIDTH_PX, draw_pair
from edged.pipeline import cloud, doubted_where_shared, inspect, judge, locate
from edged.sim.render.scene import Disc, Hole, Part, RoundedBox, Slot, Surface
from edged.vision.curves.outlines import Curve, Face
from edged.vision.curves.planefit import fit_plane
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply, invert
from edged.vision.part.flatness import form_of
from edged.vision.part.job import Job, MeasurementSpec, nominal_size
from edged.vision.part.measure import measure_part
from edged.vision.part.measured import MeasuredPart
from edged.vision.part.pointcloud import CONTOUR, FACE
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.search import SearchParams, ShapeMatch, find_shapes
from edged.vision.teaching.pair import teach

ELSEWHERE = pose((6.0, 1.0, 203.0), turn_deg=37.0, tilt_deg=5.0)


def with_sizes(job: Job, *specs: MeasurementSpec) -> Job:
    """The job with these measurements, and without a witness."""
    return replace(job, measurements=specs, witness=None)


def found(here: Cell, job: Job, where: FloatArray) -> Outcome:
    """The outcome for the part there."""
    return locate(frame_pair(*here.see(where)), job, here.rig)


def turned_deg(one: FloatArray, two: FloatArray) -> float:
    """Angle between two rotations."""
    cosine = (np.trace(one[:3, :3].T @ two[:3, :3]) - 1) / 2
    return math.degrees(math.acos(min(cosine, 1.0)))


# --- curves in one plane -----------------------------------------------------------------------------


def test_curves_of_a_plane_are_recovered_from_a_poor_start() -> None:
    """Circle, slot and edge are found from 0.1 mm off, to 8 µm and within four sigmas."""
    rig = small_rig()
    part = Part(
        "p",
        RoundedBox(0, 0, 24, 16),
        METAL,
        (Hole("s", Slot(4, 2, 9, 4, 0.5)), Hole("c", Disc(-6, -3, 3))),
    )
    where = pose(turn_deg=25.0, tilt_deg=6.0)
    start = [
        Curve("c", "circle", np.array([-6.05, -3.05, 3.05]), 0),
        Curve("s", "slot", np.array([4.05, 2.05, 0.505, 9.08, 3.95]), 1),
        Curve("e", "edge", np.array([0.0, 8.05, 0.005]), 0, length_mm=24.0),
    ]
    face = Face(where[:3, 3] + (0.0, 0.0, 0.1), where[:3, :3].T)
    fit = fit_plane(rig, pictures(rig, scene((part, where))), face, start)
    assert fit is not None
    truth = {"c": (-6, -3, 3), "s": (4, 2, 0.5, 9, 4), "e": (0, 8, 0)}
    for one in fit.fits:
        name, curve = one.curve.name, one.curve
        x, y, z = apply(invert(where), fit.face.to_rig(curve.parameters[None, :2]))[0]
        true = np.array(truth[name], dtype=float)
        sigma = np.sqrt(np.diag(fit.covariance)[fit.place(name)])
        error = np.concatenate([[x, y], curve.parameters[2:]]) - true
        if curve.kind == "edge":  # it may slide along itself
            error, sigma = error[1:], sigma[1:]
        assert np.abs(error).max() < 0.008
        assert (np.abs(error) < 4 * sigma + 0.0005).all()
        assert abs(z) < 0.01
        assert one.support.min() > 0.9
    assert [one.curve.polarity for one in fit.fits] == [1, 1, -1]


def test_curves_that_are_not_there_are_left_out() -> None:
    """A slot that is not there is left out beside a real circle; alone, or with a face behind the cameras,
    nothing is measured.
    """
    rig, part, where = small_rig(), Part("d", Disc(0, 0, 12), METAL), pose()
    images = pictures(rig, scene((part, where)))
    face = Face(where[:3, 3], where[:3, :3].T)
    real = Curve("real", "circle", np.array([0.03, 0.0, 12.0]), -1)
    nothing = Curve("nothing", "slot", np.array([2.0, 1.0, 0.3, 6.0, 3.0]), 1)
    fit = fit_plane(rig, images, face, [real, nothing])
    assert fit is not None
    assert [one.curve.name for one in fit.fits] == ["real"]
    assert fit.place("nothing") is None
    assert fit_plane(rig, images, face, [nothing]) is None
    assert fit_plane(rig, images, Face(-where[:3, 3], where[:3, :3].T), [real]) is None


# --- parts -------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_part_without_circles_is_located() -> None:
    """A plate of straight edges, turned, tilted and shifted, gets position, rotation and size from its
    edges."""
    here = cell("plate")
    assert not here.job.circles
    sizes = [
        MeasurementSpec("side", "distance", ("k0", "k1")),
        MeasurementSpec("square", "angle", here.job.corners[0].edges, math.pi / 2, math.radians(0.2)),
    ]
    target = only(found(here, with_sizes(here.job, *sizes), ELSEWHERE))
    truth = here.true_pose(ELSEWHERE)
    error = target.position_mm - truth[:3, 3]
    assert np.abs(error).max() < 0.025
    assert target.rig_from_part[:3, 2] @ ELSEWHERE[:3, 2] > math.cos(math.radians(0.1))
    assert turned_deg(target.rig_from_part, truth) < 0.3  # the teaching's own tilt is in it
    assert len(target.edges) == len(target.corners) == 5
    side, square = target.measurements
    assert side.value == pytest.approx(nominal_size(here.job, "distance", ("k0", "k1")), abs=0.01)
    assert (square.unit, square.ok) == ("deg", True)
    assert square.value == pytest.approx(90.0, abs=0.06)
    drawn = apply(ELSEWHERE, np.column_stack([np.array(PLATE.outline.points_mm), np.zeros(5)]))
    for corner in target.corners:
        assert np.linalg.norm(drawn - corner.position_mm, axis=1).min() < 0.03


@pytest.mark.long
def test_sizes_are_those_of_the_drawing() -> None:
    """Radius, distances, width and length are those of the drawing, within 10 µm and four sigmas."""
    here = cell("disc")
    job = with_sizes(
        here.job,
        MeasurementSpec("radius", "radius", ("c1",), 3.0, 0.02),
        MeasurementSpec("bores", "distance", ("c1", "c2"), math.hypot(10, 3), 0.02),
        MeasurementSpec("reach", "distance", ("c0", "s0"), math.hypot(4, 4), 0.02),
        MeasurementSpec("width", "width", ("s0",), 4.0, 0.02),
        MeasurementSpec("length", "length", ("s0",), 9.0, 0.02),
        MeasurementSpec("flat", "flatness", (), None, 0.1),
    )
    target = only(found(here, job, ELSEWHERE))
    assert [one.name for one in target.measurements] == [spec.name for spec in job.measurements]
    for one in target.measurements[:-1]:
        assert one.ok
        assert one.nominal is not None
        assert abs(one.value - one.nominal) < min(0.01, 4 * one.sigma)
    assert target.measurements[-1].value < 0.1
    assert target.reject is Reject.NONE


def test_angles_are_those_of_the_drawing() -> None:
    """The angles between the edges of every corner are those of the drawing, within 0.1° and four sigmas."""
    here = cell("plate")
    corners = [MeasurementSpec(corner.name, "angle", corner.edges) for corner in here.job.corners]
    measured = sorted(
        only(found(here, with_sizes(here.job, *corners), ELSEWHERE)).measurements, key=lambda one: one.value
    )
    x, y = np.diff(PLATE.outline.points_mm, axis=0, append=PLATE.outline.points_mm[:1]).T
    directions_deg = np.degrees(np.arctan2(y, x))
    turns_deg = np.abs(directions_deg - np.roll(directions_deg, 1)) % 180
    drawn_deg = sorted(np.minimum(turns_deg, 180 - turns_deg))
    assert 5 == len(drawn_deg) == len(measured)
    for expected_deg, angle in zip(drawn_deg, measured, strict=True):
        assert abs(angle.value - expected_deg) < min(0.1, 4 * angle.sigma)


@pytest.mark.parametrize("name", ["s0", "c1"])
def test_any_feature_may_be_the_reference(name: str) -> None:
    """With the slot or a bore as reference the position is its place."""
    here = cell("disc")
    target = only(found(here, replace(here.job, reference=name), ELSEWHERE))
    truth = apply(here.true_pose(ELSEWHERE), here.job.place_of(name))
    assert np.abs(target.position_mm - truth).max() < 0.02


@pytest.mark.long
def test_a_round_part_states_its_free_axis() -> None:
    """A plain disc has a free axis, and its rotation about it has the sigma of an unknown angle."""
    here = cell("round")
    target = only(found(here, here.job, ELSEWHERE))
    assert target.free_axis is not None
    assert target.free_axis @ ELSEWHERE[:3, 2] > math.cos(math.radians(0.2))
    about = math.sqrt(target.free_axis @ target.covariance[3:, 3:] @ target.free_axis)
    assert about == pytest.approx(math.pi / math.sqrt(3), rel=0.01)
    assert only(found(cell("disc"), cell("disc").job, ELSEWHERE)).free_axis is None


def test_two_parts_cannot_have_one_circle() -> None:
    """Where a job fits the same circles twice neither is accepted; a disc that lies on another one is."""
    here = cell("disc")
    (disc,) = inspect(frame_pair(*here.see(ELSEWHERE)), here.job, here.rig).measured
    below = (0.0, 0.0, 1.5)
    stacked = tuple(replace(bore, centre_mm=bore.centre_mm + below) for bore in disc.target.circles)
    for other, expected in (
        (disc.target.circles[:1], Reject.AMBIGUOUS_ROTATION),
        (stacked, Reject.NONE),
    ):
        pair = [disc, replace(disc, target=replace(disc.target, circles=other))]
        assert [expected] * 2 == [part.target.reject for part in doubted_where_shared(pair)]
    match = disc.target.match
    for score, expected in (
        (0.99 * match.score, Reject.NONE),
        (1.01 * match.score, Reject.AMBIGUOUS_ROTATION),
    ):
        refused = replace(disc.target, reject=Reject.AMBIGUOUS_EDGE, match=replace(match, score=score))
        first, second = doubted_where_shared([disc, replace(disc, target=refused)])
        assert (first.target.reject, second.target.reject) == (expected, Reject.AMBIGUOUS_EDGE)


# --- reasons to refuse -------------------------------------------------------------------------------


def limited(**changes: object) -> Callable[[Job], Job]:
    """The job with other limits."""
    return lambda job: replace(job, limits=replace(job.limits, **changes))


def too_narrow(job: Job) -> Job:
    """The job with a tolerance that the part does not keep."""
    return with_sizes(job, MeasurementSpec("wrong", "width", ("s0",), 4.2, 0.05))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (limited(max_rms_px=1e-6), Reject.RESIDUAL),
        (limited(max_sigma_mm=1e-6), Reject.SIGMA_LIMIT),
        (limited(max_epipolar_px=1e-9), Reject.LEFT_RIGHT_MISMATCH),
        (limited(depth_mm=(300.0, 400.0)), Reject.OUT_OF_VOLUME),
        (limited(radius_tolerance_mm=1e-9), Reject.TOLERANCE),
        (too_narrow, Reject.TOLERANCE),
    ],
)
def test_each_limit_has_its_reason(change: Callable[[Job], Job], expected: Reject) -> None:
    """A result that fails a limit is LOW_QUALITY with that reason and no other."""
    here = cell("disc")
    outcome = found(here, change(here.job), pose(turn_deg=10.0))
    assert outcome.status is Status.LOW_QUALITY
    assert only(outcome).reject == expected


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ({"max_rms_px": 1e-6}, Reject.RESIDUAL),
        ({"max_sigma_mm": 1e-6}, Reject.SIGMA_LIMIT),
        ({"max_epipolar_px": 1e-9}, Reject.LEFT_RIGHT_MISMATCH),
        ({"depth_mm": (300.0, 400.0)}, Reject.OUT_OF_VOLUME),
    ],
)
def test_each_limit_has_its_reason_without_circles(limits: dict[str, object], expected: Reject) -> None:
    """A part of straight edges that fails a limit is LOW_QUALITY with that reason."""
    here = cell("plate")
    outcome = found(here, limited(**limits)(here.job), pose(turn_deg=2.0))
    assert outcome.status is Status.LOW_QUALITY
    assert only(outcome).reject & expected


@pytest.mark.long
def test_what_only_one_camera_shows_is_dismissed_with_its_place() -> None:
    """With a blank right image there is no target; the dismissed place is given and drawn in the picture."""
    for name in ("disc", "plate"):
        here = cell(name)
        left, right = here.see(pose())
        blank = np.full_like(right, 40)
        inspection = inspect(frame_pair(left, blank), here.job, here.rig)
        outcome = judge(inspection)
        assert outcome.status is Status.NO_TARGET
        (missed,) = outcome.dismissed
        assert missed.reject is Reject.LEFT_RIGHT_MISMATCH
        seen = inspection.measured, inspection.dismissed
        picture = draw_pair(left, blank, here.rig.rig, here.job, *seen, outcome.status)
        scale = WIDTH_PX / left.shape[1]
        x, y = (round((value + 0.5) * scale - 0.5) for value in (missed.match.x_px, missed.match.y_px))
        assert tuple(picture[TITLE_HEIGHT_PX + y, x]) == RED


def test_a_narrow_miss_says_where_and_by_how_much() -> None:
    """For a half hidden part below the least score the best place is given; an empty table has none."""
    here = cell("disc")
    left, right = here.see(pose())
    empty = np.full_like(left, 40)
    (good,) = found(here, here.job, pose()).targets
    strict = replace(here.job, search=replace(here.job.search, min_score=1.0))
    missed = locate(
        frame_pair(np.where(np.arange(640) < good.match.x_px - 70, 40, left), right), strict, here.rig
    )

    assert missed.status is Status.NO_TARGET
    assert missed.nearest is not None
    nearest = missed.nearest.ask()
    assert nearest is not None
    assert (nearest.match.x_px, nearest.match.y_px) == pytest.approx(
        (good.match.x_px, good.match.y_px), abs=1.0
    )
    assert nearest.match.score < nearest.needed_score == 1.0
    nothing = locate(frame_pair(empty, empty), strict, here.rig).nearest
    assert nothing is not None
    assert nothing.ask() is None


def test_a_miss_costs_one_search_until_somebody_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    """A missed part costs one search; asking for the nearest place costs one more, however often."""
    here, searches = cell("disc"), list[float]()

    def counted(image: Image, shape: ShapeModel, params: SearchParams, *others: Any) -> list[ShapeMatch]:
        searches.append(params.min_score)
        return find_shapes(image, shape, params, *others)

    monkeypatch.setattr(pipeline, "find_shapes", counted)
    empty = np.full_like(here.see(pose())[0], 40)
    missed = locate(frame_pair(empty, empty), here.job, here.rig).nearest
    assert len(searches) == 1
    assert missed is not None
    assert (missed.answered, missed.open) == (False, True)
    with ThreadPoolExecutor(2) as threads:
        list(threads.map(lambda _turn: missed.ask(), range(4)))
    assert len(searches) == 2
    assert searches[1] < searches[0] == here.job.search.min_score
    assert (missed.answered, missed.open) == (True, False)


def test_an_ambiguous_rotation_is_refused() -> None:
    """A rotation that neither search nor straight edges decide is refused as ambiguous."""
    here = cell("plate")
    left, right = here.see(pose())
    rectification = here.rig.rectification
    images = StereoImages.of(rectification, left, right)
    (match,) = find_shapes(images.rectified_left, here.job.shape, here.job.search, rectification.valid_left)
    for ambiguous, expected in ((False, Reject.NONE), (True, Reject.AMBIGUOUS_ROTATION)):
        result = measure_part(images, here.job, replace(match, ambiguous=ambiguous))
        assert isinstance(result, MeasuredPart)
        assert result.target.reject == expected


@pytest.mark.long
def test_circles_do_not_decide_what_the_search_could_not() -> None:
    """If circles alone decide a rotation that the search left open, the part is refused."""
    holes = tuple(
        Hole(
            f"h{k}",
            Disc(8 * math.cos(k * math.pi / 2), 8 * math.sin(k * math.pi / 2), 1.5 if k else 1.1),
        )
        for k in range(4)
    )
    part, rig = Part("odd", Disc(0, 0, 13), METAL, holes), small_rig()
    prepared = pipeline.prepare(rig)
    left, right = pictures(rig, scene((part, pose())))
    job = teach(left, right, prepared.rectification, region_around(rig, pose()[:3, 3], 15.0), "odd")
    images = StereoImages.of(prepared.rectification, left, right)
    (match,) = find_shapes(images.rectified_left, job.shape, job.search, prepared.rectification.valid_left)
    for ambiguous, expected in ((False, Reject.NONE), (True, Reject.AMBIGUOUS_ROTATION)):
        result = measure_part(images, job, replace(match, ambiguous=ambiguous))
        assert isinstance(result, MeasuredPart)
        assert result.target.reject == expected


@pytest.mark.slow
@pytest.mark.parametrize("turn_deg", [12.0, 40.0])
@pytest.mark.parametrize("across_mm", [0.2, 0.5])
def test_edges_of_two_different_moments_are_refused(turn_deg: float, across_mm: float) -> None:
    """A plate that moved across the rows before the right exposure is refused or not found."""
    here = cell("plate")
    where = pose((7.5, 1.0, 204.0), turn_deg, 3.0)
    later = where.copy()
    later[:3, 3] += across_mm * here.rig.rectification.rectified_from_left[1]
    pair = frame_pair(here.see(where)[0], here.see(later, 8)[1])
    outcome = locate(pair, here.job, here.rig)
    assert outcome.status is not Status.OK
    reasons = [one.reject for one in (*outcome.targets, *outcome.dismissed)]
    assert all(reject & (Reject.LEFT_RIGHT_MISMATCH | Reject.FEW_EDGES) for reject in reasons)


@pytest.mark.long
def test_a_hidden_part_shows_too_few_edges() -> None:
    """With a third of the outline covered and nine tenths required, the part is refused for too few edges,
    with a larger sigma.

    The plate's straight edges show less of their displacement: its sigma is only not much smaller.
    """
    for name in ("disc", "plate"):
        here = cell(name)
        cover = Part("cover", RoundedBox(16.0, 0.0, 18.0, 40.0), Surface(albedo=0.3, contrast=0.1, seed=3))
        nearer = pose((PLACE_MM[0], PLACE_MM[1], PLACE_MM[2] - 2.0))
        images = pictures(here.rig.rig, scene((here.part, pose()), (cover, nearer)))
        job = limited(min_support=0.9)(replace(here.job, search=replace(here.job.search, min_score=0.65)))
        hidden = only(locate(frame_pair(*images), job, here.rig))
        whole = only(found(here, job, pose()))
        assert hidden.reject & Reject.FEW_EDGES
        assert whole.reject is Reject.NONE
        assert hidden.sigma_mm.max() > (1.0 if name == "disc" else 0.9) * whole.sigma_mm.max()
        assert (np.abs(hidden.position_mm - whole.position_mm) < 5 * hidden.sigma_mm + 0.01).all()


# --- points in space ---------------------------------------------------------------------------------


def test_points_lie_on_the_part() -> None:
    """Contour points are within 50 µm of the face and face points within their sigmas; the PLY has both."""
    here = cell("disc")
    pair = frame_pair(*here.see(ELSEWHERE))
    points = cloud(pair, here.job, here.rig, inspect(pair, here.job, here.rig))
    heights = apply(invert(ELSEWHERE), points.points_mm)[:, 2]
    contour, face = heights[points.kinds == CONTOUR], heights[points.kinds == FACE]
    assert len(contour) > 500
    assert len(face) > 50
    assert np.sqrt(np.mean(contour**2)) < 0.05
    on_face = face[np.abs(face) < 1.0]  # through the holes the table is seen
    assert len(on_face) > 0.5 * len(face)
    assert np.median(np.abs(on_face)) < 3 * np.median(points.sigma_mm[points.kinds == FACE])
    header, _, body = encode_ply(points).partition(b"end_header\n")
    vertices = np.frombuffer(body, VERTEX)
    assert f"element vertex {len(points.kinds)}" in header.decode()
    np.testing.assert_allclose([vertices[axis] for axis in "xyz"], points.points_mm.T, rtol=1e-6)
    assert len(np.unique(vertices["red"])) == 2


def test_flatness_is_the_bend_of_a_face() -> None:
    """A face bent by 50 µm, with noise of 20 µm and outliers, has that flatness; a flat one less than its
    doubt."""
    rng = np.random.default_rng(3)
    xy = rng.uniform(-10, 10, (400, 2))
    noise = rng.normal(0, 0.02, 400)
    noise[:20] += 0.5
    bent = 0.05 * (xy[:, 0] / 10) ** 2 + 0.01 * xy[:, 1]
    sigma = np.full(400, 0.02)
    value, doubt = form_of(np.column_stack([xy, bent + noise]), sigma)
    assert abs(value - 0.05) < 4 * doubt
    assert doubt < 0.01
    value, doubt = form_of(np.column_stack([xy, 0.01 * xy[:, 1] + noise]), sigma)
    assert value < 4 * doubt
    assert all(map(math.isnan, form_of(np.zeros((3, 3)), np.ones(3))))
