"""A draft of a job as it is told: over /api/v1, and to every open page. Pixels are those of raw pictures."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from edged.errors import EdgedError
from edged.robot.orientations import fixed_xyz
from edged.setup.calibration.documents import Document, Trouble, trouble_in
from edged.setup.outlines import Line, seen_at
from edged.setup.teaching.drafts import TeachingDraft
from edged.setup.teaching.editing import grasp_of, lying
from edged.setup.teaching.model import Drawing, Gripping, Shape, nearest
from edged.setup.teaching.proposing import Seen
from edged.vision.geometry.camera import StereoRig

Pixel = tuple[float, float]


class Sides(Document):
    """Where the pictures are."""

    left: str
    right: str


class Outline(Document):
    """A line in each picture."""

    left: Line
    right: Line


class FeatureDocument(Document):
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


class ContoursDocument(Document):
    """What is searched for, as lines in each picture."""

    left: list[Line]
    right: list[Line]


class ReferenceDocument(Document):
    """The feature whose place is the part's, and where that is."""

    key: str
    left: Pixel
    right: Pixel


class GrippingDocument(Document):
    """Where a tool takes the part, in the part's frame; angles about its fixed x, y, z."""

    name: str
    x_mm: float
    y_mm: float
    z_mm: float
    a_deg: float
    b_deg: float
    c_deg: float
    approach_mm: float
    retreat_mm: float
    symmetry: int
    left: Pixel
    right: Pixel


class SizeDocument(Document):
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


class RivalDocument(Document):
    """A turn after which the shape is much like itself."""

    angle_deg: float
    alike_percent: float


class WarningDocument(Document):
    """What is not as it should be. at : the place in the left picture that it means."""

    code: str
    text: str
    at: Pixel | None


class SigmaXyz(Document):
    """Of the position."""

    x: float
    y: float
    z: float


class SigmaAbc(Document):
    """Of the rotation about the rig's axes; None: nothing tells."""

    a: float | None
    b: float | None
    c: float | None


class PredictedDocument(Document):
    """The pose's sigma, as the features that are taken give it in this pair."""

    sigma_um: SigmaXyz
    sigma_deg: SigmaAbc


class DrawingDocument(Document):
    """What the job is learnt from instead of a region. depth_mm : of the face from the left camera."""

    name: str
    depth_mm: float
    outlines: int


class TeachingDocument(Document):
    """A draft of a job. shapes : the region; those with `add` in region, the others in exclude; none: the
    whole picture. proposing : the task that learns it. job : the one that it replaces.
    """

    id: str
    revision: int
    name: str
    number: int
    job: str | None
    author: str
    created: str
    width: int
    height: int
    pictures: Sides
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
    tilt_deg: float | None
    rivals: list[RivalDocument]
    warnings: list[WarningDocument]
    predicted: PredictedDocument | None
    can_undo: bool
    can_redo: bool
    active: bool


class TeachingLine(Document):
    """A draft of the list. trouble : why it cannot be read; then nothing else is known."""

    id: str
    name: str = ""
    number: int = 0
    job: str | None = None
    author: str = ""
    created: str = ""
    active: bool = False
    trouble: str | None = None


class TeachingList(Document):
    """The youngest first."""

    teachings: list[TeachingLine]


class Stale(Exception):
    """Somebody else has changed the draft since. document : as it is now."""

    def __init__(self, document: TeachingDocument) -> None:
        self.document = document
        super().__init__("somebody else has changed it since")


def teaching_document(
    draft: TeachingDraft,
    seen: Seen | None,
    rig: StereoRig | None,
    place: str,
    *,
    task: str | None,
    trouble: EdgedError | None,
    active: bool,
) -> TeachingDocument:
    """All that is known of a draft. seen, rig : what its pair teaches, as far as that is known already."""
    state, content = draft.state, draft.state.content
    shapes = list(content.shapes or ())
    return TeachingDocument(
        id=state.id,
        revision=state.revision,
        name=content.name,
        number=content.number,
        job=state.job,
        author=state.author,
        created=state.created,
        width=state.width,
        height=state.height,
        pictures=Sides(left=f"{place}/left.jpg", right=f"{place}/right.jpg"),
        shapes=shapes,
        region=[one for one in shapes if one.add],
        exclude=[one for one in shapes if not one.add],
        drawing=_drawing(content.drawing),
        proposing=task,
        trouble=trouble_in(trouble),
        tilt_deg=content.tilt_deg,
        can_undo=state.can_undo,
        can_redo=state.can_redo,
        active=active,
        **_seen(draft, seen, rig),
    )


