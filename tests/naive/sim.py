"""Plain-loop twins of the kernels of `sim`: slow, but simple enough to trust."""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.sim.render import scene


def half_plane_coverage(distance: float, slope_x: float, slope_y: float, n: int = 400) -> float:
    """Share of n x n points of the unit cell on the negative side of a line."""
    steps = (np.arange(n) + 0.5) / n - 0.5
    return float(np.mean(distance + slope_x * steps[None, :] + slope_y * steps[:, None] < 0))


def shape_covers(shape: scene.Shape, u: float, v: float) -> bool:
    """Whether a point of the plane lies in a shape, by the shape's definition."""
    match shape:
        case scene.Disc(x, y, radius):
            return (u - x) ** 2 + (v - y) ** 2 < radius**2
        case scene.Slot(x, y, length, width, angle):
            a = math.cos(angle) * (u - x) + math.sin(angle) * (v - y)
            b = -math.sin(angle) * (u - x) + math.cos(angle) * (v - y)
            along = min(max(a, -(length - width) / 2), (length - width) / 2)
            return (a - along) ** 2 + b**2 < (width / 2) ** 2
        case scene.RoundedBox(x, y, width, height, corner, angle):
            a = abs(math.cos(angle) * (u - x) + math.sin(angle) * (v - y))
            b = abs(-math.sin(angle) * (u - x) + math.cos(angle) * (v - y))
            if a > width / 2 - corner and b > height / 2 - corner:
                return (a - width / 2 + corner) ** 2 + (b - height / 2 + corner) ** 2 < corner**2
            return a < width / 2 and b < height / 2
        case scene.PolygonShape(points):
            crossings = 0
            for (ax, ay), (bx, by) in zip(points, points[1:] + points[:1], strict=True):
                if (ay > v) != (by > v) and u < ax + (v - ay) / (by - ay) * (bx - ax):
                    crossings += 1
            return crossings % 2 == 1
        case scene.Checker(x, y, square, columns, rows):
            column, row = math.floor((u - x) / square), math.floor((v - y) / square)
            return 0 <= column < columns and 0 <= row < rows and (column + row) % 2 == 0
        case scene.DiscGrid(x, y, radius, pitch, columns, rows):
            return any(
                (u - x - i * pitch) ** 2 + (v - y - j * pitch) ** 2 < radius**2
                for i in range(columns)
                for j in range(rows)
            )
    raise AssertionError(shape)


def radiance_at(world: scene.Scene, ray: FloatArray) -> float:
    """Radiance of an untextured scene along one ray (X/Z, Y/Z) of the rig frame."""

    def hit(rig_from_plane: FloatArray) -> tuple[float, float, float]:
        normal, origin = rig_from_plane[:3, 2], rig_from_plane[:3, 3]
        direction = np.array([ray[0], ray[1], 1.0])
        point = direction * (normal @ origin) / (normal @ direction)
        u, v, _ = rig_from_plane[:3, :3].T @ (point - origin)
        gradient = world.light.gradient_per_mm
        return u, v, world.light.level * (1 + gradient[0] * point[0] + gradient[1] * point[1])

    *_, light = hit(world.table.rig_from_table)
    value = world.table.surface.albedo * light
    for placed in world.parts:
        u, v, light = hit(placed.rig_from_part)
        if not shape_covers(placed.part.outline, u, v):
            continue
        behind, value = value, placed.part.surface.albedo * light
        for mark in placed.part.marks:
            if shape_covers(mark.shape, u, v):
                value = mark.albedo * light
        for hole in placed.part.holes:
            if shape_covers(hole.shape, u, v):
                value = hole.transmission * behind
    return value


def sensor_expose(
    radiance: FloatArray, normal: FloatArray, sensor: scene.Sensor, exposure_us: float, gain_db: float
) -> Image:
    """Grey values for given radiance and standard normal noise."""
    image = np.empty(radiance.shape, np.uint8)
    for index in np.ndindex(radiance.shape):
        share_of_well = radiance[index] * sensor.white / 255 * exposure_us / sensor.nominal_exposure_us
        electrons = share_of_well * sensor.full_well_e
        electrons += normal[index] * math.sqrt(electrons + sensor.read_noise_e**2)
        grey = sensor.black + electrons / sensor.full_well_e * 255 * 10 ** (gain_db / 20)
        image[index] = max(0, min(255, math.floor(grey + 0.5)))
    return image
