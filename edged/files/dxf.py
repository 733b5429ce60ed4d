"""Read drawings of flat parts (DXF, or contours as plain text) as closed outlines in mm.

An outline is a (N, 2) float64 polygon, x to the right, y up as drawn, without its first point repeated.
Lines and arcs that meet are joined; an outline that does not close is an error that names its open ends.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from ezdxf import path as dxfpath
from ezdxf.document import Drawing as DxfDocument
from ezdxf.edgeminer import Deposit, Edge, make_edge
from ezdxf.entities.circle import Circle
from ezdxf.entities.dxfentity import DXFEntity
from ezdxf.entities.dxfgfx import DXFGraphic
from ezdxf.entities.ellipse import Ellipse
from ezdxf.entities.insert import Insert
from ezdxf.entities.lwpolyline import LWPolyline
from ezdxf.entities.polyline import Polyline
from ezdxf.entities.spline import Spline
from ezdxf.enums import InsertUnits
from ezdxf.filemanagement import readfile
from ezdxf.lldxf.const import DXFError
from ezdxf.math import OCS, Vec3
from ezdxf.units import conversion_factor

from edged.domain.arrays import FloatArray
from edged.errors import FileFormatError
from edged.files.atomic import read_bytes
from edged.files.readingcost import reading_cost
from edged.files.tables import number_of, read_table
from edged.owners import file_to_read

FLATTENING_MM = 0.002
"""Largest deviation of a polygon from its curve: a hundredth of a pixel of a high-resolution camera."""
GAP_MM = 0.02
"""Ends closer than this count as joined; CAD rounds more finely."""
MAX_DRAWING_BYTES = 32 << 20
"""ezdxf takes eleven times as much memory (a file of 100,000 lines); 50,000 lines are 6 MB, 500,000 points
20 MB."""
MAX_MEMORY_BYTES, MAX_CPU_S = 1 << 30, 60.0
"""Limits for reading and flattening: three times the memory and six times the time that reading the largest
allowed file takes."""
MAX_POINTS = 500_000
MAX_ENTITIES = 50_000
"""Includes the entities of blocks, once for each placement."""
MAX_FIT_POINTS, MAX_ALL_FIT_POINTS = 1000, 20_000
"""Fit points of one spline, and of all together. The equations grow with their square: 0.1 s and 23 MiB for
a thousand, 43 s and 3.4 GB for twelve thousand. CAD programs use a few dozen."""
MAX_DEPTH = 8
"""Largest nesting depth of blocks."""
MAX_MEETING = 200
"""Most ends within the tolerance of one point: no outline has lines of a ten-thousandth of a millimetre."""
SHAPES = {"LINE", "ARC", "CIRCLE", "ELLIPSE", "LWPOLYLINE", "POLYLINE", "SPLINE"}
# what the parser raises for damaged files, found by fuzzing
_DAMAGE = (
    DXFError,
    OSError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,
    RecursionError,
)
_BINARY = b"AutoCAD Binary DXF"
_NO_NUMBER = re.compile(
    rb"^[ \t]*(?:[1-5][0-9]|1[1-4][0-9]|2[1-3][0-9]|46[0-9]|10[1-5][0-9])[ \t]*\r?\n"
    rb"(?![ \t]*+[-+]?(?:[0-9]++\.?[0-9]*+|\.[0-9]++)(?:[eE][-+]?[0-9]++)?[ \t]*+\r?$)"
    rb"(?P<value>[^\r\n]*)",
    re.MULTILINE,
)
"""A group code of floating-point values (DXF reference, "Group code value types") followed by a line that is
not a number. Where a value happens to look like such a code, the next line is a code and so a number.
Checked here because ezdxf accepts `1_0` and `nan`."""
UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}


@dataclass(frozen=True, slots=True)
class JoinedPoints:
    """A polyline of points (N, 2) in mm, and whether its last point meets the first."""

    points: FloatArray
    closed: bool


def read_dxf(
    path: Path, layers: Sequence[str] = (), units: str | None = None, most_points: int = MAX_POINTS
) -> list[FloatArray]:
    """Read the closed outlines of a DXF drawing, in mm.

    layers : only these; empty: all that are switched on.  units : key of `UNITS`; None: as the drawing says.
    most_points : limit for all curves together; a drawing is refused as soon as it is known to exceed it,
    before it takes more memory.
    Raises `FileFormatError` for a file that is not a DXF drawing, has no unit, is not flat or closed, or is
    empty.
    """
    path = Path(path)
    data = read_bytes(path, "a drawing", MAX_DRAWING_BYTES)
    wrong = None if data.startswith(_BINARY) else _NO_NUMBER.search(data)
    if wrong is not None:
        line = data.count(b"\n", 0, wrong.start("value")) + 1
        got = wrong["value"].decode("utf-8", "replace")[:40]
        raise FileFormatError(f"{path}: line {line}: expected a number, got {got!r}", "no_dxf")
    try:
        with reading_cost(path, MAX_MEMORY_BYTES, MAX_CPU_S):
            chains = _read_chains(path, layers, units, most_points)
    except _DAMAGE as error:
        raise FileFormatError(f"{path}: not a DXF drawing that can be read: {error}", "no_dxf") from error
    return _outlines(chains, str(path))


def _read_chains(
    path: Path, layers: Sequence[str], units: str | None, most_points: int
) -> list[JoinedPoints]:
    with file_to_read(path) as opened:
        place = f"/proc/self/fd/{opened.fileno()}"  # the path may refer to another file by now
        try:
            document = readfile(place)
        except OSError as error:
            raise OSError(str(error).replace(place, str(path))) from error
    known = sorted(layer.dxf.name for layer in document.layers)
    if missing := [name for name in layers if name not in known]:
        there = ", ".join(map(repr, known))[:500]
        raise FileFormatError(f"{path}: no layer {missing[0]!r}, there are {there}", "layer", there=there)
    scale = _scale(document, path, units)
    _drop_undrawn(document, layers)
    _check_content(_placed_content(document, path), path, most_points)
    chains: list[JoinedPoints] = []
    points = 0
    for entity in _entities(document):
        more = _chains(entity, scale, path, most_points)
        chains += more
        points += sum(len(chain.points) for chain in more)
        if points > most_points:
            raise _too_many(path, most_points, "points")
    return chains


def read_contour(path: Path) -> list[FloatArray]:
    """Read closed outlines from text: one point `x,y` in mm per line, an empty line between outlines.

    Raises `FileFormatError` that names the line.
    """
    path = Path(path)
    outlines: list[list[tuple[float, float]]] = [[]]
    for line in read_table(path, "a contour"):
        if not line.cells:
            if outlines[-1]:
                outlines.append([])
            continue
        try:
            x, y = (number_of(cell) for cell in line.cells)
        except ValueError:
            got = ", ".join(line.cells)[:40]
            raise FileFormatError(f"{path}: line {line.number}: expected x,y in mm, got {got!r}") from None
        outlines[-1].append((x, y))
    chains = [JoinedPoints(np.array(points), True) for points in outlines if points]
    if sum(len(chain.points) for chain in chains) > MAX_POINTS:
        raise FileFormatError(f"{path}: more than {MAX_POINTS} points: not the contour of one part")
    return _outlines(chains, str(path))


def _scale(document: DxfDocument, path: Path, units: str | None) -> float:
    if units is not None:
        if units not in UNITS:
            raise FileFormatError(f"{path}: unit {units!r}: expected one of {', '.join(UNITS)}")
        return UNITS[units]
    if document.units == 0:
        raise FileFormatError(
            f"{path}: the drawing does not say its unit ($INSUNITS is 0); state it ({', '.join(UNITS)})",
            "unit",
        )
    return float(conversion_factor(InsertUnits(document.units), InsertUnits.Millimeters))


@dataclass(frozen=True, slots=True)
class _Content:
    """Counts of drawn content. points : of polylines and splines; fit_points : of splines defined by them."""

    shapes: int = 0
    points: int = 0
    fit_points: int = 0

    def __add__(self, other: _Content) -> _Content:
        return _Content(
            self.shapes + other.shapes, self.points + other.points, self.fit_points + other.fit_points
        )


def _drop_undrawn(document: DxfDocument, layers: Sequence[str]) -> None:
    """Delete every entity that is not a shape on a wanted layer, except block references.

    The content of a block is copied at each placement, so it is filtered, too. Text, dimensions and hatches
    draw no edge.
    """
    hidden = {layer.dxf.name for layer in document.layers if layer.is_off() or layer.is_frozen()}
    for layout in (document.modelspace(), *document.blocks):
        for entity in layout:
            layer = entity.dxf.layer
            is_wanted = layer in layers if layers else layer not in hidden
            if not isinstance(entity, Insert) and not (is_wanted and entity.dxftype() in SHAPES):
                entity.destroy()


def _placed_content(document: DxfDocument, path: Path) -> _Content:
    """Counts of everything that the model space draws, with blocks counted once for each placement."""
    known: dict[str, _Content] = {}

    def of(entities: Iterable[DXFEntity], depth: int) -> _Content:
        if depth > MAX_DEPTH:
            raise FileFormatError(f"{path}: blocks inside blocks, more than {MAX_DEPTH} deep", "large")
        content = _Content()
        for entity in entities:
            content += placed(entity, depth) if isinstance(entity, Insert) else _own_content(entity, path)
        return content

    def placed(insert: Insert, depth: int) -> _Content:
        name = insert.dxf.name
        if name not in known:
            known[name] = of(insert.block() or (), depth + 1)
        return known[name] + _Content(shapes=1)

    return of(document.modelspace(), 0)


def _own_content(entity: DXFEntity, path: Path) -> _Content:
    if isinstance(entity, Spline):
        fit_points = 0 if entity.control_point_count() else entity.fit_point_count()
        if fit_points > MAX_FIT_POINTS:
            raise FileFormatError(
                f"{path}: {entity}: a spline through {fit_points} points: expected at most {MAX_FIT_POINTS}",
                "large",
            )
        return _Content(1, entity.control_point_count() + entity.fit_point_count(), fit_points)
    if isinstance(entity, LWPolyline):
        return _Content(1, len(entity))
    return _Content(1, len(entity.vertices) if isinstance(entity, Polyline) else 0)


def _check_content(content: _Content, path: Path, most_points: int) -> None:
    for count, most, what in (
        (content.shapes, MAX_ENTITIES, "shapes"),
        (content.points, most_points, "points"),
        (content.fit_points, MAX_ALL_FIT_POINTS, "points that splines are drawn through"),
    ):
        if count > most:
            raise _too_many(path, most, what)


def _entities(document: DxfDocument) -> list[DXFGraphic]:
    """Entities of the model space, with blocks resolved."""
    found: list[DXFGraphic] = []
    waiting = deque(document.modelspace())
    while waiting:
        entity = waiting.popleft()
        if isinstance(entity, Insert):
            waiting += entity.virtual_entities()
        else:
            found.append(entity)
    return found


def _too_many(path: Path, most: int, what: str) -> FileFormatError:
    return FileFormatError(f"{path}: more than {most} {what}: not the drawing of one part", "large")


def _chains(entity: DXFGraphic, scale: float, path: Path, most_points: int) -> list[JoinedPoints]:
    chains = []
    for points in _flattened(entity, FLATTENING_MM / scale, most_points):
        if len(points) < 2:
            continue
        if len(points) > most_points:
            raise _too_many(path, most_points, "points")
        points = points * scale
        if not np.isfinite(points).all():
            raise FileFormatError(f"{path}: {entity}: coordinates that are not finite")
        if np.ptp(points[:, 2]) > GAP_MM:
            raise FileFormatError(f"{path}: {entity}: not flat; expected a drawing in the x-y plane", "flat")
        chains.append(_chain(points[:, :2]))
    return chains


def _flattened(entity: DXFGraphic, distance: float, most: int) -> list[FloatArray]:
    """Points (N, 3) of each curve of an entity, each lying exactly on the drawn curve.

    distance : largest deviation of the curve from its chords. most : limit of points; one more is returned
    if there are more.

    ezdxf's paths are Bézier curves, which are 0.03 % too large for arcs: a job's radius would be off by four
    times the measurement error.
    """
    vertices: Iterable[Vec3]
    if isinstance(entity, Circle):  # Arc is a subclass
        radius = abs(entity.dxf.radius)
        if not math.pi * math.sqrt(0.5 * radius / distance) < most:  # ezdxf makes all points at once
            raise FileFormatError(f"{entity}: an arc of more than {most} points", "large")
        vertices = entity.flattening(min(distance, 0.1 * radius))
    elif isinstance(entity, Ellipse | Spline):
        vertices = entity.flattening(distance)
    elif isinstance(entity, LWPolyline):
        corners = np.array(entity.get_points("xyb"), np.float64)
        vertices = _bulged(corners, entity.closed, entity.dxf.elevation, entity.ocs(), distance, most)
    elif isinstance(entity, Polyline) and entity.is_2d_polyline:
        corners = np.array([vertex.format("xyb") for vertex in entity.vertices], np.float64)
        height = Vec3(entity.dxf.elevation).z if entity.dxf.hasattr("elevation") else 0.0
        vertices = _bulged(corners, entity.is_closed, height, entity.ocs(), distance, most)
    else:
        parts = dxfpath.make_path(entity).sub_paths()
        return [_as_points(part.flattening(distance), most) for part in parts]
    return [_as_points(vertices, most)]


def _as_points(vertices: Iterable[Vec3], most: int) -> FloatArray:
    return np.array([tuple(vertex) for vertex in islice(vertices, most + 1)], np.float64).reshape(-1, 3)


def _bulged(
    corners: FloatArray, closed: bool, height: float, ocs: OCS, distance: float, most: int
) -> Iterable[Vec3]:
    """Vertices of a polyline. corners (N, 3) : x, y, bulge (tangent of a quarter of the arc to the next)."""
    following = np.roll(corners, -1, axis=0)
    sides = len(corners) if closed else len(corners) - 1
    places, drawn = [corners[:1, :2]], 0
    for (x, y, bulge), (x2, y2, _) in zip(corners[:sides], following[:sides], strict=True):
        start, end = np.array([x, y]), np.array([x2, y2])
        chord = end - start
        length = float(np.linalg.norm(chord))
        if bulge == 0 or length == 0:
            places.append(end[None])
            continue
        aside = np.array([-chord[1], chord[0]])
        centre = 0.5 * (start + end) + aside * (1 - bulge**2) / (4 * bulge)
        radius, turn = length * (1 + bulge**2) / (4 * abs(bulge)), 4 * math.atan(bulge)
        step = 2 * math.acos(1 - min(distance / radius, 0.1))
        count = math.ceil(abs(turn) / step)
        drawn += count
        if drawn > most:
            raise FileFormatError(f"an arc of more than {most} points", "large")
        angles = turn * np.arange(1, count) / count
        out = start - centre
        cosine, sine = np.cos(angles)[:, None], np.sin(angles)[:, None]
        places += [centre + cosine * out + sine * np.array([-out[1], out[0]]), end[None]]
    return ocs.points_to_wcs(Vec3(x, y, height) for x, y in np.concatenate(places))


def _chain(points: FloatArray) -> JoinedPoints:
    """Make a chain, dropping points that repeat their predecessor."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    kept = points[np.concatenate([[True], steps > 1e-9])]
    closed = len(kept) > 3 and float(np.linalg.norm(kept[0] - kept[-1])) < GAP_MM
    return JoinedPoints(kept[:-1] if closed else kept, closed)


