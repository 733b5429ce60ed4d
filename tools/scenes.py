"""Synthetic scenes with exact truth for the shape search.

A part is a stack of polygons in its own plane, painted with the exact area of each pixel that each covers;
then blur, shot and read noise follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from edged.vision.geometry.rigid import rotation_2d
from edged.vision.teaching.coverage import coverage

Float = npt.NDArray[np.float64]
Grey = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Part:
    """outlines : closed polygons (N, 2) in px about the origin, each with its grey value, in order."""

    outlines: tuple[tuple[Float, float], ...]

    @property
    def radius(self) -> float:
        """Distance of the farthest point from the origin."""
        return max(float(np.linalg.norm(points, axis=1).max()) for points, _ in self.outlines)


@dataclass(frozen=True, slots=True)
class Truth:
    """Pose of one part: position of its origin in px, rotation from x to y, scales along its own axes."""

    x: float
    y: float
    angle: float
    scale_x: float = 1.0
    scale_y: float = 1.0

    @property
    def linear(self) -> Float:
        """Linear map (2, 2) from part to image."""
        return rotation_2d(self.angle) @ np.diag([self.scale_x, self.scale_y])


def circle(x: float, y: float, radius: float, count: int = 180) -> Float:
    """Polygon of a circle."""
    t = np.arange(count) * (2 * np.pi / count)
    return np.column_stack([x + radius * np.cos(t), y + radius * np.sin(t)])


def box(x: float, y: float, width: float, height: float, angle: float = 0.0) -> Float:
    """Polygon of a turned rectangle."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (width / 2, height / 2)
    return corners @ rotation_2d(-angle) + (x, y)


def bracket(size: float = 250.0) -> Part:
    """A plate with a cut corner, a slot and two bores of different size: no symmetry."""
    k = size / 250
    plate = np.array(
        [(-125, -80), (90, -80), (125, -45), (125, 80), (20, 80), (0, 50), (-60, 50), (-125, 20)], float
    )
    holes = (circle(-80, -30, 22), circle(75, 30, 30), box(0, -30, 80, 18, 0.25))
    return Part(((plate * k, 200.0), *((hole * k, 60.0) for hole in holes)))


def flange(odd: bool, size: float = 250.0) -> Part:
    """A round flange with six bolt holes; when odd, one of them is smaller."""
    k = size / 250
    outlines = [(circle(0, 0, 122 * k), 200.0), (circle(0, 0, 45 * k), 60.0)]
    for i in range(6):
        t = i * np.pi / 3 + 0.2
        radius = 9.0 if odd and i == 0 else 14.0
        outlines.append((circle(85 * k * np.cos(t), 85 * k * np.sin(t), radius * k, 90), 60.0))
    return Part(tuple(outlines))


def other_part(size: float = 250.0) -> Part:
    """Another part of the same size and grey."""
    k = size / 250
    gear = np.array(
        [
            ((110 if i % 2 else 85) * np.cos(i * np.pi / 9), (110 if i % 2 else 85) * np.sin(i * np.pi / 9))
            for i in range(18)
        ]
    )
    return Part(((gear * k, 200.0), (box(0, 0, 60 * k, 60 * k), 60.0)))


def gear(size: float = 250.0) -> Part:
    """A gear with a keyway: many equal teeth, one cue to the rotation."""
    k, teeth = size / 250, 16
    turns = np.arange(4 * teeth) * (2 * np.pi / (4 * teeth))
    radii = np.where(np.arange(4 * teeth) % 4 < 2, 120.0, 98.0)
    rim = np.column_stack([radii * np.cos(turns), radii * np.sin(turns)])
    return Part(((rim * k, 200.0), (circle(0, 0, 35 * k), 60.0), (box(38 * k, 0, 30 * k, 18 * k), 60.0)))


def angle_iron(size: float = 250.0) -> Part:
    """An L of six straight edges and nothing else."""
    outline = np.array([(-120, -90), (-70, -90), (-70, 50), (110, 50), (110, 100), (-120, 100)], float)
    return Part(((outline * (size / 250), 200.0),))


def stamping(size: float = 250.0) -> Part:
    """A rounded plate with slots of low contrast and one bore."""
    k = size / 250
    t = np.arange(120) * (2 * np.pi / 120)
    rim = np.column_stack(
        [
            120 * np.sign(np.cos(t)) * np.abs(np.cos(t)) ** 0.5,
            70 * np.sign(np.sin(t)) * np.abs(np.sin(t)) ** 0.5,
        ]
    )
    slots = (box(-60, 15, 70, 14, 0.6), box(45, -20, 50, 14, -0.4))
    return Part(
        ((rim * k, 200.0), *((slot * k, 165.0) for slot in slots), (circle(70 * k, 25 * k, 16 * k), 60.0))
    )


