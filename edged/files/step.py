"""Read STEP files of one solid part with `cascadio` (the extra `cad`): faces in mm, in the file's frame.

`cascadio` wraps a large C++ library, and files come from untrusted sources. It runs in its own process with
limits of time and memory, so that anything it does with a damaged file ends in an error message.
"""

from __future__ import annotations

import importlib.util
import json
import math
import re
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from edged.domain.arrays import FloatArray
from edged.errors import FileFormatError
from edged.files.atomic import read_bytes
from edged.vision.part.body import MAX_TRIANGLES
from edged.vision.teaching.cadmodel import CadModel, FlatSurface, RoundSurface, Surface

MAX_FACES = 20_000
"""Most faces of one part; castings with every fillet have a few thousand."""
MIN_READ = 0.9
"""Smallest share of the faces that must be read: only slivers between others may be lost."""
MAX_CONVERTED = 2_000_000
"""Most triangles that are read."""
MAX_SECONDS = 60
MAX_MEMORY_BYTES = 4 << 30
"""Limit of address space, not of resident pages: the library alone takes 1 GiB of it."""
MAX_MESH_BYTES = 256 << 20
"""Largest binary glTF accepted from the library."""
FINENESS = (0.01, 0.2), (0.02, 0.25), (0.02, 0.3)
"""Deviations of the triangles from the surface, mm and rad, of which the next is taken where a job could not
keep all triangles. From 0.35 rad (`MODEL.sharp`) the sides of the triangles of a fillet count as edges."""
METRES = 1000.0

_SOLIDS = re.compile(
    rb"=\s*(?:MANIFOLD_SOLID_BREP|BREP_WITH_VOIDS|FACETED_BREP|SHELL_BASED_SURFACE_MODEL)\s*\("
)
_FACES = re.compile(rb"=\s*(?:ADVANCED_FACE|FACE_SURFACE)\s*\(")
_COLOURED = re.compile(rb"\w*STYLED_ITEM\b")
"""What gives faces colours. Of a part of several the library describes the faces of one colour only."""
_WORKER = """
import os, resource, sys
for what, most in ((resource.RLIMIT_AS, int(sys.argv[1])), (resource.RLIMIT_CPU, int(sys.argv[2]))):
    resource.setrlimit(what, (most, most))
out = os.dup(1)
os.dup2(2, 1)   # the library talks
try:
    import cascadio
except ImportError as error:
    sys.exit(f"cascadio: {error}")
if os.geteuid() == 0:   # nobody: root parses no stranger's file
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)
glb = cascadio.load(sys.stdin.buffer.read(), "step", float(sys.argv[3]), float(sys.argv[4]),
                    use_parallel=False, include_brep=True)
if len(glb) > int(sys.argv[5]):
    sys.exit(f"{len(glb)} bytes of triangles, at most {sys.argv[5]}")
with os.fdopen(out, "wb") as stream:
    stream.write(glb)
"""


def read_step(path: Path) -> CadModel:
    """Read the one solid of a STEP file, converted to mm.

    Raises `FileFormatError` for a file that is not STEP, is cut off or damaged, has no solid or several,
    has more than `MAX_FACES` faces or no plane one, and if `cascadio` is not installed.
    """
    path = Path(path)
    data = read_bytes(path, "a STEP file")
    if not data.lstrip().startswith(b"ISO-10303-21"):
        raise FileFormatError(f"{path}: not a STEP file: expected ISO-10303-21 at its beginning")
    if b"END-ISO-10303-21" not in data[-4096:]:
        raise FileFormatError(f"{path}: cut off: expected END-ISO-10303-21 at its end")
    solids = len(_SOLIDS.findall(data))
    if solids != 1:
        raise FileFormatError(f"{path}: {solids or 'no'} solids: expected the model of one part, one solid")
    faces = len(_FACES.findall(data))
    if faces > MAX_FACES:
        raise FileFormatError(f"{path}: {faces} faces: expected the model of one part, at most {MAX_FACES}")
    try:
        for fineness in FINENESS:
            model = _model(_converted(data, path, fineness))
            if len(model.triangles) <= MAX_TRIANGLES:
                break
    except (ValueError, LookupError, TypeError, struct.error) as error:
        raise FileFormatError(f"{path}: damaged: its solid cannot be read ({error})") from error
    if len(model.surfaces) < MIN_READ * faces:
        raise FileFormatError(f"{path}: damaged: {len(model.surfaces)} of its {faces} faces can be read")
    if not any(isinstance(surface, FlatSurface) for surface in model.surfaces):
        raise FileFormatError(f"{path}: no plane face: expected a part with a flat face to the cameras")
    return model


