"""The teaching report: what was learnt of a part, for the eye and the archive. One self-contained page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from datetime import UTC, datetime
from html import escape

import cv2
import numpy as np

from edged import __version__
from edged.domain import Image
from edged.payload import Json
from edged.pictures.evidence import taught_outlines
from edged.report.charts import ACCENT, INK, Chart
from edged.vision.part.job import Job
from edged.vision.shape.inspection import NOISE, Inspection

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:62em;padding:0 1em;color:#1b1f24}
h1{font-size:1.6em}h2{font-size:1.2em;margin-top:2em;border-bottom:1px solid #d0d7de}
table{border-collapse:collapse;margin:.6em 0}
td,th{padding:.2em .9em .2em 0;text-align:right;font-variant-numeric:tabular-nums;vertical-align:top}
td:first-child,th:first-child{text-align:left}
figure{display:inline-block;margin:.4em 1em .4em 0}figcaption{font-size:.9em;color:#424a53}
img{width:440px;max-width:100%;image-rendering:pixelated;
border:1px solid #d0d7de}.note{color:#8a4a00;max-width:46em}
@media print{body{margin:0;max-width:none}figure,table{break-inside:avoid}}
"""
_PICTURE_PX = 440
_MARGIN_PX = 12


def teaching_report(job: Job, rectified_left: Image, inspection: Inspection) -> str:
    """The page. rectified_left (h, w) uint8 : the picture that was learnt, real or painted from a drawing."""
    title = f"Job {job.number}: {escape(job.name)}"
    when = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    sections = [
        "".join(f'<p class="note">{escape(text)}</p>' for text in inspection.warnings)
        or "<p>Nothing to warn of.</p>",
        "<h2>Model</h2>",
        "".join(_level(job, rectified_left, index) for index in range(len(job.shape.levels))),
        "<h2>Inspection</h2>",
        _facts(job, inspection),
        "<h2>Rotation</h2>",
        _rotation(inspection),
        "<h2>Features</h2>",
        _drawing(job),
        _features(job),
        f"<p>edged {__version__}, {when}</p>",
    ]
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{_STYLE}</style></head><body><h1>{title}</h1>{''.join(sections)}</body></html>\n"
    )


def inspection_to_json(job: Job, inspection: Inspection) -> Json:
    """The same for programs."""

    def known(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

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
            "noise_grey": NOISE,
            "x_px": known(inspection.sigma_x_px),
            "y_px": known(inspection.sigma_y_px),
            "angle_deg": known(np.degrees(inspection.sigma_angle_rad)),
            "scale": known(inspection.sigma_scale),
        },
        "circles": [{"name": circle.name, "radius_mm": circle.radius_mm} for circle in job.circles],
        "warnings": list(inspection.warnings),
    }


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    cells = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{cells}</tr>{body}</table>"


def _level(job: Job, picture: Image, index: int) -> str:
    """The model's points of one level on the picture of that level."""
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
    data = base64.b64encode(png.tobytes()).decode()
    text = f"level {index}: {len(level.points)} points on 1/{2**index} of the resolution"
    image = f'<img alt="{text}" src="data:image/png;base64,{data}">'
    return f"<figure>{image}<figcaption>{text}</figcaption></figure>"


def _facts(job: Job, inspection: Inspection) -> str:
    angle = (
        "–"
        if not np.isfinite(inspection.sigma_angle_rad)
        else f"{np.degrees(inspection.sigma_angle_rad):.4f}°"
    )
    rows = [
        ("size", f"radius {job.shape.radius_px:.0f} px"),
        ("contrast of the edges", f"{job.shape.contrast:.1f} grey values per px"),
        ("may fall by", f"a factor of {inspection.reserve:.1f} before edges count as none"),
        ("position, 1 σ expected", f"{inspection.sigma_x_px:.4f}, {inspection.sigma_y_px:.4f} px"),
        ("angle, scale, 1 σ expected", f"{angle}, {100 * inspection.sigma_scale:.4f} %"),
        ("sizes looked for", f"{job.search.scale_min:.3f} to {job.search.scale_max:.3f} of the taught one"),
        ("contrast", job.search.polarity),
    ]
    note = f"<p>Expected: the bound for one image with noise of {NOISE:g} grey values, nothing hidden.</p>"
    return _table(("", ""), rows) + note


def _rotation(inspection: Inspection) -> str:
    if inspection.round:
        return "<p>Round: looks the same at every angle.</p>"
    if not len(inspection.rivals):
        return "<p>Distinct: at no other angle the shape is much like itself.</p>"
    rows = [
        (f"{np.degrees(angle):.1f}°", f"{100 * similarity:.1f} %") for angle, similarity in inspection.rivals
    ]
    return _table(("turned by", "like itself"), rows)


def _drawing(job: Job) -> str:
    """The features with their names, to scale, as they lay at teaching; the reference blue."""
    outlines = {name: points[:, :2] for name, points in taught_outlines(job).items()}
    if not outlines:
        return ""
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


def _features(job: Job) -> str:
    rows = []
    for circle in job.circles:
        x, y, _ = circle.centre_mm
        kind = "hole" if circle.polarity > 0 else "disc"
        rows.append((circle.name, kind, f"{x:.3f}, {y:.3f}", f"radius {circle.radius_mm:.4f}"))
    for slot in job.slots:
        x, y, _ = slot.centre_mm
        rows.append((slot.name, "slot", f"{x:.3f}, {y:.3f}", f"{slot.length_mm:.3f} x {slot.width_mm:.3f}"))
    for edge in job.edges:
        x, y, _ = 0.5 * (edge.start_mm + edge.end_mm)
        rows.append((edge.name, "edge", f"{x:.3f}, {y:.3f}", f"length {edge.length_mm:.3f}"))
    for corner in job.corners:
        x, y, _ = job.place_of(corner.name)
        rows.append((corner.name, "corner", f"{x:.3f}, {y:.3f}", " and ".join(corner.edges)))
    reference = f"<p>Reference point: {escape(job.reference)}. Places in the part frame, mm.</p>"
    return reference + _table(("name", "kind", "place mm", "size mm"), rows)
