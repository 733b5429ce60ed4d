"""Point clouds as PLY files (G. Turk, "The PLY Polygon File Format", 1994), read by every 3D viewer."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from edged.files.atomic import write_file
from edged.vision.part.pointcloud import CONTOUR, FACE, PointCloud

COLOURS = {CONTOUR: (255, 120, 0), FACE: (40, 110, 170)}
"""Red, green, blue: contours orange, faces blue."""
VERTEX = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("sigma", "<f4"),
    ]
)
TYPES = {"<f4": "float", "|u1": "uchar"}


def encode_ply(cloud: PointCloud) -> bytes:
    """Encode as binary PLY: x, y, z in mm in the rig frame, colour by kind, sigma of the depth in mm."""
    vertices = np.zeros(len(cloud.points_mm), VERTEX)
    for axis, name in enumerate("xyz"):
        vertices[name] = cloud.points_mm[:, axis]
    vertices["sigma"] = cloud.sigma_mm
    palette = np.array([COLOURS[kind] for kind in (CONTOUR, FACE)], np.uint8)
    for channel, name in enumerate(("red", "green", "blue")):
        vertices[name] = palette[cloud.kinds, channel]
    fields = [f"property {TYPES[VERTEX[name].str]} {name}" for name in VERTEX.names or ()]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment edged: mm, frame of the left camera; contours orange, faces blue; sigma of the depth",
        f"element vertex {len(vertices)}",
        *fields,
        "end_header",
    ]
    return "\n".join(header).encode() + b"\n" + vertices.tobytes()


def save_ply(path: Path, cloud: PointCloud) -> None:
    """Write a PLY file atomically. Raises `FileFormatError` if that fails."""
    write_file(path, encode_ply(cloud))
