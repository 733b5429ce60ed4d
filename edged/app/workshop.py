"""What a cell is set up with over its page: drafts, the worker process, and what becomes of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from edged.app.status import Running
from edged.cycle import Cycle
from edged.session.live import LivePictures
from edged.session.notices import Notices
from edged.workshop.calibrations import FUNCTIONS, Calibrations
from edged.workshop.tasks import Tasks
from edged.workshop.worker import Worker

if TYPE_CHECKING:
    from edged.adapters.web.routes import RouteTable


def state_folder(config: Path) -> Path:
    """Of what the page makes: in the service's state directory; without a service manager beside the file."""
    state = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(state) / "cell" if state else config.resolve().parent / f".{config.stem}.cell"


class Workshop:
    """Built for the first page that may set the cell up; outlives its reloads.

    running : the cell, as it is then.
    """

    def __init__(
        self,
        config: Path,
        cycle: Cycle,
        running: Callable[[], Running],
        notices: Notices,
        live: LivePictures,
    ) -> None:
        folder = state_folder(config)
        # while the cell measures, one processor is left to it alone
        self._worker = Worker(FUNCTIONS, lambda: 2 if cycle.in_setup else 1)
        self._tasks = Tasks(notices)
        self._calibrations = Calibrations(
            folder / "drafts",
            self._worker,
            self._tasks,
            notices,
            cycle.capture,
            lambda: running().loaded.cell.config.cell.rig,
            lambda identity: identity == running().loaded.setup.calibration_id,
        )
        self._stop = live.listen(self._calibrations.offer)

    def rooms(self) -> Sequence[Callable[[RouteTable], None]]:
        """What adds the routes of all this."""
        from edged.workshop.calibrationroutes import CalibrationRoutes  # aiohttp: only with a page

        return [CalibrationRoutes(self._calibrations, self._tasks).add_to]

    async def close(self) -> None:
        """End the worker process; drafts are on disc."""
        self._stop()
        await self._calibrations.close()
        await self._tasks.close()
        await self._worker.close()
