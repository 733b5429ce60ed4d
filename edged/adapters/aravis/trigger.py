"""Triggers of an exposure: their GenICam settings, and sending action commands.

Software     a command to each camera
FreeRun      the camera's own clock
LineTrigger  a pulse on an input, from outside or from the other camera's exposure-active output
Action       one GigE Vision datagram for all cameras, at once or at a PTP time
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from edged.adapters.aravis.features import Features, Value
from edged.adapters.aravis.library import GVCP_PORT
from edged.adapters.aravis.names import (
    DEBOUNCE_FILTER,
    DEBOUNCE_US,
    EXPOSURE_ACTIVE,
    FRAME_RATE,
    FRAME_RATE_AUTO,
    FRAME_RATE_ENABLE,
    FRAME_TRIGGERS,
    TRIGGER_DELAY,
    TRIGGER_DELAY_ENABLE,
)
from edged.errors import CameraSetupError, FrameTimeout

ACTION_COMMAND, ACTION_ACK = 0x0100, 0x0101
ACK_WANTED, SCHEDULED = 0x01, 0x80
"""GVCP ACTION_CMD and the bits of its flags (GigE Vision 2.0, 16.7)."""

REFUSALS = {
    0x8013: "has no PTP time to schedule the action by",  # GEV_STATUS_NO_REF_TIME
    0x8016: "had the scheduled action too late: its lead is too short",  # GEV_STATUS_ACTION_LATE
}
"""Messages for status codes of GigE Vision 2.0, table 19-1, that an integrator can act on."""

ACK_S = 0.3
"""Wait for an acknowledgement, which takes milliseconds; a repeated command might expose twice."""


Edge = Literal["rising", "falling", "any"]


@dataclass(frozen=True, slots=True)
class Software:
    """Software trigger: a command to the camera."""


@dataclass(frozen=True, slots=True)
class FreeRun:
    """The camera exposes by itself. rate_hz : None: unchanged."""

    rate_hz: float | None = None


@dataclass(frozen=True, slots=True)
class LineTrigger:
    """A pulse on an input of the camera.

    delay_us : from pulse to exposure. debounce_us : shorter pulses are ignored as disturbances.
    """

    line: str = "Line1"
    edge: Edge = "rising"
    delay_us: float = 0.0
    debounce_us: float = 0.0


@dataclass(frozen=True, slots=True)
class Action:
    """A GigE Vision action command.

    send_to : addresses that this camera's `trigger` sends it to; empty where the other camera's `trigger` or
    another host sends it. lead_s : the exposure is scheduled this long ahead on the common PTP clock; 0: at
    once. broadcast : they are broadcast addresses, so no acknowledgement comes.
    """

    device_key: int = 1
    group_key: int = 1
    group_mask: int = 1
    send_to: tuple[str, ...] = ()
    lead_s: float = 0.0
    broadcast: bool = False


Trigger = Software | FreeRun | LineTrigger | Action

ACTIVATIONS: dict[Edge, str] = {"rising": "RisingEdge", "falling": "FallingEdge", "any": "AnyEdge"}


@dataclass(frozen=True, slots=True)
class Output:
    """An output line, for a strobe or to trigger the other camera."""

    line: str
    source: str = "ExposureActive"
    inverted: bool = False


def triggers_itself(trigger: Trigger) -> bool:
    """Whether the camera's `trigger` causes the exposure; else it only waits for an external one."""
    return isinstance(trigger, Software) or (isinstance(trigger, Action) and bool(trigger.send_to))


