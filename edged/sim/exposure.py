"""Request of a virtual camera for a rendered image."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ExposureRequest:
    """One exposure of a virtual camera.

    frame_id : the camera's counter, from 1.
    exposed_ns : start of the exposure, host UTC, ns.
    device_ns : the same instant on the camera's own clock.
    exposure_us, gain_db : settings of the camera.
    width, height : of the image to render, (height, width) uint8.
    """

    frame_id: int
    exposed_ns: int
    device_ns: int
    exposure_us: float
    gain_db: float
    width: int
    height: int
