#!/usr/bin/env python3
"""Which decisions about a part's rotation are wrong, and how steady they are: rendered parts of known pose.

    tools/bench decisions [--draws N] [--parts NAME,...] [--looks "NAME;..."] [--seed K] [--degrade KIND]
                          [--json FILE] [--list]

Each part has one distinguishing detail (see `distinguished`) and a plain, brushed or turned face, or is dark
on a bright table, or the taught piece was machined in another way (ground, faced or milled) than those in the
scenes: then the taught texture is found nowhere, and another texture lies everywhere. It is taught by `teach`
and found by the whole pipeline in stereo pairs of the demo's rig at half its resolution. Teaching and finding
use another calibration than the pictures: the right camera is moved by 0.02 px. A scene is a pose (any
rotation, tilted up to 5 degrees), bars and neighbours that hide up to 40 % of the part, light, gain and blur.
It is rendered once, exactly, and seen in DRAWS_PER_SCENE draws of shot and read noise. A decision is counted
for the part that is partly hidden:

silent, turned    status OK without a reason against it, and the rotation off by more than 1 degree
silent, off       ... and the position off by more than 10 sigma (and 2 µm)
refused, seen     refused or not found although most of the detail is visible, and so is each place where
                  it would be if the part were turned
agreement         share of the draws of one scene with the most frequent decision

Silent errors about its neighbours count, too. The exit status is 1 if there was any silent error.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from multiprocessing import get_context

import cv2
import numpy as np
from benching import bench_parser, finish
from distinguished import DESIGNS, HELD_OUT, Design, without_holes
from helpers.cells import PLACE_MM, frame_pair, pose, region_around, small_rig
from imperfections import KINDS

from edged.domain.arrays import FloatArray, Image
from edged.domain.measurement import Outcome, Reject, Target
from edged.errors import EdgedError, TeachError
from edged.pipeline import PreparedRig, locate, prepare
from edged.sim.render.scene import (
    Part,
    PlacedPart,
    RenderedView,
    RoundedBox,
    Scene,
    SceneLight,
    Surface,
    Table,
)
from edged.sim.views import stereo_views
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply, invert, rotation_matrix
from edged.vision.geometry.triangulation import triangulate_raw
from edged.vision.part.job import Job
from edged.vision.shape.inspection import inspect_model
from edged.vision.teaching.pair import teach

DRAWS_PER_SCENE = 8
JITTER_PX = 0.02
MAX_HIDDEN = 0.4
SEEN = 0.75
"""Visible share of the detail, here and wherever a turned part would have it, from which on a refusal counts
as unnecessary."""
TURNED_RAD, OFF_SIGMA, OFF_MM = math.radians(1.0), 10.0, 0.002
SAME_PART_MM = 4.0
TABLE_BELOW_MM = 4.0
REFERENCE_WITHIN_MM = 0.25
DARK = "dark on bright"
MACHINED = {
    "faced, seen ground": ("faced", "ground"),
    "ground, seen faced": ("ground", "faced"),
    "milled, seen ground": ("milled", "ground"),
    "ground, seen milled": ("ground", "milled"),
}
"""Finish of the taught piece, and of the pieces in the scenes."""
LOOKS = ("plain", "brushed", "turned", DARK, *MACHINED)
NOISE = 1.5
FULL_WELL = 40.0
"""Grey value per squared grey value of shot noise: 10,000 electrons at 255."""


@dataclass(frozen=True, slots=True, eq=False)
class Taught:
    """One part on one surface, taught with a slightly wrong calibration.

    part_from_job (4, 4) : from the job's part frame to the design's.
    """

    design: Design
    look: str
    rig: PreparedRig
    job: Job
    part_from_job: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """One rendered scene: radiance of both cameras, poses of its parts, hidden share of the first.

    seen : visible share of the detail, here or, if that is less, where a turned part would have it.
    """

    left: FloatArray
    right: FloatArray
    poses: tuple[FloatArray, ...]
    hidden: float
    seen: float
    gain: float


@dataclass
class Row:
    """Counts of one part on one surface."""

    name: str
    look: str
    scenes: int = 0
    draws: int = 0
    turned: int = 0
    off: int = 0
    draws_seen: int = 0
    refused: int = 0
    refused_seen: int = 0
    agreeing: int = 0
    reasons: dict[str, int] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)
    refusals: list[str] = field(default_factory=list)
    locate_ms: float = 0.0


@cache
def views() -> dict[str, RenderedView]:
    """The true cameras, made once per process."""
    return stereo_views(small_rig())


@cache
def quick_view() -> RenderedView:
    """The left camera with a quarter of the pixels: enough to determine what is hidden."""
    camera = small_rig().left
    coarse = replace(
        camera, width=camera.width // 2, height=camera.height // 2, fx=camera.fx / 2, fy=camera.fy / 2,
        cx=(camera.cx + 0.5) / 2 - 0.5, cy=(camera.cy + 0.5) / 2 - 0.5,
    )  # fmt: skip
    return RenderedView(coarse, np.eye(4))


def jittered(rig: StereoRig, rng: np.random.Generator) -> StereoRig:
    """Another calibration of this rig: by its own covariance, or with the right camera moved by 0.02 px."""
    focal = rig.right.fx
    right = replace(
        rig.right, cx=rig.right.cx + rng.normal(0, JITTER_PX), cy=rig.right.cy + rng.normal(0, JITTER_PX)
    )
    turn = rotation_matrix(rng.normal(0, JITTER_PX / focal, 3))
    moved = rig.right_from_left.copy()
    moved[:3, :3] = turn @ moved[:3, :3]
    return replace(rig, right=right, right_from_left=moved)


def albedo_of(look: str) -> float:
    """The albedo of the part's face."""
    return 0.34 if look == DARK else 0.62


