"""The calibration report: one self-contained HTML page that can be archived and printed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from edged.domain import FloatArray
from edged.vision.boards import Missed, StereoView
from edged.vision.calibration import Calibration
from edged.vision.camera import CameraModel, StereoRig
from edged.vision.geometry import apply, rotation_vector
from edged.vision.heldout import HeldOutView
from edged.vision.rectification import Rectification, make_rectification
from edged.vision.triangulation import raw_covariance

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:62em;padding:0 1em;color:#1b1f24}
h1{font-size:1.6em}h2{font-size:1.2em;margin-top:2em;border-bottom:1px solid #d0d7de}
table{border-collapse:collapse;margin:.6em 0}
td,th{padding:.2em .9em .2em 0;text-align:right;font-variant-numeric:tabular-nums}
td:first-child,th:first-child{text-align:left}
figure{display:inline-block;margin:.4em 1em .4em 0}figcaption{font-size:.9em;color:#57606a}
svg{background:#f6f8fa;border:1px solid #d0d7de}.note{color:#9a6700}
@media print{body{margin:0;max-width:none}figure,table{break-inside:avoid}}
"""
_PICTURE_WIDTH = 440


def calibration_report(
    calibration: Calibration,
    held: Sequence[HeldOutView],
    views: Sequence[StereoView],
    quality: Mapping[str, Any],
) -> str:
    """The page. held : views measured without themselves; views : all that were offered, used or not."""
    rectification = make_rectification(calibration.rig)
    sections = [
        _summary(calibration, quality),
        _lengths(held),
        _coverage(calibration),
        _volume(calibration),
        _internal(calibration.rig, rectification),
        _external(calibration.rig, rectification),
        _weakness(calibration),
        _views(calibration, views),
    ]
    title = f"Calibration {escape(calibration.rig.calibration_id)}"
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{_STYLE}</style></head><body><h1>{title}</h1>{''.join(sections)}</body></html>\n"
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    cells = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{cells}</tr>{body}</table>"


def _summary(calibration: Calibration, quality: Mapping[str, Any]) -> str:
    held = quality["held_out"]
    rows = [
        ("board", str(quality["board"])),
        ("views used", f"{len(calibration.views)} of {len(calibration.views) + len(calibration.excluded)}"),
        ("stereo rms", f"{calibration.rms_px:.4f} px"),
        ("left, right rms", f"{calibration.rms_left_px:.4f} px, {calibration.rms_right_px:.4f} px"),
        ("epipolar rms", f"{calibration.epipolar_rms_px:.4f} px"),
        ("baseline", f"{calibration.rig.baseline_mm:.4f} mm"),
        ("marks dropped as mistakes", str(calibration.outliers)),
    ]
    if held:
        rows += [
            ("held-out reprojection rms", f"{held['reprojection_rms_px']:.4f} px"),
            ("held-out epipolar rms", f"{held['epipolar_rms_px']:.4f} px"),
        ]
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in calibration.notes)
    scale = (
        "<p>All lengths rest on the board as it was stated. A wrong pitch scales every coordinate and "
        "leaves no trace in the pictures: measure the board once.</p>"
    )
    return "<h2>Summary</h2>" + _table(("", ""), rows) + notes + scale


def _lengths(held: Sequence[HeldOutView]) -> str:
    """Known lengths on the board, as in VDI/VDE 2634: measured minus true."""
    if not held:
        return "<h2>Held-out views</h2><p>Too few views to hold any out.</p>"
    rows = [
        (
            view.name,
            f"{view.reprojection_rms_px:.4f}",
            f"{view.epipolar_rms_px:.4f}",
            f"{view.length_mm:.3f}",
            f"{1000 * view.length_error_mm:+.1f}",
            f"{view.scale:.6f}",
            f"{1000 * view.flatness_mm:.1f}",
        )
        for view in held
    ]
    head = (
        "view",
        "reprojection px",
        "epipolar px",
        "longest length mm",
        "measured - true µm",
        "board size, measured / true",
        "off a plane, rms µm",
    )
    text = "<p>Each view measured with the calibration of the others, as a part would be.</p>"
    return "<h2>Held-out views</h2>" + text + _table(head, rows)


