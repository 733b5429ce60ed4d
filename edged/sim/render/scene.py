"""Scene descriptions and their rendering: flat parts on a flat table, seen by calibrated cameras.

Imaging is modelled physically: radiance of the planes is averaged over each pixel's area, blurred
by the lens, collected as electrons with shot and read noise, and rounded to 8 bits. Outlines are
accurate to 0.003 px; textures are fixed to their surfaces, so that both views of a stereo pair
agree. Not modelled: height of edges, shadows, highlights.

Lengths in mm. A part's frame has z away from the cameras, x and y in its face; a
`rig_from_part` is (4, 4). The renderer has its own projection on purpose: see `edged.sim.render.lens`.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field
from statistics import NormalDist

import cv2
import numpy as np

from edged.domain.arrays import F32, FloatArray, Image
from edged.sim.render import raster
from edged.sim.render.lens import project, rays_of_pixels
from edged.vision.geometry.camera import CameraModel

# --- outlines ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Disc:
    """A circle."""

    x_mm: float
    y_mm: float
    radius_mm: float


@dataclass(frozen=True, slots=True)
class RoundedBox:
    """A rectangle with rounded corners, turned by `angle_rad` from x to y."""

    x_mm: float
    y_mm: float
    width_mm: float
    height_mm: float
    corner_mm: float = 0.0
    angle_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Slot:
    """A slot of overall length `length_mm`: two half circles joined by straight edges."""

    x_mm: float
    y_mm: float
    length_mm: float
    width_mm: float
    angle_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class PolygonShape:
    """A closed polygon without self-intersections."""

    points_mm: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Checker:
    """The dark squares of a chessboard; (x, y) is the outer corner of the first square."""

    x_mm: float
    y_mm: float
    square_mm: float
    columns: int
    rows: int


@dataclass(frozen=True, slots=True)
class DiscGrid:
    """Equal discs in rows and columns; (x, y) is the centre of the first."""

    x_mm: float
    y_mm: float
    radius_mm: float
    pitch_mm: float
    columns: int
    rows: int


Shape = Disc | RoundedBox | Slot | PolygonShape | Checker | DiscGrid


def extent_mm(shape: Shape) -> float:
    """Radius of a circle around the frame's origin that contains the shape."""
    match shape:
        case Disc():
            return math.hypot(shape.x_mm, shape.y_mm) + shape.radius_mm
        case RoundedBox():
            return math.hypot(shape.x_mm, shape.y_mm) + 0.5 * math.hypot(shape.width_mm, shape.height_mm)
        case Slot():
            return math.hypot(shape.x_mm, shape.y_mm) + 0.5 * max(shape.length_mm, shape.width_mm)
        case PolygonShape():
            return max(math.hypot(x, y) for x, y in shape.points_mm)
        case Checker():
            last = (shape.x_mm + shape.columns * shape.square_mm, shape.y_mm + shape.rows * shape.square_mm)
            margin = 0.0
        case DiscGrid():
            width_mm, height_mm = (shape.columns - 1) * shape.pitch_mm, (shape.rows - 1) * shape.pitch_mm
            last = (shape.x_mm + width_mm, shape.y_mm + height_mm)
            margin = shape.radius_mm
    return margin + max(math.hypot(x, y) for x in (shape.x_mm, last[0]) for y in (shape.y_mm, last[1]))


# --- things --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Surface:
    """Appearance of a face.

    albedo : radiance under light of level 1. contrast : standard deviation of the texture relative to
    albedo. feature_mm : shortest strong wavelength of the texture. stretch : its elongation along the lay
    (brushed metal). seed : selects the texture. lay_rad : direction of a straight lay, from x to y.
    around_mm : centre of a lay in arcs instead (turned, milled); the elongation is `stretch` at a radius
    ARCS_MM larger than the distance of the origin, and grows with the radius.
    """

    albedo: float
    contrast: float = 0.0
    feature_mm: float = 0.8
    stretch: float = 1.0
    seed: int = 0
    lay_rad: float = 0.0
    around_mm: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Hole:
    """An opening that shows what is behind the part, with its radiance multiplied by `transmission`."""

    name: str
    shape: Shape
    transmission: float = 0.2