def table_of(look: str, rng: np.random.Generator) -> Surface:
    """Surface of the table."""
    if look == DARK:
        return Surface(rng.uniform(0.7, 0.85), contrast=0.03, feature_mm=0.8, seed=2)
    return Surface(rng.uniform(0.1, 0.2), contrast=rng.choice([0.0, 0.25]), feature_mm=0.8, seed=2)


def world(look: str, rng: np.random.Generator, *placed: tuple[Part, FloatArray]) -> Scene:
    """Parts over a table, in slightly uneven light."""
    slope = rng.uniform(-0.004, 0.004, 2)
    table = Table(table_of(look, rng), pose((PLACE_MM[0], PLACE_MM[1], PLACE_MM[2] + TABLE_BELOW_MM)))
    light = SceneLight(1.0, (float(slope[0]), float(slope[1])))
    return Scene(table, tuple(PlacedPart(part, where) for part, where in placed), light)


def changed(kind: str | None, left: Image, right: Image, seed: tuple[int, ...]) -> tuple[Image, Image]:
    """The pair as seen by an imperfect camera (see `imperfections`)."""
    if kind is None:
        return left, right
    rng = np.random.default_rng(seed)
    change = KINDS[kind].change
    return change(left, "left", rng), change(right, "right", rng)


def teach_design(design: Design, look: str, seed: int, kind: str | None = None) -> Taught:
    """Teach a part that lies flat and whole.

    kind : of imperfection, if it was there already.
    """
    rng = np.random.default_rng((seed, 1))
    part, where = made(design, look), pose()
    scene = world(look, rng, (part, where))
    left, right = (exposed(view.radiance(scene), 1.0, rng) for view in views().values())
    left, right = changed(kind, left, right, (seed, 2))
    rig = prepare(jittered(small_rig(), rng))
    region = region_around(rig.rig, where[:3, 3], design.radius_mm + 0.6)
    job = teach(left, right, rig.rectification, region, "part")
    if inspect_model(job.shape, job.search).symmetric or job.shape.round:
        raise TeachError("its detail was not learnt: the teacher is told that it looks the same when turned")
    measured = invert(where) @ job.rig_from_part
    # exclude errors of calibration and teaching from the truth: the reference is a known point
    places = np.array([(x, y, 0.0) for x, y in design.places_mm])
    apart = np.linalg.norm(places - measured[:3, 3], axis=1)
    if apart.min() > REFERENCE_WITHIN_MM:
        raise SystemExit(f"{design.name}: its reference {measured[:3, 3]} is no point of the part")
    measured[:3, 3] = places[int(apart.argmin())]
    return Taught(design, look, rig, job, measured)


def made(design: Design, look: str, *, whole: bool = True, piece: int | None = None) -> Part:
    """The part, optionally without its detail. piece : its number in the scenes, None: the taught one."""
    finish = "plain" if look == DARK else look
    if look in MACHINED:
        finish = MACHINED[look][piece is not None]
    make = design.part if whole else design.plain
    return make(albedo_of(look), finish, 0 if piece is None else piece)