def arm(camera: str, trigger: Trigger, features: Features, stated: Collection[str] = ()) -> None:
    """Set the trigger of a frame, and switch all other triggers off. Raises `CameraSetupError`.

    stated : features set in the configuration. A frame rate limit left by another program would delay
    triggers: it is switched off, unless it is stated.

    The mode is set before the source, since some firmware forgets a source that is set while the mode is off,
    and after the source, since some switches the mode off when the source changes.
    """
    features.require({"AcquisitionMode": "Continuous"})
    _all_off(camera, features)
    if isinstance(trigger, FreeRun):
        _set_rate(camera, trigger.rate_hz, features)
        return
    if not features.exists("TriggerMode"):
        raise CameraSetupError(
            camera, 'no trigger can be set: it can only run freely (trigger.mode = "free-run")'
        )
    limited = features.first(*FRAME_RATE_ENABLE)
    if limited and limited not in stated and features.value(limited) is True and features.writable(limited):
        features.require({limited: False})
    if isinstance(trigger, LineTrigger):
        _set_input(trigger, features)
    source = _source(camera, trigger, features)
    features.require({"TriggerMode": "On"})
    features.require({"TriggerSource": source})
    if isinstance(trigger, LineTrigger):
        _set_or_neutral(features, ("TriggerActivation",), ACTIVATIONS[trigger.edge], "RisingEdge")
    delay_us = trigger.delay_us if isinstance(trigger, LineTrigger) else 0.0
    if delay_us > 0 and features.exists(TRIGGER_DELAY_ENABLE):
        features.require({TRIGGER_DELAY_ENABLE: True})
    _set_or_neutral(features, TRIGGER_DELAY, delay_us, 0.0)
    if isinstance(trigger, Action):
        _set_action(trigger, source, features)
    features.require({"TriggerMode": "On"})


def set_output(output: Output, features: Features) -> None:
    """Set an output line, whose LineMode may be fixed. Raises `CameraSetupError`."""
    if not features.exists("LineSelector") and features.exists("SyncOutSelector"):
        features.require({"SyncOutSelector": output.line})
        features.require({"SyncOutSource": _shown(output, features, "SyncOutSource")})
        _set_or_neutral(features, ("SyncOutPolarity",), "Invert" if output.inverted else "Normal", "Normal")
        return
    features.require({"LineSelector": output.line})
    if features.writable("LineMode"):
        features.require({"LineMode": "Output"})
    features.require({"LineSource": _shown(output, features, "LineSource")})
    _set_or_neutral(features, ("LineInverter",), output.inverted, neutral=False)


def _shown(output: Output, features: Features, node: str) -> str:
    """Source of an output, by this camera's name for it."""
    words = EXPOSURE_ACTIVE if output.source in EXPOSURE_ACTIVE else (output.source,)
    offered = features.choices(node)
    return next((word for word in words if word in offered), output.source)


def _all_off(camera: str, features: Features) -> None:
    if not features.exists("TriggerMode"):
        return
    if not features.writable("TriggerSelector"):  # it does not exist, or has a single choice (Flea3 GE)
        features.require({"TriggerMode": "Off"})
        return
    selectors = features.choices("TriggerSelector")
    for selector in selectors:
        features.require({"TriggerSelector": selector})
        if features.exists("TriggerMode"):
            features.require({"TriggerMode": "Off"})
    frame = next((name for name in FRAME_TRIGGERS if name in selectors), None)
    if frame is None:
        raise CameraSetupError(camera, f"no trigger of a frame, only {', '.join(selectors)}")
    features.require({"TriggerSelector": frame})


def _set_rate(camera: str, rate_hz: float | None, features: Features) -> None:
    if rate_hz is None:
        return
    if enable := features.first(*FRAME_RATE_ENABLE):
        features.require({enable: True})
    if features.exists(FRAME_RATE_AUTO):  # on some cameras only once the rate is enabled
        features.require({FRAME_RATE_AUTO: "Off"})
    name = features.first(*FRAME_RATE)
    if not name:
        raise CameraSetupError(camera, "trigger rate_hz: the camera has no AcquisitionFrameRate")
    features.require({name: features.number(name, rate_hz)})