@dataclass(frozen=True, slots=True)
class PaintedMark:
    """Paint on the face."""

    shape: Shape
    albedo: float


@dataclass(frozen=True, slots=True)
class Part:
    """A flat workpiece, painted in the order outline, marks, holes; all must be within the outline."""

    name: str
    outline: Shape
    surface: Surface
    holes: tuple[Hole, ...] = ()
    marks: tuple[PaintedMark, ...] = ()

    @property
    def circles(self) -> tuple[tuple[str, Disc], ...]:
        """Those of its outline, as "outer", and its holes that are circles."""
        named = (("outer", self.outline), *((hole.name, hole.shape) for hole in self.holes))
        return tuple((name, shape) for name, shape in named if isinstance(shape, Disc))


@dataclass(frozen=True, slots=True, eq=False)
class PlacedPart:
    """A part and its pose."""

    part: Part
    rig_from_part: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The infinite plane below the parts, z = 0 of its frame."""

    surface: Surface
    rig_from_table: FloatArray


@dataclass(frozen=True, slots=True)
class SceneLight:
    """Irradiance level (1 + gradient · (X, Y)), with X and Y in the rig frame."""

    level: float = 1.0
    gradient_per_mm: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Table, parts (from lowest to topmost) and light."""

    table: Table
    parts: tuple[PlacedPart, ...] = ()
    light: SceneLight = field(default_factory=SceneLight)


@dataclass(frozen=True, slots=True)
class Sensor:
    """Lens blur and a grey 8-bit sensor.

    psf_sigma_px : sigma of the Gaussian blur, in addition to the pixel's area. full_well_e : electrons at
    grey 255 without gain. white : grey value of radiance 1 after nominal_exposure_us without gain.
    """

    psf_sigma_px: float = 0.6
    full_well_e: float = 12_000.0
    read_noise_e: float = 12.0
    black: float = 3.0
    white: float = 220.0
    nominal_exposure_us: float = 2_000.0


# --- pictures ------------------------------------------------------------------------------------


class RenderedView:
    """Renderer of one camera at a fixed pose; stores the ray of every pixel for speed.

    It also caches the radiance of the last scene: for an unchanged scene only the noise is computed.
    camera_from_rig : (4, 4). Thread-safe.
    Raises ValueError if the lens has no unique ray for a pixel.
    """

    def __init__(
        self, camera: CameraModel, camera_from_rig: FloatArray, sensor: Sensor | None = None
    ) -> None:
        self.camera = camera
        self.camera_from_rig = np.array(camera_from_rig, dtype=np.float64)
        self.sensor = sensor or Sensor()
        self._spread = _spread(self.sensor.psf_sigma_px)
        # a margin as wide as the blur, whose light reaches pixels at the border
        self._margin = self._spread.shape[1] // 2
        self._rays = _rays(camera, self._margin)
        self._seen: tuple[tuple[bytes, ...], F32] = (), np.empty((0, 0), np.float32)

    def project(self, points_mm: FloatArray) -> FloatArray:
        """Pixels (..., 2) of points (..., 3) in the rig frame."""
        return project(self.camera, self.camera_from_rig, np.asarray(points_mm, dtype=np.float64))

    def radiance(self, scene: Scene) -> F32:
        """Radiance (H, W) on the sensor, averaged over pixels and blurred, without noise; read-only."""
        radiance = self._radiance(scene).view()
        radiance.flags.writeable = False
        return radiance

    def _radiance(self, scene: Scene) -> F32:
        layers, shapes, vertices, seeds = _pack(scene, self.camera_from_rig)
        what = layers.tobytes(), shapes.tobytes(), vertices.tobytes(), repr(seeds).encode()
        seen, radiance = self._seen  # a single read: another thread may replace it meanwhile
        if seen != what:
            radiance = self._rendered(layers, shapes, vertices, _textures(seeds).ravel())
            self._seen = what, radiance
        return radiance

    def _rendered(self, layers: FloatArray, shapes: FloatArray, vertices: FloatArray, textures: F32) -> F32:
        raw, detail = np.empty(self._rays.shape[:2], np.float32), np.zeros(self._rays.shape[:2], np.float32)
        raster.render_radiance(self._rays, layers, shapes, vertices, textures, self._spread, raw, detail)
        margin = self._margin
        if not margin:
            return raw
        of_pixels, border = self._spread.sum(axis=0), cv2.BORDER_REPLICATE
        at_edges = cv2.sepFilter2D(raw, cv2.CV_32F, of_pixels, of_pixels, borderType=border) + detail
        size, sigma_px = 2 * margin + 1, self.sensor.psf_sigma_px
        cv2.GaussianBlur(raw, (size, size), sigma_px, dst=raw, borderType=border)
        # away from edges use the Gaussian blur: texture was sampled, not averaged over pixels
        seen = np.where(detail != 0.0, at_edges, raw)
        return np.ascontiguousarray(seen[margin:-margin, margin:-margin])

    def render(
        self,
        scene: Scene,
        rng: np.random.Generator | None = None,
        exposure_us: float | None = None,
        gain_db: float = 0.0,
    ) -> Image:
        """Render a picture (H, W) uint8. rng : source of the noise; None for no noise.

        exposure_us : exposure time; None for the nominal one.
        """
        sensor = self.sensor
        radiance = self._radiance(scene)
        if rng is None:
            chance, quantiles = np.zeros(radiance.shape, np.uint16), np.zeros(65536, np.float32)
        else:
            chance, quantiles = rng.integers(0, 65536, radiance.shape, np.uint16), _normal_quantiles()
        image = np.empty(radiance.shape, np.uint8)
        ratio = 1.0 if exposure_us is None else exposure_us / sensor.nominal_exposure_us
        raster.expose(
            radiance,
            chance,
            quantiles,
            sensor.white / 255.0 * sensor.full_well_e * ratio,
            sensor.read_noise_e,
            255.0 / sensor.full_well_e * 10.0 ** (gain_db / 20.0),
            sensor.black,
            image,
        )
        return image


