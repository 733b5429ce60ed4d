"""Builds the stereo head of a configuration: which cameras, and how they are triggered."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edged.adapters.aravis import (
    Action,
    AravisCamera,
    AravisSettings,
    CameraHealth,
    FreeRun,
    LineTrigger,
    Output,
    Software,
    Trigger,
)
from edged.adapters.replay import replay_cameras
from edged.cell.stereohead import HeadSettings, StereoHead
from edged.cell.twoexposures import TwoExposureHead
from edged.config.cameras import CameraSection, CamerasSection, TriggerSection
from edged.domain.arrays import SIDES
from edged.errors import ConfigError
from edged.link.summary import OpenCamera
from edged.payload import Json, translatable
from edged.ports import Camera, Head

if TYPE_CHECKING:  # a cell with real cameras starts without the simulation
    from edged.sim.world import VirtualWorld

Size = tuple[int, int]
CellHead = StereoHead | TwoExposureHead


@dataclass(frozen=True, slots=True)
class Triggering:
    """How both cameras are triggered together.

    triggers, outputs : of left and right. follower : the camera to be armed before the other is triggered;
    "" if the order does not matter.
    """

    triggers: tuple[Trigger, Trigger]
    outputs: tuple[tuple[Output, ...], tuple[Output, ...]] = ((), ())
    follower: str = ""


def head_of(
    cameras: CamerasSection,
    world: VirtualWorld | None = None,
    *,
    external: bool = False,
    calibrated: tuple[Size, Size] | None = None,
) -> CellHead:
    """Return the stereo head of a configuration, not yet open.

    world : source of virtual cameras. external : triggered externally, the daemon only listens.
    calibrated : (width, height) of the images that the rig was calibrated with, left and right; None: any.
    """
    left: Camera
    right: Camera
    triggering = Triggering((Software(), Software()))
    if cameras.source == "replay" and cameras.folder is not None:
        left, right = replay_cameras(cameras.folder)
    elif cameras.source == "aravis" or (world is not None and world.addresses is not None):
        sections = [cameras.left, cameras.right]
        if world is not None and world.addresses is not None and cameras.source != "aravis":
            sections = [
                section.model_copy(update={"device": section.device or address})
                for section, address in zip(sections, world.addresses, strict=True)
            ]
        devices = [section.device for section in sections]
        triggering = triggering_of(cameras.trigger, devices, external=external)
        left, right = (
            _aravis(cameras, sections, side, triggering, None if calibrated is None else calibrated[side])
            for side in range(2)
        )
    elif world is None:
        raise ConfigError("cameras.source", [f"a change to {cameras.source!r} needs a restart"])
    else:
        left, right = world.in_process_cameras()
    head = StereoHead(
        left,
        right,
        HeadSettings(
            timeout_s=cameras.timeout_s,
            max_skew_s=cameras.max_skew_ms * 1e-3,
            max_arrival_skew_s=cameras.max_arrival_skew_ms * 1e-3,
            follower=triggering.follower,
            free_running=isinstance(triggering.triggers[0], FreeRun),
            by_others=all(isinstance(trigger, LineTrigger) for trigger in triggering.triggers),
            detect_frozen=cameras.source != "replay",
            image_sizes=calibrated,
        ),
    )
    if cameras.exposure_ratio is None:
        return head
    long_us = {side: getattr(cameras, side).exposure_us for side in SIDES}
    settles = cameras.trigger.mode != "software"
    return TwoExposureHead(head, long_us, cameras.exposure_ratio, settles=settles)


def triggering_of(section: TriggerSection, devices: Sequence[str], *, external: bool) -> Triggering:
    """Return how the configuration triggers both cameras. devices : addresses of the cameras."""
    line = LineTrigger(section.line, section.edge, section.delay_us, section.debounce_us)
    match section.mode:
        case "free-run":
            free = FreeRun(section.rate_hz)
            return Triggering((free, free))
        case "line":
            return Triggering((line, line))
        case "chain":
            first = LineTrigger(section.first_line) if section.first_line else Software()
            shown = (Output(section.output),)
            if section.first == "left":
                return Triggering((first, line), (shown, ()), "right")
            return Triggering((line, first), ((), shown), "left")
        case "action":
            keys = (section.device_key, section.group_key, section.group_mask)
            to = (section.broadcast,) if section.broadcast else tuple(devices)
            sending = Action(
                *keys,
                send_to=() if external else to,
                lead_s=section.lead_ms * 1e-3,
                broadcast=section.broadcast != "",
            )
            return Triggering((sending, Action(*keys)), follower="" if external else "right")
        case _:
            return Triggering((Software(), Software()))


ALIKE = ("device", "serial", "exposure_us", "gain_db", "packet_size", "packet_delay_us", "count")
"""Options with the same name in a camera's configuration and its adapter's settings."""


def _aravis(
    cameras: CamerasSection,
    sections: Sequence[CameraSection],
    side: int,
    triggering: Triggering,
    calibrated: Size | None,
) -> AravisCamera:
    section, neighbour = sections[side], sections[1 - side]
    outputs = triggering.outputs[side]
    if section.strobe is not None:
        outputs += (Output(section.strobe.line, section.strobe.source, section.strobe.inverted),)
    return AravisCamera(
        SIDES[side],
        AravisSettings(
            **section.model_dump(include=set(ALIKE)),
            trigger=triggering.triggers[side],
            outputs=outputs,
            chunks=cameras.chunks,
            ptp=cameras.ptp,
            calibrated=calibrated,
            neighbour=neighbour.device,
            features=tuple(section.features),
        ),
    )


def camera_facts(head: CellHead) -> dict[str, list[Json]]:
    """Return the state of each camera as text for people; a lost camera stays in the list."""
    facts = {
        camera.name: [translatable("not-connected", "not connected")]
        for camera in head.cameras
        if isinstance(camera, AravisCamera)
    }
    for camera, health in _healths(head):
        parts = []
        if health.temperature_c is not None:
            celsius = f"{health.temperature_c:.1f}"
            parts.append(translatable("temperature", f"{celsius} °C", value=celsius))
        kind = "PTP" if health.ptp else "free-running"
        if health.clock_bound_ns is None:
            parts.append(translatable(f"clock-{kind.lower()}", f"clock: {kind}"))
        else:
            bound = f"{health.clock_bound_ns * 1e-3:.0f}"
            parts.append(
                translatable(f"clock-{kind.lower()}-within", f"clock: {kind}, ±{bound} µs", bound=bound)
            )
        if health.gamma != 1.0:
            parts.append(translatable("gamma", f"Gamma {health.gamma:g}", value=f"{health.gamma:g}"))
        if health.complete is not None:
            whole, damaged = str(health.complete), str(health.failed or 0)
            parts.append(
                translatable("images", f"{whole} images, {damaged} damaged", whole=whole, damaged=damaged)
            )
        if health.resent is not None:
            resent, lost = str(health.resent), str(health.lost or 0)
            parts.append(
                translatable("packets", f"packets: {resent} resent, {lost} lost", resent=resent, lost=lost)
            )
        if health.packet_delay_us is not None:
            pause = f"{health.packet_delay_us:.1f}"
            parts.append(translatable("packet-delay", f"{pause} µs between packets", pause=pause))
        if health.lacks:
            what = "; ".join(str(lack) for lack in health.lacks)
            parts.append(translatable("lacks", f"has not: {what}", what=what))
        facts[camera] = parts
    if isinstance(head, TwoExposureHead) and head.taken is not None:
        taken = head.taken
        long, short = f"{taken.long_us:.0f}", f"{taken.short_us:.0f}"
        apart = f"{taken.apart_ns * 1e-6:.0f}"
        text = f"exposed for {long} and {short} µs, {apart} ms apart"
        for parts in facts.values():
            parts.append(translatable("two-exposures", text, long=long, short=short, apart=apart))
    return facts


def camera_gammas(head: CellHead) -> dict[str, tuple[float, str]]:
    """Return each open camera's gamma (exponent from light to grey value) and the setting that makes it 1."""
    return {
        camera: (health.gamma, f"{health.linear[0]} = {json.dumps(health.linear[1])}")
        for camera, health in _healths(head)
    }


