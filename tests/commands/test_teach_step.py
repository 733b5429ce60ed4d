"""`edged teach --step`: a pair and a STEP file give one job, whose results are in the file's frame."""

from __future__ import annotations

import functools
import json
import math
import pickle
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.cells import TEXTURED, frame_pair, pictures, pose, small_rig
from helpers.flatparts import METAL, only
from helpers.platewithpad import CORNER, DARK, HOLES, OUTLINE, PAD, PAD_MM, STEP, settled, square
from helpers.stlfiles import binary, ring
from helpers.tilted import BELOW_MM, lying, stacked
from rich.console import Console

from edged.commands.locate import locate
from edged.commands.teach import DrawingSource, PairSource, TeachOptions, chosen_source, read_model, teach
from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Reject
from edged.errors import FileFormatError, TeachError, UserError
from edged.files.arrays import pack_arrays, unpack_arrays
from edged.files.jobs import load_job, save_job
from edged.files.rig import save_rig
from edged.files.step import read_step
from edged.pipeline import locate as find
from edged.pipeline import prepare
from edged.robot.budget import budget_of
from edged.robot.picking import RobotFrame, picked
from edged.sim.render.scene import Disc, Hole, Part, Scene, Table
from edged.vision.geometry.rectification import StereoImages
from edged.vision.geometry.rigid import apply, invert
from edged.vision.geometry.uncertainty import shifted_pose_covariance
from edged.vision.part.job import Job, ModelPoint
from edged.vision.solid.breaks import FittedBody
from edged.vision.solid.edgemodel import EdgeModel
from edged.vision.teaching import cadpair, cadsettling
from edged.vision.teaching.cadjob import teach_model
from edged.vision.teaching.cadmodel import CadModel, welded
from edged.vision.teaching.cadsettling import Settled, settle
from edged.vision.teaching.facets import faceted_curves
from edged.vision.teaching.pair import WantedJob, view_of
from edged.vision.teaching.pair import teach as teach_pair
from edged.vision.teaching.reteaching import carry_over

QUIET = Console(quiet=True)
NO_DRAWING = DrawingSource(None, None, None, (), None)


@pytest.fixture(scope="module", autouse=True)
def laid_once() -> Iterator[None]:
    """Fit a body to the same pair and pose only once, as it takes twelve seconds."""
    lay, laid = cadsettling.lay_with_breaks, dict[bytes, FittedBody | None]()

    def once(images: StereoImages, model: EdgeModel, where: FloatArray) -> FittedBody | None:
        key = pickle.dumps((repr(images.rig), images.raw, model, where))
        if key not in laid:
            laid[key] = lay(images, model, where)
        return laid[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cadsettling, "lay_with_breaks", once)
        yield


def see(where: FloatArray, holes: tuple[Hole, ...] = HOLES, seed: int = 1) -> tuple[Image, Image]:
    """A pair of the file's part, with its frame at rig_from_model."""
    above = where.copy()
    above[:3, 3] -= PAD_MM * where[:3, 2]
    plate = Part("plate", OUTLINE, METAL, (*holes, CORNER))
    pad = Part("pad", PAD, replace(METAL, seed=5), (CORNER,))
    layers = [*stacked(plate, where, 6.0, DARK, 16), *stacked(pad, above, PAD_MM, DARK, 10)]
    table = Table(TEXTURED, pose((8.0, 0.0, 205.0 + BELOW_MM)))
    return pictures(small_rig(), Scene(table, tuple(layers)), seed)


@functools.cache
def taught() -> Job:
    """The job taught from the pair alone."""
    return teach_pair(*taught_pair(), prepare(small_rig()).rectification, None, "D3")


@functools.cache
def taught_job() -> Job:
    """The job from pair and file, shared by most tests as it takes a quarter of a minute."""
    return settled(taught(), taught_pair()).job


@functools.cache
def taught_pair() -> tuple[Image, Image]:
    """The pair of the part as it lies for teaching."""
    return see(square())


