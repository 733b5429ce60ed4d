"""/api/v1/cameras: list and sides of cameras, exposure and gain, light and focus of live pictures."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from edged.adapters.web.routes import Answer, Call, Leased, Problem, route
from edged.domain.arrays import SIDES
from edged.domain.exposure import CameraValues
from edged.setup.cameras.service import TEST_PAIRS, CameraService
from edged.setup.documents import Message

SIDE = "{side:left|right}"


class OpenNow(Answer):
    """A camera that the cell has open. packet_bytes : null if it sends no packets.

    resent, lost : packets since it was opened; null if not counted.
    """

    firmware: str
    packet_bytes: int | None
    resent: int | None
    lost: int | None


class ConfiguredCamera(Answer):
    """A camera as configured. chosen : a device is assigned. tried : values tried until SETUP ends."""

    chosen: bool
    device: str
    serial: str
    exposure_us: float | None
    gain_db: float | None
    tried: dict[str, str | float]
    open: OpenNow | None


class FoundCamera(Answer):
    """A camera that answers. address_by : persistent, DHCP or link-local; "" if not known.

    is_lost : its address is in another network. trouble : why it cannot be used. side : null if unassigned.
    """

    vendor: str
    model: str
    serial: str
    address: str
    address_by: str
    is_lost: bool
    trouble: Message | None
    side: Literal["left", "right"] | None


class Settings(Answer):
    """Settings in force, as read back; null if the camera has no such setting."""

    exposure_us: float | None
    gain_db: float | None


class CameraBounds(Answer):
    """Smallest and largest possible values."""

    exposure_us: tuple[float, float] | None
    gain_db: tuple[float, float] | None


class Both(Answer):
    """Settings of both cameras."""

    left: Settings
    right: Settings


class BothLimits(Answer):
    """Limits of both cameras."""

    left: CameraBounds
    right: CameraBounds


class TriggerNow(Answer):
    """Trigger of exposures. line : the input, if a pulse triggers. rate_hz : of free-running cameras."""

    mode: str
    line: str
    rate_hz: float | None


class PacketTest(Answer):
    """Number of pairs requested and received, and the state of the cameras afterwards."""

    pairs: int
    came: int
    open: dict[str, OpenNow]


class CamerasNow(Answer):
    """Configured cameras, and those that answer."""

    configured: dict[str, ConfiguredCamera]
    found: list[FoundCamera]
    trigger: TriggerNow


class CameraSettings(Answer):
    """Settings of both cameras, and their limits."""

    settings: Both
    limits: BothLimits


class Adjusting(Leased):
    """Settings of one side to change until SETUP ends."""

    exposure_us: float | None = Field(None, gt=0, le=10_000_000)
    gain_db: float | None = Field(None, ge=-10, le=60)
    serial: str | None = Field(None, min_length=1, max_length=64, description="of the camera for this side")

    @model_validator(mode="after")
    def _is_consistent(self) -> Adjusting:
        if self.exposure_us is None and self.gain_db is None and self.serial is None:
            raise ValueError("expected exposure_us, gain_db or serial")
        return self


class Addressing(Leased):
    """Camera to give an address in this machine's network, by serial number. address : "" for a free one."""

    serial: str = Field(min_length=1, max_length=64)
    address: str = Field("", max_length=15)


class Addressed(Answer):
    """A camera's new address. is_kept : it survives power-off."""

    address: str
    is_kept: bool


class Waving(Leased):
    """The side whose camera the user waves in front of."""

    side: Literal["left", "right"] = "left"


class Waved(Answer):
    """Result of waving. moved : former side of the camera with the hand. exchanged : both were swapped."""

    moved: Literal["left", "right"] | None
    exchanged: bool


class EdgeSpread(Answer):
    """Blur of edges as a sigma, px: of the picture, and by tile from the top left; null for too few edges."""

    median: float | None
    map: list[list[float | None]]


class AdviceNow(Answer):
    """Advice on light. code : good, less_light, more_light, light_for_gain. exposure_factor : suggested."""

    code: str
    exposure_factor: float


