#!/usr/bin/env python3
"""Open virtual cameras with the features of 84 real models; report what works, what is missing, what to do.

    tools/bench models [--only NAME ...] [--resume FILE] [--doc FILE] [--json FILE]

prints Markdown. For each model two virtual cameras are made from the table of facts (`cameramodels.json`),
with the names, kinds, access and choices of the maker's own description. They start as another program may
have left them: automatics, filters, limits and a test pattern on. The real driver opens them as a cell would.
Where it refuses, the bench does what the message tells a person to do, notes it, and opens again. Then follow
a pair, exposure and gain changed and put back, and a pair by each kind of trigger. Every picture must have
the grey values of its exposure and gain, whatever their form in the camera. The features that the driver
reports as missing are compared with the table, and so are the doctor's findings. `--doc FILE` writes the
table between its marks in a page of the manual.

What this is not: a real camera. The registers are the virtual camera's own; a family's description may hold
features that a model does not have; cameras with CoaXPress need a frame grabber and cannot be reached by this
driver at all.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from bench_service import enter_namespace
from benching import bench_parser, finish
from cameramodels import Model, models
from helpers.rigs import make_rig
from modelcamera import EXPOSURE_US, GAIN_DB, SCENE, model_camera, raw_gain, spoiled

from edged.adapters.aravis import AravisCamera
from edged.app.cameras import head_of
from edged.cell.stereohead import StereoHead
from edged.config.configuration import Config
from edged.doctor.pictures import take_pictures
from edged.domain.arrays import SIDES
from edged.domain.exposure import CameraValues
from edged.domain.frames import FramePair
from edged.errors import EdgedError
from edged.sim.gige import genicam as g
from edged.sim.gige.camera import GigeCamera, Make

ADDRESSES = ("127.0.70.1", "127.0.70.2")
GREY_TOLERANCE = 1
"""Tolerance for the steps of a raw gain."""
TRIES = 6
AGAIN = 2
LIMIT_S = 20.0
BEGIN, END = "<!-- generated: models -->", "<!-- end -->"


@dataclass
class Row:
    """Results for one model."""

    name: str
    transport: str
    works: dict[str, str] = field(default_factory=dict)
    lacks: list[str] = field(default_factory=list)
    todo: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)


@dataclass
class Twins:
    """Two cameras of one model, and their configuration so far."""

    model: Model
    cameras: tuple[GigeCamera, GigeCamera]
    make: Make
    side: dict[str, Any] = field(default_factory=lambda: {"exposure_us": EXPOSURE_US, "gain_db": GAIN_DB})
    features: dict[str, Any] = field(default_factory=dict)
    trigger: dict[str, Any] = field(default_factory=dict)

    def section(self, **cameras: Any) -> dict[str, Any]:
        """The cameras section of a configuration."""
        sides = {
            side: {"device": address, **self.side, **({"features": self.features} if self.features else {})}
            for side, address in zip(SIDES, ADDRESSES, strict=True)
        }
        return {
            "source": "aravis",
            "timeout_s": 3.0,
            "max_skew_ms": 400.0,
            "max_arrival_skew_ms": 1000.0,
            "trigger": self.trigger,
            **sides,
            **cameras,
        }

    def config(self, **cameras: Any) -> Config:
        """A whole configuration."""
        return Config.model_validate(
            {
                "cell": {"name": "models", "rig": Path("rig.json"), "jobs": Path("jobs")},
                "cameras": self.section(**cameras),
            }
        )

    def head(self, **cameras: Any) -> StereoHead:
        """The head that the daemon would make."""
        return head_of(self.config(**cameras).cameras)


@contextmanager
def twins(model: Model) -> Iterator[Twins]:
    """Both cameras of a model, switched on."""
    with ExitStack() as stack:
        made = [
            model_camera(model, address, f"MODEL-{side}")
            for address, side in zip(ADDRESSES, SIDES, strict=True)
        ]
        left, right = (stack.enter_context(camera) for camera, _ in made)
        yield Twins(model, (left, right), made[0][1])


def run(cameras: Sequence[GigeCamera], head: StereoHead, script: Callable[[StereoHead], Any]) -> Any:
    """Open the head, run the script, close it."""

    async def main() -> Any:
        try:
            async with asyncio.timeout(LIMIT_S):
                await head.open()
                return await script(head)
        finally:
            await head.close()

    try:
        return asyncio.run(main())
    finally:
        released(cameras)


def released(cameras: Sequence[GigeCamera]) -> None:
    """Wait until nothing controls the cameras: on a busy machine a driver thread releases them late."""
    until_s = time.monotonic() + LIMIT_S
    while any(camera.controlled for camera in cameras) and time.monotonic() < until_s:
        time.sleep(0.01)


def expected(exposure_us: float, gain_db: float) -> np.ndarray[Any, Any]:
    """Grey values of the scene at an exposure."""
    light = exposure_us / EXPOSURE_US * 10 ** ((gain_db - GAIN_DB) / 20)
    return np.clip(np.rint(SCENE * light), 0, 255)


def greys_off(pair: FramePair, exposure_us: float = EXPOSURE_US, gain_db: float = GAIN_DB) -> float:
    """Largest difference from the expected grey values, without the first row, which numbers the picture."""
    truth = expected(exposure_us, gain_db)
    return max(float(np.abs(frame.image - truth)[1:].max()) for frame in (pair.left, pair.right))


async def one_pair(head: StereoHead) -> FramePair:
    """Capture one pair."""
    return await head.capture()


# --- what a person does ------------------------------------------------------------


def follow_advice(pairs: Twins, told: str) -> str:
    """Do what a message says; return it in a person's words, "" for a message without advice."""
    if "gain_db:" in told and "GainRaw" in told:
        pairs.side.pop("gain_db")
        raw = next(raw for raw in range(4096) if raw_gain(pairs.model, raw) >= GAIN_DB)
        pairs.features = {
            **({"GainAuto": "Off"} if pairs.model.has("GainAuto") else {}),
            "GainRaw": raw,
            **pairs.features,
        }
        return "GainRaw in its own steps, under `features`, instead of `gain_db`"
    if "gain_db: the camera has no gain" in told:
        pairs.side.pop("gain_db")
        return "leave `gain_db` out: it has no gain"
    if "exposure_us: the camera has no ExposureTime" in told:
        pairs.side.pop("exposure_us")
        return "leave `exposure_us` out: it cannot be set by a standard name"
    if "it can only run freely" in told:
        pairs.trigger = {"mode": "free-run"}
        return '`trigger.mode = "free-run"`: nothing else starts an exposure'
    return ""


