#!/usr/bin/env python3
"""Draw stereo pairs of random machined parts, with exact truth, as a set in the format of data/rendered.

    tools/solidworld.py FOLDER [--designs N] [--scenes N] [--decoys N] [--held-out] [--first N] [--seed N]

Every design (`solids`) is drawn from its number. Those from HELD_OUT on are reserved for evaluation and are
never looked at during development. FOLDER gets rig.json, teach/ (one pair for each, square to the cameras),
scenes/ and step/ (the nominal part, without the broken edges). `tools/bench solid FOLDER` measures it.

Brightness is not computed from light but random, so that no finder can rely on how surfaces behave. Walls
have 0.05 to 1.5 of the face's. Broken edges are dark, as bright as the face or the wall, or glint, in half of
the scenes differently in each camera. Blur grows with the distance from the plane of focus. Not modelled:
shadows, and reflections of one surface on another; the table lies below the part without touching it.
"""

from __future__ import annotations

import argparse
import functools
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import benching
import cv2
import numpy as np
from solids import Design, Mesh, meshed, random_design
from solidtruth import part_json, rig_json, write_drawing

from edged.domain.arrays import SIDES, FloatArray, Image
from edged.sim.cell import demo_rig
from edged.sim.render.lens import project, rays_of_pixels
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import apply, invert
from edged.vision.kernels.jit import kernel
from edged.vision.teaching.cadmodel import triangle_normals

sys.path.insert(0, str(benching.TESTS))
from helpers.cells import PLACE_MM
from helpers.tilted import lying

HELD_OUT = 1000
COLUMNS, ROWS = 4, 16
"""Samples of a pixel: 64, each at another x; the picture is blurred at COLUMNS times its size."""
SHIFTS = tuple((5 * row % ROWS + 0.5) / ROWS for row in range(ROWS))
TILE, GRAIN_TEXELS = 512, 8
BLURS = 3
FULL_WELL_E, READ_E, BLACK, WHITE = 12_000.0, 12.0, 3.0, 220.0
UPRIGHT = 0.2
"""Least z component of a drawn normal that is not a wall's."""


def world_rig() -> StereoRig:
    """Two cameras of 1280x960, f 3043 px, looking from two sides at a point 200 mm away."""
    rig = demo_rig()
    left, right = (
        replace(camera, fx=f, fy=f, distortion=(0.96 * camera.distortion[0],))
        for camera, f in ((rig.left, 3043.0), (rig.right, 3037.0))
    )
    return StereoRig(left, right, rig.right_from_left, "truth")


# --- what a scene looks like -------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class BreakLook:
    """Brightness of broken edges in one camera, relative to the face.

    level : brightness from all directions.  glint : added where they face azimuth_rad, within width_rad; for
    a rounding, where it leans by lean_rad off the face.
    """

    level: float
    glint: float
    azimuth_rad: float
    width_rad: float
    lean_rad: float


@dataclass(frozen=True, slots=True)
class Look:
    """Light and camera effects of a scene; brightness of walls relative to the face."""

    albedo: float
    contrast: float
    feature_mm: float
    wall: float
    wall_swing: float
    wall_azimuth_rad: float
    bore: float
    breaks: tuple[BreakLook, BreakLook]
    beneath: float
    table: float
    table_contrast: float
    table_feature_mm: float
    gap_mm: float
    gradient_per_mm: tuple[float, float]
    levels: tuple[float, float]
    blur_px: tuple[float, float]
    blur_px_per_mm: float
    focus_mm: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Look:
        """Random look."""
        wall = math.exp(rng.uniform(math.log(0.05), math.log(1.5)))
        first = _break_look(wall, rng)
        second = first if rng.random() < 0.5 else _break_look(wall, rng)
        return cls(
            albedo=rng.uniform(0.3, 0.75), contrast=rng.uniform(0.01, 0.15),
            feature_mm=rng.uniform(0.25, 1.0), wall=wall, wall_swing=rng.uniform(0, 0.5),
            wall_azimuth_rad=rng.uniform(0, math.tau),
            bore=rng.uniform(0.3, 1.0), breaks=(first, second), beneath=rng.uniform(0.05, 0.9),
            table=float(rng.choice([0.03, 0.16, 0.35, 0.7])) * rng.uniform(0.7, 1.3),
            table_contrast=rng.uniform(0.03, 0.35), table_feature_mm=rng.uniform(0.3, 2.0),
            gap_mm=rng.uniform(0, 15), gradient_per_mm=tuple(rng.uniform(-0.008, 0.008, 2).tolist()),
            levels=(1.0, rng.uniform(0.75, 1.25)), blur_px=tuple(rng.uniform(0.45, 0.75, 2).tolist()),
            blur_px_per_mm=rng.uniform(0, 0.05), focus_mm=rng.uniform(-6, 6),
        )  # fmt: skip