def write_pair(folder: Path, name: str, pair: tuple[Image, Image]) -> tuple[Path, Path]:
    """Write a pair to files."""
    paths = folder / f"{name}_left.png", folder / f"{name}_right.png"
    for path, image in zip(paths, pair, strict=True):
        cv2.imwrite(str(path), image)
    return paths


@pytest.mark.long
def test_a_result_has_the_frame_of_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Taught and located by the commands, four points of the file's frame, tilted by 20°, are right within
    30 µm."""
    save_rig(tmp_path / "rig.json", small_rig())
    left, right = write_pair(tmp_path, "taught", see(square()))
    source = chosen_source(PairSource(left, right, None, (), STEP, "-z"), NO_DRAWING)
    said, page = Console(record=True, width=200), tmp_path / "D3.html"
    teach(
        tmp_path / "rig.json", source, "D3", tmp_path / "job", said, TeachOptions(tilt_deg=30.0), report=page
    )
    for text in (said.export_text(), page.read_text()):
        assert "D3.step: 11 of 11 curves lie where it has them" in text
    where = lying(small_rig(), 20.0, 60.0, 130.0)
    left, right = write_pair(tmp_path, "seen", see(where, seed=4))
    capsys.readouterr()
    assert 0 == locate(tmp_path / "rig.json", tmp_path / "job", left, right, True, QUIET)
    (target,) = json.loads(capsys.readouterr().out)["targets"]
    places = np.array([[14.5, -12.5, 0.0], [-14.5, 12.5, 0.0], [-9.0, -7.0, -2.5], [0.0, 0.0, 0.0]])
    found = apply(np.array(target["rig_from_model"]), places)
    assert np.linalg.norm(found - apply(where, places), axis=1).max() < 0.03


@pytest.mark.slow
def test_settled_sizes_are_those_of_the_file() -> None:
    """For a sharp part, every circle has the file's radius and place exactly."""
    job = taught_job()
    assert {2.1, 1.4, 1.0, 1.9} == {round(one.radius_mm, 9) for one in job.circles}
    assert job.part_from_model is not None
    model_from_part = invert(job.part_from_model)
    places = {tuple(np.round(apply(model_from_part, one.centre_mm), 6)) for one in job.circles}
    assert {(10, -7, 0), (3, -7, 0), (-9, 8, 0), (-9, 1.8, 0), (-9, -7, -2.5)} == places


@pytest.mark.slow
def test_a_moved_hole_is_another_revision() -> None:
    """A hole 0.3 mm beside the file's is named with its offset."""
    holes = (HOLES[0], Hole("h1", Disc(3.3, -7, 1.4)), *HOLES[2:])
    job = teach_pair(*see(square(), holes), prepare(small_rig()).rectification, None, "D3")
    with pytest.raises(TeachError, match="another revision") as caught:
        settled(job, taught_pair())
    said = re.search(
        r"radius 1\.400 mm at \(3\.000, -7\.000, 0\.000\) and lies (\S+) mm aside", str(caught.value)
    )
    assert said is not None
    assert 0.3 == pytest.approx(float(said[1]), abs=0.03)


@pytest.mark.long
def test_a_moved_hole_is_named_by_all_edges_too() -> None:
    """With all edges, a hole 0.3 mm beside its place is named, though most edges agree."""
    holes = (HOLES[0], Hole("h1", Disc(3.3, -7, 1.4)), *HOLES[2:])
    with pytest.raises(TeachError, match="another revision") as caught:
        with_model(see(square(), holes))
    said = re.search(
        r"hole of radius 1\.400 mm at \(3\.000, -7\.000, 0\.000\) lies (\S+) mm aside", str(caught.value)
    )
    assert said is not None
    assert 0.3 == pytest.approx(float(said[1]), abs=0.07)


