"""Teaching report: what was learnt about a part, as one self-contained page to look at and archive."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

import cv2
import numpy as np
from markupsafe import Markup

from edged import __version__
from edged.domain.arrays import I32, FloatArray, Image
from edged.domain.numerals import known
from edged.payload import Json
from edged.pictures.evidence import taught_outlines
from edged.report.charts import ACCENT, INK, Chart
from edged.report.page import HtmlTable, render
from edged.vision.part.job import Job
from edged.vision.shape.inspection import ModelInspection
from edged.vision.shape.params import LEARNING
from edged.vision.teaching.cuts import Cut

_PICTURE_PX = 440
_WIDTH_PX = 900
_MARGIN_PX = 12


@dataclass(frozen=True, slots=True)
class _Level:
    """Picture of a pyramid level. png : with the model's points, base64."""

    png: str
    caption: str


@dataclass(frozen=True, slots=True, eq=False)
class Taught:
    """Picture and region that a job was learnt from.

    rectified_left (h, w) uint8 : the picture, real or rendered from a drawing.
    region (h, w) uint8 : place of the part in it; None: anywhere.  cuts : its edges that the region cuts.
    settled : findings from its CAD model and further pairs, a line each.
    """

    rectified_left: Image
    region: Image | None
    cuts: tuple[Cut, ...]
    settled: tuple[str, ...] = ()


