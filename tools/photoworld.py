#!/usr/bin/env python3
"""Render stereo pairs of random machined parts by path tracing, with exact truth: a set as data/rendered.

    tools/photoworld.py FOLDER [--designs N] [--scenes N] [--decoys N] [--held-out] [--first N] [--seed N]
        [--samples N]

The parts are those of `solids`, as in `solidworld`; light, metal and plastic are Mitsuba's (the extra
`photoworld`, and LLVM's library of the distribution). Faces are turned, ground, milled, blasted, cast or
moulded: their marks are slopes of the surface, which glint as they do on metal. Lights are those of cells: a
ring, a dome with a port for each camera, one bar or two, a low band, and sometimes a window that is reflected
in the face towards one camera. `spec` of each scene says what is drawn. A pair takes minutes: run it in the
background with `nice`; an interrupted run continues where it was.

The part's window is sampled SAMPLES times in each of 16 strata of a pixel. The table beyond is sampled more
coarsely, smoothed, and blended into it. Blur is the same at all depths; samples far brighter than white are
clamped.
"""

from __future__ import annotations

import functools
import math
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from solids import Design, Mesh, meshed
from solidworld import COLUMNS, WHITE, exposed, lying, set_parser, world_rig, write_asked

from edged.domain.arrays import FloatArray, Image
from edged.sim.render.lens import project, rays_of_pixels
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import apply, invert, unit

FINISHES = ("turned", "ground", "milled", "blasted", "cast", "plastic")
LIGHTS = ("ring", "dome", "bar", "bars", "low")
TABLES = ("dark", "plastic", "wood", "steel", "paper")
TEXELS, SHEET_MM, TABLE_MM = 2048, 48.0, 220.0
"""Textures of faces and tables: texels per side, and the side in mm."""
BATCH = 1 << 20
SEAM_PX, TABLE_BLUR_PX = 20, 1.5
BOUNCES = 4
BRIGHTEST = 6.0
"""Samples are clamped at this multiple of white: a rare bright sample would outshine its neighbours."""
DOME_MM, PORT_RAD = 130.0, 0.24
FACE_POINTS, FACE_SHARE = 4000, 0.7
"""The exposure gives this quantile of points on the faces, over both cameras, the wanted grey."""
NOT_WHITE, MOST_OVER = 0.95, 0.9
"""This share of the part's window is at most 1 / MOST_OVER of white: faces are dark in a dark field."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Appearance of a scene, except the part's shape; lengths mm, angles rad.

    pitch_mm : from mark to mark on the faces.  slope : of the marks' flanks.  roughness : of faces, walls and
    broken edges.  reflects : of the face; of a plastic one its diffuse part.  ambient : the room's share of
    the light on a level face.  window : camera, 0 or 1, that sees a bright window in the part's face; -1 for
    none.  gap_mm : from the part down to the table; parallel: the table is parallel to the part.  exposure :
    grey value of 255 that the brighter parts of the faces get, unless too much else were white.
    """

    finish: str
    pitch_mm: float
    slope: float
    lay_rad: float
    roughness: tuple[float, float, float]
    reflects: float
    light: str
    azimuth_rad: float
    height_mm: float
    ambient: float
    window: int
    table: str
    gap_mm: float
    parallel: bool
    exposure: float
    blur_px: float
    seed: int

    @classmethod
    def drawn(cls, finish: str, rng: np.random.Generator, *, teaching: bool = False) -> Setting:
        """Random setting, except for the finish of the faces, which belongs to the design.

        teaching : no window, and no table brighter than the part, as when a person teaches with care.
        """
        drawn = cls(
            finish, pitch_mm=rng.uniform(0.12, 0.32), slope=rng.uniform(0.03, 0.12),
            lay_rad=rng.uniform(0, math.tau),
            roughness=tuple(rng.uniform((0.8, 0.12, 0.1), (1.2, 0.4, 0.3)) * (ROUGHNESS[finish], 1, 1)),
            reflects=rng.uniform(0.05, 0.6) if finish == "plastic" else rng.uniform(0.5, 0.9),
            light=str(rng.choice(LIGHTS)), azimuth_rad=rng.uniform(0, math.tau),
            height_mm=rng.uniform(90, 140), ambient=rng.uniform(0.05, 0.15),
            window=int(rng.choice([-1, -1, -1, 0, 1])), table=str(rng.choice(TABLES)),
            gap_mm=float(rng.choice([0.02, rng.uniform(2, 12)])), parallel=bool(rng.random() < 0.5),
            exposure=rng.uniform(90, 210), blur_px=rng.uniform(0.5, 0.75), seed=int(rng.integers(1 << 30)),
        )  # fmt: skip
        if not teaching:
            return drawn
        tables = {"paper": "wood", "steel": "plastic"}
        return replace(drawn, window=-1, table=tables.get(drawn.table, drawn.table))