@pytest.mark.long
def test_what_the_pair_alone_takes_for_another_revision_is_asked_of_all_edges(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """If circles disagree with the file because of a bright counterbore wall, all edges still settle the
    pose."""

    def accused(*_: object) -> Settled:
        raise TeachError("c0 is 0.089 mm smaller", "revision")

    monkeypatch.setattr(cadpair, "settle", accused)
    job = with_model(taught_pair()).job
    assert job.part_from_model is not None
    places = np.array([[14.5, -12.5, 0.0], [-14.5, 12.5, 0.0], [-9.0, -7.0, -2.5], [0.0, 0.0, 0.0]])
    found = apply(job.rig_from_part @ job.part_from_model, places)
    assert np.linalg.norm(found - apply(square(), places), axis=1).max() < 0.03


def with_model(pair: tuple[Image, Image]) -> Settled:
    """The job from a pair and the file."""
    _, model = read_model(STEP, "-z")
    view = view_of(*pair, prepare(small_rig()).rectification, None)
    return cadpair.teach_with_model(view, model.curves, "D3", WantedJob("D3", 1))


@pytest.mark.slow
def test_an_edge_break_is_stated_and_kept() -> None:
    """Holes 0.4 mm wider than in the file are reported as broken edges, and keep their seen radius."""
    job = taught()
    circles = tuple(replace(one, radius_mm=one.radius_mm + 0.4) for one in job.circles)
    found = settled(replace(job, circles=circles), taught_pair())
    said = [line for line in found.remarks if "edge break" in line]
    assert 1 == len(said)
    low, high = (float(number) for number in re.findall(r"(\d\.\d+)", said[0])[:2])
    assert 0.4 == pytest.approx(low, abs=0.02)
    assert 0.4 == pytest.approx(high, abs=0.02)
    assert [one.radius_mm for one in circles] == [one.radius_mm for one in found.job.circles]


@pytest.mark.slow
def test_a_smaller_hole_is_no_edge_break() -> None:
    """A hole smaller than in the file is refused, as breaking an edge adds no material."""
    job = taught()
    circles = tuple(replace(one, radius_mm=one.radius_mm - 0.2) for one in job.circles)
    with pytest.raises(TeachError, match=r"its radius is 0\.\d+ mm smaller"):
        settled(replace(job, circles=circles), taught_pair())


@pytest.mark.slow
def test_a_job_keeps_the_frame_on_disc(tmp_path: Path) -> None:
    """The frame is stored exactly, and a matrix that is not rigid is an error naming its key."""
    job = taught_job()
    save_job(tmp_path / "job", job)
    again = load_job(tmp_path / "job")
    assert job.part_from_model is not None and again.part_from_model is not None
    assert np.array_equal(job.part_from_model, again.part_from_model)
    text = (tmp_path / "job" / "job.toml").read_text()
    broken = re.sub(r"part_from_model = \[\n.*\n", "part_from_model = [\n    [2.0, 0.0, 0.0, 0.0],\n", text)
    (tmp_path / "job" / "job.toml").write_text(broken)
    with pytest.raises(FileFormatError, match="part_from_model is not a rigid motion"):
        load_job(tmp_path / "job")


@pytest.mark.long
def test_the_frame_of_the_file_is_published_where_the_job_says_so(tmp_path: Path) -> None:
    """With `report` a point of the file is published within 30 µm, with the file's axes and levered sigma."""
    points = (
        ModelPoint("tip", np.array([-14.5, 12.5, 6.0])),
        ModelPoint("far", np.array([4000.0, 0.0, 0.0])),
    )
    job = replace(taught_job(), points=points, report="tip")
    save_job(tmp_path / "job", job)
    where = lying(small_rig(), 20.0, 60.0, 130.0)
    pair = frame_pair(*see(where, seed=4))
    told = {}
    for report in ("tip", "model", "far", "reference"):
        kept = replace(load_job(tmp_path / "job"), tilt_rad=math.radians(30.0), report=report)
        (told[report],) = picked(find(pair, kept, prepare(small_rig())), kept.picking, RobotFrame()).targets
    for report, place in (("tip", points[0].position_mm), ("model", np.zeros(3))):
        assert np.linalg.norm(told[report].position_mm - apply(where, place)) < 0.03
        assert np.abs(told[report].rig_from_part[:3, :3] - where[:3, :3]).max() < 2e-3
        assert Reject.NONE is told[report].reject
    arm = told["tip"].position_mm - told["reference"].position_mm
    assert np.array_equal(shifted_pose_covariance(told["reference"].covariance, arm), told["tip"].covariance)
    assert Reject.SIGMA_LIMIT in told["far"].reject


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('report = "tip"', "report 'tip' is none of reference, model"),
        ('report = "model"\n[[point]]\nname = "model"\nposition_mm = [0, 0, 0]', "two points have one name"),
        ('[[point]]\nname = "a"\nposition_mm = [0, 0, nan]', "finite"),
        ('[[point]]\nname = "a"\nposition_mm = [0, 0]', "at least 3"),
    ],
)
def test_a_report_that_is_none_is_refused(tmp_path: Path, line: str, said: str) -> None:
    """An invalid `report` is refused with the valid values and the file's name."""
    save_job(tmp_path / "job", drawn())
    path = tmp_path / "job" / "job.toml"
    key, _, tables = line.partition("\n") if line.startswith("report") else ("", "", line)
    text = path.read_text()
    text = re.sub(r"report = .*", key, text) if key else text
    path.write_text(f"{text}\n{tables}\n")
    with pytest.raises(FileFormatError, match=said):
        load_job(tmp_path / "job")


