"""Calibration report: one self-contained HTML page that can be archived, printed and signed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from markupsafe import Markup

from edged.domain.arrays import SIDES, Image
from edged.report.figures import coverage, lengths, radial, sigma_maps, thumbnail, view_bars
from edged.report.page import HtmlTable, render
from edged.vision.boards.board import NotDetected, StereoView
from edged.vision.calibration.calibrate import Calibration
from edged.vision.calibration.coverage import coverage_in_words, coverage_of
from edged.vision.calibration.crossvalidation import HeldOutView
from edged.vision.calibration.imaging import ImagingFinding
from edged.vision.calibration.lenschoice import choice_in_words
from edged.vision.calibration.nextbestview import best_next_view, depths_mm, volume_points
from edged.vision.calibration.params import GUIDANCE, IMAGING
from edged.vision.calibration.plainopencv import PlainCalibration
from edged.vision.geometry.camera import DISTORTION_NAMES, StereoRig
from edged.vision.geometry.rectification import Rectification, make_rectification
from edged.vision.geometry.rigid import rotation_vector
from edged.vision.geometry.triangulation import raw_covariance
from edged.vision.geometry.uncertainty import calibration_covariance, shift_by_parameters


@dataclass(frozen=True, slots=True, eq=False)
class ReportExtras:
    """Optional content of a calibration report.

    about : lines for its head (date, folder, software).  plain : OpenCV on the same marks.  found : findings
    about the cameras from the boards' edges.  verdict : as the command prints it.  thumbnails : both pictures
    of each view, small.
    """

    about: Mapping[str, str] = field(default_factory=dict)
    plain: PlainCalibration | None = None
    found: Sequence[ImagingFinding] = ()
    verdict: str = ""
    thumbnails: Mapping[str, tuple[Image, Image]] = field(default_factory=dict)


def calibration_report(
    calibration: Calibration,
    held: Sequence[HeldOutView],
    views: Sequence[StereoView],
    quality: Mapping[str, Any],
    also: ReportExtras | None = None,
) -> str:
    """Render the page. held : held-out measurements of the views.  views : all, whether used or not."""
    also = also or ReportExtras()
    rig, rectification = calibration.rig, make_rectification(calibration.rig)
    internal, lenses = _internal(rig, rectification)
    return render(
        "calibration.html",
        title=f"Stereo calibration {rig.calibration_id}",
        heading="Stereo calibration",
        calibration_id=rig.calibration_id,
        about=_about(calibration, quality, also.about),
        verdict=also.verdict,
        fitted=_fitted(calibration),
        independent=_independent(held, quality),
        remarks=calibration.notes,
        lengths=lengths(held) if held else None,
        covered=coverage_in_words([coverage_of(calibration, side) for side in SIDES]),
        coverage=coverage(calibration, "left", rig.left) + coverage(calibration, "right", rig.right),
        radial=radial(calibration),
        imaging=[finding.text for finding in also.found],
        volume=_volume(calibration),
        sigma_maps=sigma_maps(calibration),
        internal=internal,
        lenses=lenses,
        external=_external(rig, rectification),
        weakest=_weakest(calibration),
        advice=best_next_view(calibration),
        comparison=None if also.plain is None else _comparison(calibration, also.plain),
        view_bars=view_bars(calibration, held),
        views=_views(calibration, held, views),
        orange=any(coverage_of(calibration, side).share < 1.0 for side in SIDES),
        enough=GUIDANCE.good_coverage,
        pictures=_pictures(calibration, views, also.thumbnails),
    )


def _pictures(
    calibration: Calibration, views: Sequence[StereoView], thumbnails: Mapping[str, tuple[Image, Image]]
) -> list[tuple[Markup, str]]:
    """Both pictures of each view, with a caption."""
    fits = {fit.name: fit for fit in calibration.views}
    reasons = dict(calibration.excluded)
    sizes = [(camera.width, camera.height) for camera in (calibration.rig.left, calibration.rig.right)]
    shown = []
    for view in views:
        if view.name not in thumbnails:
            continue
        both = zip(SIDES, thumbnails[view.name], sizes, strict=True)
        finding = (
            f"rms {fits[view.name].rms_px:.4f} px"
            if view.name in fits
            else f"skipped: {reasons.get(view.name, '')}"
        )
        pictures = Markup().join(thumbnail(view, side, small, size) for side, small, size in both)
        shown.append((pictures, f"{view.name}: {finding}"))
    return shown


def _about(calibration: Calibration, quality: Mapping[str, Any], about: Mapping[str, str]) -> HtmlTable:
    rig = calibration.rig
    return HtmlTable(
        [
            *about.items(),
            ("board, as stated", str(quality["board"])),
            ("lens model", _lens(calibration)),
            ("images left, right", ", ".join(f"{c.width} × {c.height} px" for c in (rig.left, rig.right))),
        ]
    )


def _lens(calibration: Calibration) -> str:
    """Lens model, and how it was chosen if it was not given."""
    if not calibration.lenses:
        return calibration.rig.left.model
    return choice_in_words(calibration.lenses).removeprefix("lens model ")


def _fitted(calibration: Calibration) -> HtmlTable:
    used, offered = len(calibration.views), len(calibration.views) + len(calibration.excluded)
    rows = [
        ("views used", f"{used} of {offered}"),
        ("stereo rms", f"{calibration.rms_px:.4f} px"),
        ("left, right rms", f"{calibration.rms_left_px:.4f}, {calibration.rms_right_px:.4f} px"),
        ("epipolar rms", f"{calibration.epipolar_rms_px:.4f} px"),
        ("baseline", f"{calibration.rig.baseline_mm:.4f} mm"),
        ("marks rejected as outliers", str(calibration.outliers)),
    ]
    return HtmlTable(rows, ("fitted to all views", ""))


def _independent(held: Sequence[HeldOutView], quality: Mapping[str, Any]) -> HtmlTable:
    figures = quality["held_out"]
    rows = [("held-out views", "too few views")]
    if figures:
        errors = np.concatenate([view.lengths_mm[:, 1] - view.lengths_mm[:, 0] for view in held])
        rows = [
            ("held-out reprojection rms", f"{figures['reprojection_rms_px']:.4f} px"),
            ("held-out epipolar rms", f"{figures['epipolar_rms_px']:.4f} px"),
            ("board size, measured / true", f"{figures['board_size']:.6f} ± {figures['board_size_std']:.6f}"),
            (f"{len(errors)} lengths, error rms", f"{1000 * np.sqrt(np.mean(errors**2)):.1f} µm"),
            ("largest length error", f"{1000 * np.abs(errors).max():.1f} µm"),
            ("off a plane, rms", f"{1000 * figures['flatness_rms_mm']:.1f} µm"),
        ]
    return HtmlTable(rows, ("views not used for their own result", ""))


def _volume(calibration: Calibration) -> HtmlTable:
    """Uncertainty of a point at three depths: noise of the image, and the calibration."""
    rig, rows = calibration.rig, []
    points = volume_points(calibration)
    for depth in depths_mm(calibration):
        here = points[np.isclose(points[:, 2], depth)]
        if not len(here):
            continue
        noise = np.sqrt(np.mean(np.einsum("nii->ni", raw_covariance(rig, here, IMAGING.noise_px)), axis=0))
        ours = np.sqrt(np.mean(np.einsum("nii->ni", calibration_covariance(rig, here)), axis=0))
        rows.append((f"Z = {depth:.0f} mm", *(f"{1000 * value:.1f}" for value in (*noise, *ours))))
    head = ("µm, one sigma (rms)", "noise: σX", "σY", "σZ", "calibration: σX", "σY", "σZ")
    return HtmlTable(rows, head)


def _internal(rig: StereoRig, rectification: Rectification) -> tuple[HtmlTable, HtmlTable]:
    """Tables of the intrinsics in px with sigma, in the form of the paper's Table 1, and of the lenses."""
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
    return HtmlTable(rows, head), HtmlTable(lenses, ("lens", *blank))


