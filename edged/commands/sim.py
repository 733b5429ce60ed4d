"""`edged sim`: simulated GigE Vision cameras for testing a client of real ones."""

from __future__ import annotations

import ipaddress
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from edged.config.cameras import CameraSection
from edged.config.reading import load
from edged.domain.arrays import SIDES, Image
from edged.errors import UserError
from edged.files.images import load_image
from edged.files.pairs import find_pairs
from edged.files.rig import load_rig
from edged.sim.cell import VirtualCell, demo_part, demo_rig, inside
from edged.sim.console import SimConsole, number, set_fault
from edged.sim.exposure import ExposureRequest
from edged.sim.gige.camera import GigeCamera, moving_ramp
from edged.sim.gige.clock import DeviceClock
from edged.sim.gige.faults import Faults, Quirk
from edged.sim.reel import PairReel
from edged.sim.weather import DAY_S, Schedule, Weather
from edged.sim.world import SERIALS, cross_wire
from edged.vision.marks.frame import parse_frame

ADDRESSES = ("127.0.0.2", "127.0.0.3")
NO_CAMERA = "none"
POLL_S = 0.1
Exposure = Callable[[ExposureRequest], Image]


@dataclass(frozen=True, slots=True)
class SimOptions:
    """Options of the command line."""

    config: Path | None = None
    images: Path | None = None
    pattern: str = ""
    addresses: tuple[str, str] = ("", "")
    faults: tuple[str, ...] = ()
    quirks: tuple[str, ...] = ()
    pulse_hz: float = 0.0
    drift_ppm: float = 0.0
    marks: str = ""
    weather_k: float = 0.0
    day_s: float = DAY_S


def sim(options: SimOptions, console: Console) -> int:
    """Serve until `quit`, ctrl-C or SIGTERM."""
    cameras = build(options)
    talk = SimConsole(cameras)
    with ExitStack() as running, _stop_signals() as stopped:
        for camera in cameras.values():
            running.enter_context(camera)
        for name, camera in cameras.items():
            console.print(
                f"{name}: GigE Vision camera {camera.serial} on {camera.address}",
                highlight=False,
                soft_wrap=True,
            )
        console.print("`help` for what can be changed while they run; `quit` or ctrl-C ends it")
        if options.pulse_hz > 0:
            running.enter_context(_pulses(cameras, options.pulse_hz))
        for line in _lines(stopped):
            try:
                answer = talk.execute(line)
            except UserError as error:
                answer = f"error: {error}"
            if answer:
                print(answer, flush=True)
            if talk.ended:
                break
    return 0


def build(options: SimOptions) -> dict[str, GigeCamera]:
    """Return the cameras, not yet started. Raises `UserError`."""
    where = _places(options)
    size, exposures = _pictures(options)
    quirks = frozenset(_quirk(name) for name in options.quirks)
    cameras = {
        side: GigeCamera(
            address,
            serial,
            exposures[side],
            size=size,
            faults=Faults(),
            clock=DeviceClock(drift_ppm=options.drift_ppm if side == "right" else 0.0),
            quirks=quirks,
        )
        for side, (address, serial) in where.items()
    }
    for text in options.faults:
        _set_fault(cameras, text)
    if len(cameras) == len(SIDES):
        cross_wire(cameras["left"], cameras["right"])
    return cameras


def _places(options: SimOptions) -> dict[str, tuple[str, str]]:
    """Return address and serial number by side."""
    places: dict[str, tuple[str, str]] = dict(zip(SIDES, zip(ADDRESSES, SERIALS, strict=True), strict=True))
    if options.config is not None:
        section = load(options.config).cameras
        for side, camera in (("left", section.left), ("right", section.right)):
            places[side] = _configured(camera, *places[side])
    for side, wanted in zip(SIDES, options.addresses, strict=True):
        if wanted == NO_CAMERA:
            del places[side]
        elif wanted:
            places[side] = wanted, places[side][1]
    addresses = [address for address, _ in places.values()]
    for address in addresses:
        if not _is_address(address):
            raise UserError(f"{address!r} is no IPv4 address; expected one of this machine, or {NO_CAMERA}")
    if not addresses or len(set(addresses)) < len(addresses):
        raise UserError("expected at least one camera, each with an address of its own")
    return places