def opened(pairs: Twins, row: Row) -> bool:
    """Try the cell as configured, and follow the messages, until a pair comes."""
    for _ in range(TRIES):
        try:
            pair = run(pairs.cameras, pairs.head(), one_pair)
        except (EdgedError, TimeoutError) as error:
            done = follow_advice(pairs, str(error))
            if not done:
                row.wrong.append(str(error).removeprefix("camera both: ").partition("; right:")[0])
                return False
            row.todo.append(done)
            continue
        findings = [check for check in take_pictures(pairs.config(), RIG) if check.verdict in ("warn", "bad")]
        released(pairs.cameras)
        asked = [check for check in findings if "response" in check.name]
        row.wrong += [f"doctor: {check.finding}" for check in findings if check not in asked]
        if asked:
            name, _, value = asked[0].remedy.removeprefix("set ").partition(" under ")[0].partition(" = ")
            pairs.features[name] = {"false": False}.get(value, 1.0)
            row.todo.append(f"doctor: `{name} = {value}` under `features`, before calibrating")
            continue
        if (off := greys_off(pair)) > GREY_TOLERANCE:
            row.wrong.append(
                f"grey values off by {off:.0f}: {', '.join(spoiled(pairs.cameras[0], pairs.make))}"
            )
        row.works["pair"] = "yes"
        return True
    row.wrong.append("no end of messages")
    return False


RIG = make_rig(size=(SCENE.shape[1], SCENE.shape[0]))


# --- what works ------------------------------------------------------------


def adjusts(pairs: Twins, lacks: list[str]) -> str:
    """Change exposure and gain while it runs, and put them back; check pictures, then registers.

    lacks : receives what the driver reports as missing.
    """
    values = CameraValues(
        EXPOSURE_US / 2 if "exposure_us" in pairs.side else None, 0.0 if "gain_db" in pairs.side else None
    )
    gain = 0.0
    addresses = [node.address for node in pairs.make.features if not node.read_only]

    def memory() -> list[int]:
        return [pairs.cameras[0].registers.word(address) for address in addresses if address >= 0x10000]

    async def script(head: StereoHead) -> str:
        nonlocal gain, values, lacks
        cameras = [camera for camera in head.cameras if isinstance(camera, AravisCamera)]
        if (health := cameras[0].health) is not None:
            lacks += [f"{lack.code}|{lack}" for lack in health.lacks]
        if values == CameraValues():
            return ""
        before = memory()
        if values.gain_db is not None and (limits := (await cameras[0].limits()).gain_db) is not None:
            gain = math.ceil(max(0.0, limits[0]))
            values = CameraValues(values.exposure_us, gain)
        for camera in cameras:
            await camera.adjust(values)
        pair = await head.capture()
        off = greys_off(pair, values.exposure_us or EXPOSURE_US, GAIN_DB if values.gain_db is None else gain)
        for camera in cameras:
            await camera.restore()
        if off > GREY_TOLERANCE:
            return f"WRONG: grey values off by {off:.0f}"
        return "yes" if memory() == before else "WRONG: not as before"

    return str(run(pairs.cameras, pairs.head(), script))


