"""STL files for tests: plates with round outlines and holes, and the triangles of any model."""

from __future__ import annotations

import numpy as np

from edged.domain.arrays import FloatArray

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def binary(corners: FloatArray, header: bytes = b"") -> bytes:
    """Triangles (N, 3, 3) as a binary file."""
    records = np.zeros(len(corners), RECORD)
    records["corners"] = corners
    return header.ljust(80, b"\0") + len(corners).to_bytes(4, "little") + records.tobytes()


def text(corners: FloatArray, digits: int = 6) -> str:
    """Triangles (N, 3, 3) as a text file."""
    lines = ["solid part"]
    for triangle in corners:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex " + " ".join(f"{x:.{digits}f}" for x in corner) for corner in triangle]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid part"]) + "\n"


def ring(
    count: int, outer_mm: float, inner_mm: float, high_mm: float, turn_rad: float = 0.1, rows: int = 1
) -> FloatArray:
    """Triangles (N, 3, 3) of a round plate with a central hole, each of `count` chords; z = 0 on top.

    rows : of triangles of the outer wall.
    """
    angle = turn_rad + 2 * np.pi * np.arange(count) / count
    unit = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    down = np.array([0.0, 0.0, -high_mm])
    top_out, top_in = outer_mm * unit, inner_mm * unit
    walls = [(top_out + k / rows * down, top_out + (k + 1) / rows * down) for k in range(rows)]
    faces = []
    for one, two in ((top_in, top_out), *walls, (top_out + down, top_in + down), (top_in + down, top_in)):
        next_one, next_two = np.roll(one, -1, axis=0), np.roll(two, -1, axis=0)
        faces += [np.stack([one, two, next_two], axis=1), np.stack([one, next_two, next_one], axis=1)]
    return np.concatenate(faces)