ROUGHNESS = {"turned": 0.14, "ground": 0.16, "milled": 0.15, "blasted": 0.35, "cast": 0.45, "plastic": 0.17}


@functools.cache
def mitsuba() -> Any:
    """The renderer, grey, on one thread; imported on demand, because it is an extra."""
    import drjit
    import mitsuba as imported

    imported.set_variant("llvm_ad_mono")
    drjit.set_thread_count(1)
    return imported


# --- shapes ----------------------------------------------------------------------------------------


def write_ply(path: Path, corners: FloatArray, places: FloatArray | None = None) -> str:
    """Write triangles (M, 3, 3) as a binary PLY file, with places (M, 3, 2) on a texture; return its name."""
    columns = corners.reshape(-1, 3)
    names = ["x", "y", "z"]
    if places is not None:
        columns, names = np.hstack([columns, places.reshape(-1, 2)]), [*names, "s", "t"]
    faces = np.zeros(len(corners), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, np.arange(3 * len(corners)).reshape(-1, 3)
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(columns)}",
            *(f"property float {name}" for name in names), f"element face {len(corners)}",
            "property list uchar int vertex_index", "end_header", ""]  # fmt: skip
    path.write_bytes("\n".join(head).encode() + columns.astype("<f4").tobytes() + faces.tobytes())
    return str(path)


def panel(centre: FloatArray, towards: FloatArray, width: float, height: float) -> FloatArray:
    """A rectangle (2, 3, 3) at a place (3,) that faces another place."""
    facing = unit(towards - centre)
    aside = unit(np.cross([0.0, 0.0, 1.0] if abs(facing[2]) < 0.9 else [0.0, 1.0, 0.0], facing))
    x, y = 0.5 * width * aside, 0.5 * height * np.cross(facing, aside)
    a, b, c, d = (centre + i * x + j * y for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    return np.array([[a, b, c], [a, c, d]])


def ring_of_panels(
    radius: float, up_mm: float, width: float, height: float, towards: FloatArray
) -> FloatArray:
    """24 panels on a circle about the z axis, up_mm above z = 0 (at negative z)."""
    turns = math.tau * np.arange(24) / 24
    places = [np.array([radius * math.cos(t), radius * math.sin(t), -up_mm]) for t in turns.tolist()]
    return np.concatenate([panel(place, towards, width, height) for place in places])


def dome(ports: list[FloatArray]) -> FloatArray:
    """A hemisphere (M, 3, 3) above z = 0 seen from within, with holes around unit directions (3,)."""
    lean, turn = np.meshgrid(np.linspace(0, 0.47 * math.pi, 61), np.linspace(0, math.tau, 145), indexing="ij")
    points = DOME_MM * np.stack(
        [np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), -np.cos(lean)], axis=-1
    )
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    corners = np.concatenate([np.stack(one, axis=-2).reshape(-1, 3, 3) for one in ((a, c, b), (a, d, c))])
    middles = unit_rows(corners.mean(axis=1))
    open_to = np.array([np.arccos(np.clip(middles @ port, -1, 1)) < PORT_RAD for port in ports]).any(axis=0)
    inward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    wrong = np.einsum("ij,ij->i", inward, middles) > 0
    corners[wrong] = corners[wrong][:, ::-1]
    return np.asarray(corners[~open_to])