def open_cameras(head: Head) -> dict[str, OpenCamera]:
    """Return the open cameras, by side, for the set-up page."""
    if not isinstance(head, StereoHead | TwoExposureHead):
        return {}
    return {
        camera: OpenCamera(health.firmware, health.packet_bytes, health.resent, health.lost)
        for camera, health in _healths(head)
    }


def camera_figures(head: CellHead) -> dict[str, tuple[str, float]]:
    """Return camera figures for /metrics: name to (help text, value)."""
    figures: dict[str, tuple[str, float]] = {}
    for camera, health in _healths(head):
        for name, text, value in (
            ("temperature_celsius", "temperature", health.temperature_c),
            ("clock_bound_seconds", "how well its clock is known", _seconds(health.clock_bound_ns)),
            ("images", "complete images since it was opened", health.complete),
            ("damaged_images", "incomplete images since it was opened", health.failed),
            ("resent_packets", "packets resent since it was opened", health.resent),
            ("lost_packets", "packets that never came since it was opened", health.lost),
        ):
            if value is not None:
                figures[f"camera_{camera}_{name}"] = (f"{camera} camera: {text}", value)
    return figures


def _healths(head: CellHead) -> list[tuple[str, CameraHealth]]:
    cameras = [camera for camera in head.cameras if isinstance(camera, AravisCamera)]
    return [(camera.name, health) for camera in cameras if (health := camera.health) is not None]


def _seconds(duration_ns: int | None) -> float | None:
    return None if duration_ns is None else duration_ns * 1e-9
