"""Plain twins of the kernels of `edged.vision.marks`."""

from __future__ import annotations

import math

import numpy as np

from edged.domain.arrays import FloatArray, Image
from edged.vision.marks.params import MARKS


def fit_rims_naive(image: Image, start: FloatArray) -> FloatArray:
    """`edged.vision.marks.rims.fit_rims`, with numpy's least squares and numerical derivatives."""
    result = np.full((len(start), 5), np.nan)
    result[:, 3:] = 0.0
    for n, (x, y, b11, b12, b22, blur, half) in enumerate(start.tolist()):
        determinant = b11 * b22 - b12 * b12
        if determinant <= 0:
            continue
        radius = 1 / math.sqrt(determinant)
        longer = 1 / np.linalg.eigvalsh([[b11, b12], [b12, b22]])[0]
        reach = longer * (1 + half / radius) + 1
        height, width = image.shape
        if not (reach <= x <= width - 1 - reach and reach <= y <= height - 1 - reach):
            continue
        rows, columns = np.mgrid[0:height, 0:width]
        q = np.hypot(b11 * (columns - x) + b12 * (rows - y), b12 * (columns - x) + b22 * (rows - y))
        ring = np.abs(q - 1) * radius <= half
        at, grey = np.column_stack([columns[ring], rows[ring]]).astype(float), image[ring].astype(float)
        spread = blur / radius

        def model(
            p: FloatArray, at: FloatArray = at, b=(b11, b12, b22), spread: float = spread
        ) -> FloatArray:
            dx, dy = (at - p[:2]).T
            scale = math.exp(p[2])
            r = scale * np.hypot(b[0] * dx + b[1] * dy, b[1] * dx + b[2] * dy)
            edge = np.array([math.erf(value) for value in (r - 1) / (math.sqrt(2) * spread)])
            return (p[3] + p[4] * edge) * (1 + p[5] * dx + p[6] * dy)

        inside, k = float(image[round(y), round(x)]), np.arange(16) * math.pi / 8
        around = zip(np.rint(y + reach * np.sin(k)), np.rint(x + reach * np.cos(k)), strict=True)
        outside = float(np.mean([image[int(j), int(i)] for j, i in around]))
        p = np.array([x, y, 0, 0.5 * (inside + outside), 0.5 * (outside - inside), 0, 0])
        settled = False
        for _ in range(MARKS.rim_steps):
            slopes = np.stack([(model(p + d) - model(p - d)) / 2e-6 for d in 1e-6 * np.eye(7)], axis=1)
            residual = grey - model(p)
            inverse = np.linalg.inv(slopes.T @ slopes)
            step = inverse @ slopes.T @ residual
            p = p + step
            if not math.hypot(p[0] - x, p[1] - y) < MARKS.rim_px:
                break
            if np.abs(step[:2]).max() < MARKS.settled_px:
                settled = True
                break
        if not settled:
            continue
        meat = (slopes * residual[:, None] ** 2).T @ slopes
        count = len(grey)
        variance = np.trace((inverse @ meat @ inverse)[:2, :2]) / 2 * count / (count - 7)
        contrast = 2 * abs(p[4])
        good = math.sqrt(residual @ residual / (count - 7)) < MARKS.rough * contrast
        result[n] = p[0], p[1], math.sqrt(variance), contrast, float(good)
    return result