def unit_rows(vectors: FloatArray) -> FloatArray:
    """Rows (N, 3) scaled to length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def lamps(setting: Setting, eyes: list[FloatArray]) -> FloatArray:
    """Luminous triangles (M, 3, 3), in a frame whose z = 0 is about the part's face, z down.

    eyes : both cameras (3,) in that frame.
    """
    middle, azimuth = np.zeros(3), setting.azimuth_rad
    if setting.light == "ring":
        return ring_of_panels(0.75 * setting.height_mm, 175.0, 12.0, 12.0, middle)
    if setting.light == "dome":
        return dome([unit(eye) for eye in eyes])
    if setting.light == "low":
        return ring_of_panels(75.0, 0.2 * setting.height_mm, 20.0, 10.0, middle)
    sides = (azimuth, azimuth + math.pi) if setting.light == "bars" else (azimuth,)
    places = [np.array([95 * math.cos(t), 95 * math.sin(t), -setting.height_mm]) for t in sides]
    return np.concatenate([panel(place, middle, 110.0, 16.0) for place in places])


def irradiance(triangles: FloatArray) -> float:
    """Irradiance on a level patch at the origin facing up, from triangles (M, 3, 3) of radiance 1."""
    middles = triangles.mean(axis=1)
    normals = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    distance = np.linalg.norm(middles, axis=1)
    leaving = np.maximum(-np.einsum("ij,ij->i", normals, middles) / distance, 0)
    arriving = np.maximum(-middles[:, 2] / distance, 0)
    return float((leaving * arriving / distance**2).sum())


# --- surfaces --------------------------------------------------------------------------------------


@functools.lru_cache(maxsize=4)
def marks(finish: str, pitch_mm: float, slope: float, lay_rad: float, seed: int) -> FloatArray:
    """Heights (TEXELS, TEXELS) in mm of a face of SHEET_MM, the part's origin in its middle."""
    rng = np.random.default_rng((30, seed))
    step = SHEET_MM / TEXELS
    y, x = (np.mgrid[0:TEXELS, 0:TEXELS] - 0.5 * (TEXELS - 1)) * step
    rough = band(rng, 0.15, 0.6, step) * 0.15 * slope * 0.1
    amplitude = slope * pitch_mm / math.tau
    if finish in ("turned", "milled"):
        centre = (0.0, 0.0) if finish == "turned" else 60 * np.array([math.cos(lay_rad), math.sin(lay_rad)])
        away = np.hypot(x - centre[0], y - centre[1])
        drift = 0.2 * pitch_mm * band(rng, 3.0, 12.0, step)
        return np.asarray(amplitude * np.cos(math.tau * (away + drift) / pitch_mm) + rough)
    if finish == "ground":
        across = -math.sin(lay_rad) * x + math.cos(lay_rad) * y
        along = math.cos(lay_rad) * x + math.sin(lay_rad) * y
        lines = band(rng, 0.06, 0.5, step)
        where = [((one / step) % TEXELS).astype(np.float32) for one in (across, along / 40)]
        scratches = cv2.remap(lines.astype(np.float32), *where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        return np.asarray(amplitude * 0.5 * scratches + rough)
    grain_mm = {"blasted": (0.08, 0.3), "cast": (0.25, 1.2), "plastic": (0.5, 3.0)}[finish]
    strength = {"blasted": 0.6, "cast": 0.8, "plastic": 0.15}[finish]
    return np.asarray(strength * slope * grain_mm[0] / 2 * band(rng, *grain_mm, step))


def band(rng: np.random.Generator, finest_mm: float, coarsest_mm: float, step_mm: float) -> FloatArray:
    """Periodic noise (TEXELS, TEXELS) of deviation 1 with wavelengths between two limits."""
    f = np.hypot(np.fft.fftfreq(TEXELS)[:, None], np.fft.rfftfreq(TEXELS)[None]) / step_mm
    passed = np.where((f > 1 / coarsest_mm) & (f < 1 / finest_mm), 1 / np.maximum(f, 1e-9), 0)
    noise = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((TEXELS, TEXELS))) * passed, s=(TEXELS, TEXELS))
    return np.asarray(noise / noise.std())


def bitmap(values: FloatArray) -> dict[str, Any]:
    """A texture of one channel, with values unchanged."""
    return {"type": "bitmap", "data": mitsuba().TensorXf(values.astype(np.float32)[..., None]), "raw": True}


def metal(reflects: Any, roughness: float) -> dict[str, Any]:
    """A conductor (GGX, Walter 2007)."""
    return {"type": "roughconductor", "distribution": "ggx", "alpha": roughness, "material": "none",
            "specular_reflectance": reflects}  # fmt: skip


def coated(diffuse: Any, roughness: float) -> dict[str, Any]:
    """Plastic, or paint."""
    return {"type": "roughplastic", "distribution": "ggx", "alpha": roughness, "diffuse_reflectance": diffuse}


