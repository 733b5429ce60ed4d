"""Documents of registration drafts, served under /api/v1 and sent to every open page."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.numerals import known
from edged.robot.errormap import error_map
from edged.robot.orientations import Brand, transform_of
from edged.robot.pendant import PENDANTS, READING_CODES, brands_of, mm_per_unit
from edged.robot.readings import PoseFormat
from edged.setup.documents import DraftHead, DraftSummary, Frozen, Message, PicturePaths, Trouble
from edged.setup.inuse import RigInUse
from edged.setup.registration.model import Place, RegistrationState, SkyDocument
from edged.setup.registration.verdict import Judged, Row
from edged.setup.registration.work import marks_at
from edged.vision.boards.board import parse_boards
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply

PLACE = "/api/v1/registrations"
WANTED = {"touch": 6, "poses": 10}
"""Samples that a good registration has; with fewer, mistakes are hard to detect."""
ROBOT = "a robot's program"
"""Author of drafts that a robot's program fills."""
FLAT_SHARE = 0.05
"""Points whose smallest extent is less than this share of the largest one lie in one plane."""
MM = ("X", "Y", "Z")


class BrandDocument(Frozen):
    """How a brand's pendant shows a pose: labels, and the unit of each."""

    id: Brand
    labels: list[str]
    units: list[str]


class AtRobot(Frozen):
    """Position of a place by the solved registration, as the robot's pendant shows positions."""

    numbers: list[float]
    text: str


class PlaceDocument(Frozen):
    """A place to touch. sample : the one that touched it in this picture. wanted : best one to touch next."""

    key: str
    kind: str
    name: str
    rig_mm: list[float]
    left: list[float]
    right: list[float]
    sample: str | None
    wanted: bool
    robot: AtRobot | None


class PicturesDocument(PicturePaths):
    """A pair of pictures, as paths; places are in px of a picture of this width and height."""

    name: str
    width: int
    height: int


class SampleDocument(Frozen):
    """A point or a pose. why : reason why it does not count: "left_out", "not_seen", "length" (the board's is
    wrong), "no_numbers", "misfit" (numbers of another brand) or "outlier"; null: it counts.
    """

    name: str
    place: str | None
    kind: str | None
    rig_mm: list[float] | None
    numbers: list[float] | None
    text: str | None
    used: bool
    why: str | None
    why_text: Message | None
    residual_mm: float | None
    held_out_mm: float | None
    held_out_deg: float | None
    pictures: PicturesDocument | None


class ReadingDocument(Frozen):
    """A way to read the poses. said : it is the one that the user stated."""

    code: str
    orientation: str
    length_unit: str
    mount: str
    brands: list[Brand]
    rms_mm: float
    said: bool


class ConfirmedDocument(Frozen):
    """A place that was touched after solving. off_mm : robot minus expected. distance_mm : its length."""

    place: str
    numbers: list[float]
    off_mm: list[float]
    distance_mm: float


class RegistrationDocument(DraftHead):
    """A draft. by_program : the robot's own program fills it. stale : the cell has another calibration now.

    advice : code of what to do next. conventions : ranked, best first. missing : rotations that the poses
    lack: "all", "tilt", "wrist". good : it may be solved. figures : of all samples that count.
    """

    by_program: bool
    mount: str
    kind: str
    brand: Brand | None
    labels: list[str]
    units: list[str]
    board: str
    limit_mm: float
    calibration: str
    stale: bool
    samples: list[SampleDocument]
    wanted: int
    places: list[PlaceDocument]
    looked: PicturesDocument | None
    look_reason: str | None
    look_length_percent: float | None
    judging: bool
    trouble: Trouble | None
    culprit: str | None
    figures: dict[str, float]
    sigma_mm: list[float] | None
    sigma_deg: list[float] | None
    conventions: list[ReadingDocument]
    sky: list[SkyDocument]
    missing: str | None
    advice: str | None
    good: bool
    solved: bool
    confirmed: ConfirmedDocument | None


class RegistrationLine(DraftSummary):
    """A draft in the list. trouble : why it cannot be read."""

    kind: str = ""
    mount: str = ""
    samples: int = 0


class RobotMapPoint(Frozen):
    """A touched place in the robot's frame, mm. off_mm : position that the robot showed minus the place."""

    place_mm: list[float]
    off_mm: list[float]


class RobotMapDocument(Frozen):
    """The map of the robot's error that the cell uses; the same figures as over Zenoh."""

    degree: int
    alone_mm: float
    held_out_mm: float
    noise_mm: float
    points: list[RobotMapPoint]


class RegistrationList(Frozen):
    """All drafts, newest first. brands : those that a draft may state. robot_map : of the rig in use."""

    registrations: list[RegistrationLine]
    brands: list[BrandDocument]
    robot_map: RobotMapDocument | None = None