def _converted(data: bytes, path: Path, fineness: tuple[float, float]) -> bytes:
    """Convert the file to binary glTF: triangles of a fineness, and the face that each belongs to."""
    if importlib.util.find_spec("cascadio") is None:
        raise FileFormatError(f"{path}: to read STEP files, install cascadio: pip install 'edged[cad]'")
    limits = MAX_MEMORY_BYTES, MAX_SECONDS, *fineness, MAX_MESH_BYTES
    command = [sys.executable, "-P", "-c", _WORKER, *(str(limit) for limit in limits)]
    try:
        plain = _COLOURED.sub(b"NO_ITEM", data)
        done = subprocess.run(command, input=plain, capture_output=True, timeout=2 * MAX_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        raise FileFormatError(f"{path}: not read within {MAX_SECONDS} s: expected one part") from None
    if done.returncode != 0 or not done.stdout:
        lines = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        if lines and lines[0].startswith("cascadio: "):
            raise FileFormatError(f"{path}: {lines[0]}: reinstall it, pip install 'edged[cad]' again")
        why = f" ({lines[0][:200]})" if lines else ""
        raise FileFormatError(f"{path}: damaged, or too large: its solid cannot be read{why}")
    return done.stdout


def _model(glb: bytes) -> CadModel:
    """Parse triangles and faces from binary glTF. Raises ValueError, LookupError, TypeError, struct.error."""
    if glb[:4] != b"glTF":
        raise ValueError("no triangles")
    (size,) = struct.unpack_from("<I", glb, 12)
    document = json.loads(glb[20 : 20 + size])
    binary = glb[28 + size :]
    bodies = [
        (number, primitive)
        for number, node in enumerate(document.get("nodes", []))
        if "mesh" in node
        for primitive in document["meshes"][node["mesh"]]["primitives"]
        if primitive.get("mode", _TRIANGLES) == _TRIANGLES  # sketches are lines
    ]
    if len(bodies) != 1:
        raise ValueError(f"{len(bodies)} bodies")
    ((number, primitive),) = bodies
    extra = primitive["extensions"]["TM_brep_faces"]
    points = _array(document, binary, primitive["attributes"]["POSITION"]).astype(np.float64)
    triangles = _array(document, binary, primitive["indices"]).astype(np.int64).reshape(-1, 3)
    face_of = _array(document, binary, extra["faceIndices"]).astype(np.int64).reshape(-1)
    if not 0 < len(triangles) <= MAX_CONVERTED or len(face_of) != len(triangles):
        raise ValueError(f"{len(triangles)} triangles")
    placed = _placed(document, number)
    points = METRES * (points @ placed[:3, :3].T + placed[:3, 3])
    if not np.isfinite(points).all() or face_of.max() >= len(extra["faces"]):
        raise ValueError("coordinates that are no numbers")
    surfaces = tuple(None if face is None else _surface(face, placed) for face in extra["faces"])
    return CadModel(points, triangles, face_of, surfaces)


_TRIANGLES = 4  # of a primitive's modes (glTF 2.0 specification, 5.24.4)
_TYPES: dict[int, str] = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""numpy types of glTF component types (glTF 2.0 specification, 3.6.2.2)."""


def _array(document: dict[str, Any], binary: bytes, number: int) -> FloatArray:
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    kind, width = np.dtype(_TYPES[accessor["componentType"]]), 3 if accessor["type"] == "VEC3" else 1
    if view.get("byteStride", kind.itemsize * width) != kind.itemsize * width:
        raise ValueError("interleaved coordinates")
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    values = np.frombuffer(binary, kind, accessor["count"] * width, start)
    return values.reshape(-1, width) if width > 1 else values


def _placed(document: dict[str, Any], node: int) -> FloatArray:
    """Pose (4, 4) of a node in its file, in metres: the product of the transforms from the root to it."""
    placed = np.eye(4)
    seen: set[int] = set()
    at: int | None = node
    while at is not None and at not in seen:
        seen.add(at)
        placed = _own_place(document["nodes"][at]) @ placed
        at = next(
            (k for k, candidate in enumerate(document["nodes"]) if at in candidate.get("children", [])), None
        )
    return placed


def _own_place(node: dict[str, Any]) -> FloatArray:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    place = np.eye(4)
    place[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    place[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return place


def _surface(face: dict[str, Any], placed: FloatArray) -> Surface | None:
    """Exact parameters of a face in mm; None if it is neither a plane, a cylinder nor a cone."""

    def point(name: str) -> FloatArray:
        return np.asarray(METRES * (placed[:3, :3] @ np.array(face[name], np.float64) + placed[:3, 3]))

    def direction(name: str) -> FloatArray:
        vector = placed[:3, :3] @ np.array(face[name], np.float64)
        return np.asarray(vector / np.linalg.norm(vector))

    if face["type"] == "plane":
        return FlatSurface(point("origin"), direction("normal"))
    if face["type"] == "cylinder":
        return RoundSurface(point("origin"), direction("axis"), METRES * float(face["radius"]), 0.0)
    if face["type"] == "cone":
        slope = math.tan(abs(float(face["semi_angle"])))
        return RoundSurface(point("apex"), direction("axis"), 0.0, slope)
    return None