def _coverage(calibration: Calibration) -> str:
    """Where the marks lay in both images, each with its residual."""
    figures = []
    exaggeration = 0.02 * calibration.rig.left.width / max(calibration.rms_px, 1e-9)
    for side, camera in (("left", calibration.rig.left), ("right", calibration.rig.right)):
        scale = _PICTURE_WIDTH / camera.width
        lines = []
        for fit in calibration.views:
            residuals = fit.residuals_left_px if side == "left" else fit.residuals_right_px
            ends = fit.view.found(side).pixels + exaggeration * residuals
            for (x, y), (u, v) in zip(fit.view.found(side).pixels * scale, ends * scale, strict=True):
                lines.append(f"M{x:.1f} {y:.1f}L{u:.1f} {v:.1f}")
        path = f'<path d="{"".join(lines)}" stroke="#0969da" stroke-width=".8" fill="none"/>'
        share = 100 * _covered_share(calibration, side, camera)
        figures.append(_figure(path, camera.height * scale, f"{side}: marks in {share:.0f} % of the image"))
    text = (
        f"<p>Residuals, drawn {exaggeration:.0f} times too long. "
        "A pattern in them would mean a wrong lens model.</p>"
    )
    return "<h2>Coverage and residuals</h2>" + text + "".join(figures)


def _covered_share(calibration: Calibration, side: str, camera: CameraModel) -> float:
    """Share of a grid of 8 x 6 fields of the image with at least one mark."""
    pixels = np.concatenate([fit.view.found(side).pixels for fit in calibration.views])
    fields = np.floor(pixels / (camera.width / 8, camera.height / 6)).clip(0, (7, 5)).astype(int)
    return len(np.unique(fields, axis=0)) / 48


def _figure(content: str, height: float, caption: str) -> str:
    return (
        f'<figure><svg xmlns="http://www.w3.org/2000/svg" width="{_PICTURE_WIDTH}" height="{height:.0f}">'
        f"{content}</svg><figcaption>{escape(caption)}</figcaption></figure>"
    )


def _volume(calibration: Calibration) -> str:
    """Expected sigma of a point, for image noise of 0.05 px, over the left image at three depths."""
    rig = calibration.rig
    marks = np.concatenate(
        [apply(fit.left_from_board, fit.view.board.points_mm) for fit in calibration.views]
    )
    depths = np.percentile(marks[:, 2], (5, 50, 95))
    figures = [
        _sigma_map(rig, depth, lambda c: np.sqrt(c[:, 2, 2]), f"σZ at Z = {depth:.0f} mm") for depth in depths
    ]
    figures += [
        _sigma_map(
            rig,
            float(depths[1]),
            lambda c: np.sqrt(np.maximum(c[:, 0, 0], c[:, 1, 1])),
            f"σX, σY (the larger) at Z = {depths[1]:.0f} mm",
        )
    ]
    text = (
        "<p>For an image noise of 0.05 px in each coordinate and a perfect rig; other noise in proportion. "
        "Grey: not seen by both cameras.</p>"
    )
    return "<h2>Working volume</h2>" + text + "".join(figures)


def _sigma_map(
    rig: StereoRig, depth_mm: float, pick: Callable[[FloatArray], FloatArray], caption: str
) -> str:
    columns, rows = 16, 12
    width, height = rig.left.width / columns, rig.left.height / rows
    x, y = np.meshgrid((np.arange(columns) + 0.5) * width, (np.arange(rows) + 0.5) * height)
    rays = rig.left.normalise(np.stack([x.ravel(), y.ravel()], axis=-1))
    points = np.column_stack([rays, np.ones(len(rays))]) * depth_mm
    in_right = apply(rig.right_from_left, points)
    with np.errstate(invalid="ignore", divide="ignore"):
        pixels = rig.right.project(in_right)
        inside = (pixels >= 0) & (pixels <= (rig.right.width - 1, rig.right.height - 1))
    seen = inside.all(axis=1) & (in_right[:, 2] > 0)
    if not seen.any():
        return ""
    sigma_um = np.full(len(points), np.nan)
    sigma_um[seen] = 1000 * pick(raw_covariance(rig, points[seen], 0.05))
    low, high = np.nanmin(sigma_um), np.nanmax(sigma_um)
    scale = _PICTURE_WIDTH / rig.left.width
    fields = []
    for u, v, sigma in zip(x.ravel() - width / 2, y.ravel() - height / 2, sigma_um, strict=True):
        if np.isfinite(sigma):
            light = 90 - 45 * (sigma - low) / max(high - low, 1e-12)
            fields.append(
                f'<rect x="{u * scale:.1f}" y="{v * scale:.1f}" width="{width * scale:.1f}" '
                f'height="{height * scale:.1f}" fill="hsl(210,80%,{light:.0f}%)"/>'
            )
    return _figure("".join(fields), rig.left.height * scale, f"{caption}: {low:.2f} to {high:.2f} µm")


