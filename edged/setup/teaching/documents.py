"""Documents of job drafts, served under /api/v1 and sent to every open page. Pixels are of raw pictures."""

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
    """An outline as a line in each picture."""

    left: Line
    right: Line


class FeatureDocument(Frozen):
    """A feature. size : its sizes by name, mm.  sigma_um : of its size in this pair; for edges and corners of
    their position. why : code of why it was not measured.
    """

    key: str
    kind: str
    taken: bool
    size: dict[str, float]
    sigma_um: float | None
    outline: Outline
    why: str | None


class ContoursDocument(Frozen):
    """Contours that are searched for, as lines in each picture."""

    left: list[Line]
    right: list[Line]


class ReferenceDocument(Frozen):
    """The feature whose position is the part's, and its position in both pictures."""

    key: str
    left: Pixel
    right: Pixel


class GrippingDocument(PlaceMm):
    """Pose of the tool when it grips the part, in the part's frame; angles about its fixed x, y, z."""

    name: str
    approach_mm: float
    retreat_mm: float
    symmetry: int
    left: Pixel
    right: Pixel


class SizeDocument(Frozen):
    """A size to measure; angles in degrees. witness : used to monitor the rig. ok : within its tolerance."""

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
    """A rotation after which the shape looks much like itself."""

    angle_deg: float
    alike_percent: float


class WarningDocument(Frozen):
    """A warning. at : the position in the left picture that it refers to."""

    code: str
    text: str
    at: Pixel | None


class PredictedDocument(Frozen):
    """Sigma of the pose from the features in use, in this pair."""

    sigma_um: SigmaXyz
    sigma_deg: SigmaAbc


class DrawingDocument(Frozen):
    """The drawing that a job is learnt from instead of a region. depth_mm : its face from the left camera."""

    name: str
    depth_mm: float
    outlines: int


class TeachingDocument(DraftHead):
    """A draft of a job. shapes : the region; empty for the whole picture. region, exclude : shapes with and
    without `add`. proposing : the task that learns it. job : the one that it replaces. further : names of
    further pairs. break_mm : width of the part's edge breaks, null where it is not known.
    break_end : which edge of each was taught, null for either.
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
    """A draft in the list. trouble : why it cannot be read; then only its id is known."""

    name: str = ""
    number: int = 0
    job: str | None = None


class TeachingList(Frozen):
    """All drafts, newest first."""

    teachings: list[TeachingLine]
