"""Parts with a CAD model whose edge breaks neither the file nor teaching shows: each pair shows them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.drawnparts import from_file, images_of, place, rig
from solids import random_design
from solidworld import Look, World, drawn, pictures, world_rig, write_drawing

from edged.commands.teach import read_model
from edged.domain.arrays import FloatArray
from edged.domain.measurement import Reject, Target
from edged.errors import TeachError
from edged.files.jobs import load_job, save_job
from edged.vision.geometry.rectification import StereoImages
from edged.vision.part.job import Job
from edged.vision.solid.forms import with_breaks
from edged.vision.solid.jobmodels import models_of, wanted_of
from edged.vision.solid.locate import locate_solid
from edged.vision.solid.modes import find_places, pyramids_of
from edged.vision.solid.weighing import (
    FoundPart,
    weighed,
    weighed_with_breaks_of,
    weighed_with_own_breaks,
)
from edged.vision.teaching import cadpair
from edged.vision.teaching.cadsettling import Settled
from edged.vision.teaching.furtherpairs import with_breaks_shown
from edged.vision.teaching.pair import WantedJob, view_of

DEPTH_MM = 205.0


def hiding(design: int, seed: int) -> StereoImages:
    """A teaching pair of a part with walls and breaks about as bright as its faces."""
    look = Look.drawn(np.random.default_rng(seed))
    like_face = replace(look.breaks[0], level=0.95, glint=0.0)
    look = replace(look, breaks=(like_face, like_face), wall=1.0, table=0.1, table_contrast=0.05)
    pair = pictures(World(random_design(design), place(0.0), look, seed), world_rig())
    return StereoImages.of(rig().rectification, *pair)


def narrow(design: int, break_mm: float) -> StereoImages:
    """A teaching pair of a part with all of its breaks of one width."""
    part = random_design(design)
    walls = tuple(replace(wall, break_mm=break_mm if wall.break_mm else 0.0) for wall in part.walls)
    rng = np.random.default_rng((1, design, 0))
    pair, _ = drawn(replace(part, walls=walls), place(0.0), rng, teaching=True)
    return StereoImages.of(rig().rectification, *pair)


def from_both(folder: Path, design: int, images: StereoImages) -> Settled:
    """The job of a drawn part, taught from a pair and its file."""
    write_drawing(folder, random_design(design))
    _, shown = read_model(folder / f"P{design}.step", "-z")
    view = view_of(*images.raw, rig().rectification, None)
    return cadpair.teach_with_model(view, shown.curves, f"P{design}", WantedJob(f"P{design}", 1))


def only(images: StereoImages, job: Job) -> Target:
    """The one part that is found."""
    measured, dismissed, _ = locate_solid(images, job)
    assert 1 == len(measured)
    assert not dismissed
    return measured[0].target


def off_mm(target: Target, tilt_deg: float) -> float:
    """Distance of the model's origin from its true place."""
    assert target.rig_from_model is not None
    return apart_mm(target.rig_from_model, tilt_deg)


def apart_mm(rig_from_model: FloatArray, tilt_deg: float) -> float:
    """Distance of the model's origin, at a pose, from its true place."""
    return float(np.linalg.norm(rig_from_model[:3, 3] - place(tilt_deg)[:3, 3]))


@pytest.mark.long
@pytest.mark.parametrize(("design", "seed"), [(4, 2), (8, 1)])
def test_a_file_alone_measures_a_part_by_the_breaks_that_the_pair_shows(
    tmp_path: Path, design: int, seed: int
) -> None:
    """Parts with breaks of 0.39 and 0.25 mm, taught from files without any, are right to 40 µm.

    Their sigma says so. Laid sharp, they were off by as much as the breaks.
    """
    target = only(images_of(design, seed, 20.0), from_file(tmp_path, design))
    assert Reject.NONE is target.reject
    assert off_mm(target, 20.0) < 0.04
    assert target.sigma_mm.max() < 0.06


@pytest.mark.long
@pytest.mark.parametrize(("design", "seed"), [(0, 1), (4, 1)])
def test_breaks_that_a_pair_hides_are_in_the_sigma(tmp_path: Path, design: int, seed: int) -> None:
    """Parts whose breaks are as bright as their faces are off by up to their width; the sigma says so."""
    target = only(images_of(design, seed, 20.0), from_file(tmp_path, design))
    assert 0.1 < off_mm(target, 20.0) < 3 * float(target.sigma_mm.max())


