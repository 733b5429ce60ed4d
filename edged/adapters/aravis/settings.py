"""Settings of a GenICam camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from edged.adapters.aravis.features import Value
from edged.adapters.aravis.trigger import Output, Software, Trigger


@dataclass(frozen=True, slots=True)
class AravisSettings:
    """Address, identity and settings of a camera.

    device : serial number or IP address.
    exposure_us, gain_db : None: unchanged; a value switches the automatic off.
    packet_size : GVSP packet in bytes, including IP and UDP headers; None negotiates the largest that passes.
    serial : expected serial number; "" accepts any camera.
    trigger : trigger of an exposure. outputs : output lines, for a strobe for example.
    chunks : have the exposure time sent with each image, and compare it with exposure_us.
    count : chunk with the encoder's or counter's value at each exposure: "EncoderValue", "CounterValue";
        "": none.
    ptp : None leaves the PTP setting of the camera unchanged.
    calibrated : (width, height) of the image that the rig was calibrated with; None accepts any.
    packet_delay_us : pause after each packet; None: computed from the link and the neighbour.
    neighbour : serial number or IP address of the other camera, which sends at the same time.
    features : groups of GenICam nodes by name, written one group after the other, before exposure, trigger
        and outputs; within a group, size and format of the image come first.
    resend : request lost packets again.
    user_socket : receive through an ordinary socket even where a packet socket is allowed.
    """

    device: str
    serial: str = ""
    exposure_us: float | None = None
    gain_db: float | None = None
    trigger: Trigger = field(default_factory=Software)
    outputs: tuple[Output, ...] = ()
    chunks: bool = False
    count: str = ""
    ptp: bool | None = None
    calibrated: tuple[int, int] | None = None
    packet_size: int | None = None
    packet_delay_us: float | None = None
    neighbour: str = ""
    features: tuple[Mapping[str, Value], ...] = ()
    resend: bool = True
    user_socket: bool = False
