"""Charts of a calibration report."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from markupsafe import Markup

from edged.domain.arrays import SIDES, FloatArray, Image, Side
from edged.pictures.encoding import jpeg
from edged.report.charts import INK, WARN, Chart, bars, field_map, symmetric_limit
from edged.vision.boards.board import NotDetected, StereoView
from edged.vision.calibration.calibrate import Calibration
from edged.vision.calibration.coverage import COLUMNS, ROWS, coverage_of
from edged.vision.calibration.crossvalidation import HeldOutView
from edged.vision.calibration.nextbestview import depths_mm
from edged.vision.geometry.camera import CameraModel
from edged.vision.geometry.rigid import apply
from edged.vision.geometry.triangulation import raw_covariance

_NOISE_PX = 0.05
_MAP_COLUMNS, _MAP_ROWS = 8, 6
_RADIAL_BINS = 10
_VECTOR_SHARE = 0.015  # length at which a residual equal to the rms is drawn, as a share of the image's width
_THUMBNAIL_QUALITY = 65  # of JPEG: about 4 kB per picture
_NOT_REACHED, _NOT_COMMON = "#f7d4bf", "#e4e7eb"
_FOUND, _FIRST = "#23d96c", "#ff8f3a"


def lengths(held: Sequence[HeldOutView]) -> Markup:
    """Chart of the length error (measured - true) of every single distance against its true length."""
    values = np.concatenate([view.lengths_mm for view in held])
    errors_um = 1000 * (values[:, 1] - values[:, 0])
    limit = symmetric_limit(errors_um)
    end = 1.05 * float(values[:, 0].max())
    chart = Chart((0.0, end), (-limit, limit), "true length, mm", "measured − true, µm", 940.0, 280.0)
    worst = float(np.abs(errors_um).max())
    chart.line(np.array([[0.0, 0.0], [end, 0.0]]))
    for level in (worst, -worst):
        chart.line(np.array([[0.0, level], [end, level]]), WARN, dashed=True)
    chart.points(np.column_stack([values[:, 0], errors_um]), radius=1.8)
    rms = float(np.sqrt(np.mean(errors_um**2)))
    caption = f"{len(values)} lengths in {len(held)} views: rms {rms:.1f} µm, largest {worst:.1f} µm"
    return chart.figure(caption)


def coverage(calibration: Calibration, side: Side, camera: CameraModel) -> Markup:
    """Marks in an image with their residuals, and the fields without any mark."""
    pixels, residuals = _marks(calibration, side)
    rms = calibration.rms_left_px if side == "left" else calibration.rms_right_px
    exaggeration = _VECTOR_SHARE * camera.width / max(rms, 1e-9)
    chart = Chart((0.0, camera.width - 1.0), (camera.height - 1.0, 0.0), "x, px", "y, px", 470.0, equal=True)
    fields = coverage_of(calibration, side)
    x_edges, y_edges = (
        np.linspace(0, n - 1.0, m + 1) for n, m in ((camera.width, COLUMNS), (camera.height, ROWS))
    )
    for row, y in enumerate(pairwise(y_edges)):
        for column, x in enumerate(pairwise(x_edges)):
            if not fields.common[row, column]:
                chart.rectangle(x, y, _NOT_COMMON)
            elif not fields.reached[row, column]:
                chart.rectangle(x, y, _NOT_REACHED)
    chart.strokes(pixels, pixels + exaggeration * residuals)
    caption = (
        f"{side}: {len(pixels)} marks in {100 * fields.share:.0f} % of the common view; residuals "
        f"magnified {exaggeration:.0f}×, rms {rms:.4f} px"
    )
    return chart.figure(caption)


def thumbnail(view: StereoView, side: Side, small: Image, size: tuple[int, int]) -> Markup:
    """Picture with the marks that were found in it, the first one as a ring.

    small (h, w) uint8.  size (W, H) : of the image in which the marks were measured.
    """
    found = view.left if side == "left" else view.right
    path, ring = "", Markup()
    if not isinstance(found, NotDetected):
        path = "".join(f"M{x:.0f} {y:.0f}h0" for x, y in found.pixels)
        first = found.pixels[int(np.argmin(found.ids))]
        mark = Markup(
            '<circle cx="{:.0f}" cy="{:.0f}" r="{:.0f}" fill="none" stroke="{}" stroke-width="{:.0f}"/>'
        )
        ring = mark.format(*first, size[0] / 45, _FIRST, size[0] / 150)
    picture = Markup(
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {} {}" role="img" aria-label="{}">'
        '<image href="data:image/jpeg;base64,{}" width="{}" height="{}"/>'
        '<path d="{}" fill="none" stroke="{}" stroke-width="{:.0f}" stroke-linecap="round"/>{}</svg>'
    )
    label = f"{view.name}, {side}: the marks that were found"
    encoded = base64.b64encode(jpeg(small, _THUMBNAIL_QUALITY)).decode()
    return picture.format(*size, label, encoded, *size, path, _FOUND, size[0] / 50, ring)


def _marks(calibration: Calibration, side: Side) -> tuple[FloatArray, FloatArray]:
    """Pixels (N, 2) and residuals (N, 2) of all views."""
    pixels = np.concatenate([fit.view.found(side).pixels for fit in calibration.views])
    residuals = [
        fit.residuals_left_px if side == "left" else fit.residuals_right_px for fit in calibration.views
    ]
    return pixels, np.concatenate(residuals)


def radial(calibration: Calibration) -> Markup:
    """Mean radial residual over the distance from the principal point: what the lens model leaves."""
    pictures = []
    for side, camera in zip(SIDES, (calibration.rig.left, calibration.rig.right), strict=True):
        pixels, residuals = _marks(calibration, side)
        arm = pixels - (camera.cx, camera.cy)
        radius = np.linalg.norm(arm, axis=1)
        outward = np.sum(residuals * arm, axis=1) / np.maximum(radius, 1e-9)
        edges = np.quantile(radius, np.linspace(0, 1, _RADIAL_BINS + 1))
        places, means, errors = [], [], []
        for low, high in pairwise(edges):
            inside = outward[(radius >= low) & (radius <= high)]
            if len(inside) > 1:
                places.append(0.5 * (low + high))
                means.append(float(inside.mean()))
                errors.append(float(inside.std(ddof=1)) / np.sqrt(len(inside)))
        x, mean, error = np.array(places), np.array(means), np.array(errors)
        limit = symmetric_limit(np.abs(mean) + 2 * error)
        chart = Chart(
            (0.0, float(edges[-1])),
            (-limit, limit),
            "distance from principal point, px",
            "outward, px",
            470.0,
            200.0,
        )
        chart.line(np.array([[0.0, 0.0], [float(edges[-1]), 0.0]]), INK)
        chart.strokes(
            np.column_stack([x, mean - 2 * error]), np.column_stack([x, mean + 2 * error]), width=1.5
        )
        chart.points(np.column_stack([x, mean]), radius=3)
        pictures.append(chart.figure(f"{side}: mean radial residual in rings of equal count, ± 2 sigma"))
    return Markup().join(pictures)


def sigma_maps(calibration: Calibration) -> Markup:
    """Expected sigma of a point over the left image: Z at three depths, X and Y at the middle one."""
    near, middle, far = (float(depth) for depth in depths_mm(calibration))
    pictures = [_sigma_map(calibration, depth, "σZ") for depth in (near, middle, far)]
    return Markup().join([*pictures, _sigma_map(calibration, middle, "σXY")])


def _sigma_map(calibration: Calibration, depth_mm: float, what: str) -> Markup:
    rig = calibration.rig
    x_edges = np.linspace(0, rig.left.width - 1, _MAP_COLUMNS + 1)
    y_edges = np.linspace(0, rig.left.height - 1, _MAP_ROWS + 1)
    u, v = np.meshgrid(0.5 * (x_edges[1:] + x_edges[:-1]), 0.5 * (y_edges[1:] + y_edges[:-1]))
    rays = rig.left.normalise(np.column_stack([u.ravel(), v.ravel()]))
    points = np.column_stack([rays, np.ones(len(rays))]) * depth_mm
    in_right = apply(rig.right_from_left, points)
    with np.errstate(invalid="ignore", divide="ignore"):
        pixels = rig.right.project(in_right)
        inside = (pixels >= 0) & (pixels <= (rig.right.width - 1, rig.right.height - 1))
    seen = inside.all(axis=1) & (in_right[:, 2] > 0)
    sigma_um = np.full(len(points), np.nan)
    if seen.any():
        covariance = raw_covariance(rig, points[seen], _NOISE_PX)
        variance = covariance[:, 2, 2] if what == "σZ" else covariance[:, [0, 1], [0, 1]].max(axis=1)
        sigma_um[seen] = 1000 * np.sqrt(variance)
    chart = Chart(
        (0.0, x_edges[-1]), (y_edges[-1], 0.0), "x, px of the left image", "y, px", 470.0, equal=True
    )
    field_map(
        chart, x_edges, y_edges, sigma_um.reshape(_MAP_ROWS, _MAP_COLUMNS), lambda value: f"{value:.3g}"
    )
    width_mm = depth_mm * rig.left.width / rig.left.fx
    name = "σZ" if what == "σZ" else "the larger of σX and σY"
    return chart.figure(f"{name} in µm for {_NOISE_PX} px, at Z = {depth_mm:.0f} mm ({width_mm:.0f} mm wide)")


def view_bars(calibration: Calibration, held: Sequence[HeldOutView]) -> Markup:
    """Rms of each view, and its rms with the calibration of the other views."""
    names = [fit.name for fit in calibration.views]
    without = {view.name: view.reprojection_rms_px for view in held}
    second = np.array([without[name] for name in names]) if held else None
    chart = bars(names, np.array([fit.rms_px for fit in calibration.views]), "rms, px", second)
    return chart.figure(
        "rms of each view" + ("; line: with the calibration of the other views" if held else "")
    )