def surfaces(setting: Setting) -> dict[str, dict[str, Any]]:
    """The materials of faces, walls and broken edges."""
    is_metal = setting.finish not in ("plastic", "cast")
    kind = metal if is_metal else coated
    reflects = setting.reflects if setting.finish != "cast" else 0.3 * setting.reflects
    height = marks(setting.finish, setting.pitch_mm, setting.slope, setting.lay_rad, setting.seed)
    face = {"type": "bumpmap", "height": bitmap(height), "bsdf": kind(reflects, setting.roughness[0])}
    # a casting is machined at its broken edges
    edge = (
        kind(reflects, setting.roughness[2]) if setting.finish != "cast" else metal(0.7, setting.roughness[2])
    )
    wall = kind(0.85 * reflects, setting.roughness[1])
    return {"face": face, "wall": wall, "break": edge, "under": wall}


def table_surface(setting: Setting) -> dict[str, Any]:
    """Material of the table."""
    rng = np.random.default_rng((31, setting.seed))
    noise = band(rng, 0.3, 6.0, TABLE_MM / TEXELS)
    if setting.table == "steel":
        return {"type": "bumpmap", "height": bitmap(0.004 * noise), "bsdf": metal(0.55, 0.3)}
    if setting.table == "wood":
        fibres = cv2.resize(noise[: TEXELS // 16], (TEXELS, TEXELS), interpolation=cv2.INTER_CUBIC).T
        return {"type": "diffuse", "reflectance": bitmap(np.clip(0.3 + 0.07 * fibres, 0.02, 0.9))}
    level, contrast = {"dark": (0.04, 0.3), "plastic": (0.15, 0.12), "paper": (0.6, 0.04)}[setting.table]
    reflectance = bitmap(np.clip(level * (1 + contrast * noise), 0.01, 0.9))
    return (
        coated(reflectance, 0.25)
        if setting.table == "plastic"
        else {"type": "diffuse", "reflectance": reflectance}
    )


# --- scenes ----------------------------------------------------------------------------------------


def scene_of(mesh: Mesh, where: FloatArray, setting: Setting, rig: StereoRig, folder: Path) -> dict[str, Any]:
    """The scene as Mitsuba's dictionary, in the rig's frame; its triangles go to files in a folder."""
    corners = apply(where, mesh.model.points_mm)[mesh.model.triangles]
    kinds = np.array(mesh.kind)
    level = mesh.model.points_mm[mesh.model.triangles][..., :2] / SHEET_MM + 0.5
    scene: dict[str, Any] = {"type": "scene", "room": {"type": "constant", "radiance": 0.0}}
    for kind, material in surfaces(setting).items():
        some = kinds == kind
        if some.any():
            name = write_ply(folder / f"{kind}.ply", corners[some], level[some] if kind == "face" else None)
            scene[kind] = {"type": "ply", "filename": name, "face_normals": True, "material": material}
    bed = bed_of(corners, where, setting, rig)
    half = 0.5 * TABLE_MM
    square = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])[
        [[0, 2, 1], [0, 3, 2]]
    ]
    name = write_ply(folder / "table.ply", apply(bed, square.reshape(-1, 3)).reshape(-1, 3, 3),
                     square[..., :2] / TABLE_MM + 0.5)  # fmt: skip
    scene["table"] = {"type": "ply", "filename": name, "material": table_surface(setting)}
    return scene | lights(where, bed, setting, rig, folder)


def bed_of(corners: FloatArray, where: FloatArray, setting: Setting, rig: StereoRig) -> FloatArray:
    """rig_from_table (4, 4): z down, below the part; parallel to it, or square to the cameras' middle."""
    place = tuple(where[:3, 3].tolist())
    bed = where.copy() if setting.parallel else lying(rig, 0.0, 0.0, 0.0, place)
    lowest = apply(invert(bed), corners.reshape(-1, 3))[:, 2].max()
    bed[:3, 3] += (lowest + setting.gap_mm) * bed[:3, 2]
    return bed