def _break_look(wall: float, rng: np.random.Generator) -> BreakLook:
    level, glint = {
        "dark": (rng.uniform(0.05, 0.4), 0.0),
        "face": (rng.uniform(0.9, 1.1), 0.0),
        "wall": (wall * rng.uniform(0.8, 1.2), 0.0),
        "glint": (rng.uniform(0.1, 0.8), rng.uniform(0.8, 3.0)),
    }[str(rng.choice(["dark", "face", "wall", "glint"]))]
    turns = rng.uniform(0, math.tau), rng.uniform(0.6, 3.0), rng.uniform(0.2, 1.2)
    return BreakLook(level, glint, *turns)


def brightness(mesh: Mesh, look: Look, camera: int, rng: np.random.Generator) -> FloatArray:
    """Radiance (M,) of each triangle."""
    _, normals = triangle_normals(mesh.model)
    azimuth = np.arctan2(normals[:, 1], normals[:, 0])
    lean = np.arccos(np.clip(-normals[:, 2], -1, 1))
    kind = np.array(mesh.kind)
    wall = look.wall * (1 + look.wall_swing * np.cos(azimuth - look.wall_azimuth_rad))
    wall = wall * np.where(mesh.hole > 0, look.bore, 1.0)
    broken = look.breaks[camera]
    away = np.abs((azimuth - broken.azimuth_rad + math.pi) % math.tau - math.pi)
    lobe = np.exp(-((away / broken.width_rad) ** 2))
    is_round = np.array([surface is None for surface in mesh.model.surfaces])[mesh.model.face_of]
    lobe = lobe * np.where(is_round, np.exp(-(((lean - broken.lean_rad) / 0.3) ** 2)), 1.0)
    share = 2 * lean / math.pi
    level = np.where(is_round, 0.5 * broken.level + 0.5 * ((1 - share) + share * wall), broken.level)
    face = rng.uniform(0.9, 1.1, len(mesh.model.surfaces))[mesh.model.face_of]
    of_part = np.select(
        [kind == "face", kind == "wall", kind == "break"],
        [face, wall, level + broken.glint * lobe],
        look.wall,
    )
    return np.where(kind == "beneath", look.table * look.beneath, look.albedo * of_part) * look.levels[camera]


# --- pictures --------------------------------------------------------------------------------------


@kernel("void(f8[:, ::1], f8[::1], i8[:, ::1], f8[::1], i8, i8, f4[:, ::1], i4[:, ::1])")
def cover(
    samples: FloatArray, inverse_depth: FloatArray, triangles: Any, shifts: FloatArray, top: int, left: int,
    nearest: Any, owner: Any,
) -> None:  # fmt: skip
    """Write the number of the nearest triangle that each sample sees, and its 1 / depth.

    samples (V, 2) : vertices in columns and rows of samples; row r is at r, column c at c + shifts[r % R].
    top, left : row and column of the first sample of nearest and owner.
    """
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t]
        ux, uy = samples[b, 0] - samples[a, 0], samples[b, 1] - samples[a, 1]
        vx, vy = samples[c, 0] - samples[a, 0], samples[c, 1] - samples[a, 1]
        area = ux * vy - uy * vx
        if abs(area) < 1e-9:
            continue
        du, dv = inverse_depth[b] - inverse_depth[a], inverse_depth[c] - inverse_depth[a]
        by_x, by_y = (du * vy - dv * uy) / area, (dv * ux - du * vx) / area
        low = min(samples[a, 1], samples[b, 1], samples[c, 1])
        high = max(samples[a, 1], samples[b, 1], samples[c, 1])
        for row in range(max(math.ceil(low), top), min(math.ceil(high), top + nearest.shape[0])):
            first, last = np.inf, -np.inf
            for k in range(3):
                p, q = triangles[t, k], triangles[t, (k + 1) % 3]
                if samples[p, 1] > samples[q, 1]:
                    p, q = q, p  # a side shared by two triangles is cut at the same place
                if samples[p, 1] <= row < samples[q, 1]:
                    share = (row - samples[p, 1]) / (samples[q, 1] - samples[p, 1])
                    x = samples[p, 0] + share * (samples[q, 0] - samples[p, 0])
                    first, last = min(first, x), max(last, x)
            if first == np.inf:
                continue
            shift = shifts[row % shifts.shape[0]]
            start = max(math.ceil(first - shift), left)
            for column in range(start, min(math.ceil(last - shift), left + nearest.shape[1])):
                value = inverse_depth[a] + by_x * (column + shift - samples[a, 0])
                value += by_y * (row - samples[a, 1])
                if value > nearest[row - top, column - left]:
                    nearest[row - top, column - left] = value
                    owner[row - top, column - left] = t


