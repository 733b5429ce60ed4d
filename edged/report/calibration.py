"""The calibration report: one self-contained HTML page that can be archived, printed and signed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from edged.report.figures import coverage, lengths, radial, sigma_maps, view_bars
from edged.vision.boards.board import Missed, StereoView
from edged.vision.calibration.calibrate import Calibration
from edged.vision.calibration.crossvalidation import HeldOutView
from edged.vision.calibration.nextbestview import best_next_view, depths_mm, volume_points
from edged.vision.calibration.plainopencv import PlainCalibration
from edged.vision.geometry.camera import DISTORTION_NAMES, StereoRig
from edged.vision.geometry.rectification import Rectification, make_rectification
from edged.vision.geometry.rigid import invert, rotation_vector
from edged.vision.geometry.triangulation import raw_covariance
from edged.vision.geometry.uncertainty import calibration_covariance, shift_by_parameters

_STYLE = """
@page{size:A4;margin:14mm}
body{font:14px/1.45 "Helvetica Neue",Arial,"Liberation Sans",sans-serif;margin:2em auto;max-width:980px;
padding:0 1em;color:#1b1f24}
h1{font-size:1.7em;margin:0 0 .2em}h2{font-size:1.15em;margin:2em 0 .5em;border-bottom:1.5px solid #1b1f24;
padding-bottom:.15em;break-after:avoid}
.id{color:#57606a;margin:0 0 1.2em}
table{border-collapse:collapse;margin:.6em 0;font-size:.93em}
td,th{padding:.22em 1em .22em 0;text-align:right;vertical-align:top;font-variant-numeric:tabular-nums}
th{border-bottom:1px solid #8c959f;font-weight:600}tr+tr td{border-top:1px solid #eaeef2}
td:first-child,th:first-child{text-align:left}td{white-space:nowrap}td:first-child{white-space:normal}
.left{white-space:normal}
.two{display:flex;flex-wrap:wrap;gap:0 3em}.two>table{flex:1}
figure{display:inline-block;margin:.4em .4em .6em 0;break-inside:avoid}
figcaption{font-size:.88em;color:#424a53;max-width:460px}
svg text{font-size:11px}
.note{border-left:3px solid #b3541e;padding-left:.7em}
.sign td{height:2.6em;border-bottom:1px solid #1b1f24;min-width:14em;vertical-align:bottom;text-align:left}
@media print{body{margin:0;max-width:none;padding:0;font-size:12px}table{break-inside:avoid}
.two{gap:0 1.5em}figure{margin:.3em 0}figure svg{width:100%;height:auto}figure.half{width:88mm}
h2,h2+p{break-after:avoid}
*{print-color-adjust:exact;-webkit-print-color-adjust:exact}}
"""


def calibration_report(
    calibration: Calibration,
    held: Sequence[HeldOutView],
    views: Sequence[StereoView],
    quality: Mapping[str, Any],
    about: Mapping[str, str] | None = None,
    plain: PlainCalibration | None = None,
) -> str:
    """The page.

    held : views measured without themselves.  views : all that were offered, used or not.
    about : lines for its head (date, folder, software).  plain : OpenCV on the same marks.
    """
    rectification = make_rectification(calibration.rig)
    sections = [
        _head(calibration, quality, about or {}),
        _summary(calibration, held, quality),
        _lengths(held),
        _residuals(calibration),
        _volume(calibration),
        _internal(calibration.rig, rectification),
        _external(calibration.rig, rectification),
        _weakness(calibration),
        _comparison(calibration, plain),
        _views(calibration, held, views),
        _signature(),
    ]
    title = f"Stereo calibration {escape(calibration.rig.calibration_id)}"
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{_STYLE}</style></head><body>{''.join(sections)}</body></html>\n"
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    cells = "".join(f"<th>{escape(cell)}</th>" for cell in head) if any(head) else ""
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table>{f'<tr>{cells}</tr>' if cells else ''}{body}</table>"


def _head(calibration: Calibration, quality: Mapping[str, Any], about: Mapping[str, str]) -> str:
    rig = calibration.rig
    rows = [
        *about.items(),
        ("board, as stated", str(quality["board"])),
        ("lens model", rig.left.model),
        ("images left, right", ", ".join(f"{c.width} × {c.height} px" for c in (rig.left, rig.right))),
    ]
    return f"<h1>Stereo calibration</h1><p class=id>{escape(rig.calibration_id)}</p>" + _table(("", ""), rows)


def _summary(calibration: Calibration, held: Sequence[HeldOutView], quality: Mapping[str, Any]) -> str:
    figures = quality["held_out"]
    used, offered = len(calibration.views), len(calibration.views) + len(calibration.excluded)
    fitted = [
        ("views used", f"{used} of {offered}"),
        ("stereo rms", f"{calibration.rms_px:.4f} px"),
        ("left, right rms", f"{calibration.rms_left_px:.4f}, {calibration.rms_right_px:.4f} px"),
        ("epipolar rms", f"{calibration.epipolar_rms_px:.4f} px"),
        ("baseline", f"{calibration.rig.baseline_mm:.4f} mm"),
        ("marks dropped as mistakes", str(calibration.outliers)),
    ]
    independent = [("held-out views", "too few views")]
    if figures:
        errors = np.concatenate([view.lengths_mm[:, 1] - view.lengths_mm[:, 0] for view in held])
        independent = [
            ("held-out reprojection rms", f"{figures['reprojection_rms_px']:.4f} px"),
            ("held-out epipolar rms", f"{figures['epipolar_rms_px']:.4f} px"),
            ("board size, measured / true", f"{figures['board_size']:.6f} ± {figures['board_size_std']:.6f}"),
            (f"{len(errors)} lengths, error rms", f"{1000 * np.sqrt(np.mean(errors**2)):.1f} µm"),
            ("largest length error", f"{1000 * np.abs(errors).max():.1f} µm"),
            ("off a plane, rms", f"{1000 * figures['flatness_rms_mm']:.1f} µm"),
        ]
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in calibration.notes)
    scale = (
        "<p>All lengths rest on the board as it was stated. A wrong pitch scales every coordinate and "
        "leaves no trace in the pictures: measure the board once.</p>"
    )
    left = _table(("fitted to all views", ""), fitted)
    right = _table(("views not used for their own result", ""), independent)
    return f'<h2>Summary</h2><div class="two">{left}{right}</div>{notes}{scale}'


def _lengths(held: Sequence[HeldOutView]) -> str:
    """Known lengths on the board, in the manner of VDI/VDE 2634: measured minus true."""
    if not held:
        return "<h2>Known lengths</h2><p>Too few views to hold any out.</p>"
    text = (
        "<p>The outer marks of every row, column and diagonal of the board, each view measured with the "
        "calibration of the others, mark by mark, as a part would be. In the manner of VDI/VDE 2634: single "
        "distances, no averages. Dashed: the largest error.</p>"
    )
    return "<h2>Known lengths: measured minus true</h2>" + text + lengths(held)


def _residuals(calibration: Calibration) -> str:
    rig = calibration.rig
    left = coverage(calibration, "left", rig.left) + coverage(calibration, "right", rig.right)
    text = "<p>Long enough to be seen; a pattern in them would mean a wrong lens model or a bent board.</p>"
    return f"<h2>Coverage and residuals</h2>{text}{left}{radial(calibration)}"


def _volume(calibration: Calibration) -> str:
    """What a point is worth, at three depths: noise of the image, and the calibration."""
    rig, rows = calibration.rig, []
    points = volume_points(calibration)
    for depth in depths_mm(calibration):
        here = points[np.isclose(points[:, 2], depth)]
        if not len(here):
            continue
        noise = np.sqrt(np.mean(np.einsum("nii->ni", raw_covariance(rig, here, 0.05)), axis=0))
        ours = np.sqrt(np.mean(np.einsum("nii->ni", calibration_covariance(rig, here)), axis=0))
        rows.append((f"Z = {depth:.0f} mm", *(f"{1000 * value:.1f}" for value in (*noise, *ours))))
    head = ("µm, one sigma (rms)", "noise: σX", "σY", "σZ", "calibration: σX", "σY", "σZ")
    text = (
        "<p>Noise: 0.05 px in each image coordinate of a single point; other noise in proportion. "
        "Calibration: what the uncertainty of all parameters adds, nearly the same for neighbouring points, "
        "so that sizes and distances hardly suffer. Empty: not seen by both cameras.</p>"
    )
    return f"<h2>Working volume</h2>{text}{_table(head, rows)}{sigma_maps(calibration)}"


def _internal(rig: StereoRig, rectification: Rectification) -> str:
    """The form of the paper's Table 1, in pixels; with sigma. The lens beside it."""
    sigma = _sigmas(rig)
    rows, lenses = [], []
    for side, camera in (("left", rig.left), ("right", rig.right)):
        values = [f"{getattr(camera, n):.3f} ± {sigma[f'{side}.{n}']:.3f}" for n in ("fx", "fy", "cx", "cy")]
        rows.append((f"{side}, before rectification", *values))
        coefficients = zip(DISTORTION_NAMES[camera.model], camera.distortion, strict=True)
        cells = [
            f"{name} {value:.5f} ± {sigma[f'{side}.{name}']:.5f}" if sigma[f"{side}.{name}"] else f"{name} 0"
            for name, value in coefficients
        ]
        lenses.append((f"{side}, {camera.model}", *cells))
    for side, centre in (("left", rectification.centre_left_px), ("right", rectification.centre_right_px)):
        focal = f"{rectification.focal_px:.3f}"
        rows.append((f"{side}, after", focal, focal, f"{centre[0]:.3f}", f"{centre[1]:.3f}"))
    lenses.append(("both, after", "no distortion"))
    head = ("Table 1", "fx px", "fy px", "cx px", "cy px")
    blank = [""] * (len(max(lenses, key=len)) - 1)
    return "<h2>Internal parameters</h2>" + _table(head, rows) + _table(("lens", *blank), lenses)


def _external(rig: StereoRig, rectification: Rectification) -> str:
    """The form of the paper's Table 2: the right camera's place and turn against the left, both ways."""
    sigma = _sigmas(rig)
    turn = np.degrees(rotation_vector(rig.right_from_left[:3, :3]))
    before = [
        f"{value:.4f} ± {sigma[f'translation.{axis}']:.4f}"
        for axis, value in zip("xyz", rig.right_from_left[:3, 3], strict=True)
    ]
    before += [
        f"{value:.4f} ± {np.degrees(sigma[f'rotation.{axis}']):.4f}"
        for axis, value in zip("xyz", turn, strict=True)
    ]
    place = [f"{value:.4f}" for value in invert(rig.right_from_left)[:3, 3]]
    rows = (
        ("before rectification", *before),
        ("after", f"{-rectification.baseline_mm:.4f}", "0", "0", "0", "0", "0"),
        ("place of right in left", *place, *(f"{-value:.4f}" for value in turn)),
    )
    head = ("Table 2: right_from_left", "x mm", "y mm", "z mm", "turn x °", "turn y °", "turn z °")
    return "<h2>External parameters</h2>" + _table(head, rows)


def _sigmas(rig: StereoRig) -> dict[str, float]:
    """One sigma of each parameter by its name."""
    count = len(rig.parameter_names)
    values = np.full(count, np.nan) if rig.covariance is None else np.sqrt(np.diag(rig.covariance))
    return dict(zip(rig.parameter_names, values.tolist(), strict=True))


def _weakness(calibration: Calibration) -> str:
    """Parameters by what their uncertainty would do to a point, and the view that would help most."""
    rig = calibration.rig
    sigma = _sigmas(rig)
    shift = shift_by_parameters(rig, volume_points(calibration))
    names = list(rig.parameter_names)
    # fx and fy as one unknown move together
    for side, camera in (("left", rig.left), ("right", rig.right)):
        if camera.fx == camera.fy:
            x, y = names.index(f"{side}.fx"), names.index(f"{side}.fy")
            shift[:, :, x] += shift[:, :, y]
            shift[:, :, y] = 0.0
    effect_um = 1000 * np.sqrt(np.mean(np.sum(shift**2, axis=1), axis=0)) * np.array(list(sigma.values()))
    order = [i for i in np.argsort(-np.nan_to_num(effect_um)) if effect_um[i] > 0][:6]
    rows = [(names[i], _sigma_text(names[i], sigma[names[i]]), f"{effect_um[i]:.1f} µm") for i in order]
    advice = best_next_view(calibration)
    words = (
        "<p>No further view of the board in this volume can be suggested.</p>"
        if advice is None
        else f"<p><b>The view that would help most:</b> {escape(advice.where)}. It would lower the "
        f"calibration's part in the error of points by {100 * advice.gain:.0f} %.</p>"
    )
    text = (
        "<p>Each parameter taken alone; their errors are correlated and compensate each other for the most "
        "part: what is left of all together is the calibration's sigma above.</p>"
    )
    head = ("weakest first", "one sigma", "effect on a point alone")
    return "<h2>What is least certain</h2>" + _table(head, rows) + text + words


def _sigma_text(name: str, sigma: float) -> str:
    kind = name.split(".")[1]
    if name.startswith("rotation"):
        return f"{np.degrees(sigma):.5f}°"
    if name.startswith("translation"):
        return f"{1000 * sigma:.1f} µm"
    return f"{sigma:.3f} px" if kind in ("fx", "fy", "cx", "cy") else f"{sigma:.2g}"


def _comparison(calibration: Calibration, plain: PlainCalibration | None) -> str:
    """cv2.stereoCalibrate on the same marks."""
    if plain is None:
        return ""
    rows = []
    for name, rig, rms, rows_px in (
        ("edged", calibration.rig, calibration.rms_px, calibration.epipolar_rms_px),
        ("cv2.stereoCalibrate", plain.rig, plain.rms_px, plain.epipolar_rms_px),
    ):
        turn = np.degrees(np.linalg.norm(rotation_vector(rig.right_from_left[:3, :3])))
        rows.append(
            (
                name,
                f"{rms:.4f}",
                f"{rows_px:.4f}",
                f"{rig.left.fx:.2f}",
                f"{rig.right.fx:.2f}",
                f"{rig.baseline_mm:.4f}",
                f"{turn:.4f}",
            )
        )
    head = (
        "same marks",
        "stereo rms px",
        "epipolar rms px",
        "left fx px",
        "right fx px",
        "baseline mm",
        "turn °",
    )
    text = "<p>An outside witness: all marks weighted alike, Brown-Conrady with k1, k2, p1, p2.</p>"
    return "<h2>Plain OpenCV on the same marks</h2>" + _table(head, rows) + text


def _views(calibration: Calibration, held: Sequence[HeldOutView], views: Sequence[StereoView]) -> str:
    fits = {fit.name: fit for fit in calibration.views}
    without = {view.name: view for view in held}
    reasons = dict(calibration.excluded)
    rows = []
    for view in views:
        cells = [view.name, str(view.board)]
        for found in (view.left, view.right):
            cells += ["", ""] if isinstance(found, Missed) else [str(len(found.ids)), f"{found.blur_px:.2f}"]
        if view.name in fits:
            measured = without.get(view.name)
            cells.append(f"{fits[view.name].rms_px:.4f}")
            if measured is not None:
                cells += [f"{measured.epipolar_rms_px:.4f}", f"{measured.scale:.6f}"]
        else:
            cells.append(f"left out: {reasons.get(view.name, '')}")
        rows.append((*cells, *[""] * (9 - len(cells))))
    head = (
        "view",
        "board",
        "marks left",
        "edge px",
        "right",
        "edge px",
        "rms px",
        "held-out rows px",
        "size",
    )
    text = (
        "<p>Edge: spread (sigma) of the marks' edges. Size: of the board, measured / true, view held out.</p>"
    )
    return "<h2>Views</h2>" + view_bars(calibration, held) + _table(head, rows) + text


def _signature() -> str:
    cells = "".join(f"<td>{name}</td>" for name in ("Date", "Name", "Signature"))
    return f'<table class="sign"><tr>{cells}</tr></table>'
