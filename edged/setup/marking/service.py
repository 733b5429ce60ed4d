"""Reference marks on the page: checking them, and teaching them from pairs that are taken for it."""

from __future__ import annotations

import asyncio
import shutil
from functools import partial

from edged.errors import SetupRefused, UserError
from edged.files.atomic import make_folders
from edged.files.marks import MARKS_NAME
from edged.setup.documents import Frozen, LastDocument, SigmaXyz, now_text
from edged.setup.inuse import CellInUse
from edged.setup.pairs import Progress, write_sides
from edged.vision.marks.params import MARKS

FUNCTIONS = {name: f"edged.setup.marking.work:{name}" for name in ("look_at_marks", "teach_marks")}
Pixel = tuple[float, float]


class SeenMark(Frozen):
    """One mark, raw px: its position when taught, and now; null if not seen."""

    code: int
    was_left: Pixel
    was_right: Pixel
    left: Pixel | None
    right: Pixel | None


class MarksLookDocument(Frozen):
    """Result of one pair, as of the first exposure after a start; fields as in `marks` of results."""

    state: str
    valid: bool
    seen: int
    taught: int
    excluded: list[int]
    fit: float | None
    left_mm: float | None
    right_mm: float | None
    text: str
    marks: list[SeenMark]


class TaughtDocument(Frozen):
    """The last teaching on the page. sigma_um : left in a part among the marks after one exposure."""

    at: str
    by: str
    calibration: str
    codes: list[int]
    exposures: int
    noise_px: float
    sigma_um: SigmaXyz


class MarksDocument(Frozen):
    """State of the marks. in_use : there are some for the calibration in use. exposures : of a teaching."""

    in_use: bool
    exposures: int
    material: str
    range_k: float
    on_knock: str
    last: TaughtDocument | None


class Marking:
    """Reference marks of a cell; used on the event loop only."""

    def __init__(self, cell: CellInUse) -> None:
        self._cell = cell
        self._kept = LastDocument(
            cell.folder / "marks-taught.json", TaughtDocument, "the last teaching of marks"
        )
        self._teaching: str | None = None

    async def document(self) -> MarksDocument:
        """State of the marks."""
        stated = self._cell.files.config.marks
        return MarksDocument(
            in_use=MARKS_NAME in self._cell.files.contents,
            exposures=MARKS.min_exposures,
            material=stated.material,
            range_k=stated.range_k,
            on_knock=stated.on_knock,
            last=await asyncio.to_thread(self._kept.read),
        )

    async def look(self, token: str) -> MarksLookDocument:
        """Take a pair, and check its marks. Raises `SetupRefused`, `CaptureError`, `UserError`."""
        rig, stated = self._cell.needed_rig("that marks were taught with"), self._cell.files.config.marks
        content = self._cell.files.contents.get(MARKS_NAME)
        if content is None:
            raise UserError("this cell has no marks of its calibration: teach them")
        pair = await self._cell.session.capture(token)
        images = pair.images
        found = await self._cell.worker.run(
            "look_at_marks", rig, content, (stated.material, stated.range_k), images, pair.exposed_ns
        )
        return MarksLookDocument.model_validate(found)

    async def teach(self, token: str, author: str) -> str:
        """Start to take pairs and teach the marks in them; return the task. Raises as `look`."""
        await self._cell.session.renew_setup(token)
        if self._cell.tasks.is_running(self._teaching):
            raise SetupRefused("marks are being taught")
        self._cell.needed_rig("to teach marks with")
        self._teaching = self._cell.tasks.start("marks", partial(self._teach, token, author))
        return self._teaching

    async def _teach(self, token: str, author: str, progress: Progress) -> None:
        folder, count = self._cell.folder / "marks-pictures", MARKS.min_exposures
        rig, material = self._cell.needed_rig(), self._cell.files.config.marks.material
        await asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True)
        try:
            await asyncio.to_thread(make_folders, folder)
            for number in range(count):
                progress("take pairs", number, count)
                pair = await self._cell.session.capture(token)
                images = pair.images
                await asyncio.to_thread(write_sides, folder, f"view_{number:03d}_{{side}}.png", images)
            found = await self._cell.worker.run("teach_marks", rig, folder, material, progress=progress)
        finally:
            await asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True)
        content = found.pop("content")
        await self._cell.running.keep_beside("marks", content, token)
        x, y, z = found.pop("sigma_um")
        taught = TaughtDocument(
            at=now_text(),
            by=author,
            calibration=rig.calibration_id,
            sigma_um=SigmaXyz(x=x, y=y, z=z),
            **found,
        )
        await asyncio.to_thread(self._kept.write, taught)
