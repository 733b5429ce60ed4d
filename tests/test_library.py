"""The library's interface: the names of `from edged import ...`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.cells import flange, frame_pair

import edged
from edged import errors, library
from edged.pipeline import locate, prepare
from edged.vision.part.job import Job
from edged.vision.teaching.region import CircleRegion


@pytest.fixture(scope="module")
def job() -> Job:
    """A job of the demo's flange."""
    part = flange()
    return edged.teach(part.left, part.right, part.rig, part.region, name="flange")


def test_importing_edged_loads_nothing() -> None:
    """`import edged` loads no other module."""
    code = "import sys; old = set(sys.modules); import edged; print(*sorted(set(sys.modules) - old))"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert ["edged"] == ran.stdout.split()


def test_the_command_line_does_not_load_the_library() -> None:
    """The command line loads neither the library nor numba."""
    code = "import sys, edged.cli.main; print(*({'edged.library', 'numba'} & set(sys.modules)))"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert [] == ran.stdout.split()


def test_the_names_are_those_of_the_library() -> None:
    """The names of `__all__`, and no others, exist."""
    assert {getattr(library, name) for name in edged.__all__} == {
        getattr(edged, name) for name in edged.__all__
    }
    with pytest.raises(AttributeError, match="module 'edged' has no attribute 'solve'"):
        edged.solve  # type: ignore[attr-defined]  # noqa: B018  (it is the look-up that is refused)


@pytest.mark.slow
def test_locate_gives_the_digits_of_the_pipeline(job: Job) -> None:
    """Pose and covariance equal the pipeline's exactly, also with a rig that is used a second time."""
    part = flange()
    (expected,) = locate(frame_pair(part.left, part.right), job, prepare(part.rig)).targets
    for _ in range(2):
        (target,) = edged.locate(part.left, part.right, job, part.rig).targets
        np.testing.assert_array_equal(expected.rig_from_part, target.rig_from_part)
        np.testing.assert_array_equal(expected.covariance, target.covariance)


@pytest.mark.slow
def test_what_is_saved_is_what_is_loaded(job: Job, tmp_path: Path) -> None:
    """A saved job and rig locate the same after loading."""
    part = flange()
    edged.save_rig(tmp_path / "rig.json", part.rig)
    edged.save_job(tmp_path / "flange", job)
    rig, read = edged.load_rig(str(tmp_path / "rig.json")), edged.load_job(str(tmp_path / "flange"))
    (expected,) = edged.locate(part.left, part.right, job, part.rig).targets
    (target,) = edged.locate(part.left, part.right, read, rig).targets

    np.testing.assert_array_equal(expected.rig_from_part, target.rig_from_part)


@pytest.mark.long
def test_what_weakens_a_job_is_a_warning() -> None:
    """A region that cuts the part gives a warning."""
    part = flange()
    region = part.region
    middle = region.x + region.width / 2, region.y + region.height / 2
    with pytest.warns(UserWarning, match="The region cuts"):
        edged.teach(part.left, part.right, part.rig, CircleRegion(*middle, 0.35 * region.width))


def test_mistakes_are_refused_in_a_sentence() -> None:
    """Images of another size or kind, an impossible name or tilt, and pictures without a board are
    refused."""
    part, image = flange(), np.zeros((48, 64), np.uint8)
    with pytest.raises(errors.ImageError, match="left image: 64x48, the rig was calibrated for 640x480"):
        edged.teach(image, image, part.rig)
    with pytest.raises(errors.ImageError, match=r"right image: \(48, 64\) float64, expected grey"):
        edged.calibrate([(image, image.astype(float))], "chessboard:9x6:25")  # type: ignore[list-item]  # on purpose
    with pytest.raises(errors.TeachError, match="expected up to 64 letters"):
        edged.teach(part.left, part.right, part.rig, name="a b")
    with pytest.raises(errors.TeachError, match="expected more than 0 and at most 45 degrees"):
        edged.teach(part.left, part.right, part.rig, tilt_rad=1.0)
    with pytest.raises(errors.CalibrationError):
        edged.calibrate([(image, image)] * 3, "chessboard:9x6:25")
