"""The overview of a measuring cell for people who set it up."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.livecell import Head
from helpers.smallcell import SmallCell

from edged.app.cell import load_cell
from edged.app.running import Running
from edged.cell.cycle import Cycle
from edged.files.jobs import load_job
from edged.files.rig import load_rig, save_rig
from edged.vision.geometry.projection import project_with_jacobians
from edged.vision.geometry.rigid import apply
from edged.vision.geometry.triangulation import triangulate_raw


async def never() -> str:
    """A reload that must not happen."""
    raise NotImplementedError


def told(config: Path) -> tuple[float, float, float] | None:
    """The sigma of X, Y, Z."""
    loaded = load_cell(config)
    head = Head()
    rig = Running(config, loaded, Cycle(head, loaded.setup), head, never).overview().rig
    assert rig is not None
    return rig.sigma_um


@pytest.mark.slow
def test_the_sigma_of_the_rig_is_what_its_covariance_does_where_parts_were_taught(tmp_path: Path) -> None:
    """The rig's sigma is its covariance at the taught place; without a covariance it is unknown."""
    cell = SmallCell(tmp_path, source="virtual-inprocess")
    path = tmp_path / "rig.json"
    true, sigma_mm = load_rig(path), 0.01
    save_rig(path, replace(true, covariance=None))
    assert None is told(cell.config)

    variances = [sigma_mm**2 * (name == "translation.x") for name in true.parameter_names]
    save_rig(path, replace(true, covariance=np.diag(variances)))
    place = load_job(tmp_path / "jobs" / "flange").rig_from_part[:3, 3][None]
    seen = (true.left, place), (true.right, apply(true.right_from_left, place))
    pixels = [project_with_jacobians(camera, points)[0] for camera, points in seen]
    relation = true.right_from_left.copy()
    relation[0, 3] += sigma_mm
    moved = triangulate_raw(replace(true, right_from_left=relation), *pixels) - place
    sigma_um = told(cell.config)
    assert sigma_um is not None
    assert pytest.approx(1e3 * np.abs(moved[0]), rel=1e-3, abs=1e-3) == sigma_um
    assert sigma_um[2] > 1