@kernel(
    "void(i4[:, ::1], f4[:, ::1], f8[::1], f8[::1], f8[:, :, ::1], f8, f4[:, ::1], f8[::1], f4[:, ::1], "
    "f4[:, ::1])"
)
def shade(
    owner: Any, nearest: Any, levels: FloatArray, contrast: FloatArray, planes: FloatArray, scale: float,
    texture: Any, shifts: FloatArray, radiance: Any, depth: Any,
) -> None:  # fmt: skip
    """Blend what the samples see into radiance and depth (h, w): several samples each, one below another.

    owner, nearest : of `cover`.  levels, contrast (M), planes (M, 3, 3) : of triangles.  scale : texels a mm.
    """
    each, mask = owner.shape[0] // radiance.shape[0], texture.shape[0] - 1
    for y in range(radiance.shape[0]):
        for x in range(radiance.shape[1]):
            seen, light, deep = 0, 0.0, 0.0
            for row in range(y * each, (y + 1) * each):
                t = owner[row, x]
                if t < 0:
                    continue
                column = x + shifts[row % shifts.shape[0]]
                plane, far = planes[t], 1.0 / nearest[row, x]
                u = (plane[0, 0] * column + plane[0, 1] * row + plane[0, 2]) * far * scale
                v = (plane[1, 0] * column + plane[1, 1] * row + plane[1, 2]) * far * scale
                i, k = math.floor(u), math.floor(v)
                a, b, right, left = u - i, v - k, (i + 1) & mask, i & mask
                above, below = texture[k & mask], texture[(k + 1) & mask]
                noise = (1 - b) * ((1 - a) * above[left] + a * above[right])
                noise += b * ((1 - a) * below[left] + a * below[right])
                light += levels[t] * max(1.0 + contrast[t] * noise, 0.02)
                deep += far
                seen += 1
            if seen:
                radiance[y, x] += (light - seen * radiance[y, x]) / each
                depth[y, x] += (deep - seen * depth[y, x]) / each


@functools.cache
def grain(seed: int) -> Any:
    """Periodic noise (TILE, TILE) of mean 0 and deviation 1; its shortest wave is GRAIN_TEXELS long."""
    frequency = np.hypot(np.fft.fftfreq(TILE)[:, None], np.fft.rfftfreq(TILE)[None])
    band = np.where(
        (frequency > 4 / TILE) & (frequency < 1 / GRAIN_TEXELS), 1 / np.maximum(frequency, 1e-9), 0
    )
    white = np.random.default_rng((21, seed)).standard_normal((TILE, TILE))
    tile = np.fft.irfft2(np.fft.rfft2(white) * band, s=(TILE, TILE))
    return (tile / tile.std()).astype(np.float32)