@pytest.mark.slow
def test_a_job_without_a_model_has_no_frame_to_report(tmp_path: Path) -> None:
    """`report` without a model is refused in the file, and dropped when carried over from a job with one."""
    job = replace(drawn(), part_from_model=None, sigma_mm=0.0)
    save_job(tmp_path / "job", job)
    path = tmp_path / "job" / "job.toml"
    path.write_text(path.read_text().replace("[limits]", 'report = "model"\n[limits]'))
    with pytest.raises(FileFormatError, match="report and points need part_from_model"):
        load_job(tmp_path / "job")
    again, said = carry_over(replace(drawn(), report="model"), job)
    assert "reference" == again.report
    assert [line for line in said if "report = model is dropped" in line]
    again, said = carry_over(replace(drawn(), report="model"), drawn())
    assert "model" == again.report
    assert "kept: report = model" in said


@pytest.mark.slow
def test_a_job_keeps_the_surface_of_its_part(tmp_path: Path) -> None:
    """The surface is stored with the shape in some kilobytes, and damage to it is named."""
    job = drawn()
    save_job(tmp_path / "job", job)
    again = load_job(tmp_path / "job").body
    assert job.body is not None and again is not None
    assert np.array_equal(job.body.triangles, again.triangles)
    assert (tmp_path / "job" / "shape.npz").stat().st_size < 100_000
    shape = tmp_path / "job" / "shape.npz"
    arrays = unpack_arrays(shape.read_bytes(), shape, "edged-shape", 1)
    arrays["body_triangles"] = arrays["body_triangles"] + np.uint32(10**6)
    shape.write_bytes(pack_arrays("edged-shape", 1, arrays))
    with pytest.raises(FileFormatError, match=r"shape\.npz: body_triangles: of points that are not there"):
        load_job(tmp_path / "job")
    save_job(tmp_path / "plain", taught())
    assert load_job(tmp_path / "plain").body is None


@pytest.mark.slow
def test_what_an_overhang_hides_is_not_taught() -> None:
    """A hole hidden below a cap is not taught as a feature."""
    cap = ring(60, 8.0, 1.5, 2.0) + np.array([0.0, 0.0, 4.0])
    points, triangles = welded(np.concatenate([ring(60, 12.0, 3.0, 2.0), cap]))
    model = CadModel(points, triangles, np.arange(len(triangles)), ())
    shown = faceted_curves(model, np.array([0.0, 0.0, 1.0]))
    assert {12.0, 8.0, 3.0, 1.5} == {round(one.radius_mm, 3) for one in shown.circles}
    job, _ = teach_model(model, shown, prepare(small_rig()).rectification, 205.0, "mushroom")
    assert {12.0, 8.0, 1.5} == {round(one.radius_mm, 3) for one in job.circles}


def stl_of(folder: Path, scale: float = 1.0) -> Path:
    """The part's triangles as STL, in units of 1/scale mm."""
    model = read_step(STEP)
    path = folder / "D3.STL"
    path.write_bytes(binary(scale * model.points_mm[model.triangles]))
    return path