def _internal(rig: StereoRig, rectification: Rectification) -> str:
    """The form of the paper's Table 1, in pixels; with sigma."""
    sigma = _sigmas(rig)
    rows = []
    for side, camera in (("left", rig.left), ("right", rig.right)):
        values = [f"{getattr(camera, n):.3f} ± {sigma[f'{side}.{n}']:.3f}" for n in ("fx", "fy", "cx", "cy")]
        names = list(sigma)
        lens = [n for n in names if n.startswith(f"{side}.")][4:]
        distortion = ", ".join(
            f"{n.split('.')[1]} {v:.5g} ± {sigma[n]:.2g}"
            for n, v in zip(lens, camera.distortion, strict=True)
        )
        rows.append((f"{side} before rectification", *values, distortion))
    for side, centre in (("left", rectification.centre_left_px), ("right", rectification.centre_right_px)):
        focal = f"{rectification.focal_px:.3f}"
        rows.append((f"{side} after", focal, focal, f"{centre[0]:.3f}", f"{centre[1]:.3f}", "none"))
    head = ("camera", "fx px", "fy px", "cx px", "cy px", f"lens ({rig.left.model})")
    return "<h2>Internal parameters</h2>" + _table(head, rows)


def _external(rig: StereoRig, rectification: Rectification) -> str:
    """The form of the paper's Table 2: the right camera's place and turn against the left."""
    sigma = _sigmas(rig)
    turn = np.degrees(rotation_vector(rig.right_from_left[:3, :3]))
    shift = rig.right_from_left[:3, 3]
    before = [
        f"{value:.4f} ± {sigma[f'translation.{axis}']:.4f}" for axis, value in zip("xyz", shift, strict=True)
    ]
    before += [
        f"{value:.5f} ± {np.degrees(sigma[f'rotation.{axis}']):.5f}"
        for axis, value in zip("xyz", turn, strict=True)
    ]
    after = [f"{-rectification.baseline_mm:.4f}", "0", "0", "0", "0", "0"]
    head = ("right_from_left", "x mm", "y mm", "z mm", "turn x °", "turn y °", "turn z °")
    rows = (("before rectification", *before), ("after", *after))
    return "<h2>External parameters</h2>" + _table(head, rows)


def _sigmas(rig: StereoRig) -> dict[str, float]:
    """One sigma of each parameter by its name."""
    count = len(rig.parameter_names)
    values = np.full(count, np.nan) if rig.covariance is None else np.sqrt(np.diag(rig.covariance))
    return dict(zip(rig.parameter_names, values.tolist(), strict=True))


def _weakness(calibration: Calibration) -> str:
    """The combination of parameters that the views leave most open, and the view that would help."""
    rig = calibration.rig
    sigma = _sigmas(rig)
    ratios = {
        "focal length of the left camera": sigma["left.fx"] / rig.left.fx,
        "focal length of the right camera": sigma["right.fx"] / rig.right.fx,
        "length of the baseline": float(
            np.linalg.norm([sigma[f"translation.{axis}"] for axis in "xyz"]) / rig.baseline_mm
        ),
    }
    centres = {
        f"principal point of the {side} camera": np.hypot(sigma[f"{side}.cx"], sigma[f"{side}.cy"])
        for side in ("left", "right")
    }
    rows = [(name, f"{1e6 * value:.0f} ppm") for name, value in ratios.items()]
    rows += [(name, f"{value:.3f} px") for name, value in centres.items()]
    normals = np.array([fit.left_from_board[:3, 2] for fit in calibration.views])
    tilt = np.degrees(np.arctan2(np.abs(normals[:, :2]), normals[:, 2:]).max(axis=0))
    share = {
        side: _covered_share(calibration, side, camera)
        for side, camera in (("left", rig.left), ("right", rig.right))
    }
    if tilt.min() < 15:
        axis = "left or right" if tilt[0] < tilt[1] else "up or down"
        advice = (
            f"a view with the board tilted by 20° to 40° to face {axis}: so far {tilt.min():.0f}° at most"
        )
    elif min(share.values()) < 0.75:
        side = min(share, key=lambda name: share[name])
        advice = (
            f"views with the board in the empty parts of the {side} image ({100 * share[side]:.0f} % covered)"
        )
    else:
        advice = "more views of any kind: tilt and coverage are good"
    return (
        "<h2>What is least certain</h2>"
        + _table(("", "one sigma"), rows)
        + f"<p>Most useful: {escape(advice)}.</p>"
    )


def _views(calibration: Calibration, views: Sequence[StereoView]) -> str:
    rms = {fit.name: fit.rms_px for fit in calibration.views}
    reasons = dict(calibration.excluded)
    rows = []
    for view in views:
        blur = [
            "" if isinstance(found, Missed) else f"{found.blur_px:.2f}" for found in (view.left, view.right)
        ]
        verdict = (
            f"{rms[view.name]:.4f} px" if view.name in rms else f"left out: {reasons.get(view.name, '')}"
        )
        rows.append((view.name, str(view.board), *blur, verdict))
    head = ("view", "board", "left edges px", "right edges px", "rms")
    return "<h2>Views</h2>" + _table(head, rows)