def _outlines(chains: Sequence[JoinedPoints], place: str) -> list[FloatArray]:
    """Join open chains end to end. Raises `FileFormatError` if one stays open or there is no outline."""
    outlines = [chain.points for chain in chains if chain.closed and len(chain.points) >= 3]
    outlines += _joined(
        [chain.points for chain in chains if not chain.closed and len(chain.points) >= 2], place
    )
    outlines = [outline for outline in outlines if abs(area(outline)) > GAP_MM**2]
    if not outlines:
        expected = "expected lines, arcs, circles or polylines"
        raise FileFormatError(f"{place}: no closed outline in it; {expected}", "empty")
    return outlines


def _joined(lines: Sequence[FloatArray], place: str) -> list[FloatArray]:
    """Join lines (N, 2) that meet end to end, in any order and direction, into outlines.

    ezdxf finds nearby ends; which of them continues the chain is decided here. Its own chaining stops where
    more than two ends are within the tolerance, as with lines shorter than it or outlines that nearly touch,
    and loops for ever where two ends are near a third but not near each other.
    """
    edges = [make_edge(points[0], points[-1], payload=points) for points in lines]
    if not edges:
        return []
    ends = Deposit(edges, gap_tol=GAP_MM)
    used: set[Edge] = set()
    outlines = []
    for first in edges:
        if first in used:
            continue
        chain = [first]
        used.add(first)
        while (following := _next(chain, used, ends)) is not first:
            if following is None:
                raise _open_outline_error(place, chain, ends)
            chain.append(following)
            used.add(following)
        points = [edge.payload[::-1] if edge.is_reverse else edge.payload for edge in chain]
        outlines.append(np.concatenate([points[0], *(more[1:] for more in points[1:])])[:-1])
    return outlines