def textured(u: FloatArray, v: FloatArray, feature_mm: float, seed: int) -> Any:
    """Noise at points of a surface, mm, of any shape (H, W)."""
    places = [(one * GRAIN_TEXELS / feature_mm % TILE).astype(np.float32) for one in (u, v)]
    return cv2.remap(grain(seed), *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


@dataclass(frozen=True, slots=True)
class World:
    """A part in its pose; seed: of textures and noise."""

    design: Design | Mesh
    rig_from_part: FloatArray
    look: Look
    seed: int


def pictures(world: World, rig: StereoRig) -> tuple[Image, Image]:
    """Left and right picture (H, W)."""
    design = world.design
    mesh = design if isinstance(design, Mesh) else meshed(design, nominal=False, closed_below=True)
    left, right = (
        _picture(world, mesh, index, camera, camera_from_rig)
        for index, (camera, camera_from_rig) in enumerate(
            ((rig.left, np.eye(4)), (rig.right, np.asarray(rig.right_from_left)))
        )
    )
    return left, right


def _picture(world: World, mesh: Mesh, index: int, camera: CameraModel, camera_from_rig: FloatArray) -> Image:
    look, rng = world.look, np.random.default_rng((22, world.seed, index))
    radiance, depth_mm = _table(world, mesh, camera, camera_from_rig)
    points = apply(world.rig_from_part, mesh.model.points_mm)
    pixels = project(camera, camera_from_rig, points)
    x0, y0 = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 12, 0)
    x1, y1 = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 13, (camera.width, camera.height))
    levels = brightness(mesh, look, index, np.random.default_rng((23, world.seed)))
    window = (slice(y0, y1), slice(x0, x1))
    size = ((x1 - x0) * COLUMNS, (y1 - y0) * COLUMNS)
    fine = [cv2.resize(one[window], size, interpolation=cv2.INTER_LINEAR) for one in (radiance, depth_mm)]
    _draw(fine, world, mesh, levels, pixels, apply(camera_from_rig, points)[:, 2], (x0, y0))
    focus_mm = float(apply(camera_from_rig, world.rig_from_part[None, :3, 3])[0, 2]) + look.focus_mm
    blurred = _blurred(*fine, look, index, focus_mm)
    of_table = math.hypot(
        look.blur_px[index], look.blur_px_per_mm * (float(depth_mm[window].mean()) - focus_mm)
    )
    radiance = cv2.GaussianBlur(radiance, (0, 0), of_table)
    radiance[window] = cv2.resize(blurred, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
    return exposed(radiance, rng)


def _table(world: World, mesh: Mesh, camera: CameraModel, camera_from_rig: FloatArray) -> tuple[Any, Any]:
    """Radiance (H, W) and depth (H, W) of a table square to the cameras' middle, below the part."""
    look = world.look
    table = camera_from_rig @ _table_frame(world, mesh)
    y, x = np.mgrid[0 : camera.height : 4, 0 : camera.width : 4]  # distortion is negligible within 4 px
    rays = rays_of_pixels(camera, np.stack([x, y], axis=-1).astype(float))
    rays = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=2)
    depth = (table[:3, 2] @ table[:3, 3]) / (rays @ table[:3, 2])
    places = (rays * depth[..., None] - table[:3, 3]) @ table[:3, :2]
    u, v, depth = (_between(one, camera) for one in (places[..., 0], places[..., 1], depth))
    light = 1 + look.gradient_per_mm[0] * u + look.gradient_per_mm[1] * v
    noise = 1 + look.table_contrast * textured(u, v, look.table_feature_mm, world.seed)
    return (look.table * np.maximum(light * noise, 0.02)).astype(np.float32), depth.astype(np.float32)