def by_trigger(pairs: Twins, trigger: dict[str, Any], pulse: bool = False, **cameras: Any) -> str:
    """Take a pair with this trigger."""
    before, pairs.trigger = pairs.trigger, trigger

    async def script(head: StereoHead) -> str:
        coming = asyncio.create_task(head.capture())
        if pulse:
            await asyncio.sleep(0.05)
            at_ns = time.monotonic_ns()
            for camera in pairs.cameras:
                camera.line("Line1").pulse(at_ns=at_ns)
        off = greys_off(await coming)
        selectable = any(
            node.name == "TriggerSelector" and not node.read_only for node in pairs.make.features
        )
        words = (pairs.cameras[0].registers.word(g.TRIGGER_MODE + 4 * place) for place in range(1, 16))
        if selectable and any(words):
            return "WRONG: another trigger is on"
        return "yes" if off <= GREY_TOLERANCE else f"WRONG: grey values off by {off:.0f}"

    try:
        return str(run(pairs.cameras, pairs.head(**cameras), script))
    except TimeoutError:
        return "WRONG: no answer"
    except EdgedError as error:
        return f"WRONG: {error}"
    finally:
        pairs.trigger = before


def outputs(pairs: Twins) -> str:
    """Take a pair by chain: an output of the left camera signals its exposure to the right one."""
    line = next((choices[1] for choices in _choices(pairs.make, "LineSelector") if len(choices) > 1), "")
    out = next((choices[0] for choices in _choices(pairs.make, "SyncOutSelector")), "")
    first = _line(pairs)
    if not first or not (line or out):
        return "no"
    if out and not line:  # the virtual camera has no wire there: only check that the settings arrive
        pairs.side["strobe"] = {"line": out, "source": "ExposureActive"}
        try:
            return by_trigger(pairs, {})
        finally:
            del pairs.side["strobe"]
    left, right = pairs.cameras
    left.line("Line2").feeds(right.line("Line1"))
    return by_trigger(pairs, {"mode": "chain", "output": line, "line": first})


def _choices(make: Make, name: str) -> list[list[str]]:
    return [list(node.choices) for node in make.features if node.name == name]


def _line(pairs: Twins) -> str:
    """The first input that triggers; "" for none."""
    sources = next(iter(_choices(pairs.make, "TriggerSource")), [])
    return next((source for source in sources if source.startswith("Line")), "")


def truth(model: Model) -> set[str]:
    """Features that are missing according to the table."""
    choices = {feature.name: feature.choices for feature in model.features}
    sources = choices.get("TriggerSource", ()) if model.has("TriggerMode") else ()
    shown = (*choices.get("LineSource", ()), *choices.get("SyncOutSource", ()))
    known = (
        any(begin in model.name for begin in ("acA2000-50", "acA640-90", "acA1300-30"))
        or "Basler" not in model.name
    )
    has = {
        "software-trigger": "Software" in sources,
        "line-trigger": any(name.startswith("Line") for name in sources),
        "action-trigger": any(name.startswith("Action") for name in sources)
        and bool(model.has("ActionDeviceKey")),
        "exposure-output": bool({"ExposureActive", "Exposing"} & set(shown)),
        "chunk-exposure": "ExposureTime" in choices.get("ChunkSelector", ()),
        "gain-db": bool(model.has("Gain", "GainAbs")) or (bool(model.has("GainRaw")) and known),
        "frame-rate": bool(model.has("AcquisitionFrameRate", "AcquisitionFrameRateAbs")),
        "ptp": bool(model.has("PtpEnable", "GevIEEE1588", "PtpMode")),
        "temperature": bool(model.has("DeviceTemperature", "TemperatureAbs", "SensorTemperature")),
        "clock": True,  # the virtual camera has the bootstrap registers
    }
    return {code for code, there in has.items() if not there}


