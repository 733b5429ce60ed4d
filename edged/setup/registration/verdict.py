"""Verdict on the samples of a registration so far, computed after each of them; nothing is saved.

The figures are the same as those of `edged register`: the same functions of the same samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.registration import UNKNOWN_6
from edged.errors import CalibrationError
from edged.robot.handeye import MIN_POSES, MIN_TURN_RAD, Mount, turns_of
from edged.robot.orientations import LENGTH_UNITS_MM, POSE_FORMATS, Brand, transform_of
from edged.robot.pendant import READING_CODES, brands_of, mm_per_unit
from edged.robot.readings import PoseFormat, rank_readings
from edged.robot.touch import TWIN_SHARE
from edged.setup.documents import Trouble
from edged.setup.registration.model import SkyDocument
from edged.setup.registration.registering import (
    DECIDED,
    FromPoints,
    RegisteredRig,
    from_points,
    from_poses,
    in_words,
    stands_out,
)
from edged.setup.registration.sampling import TRIED, sigma_at
from edged.vision.boards.board import NominalBoard
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply

LEAST_POINTS = 3
UNSOLVED = "calibration"
"""Code of samples that give no result, for a reason without a code of its own."""
WRIST_SHARE = 0.7
"""A turn whose axis is nearer to the flange's own than this cosine turns the wrist; another one tilts it."""
_UNITS_MM = {"µm": 0.001, "mm": 1.0, "cm": 10.0, "inch": 25.4, "m": 1000.0}


@dataclass(frozen=True, slots=True)
class Row:
    """Residuals of one sample against the fit of all, and against the fit of all others.

    NaN where not known, such as degrees of points. is_used : it is not rejected as an outlier.
    """

    residual_mm: float = math.nan
    held_out_mm: float = math.nan
    held_out_deg: float = math.nan
    is_used: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Verdict on the samples so far.

    rows, sky : by the sample's name. culprit : the sample that is wrong, or agrees least if they disagree.
    missing : rotation that the poses lack: "all", "tilt" or "wrist"; "" if they turn enough.
    readings : ranked, best first; empty with fewer than four poses. stated : rank of the stated one among
    them. figures : of the fit, mm. registered : set only if the result is good.
    """

    rows: Mapping[str, Row] = field(default_factory=dict)
    trouble: Trouble | None = None
    culprit: str | None = None
    figures: Mapping[str, float] = field(default_factory=dict)
    sigma: tuple[float, ...] = UNKNOWN_6
    sky: Mapping[str, SkyDocument] = field(default_factory=dict)
    missing: str = ""
    readings: tuple[PoseFormat, ...] = ()
    stated: int | None = None
    registered: RegisteredRig | None = None


# --- by touched points ----------------------------------------------------------------------------


def judge_points(
    rig: StereoRig,
    touched: Mapping[str, tuple[FloatArray, tuple[float, ...]]],
    brand: Brand | None,
    limit_mm: float,
) -> Judged:
    """Judge points (3,), mm in the rig's frame, against the numbers of the robot; in mm without a brand."""
    names = list(touched)
    if len(names) < LEAST_POINTS:
        return Judged(trouble=_too_few(len(names), LEAST_POINTS))
    unit_mm = 1.0 if brand is None else mm_per_unit(brand)
    rig_mm = np.array([place for place, _ in touched.values()])
    robot_mm = np.array([numbers[:3] for _, numbers in touched.values()]) * unit_mm
    try:
        solved = from_points(rig, rig_mm, robot_mm, limit_mm)
    except CalibrationError as error:
        return Judged(trouble=_of_points(error, names, rig_mm, robot_mm, unit_mm))
    found = solved.found
    rows = {
        name: Row(*values)
        for name, *values in zip(names, found.residuals_mm.tolist(), found.held_out_mm.tolist(), strict=True)
    }
    culprit = None if solved.good or found.culprit is None else names[found.culprit]
    trouble = _trouble_of_points(solved, culprit, names, limit_mm)
    return Judged(
        rows,
        trouble,
        culprit,
        {
            "rms_mm": found.rms_mm,
            "worst_mm": solved.worst_mm,
            "scale": found.scale,
            "sigma_scale": found.sigma_scale,
        },
        sigma_at(found.covariance, robot_mm.mean(axis=0)),
        registered=solved.registered if trouble is None else None,
    )


