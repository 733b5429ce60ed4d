"""Truth of random parts in the format of data/rendered: for the rig, for drawings, for scenes."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from solids import Design, Outline, Wall
from solidstep import step_text

from edged.domain.arrays import FloatArray
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import apply


def rig_json(rig: StereoRig) -> dict[str, Any]:
    """Rig as in data/rendered: x_right = R x_left + T, mm."""

    def camera(one: CameraModel) -> dict[str, Any]:
        matrix = [[one.fx, 0.0, one.cx], [0.0, one.fy, one.cy], [0.0, 0.0, 1.0]]
        return {"model": one.model, "width": one.width, "height": one.height, "K": matrix,
                "kappa_normalised": one.distortion[0]}  # fmt: skip

    move = np.asarray(rig.right_from_left)
    return {
        "left": camera(rig.left),
        "right": camera(rig.right),
        "R": move[:3, :3].tolist(),
        "T": move[:3, 3].tolist(),
    }


def write_drawing(folder: Path, design: Design) -> None:
    """Write the nominal part as STEP, and its features."""
    (folder / f"{design.name}.step").write_text(step_text(design))
    breaks = {wall.name: [wall.form, wall.break_mm] for wall in design.walls if wall.break_mm}
    features = [one for wall in design.walls for one in _curves(wall, wall.outline, wall.top, wall.name)]
    facts = {"design": design.name, "break_in_step_mm": 0.0, "break_real_part_mm": breaks,
             "features_in_step": features}  # fmt: skip
    (folder / f"{design.name}.json").write_text(json.dumps(facts, indent=1))


def part_json(design: Design, rig_from_part: FloatArray, tilt_deg: float, rig: StereoRig) -> dict[str, Any]:
    """Truth of one part of a scene."""
    circles, lines, breaks = [], [], []
    for wall in design.walls:
        upper = wall.outline.offset(wall.profile(nominal=False)[0][0])
        ends = [("sharp", "", wall.outline, wall.top)]
        if wall.break_mm:
            ends = [("break_face", "@face", upper, wall.top),
                    ("break_wall", "@wall", wall.outline, wall.top + wall.break_mm)]  # fmt: skip
            breaks += _break_json(wall)
        for role, ending, outline, z in ends:
            for curve in _curves(wall, outline, z, wall.name + ending):
                (circles if curve["shape"] == "circle" else lines).append(curve | {"role": role})
    to_right = np.asarray(rig.right_from_left)
    for one in circles:
        centre = apply(rig_from_part, np.array([one["centre_part_mm"]]))
        one |= {"centre_left_mm": centre[0].tolist(), "centre_right_mm": apply(to_right, centre)[0].tolist(),
                "normal_left": (-rig_from_part[:3, 2]).tolist()}  # fmt: skip
    for one in lines:
        one["ends_left_mm"] = apply(rig_from_part, np.array(one["ends_part_mm"])).tolist()
    sizes = {wall.name: wall.break_mm for wall in design.walls if wall.break_mm}
    return {"design": design.name, "break_mm": sizes, "R": rig_from_part[:3, :3].tolist(),
            "t": rig_from_part[:3, 3].tolist(), "tilt_bisector_deg": tilt_deg, "edge_breaks": breaks,
            "circles": circles, "lines": lines}  # fmt: skip


def _curves(wall: Wall, outline: Outline, z: float, name: str) -> list[dict[str, Any]]:
    """Circles (or arcs, with their share of a circle) and straight lines of an outline at a level."""
    kind, found = "boss" if wall.solid else "hole", []
    rings: dict[tuple[float, float], float] = {}
    for side, centre in enumerate(outline.centres):
        if centre is not None:
            rings[centre] = rings.get(centre, 0.0) + outline.angles(side)[1] / math.tau
            continue
        ends = outline.corners[side], outline.corners[(side + 1) % len(outline.corners)]
        head, at, end = name.partition("@")
        found.append({"name": f"{head}_e{side}{at}{end}", "shape": "line", "kind": kind,
                      "ends_part_mm": [[*one, z] for one in ends], "height_mm": -z})  # fmt: skip
    for (x, y), share in rings.items():
        radius = outline.radius(outline.centres.index((x, y)))
        found.append({"name": name, "shape": "circle", "kind": kind, "radius_mm": radius,
                      "centre_part_mm": [x, y, z], "height_mm": -z, "normal_part": [0.0, 0.0, -1.0],
                      "edge_exists": round(share, 4)})  # fmt: skip
    return found


def _break_json(wall: Wall) -> list[dict[str, Any]]:
    """Breaks of a wall's upper edge: for each circle or arc, its nominal, face and wall end."""
    grow, found = wall.profile(nominal=False)[0][0], []
    for one in _curves(wall, wall.outline, wall.top, wall.name):
        if one["shape"] == "circle":
            radius, centre, lower = one["radius_mm"], one["centre_part_mm"], wall.top + wall.break_mm
            found.append({
                "feature": wall.name, "kind": one["kind"], "form": wall.form, "size_mm": wall.break_mm,
                "nominal": {"radius_mm": radius, "depth_mm": wall.top, "centre_part_mm": centre},
                "face_end": {"name": f"{wall.name}@face", "radius_mm": radius + grow, "depth_mm": wall.top},
                "wall_end": {"name": f"{wall.name}@wall", "radius_mm": radius, "depth_mm": lower},
            })  # fmt: skip
    return found