def _next(chain: Sequence[Edge], used: Set[Edge], ends: Deposit) -> Edge | None:
    """Nearest line that continues a chain at its end; the chain's first line if that closes it."""
    end = chain[-1].end
    linked = ends.edges_linked_to(end)
    if len(linked) > MAX_MEETING:
        return None
    near = [way for edge in linked if edge not in used for way in (edge, edge.reversed())]
    if sum(len(edge.payload) - 1 for edge in chain[:3]) >= 3:  # two segments, there and back, enclose nothing
        near.append(chain[0])
    return min(
        (edge for edge in near if edge.start.distance(end) < GAP_MM),
        key=lambda edge: (edge.start.distance(end), edge not in used, edge.id, edge.is_reverse),
        default=None,
    )


def _open_outline_error(place: str, chain: Sequence[Edge], ends: Deposit) -> FileFormatError:
    """Error that says why a chain does not close: a loose end, or a point where more than two edges meet."""
    hint = "expected closed outlines (leave out construction lines by choosing layers)"
    last, first = chain[-1].end, chain[0].start
    for end in (last, first):
        if len(set(ends.edges_linked_to(end))) == 1:
            why = f"an outline is open: nothing goes on at ({end.x:.3f}, {end.y:.3f}) mm; {hint}"
            return FileFormatError(f"{place}: {why}", "open", x=f"{end.x:.3f}", y=f"{end.y:.3f}")
    where = f"({last.x:.3f}, {last.y:.3f}) mm, where {ends.degree(last)} ends meet"
    why = f"no outline closes at {where}: a branch or a line drawn twice; {hint}"
    return FileFormatError(f"{place}: {why}", "branch", x=f"{last.x:.3f}", y=f"{last.y:.3f}")


def area(outline: FloatArray) -> float:
    """Signed area of a polygon (N, 2), mm²; positive when it turns from x to y."""
    x, y = outline.T
    return float(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)))