def _trouble_of_points(
    solved: FromPoints, culprit: str | None, names: list[str], limit_mm: float
) -> Trouble | None:
    found = solved.found
    if culprit is not None:
        k = names.index(culprit)
        off, others = float(found.held_out_mm[k]), float(found.others_rms_mm[k])
        text = f"{culprit} is wrong by {off:.3f} mm: without it the others agree to {others:.3f} mm"
        return _trouble("culprit", text, name=culprit, mm=off, others=others)
    if solved.doubt:
        percent = 100 * (found.scale - 1)
        text = f"the robot's lengths differ by {percent:+.2f} %: is the board's length right?"
        return _trouble("scale", text, percent=percent, sigma=100 * found.sigma_scale)
    return None if solved.good else _disagree(solved.worst_mm, limit_mm)


def _of_points(
    error: CalibrationError, names: list[str], rig_mm: FloatArray, robot_mm: FloatArray, unit_mm: float
) -> Trouble:
    params: dict[str, str | float] = {}
    if error.code == "other_units":
        ratio = _length_of(robot_mm) / _length_of(rig_mm) / unit_mm
        nearest = min(_UNITS_MM, key=lambda unit: abs(math.log(ratio * _UNITS_MM[unit])))
        params = {"unit": nearest}
    for points in (rig_mm, robot_mm):
        apart = np.linalg.norm(points[:, None] - points, axis=2)
        twins = np.argwhere(np.triu(apart < TWIN_SHARE * apart.max(), 1))
        if len(twins) and not params:
            params = {"one": names[twins[0][0]], "two": names[twins[0][1]]}
    return _trouble(error.code or UNSOLVED, str(error), **params)


def _length_of(points: FloatArray) -> float:
    return float(np.linalg.norm(points - points.mean(axis=0)))


# --- by poses and a board -------------------------------------------------------------------------


def judge_poses(
    rig: StereoRig,
    posed: Mapping[str, tuple[FloatArray, tuple[float, ...]]],
    board: NominalBoard,
    brand: Brand | None,
    mount: Mount,
    limit_mm: float,
) -> Judged:
    """Judge views (4, 4) of the board against the pose of the flange as the robot showed it.

    Without a brand only the readings are known.
    """
    posed = {name: sample for name, sample in posed.items() if _fits(sample[1], brand)}
    readings, stated = _ranked(posed, board, brand, mount)
    if brand is None:
        missing = _trouble("no_brand", "whose robot is it? The poses are not read without")
        return Judged(trouble=missing, readings=readings)
    flanges = {name: transform_of(brand, numbers) for name, (_, numbers) in posed.items()}
    other = _other_reading(readings, stated)
    known = Judged(readings=readings, stated=stated)
    if other is None:  # numbers that are read wrongly tell nothing about rotations
        known = replace(known, sky=_sky(flanges), missing=_missing(list(flanges.values())))
    if len(posed) < MIN_POSES:
        return replace(known, trouble=_too_few(len(posed), MIN_POSES))
    views = {name: view for name, (view, _) in posed.items()}
    try:
        solved = from_poses(rig, flanges, views, board, mount, limit_mm)
    except CalibrationError as error:
        return replace(known, trouble=other or _trouble(error.code or UNSOLVED, str(error)))
    except np.linalg.LinAlgError as error:
        return replace(known, trouble=other or _trouble(UNSOLVED, str(error)))
    found = solved.found
    rows = {
        name: Row(math.nan, held_mm, math.degrees(held_rad), bool(used))
        for name, held_mm, held_rad, used in zip(
            views, found.held_out_mm.tolist(), found.held_out_rad.tolist(), found.used, strict=True
        )
    }
    middle = board.points_mm.mean(axis=0)
    places = np.array([apply(found.rig @ view, middle[None])[0] for view in views.values()])
    trouble = other or (None if solved.good else _disagree(solved.held_out_rms_mm, limit_mm))
    return replace(
        known,
        rows=rows,
        trouble=trouble,
        culprit=None if solved.worst is None else list(views)[solved.worst],
        figures={"rms_mm": found.rms_mm, "worst_mm": solved.held_out_rms_mm},
        sigma=sigma_at(found.covariance, places.mean(axis=0)),
        registered=solved.registered if trouble is None else None,
    )


