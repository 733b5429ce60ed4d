"""Writing job.toml for people, with comments that explain each line."""

from __future__ import annotations

import json
import math

import numpy as np

from edged.domain.picking import Bounds, Grasp, Tray
from edged.robot.orientations import fixed_xyz
from edged.vision.part.job import Job, MeasurementKind, MeasurementSpec, nominal_size


def _numbers(values: object) -> str:
    return "[" + ", ".join(repr(float(value)) for value in np.ravel(np.asarray(values))) + "]"


def to_toml(job: Job) -> str:
    """The text of a job's file."""
    limits, search = job.limits, job.search
    radius_line, form_line = (
        f"# {name} = 0.05" if tolerance is None else f"{name} = {tolerance!r}"
        for name, tolerance in (
            ("radius_tolerance_mm", limits.radius_tolerance_mm),
            ("form_tolerance_mm", limits.form_tolerance_mm),
        )
    )
    scale_y_line = (
        f"scale_y = {_numbers((search.scale_y_min, search.scale_y_max))}"
        if search.scale_y_min is not None and search.scale_y_max is not None
        else "# scale_y = [0.9, 1.1]"
    )
    lines = [
        "# A taught job. Edit what you like below; unknown keys are errors. shape.npz is not for editing.",
        'format = "edged-job"',
        "version = 1",
        f'name = "{job.name}"',
        f"number = {job.number}   # how the PLC calls it",
        f'reference = "{job.reference}"   # the circle, slot or corner whose place is the reported position',
        f'witness = "{job.witness}"   # the measurement whose size is known: tells when the rig drifts'
        if job.witness
        else '# witness = "l"   # a measurement whose size is known: tells when the rig drifts',
        *(
            [f"calibration = {json.dumps(job.calibration_id)}   # of the rig that measured the sizes below"]
            if job.calibration_id
            else []
        ),
        "# pose at teaching: x_rig = rig_from_part x_part, mm",
        "rig_from_part = [",
        *(f"    {_numbers(row)}," for row in job.rig_from_part),
        "]",
        *_model_to_toml(job),
        *_break_to_toml(job),
        "",
        "[limits]   # a result beyond them is published as not good, with the reason",
        f"depth_mm = {_numbers(limits.depth_mm)}   # nearest and farthest, rig z",
        f"min_support = {limits.min_support!r}   # share of the reference circle that each camera must see",
        f"max_rms_px = {limits.max_rms_px!r}   # of its edges",
        f"max_sigma_mm = {limits.max_sigma_mm!r}   # of each coordinate",
        f"max_epipolar_px = {limits.max_epipolar_px!r}   # rows of both cameras against each other",
        "# How far a part may differ from the taught one. Beyond that it is another part, another edge was",
        "# seen (a chamfer, a burr), or the distance is wrong (a knocked camera, a part that moved between",
        "# the exposures). Taught: half of ISO 2768-1 class f, or half a pixel. Your drawing knows better.",
        radius_line + "   # of the reference circle",
        form_line + "   # of a part without circles: of each straight edge and slot",
        *_bounds_to_toml(job.picking.bounds),
        "",
        "[search]",
        f"angle_start_deg = {math.degrees(search.angle_start_rad):.6g}",
        f"angle_extent_deg = {math.degrees(search.angle_extent_rad):.6g}   # a nut looks the same after 60",
        f"scale = {_numbers((search.scale_min, search.scale_max))}   # apparent size against the teaching",
        scale_y_line + "   # the same across, where it differs",
        f"min_score = {search.min_score!r}   # share of the shape that must be seen",
        f"max_matches = {search.max_matches}",
        f"max_overlap = {search.max_overlap!r}",
        '# contrast "same" as taught, "global": may be inverted as a whole, "local": each edge by itself',
        f'polarity = "{search.polarity}"',
        f"min_contrast = {search.min_contrast!r}   # grey values per px",
        f'sub_pixel = "{search.sub_pixel}"   # none, rigid, similarity, stretch, affine or projective',
        f"allow_partial = {str(search.allow_partial).lower()}   # may reach beyond the image",
        ("# tilt_deg = 45" if job.tilt_rad is None else f"tilt_deg = {math.degrees(job.tilt_rad):.6g}")
        + "   # how far the part may lie tilted, from the bisector of the cameras",
        "",
        "[picking]   # several parts in one picture: which the robot gets first",
        f'order = "{job.picking.order}"   # score, nearest, topmost, leftmost, least_sigma or pocket',
        *_tray_to_toml(job.picking.tray),
    ]
    lines += _points_to_toml(job)
    lines += [*_grasps_to_toml(job.picking.grasps), *_features_to_toml(job), *_measurements_to_toml(job)]
    return "\n".join(lines) + "\n"


