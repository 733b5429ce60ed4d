#!/usr/bin/env python3
"""Halve and double each number of a stage's Params, to see its effect on scenes drawn with exact truth.

    tools/bench ablate [--only NAME] [--quick] [--poses N] [--json FILE]

--only takes a stage (JointFitParams) or a field (agree_px). Sets: *parts*, a plate, a disc and a flange, each
taught from one pair and then lying anywhere, tilted by up to 12 degrees, and scenes without the part;
*solids*, two random thick parts of `bench_slices`, tilted by up to 45 degrees; *boards*, rigs calibrated from
chessboards and from dots. A row shows the change from the numbers as they are: parts found and false, rms
error of their places (for boards: of their marks) and processor time. "=" means that no digit changes; a
number with "=" twice has no effect here. Numbers that a kernel compiles in, or that a module reads when it is
imported, need a process of their own, and minutes where kernels are compiled: --quick leaves them out.
"""

from __future__ import annotations

import argparse
import ast
import functools
import gc
import hashlib
import json
import math
import multiprocessing
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from benching import bench_parser, finish

ROOT = Path(__file__).resolve().parent.parent

FACTORS = (0.5, 2.0)
WRONG_MM, WRONG_DEG = 0.1, 3.0
SETS = {"boards": "boards", "calibration": "boards", "solid": "solids"}
"""Set by package; all others use *parts*, the numbers of `SolidParams` *solids*."""
PATIENCE = 20.0
"""Multiple of the usual time after which a number counts as far too slow."""


@dataclass(frozen=True, slots=True)
class Result:
    """Result of one set. micron : rms error.  digits : a hash of all results."""

    asked: int
    found: int
    false: int
    micron: float
    seconds: float
    digits: str

    def against(self, usual: Result) -> str:
        """Differences from the usual result."""
        if self.digits == usual.digits:
            return "="
        told = [f"{self.found - usual.found:+d} found"] if self.found != usual.found else []
        told += [f"{self.false - usual.false:+d} false"] if self.false != usual.false else []
        return ", ".join([*told, f"{self.micron:.2f} µm", f"time {self.seconds / usual.seconds:.2f}"])


@dataclass(frozen=True, slots=True)
class Number:
    """A field of a stage. module, instance : of its stage.  scenes : the set that shows its effect."""

    stage: str
    name: str
    module: str
    instance: str
    scenes: str
    imported: bool

    def set_by(self, factor: float) -> bool:
        """Vary it in this process; return whether its value changes."""
        stage = getattr(import_module(self.module), self.instance)
        before = getattr(stage, self.name)
        after = scaled(before, factor)
        object.__setattr__(stage, self.name, after)
        return bool(after != before)


def scaled(value: Any, factor: float) -> Any:
    """Scale numbers by a factor, integers to at least 1; of curve-fitting parameters, only the reach."""
    if isinstance(value, tuple):
        return tuple(scaled(one, factor) for one in value)
    if isinstance(value, int):
        return max(1, round(value * factor))
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, reach_px=scaled(getattr(value, "reach_px"), factor))  # noqa: B009  (of any class)
    return value * factor


def numbers() -> Iterator[Number]:
    """All fields of all stages, in the order of the packages."""
    imported = {
        name for source in sorted((ROOT / "edged/vision").rglob("*.py")) for name in read_at_import(source)
    }
    for source in sorted((ROOT / "edged/vision").glob("*/params.py")):
        module = f"edged.vision.{source.parent.name}.params"
        for name, value in vars(import_module(module)).items():
            if name.isupper() and is_dataclass(value) and type(value).__module__ == module:
                stage = type(value).__name__
                scenes = "solids" if stage == "SolidParams" else SETS.get(source.parent.name, "parts")
                for field in fields(value):
                    known = f"{name}.{field.name}" in imported
                    yield Number(stage, field.name, module, name, scenes, known)