@functools.lru_cache(maxsize=2)
def _rays(camera: CameraModel, margin: int) -> FloatArray:
    """Rays (H, W, 2) of all pixels and a margin around; 20 MB, cached for the two cameras of a rig."""
    y, x = np.mgrid[-margin : camera.height + margin, -margin : camera.width + margin]
    return np.ascontiguousarray(rays_of_pixels(camera, np.stack([x, y], axis=-1).astype(np.float64)))


@functools.lru_cache(maxsize=16)
def _spread(psf_sigma_px: float) -> FloatArray:
    """Contribution (CELLS, 2 R + 1) of each cell of a pixel to the pixels around, along rows or columns.

    A Gaussian about the cell's centre, averaged over the receiving pixel. (CELLS, 0) without blur.
    """
    if psf_sigma_px <= 0.0:
        return np.empty((raster.CELLS, 0))
    reach = math.ceil(4.0 * psf_sigma_px) + 1
    centres = (np.arange(raster.CELLS) + 0.5) / raster.CELLS - 0.5
    borders = np.arange(-reach, reach + 2) - 0.5
    # cells already hold means over their width: the variance of that is subtracted
    normal = NormalDist(sigma=math.sqrt(max(psf_sigma_px**2 - raster.CELLS**-2 / 12, 1e-6)))
    spread = np.diff([[normal.cdf(border - centre) for border in borders] for centre in centres])
    return np.asarray(spread / spread.sum())


@functools.cache
def _normal_quantiles() -> F32:
    """65536 equally likely values of a standard normal; selecting one by 16 random bits is five times
    faster than drawing from the distribution."""
    normal = NormalDist()
    return np.array([normal.inv_cdf((k + 0.5) / 65536) for k in range(65536)], np.float32)


