"""Sections for the source of images and the trigger of exposures."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, PlainValidator, model_validator

from edged.config.fields import FilePath, Section, is_address


def _feature(value: object) -> bool | int | float | str:
    if not isinstance(value, bool | int | float | str):
        raise ValueError("expected true or false, a number or a text")  # noqa: TRY004  (pydantic's way)
    return value


FeatureGroup = dict[str, Annotated[bool | int | float | str, PlainValidator(_feature)]]


def _groups(value: object) -> object:
    """Accept a single table of features as a list of one."""
    return [value] if isinstance(value, dict) else value


class StrobeSection(Section):
    """Output line that is active while the camera exposes, for a flash."""

    line: str = Field("Line2", min_length=1, description="the output")
    source: str = Field("ExposureActive", min_length=1, description="GenICam LineSource")
    inverted: bool = Field(False, description="low while the camera exposes")


class CameraSection(Section):
    """One camera. Values that are left out stay as they are in the camera."""

    device: str = Field("", description="serial number or IP address")
    serial: str = Field("", description="serial number that is expected at an IP address")
    exposure_us: float | None = Field(
        None, gt=0, le=10_000_000, description="exposure time; switches the camera's automatic off"
    )
    gain_db: float | None = Field(
        None, ge=-10, le=60, description="gain; switches the camera's automatic off"
    )
    packet_size: int | None = Field(
        None, ge=220, le=65_000, description="GVSP packet size in bytes; negotiated when left out"
    )
    packet_delay_us: float | None = Field(
        None, ge=0, le=100_000, description="pause after each packet; from the link's speed when left out"
    )
    strobe: StrobeSection | None = Field(None, description="left out: no line is touched")
    count: Literal["", "EncoderValue", "CounterValue"] = Field(
        "",
        description="have the encoder's or counter's value at each exposure sent with the image, and publish "
        "it; of one camera; left out: none",
    )
    features: Annotated[list[FeatureGroup], BeforeValidator(_groups)] = Field(
        default_factory=list,
        description="any other GenICam node by name, checked and read back; a list of tables is written one "
        "after another",
    )


MODE_KEYS: dict[str, set[str]] = {
    "software": set(),
    "free-run": {"rate_hz"},
    "line": {"line", "edge", "delay_us", "debounce_us"},
    "chain": {"first", "first_line", "output", "line", "edge", "delay_us", "debounce_us"},
    "action": {"device_key", "group_key", "group_mask", "broadcast", "lead_ms"},
}
"""Keys that each trigger mode uses: a setting that would be ignored is a mistake."""
Key = Annotated[int, Field(ge=0, le=0xFFFF_FFFF)]


class TriggerSection(Section):
    """Trigger of an exposure. A key that does not belong to the mode is a mistake."""

    mode: Literal["software", "free-run", "line", "chain", "action"] = Field(
        "software",
        description='"software": a command to each camera; "free-run": the cameras\' own clock; "line": a '
        'pulse on an input of both; "chain": one triggers the other by its exposure-active output; "action": '
        "one GigE Vision command for both",
    )
    rate_hz: float | None = Field(None, gt=0, le=10_000, description="free-run: exposures a second")
    line: str = Field("Line1", min_length=1, description="line, chain: input of the camera that waits for it")
    edge: Literal["rising", "falling", "any"] = Field(
        "rising", description="line, chain: which flank of a pulse starts the exposure"
    )
    delay_us: float = Field(0.0, ge=0, le=10_000_000, description="line, chain: from pulse to exposure")
    debounce_us: float = Field(
        0.0, ge=0, le=1_000_000, description="line, chain: shorter pulses are disturbances, and ignored"
    )
    first: Literal["left", "right"] = Field("left", description="chain: the camera that triggers the other")
    first_line: str = Field("", description="chain: input that triggers the first; left out: software does")
    output: str = Field("Line2", min_length=1, description="chain: the first camera's exposure-active output")
    device_key: Key = Field(1, description="action: the same in both cameras")
    group_key: Key = Field(1, description="action: the same in both cameras")
    group_mask: Key = Field(1, description="action: the same in both cameras")
    broadcast: str = Field("", description="action: broadcast address; left out: to each camera's own")
    lead_ms: float = Field(
        0.0, ge=0, le=1000, description="action: scheduled so long ahead, which needs `ptp`; 0: at once"
    )

    @model_validator(mode="after")
    def _belongs(self) -> TriggerSection:
        if odd := self.model_fields_set - MODE_KEYS[self.mode] - {"mode"}:
            raise ValueError(f"{', '.join(sorted(odd))}: does not belong to mode {self.mode!r}")
        if self.broadcast and not is_address(self.broadcast):
            raise ValueError(f"broadcast: expected an IP address, got {self.broadcast!r}")
        return self

    @property
    def is_self_triggered(self) -> bool:
        """Whether edged itself starts the exposures, at any time."""
        return self.mode not in ("free-run", "line") and not self.first_line

    @property
    def can_be_external(self) -> bool:
        """Whether exposures can be started from outside."""
        return self.mode in ("free-run", "line", "action") or (self.mode == "chain" and self.first_line != "")


class CamerasSection(Section):
    """Source of the images."""

    source: Literal["aravis", "replay", "virtual", "virtual-inprocess"] = Field(
        "aravis",
        description='"aravis": GigE Vision and USB3 Vision; "replay": the pairs of `folder`; "virtual": a '
        'virtual cell with GigE Vision cameras over UDP; "virtual-inprocess": the same without a network',
    )
    folder: FilePath | None = Field(None, description='for "replay": pairs NAME_left.png, NAME_right.png')
    timeout_s: float = Field(1.0, gt=0, le=10, description="from trigger to both images")
    max_skew_ms: float = Field(5.0, gt=0, le=1000, description="limit for two frames to be one exposure")
    max_arrival_skew_ms: float = Field(
        50.0, gt=0, le=1000, description="the same for cameras of which nothing but the arrival is known"
    )
    chunks: bool = Field(False, description="check the exposure time that each image carries as chunk data")
    ptp: bool | None = Field(None, description="the cameras' PTP clocks: on or off; left out: as they are")
    exposure_ratio: float | None = Field(
        None,
        ge=2,
        le=32,
        description="each cycle takes two exposures, `exposure_us` and one shorter by this ratio (8 holds "
        "black and glints of metal), and measures them merged; left out: one",
    )
    trigger: TriggerSection = Field(TriggerSection(), description="what starts an exposure")
    left: CameraSection = Field(CameraSection(), description="the left camera")
    right: CameraSection = Field(CameraSection(), description="the right camera")

    @model_validator(mode="after")
    def _complete(self) -> CamerasSection:
        if self.source == "replay" and self.folder is None:
            raise ValueError('source "replay" needs `folder`')
        if self.source == "aravis":
            if not self.left.device or not self.right.device:
                raise ValueError('source "aravis" needs left.device and right.device (serial number or IP)')
            if self.left.device == self.right.device:
                raise ValueError(f"left and right are the same device {self.left.device!r}")
            if self.left.serial and self.left.serial == self.right.serial:
                raise ValueError(f"left and right expect the same serial number {self.left.serial!r}")
            unicast = self.trigger.mode == "action" and not self.trigger.broadcast
            if unicast and not (is_address(self.left.device) and is_address(self.right.device)):
                raise ValueError("trigger.broadcast: missing; without it both devices must be IP addresses")
        if self.trigger.mode != "software" and self.source not in ("aravis", "virtual"):
            raise ValueError(f"trigger.mode {self.trigger.mode!r} needs cameras, not source {self.source!r}")
        if self.exposure_ratio is not None:
            self._check_two_exposures()
        if self.left.count or self.right.count:
            self._check_count()
        return self

    def _check_count(self) -> None:
        if self.source == "replay":
            raise ValueError(f"count: needs cameras, not source {self.source!r}")
        if self.left.count and self.right.count:
            raise ValueError("count: of one camera only: a result has one")
        if self.exposure_ratio is not None:
            raise ValueError("count: not with exposure_ratio, for which the part lies still")

    def _check_two_exposures(self) -> None:
        if self.source == "replay":
            raise ValueError("exposure_ratio: pictures of a folder were exposed already")
        if not self.trigger.is_self_triggered:
            raise ValueError(
                'exposure_ratio: needs trigger.mode "software", "action" or "chain" without first_line'
            )
        if self.left.exposure_us is None or self.right.exposure_us is None:
            raise ValueError(
                "exposure_ratio: needs left.exposure_us and right.exposure_us, the long exposure"
            )