def read_at_import(source: Path) -> set[str]:
    """`STAGE.field` names that a module reads outside function bodies, that is, at import."""
    found, waiting = set[str](), list[ast.AST](ast.parse(source.read_text()).body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id.isupper():
            found.add(f"{node.value.id}.{node.attr}")
        inside: list[ast.AST] = [*ast.iter_child_nodes(node)]
        if isinstance(node, ast.FunctionDef | ast.Lambda):
            inside = [node.args, *getattr(node, "decorator_list", ())]
        waiting += inside
    return found


def draw(folder: Path, poses: int) -> None:
    """Draw all sets, once."""
    import numpy as np
    from bench_slices import WALL, random_solid
    from helpers.cells import pictures, pose, scene, small_rig
    from helpers.flatparts import DISC, PLATE
    from helpers.tilted import lying

    from edged.sim.cell import demo_part
    from edged.sim.render.scene import chessboard_plate, dots_plate
    from edged.sim.views import calibration_views

    rig, rng = small_rig(), np.random.default_rng(1)
    designs: list[Any] = [PLATE, DISC, demo_part()]
    parts = []
    for k, part in enumerate(designs):
        where = [
            pose(
                (8 + rng.uniform(-12, 12), rng.uniform(-8, 8), 205 + rng.uniform(-3, 3)),
                rng.uniform(0, 360),
                rng.uniform(0, 12),
            )
            for _ in range(poses)
        ]
        shown: list[Any] = [(pictures(rig, scene((part, at)), n), at) for n, at in enumerate(where)]
        other = designs[(k + 1) % len(designs)]
        shown += [(pictures(rig, scene(), 1), None), (pictures(rig, scene((other, pose())), 2), None)]
        parts.append((part.name, pictures(rig, scene((part, pose())), 99), pose(), shown))
    solids = []
    for k in range(2):
        solid, at = random_solid(np.random.default_rng((1, k))), lying(rig, 0.0, 0.0, 0.0)
        where = [
            lying(rig, rng.uniform(0, 45), rng.uniform(0, 360), rng.uniform(0, 360))
            for _ in range(max(1, poses // 2))
        ]
        shown = [(pictures(rig, solid.at(there, 0.2), n), there) for n, there in enumerate(where)]
        solids.append(("solid", pictures(rig, solid.at(at, WALL.albedo), 99), at, shown))
    boards = [
        (spec, plate.points_mm, [(view.left, view.right, view.rig_from_plate) for view in shots])
        for spec, plate in (
            ("chessboard:9x6:4.0", chessboard_plate(9, 6, 4.0)),
            ("dots:7x7:5.0", dots_plate(7, 7, 5.0)),
        )
        for shots in [list(calibration_views(rig, plate, 8, seed=2))]
    ]
    for name, value in (("parts", parts), ("solids", solids), ("boards", boards)):
        (folder / name).write_bytes(pickle.dumps(value))


def run_parts(folder: Path, name: str) -> Result:
    """Teach and locate every design of a set."""
    import numpy as np
    from helpers.cells import frame_pair, small_rig

    from edged.domain.measurement import Reject
    from edged.errors import EdgedError
    from edged.pipeline import locate, prepare
    from edged.vision.geometry.rigid import invert
    from edged.vision.teaching.pair import teach

    rig, asked, found, false, seconds = prepare(small_rig()), 0, 0, 0, 0.0
    errors, digits = list[float](), hashlib.sha256()
    for design, taught, taught_at, shown in pickle.loads((folder / name).read_bytes()):
        asked += sum(where is not None for _, where in shown)
        try:
            job = teach(*taught, rig.rectification, None, design)
        except EdgedError as error:
            digits.update(str(error).encode())
            continue
        if name == "solids":
            job = replace(job, tilt_rad=math.radians(45.0))
        part_from_job = invert(taught_at) @ job.rig_from_part
        for pair, where in shown:
            start = time.process_time()
            outcome = locate(frame_pair(*pair), job, rig)
            seconds += time.process_time() - start
            good = [target for target in outcome.targets if target.reject is Reject.NONE]
            digits.update(repr([(t.rig_from_part.tolist(), t.covariance.tolist()) for t in good]).encode())
            for target in good:
                error = math.inf
                if where is not None:
                    true = where @ part_from_job
                    error = float(np.linalg.norm(target.rig_from_part[:3, 3] - true[:3, 3]))
                    leant = math.degrees(
                        math.acos(min(1.0, float(true[:3, 2] @ target.rig_from_part[:3, 2])))
                    )
                    error = math.inf if leant > WRONG_DEG else error
                right = error < WRONG_MM
                found, false = found + right, false + (not right)
                errors += [1e3 * error] if right else []
    rms = math.sqrt(float(np.mean(np.square(errors)))) if errors else math.nan
    return Result(asked, found, false, rms, seconds, digits.hexdigest())


def run_boards(folder: Path) -> Result:
    """Find the boards and calibrate with each kind; errors are those of the marks against the truth."""
    import numpy as np

    from edged.errors import EdgedError
    from edged.vision.boards.board import StereoView, parse_board
    from edged.vision.boards.deformation import nominal
    from edged.vision.boards.detection import detect_board
    from edged.vision.calibration.calibrate import calibrate_stereo, marks_in_both
    from edged.vision.geometry.rigid import apply
    from edged.vision.geometry.triangulation import triangulate_raw

    asked, found, false, start = 0, 0, 0, time.process_time()
    errors, digits = list[float](), hashlib.sha256()
    for spec, points_mm, shots in pickle.loads((folder / "boards").read_bytes()):
        board = parse_board(spec)
        views = [
            StereoView(str(k), nominal(board), detect_board(left, board), detect_board(right, board))
            for k, (left, right, _) in enumerate(shots)
        ]
        asked += len(shots)
        try:
            calibration = calibrate_stereo(
                views, *[(shots[0][0].shape[1], shots[0][0].shape[0])] * 2, model="auto"
            )
        except EdgedError as error:
            digits.update(str(error).encode())
            continue
        found += len(calibration.views)
        for fit in calibration.views:
            ids, left, right = marks_in_both(fit.view)
            measured = triangulate_raw(calibration.rig, left, right)
            true = apply(shots[int(fit.view.name)][2], points_mm[ids])
            errors += [1e3 * float(error) for error in np.linalg.norm(measured - true, axis=1)]
        digits.update(repr(errors).encode())
    rms = math.sqrt(float(np.mean(np.square(errors)))) if errors else math.nan
    return Result(asked, found, false, rms, time.process_time() - start, digits.hexdigest())


def run(folder: Path, scenes: str) -> Result:
    """Run one set with the numbers as they are in this process."""
    return run_boards(folder) if scenes == "boards" else run_parts(folder, scenes)


def in_child(folder: Path, number: Number, factor: float, patience_s: float) -> Result | str:
    """Run the set with one number varied, in a fork of this warm process."""
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)

    def work() -> None:
        from edged.vision.kernels import jit

        jit._RIGHT = ThreadPoolExecutor(1)  # noqa: SLF001  (the parent's thread is not in a fork)
        for kept in gc.get_objects():
            if isinstance(kept, functools._lru_cache_wrapper):  # noqa: SLF001  (it has no public name)
                kept.cache_clear()
        there.send(varied(folder, number, factor))

    child = context.Process(target=work)
    child.start()
    there.close()
    try:
        return here.recv() if here.poll(patience_s) else "far too slow"
    except EOFError:
        return "breaks"
    finally:
        child.kill()
        child.join()
        here.close()


def varied(folder: Path, number: Number, factor: float) -> Result | str:
    """Run the set with one number varied, in this process."""
    if not number.set_by(factor):
        return "the same number"
    try:
        return run(folder, number.scenes)
    except Exception as error:  # noqa: BLE001  (any failure that a senseless number causes is its result)
        return f"fails: {type(error).__name__}"


def in_new_process(folder: Path, number: Number, factor: float, patience_s: float) -> Result | str:
    """Run the set with one number varied before anything that reads it is imported."""
    order = [sys.executable, __file__, "--varied", json.dumps([str(folder), asdict(number), factor])]
    try:
        answer = subprocess.run(order, stdout=subprocess.PIPE, check=False, timeout=patience_s)
    except subprocess.TimeoutExpired:
        return "far too slow"
    return pickle.loads(answer.stdout) if answer.stdout else "breaks"


def report(chosen: list[Number], folder: Path) -> None:
    """Print a row for each number."""
    import cv2

    cv2.setNumThreads(1)
    usual: dict[str, Result] = {}
    for scenes in dict.fromkeys(number.scenes for number in chosen):
        run(folder, scenes)  # loads the kernels
        usual[scenes] = run(folder, scenes)
        it = usual[scenes]
        print(
            f"{scenes}: {it.found} of {it.asked} found, {it.false} false, {it.micron:.2f} µm rms", flush=True
        )
    print("\n| number | half | double |\n|---|---|---|", flush=True)
    for number in chosen:
        way: Callable[..., Result | str] = in_new_process if number.imported else in_child
        patience_s = 30.0 + PATIENCE * usual[number.scenes].seconds + 300.0 * number.imported
        results = [way(folder, number, factor, patience_s) for factor in FACTORS]
        told = [one if isinstance(one, str) else one.against(usual[number.scenes]) for one in results]
        print(f"| {number.stage}.{number.name} | {' | '.join(told)} |", flush=True)


def main() -> int:
    """Print the table."""
    parser = bench_parser(__doc__)
    parser.add_argument("--only", default="", help="a stage's class, or a field")
    parser.add_argument("--quick", action="store_true", help="not what is compiled in or read at import")
    parser.add_argument("--poses", type=int, default=20, help="of each of three designs")
    parser.add_argument("--varied", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.varied:
        folder, number, factor = json.loads(options.varied)
        result = pickle.dumps(varied(Path(folder), Number(**number), factor))
        sys.stdout.buffer.write(result)
        return 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cache = folder / "kernels"  # kernels with senseless numbers stay out of the usual cache
        if Path(os.environ.get("NUMBA_CACHE_DIR", "")).is_dir() and os.environ.get("NUMBA_CACHE_DIR"):
            shutil.copytree(os.environ["NUMBA_CACHE_DIR"], cache)
        cache.mkdir(exist_ok=True)
        os.environ["NUMBA_CACHE_DIR"] = str(cache)
        chosen = [number for number in numbers() if options.only in ("", number.stage, number.name)]
        chosen = [number for number in chosen if not (options.quick and number.imported)]
        if not chosen:
            parser.error(f"--only {options.only}: no stage and no field has this name")
        draw(folder, options.poses)
        report(chosen, folder)
    finish(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