def _pack(
    scene: Scene, camera_from_rig: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, tuple[int, ...]]:
    """Convert the scene to the flat arrays of `raster.render_radiance`, and the seeds of its textures."""
    planes = [(scene.table.rig_from_table, scene.table.surface, [_row(None, scene.table.surface, [])])]
    vertices: list[tuple[float, float]] = []
    for placed in scene.parts:
        part = placed.part
        rows = [_row(part.outline, part.surface, vertices)]
        rows += [_row(mark.shape, Surface(mark.albedo), vertices) for mark in part.marks]
        rows += [_row(hole.shape, Surface(0.0), vertices, hole.transmission) for hole in part.holes]
        planes.append((placed.rig_from_part, part.surface, rows))
    seeds = tuple(sorted({surface.seed for _, surface, _ in planes}))
    layers = np.zeros((len(planes), raster.LAYER_COLUMNS))
    first = 0
    for layer, (rig_from_plane, surface, rows) in zip(layers, planes, strict=True):
        camera_from_plane = camera_from_rig @ rig_from_plane
        homography = np.linalg.inv(camera_from_plane[:3, [0, 1, 3]])
        layer[raster.HOMOGRAPHY : raster.HOMOGRAPHY + 9] = homography.ravel()
        gradient = np.array(scene.light.gradient_per_mm)
        layer[raster.IRRADIANCE] = scene.light.level * (1.0 + gradient @ rig_from_plane[:2, 3])
        slope = scene.light.level * (gradient @ rig_from_plane[:2, :2])
        layer[raster.IRRADIANCE + 1 : raster.IRRADIANCE + 3] = slope
        texels_per_mm = TEXELS_PER_FEATURE / surface.feature_mm
        layer[raster.TEXTURE] = seeds.index(surface.seed)
        layer[raster.TEXELS_U], layer[raster.TEXELS_V] = texels_per_mm / surface.stretch, texels_per_mm
        layer[raster.LAY_COS : raster.LAY_RADIUS + 1] = _lay(surface)
        layer[raster.FIRST], layer[raster.END] = first, first + len(rows)
        first += len(rows)
    shapes = np.array([row for _, _, rows in planes for row in rows], dtype=np.float64)
    return layers, shapes, np.array(vertices, dtype=np.float64).reshape(-1, 2), seeds


def _lay(surface: Surface) -> tuple[float, float, float, float, float]:
    """Lay of a surface's texture as the values of a layer's columns."""
    if surface.around_mm is None:
        return math.cos(surface.lay_rad), math.sin(surface.lay_rad), 0.0, 0.0, 0.0
    x_mm, y_mm = surface.around_mm
    away_mm = math.hypot(x_mm, y_mm)
    # arcs are mirrored at a line through their centre, which is perpendicular to the direction of the origin
    across_rad = math.atan2(y_mm, x_mm) + 0.5 * math.pi
    return math.cos(across_rad), math.sin(across_rad), x_mm, y_mm, ARCS_MM + away_mm


def _row(
    shape: Shape | None, surface: Surface, vertices: list[tuple[float, float]], transmission: float = 0.0
) -> list[float]:
    """Convert a shape to a row; points of a polygon are appended to `vertices`. None: the whole plane."""
    angle_rad = 0.0
    match shape:
        case None:
            geometry = [raster.PLANE, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        case Disc():
            geometry = [raster.DISC, shape.x_mm, shape.y_mm, shape.radius_mm, 0.0, 0.0, 0.0]
        case RoundedBox():
            half = (0.5 * shape.width_mm, 0.5 * shape.height_mm)
            geometry = [raster.BOX, shape.x_mm, shape.y_mm, *half, shape.corner_mm, 0.0]
            angle_rad = shape.angle_rad
        case Slot():
            half = (0.5 * shape.length_mm, 0.5 * shape.width_mm)
            geometry = [raster.BOX, shape.x_mm, shape.y_mm, *half, min(half), 0.0]
            angle_rad = shape.angle_rad
        case PolygonShape():
            geometry = [raster.POLYGON, 0.0, 0.0, len(vertices), len(shape.points_mm), 0.0, 0.0]
            vertices.extend(shape.points_mm)
        case Checker():
            grid = (shape.square_mm, shape.columns, shape.rows)
            geometry = [raster.CHECKER, shape.x_mm, shape.y_mm, *grid, 0.0]
        case DiscGrid():
            grid = (shape.pitch_mm, shape.columns, shape.rows)
            geometry = [raster.DOTS, shape.x_mm, shape.y_mm, shape.radius_mm, *grid]
    kind, x_mm, y_mm, *parameters = geometry
    direction = (math.cos(angle_rad), math.sin(angle_rad))
    paint = (surface.albedo, surface.contrast, transmission)
    return [float(value) for value in (kind, x_mm, y_mm, *direction, *parameters, *paint)]


ARCS_MM = 10.0
"""See `Surface`."""
TEXELS_PER_FEATURE = 8.0
"""Texels per `feature_mm`; the shortest wavelength has half as many."""


@functools.lru_cache(maxsize=4)
def _textures(seeds: tuple[int, ...]) -> F32:
    """Periodic pink noise (T, N, N) of mean 0 and deviation 1, with no wave shorter than half a feature."""
    n = raster.TEXTURE_SIZE
    frequency = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None, :]) * TEXELS_PER_FEATURE
    with np.errstate(divide="ignore"):
        octaves = np.log2(frequency)
    # equal power in each octave from 8 features down to half a feature, faded out at both ends
    inside = np.clip(np.minimum(octaves + 4.0, 1.0 - octaves), 0.0, 1.0)
    band = np.where(inside > 0.0, np.sin(0.5 * np.pi * inside) ** 2 / np.maximum(frequency, 1e-9), 0.0)
    tiles = np.empty((len(seeds), n, n), np.float32)
    for tile, seed in zip(tiles, seeds, strict=True):
        white = np.random.default_rng(seed).standard_normal((n, n))
        noise = np.fft.irfft2(np.fft.rfft2(white) * band, s=(n, n))
        tile[:] = noise / noise.std()
    return tiles