def lights(
    where: FloatArray, bed: FloatArray, setting: Setting, rig: StereoRig, folder: Path
) -> dict[str, Any]:
    """Lamps, room and window, of radiance 1 on a level face."""
    frame, eyes = lamp_frame(where, bed, setting, rig), eyes_of(rig)
    shining = lamps(setting, [apply(invert(frame), eye[None])[0] for eye in eyes])
    name = write_ply(folder / "lamps.ply", apply(frame, shining.reshape(-1, 3)).reshape(-1, 3, 3))
    level = math.pi / irradiance(shining)
    found: dict[str, Any] = {
        "room": {"type": "constant", "radiance": setting.ambient},
        "lamps": {"type": "ply", "filename": name, "face_normals": True,
                  "emitter": {"type": "area", "radiance": level * (1 - setting.ambient)}},
    }  # fmt: skip
    if setting.window >= 0:
        ray = unit(where[:3, 3] - eyes[setting.window])
        normal = -where[:3, 2]
        away = where[:3, 3] + 450 * (ray - 2 * float(ray @ normal) * normal)
        pane = write_ply(folder / "window.ply", panel(away, where[:3, 3], 110.0, 150.0))
        found["window"] = {"type": "ply", "filename": pane, "face_normals": True,
                           "emitter": {"type": "area", "radiance": 1.5}}  # fmt: skip
    return found


def lamp_frame(where: FloatArray, bed: FloatArray, setting: Setting, rig: StereoRig) -> FloatArray:
    """rig_from_lamps (4, 4): dome and low band stand on the table, ring and bars hang by the cameras."""
    if setting.light not in ("dome", "low"):
        return lying(rig, 0.0, 0.0, 0.0, tuple(where[:3, 3].tolist()))
    frame = bed.copy()
    frame[:3, 3] = where[:3, 3]
    return frame


def eyes_of(rig: StereoRig) -> list[FloatArray]:
    """Positions of both cameras (3,)."""
    return [np.zeros(3), invert(np.asarray(rig.right_from_left))[:3, 3]]


class Tracer:
    """Traces rays through one scene."""

    def __init__(self, scene: dict[str, Any]) -> None:
        self._mi, self._seed = mitsuba(), 0
        self._scene = self._mi.load_dict(scene)
        self._integrator = self._mi.load_dict({"type": "path", "max_depth": BOUNCES, "rr_depth": BOUNCES})

    def radiance(self, camera: CameraModel, camera_from_rig: FloatArray, pixels: FloatArray) -> FloatArray:
        """Incoming radiance (N,) at places (N, 2) of a picture."""
        mi = self._mi
        rig_from_camera = invert(camera_from_rig)
        eye = mi.Point3f(*rig_from_camera[:3, 3].tolist())
        found = np.empty(len(pixels), np.float32)
        for first in range(0, len(pixels), BATCH):
            some = rays_of_pixels(camera, pixels[first : first + BATCH])
            ahead = unit_rows(np.column_stack([some, np.ones(len(some))]) @ rig_from_camera[:3, :3].T)
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(self._seed, len(some))
            self._seed += 1
            ray = mi.RayDifferential3f(mi.Ray3f(eye, mi.Vector3f(ahead.T.astype(np.float32))))
            value = self._integrator.sample(self._scene, sampler, ray)[0]
            found[first : first + len(some)] = np.array(value[0])
        return np.nan_to_num(found)


def strata(window: tuple[int, int, int, int], each: int, rng: np.random.Generator) -> FloatArray:
    """Random places (each H, each W, 2), one in each of each x each cells of the pixels x0, y0, x1, y1."""
    x0, y0, x1, y1 = window
    y, x = np.mgrid[0 : (y1 - y0) * each, 0 : (x1 - x0) * each]
    places = np.stack([x, y], axis=-1) + rng.random((*x.shape, 2))
    return np.asarray(places / each + (x0 - 0.5, y0 - 0.5))


def pictures(
    mesh: Mesh, where: FloatArray, setting: Setting, rig: StereoRig, samples: int,
    expose: Callable[[FloatArray, np.random.Generator], Image] = exposed,
) -> tuple[Image, Image]:  # fmt: skip
    """Left and right picture with one exposure, as in cells. expose : makes a picture from light."""
    with tempfile.TemporaryDirectory() as folder:
        tracer = Tracer(scene_of(mesh, where, setting, rig, Path(folder)))
        views = [(rig.left, np.eye(4)), (rig.right, np.asarray(rig.right_from_left))]
        rng = np.random.default_rng((32, setting.seed))
        windows = [_window(view, apply(where, mesh.model.points_mm)) for view in views]
        places = apply(where, face_points(mesh, rng))
        of_faces = [tracer.radiance(*view, project(*view, places)) for view in views]
        around = [tracer.radiance(*view, strata(window, 1, rng).reshape(-1, 2))
                  for view, window in zip(views, windows, strict=True)]  # fmt: skip
        white = max(np.quantile(np.concatenate(of_faces), FACE_SHARE) * WHITE / setting.exposure,
                    np.quantile(np.concatenate(around), NOT_WHITE) * MOST_OVER)  # fmt: skip
        left, right = (
            expose(_seen(tracer, view, window, white, setting, samples, rng) / white, rng)
            for view, window in zip(views, windows, strict=True)
        )
    return left, right


