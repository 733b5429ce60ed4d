"""Trays and pallets: the pocket in which a part lies. Pure functions of the layout."""

from __future__ import annotations

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.picking import Tray


def centres_mm(tray: Tray) -> FloatArray:
    """Centres of all pockets (N, 3), in the order of their numbers."""
    first, places = np.array(tray.first_mm), np.zeros((1, 3))
    for end_mm, count in zip(tray.ends_mm, tray.counts, strict=True):
        steps = np.linspace(0.0, 1.0, count)[:, np.newaxis, np.newaxis] * (np.array(end_mm) - first)
        places = (steps + places).reshape(-1, 3)
    return first + places


def pocket_of(tray: Tray, place_mm: FloatArray) -> int:
    """Number of the pocket in which a point (3,) lies, from 1; 0: in none."""
    apart_mm = np.linalg.norm(centres_mm(tray) - place_mm, axis=1)
    nearest = int(np.argmin(apart_mm))
    return nearest + 1 if apart_mm[nearest] <= tray.tolerance_mm else 0


def step_mm(tray: Tray) -> float:
    """Distance between the two nearest pockets; inf for a single pocket."""
    centres = centres_mm(tray)
    apart_mm = np.linalg.norm(centres[:, np.newaxis] - centres, axis=2)
    np.fill_diagonal(apart_mm, np.inf)
    return float(apart_mm.min())