def paint(canvas: npt.NDArray[np.float32], part: Part, truth: Truth) -> None:
    """Blend a part into a float canvas (H, W) with exact area coverage."""
    height, width = canvas.shape
    reach = part.radius * max(truth.scale_x, truth.scale_y) + 3
    x0, x1 = max(0, int(truth.x - reach)), min(width, int(truth.x + reach) + 2)
    y0, y1 = max(0, int(truth.y - reach)), min(height, int(truth.y + reach) + 2)
    if x1 <= x0 or y1 <= y0:
        return
    for points, grey in part.outlines:
        placed = points @ truth.linear.T + (truth.x - x0, truth.y - y0)
        cover = coverage(np.ascontiguousarray(placed), y1 - y0, x1 - x0).astype(np.float32)
        canvas[y0:y1, x0:x1] += cover * (np.float32(grey) - canvas[y0:y1, x0:x1])


@dataclass(frozen=True, slots=True)
class Look:
    """Disturbances of a scene.

    noise : read noise, grey values.  clutter : number of distracting shapes.  occlusion : share of the
    part's disc covered by a strip.  invert : all contrasts.  gradient : relative change of light across.
    texture : amplitude of a smooth random background.
    """

    noise: float = 1.0
    clutter: int = 0
    occlusion: float = 0.0
    invert: bool = False
    gradient: float = 0.0
    texture: float = 0.0
    blur: float = 0.7


def render(
    parts: Sequence[tuple[Part, Truth]],
    look: Look,
    rng: np.random.Generator,
    size: tuple[int, int] = (1280, 960),
) -> Grey:
    """One image (H, W) uint8 of parts over a background, clutter below, occluders above."""
    width, height = size
    canvas = np.full((height, width), 60, np.float32)
    if look.texture:
        coarse = rng.normal(0, look.texture, (height // 6, width // 6)).astype(np.float32)
        canvas += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    for _ in range(look.clutter):
        kind, radius, grey = rng.integers(3), rng.uniform(10, 90), rng.uniform(20, 235)
        shape = (
            circle(0, 0, radius)
            if kind == 0
            else box(0, 0, radius * 2, rng.uniform(6, radius))
            if kind == 1
            else rng.normal(0, radius / 2, (5, 2))
        )
        paint(
            canvas,
            Part(((shape, grey),)),
            Truth(rng.uniform(0, width), rng.uniform(0, height), rng.uniform(0, 6.3)),
        )
    for part, truth in parts:
        paint(canvas, part, truth)
    for part, truth in parts if look.occlusion else ():
        side, radius = rng.uniform(0, 2 * np.pi), part.radius
        # at this distance from the centre, a half plane covers about that share of the diameter
        depth = radius * (1 - 2 * look.occlusion)
        cover = Part(((box(0, 0, radius * 2, radius * 3), rng.uniform(30, 220)),))
        at = depth + radius
        paint(canvas, cover, Truth(truth.x + at * np.cos(side), truth.y + at * np.sin(side), side))
    if look.gradient:
        ramp = 1 + look.gradient * (
            np.linspace(-0.5, 0.5, width)[None] + np.linspace(-0.5, 0.5, height)[:, None]
        )
        canvas *= ramp.astype(np.float32)
    canvas = cv2.GaussianBlur(canvas, (0, 0), look.blur)
    if look.invert:
        canvas = 260 - canvas
    shot = np.sqrt(np.maximum(canvas, 0) / 40)  # 10,000 electrons at 255
    canvas += rng.standard_normal(canvas.shape, np.float32) * np.hypot(shot, look.noise).astype(np.float32)
    return np.clip(np.rint(canvas), 0, 255).astype(np.uint8)


def teach_image(part: Part) -> tuple[Grey, Grey, Float]:
    """Image, mask and origin (2,) of a part lying straight, nearly free of noise."""
    radius = int(np.ceil(part.radius)) + 20
    truth = Truth(radius + 0.0, radius + 0.0, 0.0)
    size = 2 * radius + 1
    image = render([(part, truth)], Look(noise=0.5), np.random.default_rng(1), (size, size))
    return image, np.full(image.shape, 255, np.uint8), np.array([truth.x, truth.y])


def bound_px(part: Part, look: Look, step: float = 140.0) -> float:
    """Cramér-Rao bound of a rigid pose: rms of one coordinate of the origin, for edges of one step of grey.

    A blurred step of height A in white noise holds A^2 / (2 sqrt(pi) s sigma^2) per px of its length.
    """
    blur = np.hypot(look.blur, np.sqrt(1 / 12))  # a pixel averages over its own area
    shot = (60 + 200) / 2 / 40
    density = step**2 / (2 * np.sqrt(np.pi) * blur * (look.noise**2 + shot + 1 / 12))
    information = np.zeros((3, 3))
    for points, _ in part.outlines:
        along = np.roll(points, -1, axis=0) - points
        length = np.linalg.norm(along, axis=1)
        normal = np.column_stack([along[:, 1], -along[:, 0]]) / length[:, None]
        for share in (1 / 6, 1 / 2, 5 / 6):
            at = points + share * along
            turn = normal[:, 1] * at[:, 0] - normal[:, 0] * at[:, 1]
            design = np.column_stack([normal, turn])
            information += density / 3 * design.T @ (design * length[:, None])
    covariance = np.linalg.inv(information)
    return float(np.sqrt((covariance[0, 0] + covariance[1, 1]) / 2))