def _set_input(trigger: LineTrigger, features: Features) -> None:
    if not features.exists("LineSelector") and features.exists("SyncInSelector"):
        if trigger.debounce_us > 0:  # Line1 is SyncIn1; ns
            features.require({"SyncInSelector": trigger.line.replace("Line", "SyncIn")})
            features.require({"SyncInGlitchFilter": round(trigger.debounce_us * 1e3)})
        return
    if not features.exists("LineSelector") or trigger.line not in features.choices("LineSelector"):
        if trigger.debounce_us > 0:
            features.require({"LineSelector": trigger.line})  # raises, with the choices
        return  # a trigger input need not be a configurable line
    features.require({"LineSelector": trigger.line})
    if features.writable("LineMode"):
        features.require({"LineMode": "Input"})
    if "Debounce" in features.choices(DEBOUNCE_FILTER):
        features.require({DEBOUNCE_FILTER: "Debounce"})
    _set_or_neutral(features, DEBOUNCE_US, trigger.debounce_us, 0.0)


def _source(camera: str, trigger: Trigger, features: Features) -> str:
    """Value of the GenICam TriggerSource for a trigger."""
    if isinstance(trigger, LineTrigger):
        return trigger.line
    if not isinstance(trigger, Action):
        return "Software"
    sources = features.choices("TriggerSource")
    action = next((source for source in sources if source.startswith("Action")), None)
    if action is None:
        raise CameraSetupError(camera, f"no trigger by action command, only by {', '.join(sources)}")
    return action


def _set_action(trigger: Action, source: str, features: Features) -> None:
    if features.choices("ActionSelector"):  # on Blackfly S an enumeration with one entry
        if features.writable("ActionSelector"):
            features.require({"ActionSelector": source})
    elif features.exists("ActionSelector"):  # a number, as in the name of the source, within its limits
        features.require({"ActionSelector": features.nearest("ActionSelector", int(source[6:] or 0))})
    features.require({"ActionDeviceKey": trigger.device_key})
    features.require({"ActionGroupKey": trigger.group_key})
    features.require({"ActionGroupMask": trigger.group_mask})


def _set_or_neutral(features: Features, names: tuple[str, ...], value: Value, neutral: Value) -> None:
    """Write the first existing name. Raises `CameraSetupError` without one, unless the value is neutral."""
    name = features.first(*names)
    if name and isinstance(value, float):
        value = features.number(name, value)
    if name or value != neutral:
        features.require({name or names[0]: value})


def send_action(camera: str, trigger: Action, at_ticks: int | None, request: int) -> None:
    """Send an action command. at_ticks : scheduled for this time of the cameras' PTP clock.

    Waits for the acknowledgements of single cameras; broadcasts have none. Raises `FrameTimeout`.
    """
    flags = 0 if at_ticks is None else SCHEDULED
    body = struct.pack(">III", trigger.device_key, trigger.group_key, trigger.group_mask)
    if at_ticks is not None:
        body += struct.pack(">Q", at_ticks)
    waiting = set[str]()
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            udp.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            udp.settimeout(ACK_S)
            for address in trigger.send_to:
                wanted = 0 if trigger.broadcast else ACK_WANTED
                header = struct.pack(">BBHHH", 0x42, flags | wanted, ACTION_COMMAND, len(body), request)
                udp.sendto(header + body, (address, GVCP_PORT))
                if wanted:
                    waiting.add(address)
            while waiting:
                answer, (address, _) = udp.recvfrom(64)
                waiting.discard(_acknowledged(camera, answer, address, request))
    except TimeoutError:
        silent = ", ".join(sorted(waiting))
        raise FrameTimeout(camera, f"the action command was not acknowledged by {silent}") from None
    except OSError as error:
        raise FrameTimeout(camera, f"the action command: {error.strerror or error}") from error


def _acknowledged(camera: str, answer: bytes, address: str, request: int) -> str:
    """Address that sent an acknowledgement; "" for any other datagram. Raises `FrameTimeout` if refused."""
    if len(answer) < 8:
        return ""
    status, kind, _, number = struct.unpack(">HHHH", answer[:8])
    if kind != ACTION_ACK or number != request:
        return ""
    if status != 0:
        reason = REFUSALS.get(status, f"refused the action command: status 0x{status:04x}")
        raise FrameTimeout(camera, f"{address} {reason}")
    return address


def trigger_names(values: Mapping[str, Any]) -> list[str]:
    """The features among these that `arm` sets."""
    return [name for name in ("TriggerMode", "TriggerSource", "AcquisitionMode") if name in values]
