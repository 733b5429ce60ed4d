"""The document of a job's draft: over /api/v1, and to every open page. Pixels are those of raw pictures."""

from __future__ import annotations

from edged.files.jobs.schema import TraySection
from edged.setup.documents import (
    DraftHead,
    DraftSummary,
    Frozen,
    PicturePaths,
    PlaceMm,
    SigmaAbc,
    SigmaXyz,
    Trouble,
)
from edged.setup.outlines import Line
from edged.setup.teaching.model import Shape
from edged.vision.part.job import BreakEnd

Pixel = tuple[float, float]


class Outline(Frozen):
    """A line in each picture."""

    left: Line
    right: Line


class FeatureDocument(Frozen):
    """A feature. size : by the name of each, mm.  sigma_um : of it, in this pair; of an edge or a corner of
    its place. why : it was not measured: a code.
    """

    key: str
    kind: str
    taken: bool
    size: dict[str, float]
    sigma_um: float | None
    outline: Outline
    why: str | None


class ContoursDocument(Frozen):
    """What is searched for, as lines in each picture."""

    left: list[Line]
    right: list[Line]


class ReferenceDocument(Frozen):
    """The feature whose place is the part's, and where that is."""

    key: str
    left: Pixel
    right: Pixel


class GrippingDocument(PlaceMm):
    """Where a tool takes the part, in the part's frame; angles about its fixed x, y, z."""

    name: str
    approach_mm: float
    retreat_mm: float
    symmetry: int
    left: Pixel
    right: Pixel


class SizeDocument(Frozen):
    """A size to measure; angles in degrees. witness : the rig is watched by it. ok : within its tolerance."""

    key: str
    kind: str
    of: list[str]
    nominal: float | None
    tolerance: float | None
    measured: float | None
    sigma: float | None
    unit: str
    witness: bool
    ok: bool | None


class RivalDocument(Frozen):
    """A turn after which the shape is much like itself."""

    angle_deg: float
    alike_percent: float


class WarningDocument(Frozen):
    """What is not as it should be. at : the place in the left picture that it means."""

    code: str
    text: str
    at: Pixel | None


class PredictedDocument(Frozen):
    """The pose's sigma, as the features that are taken give it in this pair."""

    sigma_um: SigmaXyz
    sigma_deg: SigmaAbc


class DrawingDocument(Frozen):
    """What the job is learnt from instead of a region. depth_mm : of the face from the left camera."""

    name: str
    depth_mm: float
    outlines: int


class TeachingDocument(DraftHead):
    """A draft of a job. shapes : the region; those with `add` in region, the others in exclude; none: the
    whole picture. proposing : the task that learns it. job : the one that it replaces. further : names of
    pairs beside the first. break_mm : width of the part's edge breaks, null where it is not known.
    break_end : which edge of each was taught, null: either.
    """

    name: str
    number: int
    job: str | None
    width: int
    height: int
    pictures: PicturePaths
    shapes: list[Shape]
    region: list[Shape]
    exclude: list[Shape]
    drawing: DrawingDocument | None
    proposing: str | None
    trouble: Trouble | None
    features: list[FeatureDocument]
    outlines: ContoursDocument
    reference: ReferenceDocument | None
    gripping: GrippingDocument | None
    sizes: list[SizeDocument]
    tray: TraySection | None
    tilt_deg: float | None
    further: list[str]
    break_mm: float | None
    break_end: BreakEnd | None
    rivals: list[RivalDocument]
    warnings: list[WarningDocument]
    predicted: PredictedDocument | None


class TeachingLine(DraftSummary):
    """A draft of the list. trouble : why it cannot be read; then nothing else is known."""

    name: str = ""
    number: int = 0
    job: str | None = None


class TeachingList(Frozen):
    """The youngest first."""

    teachings: list[TeachingLine]