def _between(coarse: FloatArray, camera: CameraModel) -> FloatArray:
    """Interpolate to (H, W) from every fourth row and column."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float32) / 4
    padded = np.pad(coarse, ((0, 1), (0, 1)), mode="reflect", reflect_type="odd")
    return np.asarray(cv2.remap(padded.astype(np.float32), x, y, cv2.INTER_LINEAR))


def _table_frame(world: World, mesh: Mesh) -> FloatArray:
    frame = lying(world_rig(), 0.0, 0.0, 0.0, tuple(world.rig_from_part[:3, 3].tolist()))
    lowest = apply(invert(frame), apply(world.rig_from_part, mesh.model.points_mm))[:, 2].max()
    frame[:3, 3] += (lowest + world.look.gap_mm) * frame[:3, 2]
    return frame


def _draw(
    fine: list[Any], world: World, mesh: Mesh, levels: FloatArray, pixels: FloatArray, depth_mm: FloatArray,
    corner: tuple[int, int],
) -> None:  # fmt: skip
    """Draw the part into radiance and depth of a window, COLUMNS times its size; corner: its first pixel."""
    height, width = fine[0].shape
    nearest = np.zeros((height * ROWS // COLUMNS, width), np.float32)
    owner = np.full(nearest.shape, -1, np.int32)
    # a pixel extends from half a pixel before its middle to half a pixel after it
    samples = (pixels + 0.5 - corner) * (COLUMNS, ROWS) - (0.0, 0.5)
    triangles = mesh.model.triangles.astype(np.int64)
    cover(np.ascontiguousarray(samples), 1 / depth_mm, triangles, np.array(SHIFTS), 0, 0, nearest, owner)
    planes = _planes(mesh, samples, 1 / depth_mm)
    contrast = np.where(np.array(mesh.kind) == "beneath", 0.0, world.look.contrast)
    scale = GRAIN_TEXELS / world.look.feature_mm
    shade(owner, nearest, levels, contrast, planes, scale, grain(world.seed + 1), np.array(SHIFTS), *fine)


def _planes(mesh: Mesh, samples: FloatArray, inverse_depth: FloatArray) -> FloatArray:
    """Maps (M, 3, 3) from (column, row, 1) to (u, v, 1) / depth, u and v in mm on the triangle's surface.

    On faces u and v are x and y; on walls they are height, and whichever of x and y runs more along them.
    """
    model = mesh.model
    normals = np.abs(triangle_normals(model)[1])
    corners = model.points_mm[model.triangles]
    frame = np.concatenate([samples[model.triangles], np.ones((len(corners), 3, 1))], axis=2)
    frame[np.abs(np.linalg.det(frame)) < 1e-9] = np.eye(3)
    wall = np.where(normals[:, 0] > normals[:, 1], 1, 2)
    axes = np.array([[0, 1], [1, 2], [0, 2]])[np.where(normals[:, 2] > UPRIGHT, 0, wall)]
    weight = inverse_depth[model.triangles][..., None]
    places = np.take_along_axis(corners, axes[:, None, :], axis=2)
    # a linear function on a surface is linear in the picture once it is divided by the depth
    solved = np.linalg.solve(frame, np.concatenate([places, np.ones_like(weight)], axis=2) * weight)
    return np.ascontiguousarray(solved.transpose(0, 2, 1))


def _blurred(radiance: Any, depth_mm: Any, look: Look, index: int, focus_mm: float) -> Any:
    """The picture through a lens that is in focus at one depth."""
    sigma = np.hypot(look.blur_px[index], look.blur_px_per_mm * (depth_mm - focus_mm))
    steps = np.linspace(sigma.min(), max(sigma.max(), sigma.min() + 1e-3), BLURS)
    place = (sigma - steps[0]) / (steps[1] - steps[0])
    result = np.zeros_like(radiance)
    for k, step in enumerate(steps):
        soft = cv2.GaussianBlur(radiance, (0, 0), float(step) * COLUMNS, borderType=cv2.BORDER_REPLICATE)
        result += soft * np.maximum(1 - np.abs(place - k), 0).astype(np.float32)
    return result


def exposed(radiance: FloatArray, rng: np.random.Generator) -> Image:
    """8-bit picture with shot and read noise."""
    electrons = radiance * WHITE / 255 * FULL_WELL_E
    noisy = electrons + rng.standard_normal(radiance.shape, np.float32) * np.sqrt(electrons + READ_E**2)
    return np.clip(np.rint(noisy * 255 / FULL_WELL_E + BLACK), 0, 255).astype(np.uint8)


# --- sets ----------------------------------------------------------------------------------------


class Draw(Protocol):
    """A renderer."""

    def __call__(
        self, design: Design, where: FloatArray, rng: np.random.Generator, *, teaching: bool
    ) -> tuple[tuple[Image, Image], dict[str, Any]]:
        """Both pictures of a design at a place (4, 4) with a random look, and the look for the truth."""


def drawn(
    design: Design | Mesh, where: FloatArray, rng: np.random.Generator, *, teaching: bool
) -> tuple[tuple[Image, Image], dict[str, Any]]:
    """Pictures of this world: parts are taught on a plain and dark table; all else is as in any scene."""
    look = Look.drawn(rng)
    if teaching:
        look = replace(look, table=min(look.table, 0.2), table_contrast=0.3 * look.table_contrast)
    return pictures(World(design, where, look, int(rng.integers(1 << 30))), world_rig()), asdict(look)


def write_set(
    folder: Path, numbers: Sequence[int], scenes: int, decoys: int, seed: int, draw: Draw = drawn
) -> None:
    """Write a set: for each design a teaching pair and `scenes` scenes; and scenes of parts not taught.

    An existing pair is left as it is, so that an interrupted long run can continue.
    """
    for name in ("teach", "scenes", "step"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "rig.json").write_text(json.dumps(rig_json(world_rig()), indent=1))
    for number in numbers:
        write_drawing(folder / "step", random_design(number))
    for scene in range(-1, scenes):
        for number in numbers:
            rng = np.random.default_rng((24, seed, number, scene + 1))
            _write_pair(folder, random_design(number), rng, scene, draw)
    for scene in range(decoys):
        rng = np.random.default_rng((25, seed, scene))
        _write_pair(folder, random_design(max(numbers) + 1 + scene), rng, scene, draw, is_decoy=True)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Where a part lies in a scene, and the path of its files without their endings."""

    path: Path
    tilt_deg: float
    rig_from_part: FloatArray

    @classmethod
    def drawn(
        cls, folder: Path, name: str, rng: np.random.Generator, number: int, *, is_decoy: bool = False
    ) -> Scene:
        """A random place; number -1: of the teaching pair, square to the cameras."""
        tilt, side, turn, place = _pose(rng)
        path = folder / "scenes" / f"{'x' if is_decoy else 's'}{number:02d}_{name}_t{tilt:02.0f}"
        if number < 0:
            tilt, place, path = 0.0, PLACE_MM, folder / "teach" / f"teach_{name}"
        return cls(path, tilt, lying(world_rig(), tilt, side, turn, place))

    @property
    def truth(self) -> Path:
        """File of the truth, written last."""
        return self.path.with_name(self.path.name + ".json")

    def save(self, pair: tuple[Image, Image], spec: dict[str, Any], parts: list[dict[str, Any]]) -> None:
        """Write the pictures and the truth."""
        for camera, picture in zip(SIDES, pair, strict=True):
            cv2.imwrite(f"{self.path}_{camera}.png", picture)
        facts = {"scene": self.path.name, "n_parts": len(parts), "spec": spec, "parts": parts}
        self.truth.write_text(json.dumps(facts, indent=1))