class Conventions(Frozen):
    """Ways to read the poses, best first; empty with fewer than four poses."""

    conventions: list[ReadingDocument]


def map_of(rig: RigInUse | None) -> RobotMapDocument | None:
    """Map of the robot's error in a rig; None without one."""
    made = None if rig is None else rig.stereo().robot_map
    if made is None:
        return None
    found = error_map(made).figures
    off = made.shown_mm - made.expected_mm
    both = zip(made.expected_mm.tolist(), off.tolist(), strict=True)
    return RobotMapDocument(
        degree=found.degree,
        alone_mm=found.alone_mm,
        held_out_mm=found.held_out_mm,
        noise_mm=found.noise_mm,
        points=[RobotMapPoint(place_mm=place, off_mm=off_mm) for place, off_mm in both],
    )


def brands() -> list[BrandDocument]:
    """All known brands of robots."""
    return [
        BrandDocument(id=brand, labels=list(pendant.labels), units=list(pendant.units))
        for brand, pendant in PENDANTS.items()
    ]


def is_active(state: RegistrationState, rig: RigInUse | None) -> bool:
    """Whether the cell uses the rig that the draft was solved to."""
    solved = state.solved
    return solved is not None and rig is not None and solved.digest == hashlib.sha256(rig.content).hexdigest()


def document_of(
    state: RegistrationState, judged: Judged, rig: RigInUse | None, solved: StereoRig | None, *, judging: bool
) -> RegistrationDocument:
    """Document of a draft. solved : the registered rig. judging : `judged` is outdated, being recomputed."""
    in_use = None if rig is None else rig.stereo()
    pendant = None if state.brand is None else PENDANTS[state.brand]
    labels, units = (MM, ("mm",) * 3) if pendant is None else (pendant.labels, pendant.units)
    shown = 3 if state.kind == "touch" else None
    is_known = all(map(math.isfinite, judged.sigma))
    places, looked = _places(state, in_use, solved, judged)
    return RegistrationDocument(
        **state.head,
        **state.model_dump(include={"mount", "kind", "brand", "board", "limit_mm"}),
        by_program=state.author == ROBOT,
        labels=list(labels[:shown]),
        units=list(units[:shown]),
        calibration=state.calibration_id,
        stale=rig is None or rig.calibration_id != state.calibration_id,
        samples=[_sample(state, name, judged, in_use) for name in state.taken],
        wanted=WANTED[state.kind],
        places=places,
        looked=looked,
        look_reason=None if state.looked is None else state.looked.reason or None,
        look_length_percent=None if state.looked is None else state.looked.length_percent,
        judging=judging,
        trouble=judged.trouble,
        culprit=judged.culprit,
        figures={name: value for name, value in judged.figures.items() if math.isfinite(value)},
        sigma_mm=list(judged.sigma[:3]) if is_known else None,
        sigma_deg=list(judged.sigma[3:]) if is_known else None,
        conventions=readings_in(judged),
        sky=list(judged.sky.values()),
        missing=judged.missing or None,
        advice=_advice(state, judged),
        good=judged.registered is not None,
        solved=state.solved is not None,
        confirmed=_confirmed(state),
        active=is_active(state, rig),
    )


def readings_in(judged: Judged) -> list[ReadingDocument]:
    """The five best readings of the poses, and the stated one."""
    shown = [*range(min(5, len(judged.readings)))]
    if judged.stated is not None and judged.stated not in shown:
        shown.append(judged.stated)
    return [_reading(judged.readings[rank], is_stated=rank == judged.stated) for rank in shown]


def _reading(reading: PoseFormat, *, is_stated: bool) -> ReadingDocument:
    return ReadingDocument(
        code=READING_CODES[reading.orientation],
        orientation=reading.orientation,
        length_unit=reading.length_unit,
        mount="fixed" if reading.mount == "eye-to-hand" else "flange",
        brands=list(brands_of(reading.orientation, reading.length_unit)),
        rms_mm=reading.rms_mm,
        said=is_stated,
    )


def _sample(state: RegistrationState, name: str, judged: Judged, rig: StereoRig | None) -> SampleDocument:
    sample, numbers = state.samples[name], state.numbers.get(name)
    row, place = judged.rows.get(name, Row()), sample.place
    why, text = None, None
    if name not in state.used:
        why = "left_out"
    elif sample.reason:
        why, text = "not_seen" if sample.length_percent is None else "length", sample.reason
    elif numbers is None:
        why = "no_numbers"
    elif state.kind == "poses" and not _is_whole(state, numbers):
        why = "misfit"
    elif not row.is_used:
        why = "outlier"
    return SampleDocument(
        name=name,
        place=place and place.key,
        kind=place and place.kind,
        rig_mm=place and list(place.rig_mm),
        numbers=numbers and list(numbers),
        text=numbers and _text(state, numbers),
        used=why is None,
        why=why,
        why_text=text,
        residual_mm=known(row.residual_mm),
        held_out_mm=known(row.held_out_mm),
        held_out_deg=known(row.held_out_deg),
        pictures=None if place is not None else _pictures(state, name, rig),
    )


