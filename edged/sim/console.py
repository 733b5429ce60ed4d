"""Line-based command console for running virtual cameras, for people and scripts."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Mapping
from dataclasses import fields

from edged.domain.numerals import decimal
from edged.errors import ListenError, UserError
from edged.sim.gige.camera import GigeCamera
from edged.sim.gige.faults import Faults
from edged.sim.gige.genicam import LINES

HELP = """\
WHO is left, right or both.
  status                       what each camera does, and what is wrong with it
  set WHO FAULT VALUE          one of the faults below; on, off, a number, or numbers 2,3
  clear WHO                    no faults
  pulse WHO [LINE] [MS]        a pulse on an input; Line1, 1 ms
  reboot WHO [SECONDS]         control and settings lost, silent for a while; 0.5 s
  steal WHO, release WHO       another host takes control; nobody has it
  move WHO ADDRESS             another IP address
  temperature WHO CELSIUS
  jump WHO SECONDS             step the clock
  drift WHO PPM                how much faster than this machine's the clock runs
  help, quit
faults: """ + ", ".join(field.name for field in fields(Faults))
SHARES = ("packet_loss", "reordering", "duplication", "answer_loss")


def set_fault(faults: Faults, name: str, text: str) -> None:
    """Set a fault from text. Raises `UserError` that states what was expected."""
    known = {field.name: getattr(Faults(), field.name) for field in fields(Faults)}
    if name not in known:
        raise UserError(f"no fault {name!r}; expected one of {', '.join(known)}")
    default = known[name]
    value: bool | int | float | tuple[int, ...]
    if isinstance(default, bool):
        if text not in ("on", "off"):
            raise UserError(f"{name}: {text!r}; expected on or off")
        value = text == "on"
    elif isinstance(default, float):
        value = number(name, text, 0.0, 1.0 if name in SHARES else 60.0)
    elif isinstance(default, int):
        value = round(number(name, text, 0, 1_000_000))
    else:
        value = tuple(round(number(name, part, 0, 0xFFFFFF)) for part in text.split(",") if part)
    setattr(faults, name, value)


def number(what: str, text: str, low: float, high: float) -> float:
    """Parse a number within limits. Raises `UserError`."""
    try:
        value = decimal(text.strip())
    except ValueError:
        value = float("nan")
    if not low <= value <= high:
        raise UserError(f"{what}: {text!r}; expected a number from {low:g} to {high:g}")
    return value


class SimConsole:
    """Executes commands for named cameras."""

    def __init__(self, cameras: Mapping[str, GigeCamera]) -> None:
        self._cameras = cameras
        self.ended = False
        self._commands: dict[str, tuple[int, int, Callable[[GigeCamera, list[str]], None]]] = {
            "set": (2, 2, lambda camera, words: set_fault(camera.faults, *words)),
            "clear": (0, 0, _clear),
            "pulse": (0, 2, _pulse),
            "reboot": (0, 1, lambda camera, words: camera.reboot(_optional("reboot", words, 0, 0.5, 600))),
            "steal": (0, 0, lambda camera, _: camera.steal_control()),
            "release": (0, 0, lambda camera, _: camera.release_control()),
            "move": (1, 1, _move),
            "temperature": (1, 1, _heat),
            "jump": (1, 1, lambda camera, words: camera.clock.jump(number("jump", words[0], -1e9, 1e9))),
            "drift": (1, 1, _drift),
        }

    @property
    def verbs(self) -> tuple[str, ...]:
        """Commands that take the name of a camera."""
        return tuple(self._commands)

    def execute(self, line: str) -> str:
        """Execute one line and return the reply. Raises `UserError` if it is invalid or fails."""
        verb, *words = line.split() or [""]
        if verb == "":
            return ""
        if verb == "quit":
            self.ended = True
            return ""
        if verb == "help":
            return HELP
        if verb == "status":
            return "\n".join(describe(name, camera) for name, camera in self._cameras.items())
        if verb not in self._commands:
            raise UserError(f"no command {verb!r}; `help` lists them")
        fewest, most, work = self._commands[verb]
        who, *rest = words or [""]
        cameras = list(self._cameras.values()) if who == "both" else [self._cameras.get(who)]
        if None in cameras:
            raise UserError(f"{verb}: no camera {who!r}; expected {', '.join(self._cameras)} or both")
        if not fewest <= len(rest) <= most:
            raise UserError(f"{verb}: {len(rest)} values after {who}; `help` shows what it takes")
        for camera in cameras:
            if camera is not None:
                try:
                    work(camera, rest)
                except ListenError as error:
                    raise UserError(f"{verb} {who}: {error}") from error
        return "ok"


def describe(name: str, camera: GigeCamera) -> str:
    """Status line: name, serial, address, whether controlled, number of exposures, and active faults."""
    wrong = [
        f"{field.name}={getattr(camera.faults, field.name)}"
        for field in fields(Faults)
        if getattr(camera.faults, field.name) != getattr(Faults(), field.name)
    ]
    control = "controlled" if camera.controlled else "free"
    return f"{name}: {camera.serial} at {camera.address}, {control}, {camera.exposures} exposures" + (
        f", {', '.join(wrong)}" if wrong else ""
    )


def _clear(camera: GigeCamera, _words: list[str]) -> None:
    for field in fields(Faults):
        setattr(camera.faults, field.name, getattr(Faults(), field.name))


def _pulse(camera: GigeCamera, words: list[str]) -> None:
    line = words[0] if words else "Line1"
    if line not in LINES:
        raise UserError(f"pulse: no line {line!r}; expected one of {', '.join(LINES)}")
    camera.line(line).pulse(_optional("pulse", words, 1, 1.0, 10_000) * 1e-3)


def _heat(camera: GigeCamera, words: list[str]) -> None:
    camera.temperature_c = number("temperature", words[0], -40, 120)


def _move(camera: GigeCamera, words: list[str]) -> None:
    try:
        address = str(ipaddress.IPv4Address(words[0]))
    except ValueError as error:
        raise UserError(f"move: {words[0]!r}; expected an IPv4 address of this machine") from error
    camera.move_to(address)


def _drift(camera: GigeCamera, words: list[str]) -> None:
    camera.clock.drift_ppm = number("drift", words[0], -100_000, 100_000)


def _optional(what: str, words: list[str], place: int, default: float, high: float) -> float:
    return number(what, words[place], 0, high) if len(words) > place else default