@pytest.mark.long
def test_an_stl_file_settles_a_pair_as_well(tmp_path: Path) -> None:
    """Radii and centres equal the STEP file's within 0.1 µm, with the facets' uncertainty in the job's
    sigma."""
    curves = read_model(stl_of(tmp_path), "-z")[1].curves
    found = settle(
        taught(), curves, StereoImages.of(prepare(small_rig()).rectification, *taught_pair()), "D3.STL"
    )
    exact = taught_job()
    assert "D3.STL: 11 of 11 curves lie where it has them" in found.remarks
    for one, other in zip(exact.circles, found.job.circles, strict=True):
        assert np.abs(one.centre_mm - other.centre_mm).max() < 1e-4
        assert one.radius_mm == pytest.approx(other.radius_mm, abs=1e-4)
    assert 0.0 == exact.sigma_mm
    assert 0.0002 < found.job.sigma_mm < 0.002


@pytest.mark.long
def test_radii_of_a_coarse_file_are_those_of_the_pair(tmp_path: Path) -> None:
    """Where chords leave 20 µm of uncertainty, the radii of the pair are used, which is reported."""
    curves = read_model(stl_of(tmp_path), "-z")[1].curves
    coarse = replace(curves, circles=tuple(replace(one, sigma_mm=0.02) for one in curves.circles))
    found = settle(
        taught(), coarse, StereoImages.of(prepare(small_rig()).rectification, *taught_pair()), "D3.STL"
    )
    assert [one.radius_mm for one in taught().circles] == [one.radius_mm for one in found.job.circles]
    assert 0.0 == found.job.sigma_mm
    assert [line for line in found.remarks if "radius as seen" in line and "0.020 mm open: c0, c1" in line]
    alone = teach_model(read_step(STEP), coarse, prepare(small_rig()).rectification, 205.0, "D3")[0]
    assert 0.02 == pytest.approx(alone.sigma_mm)


def test_the_unit_of_an_stl_file_is_asked_for(tmp_path: Path) -> None:
    """For a file in inches the error states its assumed size, and how to give the unit."""
    save_rig(tmp_path / "rig.json", small_rig())
    drawing = replace(NO_DRAWING, depth_mm=205.0)
    inches = PairSource(None, None, None, (), stl_of(tmp_path, 1 / 25.4), "-z")
    with pytest.raises(TeachError, match=r"has no unit: its 1\.142 x 0\.9843 x 0\.3346 were taken as mm"):
        teach(tmp_path / "rig.json", chosen_source(inches, drawing), "D3", tmp_path / "job", QUIET)
    source = chosen_source(inches, replace(drawing, unit="in"))
    assert 0 == teach(tmp_path / "rig.json", source, "D3", tmp_path / "job", QUIET)
    with pytest.raises(TeachError, match="says its own unit"):
        read_model(STEP, "-z", "in")


@pytest.mark.parametrize(("step", "up"), [(STEP, None), (None, "z")])
def test_half_a_model_is_refused(step: Path | None, up: str | None) -> None:
    """--step without --up, and --up without --step, are refused."""
    with pytest.raises(UserError, match="--step FILE and --up AXIS belong together"):
        chosen_source(PairSource(Path("l"), Path("r"), None, (), step, up), NO_DRAWING)


def test_an_axis_is_one_of_six() -> None:
    """Any other axis is refused with the valid ones."""
    with pytest.raises(
        TeachError, match="--up 'w': expected an axis of the file, one of x, y, z, -x, -y, -z"
    ):
        read_model(STEP, "w")


@functools.cache
def drawn() -> Job:
    """The job taught from the file alone."""
    model, shown = read_model(STEP, "-z")
    return teach_model(model, shown.curves, prepare(small_rig()).rectification, 205.0, "D3")[0]