def _is_whole(state: RegistrationState, numbers: tuple[float, ...]) -> bool:
    return state.brand is None or len(numbers) == len(PENDANTS[state.brand].labels)


def _text(state: RegistrationState, numbers: tuple[float, ...]) -> str:
    pendant = None if state.brand is None else PENDANTS[state.brand]
    if pendant is None or len(numbers) > len(pendant.labels):
        return ", ".join(f"{number:g}" for number in numbers)
    return pendant.text(numbers)


def _pictures(state: RegistrationState, name: str, rig: StereoRig | None) -> PicturesDocument | None:
    if rig is None:
        return None
    left, right = (f"{PLACE}/{state.id}/pictures/{name}/{side}.jpg" for side in ("left", "right"))
    return PicturesDocument(name=name, left=left, right=right, width=rig.left.width, height=rig.left.height)


# --- places ---------------------------------------------------------------------------------------


def _places(
    state: RegistrationState, rig: StereoRig | None, solved: StereoRig | None, judged: Judged
) -> tuple[list[PlaceDocument], PicturesDocument | None]:
    """Places that can be touched, and the pictures that show them."""
    if rig is None:
        return [], None
    robot_from_rig = None
    places: Sequence[Place] = ()
    name = None
    if state.mount == "fixed" and state.looked is not None:
        places, name = state.looked.places, state.looked.name
        robot_from_rig = None if solved is None else solved.robot_from_rig
    elif state.mount == "flange" and solved is not None and state.brand is not None:
        # the board does not move: the last pose in use shows where it is
        name = next((pose for pose in reversed(state.used) if pose in judged.rows), None)
        if name is not None and solved.flange_from_rig is not None:
            view = np.array(state.samples[name].view)
            places = marks_at(rig, parse_boards(state.board)[0], view)
            robot_from_rig = transform_of(state.brand, state.numbers[name]) @ solved.flange_from_rig
    touched = {
        place.key: sample
        for sample in state.used
        if (place := state.samples[sample].place) is not None and state.samples[sample].look == name
    }
    wanted = _wanted(state, places)
    documents = [
        PlaceDocument(
            **place.model_dump(),
            sample=touched.get(place.key),
            wanted=place.key == wanted,
            robot=None if robot_from_rig is None else _at_robot(state, robot_from_rig, place),
        )
        for place in places
    ]
    return documents, None if name is None else _pictures(state, name, rig)


def _at_robot(state: RegistrationState, robot_from_rig: FloatArray, place: Place) -> AtRobot:
    at_mm = apply(robot_from_rig, np.array([place.rig_mm]))[0]
    x, y, z = (at_mm / (1.0 if state.brand is None else mm_per_unit(state.brand))).tolist()
    if state.brand is None:
        return AtRobot(numbers=[x, y, z], text=f"X {x:.2f}, Y {y:.2f}, Z {z:.2f}")
    return AtRobot(numbers=[x, y, z], text=PENDANTS[state.brand].text((x, y, z)))


def _touched_mm(state: RegistrationState) -> FloatArray:
    """Touched points in use, (N, 3) mm in the rig's frame."""
    places = [state.samples[name].place for name in state.used]
    return np.array([place.rig_mm for place in places if place is not None]).reshape(-1, 3)


def _wanted(state: RegistrationState, places: Sequence[Place]) -> str | None:
    """Key of the place that is farthest from all touched ones, as it tells the most."""
    if not places:
        return None
    offered = np.array([place.rig_mm for place in places])
    there = _touched_mm(state)
    others = there if len(there) else offered.mean(axis=0)[None]
    distances = np.linalg.norm(offered[:, None] - others, axis=2).min(axis=1)
    return places[int(np.argmax(distances))].key


def _advice(state: RegistrationState, judged: Judged) -> str | None:
    """Code of what would improve it: a missing rotation, "flat" for points in one plane, or "more"; None."""
    if state.kind == "poses" and judged.missing:
        return judged.missing
    there = _touched_mm(state)
    if state.kind == "touch" and len(there) >= WANTED["touch"] // 2:
        spread = np.linalg.svd(there - there.mean(axis=0), compute_uv=False)
        if spread[2] < FLAT_SHARE * spread[0]:
            return "flat"
    return "more" if len(state.used) < WANTED[state.kind] else None


def _confirmed(state: RegistrationState) -> ConfirmedDocument | None:
    confirmed = state.confirmed
    if confirmed is None:
        return None
    return ConfirmedDocument(
        place=confirmed.place.key,
        numbers=list(confirmed.numbers),
        off_mm=list(confirmed.off_mm),
        distance_mm=math.hypot(*confirmed.off_mm),
    )