def _break_to_toml(job: Job) -> list[str]:
    if job.body is not None and job.body.breaks_mm is not None:
        return []
    what = "width of the part's edge breaks (chamfers, roundings); 0: sharp. Your drawing knows better."
    width = "# break_mm = 0.2" if job.break_mm is None else f"break_mm = {job.break_mm!r}"
    end = (
        []
        if job.break_end is None
        else [f'break_end = "{job.break_end}"   # the edge of each that was taught']
    )
    return [f"{width}   # {what}", *end]


def _model_to_toml(job: Job) -> list[str]:
    """The frame of the CAD model, if there is one, and the sigma of the features, if they have one."""
    sigma = [f"sigma_mm = {job.sigma_mm!r}   # of the features"] if job.sigma_mm else []
    if job.part_from_model is None:
        return sigma
    return [
        "# frame of the CAD model: x_part = part_from_model x_model, mm",
        "part_from_model = [",
        *(f"    {_numbers(row)}," for row in job.part_from_model),
        "]",
        f'report = "{job.report}"   # whose pose is published: reference, model, or a [[point]] of its frame',
        *sigma,
    ]


def _points_to_toml(job: Job) -> list[str]:
    """Points of the CAD model; for a job without points, a comment that shows how to add one."""
    if job.part_from_model is None:
        return []
    if not job.points:
        return ["", '# [[point]], name = "grip", position_mm = [x, y, z]: of the CAD model, for report above']
    return [
        line
        for point in job.points
        for line in [
            "",
            "[[point]]",
            f'name = "{point.name}"',
            f"position_mm = {_numbers(point.position_mm)}",
        ]
    ]


def _bounds_to_toml(bounds: tuple[Bounds, ...]) -> list[str]:
    """The boxes where the robot may go; for a job without any, an example as comments."""
    if not bounds:
        return [
            "# Where the robot may go for this part, and where not, in its frame (the rig's without one):",
            '# [[limits.box]] or [[limits.keep_out]], name = "bin", min_mm = [x, y, z], max_mm = [x, y, z]',
        ]
    lines: list[str] = []
    for key, boxes in (("box", bounds[0].boxes), ("keep_out", bounds[0].keep_out)):
        for box in boxes:
            corners = f"min_mm = {_numbers(box.min_mm)}", f"max_mm = {_numbers(box.max_mm)}"
            lines += ["", f"[[limits.{key}]]", f'name = "{box.name}"', *corners]
    return lines


def grasp_to_toml(grasp: Grasp) -> list[str]:
    """One grasp as a table of a job's file."""
    rotation_deg = fixed_xyz(grasp.part_from_tcp[:3, :3])
    return [
        "[[grasp]]",
        f"name = {json.dumps(grasp.name)}",
        f"position_mm = {_numbers(grasp.part_from_tcp[:3, 3])}   # the tool's tip, part frame",
        f"rotation_deg = {_numbers(rotation_deg)}   # of the tool, about the part's fixed x, y, z",
        f"approach_mm = {grasp.approach_mm!r}",
        f"retreat_mm = {grasp.retreat_mm!r}",
        f"symmetry = {grasp.symmetry}   # ways to take it alike, turned about the part's z; 0: any",
    ]


def _tray_to_toml(tray: Tray | None) -> list[str]:
    if tray is None:
        return []
    lines = ["", "[picking.tray]", f"first_mm = {_numbers(tray.first_mm)}   # of a part in the first pocket"]
    names = (("columns", "row_end_mm"), ("rows", "column_end_mm"), ("layers", "layer_end_mm"))
    for (name, place), count, end_mm in zip(names, tray.counts, tray.ends_mm, strict=True):
        lines += [f"{name} = {count}", f"{place} = {_numbers(end_mm)}"] if count > 1 else []
    return [*lines, f"tolerance_mm = {tray.tolerance_mm!r}   # from the middle of a pocket"]


