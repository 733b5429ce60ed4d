"""Golden parts kept in memory, for cells whose pictures are made up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from edged.cell.loaded import Setup
from edged.domain.events import Snapshot
from edged.domain.golden import Golden
from edged.errors import UserError
from edged.robot.covariance import robot_covariance
from edged.robot.golden import golden_target, held
from helpers.livecell import LiveCell
from helpers.rigs import make_rig


class MemoryKeeper:
    """A `GoldenKeeper` of a live cell. kept : number kept. cannot : reason to refuse, or ""."""

    def __init__(self, cell: LiveCell) -> None:
        self.cell = cell
        self.kept = 0
        self.cannot = ""

    async def keep(self, snapshot: Snapshot) -> Setup:
        target = golden_target(snapshot)
        if isinstance(target, str) or self.cannot:
            raise UserError(self.cannot or str(target))
        robot = snapshot.robot_from_rig
        assert robot is not None
        golden = Golden(
            snapshot.job_number,
            snapshot.job,
            "part",
            snapshot.calibration_id,
            "registration",
            snapshot.exposed_ns,
            robot,
            target.rig_from_part,
            robot_covariance(target, robot, None),
            target.covariance,
            np.zeros((0, 3)),
        )
        jobs = dict(self.cell.setup.jobs)
        part = held(golden, make_rig())
        jobs[snapshot.job_number] = replace(jobs[snapshot.job_number], golden=part)
        self.cell.setup = replace(self.cell.setup, jobs=jobs)
        self.kept += 1
        return self.cell.setup


def golden_cell(cell: LiveCell) -> MemoryKeeper:
    """Give a live cell a keeper of golden parts, before it starts."""
    keeper = MemoryKeeper(cell)
    cell.keeper = keeper
    return keeper
