"""Imperfections of real cameras, put into pictures with exact truth.

Each kind affects everything (calibration, teaching and scenes were all taken this way), or only what came
after the teaching (something happened to a cell that was set up well).
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from edged.domain.arrays import SIDES, FloatArray, Image
from edged.files.images import load_image

KNOCK_ALONG_PX, KNOCK_ACROSS_PX = 1.2, 0.1
GAMMA = 0.5
FOCUS_SIGMA_PX = 1.6
COMA_PX = 3.0
VIGNETTING = 0.45
SATURATING_GAIN = 1.7
JPEG_QUALITY = 30
MOTION_PX = 7
NOISE_GREY = 12.0
DUST_SPOTS = 40
DUST_PX, DUST_DEPTH = 6.0, 0.35

Change = Callable[[Image, str, np.random.Generator], Image]


@dataclass(frozen=True, slots=True)
class Imperfection:
    """change : of a picture (H, W) uint8 of a side.  everywhere : in calibration and teaching, too."""

    change: Change
    everywhere: bool


def _to_grey(values: FloatArray) -> Image:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _knock(image: Image, side: str, _: np.random.Generator) -> Image:
    if side == "left":
        return image
    shift = np.array([[1.0, 0.0, KNOCK_ALONG_PX], [0.0, 1.0, KNOCK_ACROSS_PX]])
    moved = cv2.warpAffine(
        image, shift, image.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(moved, np.uint8)


def _gamma(image: Image, _: str, __: np.random.Generator) -> Image:
    return _to_grey(255.0 * (image / 255.0) ** GAMMA)


def _focus(image: Image, side: str, _: np.random.Generator) -> Image:
    return image if side == "left" else np.asarray(cv2.GaussianBlur(image, (0, 0), FOCUS_SIGMA_PX), np.uint8)


def _coma(image: Image, _: str, __: np.random.Generator) -> Image:
    """A comet's tail away from the centre, proportional to the distance from it: a blur with a slope."""
    height, width = image.shape
    x, y = np.meshgrid(np.arange(width) - width / 2, np.arange(height) - height / 2)
    total, weights = np.zeros(image.shape), 0.0
    for step in range(8):
        share, weight = step / 7, np.exp(-2.0 * step / 7)
        scale = share * COMA_PX / np.hypot(width / 2, height / 2)
        maps = (
            (x * (1 - scale) + width / 2).astype(np.float32),
            (y * (1 - scale) + height / 2).astype(np.float32),
        )
        total += weight * cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        weights += weight
    return _to_grey(total / weights)


def _vignetting(image: Image, _: str, __: np.random.Generator) -> Image:
    height, width = image.shape
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    return _to_grey(image * (1 - VIGNETTING * (x * x + y * y) / 2))


def _jpeg(image: Image, _: str, __: np.random.Generator) -> Image:
    _, data = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)


def _saturation(image: Image, _: str, __: np.random.Generator) -> Image:
    return _to_grey(image * SATURATING_GAIN)


def _motion(image: Image, _: str, __: np.random.Generator) -> Image:
    return np.asarray(cv2.blur(image, (MOTION_PX, 1)), np.uint8)


def _noise(image: Image, _: str, rng: np.random.Generator) -> Image:
    return _to_grey(image + rng.normal(0.0, NOISE_GREY, image.shape))


def _dust(image: Image, side: str, _: np.random.Generator) -> Image:
    """Grey spots on each lens, at the same places in all of its pictures."""
    rng = np.random.default_rng(1 if side == "left" else 2)
    shade, (height, width) = np.ones(image.shape), image.shape
    for _spot in range(DUST_SPOTS):
        x, y = rng.uniform((0, 0), (width, height))
        cv2.circle(shade, (int(x), int(y)), int(rng.uniform(1, DUST_PX)), 1 - DUST_DEPTH, -1)
    return _to_grey(image * cv2.GaussianBlur(shade, (0, 0), 2.0))


KINDS = {
    "knock": Imperfection(_knock, everywhere=False),
    "gamma": Imperfection(_gamma, everywhere=True),
    "focus": Imperfection(_focus, everywhere=True),
    "coma": Imperfection(_coma, everywhere=True),
    "vignetting": Imperfection(_vignetting, everywhere=False),
    "jpeg": Imperfection(_jpeg, everywhere=False),
    "saturation": Imperfection(_saturation, everywhere=False),
    "motion": Imperfection(_motion, everywhere=False),
    "noise": Imperfection(_noise, everywhere=False),
    "dust": Imperfection(_dust, everywhere=False),
}


def degraded(dataset: Path, kind: str, folder: Path) -> Path:
    """A copy of a data set (rig.json, calib_chess/, teach/, table3/, scenes/) with one imperfection."""
    one, target = KINDS[kind], folder / f"{dataset.name}_{kind}"
    rng = np.random.default_rng(0)
    for name in ("calib_chess", "teach", "table3", "scenes"):
        changes = one.everywhere or name in ("table3", "scenes")
        (target / name).mkdir(parents=True)
        for path in sorted((dataset / name).glob("*")):
            side = path.stem.rpartition("_")[2]
            if changes and path.suffix == ".png" and side in SIDES:
                cv2.imwrite(str(target / name / path.name), one.change(load_image(path), side, rng))
            else:
                shutil.copy(path, target / name)
    shutil.copy(dataset / "rig.json", target)
    return target
