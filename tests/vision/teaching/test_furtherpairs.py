"""Further pairs of a part settle the width of its breaks and which edge of each was taught."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.drawnparts import pair, place, rig

from edged.domain.arrays import FloatArray
from edged.errors import TeachError
from edged.files.jobs import load_job, save_job
from edged.vision.geometry.rectification import StereoImages
from edged.vision.part.job import Job
from edged.vision.solid.forms import PosedPair, likeliest_form
from edged.vision.solid.jobmodels import forms_of, models_of
from edged.vision.solid.lock import Pyramids
from edged.vision.solid.params import BREAKS, DECISION
from edged.vision.teaching.furtherpairs import with_breaks_shown
from edged.vision.teaching.pair import teach

DESIGN, BREAK_MM = 4, 0.394
"""A design whose teaching pair shows the lower edges of its breaks."""


@functools.cache
def taught() -> Job:
    """The part with broken edges, taught from one pair."""
    return teach(*pair(DESIGN, 0.0), rig().rectification, None, "part")


def view(images: StereoImages, pose: FloatArray) -> PosedPair:
    """A pair that shows the part at a pose."""
    return PosedPair(images, Pyramids(images.rig, images.raw, 1), pose)


@pytest.mark.long
def test_a_tilted_pair_tells_the_form_of_the_breaks() -> None:
    """A tilted pair gives the breaks' width to 0.03 mm and shows that the lower edges were taught."""
    job = taught()
    pose = place(25.0) @ np.linalg.inv(place(0.0)) @ job.rig_from_part
    images = StereoImages.of(rig().rectification, *pair(DESIGN, 25.0))
    choice = likeliest_form(models_of(job), [view(images, pose)])
    assert choice is not None
    model = choice.form.model
    assert float(np.median(model.breaks_mm)) == pytest.approx(BREAK_MM, abs=0.03)
    assert choice.form.contradicts < BREAKS.most_misfit
    ends = {forms_of(job)[k][1] for k, share in enumerate(choice.likely) if share > DECISION.likely}
    assert ends == {True}
    assert all(form.sigmas_behind(choice.form) > DECISION.certain for form in choice.others)


@pytest.mark.long
def test_a_further_pair_settles_the_job_and_the_job_keeps_it(tmp_path: Path) -> None:
    """With a further pair both edges of each break are found, the job's file keeps it, and a line says so."""
    assert taught().break_mm is None
    job, said = with_breaks_shown(taught(), pair(DESIGN, 0.0), [pair(DESIGN, 25.0)], rig().rectification)
    assert (job.break_mm, job.break_end) == (pytest.approx(BREAK_MM, abs=0.03), "face")
    assert len(models_of(job)) == 1
    brought, settled = said
    assert brought.startswith("pair 2: turned by ")
    assert settled.endswith("both edges of each were found, by all pairs")
    save_job(tmp_path / "part", job)
    again = load_job(tmp_path / "part")
    assert (again.break_mm, again.break_end) == (job.break_mm, "face")


@pytest.mark.long
def test_a_pair_of_another_part_is_refused_by_its_number() -> None:
    """A pair of another part is refused with its number, and a job with too few curves is refused, too."""
    with pytest.raises(TeachError, match=r"^pair 2: .*expected one part"):
        with_breaks_shown(taught(), pair(DESIGN, 0.0), [pair(0, 25.0)], rig().rectification)
    few = replace(taught(), edges=taught().edges[:2], slots=(), traced=())
    with pytest.raises(TeachError, match="that few curves"):
        with_breaks_shown(few, pair(DESIGN, 0.0), [pair(DESIGN, 25.0)], rig().rectification)


@pytest.mark.slow
def test_chance_leaves_two_thirds_of_a_square_pixel() -> None:
    """In a picture of noise the profiles leave twice as much as a part may leave."""
    job = taught()
    rng = np.random.default_rng(3)
    shape, left = pair(DESIGN, 0.0)[0].shape, []
    for _ in range(4):
        images = StereoImages.of(rig().rectification, *rng.integers(60, 180, (2, *shape), np.uint8))
        profiles = view(images, job.rig_from_part).profiles(models_of(job)[0])
        left.append(np.minimum(profiles.shift_px[profiles.weight > BREAKS.min_weight] ** 2, 1.0))
    assert np.concatenate(left).mean() == pytest.approx(2 * BREAKS.most_misfit, rel=0.15)