def _configured(camera: CameraSection, address: str, serial: str) -> tuple[str, str]:
    """Return address and serial number of a configured camera, whose `device` is either of the two."""
    if _is_address(camera.device):
        return camera.device, camera.serial or serial
    return address, camera.device or serial


def _pictures(options: SimOptions) -> tuple[tuple[int, int], dict[str, Exposure]]:
    """Return (width, height) and the image source of each side: a pattern, a folder or the virtual cell."""
    if options.pattern:
        width, by, height = options.pattern.partition("x")
        if not by:
            raise UserError(f"--pattern {options.pattern!r}: expected WIDTHxHEIGHT in px, as 640x480")
        size = round(number("--pattern", width, 16, 8192)), round(number("--pattern", height, 16, 8192))
        return size, dict.fromkeys(SIDES, moving_ramp)
    if options.images is not None:
        pairs = find_pairs(options.images)
        shown = {side: [load_image(getattr(pair, side)) for pair in pairs] for side in SIDES}
        shapes = {image.shape for images in shown.values() for image in images}
        if len(shapes) > 1:
            raise UserError(f"{options.images}: pictures of {len(shapes)} sizes; a sensor has one")
        height_px, width_px = shapes.pop()
        reel = PairReel(shown)
        return (width_px, height_px), {side: reel.exposure(side) for side in SIDES}
    rig = demo_rig() if options.config is None else load_rig(load(options.config).cell.rig)
    try:
        frame = parse_frame(options.marks) if options.marks else None
        weather = Weather(rig, Schedule.days(options.weather_k, 400.0)) if options.weather_k > 0 else None
        cell = VirtualCell(
            rig,
            demo_part(),
            motion=None if frame is None else inside(frame),
            marks=frame,
            weather=weather,
            pace=DAY_S / options.day_s,
        )
    except ValueError as error:
        raise UserError(f"the demo's part cannot be shown to this rig ({error}); use --images") from error
    size = rig.left.width, rig.left.height
    return size, {side: cell.exposure(side) for side in SIDES}


def _quirk(name: str) -> Quirk:
    try:
        return Quirk(name)
    except ValueError:
        raise UserError(f"--quirk {name!r}; expected one of {', '.join(Quirk)}") from None


def _set_fault(cameras: dict[str, GigeCamera], text: str) -> None:
    """Set a fault given as [SIDE.]NAME=VALUE."""
    name, separator, value = text.partition("=")
    side, dot, fault = name.rpartition(".")
    chosen = [camera for key, camera in cameras.items() if not dot or key == side]
    if not separator or not chosen:
        raise UserError(f"--fault {text!r}; expected NAME=VALUE or left.NAME=VALUE")
    for camera in chosen:
        set_fault(camera.faults, fault, value)


def _is_address(text: str) -> bool:
    try:
        ipaddress.IPv4Address(text)
    except ValueError:
        return False
    return True


@contextmanager
def _stop_signals() -> Iterator[threading.Event]:
    """Return an event that SIGINT and SIGTERM set; they have no other effect meanwhile."""
    stopped = threading.Event()
    before = {
        number: signal.signal(number, lambda *_: stopped.set()) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stopped
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _pulses(cameras: dict[str, GigeCamera], rate_hz: float) -> Iterator[None]:
    """Simulate a sensor that repeatedly sends the same pulse to Line1 of all cameras."""
    ended = threading.Event()

    def work() -> None:
        while not ended.wait(1.0 / rate_hz):
            at_ns = time.monotonic_ns()
            for camera in cameras.values():
                camera.line("Line1").pulse(at_ns=at_ns)

    thread = threading.Thread(target=work, name="sim-pulses", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _lines(stopped: threading.Event) -> Iterator[str]:
    """Yield lines of standard input as they arrive; after its end, wait for a signal."""
    rest, descriptor, is_open = b"", sys.stdin.fileno(), True
    while not stopped.is_set():
        if not is_open:
            stopped.wait()
            return
        if select.select([descriptor], [], [], POLL_S)[0]:
            heard = os.read(descriptor, 4096)
            *lines, rest = (rest + heard).split(b"\n")
            is_open = bool(heard)
            yield from (line.decode(errors="replace") for line in lines)