@pytest.mark.long
@pytest.mark.parametrize(("tilt_deg", "turn_deg"), [(0.0, 40.0), (30.0, 200.0)])
def test_a_file_alone_is_enough_to_find_the_part(tilt_deg: float, turn_deg: float) -> None:
    """A sharp part is found within 30 µm, with a sigma for breaks that it may hide."""
    where = lying(small_rig(), tilt_deg, 60.0, turn_deg)
    job = replace(drawn(), tilt_rad=math.radians(45.0))
    target = only(find(frame_pair(*see(where, seed=3)), job, prepare(small_rig())))
    places = np.array([[14.5, -12.5, 0.0], [-14.5, 12.5, 0.0], [-9.0, -7.0, -2.5]])
    assert target.rig_from_model is not None
    off = np.linalg.norm(apply(target.rig_from_model, places) - apply(where, places), axis=1)
    normal = target.rig_from_part[:3, 2]
    assert Reject.NONE is target.reject
    assert off.max() < 0.03
    assert math.sqrt(normal @ target.covariance[:3, :3] @ normal) >= 0.2
    budget = budget_of(target, None, None)
    assert budget is not None
    assert budget.edges[:3].max() >= 0.1**2
    assert budget.calibration[:3].max() < 0.01


@pytest.mark.slow
def test_a_file_alone_teaches_every_feature_of_its_faces() -> None:
    """It teaches five holes and the edges of both faces at their heights."""
    job = drawn()
    assert [0.0, 0.0, 0.0, 0.0, -2.5] == [float(one.centre_mm[2]) for one in job.circles]
    assert 6 == sum(float(one.start_mm[2]) == 0.0 for one in job.edges)
    assert 4 == sum(float(one.start_mm[2]) == -2.5 for one in job.edges)


@pytest.mark.slow
def test_of_a_broken_edge_the_upper_one_is_taught() -> None:
    """For each broken edge of the flange the face's circle is taught."""
    model, shown = read_model(STEP.with_name("D1.step"), "-z")
    job, _ = teach_model(model, shown.curves, prepare(small_rig()).rectification, 205.0, "D1")
    assert [15.8, 5.2, 2.4, 1.8, 1.8, 1.8, 1.8] == [round(one.radius_mm, 9) for one in job.circles]
    assert {0.0} == {float(one.centre_mm[2]) for one in job.circles}


@pytest.mark.slow
def test_an_axis_that_hides_every_feature_is_named() -> None:
    """The error says what was expected, and names the option."""
    model, shown = read_model(STEP, "-z")
    nothing = replace(shown.curves, circles=(), edges=())
    with pytest.raises(TeachError, match=r"the model shows nothing .* or another up axis"):
        teach_model(model, nothing, prepare(small_rig()).rectification, 205.0, "D3")


@pytest.mark.slow
def test_a_pair_ends_the_vagueness_of_a_file_alone() -> None:
    """After teaching with both, the limit needed by a job from a file alone is not carried over."""
    again, said = carry_over(drawn(), taught_job())
    assert 0.2 == again.limits.max_sigma_mm
    assert not [line for line in said if "max_sigma_mm" in line]


@pytest.mark.slow
def test_a_job_keeps_its_sigma_on_disc(tmp_path: Path) -> None:
    """The sigma of a job's features is stored."""
    save_job(tmp_path / "job", replace(drawn(), sigma_mm=0.1))
    assert 0.1 == load_job(tmp_path / "job").sigma_mm


@pytest.mark.slow
def test_a_file_alone_needs_its_distance(tmp_path: Path) -> None:
    """Without --depth it is refused, as is a distance at which the part does not fit the picture."""
    with pytest.raises(UserError, match="--depth missing"):
        chosen_source(PairSource(None, None, None, (), STEP, "-z"), NO_DRAWING)
    save_rig(tmp_path / "rig.json", small_rig())
    near = replace(NO_DRAWING, depth_mm=60.0)
    source = chosen_source(PairSource(None, None, None, (), STEP, "-z"), near)
    with pytest.raises(TeachError, match="does not fit the image at this distance"):
        teach(tmp_path / "rig.json", source, "D3", tmp_path / "job", QUIET)
    far = replace(near, depth_mm=205.0)
    source = chosen_source(PairSource(None, None, None, (), STEP, "-z"), far)
    assert 0 == teach(tmp_path / "rig.json", source, "D3", tmp_path / "job", QUIET)
    assert (tmp_path / "job" / "job.toml").is_file()
