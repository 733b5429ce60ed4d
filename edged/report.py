"""The calibration report: one self-contained HTML page that can be archived and printed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from edged.vision.boards import StereoView
from edged.vision.calibration import Calibration

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:62em;color:#1b1f24}
h1{font-size:1.6em}h2{font-size:1.2em;margin-top:2em;border-bottom:1px solid #d0d7de}
table{border-collapse:collapse;margin:.6em 0}td,th{padding:.2em .9em .2em 0;text-align:right}
td{font-variant-numeric:tabular-nums}
td:first-child,th:first-child{text-align:left}
"""


def calibration_report(
    calibration: Calibration, views: Sequence[StereoView], quality: Mapping[str, Any]
) -> str:
    """The page. views : all that were offered, used or not."""
    sections = [_summary(calibration, quality), _parameters(calibration), _views(calibration, views)]
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
    rows = [
        ("board", str(quality["board"])),
        ("views used", str(len(calibration.views))),
        ("stereo rms", f"{calibration.rms_px:.4f} px"),
        ("epipolar rms", f"{calibration.epipolar_rms_px:.4f} px"),
        ("baseline", f"{calibration.rig.baseline_mm:.4f} mm"),
    ]
    notes = "".join(f"<p>{escape(note)}</p>" for note in calibration.notes)
    return "<h2>Summary</h2>" + _table(("", ""), rows) + notes


def _parameters(calibration: Calibration) -> str:
    rig = calibration.rig
    values = []
    for camera in (rig.left, rig.right):
        values += [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]
    values += [float("nan")] * 3 + list(rig.right_from_left[:3, 3])
    sigma = np.zeros(len(values)) if rig.covariance is None else np.sqrt(np.diag(rig.covariance))
    rows = [
        (name, f"{value:.6g}", f"{s:.2g}")
        for name, value, s in zip(rig.parameter_names, values, sigma, strict=True)
    ]
    return "<h2>Parameters</h2>" + _table(("parameter", "value", "sigma"), rows)


def _views(calibration: Calibration, views: Sequence[StereoView]) -> str:
    rms = {fit.name: fit.rms_px for fit in calibration.views}
    reasons = dict(calibration.excluded)
    rows = [
        (view.name, f"{rms[view.name]:.4f} px" if view.name in rms else reasons.get(view.name, ""))
        for view in views
    ]
    return "<h2>Views</h2>" + _table(("view", "rms, or why it was left out"), rows)