def look_at(model: Model) -> Row:
    """Test everything on one model."""
    row = Row(model.name, model.transport)
    with twins(model) as pairs:
        if not opened(pairs, row):
            return row
        said: list[str] = []
        row.works["adjust"] = adjusts(pairs, said)
        row.lacks = [text.partition("|")[2] for text in said]
        missing = {text.partition("|")[0] for text in said}
        if missing != truth(model):
            row.wrong.append(f"says that it lacks {said}, the table: {truth(model)}")
        if pairs.trigger:
            row.works["free-run"] = by_trigger(pairs, pairs.trigger)
            return row
        rate = {} if "frame-rate" in missing else {"rate_hz": 20.0}
        ways: dict[str, tuple[str, Callable[[], str]]] = {
            "line": (
                "line-trigger",
                lambda: by_trigger(pairs, {"mode": "line", "line": _line(pairs)}, pulse=True),
            ),
            "action": ("action-trigger", lambda: by_trigger(pairs, {"mode": "action"})),
            "output": ("exposure-output", lambda: outputs(pairs)),
            "free-run": ("", lambda: by_trigger(pairs, {"mode": "free-run", **rate})),
            "chunks": ("chunk-exposure", lambda: by_trigger(pairs, {}, chunks=True)),
            "PTP": ("ptp", lambda: by_trigger(pairs, {}, ptp=True)),
        }
        for name, (needs, way) in ways.items():
            row.works[name] = "no" if needs in missing else way()
    row.wrong += [f"{what}: {text}" for what, text in row.works.items() if text.startswith("WRONG")]
    return row


def looked_at(model: Model) -> Row:
    """`look_at`, repeated after an error: a busy machine loses pictures of two virtual cameras."""
    for number in range(AGAIN + 1):
        try:
            row = look_at(model)
        except (EdgedError, TimeoutError) as error:
            row = Row(model.name, model.transport, wrong=[str(error)])
        if not row.wrong or model.transport == "CoaXPress" or number == AGAIN:
            break
        print(f"{model.name}: {row.wrong}; again", file=sys.stderr, flush=True)
    return row


COLUMNS = ("pair", "adjust", "line", "action", "output", "free-run", "chunks", "PTP")
MARKS = {"yes": "✓", "no": "–"}
GRABBER = "a frame grabber and its own driver: CoaXPress"


def table(rows: list[Row]) -> str:
    """The rows as a Markdown table."""
    lines = [
        f"| model | {' | '.join(COLUMNS)} | lacks | a person must |",
        "|---|" + "---|" * (len(COLUMNS) + 2),
    ]
    for row in rows:
        cells = [MARKS.get(mark := row.works.get(column, ""), mark) for column in COLUMNS]
        todo = [GRABBER] if row.transport == "CoaXPress" else row.todo
        trouble = [f"not opened: {row.wrong[0]}"] if not row.works and row.transport != "CoaXPress" else []
        name = row.name.replace("_", " ")
        lacks = "; ".join(row.lacks).replace("|", "/")
        lines.append(
            f"| {name} ({row.transport}) | {' | '.join(cells)} | {lacks} | {'; '.join([*todo, *trouble])} |"
        )
    return "\n".join(lines)


def _known(file: Path | None) -> dict[str, Row]:
    """Rows of an interrupted run."""
    if file is None or not file.exists():
        return {}
    return {row["name"]: Row(**row) for row in json.loads(file.read_text()) if not row["wrong"]}


def main() -> None:
    """Test every model, one after the other."""
    parser = bench_parser(__doc__)
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="NAME", help="models whose name contains one of these"
    )
    parser.add_argument(
        "--resume", type=Path, metavar="FILE", help="well rows of this --json stand; new ones are added"
    )
    parser.add_argument("--doc", type=Path, metavar="FILE", help="write the table into this page")
    options = parser.parse_args()
    enter_namespace()
    logging.getLogger("edged").addHandler(logging.NullHandler())
    logging.getLogger("edged").propagate = False
    known = _known(options.resume)
    rows = []
    for model in models():
        if options.only and not any(part in model.name for part in options.only):
            continue
        if model.name not in known:
            known[model.name] = looked_at(model)
            print(f"{model.name}: {known[model.name].wrong or 'well'}", file=sys.stderr, flush=True)
            if options.resume is not None:
                options.resume.write_text(json.dumps([asdict(row) for row in known.values()], indent=1))
        rows.append(known[model.name])
    reached = [row for row in rows if row.transport != "CoaXPress"]
    wrong = [row for row in reached if row.wrong]
    good = [row for row in reached if row.works.get("pair") == "yes" and not row.wrong]
    text = table(rows)
    summary = f"{len(good)} of {len(reached)} models with GigE Vision or USB3 Vision give right pairs"
    taught = sum(bool(row.todo) for row in good)
    print(f"\n{text}\n\n{summary}; {taught} of them after a person has done what is said.")
    if options.doc is not None:
        page = options.doc.read_text()
        before, rest = page.split(BEGIN, 1)
        generated = f"{BEGIN}\n\n{summary}.\n\n{text}\n\n{END}"
        options.doc.write_text(before + generated + rest.split(END, 1)[1])
    finish(options, [asdict(row) for row in rows])
    if wrong:
        sys.exit("; ".join(f"{row.name}: {row.wrong[0]}" for row in wrong[:10]))


if __name__ == "__main__":
    main()