def _drawing(drawing: Drawing | None) -> DrawingDocument | None:
    if drawing is None:
        return None
    return DrawingDocument(name=drawing.name, depth_mm=drawing.depth_mm, outlines=len(drawing.outlines))


def _seen(draft: TeachingDraft, seen: Seen | None, rig: StereoRig | None) -> dict[str, Any]:
    if seen is None or rig is None:
        return {
            "features": [],
            "outlines": ContoursDocument(left=[], right=[]),
            "reference": None,
            "gripping": None,
            "sizes": [],
            "rivals": [],
            "warnings": [],
            "predicted": None,
        }
    left_out = {nearest(mark, seen.marks) for mark in draft.state.content.left_out}
    job = seen.job
    return {
        "features": [
            FeatureDocument(
                key=one.name,
                kind=one.kind,
                taken=one.name not in left_out and (job.kind_of(one.name) is not None or not left_out),
                size={name: round(value, 5) for name, value in one.size_mm.items()},
                sigma_um=_known(one.sigma_um),
                outline=Outline(left=one.left, right=one.right),
                why=one.why or None,
            )
            for one in seen.features
        ],
        "outlines": ContoursDocument(left=list(seen.contours[0]), right=list(seen.contours[1])),
        "reference": ReferenceDocument(key=job.reference, left=seen.reference[0], right=seen.reference[1]),
        "gripping": _gripping(draft.state.content.gripping, seen, rig),
        "sizes": [
            SizeDocument(
                key=one.name,
                kind=one.kind,
                of=list(one.of),
                nominal=_known(one.nominal, 5),
                tolerance=_known(one.tolerance, 5),
                measured=_known(one.value, 5),
                sigma=_known(one.sigma, 5),
                unit="deg" if one.kind == "angle" else "mm",
                witness=one.is_witness,
                ok=one.ok,
            )
            for one in seen.sizes
        ],
        "rivals": [
            RivalDocument(angle_deg=round(angle, 1), alike_percent=round(alike, 1))
            for angle, alike in seen.rivals
        ],
        "warnings": [WarningDocument(code=one.code, text=one.text, at=one.at) for one in seen.warnings],
        "predicted": _predicted(seen),
    }


def _gripping(wanted: Gripping | None, seen: Seen, rig: StereoRig) -> GrippingDocument | None:
    """As people want it, else as the job that is replaced has it."""
    grasps = seen.job.picking.grasps
    grasp = (
        grasps[0]
        if wanted is None and grasps
        else None
        if wanted is None
        else grasp_of(wanted, seen.job, seen.moved)
    )
    if grasp is None:
        return None
    x, y, z = (round(float(value), 6) for value in grasp.part_from_tcp[:3, 3])
    a, b, c = (round(value, 6) for value in fixed_xyz(grasp.part_from_tcp[:3, :3]))
    there = lying(seen.job, seen.moved).rig_from_part
    left, right = seen_at((there @ grasp.part_from_tcp)[:3, 3], rig)
    return GrippingDocument(
        name=grasp.name,
        x_mm=x,
        y_mm=y,
        z_mm=z,
        a_deg=a,
        b_deg=b,
        c_deg=c,
        approach_mm=grasp.approach_mm,
        retreat_mm=grasp.retreat_mm,
        symmetry=grasp.symmetry,
        left=left,
        right=right,
    )


def _predicted(seen: Seen) -> PredictedDocument | None:
    if seen.sigma is None or not np.isfinite(seen.sigma[:3]).all():
        return None
    x, y, z = (round(1e3 * value, 3) for value in seen.sigma[:3])
    a, b, c = (_known(math.degrees(value), 5) for value in seen.sigma[3:])
    return PredictedDocument(sigma_um=SigmaXyz(x=x, y=y, z=z), sigma_deg=SigmaAbc(a=a, b=b, c=c))


def _known(value: float | None, digits: int = 3) -> float | None:
    """None instead of what JSON has no word for."""
    return round(value, digits) if value is not None and math.isfinite(value) else None
