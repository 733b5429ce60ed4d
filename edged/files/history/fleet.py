"""Compare cells that run the same job and find those that measure differently from the rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from edged.domain.outliers import OUTLIERS, deviations, limit, outliers
from edged.files.history.query import ask
from edged.payload import Json

FIGURES = """
WITH chosen AS (SELECT *, plant || '/' || cell AS who FROM cycles WHERE day BETWEEN '{first}' AND '{last}'),
good AS (SELECT * FROM chosen WHERE status = 'OK'),
many AS (SELECT job, who FROM good GROUP BY ALL HAVING count(*) >= {min_cycles}),
size AS (SELECT job, who, unnest(sizes) AS size FROM good)
SELECT job, 'OK rate' AS figure, '' AS unit, who, avg((status = 'OK')::INT) AS value, count(*) AS noise
    FROM chosen SEMI JOIN many USING (job, who) GROUP BY ALL
UNION ALL SELECT job, 'sigma', 'mm', who,
    median(sqrt(sigma_x_mm ** 2 + sigma_y_mm ** 2 + sigma_z_mm ** 2)), 0.0
    FROM good SEMI JOIN many USING (job, who) GROUP BY ALL
UNION ALL SELECT job, 'row difference', 'px', who, median(rows_px), 0.0
    FROM good SEMI JOIN many USING (job, who) GROUP BY ALL
UNION ALL SELECT job, 'size ' || size.name, size.unit, who,
    median(size.value - coalesce(size.nominal, 0.0)), median(size.sigma)
    FROM size SEMI JOIN many USING (job, who) GROUP BY job, size.name, size.unit, who
ORDER BY ALL
"""


@dataclass(frozen=True, slots=True)
class CompareParams:
    """Thresholds of a comparison; min_cycles : good cycles that a cell needs to be compared.

    The others are spreads between cells that are ignored. sigma_share, rows_share : relative to the median,
    the effect of light and dirt. ok_rate : absolute. size_share : relative to a size's stated sigma, which a
    single measurement could not resolve either.
    """

    min_cycles: int = 50
    sigma_share: float = 0.05
    rows_share: float = 0.05
    ok_rate: float = 0.005
    size_share: float = 0.5

    def least_spread(self, figure: str, values: list[float], noise: list[float]) -> float:
        """Largest spread of a figure that is ignored. noise : cycle counts for OK rates, sigmas for sizes."""
        middle, typical = float(np.median(values)), float(np.median(noise))
        match figure:
            case "OK rate":
                by_chance = math.sqrt(middle * (1.0 - middle) / max(typical, 1.0))
                return max(self.ok_rate, by_chance)
            case "sigma":
                return self.sigma_share * abs(middle)
            case "row difference":
                return self.rows_share * abs(middle)
            case _:
                return self.size_share * typical


COMPARE = CompareParams()


@dataclass(frozen=True, slots=True)
class Differing:
    """A cell (PLANT/CELL) that differs, and by how many robust sigmas, signed."""

    cell: str
    value: float
    deviation: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """One figure of a job across its cells. limit : on deviations; None if too few cells run the job."""

    job: str
    figure: str
    unit: str
    cells: int
    median: float
    limit: float | None
    differing: tuple[Differing, ...]

    def to_json(self) -> Json:
        """JSON object with all fields."""
        return asdict(self)


def compare(
    folders: Sequence[Path | str], first: str, last: str, params: CompareParams = COMPARE
) -> list[Comparison]:
    """Compare every figure of every job over the days from first to last. Raises `UserError`."""
    wanted = FIGURES.format(first=first, last=last, min_cycles=params.min_cycles)
    groups: dict[tuple[str, str, str], list[tuple[str, float, float]]] = {}
    for job, figure, unit, who, value, noise in ask(folders, wanted)[1]:
        if value is not None:
            groups.setdefault((job, figure, unit), []).append((who, value, noise or 0.0))
    found = []
    for (job, figure, unit), rows in groups.items():
        who, values, noise = ([*column] for column in zip(*rows, strict=True))
        least = params.least_spread(figure, values, noise)
        away = deviations(np.array(values), least)
        found.append(
            Comparison(
                job,
                figure,
                unit,
                len(rows),
                float(np.median(values)),
                limit(len(rows)) if len(rows) >= OUTLIERS.min_count else None,
                tuple(
                    Differing(who[index], values[index], float(away[index]))
                    for index in outliers(np.array(values), least)
                ),
            )
        )
    return found
