"""Documents of trying a job, for the page: the newest pair, the still test, the working volume."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from edged.domain.numerals import known
from edged.setup.documents import Frozen, SigmaXyz, Trouble
from edged.setup.trials.sigmamap import SigmaMap
from edged.setup.trials.stilltest import StillResult, StillVerdict
from edged.setup.trials.tried import TriedPart, sigma_of


class TrialDocument(Frozen):
    """State of the trial. number : of the live pair. status : OK, LOW_QUALITY, NO_TARGET; null if none yet.

    words_code : the first reason, or OK. trouble : why the pair could not be measured at all.
    covered : places in the rig's frame, mm, where a part was good, as x, y, z. covered_share : of the working
    volume, null while its map is not known.
    """

    on: bool
    job: str | None = None
    teaching: str | None = None
    name: str = ""
    number: int = 0
    status: str | None = None
    words_code: str | None = None
    reasons: list[str] = []  # noqa: RUF012  (pydantic copies it)
    targets: list[TriedPart] = []  # noqa: RUF012  (likewise)
    limit_um: float | None = None
    covered: list[list[float]] = []  # noqa: RUF012  (likewise)
    covered_share: float | None = None
    trouble: Trouble | None = None


class StillDocument(Frozen):
    """A still test. edges_um : the edges' share of the stated sigma. noise_um : its part due to noise.

    chi2 : variance of the scatter relative to that explained by noise, or to the stated one if the noise is
    not known. expected : interval where it should lie. verdict : "larger", "smaller": the scatter is larger
    or smaller than explained or stated; "moving": the part moved; "vanished": it was not found. covers : the
    stated sigma covers the scatter; null if not judged.
    """

    at: str
    by: str
    name: str
    calibration: str
    n: int
    scatter_um: SigmaXyz | None
    edges_um: SigmaXyz | None
    noise_um: SigmaXyz | None = None
    chi2: float | None
    expected: tuple[float, float]
    verdict: StillVerdict
    covers: bool | None = None


class Stills(Frozen):
    """The last still test, if there was one."""

    last: StillDocument | None


class MapPoint(Frozen):
    """A position of the reference point, mm, rig frame. sigma_um : null if the part is not in both pictures.

    left : raw px of the left picture; null outside its lens's field of view.
    """

    x: float
    y: float
    z: float
    sigma_um: SigmaXyz | None
    left: list[float] | None


class MapDocument(Frozen):
    """Expected sigma from edges and calibration, X, Y, Z in the rig's frame, of the part as at teaching.

    points : x runs fastest, then y, then z. measured : with the edge quality of the last pair, else a usual
    one.
    """

    name: str
    columns: int
    rows: int
    layers: int
    measured: bool
    limit_um: float = Field(description="of each coordinate: beyond it a part is refused")
    points: list[MapPoint]


def map_document(name: str, found: SigmaMap, *, measured: bool) -> MapDocument:
    """Document of a map."""
    columns, rows, layers = (len(axis) for axis in found.axes)
    points = []
    for place, sigma, left in zip(found.places_mm.tolist(), found.sigma_mm, found.left_px, strict=True):
        x, y, z = (round(value, 3) for value in place)
        shown = [round(value, 1) for value in left.tolist()] if np.isfinite(left).all() else None
        expected = sigma_of(sigma) if np.isfinite(sigma).all() else None
        points.append(MapPoint(x=x, y=y, z=z, sigma_um=expected, left=shown))
    return MapDocument(
        name=name,
        columns=columns,
        rows=rows,
        layers=layers,
        measured=measured,
        limit_um=1e3 * found.limit_mm,
        points=points,
    )


def still_document(found: StillResult, name: str, calibration: str, at: str, by: str) -> StillDocument:
    """Document of a still test."""
    low, high = found.expected
    return StillDocument(
        at=at,
        by=by,
        name=name,
        calibration=calibration,
        n=found.pictures,
        scatter_um=None if found.scatter_mm is None else sigma_of(found.scatter_mm),
        edges_um=None if found.edges_mm is None else sigma_of(found.edges_mm),
        noise_um=None if found.noise_mm is None else sigma_of(found.noise_mm),
        chi2=known(found.chi2, 3),
        expected=(round(low, 3), round(high, 3)),
        verdict=found.verdict,
        covers=found.covers,
    )