def exposed(radiance: FloatArray, gain: float, rng: np.random.Generator) -> Image:
    """Picture with shot and read noise."""
    grey = gain * (3.0 + 200.0 * radiance.astype(np.float32))
    noise = np.sqrt(gain * np.maximum(grey, 0) / FULL_WELL + np.float32((gain * NOISE) ** 2))
    grey += noise * rng.standard_normal(grey.shape, np.float32)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def draw_scene(taught: Taught, rng: np.random.Generator) -> Drawn:
    """Draw a pose, and objects in front of the part that hide at most MAX_HIDDEN of it."""
    design, look = taught.design, taught.look
    piece = int(rng.integers(1, 1000)) if look in MACHINED else 1
    part, plain = made(design, look, piece=piece), made(design, look, whole=False, piece=piece)
    place = np.array(PLACE_MM) + rng.uniform(-1, 1, 3) * (6.0, 4.0, 2.0)
    where = tilted(place, rng.uniform(-180, 180), 5.0 * math.sqrt(rng.random()), rng)
    silhouette = without_holes(part)
    light_seed = int(rng.integers(1 << 31))
    left = quick_view()

    def seen(one: Part, front: tuple[tuple[Part, FloatArray], ...]) -> FloatArray:
        scene = world(look, np.random.default_rng(light_seed), (one, where), *front)
        return left.radiance(scene).astype(np.float64)

    alone = seen(part, ())
    detail = np.abs(alone - seen(plain, ()))
    black = Scene(
        Table(Surface(0.0), world(look, rng).table.rig_from_table), (PlacedPart(silhouette, where),)
    )
    covered = left.radiance(black).astype(np.float64)
    for _ in range(50):
        front, poses = things_in_front(taught, where, rng, piece + 1000)
        if front:
            shadow = tuple(
                PlacedPart(replace(without_holes(one), surface=Surface(0.0)), at) for one, at in front
            )
            left_over = left.radiance(replace(black, parts=(*black.parts, *shadow)))
            hidden = 1.0 - float(left_over.sum() / covered.sum())
        else:
            hidden = 0.0
        if hidden <= MAX_HIDDEN:
            break
    else:
        front, poses, hidden = (), (), 0.0
    visible = 1.0
    if front:
        clear = np.where(covered > 0, left_over / np.maximum(covered, 1e-9), 1.0)
        visible = min(
            float((place * clear).sum() / place.sum())
            for place in (
                turned_image(detail, where, 2 * math.pi * k / design.folds) for k in range(design.folds)
            )
        )
    scene = world(look, np.random.default_rng(light_seed), (part, where), *front)
    blur = float(rng.choice([0.0, 0.5, 0.9]))
    pictures = []
    for view in views().values():
        radiance = view.radiance(scene)
        pictures.append(cv2.GaussianBlur(radiance, (0, 0), blur) if blur else radiance)
    gain = float(rng.uniform(0.7, 1.3))
    return Drawn(pictures[0], pictures[1], (where, *poses), hidden, visible, gain)


def turned_image(picture: FloatArray, where: FloatArray, angle_rad: float) -> FloatArray:
    """Picture of a detail as it would be if the part were turned in its own plane."""
    if angle_rad == 0.0:
        return picture
    corners = np.array([(-10.0, -10.0, 0.0), (10.0, -10.0, 0.0), (10.0, 10.0, 0.0), (-10.0, 10.0, 0.0)])
    before, after = (
        quick_view().project(apply(where, corners @ rotation_matrix(np.array([0.0, 0.0, turn])).T))
        for turn in (0.0, angle_rad)
    )
    to_turned = cv2.getPerspectiveTransform(before.astype(np.float32), after.astype(np.float32))
    return np.asarray(cv2.warpPerspective(picture, to_turned, picture.shape[::-1]))


def tilted(place: FloatArray, turn_deg: float, tilt_deg: float, rng: np.random.Generator) -> FloatArray:
    """rig_from_part of a tilted part."""
    side = rng.uniform(0, 2 * math.pi)
    tilt = rotation_matrix(math.radians(tilt_deg) * np.array([math.cos(side), math.sin(side), 0.0]))
    flat = pose((float(place[0]), float(place[1]), float(place[2])), turn_deg)
    flat[:3, :3] = tilt @ flat[:3, :3]
    return flat