def _external(rig: StereoRig, rectification: Rectification) -> HtmlTable:
    """Position and rotation between the cameras, both ways, in the form of the paper's Table 2."""
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
    place = [f"{value:.4f}" for value in rig.eyes_mm[1]]
    rows = (
        ("before rectification", *before),
        ("after", f"{-rectification.baseline_mm:.4f}", "0", "0", "0", "0", "0"),
        ("right camera in left frame", *place, *(f"{-value:.4f}" for value in turn)),
    )
    head = ("Table 2: right_from_left", "x mm", "y mm", "z mm", "turn x °", "turn y °", "turn z °")
    return HtmlTable(rows, head)


def _sigmas(rig: StereoRig) -> dict[str, float]:
    """One sigma of each parameter by its name."""
    count = len(rig.parameter_names)
    values = np.full(count, np.nan) if rig.covariance is None else np.sqrt(np.diag(rig.covariance))
    return dict(zip(rig.parameter_names, values.tolist(), strict=True))


def _weakest(calibration: Calibration) -> HtmlTable:
    """Table of the parameters whose uncertainty has the largest effect on a point."""
    rig = calibration.rig
    sigma = _sigmas(rig)
    shift = shift_by_parameters(rig, volume_points(calibration))
    names = list(rig.parameter_names)
    # fx and fy that are one unknown move together
    for side, camera in (("left", rig.left), ("right", rig.right)):
        if camera.fx == camera.fy:
            x, y = names.index(f"{side}.fx"), names.index(f"{side}.fy")
            shift[:, :, x] += shift[:, :, y]
            shift[:, :, y] = 0.0
    effect_um = 1000 * np.sqrt(np.mean(np.sum(shift**2, axis=1), axis=0)) * np.array(list(sigma.values()))
    order = [i for i in np.argsort(-np.nan_to_num(effect_um)) if effect_um[i] > 0][:6]
    rows = [(names[i], _sigma_text(names[i], sigma[names[i]]), f"{effect_um[i]:.1f} µm") for i in order]
    return HtmlTable(rows, ("weakest first", "one sigma", "effect on a point alone"))