# --- calibration plates ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Plate:
    """A calibration plate and its control points (N, 3) in the part frame, row by row."""

    part: Part
    points_mm: FloatArray


PLATE_WHITE, PLATE_BLACK = 0.82, 0.06


def chessboard_plate(columns: int, rows: int, square_mm: float) -> Plate:
    """A chessboard with columns x rows inner corners; the frame's origin is the first corner."""
    field_mm = ((columns + 1) * square_mm, (rows + 1) * square_mm)
    centre_mm = (0.5 * (columns - 1) * square_mm, 0.5 * (rows - 1) * square_mm)
    outline = RoundedBox(*centre_mm, field_mm[0] + square_mm, field_mm[1] + square_mm)
    squares = Checker(-square_mm, -square_mm, square_mm, columns + 1, rows + 1)
    part = Part("chessboard", outline, Surface(PLATE_WHITE), marks=(PaintedMark(squares, PLATE_BLACK),))
    return Plate(part, _grid_points(columns, rows, square_mm, (0.0, 0.0)))


def dots_plate(columns: int, rows: int, pitch_mm: float) -> Plate:
    """A plate of columns x rows dots, half a pitch in diameter, in a black frame with one filled corner.

    The frame's origin is the centre of the plate; the filled corner is beside the first dot.
    """
    origin_mm = (-0.5 * (columns - 1) * pitch_mm, -0.5 * (rows - 1) * pitch_mm)

    def rim(margin: float) -> RoundedBox:
        return RoundedBox(0.0, 0.0, (columns - 1 + 2 * margin) * pitch_mm, (rows - 1 + 2 * margin) * pitch_mm)

    inner = rim(0.7)
    x, y, leg = -0.5 * inner.width_mm, -0.5 * inner.height_mm, 0.5 * pitch_mm
    marks = (
        PaintedMark(rim(0.95), PLATE_BLACK),
        PaintedMark(inner, PLATE_WHITE),
        PaintedMark(PolygonShape(((x, y), (x + leg, y), (x, y + leg))), PLATE_BLACK),
        PaintedMark(DiscGrid(*origin_mm, 0.25 * pitch_mm, pitch_mm, columns, rows), PLATE_BLACK),
    )
    part = Part("dots", rim(1.1), Surface(PLATE_WHITE), marks=marks)
    return Plate(part, _grid_points(columns, rows, pitch_mm, origin_mm))


def _grid_points(columns: int, rows: int, pitch_mm: float, origin_mm: tuple[float, float]) -> FloatArray:
    y, x = np.mgrid[0:rows, 0:columns]
    flat = np.stack([x.ravel(), y.ravel(), np.zeros(columns * rows)], axis=-1)
    return np.asarray(flat * pitch_mm + (*origin_mm, 0.0))