def things_in_front(
    taught: Taught, where: FloatArray, rng: np.random.Generator, piece: int
) -> tuple[tuple[tuple[Part, FloatArray], ...], tuple[FloatArray, ...]]:
    """Nothing, one or two bars, or another such part beside or on the first; poses of such parts.

    piece : number of the other part's piece.
    """
    kind, radius = rng.choice(["nothing", "bar", "bar", "bars", "part"]), taught.design.radius_mm
    if kind == "nothing":
        return (), ()
    side = rng.uniform(0, 2 * math.pi)
    away = np.array([math.cos(side), math.sin(side), 0.0])
    if kind == "part":
        distance = radius * rng.uniform(1.1, 2.1)
        at = where[:3, 3] + distance * away - (0.0, 0.0, 2.5)
        there = tilted(at, rng.uniform(-180, 180), 3.0 * rng.random(), rng)
        return ((made(taught.design, taught.look, piece=piece), there),), (there,)
    bars: list[tuple[Part, FloatArray]] = []
    for k in range(2 if kind == "bars" else 1):
        surface = Surface(rng.uniform(0.05, 0.9), contrast=rng.choice([0.0, 0.15]), feature_mm=0.6, seed=3)
        bar = Part("bar", RoundedBox(0, 0, 6 * radius, rng.uniform(0.15, 0.7) * radius), surface)
        at = where[:3, 3] + rng.uniform(-1, 1) * radius * away - (0.0, 0.0, 4.0 + k)
        turn = math.degrees(side) + 90 + rng.uniform(-20, 20)
        bars.append((bar, pose((float(at[0]), float(at[1]), float(at[2])), turn)))
        side += rng.uniform(0.5, 2.5)
        away = np.array([math.cos(side), math.sin(side), 0.0])
    return tuple(bars), ()


def judge_target(taught: Taught, target: Target, truth: FloatArray) -> tuple[float, float]:
    """Rotation error of a target about its normal, rad, and its largest position error in sigma."""
    expected = truth @ taught.part_from_job
    relative = expected[:3, :3].T @ target.rig_from_part[:3, :3]
    turn = abs(math.atan2(relative[1, 0] - relative[0, 1], relative[0, 0] + relative[1, 1]))
    off = target.position_mm - seen_by(taught.rig.rig, expected[:3, 3])
    if np.linalg.norm(off) < OFF_MM:
        return turn, 0.0
    return turn, float(np.max(np.abs(off) / target.sigma_mm))


def seen_by(rig: StereoRig, point_mm: FloatArray) -> FloatArray:
    """Position that a calibration gives a point seen by the true cameras, to exclude its own error."""
    true = small_rig()
    left = true.left.project(point_mm[None])
    right = true.right.project(apply(true.right_from_left, point_mm[None]))
    return np.asarray(triangulate_raw(rig, left, right)[0])


def decision(taught: Taught, scene: Drawn, outcome: Outcome) -> tuple[str, list[str]]:
    """Decision about the first part, and every silent error in the picture."""
    errors: list[str] = []
    first = "not found"
    origins = np.array([one[:3, 3] for one in scene.poses])
    for target in outcome.targets:
        part_origin = target.rig_from_part @ invert(taught.part_from_job)
        apart = np.linalg.norm(origins - part_origin[:3, 3], axis=1)
        index = int(apart.argmin())
        if target.reject != Reject.NONE:
            if index == 0 and apart[0] < SAME_PART_MM and first == "not found":
                first = "|".join(str(flag.name) for flag in Reject if flag in target.reject)
            continue
        turn, sigmas = judge_target(taught, target, scene.poses[index])
        said = f"OK, turned by {30 * round(math.degrees(turn) / 30)}" if turn > TURNED_RAD else "OK"
        if turn > TURNED_RAD:
            errors.append("turned")
        elif apart[index] > SAME_PART_MM or sigmas > OFF_SIGMA:
            errors.append("off")
        if index == 0:
            first = said
    if first == "not found":
        for dismissed in outcome.dismissed:
            first = "|".join(str(flag.name) for flag in Reject if flag in dismissed.reject)
    return first, errors


def run_part(index: int, look: str, scenes: int, seed: int, kind: str | None = None) -> Row:
    """Run all scenes of one part on one surface."""
    cv2.setNumThreads(1)
    design = DESIGNS[index]
    row = Row(design.name, look)
    number = (seed, index, LOOKS.index(look))
    try:
        before = kind if kind is not None and KINDS[kind].everywhere else None
        taught = teach_design(design, look, seed * 1000 + index * 10 + LOOKS.index(look), before)
    except EdgedError as error:
        row.wrong.append(f"not taught: {error}")
        return row
    reasons: Counter[str] = Counter()
    spent = 0.0
    for k in range(scenes):
        rng = np.random.default_rng((*number, k))
        scene = draw_scene(taught, rng)
        decisions: Counter[str] = Counter()
        for draw in range(DRAWS_PER_SCENE):
            noise = np.random.default_rng((*number, k, draw))
            left, right = (exposed(side, scene.gain, noise) for side in (scene.left, scene.right))
            left, right = changed(kind, left, right, (*number, k, draw, 1))
            start = time.thread_time()
            outcome = locate(frame_pair(left, right), taught.job, taught.rig)
            spent += time.thread_time() - start
            first, errors = decision(taught, scene, outcome)
            decisions[first if first.startswith("OK") else "refused"] += 1
            row.draws += 1
            row.turned += errors.count("turned")
            row.off += errors.count("off")
            row.draws_seen += scene.seen >= SEEN
            if not first.startswith("OK"):
                if scene.seen >= SEEN:
                    row.refusals.append(f"scene {k} draw {draw}: {first}, {scene.hidden:.2f} hidden")
                reasons[first] += 1
                row.refused += 1
                row.refused_seen += scene.seen >= SEEN
            if errors:
                sight = f"{scene.hidden:.2f} hidden, {scene.seen:.2f} of what decides seen"
                row.wrong.append(f"scene {k} draw {draw}: {first}, {errors}, {sight}")
        row.scenes += 1
        row.agreeing += decisions.most_common(1)[0][1]
    row.reasons = dict(reasons.most_common())
    row.locate_ms = 1e3 * spent / max(row.draws, 1)
    return row