def _sigma_text(name: str, sigma: float) -> str:
    kind = name.split(".")[1]
    if name.startswith("rotation"):
        return f"{np.degrees(sigma):.5f}°"
    if name.startswith("translation"):
        return f"{1000 * sigma:.1f} µm"
    return f"{sigma:.3f} px" if kind in ("fx", "fy", "cx", "cy") else f"{sigma:.2g}"


def _comparison(calibration: Calibration, plain: PlainCalibration) -> HtmlTable:
    """Comparison with cv2.stereoCalibrate on the same marks."""
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
    return HtmlTable(rows, head)


def _views(calibration: Calibration, held: Sequence[HeldOutView], views: Sequence[StereoView]) -> HtmlTable:
    fits = {fit.name: fit for fit in calibration.views}
    without = {view.name: view for view in held}
    reasons = dict(calibration.excluded)
    rows = []
    for view in views:
        cells = [view.name, str(view.board)]
        for found in (view.left, view.right):
            cells += (
                ["", ""] if isinstance(found, NotDetected) else [str(len(found.ids)), f"{found.blur_px:.2f}"]
            )
        if view.name in fits:
            measured = without.get(view.name)
            cells.append(f"{fits[view.name].rms_px:.4f}")
            if measured is not None:
                cells += [f"{measured.epipolar_rms_px:.4f}", f"{measured.scale:.6f}"]
        else:
            cells.append(f"skipped: {reasons.get(view.name, '')}")
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
    return HtmlTable(rows, head)
