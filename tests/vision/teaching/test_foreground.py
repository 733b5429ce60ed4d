"""The place of a part in a picture: for light, dark and two-coloured parts on a textured table."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from edged.domain.arrays import Image
from edged.errors import TeachError
from edged.vision.teaching.foreground import likely_part, parts_at
from edged.vision.teaching.region import PolygonRegion

WIDTH, HEIGHT = 640, 480


def table(grey: float, contrast: float, seed: int = 0, slope: float = 0.0) -> np.ndarray:
    """A texture with features of some px, and light that falls off to one side."""
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(rng.normal(0, 1, (HEIGHT, WIDTH)), (0, 0), 4.0)
    fall = 1 + slope * (np.arange(WIDTH) / WIDTH - 0.5)
    return grey * fall * (1 + contrast * texture / texture.std())


def part(shape: str) -> Image:
    """(H, W) uint8 255 inside of a plate in the middle: an L, or a ring with a hole."""
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    if shape == "ring":
        cv2.circle(mask, (330, 240), 120, 255, -1)
    else:
        corners = np.array([[200, 120], [300, 110], [310, 290], [460, 280], [470, 370], [210, 390]])
        cv2.fillPoly(mask, [corners], 255)
    return mask


def picture(ground: np.ndarray, mask: Image, *greys: float) -> Image:
    """The part in one grey or its halves in two, with a dark hole, blurred as by a lens; with noise."""
    image, inside = ground.copy(), mask > 0
    image[inside] = greys[0]
    image[inside & (np.arange(WIDTH) > 330)] = greys[-1]
    if mask[240, 330]:
        cv2.circle(image, (330, 240), 35, 0.5 * float(ground.mean()), -1)
    image = cv2.GaussianBlur(image, (0, 0), 1.0) + np.random.default_rng(9).normal(0, 3, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def check_around(corners: np.ndarray, mask: Image) -> None:
    """Check that all of the part is inside, and little else."""
    inside = PolygonRegion(corners).painted(WIDTH, HEIGHT)
    assert not np.any((mask > 0) & (inside == 0)), "a piece of the part is outside"
    wide = cv2.dilate(mask, np.ones((41, 41), np.uint8))
    assert not np.any((inside > 0) & (wide == 0)), "more than a margin of the table is inside"


@pytest.mark.parametrize("shape", ["L", "ring"])
@pytest.mark.parametrize(
    ("grey", "contrast", "slope", "greys"),
    [
        (40.0, 0.25, 0.0, (150.0,)),
        (170.0, 0.12, 0.0, (60.0,)),
        (110.0, 0.08, 0.0, (190.0, 40.0)),
        (60.0, 0.2, 0.6, (150.0,)),
    ],
    ids=["light", "dark", "light and dark", "in a falling light"],
)
def test_a_part_is_found_with_and_without_a_tap(
    shape: str, grey: float, contrast: float, slope: float, greys: tuple[float, ...]
) -> None:
    """The part's outline is within the region with a margin, whether part or table is brighter."""
    mask = part(shape)
    image = picture(table(grey, contrast, slope=slope), mask, *greys)

    found = likely_part(image)

    assert found is not None
    check_around(found, mask)
    tapped = parts_at(image, 270.0, 250.0)
    check_around(tapped[0], mask)


def test_tapped_in_its_hole_a_part_comes_before_the_hole() -> None:
    """For a tap in its hole the ring comes first and the hole next."""
    image = picture(table(40.0, 0.25), part("ring"), 150.0)
    ring, hole = parts_at(image, 330.0, 240.0)
    check_around(ring, part("ring"))
    inside = PolygonRegion(hole).painted(WIDTH, HEIGHT)
    assert np.pi * 35**2 < np.count_nonzero(inside) < np.pi * 55**2


def test_nothing_is_found_where_nothing_is() -> None:
    """A table's texture, with or without a tap, and a picture of one grey show no part."""
    bare = np.clip(table(90.0, 0.2), 0, 255).astype(np.uint8)
    assert None is likely_part(bare)
    with pytest.raises(TeachError, match="nothing with a clear outline was tapped at 300, 200 px"):
        parts_at(bare, 300.0, 200.0)
    assert None is likely_part(np.full((HEIGHT, WIDTH), 80, np.uint8))