def _grasps_to_toml(grasps: tuple[Grasp, ...]) -> list[str]:
    if not grasps:
        return [
            "",
            "# How a tool takes the part; its z axis is the direction in which it comes. Take out the #:",
            "# [[grasp]]",
            '# name = "inner"',
            "# position_mm = [0.0, 0.0, 0.0]   # the tool's tip, part frame",
            "# approach_mm = 50.0",
        ]
    return [line for grasp in grasps for line in ["", *grasp_to_toml(grasp)]]


def _features_to_toml(job: Job) -> list[str]:
    lines: list[str] = []
    for circle in job.circles:
        lines += [
            "",
            "[[circle]]   # part frame, mm; polarity 1: brighter outside",
            f'name = "{circle.name}"',
            f"centre_mm = {_numbers(circle.centre_mm)}",
            f"radius_mm = {circle.radius_mm!r}",
            f"polarity = {circle.polarity}",
            *(["double = true   # a second edge runs beside it: a chamfer"] if circle.double else []),
        ]
    for slot in job.slots:
        lines += [
            "",
            "[[slot]]   # part frame, mm; length over all; angle of its long axis, from x to y",
            f'name = "{slot.name}"',
            f"centre_mm = {_numbers(slot.centre_mm)}",
            f"angle_deg = {math.degrees(slot.angle_rad)!r}",
            f"length_mm = {slot.length_mm!r}",
            f"width_mm = {slot.width_mm!r}",
            f"polarity = {slot.polarity}",
        ]
    for edge in job.edges:
        lines += [
            "",
            "[[edge]]   # part frame, mm; polarity 1: brighter at 90 degrees from its direction, from x to y",
            f'name = "{edge.name}"',
            f"start_mm = {_numbers(edge.start_mm)}",
            f"end_mm = {_numbers(edge.end_mm)}",
            f"polarity = {edge.polarity}",
        ]
    for corner in job.corners:
        lines += [
            "",
            "[[corner]]   # where two edges meet",
            f'name = "{corner.name}"',
            f'edges = ["{corner.edges[0]}", "{corner.edges[1]}"]',
        ]
    return lines


def _measurements_to_toml(job: Job) -> list[str]:
    """The measurements; for a job without any, some that its features allow, as comments."""
    if job.measurements:
        return [line for spec in job.measurements for line in ["", *_measurement_to_toml(spec)]]
    kinds: dict[MeasurementKind, tuple[str, ...]] = {}
    if job.circles:
        kinds["radius"] = (job.reference_circle.name,)
    if len(job.circles) > 1:
        far = max(
            job.circles[1:], key=lambda c: float(np.linalg.norm(c.centre_mm - job.circles[0].centre_mm))
        )
        other = max(job.circles, key=lambda c: float(np.linalg.norm(c.centre_mm - far.centre_mm)))
        kinds["distance"] = (far.name, other.name)
    if job.slots:
        kinds["width"] = kinds["length"] = (job.slots[0].name,)
    if job.corners:
        kinds["angle"] = job.corners[0].edges
    heights = sorted(job.circles, key=lambda c: -float(c.centre_mm[2]))
    if job.solid and len(heights) > 1:
        kinds["height"] = (heights[0].name, heights[-1].name)
    kinds["flatness"] = ()
    lines = ["", "# What to measure; a part out of tolerance is not good. Take out the # of what you want:"]
    for kind, of in kinds.items():
        nominal = nominal_size(job, kind, of)
        spec = MeasurementSpec(kind, kind, of, nominal, math.radians(0.1) if kind == "angle" else 0.05)
        lines += ["#", *(f"# {line}" for line in _measurement_to_toml(spec))]
    return lines


def _measurement_to_toml(spec: MeasurementSpec) -> list[str]:
    of = ", ".join(f'"{name}"' for name in spec.of)
    lines = ["[[measurement]]", f'name = "{spec.name}"', f'kind = "{spec.kind}"']
    lines += [f"of = [{of}]"] if spec.of else []
    unit, scale = ("deg", math.degrees(1)) if spec.kind == "angle" else ("mm", 1.0)
    if spec.nominal is not None and spec.kind != "flatness":
        lines.append(f"nominal_{unit} = {spec.nominal * scale!r}")
    if spec.tolerance is not None:
        lines.append(f"tolerance_{unit} = {spec.tolerance * scale!r}")
    return lines
