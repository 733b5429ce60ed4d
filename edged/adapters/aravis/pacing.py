"""Limiting the rate of two cameras that share a network port or a USB controller."""

from __future__ import annotations

import logging
import math
from typing import Any

from edged.adapters.aravis import link
from edged.adapters.aravis.clock import tick_hz
from edged.adapters.aravis.features import Features
from edged.adapters.aravis.library import library
from edged.adapters.aravis.names import BYTES_PER_SECOND, LIMIT_MODE
from edged.adapters.aravis.settings import AravisSettings

log = logging.getLogger(__name__)

LINK_SPEED_REGISTER, PACKET_DELAY_REGISTER = 0x0670, 0x0D08
"""Bootstrap registers (GigE Vision 2.0): speed of the port in Mbit/s; pause after a packet in ticks."""


def pace(name: str, camera: Any, features: Features, settings: AravisSettings) -> float | None:
    """Set a GigE Vision camera's pause after each packet; return the resulting pause, us, None if unchanged.

    Written to the register that every camera has, since the node's name and unit differ. GLib errors pass
    through.
    """
    if any("GevSCPD" in group for group in settings.features):
        return None
    device = camera.get_device()
    if settings.packet_delay_us is not None:
        delay_s = settings.packet_delay_us * 1e-6
    else:
        cameras = link.cameras_on_link(settings.device, settings.neighbour)
        if cameras == 0:
            return None
        try:
            camera_bps = device.read_register(LINK_SPEED_REGISTER) * 1e6 or link.DEFAULT_BPS
        except library(name).glib.Error:  # GigE Vision 1.x has no such register
            camera_bps = link.DEFAULT_BPS
        host_bps = link.host_bps(settings.device)
        _share(name, features, settings, host_bps / cameras / 8)
        delay_s = link.packet_delay_s(camera.gv_get_packet_size(), camera_bps, host_bps, cameras)
    ticks_hz = tick_hz(device) or 10**9
    ticks = math.ceil(delay_s * ticks_hz)
    device.write_register(PACKET_DELAY_REGISTER, ticks)
    found = device.read_register(PACKET_DELAY_REGISTER)
    found_us = float(found / ticks_hz * 1e6)
    if found != ticks:
        log.warning("camera %s: a packet delay of %.1f us became %.1f us", name, delay_s * 1e6, found_us)
    return found_us


def share_usb(name: str, features: Features, settings: AravisSettings) -> None:
    """Limit a USB camera's rate where it shares a controller of this host with another camera."""
    rate = link.usb_bytes_per_second(settings.device, settings.neighbour)
    if rate is not None:
        _share(name, features, settings, rate)


def _share(name: str, features: Features, settings: AravisSettings, bytes_per_second: float) -> None:
    """Limit the rate of a camera that paces itself by one, and ignores the pause between packets."""
    node = features.first(*BYTES_PER_SECOND)
    stated = any(node in group for group in settings.features)
    if not node or stated:
        return
    if "On" in features.choices(LIMIT_MODE) and features.value(LIMIT_MODE) != "On":
        features.write({LIMIT_MODE: "On"})
    if not features.writable(node) or not isinstance(features.value(node), int):
        return
    rate = features.nearest(node, math.floor(bytes_per_second))
    if refused := features.write({node: rate}):  # the camera rounds it to its own steps
        log.warning("camera %s: two cameras share its link: %s", name, "; ".join(refused))