@pytest.mark.long
def test_a_width_from_the_drawing_settles_the_breaks(tmp_path: Path) -> None:
    """`break_mm` in the job's file leaves one form, and a part that hides its breaks is right."""
    save_job(tmp_path / "job", from_file(tmp_path, 4))
    text = (tmp_path / "job" / "job.toml").read_text()
    assert "# break_mm = 0.2" in text
    (tmp_path / "job" / "job.toml").write_text(text.replace("# break_mm = 0.2", "break_mm = 0.394"))
    job = load_job(tmp_path / "job")
    assert 1 == len(models_of(job))
    target = only(images_of(4, 1, 20.0), job)
    assert Reject.NONE is target.reject
    assert off_mm(target, 20.0) < min(0.08, 3 * float(target.sigma_mm.max()))


@pytest.mark.long
@pytest.mark.parametrize(("design", "break_mm"), [(4, 0.394), (12, 0.439)])
def test_wide_breaks_are_found_where_curves_do_not_tell_how_a_part_lies(
    tmp_path: Path, design: int, break_mm: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A scan with narrow breaks leads between the two edges of wide ones, one with wide breaks to them."""

    def open_turn(*_: object) -> Settled:
        raise TeachError("fits otherwise as well", "open_turn")

    monkeypatch.setattr(cadpair, "settle", open_turn)
    body = from_both(tmp_path, design, images_of(design, 1)).job.body
    assert body is not None
    assert body.breaks_mm is not None
    assert break_mm == pytest.approx(float(np.median(body.breaks_mm[body.breaks_mm > 0])), abs=0.03)


@pytest.mark.long
def test_a_pair_that_hides_breaks_leaves_them_open(tmp_path: Path) -> None:
    """Where edges do not fit a part laid as sharp, its breaks may hide: each picture has to show them."""
    settled = from_both(tmp_path, 11, hiding(11, 1))
    assert settled.job.body is not None
    assert settled.job.body.breaks_mm is None
    assert [line for line in settled.remarks if "may hide" in line]
    further = images_of(11, 1, 20.0)
    job, said = with_breaks_shown(settled.job, hiding(11, 1).raw, [further.raw], rig().rectification)
    assert not job.has_open_breaks
    assert "pair 2: shows them" in said
    assert np.linalg.norm(job.rig_from_part[:3, 3] - settled.job.rig_from_part[:3, 3]) > 0.02
    target = only(images_of(11, 1, 20.0), settled.job)
    assert Reject.NONE is target.reject
    assert off_mm(target, 20.0) < 0.04


@pytest.mark.long
def test_breaks_that_are_little_certain_are_in_the_sigma(tmp_path: Path) -> None:
    """Breaks of 0.12 mm by which a part fits somewhat better are taken, with their sigma."""
    settled = from_both(tmp_path, 326, narrow(326, 0.12))
    body = settled.job.body
    assert body is not None
    assert body.breaks_mm is not None
    assert body.breaks_mm.any()
    assert settled.job.sigma_mm > 0.02
    assert [line for line in settled.remarks if "little certainty" in line]
    target = only(narrow(326, 0.12), settled.job)
    assert Reject.NONE is target.reject
    assert 0.05 < off_mm(target, 0.0) < 2 * float(target.sigma_mm.max())


@pytest.mark.long
def test_breaks_that_contradict_teaching_are_laid_anew(tmp_path: Path) -> None:
    """A part taught as sharp, whose breaks a picture shows, is measured by them; it was refused before."""
    job = from_file(tmp_path, 202)
    assert job.body is not None
    sharp = replace(job, body=replace(job.body, breaks_mm=np.zeros(len(job.body.lines))))
    target = only(images_of(202, 1, 10.0), sharp)
    assert Reject.NONE is target.reject
    assert off_mm(target, 10.0) < 0.04


@pytest.mark.long
def test_further_parts_of_a_picture_are_weighed_with_the_breaks_of_its_first(tmp_path: Path) -> None:
    """Breaks as one part shows them explain another one at once; breaks that do not fit are laid anew."""
    job = from_file(tmp_path, 8)

    def seen(tilt_deg: float, breaks_of: FoundPart | None) -> FoundPart | None:
        images = images_of(8, 1, tilt_deg)
        pyramids = pyramids_of(images, wanted_of(job))
        place = find_places(wanted_of(job), pyramids)[0]
        if breaks_of is not None:
            return weighed_with_breaks_of(breaks_of, images, job, place, pyramids)
        by_any = weighed(pyramids, place, lambda _: ())
        return weighed_with_own_breaks(images, job, by_any, place, pyramids)

    first = seen(20.0, None)
    assert first is not None
    found = seen(30.0, first)
    assert found is not None
    assert job.part_from_model is not None
    assert apart_mm(found.laid.pose @ job.part_from_model, 30.0) < 0.1
    wrong = replace(first.laid, model=with_breaks(first.laid.model, 0.7))
    assert seen(30.0, replace(first, laid=wrong)) is None
