"""How a camera is found and set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from edged.adapters.aravis.features import Value
from edged.adapters.aravis.trigger import Output, Software, Trigger


@dataclass(frozen=True, slots=True)
class AravisSettings:
    """How a camera is found and set.

    device : serial number or IP address.
    exposure_us, gain_db : None leaves what the camera has; a value switches the automatic off.
    packet_size : GVSP packet in bytes, IP and UDP headers included; None negotiates the largest that passes.
    serial : the serial number that is expected there; "" takes any camera.
    trigger : what starts an exposure. outputs : lines that show something, a strobe for example.
    chunks : have the exposure time sent with each image and compare it with exposure_us.
    count : have the encoder's or counter's value at each exposure sent with it: "EncoderValue",
        "CounterValue"; "": none.
    ptp : None leaves the PTP clock as the camera has it.
    calibrated : (width, height) of the image that the rig was calibrated with; None takes any.
    packet_delay_us : pause after each packet; None: what the link and the neighbour ask for.
    neighbour : serial number or IP address of the other camera, which sends at the same time.
    features : groups of GenICam nodes by name, one group after the other, before exposure,
        trigger and outputs; within a group size and format of the image come first.
    resend : ask for packets that were lost.
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