class PictureFigures(Answer):
    """Light and sharpness of one picture. sigma_z_factor : increase of sigma Z by its blur."""

    clipped_share: float
    dark_share: float
    noise_grey: float
    contrast_grey: float
    bright_grey: float
    edge_spread_px: EdgeSpread
    sigma_z_factor: float | None
    advice: AdviceNow


class Quality(Answer):
    """Figures of the live pair with this number."""

    number: int
    left: PictureFigures
    right: PictureFigures


class CameraRoutes:
    """The routes of the cameras."""

    def __init__(self, cameras: CameraService) -> None:
        self._cameras = cameras

    @route("GET", "/cameras", "Which cameras there are")
    async def _now(self, _call: Call[None]) -> CamerasNow:
        opened, trigger = self._opened(), self._cameras.trigger
        return CamerasNow(
            configured={
                side: ConfiguredCamera(**camera, open=opened.get(side))
                for side, camera in self._cameras.configured().items()
            },
            found=[FoundCamera(**camera) for camera in await self._cameras.found()],
            trigger=TriggerNow.model_validate(trigger),
        )

    def _opened(self) -> dict[str, OpenNow]:
        return {side: OpenNow.model_validate(camera) for side, camera in self._cameras.open_cameras().items()}

    @route(
        "POST",
        "/cameras/packets",
        "Open both cameras anew, with the largest packets that arrive, and take pairs",
        audit=True,
        needs_lease=True,
    )
    async def _test_packets(self, call: Call[Leased]) -> PacketTest:
        came = await self._cameras.test_packets(call.body.token)
        return PacketTest(pairs=TEST_PAIRS, came=came, open=self._opened())

    @route(
        "POST",
        "/cameras/settings",
        "What both cameras are set to, and the least and the most of it",
        is_by_itself=True,
        needs_lease=True,
    )
    async def _settings(self, call: Call[Leased]) -> CameraSettings:
        token = call.body.token
        values = {side: await self._cameras.adjust(token, side, CameraValues()) for side in SIDES}
        bounds = {side: await self._cameras.limits(token, side) for side in SIDES}
        return CameraSettings(settings=Both.model_validate(values), limits=BothLimits.model_validate(bounds))

    @route(
        "PUT",
        f"/cameras/{SIDE}",
        "Set exposure and gain, or make another camera this one, until SETUP ends",
        audit=True,
        needs_lease=True,
    )
    async def _adjust(self, call: Call[Adjusting]) -> Settings:
        side, body = call.side, call.body
        if body.serial is not None:
            await self._cameras.assign(body.token, side, body.serial)
        values = CameraValues(body.exposure_us, body.gain_db)
        return Settings.model_validate(await self._cameras.adjust(body.token, side, values))

    @route(
        "POST",
        "/cameras/keep",
        "Make what is tried the cell's: exposure and gain; without a rig also which camera is left",
        audit=True,
        needs_lease=True,
    )
    async def _keep(self, call: Call[Leased]) -> None:
        await self._cameras.keep(call.body.token)

    @route(
        "POST",
        "/cameras/wave",
        "Wait for a hand before one camera, and make it this side's",
        audit=True,
        needs_lease=True,
    )
    async def _wave(self, call: Call[Waving]) -> Waved:
        moved, exchanged = await self._cameras.wave(call.body.token, call.body.side)
        return Waved(moved=moved, exchanged=exchanged)

    @route(
        "POST",
        "/cameras/address",
        "Give a camera of another network a free address in this machine's, unless a program controls it",
        audit=True,
        needs_lease=True,
    )
    async def _address(self, call: Call[Addressing]) -> Addressed:
        address, is_kept = await self._cameras.give_address(
            call.body.token, call.body.serial, call.body.address
        )
        return Addressed(address=address, is_kept=is_kept)

    @route("GET", "/cameras/quality", "Light and focus of the last live pictures")
    async def _quality(self, _call: Call[None]) -> Quality:
        document = self._cameras.quality()
        if document is None:
            raise Problem(404, "no_picture", "no live picture has been judged yet")
        return Quality.model_validate(document)