def percent(share: int, of: int) -> str:
    """Percentage with one decimal; a dash without a total."""
    return f"{100 * share / of:.1f}" if of else "-"


def show(rows: list[Row], title: str) -> None:
    """Print a Markdown table, one line for each row."""
    print(f"\n| {title} | draws | silent, turned | silent, off | refused % ", end="")
    print("| refused, seen % | agreement % | ms |")
    print("|---" + "|---:" * 7 + "|")
    for row in rows:
        print(
            f"| {row.name}{', ' if row.look else ''}{row.look} | {row.draws} | {row.turned} | {row.off} "
            f"| {percent(row.refused, row.draws)} | {percent(row.refused_seen, row.draws_seen)} "
            f"| {percent(row.agreeing, row.draws)} | {row.locate_ms:.1f} |"
        )


def summed(rows: list[Row], name: str, look: str = "") -> Row:
    """Sum of the counts of several rows."""
    total, reasons = Row(name, look), Counter[str]()
    for row in rows:
        for key in ("scenes", "draws", "turned", "off", "draws_seen", "refused", "refused_seen", "agreeing"):
            setattr(total, key, getattr(total, key) + getattr(row, key))
        total.locate_ms += row.locate_ms * row.draws
        reasons.update(row.reasons)
    total.locate_ms /= max(total.draws, 1)
    total.reasons = dict(reasons.most_common())
    return total


def main() -> int:
    """Run all parts on all surfaces, in two processes."""
    parser = bench_parser(__doc__)
    parser.add_argument("--draws", type=int, default=20_000, help="in all; rounded up to whole scenes")
    parser.add_argument("--parts", help="names, separated by commas; default: all")
    parser.add_argument("--looks", help="names, separated by semicolons; default: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--list", action="store_true", help="print every silent error and refusal")
    parser.add_argument("--degrade", choices=sorted(KINDS), help="as an imperfect camera sees it")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    wanted = options.parts.split(",") if options.parts else [design.name for design in DESIGNS]
    unknown = set(wanted) - {design.name for design in DESIGNS}
    if unknown:
        parser.error(f"unknown parts {sorted(unknown)}; there are {[design.name for design in DESIGNS]}")
    looks = options.looks.split(";") if options.looks else list(LOOKS)
    if set(looks) - set(LOOKS):
        parser.error(f"unknown looks {sorted(set(looks) - set(LOOKS))}; there are {LOOKS}")
    tasks = [(i, look) for i, design in enumerate(DESIGNS) if design.name in wanted for look in looks]
    scenes = max(1, math.ceil(options.draws / (DRAWS_PER_SCENE * len(tasks))))
    with ProcessPoolExecutor(options.processes, mp_context=get_context("spawn")) as pool:
        running = [
            pool.submit(run_part, index, look, scenes, options.seed, options.degrade) for index, look in tasks
        ]
        rows = []
        for one in running:
            rows.append(one.result())
            print(f"{rows[-1].name}, {rows[-1].look}: {rows[-1].turned} turned", file=sys.stderr, flush=True)
    show(rows, "part, surface")
    show([summed([row for row in rows if row.look == look], look) for look in looks], "surface")
    show([summed([row for row in rows if row.name in HELD_OUT], "held out")], "designs")
    total = summed(rows, "all")
    show([total], f"{total.scenes} scenes")
    print("\nrefused because of:", total.reasons)
    for row in rows:
        listed = [*row.wrong, *row.refusals] if options.list else []
        for line in listed or [line for line in row.wrong if "not taught" in line]:
            print(f"{row.name}, {row.look}: {line}")
    finish(options, {"total": asdict(total), "rows": rows})
    return 1 if total.turned or total.off else 0


if __name__ == "__main__":
    sys.exit(main())