def _write_pair(
    folder: Path, design: Design, rng: np.random.Generator, number: int, draw: Draw, *, is_decoy: bool = False
) -> None:
    """Write a pair with its truth: for scene -1 the teaching pair; for a decoy without a known part."""
    scene = Scene.drawn(folder, design.name, rng, number, is_decoy=is_decoy)
    if scene.truth.exists():
        return
    pair, spec = draw(design, scene.rig_from_part, rng, teaching=number < 0)
    part = part_json(design, scene.rig_from_part, scene.tilt_deg, world_rig())
    scene.save(pair, spec, [] if is_decoy else [part])


def _pose(rng: np.random.Generator) -> tuple[float, float, float, tuple[float, float, float]]:
    """Random tilt, its side, turn, degrees, and place, mm: two of five within 15 degrees, two beyond 30."""
    low, high = [(0, 15), (0, 15), (15, 30), (30, 45), (30, 45)][rng.integers(5)]
    x, y, z = (PLACE_MM + rng.uniform(-1, 1, 3) * (6, 5, 10)).tolist()
    return rng.uniform(low, high), rng.uniform(0, 360), rng.uniform(0, 360), (x, y, z)


def set_parser(doc: str | None) -> argparse.ArgumentParser:
    """Parser of the arguments that select a set."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--designs", type=int, default=6)
    parser.add_argument("--scenes", type=int, default=4, help="of each design")
    parser.add_argument("--decoys", type=int, default=0, help="scenes with parts that are not taught")
    parser.add_argument("--first", type=int, default=0, help="number of the first design")
    parser.add_argument("--held-out", action="store_true", help=f"designs from {HELD_OUT} on")
    parser.add_argument("--seed", type=int, default=1, help="of poses and looks")
    return parser


def write_asked(options: argparse.Namespace, folder: Path, draw: Draw = drawn) -> None:
    """Write the set selected by the arguments into a folder."""
    cv2.setNumThreads(1)
    first = options.first + (HELD_OUT if options.held_out else 0)
    numbers = range(first, first + options.designs)
    write_set(folder, numbers, options.scenes, options.decoys, options.seed, draw)


def main() -> int:
    """Write a set."""
    options = set_parser(__doc__).parse_args()
    write_asked(options, options.folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