def _fits(numbers: tuple[float, ...], brand: Brand | None) -> bool:
    if brand is None:
        return True
    try:
        transform_of(brand, numbers)
    except ValueError:
        return False
    return True


def _ranked(
    posed: Mapping[str, tuple[FloatArray, tuple[float, ...]]],
    board: NominalBoard,
    brand: Brand | None,
    mount: Mount,
) -> tuple[tuple[PoseFormat, ...], int | None]:
    """All ways to read the poses, best first, and the rank of the stated one."""
    if len(posed) < MIN_POSES:
        return (), None
    names = list(posed)
    some = np.linspace(0, len(names) - 1, min(len(names), TRIED)).round().astype(int)
    views, numbers = zip(*(posed[names[k]] for k in some), strict=True)
    try:
        ranked = rank_readings(numbers, views, board.points_mm, POSE_FORMATS, LENGTH_UNITS_MM)
    except CalibrationError:
        return (), None
    ranks = (
        rank
        for rank, reading in enumerate(ranked)
        if reading.mount == mount and brand in brands_of(reading.orientation, reading.length_unit)
    )
    return tuple(ranked), next(ranks, None)


def _other_reading(readings: tuple[PoseFormat, ...], stated: int | None) -> Trouble | None:
    """Trouble naming a reading that fits so much better than the stated one that it must be right, if any."""
    if not readings:
        return None
    best = readings[0]
    if not stands_out(readings) or (stated is not None and readings[stated].rms_mm <= DECIDED * best.rms_mm):
        return None
    brands = brands_of(best.orientation, best.length_unit)
    params: dict[str, str | float] = {
        "orientation": READING_CODES[best.orientation],
        "unit": best.length_unit,
        "mount": "fixed" if best.mount == "eye-to-hand" else "flange",
        "brand": brands[0].value if brands else "",
        "mm": best.rms_mm,
    }
    return _trouble("other_reading", in_words(best), **params)


def _missing(flanges: list[FloatArray]) -> str:
    if len(flanges) < 2:
        return ""
    turns = turns_of(flanges)
    if turns.are_enough:
        return ""
    if turns.largest_rad < MIN_TURN_RAD:
        return "all"
    return "tilt" if abs(turns.axis[2]) > WRIST_SHARE else "wrist"


def _sky(flanges: Mapping[str, FloatArray]) -> dict[str, SkyDocument]:
    """Direction of each flange's axis relative to the first flange, and the rotation about it."""
    points = {}
    first = next(iter(flanges.values()), np.eye(4))
    for name, flange in flanges.items():
        turn = first[:3, :3].T @ flange[:3, :3]
        tilt = math.acos(max(-1.0, min(1.0, float(turn[2, 2]))))
        azimuth = math.atan2(turn[1, 2], turn[0, 2]) if tilt > 1e-9 else 0.0
        # swing-twist decomposition: the twist is about z, the swing tilts z
        twist = 2 * math.atan2(turn[1, 0] - turn[0, 1], 1 + turn[0, 0] + turn[1, 1] + turn[2, 2])
        tilt_deg, azimuth_deg, turn_deg = map(math.degrees, (tilt, azimuth, twist))
        points[name] = SkyDocument(name=name, tilt_deg=tilt_deg, azimuth_deg=azimuth_deg, turn_deg=turn_deg)
    return points


# --- both -----------------------------------------------------------------------------------------


def _trouble(code: str, text: str, **params: str | float) -> Trouble:
    return Trouble(code=code, text=text, params=params)


def _too_few(there: int, least: int) -> Trouble:
    return _trouble("too_few", f"{there}, at least {least} are needed", count=there, least=least)


def _disagree(mm: float, limit_mm: float) -> Trouble:
    text = f"they disagree by {mm:.3f} mm, the limit is {limit_mm:g} mm"
    return _trouble("disagree", text, mm=mm, limit=limit_mm)