def teaching_report(
    job: Job, taught: Taught, inspection: ModelInspection, about: Mapping[str, str] | None = None
) -> str:
    """Render the page. about : lines for its head, such as the rig and the pictures."""
    title = f"Job {job.number}: {job.name}"
    return render(
        "teaching.html",
        title=title,
        heading=title,
        warnings=inspection.warnings,
        picture=_where(job, taught),
        cuts=[cut.text for cut in taught.cuts],
        settled=taught.settled,
        levels=[_level(job, taught.rectified_left, index) for index in range(len(job.shape.levels))],
        facts=_facts(job, inspection),
        noise=f"{LEARNING.noise:g}",
        round=inspection.round,
        rivals=_rivals(inspection),
        drawing=_drawing(job),
        reference=job.reference,
        features=_features(job),
        about=HtmlTable(
            [*(about or {}).items(), ("made", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, edged {__version__}")]
        ),
    )


def inspection_to_json(job: Job, inspection: ModelInspection) -> Json:
    """Convert the inspection to JSON."""

    return {
        "job": job.name,
        "levels": [len(level.points) for level in job.shape.levels],
        "radius_px": job.shape.radius_px,
        "contrast": job.shape.contrast,
        "contrast_reserve": inspection.reserve,
        "round": inspection.round,
        "symmetric": inspection.symmetric,
        "rivals": [
            {"angle_deg": float(np.degrees(angle)), "similarity": float(similarity)}
            for angle, similarity in inspection.rivals
        ],
        "expected_sigma": {
            "noise_grey": LEARNING.noise,
            "x_px": known(inspection.sigma_x_px),
            "y_px": known(inspection.sigma_y_px),
            "angle_deg": known(np.degrees(inspection.sigma_angle_rad)),
            "scale": known(inspection.sigma_scale),
        },
        "circles": [{"name": circle.name, "radius_mm": circle.radius_mm} for circle in job.circles],
        "warnings": list(inspection.warnings),
    }


def _where(job: Job, taught: Taught) -> str:
    """Picture as base64 PNG with the region (yellow), the learnt points (green) and the cuts (red)."""
    height, width = taught.rectified_left.shape
    zoom = _WIDTH_PX / width
    size = (_WIDTH_PX, round(height * zoom))
    canvas = cv2.cvtColor(
        np.asarray(cv2.resize(taught.rectified_left, size, interpolation=cv2.INTER_AREA), np.uint8),
        cv2.COLOR_GRAY2BGR,
    )

    def placed(points: FloatArray) -> I32:
        return np.asarray(np.rint(16 * ((points + 0.5) * zoom - 0.5)), np.int32)

    for x, y in placed(job.shape.origin_px + job.shape.levels[0].points):
        cv2.circle(canvas, (int(x), int(y)), 16, (60, 220, 60), -1, cv2.LINE_AA, 4)
    if taught.region is not None:
        outlines, _ = cv2.findContours(taught.region, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
        for outline in outlines:
            cv2.polylines(canvas, [placed(outline[:, 0].astype(np.float64))], True, (0, 220, 255), 1, 16, 4)
    for cut in taught.cuts:
        cv2.polylines(canvas, [placed(cut.points)], False, (40, 40, 255), 2, cv2.LINE_AA, 4)
    _, png = cv2.imencode(".png", canvas)
    return base64.b64encode(png.tobytes()).decode()


def _level(job: Job, picture: Image, index: int) -> _Level:
    """Draw the model's points of one pyramid level on the picture of that level."""
    level, shape = job.shape.levels[index], job.shape
    for _ in range(index):
        height, width = picture.shape
        even = picture[: height // 2 * 2, : width // 2 * 2]
        picture = np.asarray(
            cv2.resize(even, (width // 2, height // 2), interpolation=cv2.INTER_AREA), np.uint8
        )
    origin = (shape.origin_px + 0.5) / 2**index - 0.5
    points = origin + level.points
    low = np.maximum(np.floor(points.min(axis=0)).astype(int) - _MARGIN_PX, 0)
    high = np.minimum(np.ceil(points.max(axis=0)).astype(int) + _MARGIN_PX, np.array(picture.shape[::-1]) - 1)
    part = picture[low[1] : high[1] + 1, low[0] : high[0] + 1]
    zoom = max(1, round(_PICTURE_PX / max(part.shape)))
    shown = cv2.resize(part, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_NEAREST)
    canvas = cv2.cvtColor(shown, cv2.COLOR_GRAY2BGR)
    for (x, y), (nx, ny) in zip((points - low + 0.5) * zoom - 0.5, level.normals, strict=True):
        start, end = (round(16 * x), round(16 * y)), (round(16 * (x + 4 * nx)), round(16 * (y + 4 * ny)))
        cv2.line(canvas, start, end, (80, 190, 255), 1, cv2.LINE_AA, 4)
        cv2.circle(canvas, start, 24, (60, 220, 60), -1, cv2.LINE_AA, 4)
    _, png = cv2.imencode(".png", canvas)
    caption = f"level {index}: {len(level.points)} points on 1/{2**index} of the resolution"
    return _Level(base64.b64encode(png.tobytes()).decode(), caption)


def _facts(job: Job, inspection: ModelInspection) -> HtmlTable:
    angle = (
        "–"
        if not np.isfinite(inspection.sigma_angle_rad)
        else f"{np.degrees(inspection.sigma_angle_rad):.4f}°"
    )
    rows = [
        ("size", f"radius {job.shape.radius_px:.0f} px"),
        ("contrast of the edges", f"{job.shape.contrast:.1f} grey values per px"),
        (
            "least contrast that is still seen",
            f"{job.shape.contrast / inspection.reserve:.1f} grey values per px",
        ),
        ("position, 1 σ expected", f"{inspection.sigma_x_px:.4f}, {inspection.sigma_y_px:.4f} px"),
        ("angle, scale, 1 σ expected", f"{angle}, {100 * inspection.sigma_scale:.4f} %"),
        ("sizes looked for", f"{job.search.scale_min:.3f} to {job.search.scale_max:.3f} of the taught one"),
        ("contrast", job.search.polarity),
    ]
    return HtmlTable(rows)


def _rivals(inspection: ModelInspection) -> HtmlTable:
    """Table of the rotations at which the shape resembles itself."""
    rows = [
        (f"{np.degrees(angle):.1f}°", f"{100 * similarity:.1f} %") for angle, similarity in inspection.rivals
    ]
    return HtmlTable(rows, ("turned by", "similarity"))


def _drawing(job: Job) -> Markup:
    """Drawing to scale of the features with their names, as they lay at teaching; the reference is blue."""
    outlines = {name: points[:, :2] for name, points in taught_outlines(job).items()}
    if not outlines:
        return Markup()
    every = np.concatenate(list(outlines.values()))
    margin = 0.08 * float(np.ptp(every, axis=0).max())
    low, high = every.min(axis=0) - margin, every.max(axis=0) + margin
    chart = Chart((low[0], high[0]), (high[1], low[1]), "x, mm", "y, mm", equal=True)
    middle = 0.5 * (low + high)
    closed = {circle.name for circle in job.circles} | {slot.name for slot in job.slots}
    for name, points in outlines.items():
        colour = ACCENT if name == job.reference else INK
        chart.line(np.vstack([points, points[:1]]) if name in closed else points, colour)
        out = points.mean(axis=0) - middle
        if name in closed:
            way = out / np.linalg.norm(out) if np.linalg.norm(out) > margin else np.array([0.6, -0.8])
            place = points[int(np.argmax(points @ way))]
        else:
            along = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
            way = np.array([-along[1], along[0]]) * (1 if along[0] * out[1] > along[1] * out[0] else -1)
            place = points[len(points) // 2]
        x, y = place + 0.5 * margin * way
        chart.text(float(x), float(y), name, colour)
    return chart.figure("features in the part frame; the reference is blue")


def _features(job: Job) -> HtmlTable:
    def place(point: FloatArray) -> str:
        x, y, down = point
        return f"{x:.3f}, {y:.3f}" + (f", {-down:+.3f}" if job.solid else "")

    rows: list[tuple[str, ...]] = []
    for circle in job.circles:
        kind = "hole" if circle.polarity > 0 else "disc"
        rows.append((circle.name, kind, place(circle.centre_mm), f"radius {circle.radius_mm:.4f}"))
    for slot in job.slots:
        size = f"{slot.length_mm:.3f} x {slot.width_mm:.3f}"
        rows.append((slot.name, "slot", place(slot.centre_mm), size))
    for edge in job.edges:
        middle = 0.5 * (edge.start_mm + edge.end_mm)
        rows.append((edge.name, "edge", place(middle), f"length {edge.length_mm:.3f}"))
    rows += [
        (corner.name, "corner", place(job.place_of(corner.name)), " and ".join(corner.edges))
        for corner in job.corners
    ]
    return HtmlTable(rows, ("name", "kind", "place, height mm" if job.solid else "place mm", "size mm"))