def face_points(mesh: Mesh, rng: np.random.Generator) -> FloatArray:
    """Random points (FACE_POINTS, 3) on the faces that look up."""
    corners = mesh.model.points_mm[mesh.model.triangles][np.array(mesh.kind) == "face"]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = corners[rng.choice(len(corners), FACE_POINTS, p=area / area.sum())]
    return np.asarray(np.einsum("nij,ni->nj", chosen, rng.dirichlet(np.ones(3), FACE_POINTS)))


def _window(view: tuple[CameraModel, FloatArray], points: FloatArray) -> tuple[int, int, int, int]:
    """First and last pixels that show the part, with a margin."""
    size, pixels = (view[0].width, view[0].height), project(*view, points)
    x0, y0 = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - SEAM_PX - 8, 0).tolist()
    x1, y1 = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + SEAM_PX + 9, size).tolist()
    return x0, y0, x1, y1


def _seen(
    tracer: Tracer, view: tuple[CameraModel, FloatArray], window: tuple[int, int, int, int], white: float,
    setting: Setting, samples: int, rng: np.random.Generator,
) -> FloatArray:  # fmt: skip
    """Radiance (H, W) behind the lens: the window around the part finely, the rest coarsely and smoothed."""
    camera, (x0, y0, x1, y1) = view[0], window

    def traced(area: tuple[int, int, int, int], each: int) -> FloatArray:
        places = strata(area, each, rng)
        values = np.minimum(tracer.radiance(*view, places.reshape(-1, 2)), BRIGHTEST * white)
        return values.reshape(places.shape[:2])

    whole = cv2.resize(traced((0, 0, camera.width, camera.height), 2), (camera.width, camera.height),
                       interpolation=cv2.INTER_AREA)  # fmt: skip
    whole = cv2.GaussianBlur(whole, (0, 0), TABLE_BLUR_PX)
    fine = sum(traced(window, COLUMNS) for _ in range(samples)) / samples
    # a cell is a quarter of a pixel wide, which already blurs
    sigma = math.sqrt(max(setting.blur_px**2 * COLUMNS**2 - 1 / 12, 0.01))
    fine = cv2.GaussianBlur(fine, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    fine = cv2.resize(fine, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
    rise = [np.minimum(np.arange(1, n + 1), np.arange(n, 0, -1)) / SEAM_PX for n in fine.shape]
    share = np.clip(np.minimum(rise[0][:, None], rise[1]), 0, 1)
    whole[y0:y1, x0:x1] += share * (fine - whole[y0:y1, x0:x1])
    return np.asarray(whole)


def finish_of(name: str) -> str:
    """Finish of the faces of a part, such as P12: the same in all its scenes."""
    return FINISHES[int(np.random.default_rng((33, int(name[1:]))).integers(len(FINISHES)))]


def traced(
    name: str, mesh: Mesh, where: FloatArray, rng: np.random.Generator, samples: int, *, teaching: bool
) -> tuple[tuple[Image, Image], dict[str, Any]]:
    """A pair of a part in a random setting, and what the setting is."""
    setting = Setting.drawn(finish_of(name), rng, teaching=teaching)
    pair = pictures(mesh, where, setting, world_rig(), samples)
    print(f"{name}: {setting.finish}, {setting.light}, {setting.table}", flush=True)
    return pair, asdict(setting) | {"samples": samples}


def main() -> int:
    """Render a set."""
    parser = set_parser(__doc__)
    parser.add_argument("--samples", type=int, default=4, help="in each of a pixel's 16 strata")
    options = parser.parse_args()

    def draw(
        design: Design, where: FloatArray, rng: np.random.Generator, *, teaching: bool
    ) -> tuple[tuple[Image, Image], dict[str, Any]]:
        mesh = meshed(design, nominal=False)
        return traced(design.name, mesh, where, rng, options.samples, teaching=teaching)

    write_asked(options, options.folder, draw)
    return 0


if __name__ == "__main__":
    sys.exit(main())
