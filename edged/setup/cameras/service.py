"""Setting up cameras by hand: available ones, assignment to sides, exposure, light and focus."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Mapping
from typing import Any

from edged.adapters.aravis import (
    CameraInfo,
    DiscoveredCamera,
    aravis_missing,
    give_address,
    list_cameras,
    with_addresses,
)
from edged.cell.lease.judging import PictureJudge
from edged.cell.lease.live import LivePictures
from edged.config.cameras import CameraSection, TriggerSection
from edged.config.chosencameras import UNCHOSEN, ChosenCamera
from edged.domain.arrays import SIDES, Side
from edged.domain.exposure import CameraLimits, CameraValues
from edged.domain.frames import FramePair
from edged.errors import CaptureError, ExposuresDiffer, UserError
from edged.link.summary import OpenCamera
from edged.pictures.change import changed_most, changed_share
from edged.setup.inuse import CellInUse
from edged.setup.releases.service import Activation, Mandate

WAVE_S = 8.0
"""Time to walk to the camera, wave, and come back."""
TEST_PAIRS = 10
"""Pairs of a packet test: at two pairs a second, enough for a walk to the network switch and back."""
SURE = 2
"""Consecutive pairs that must show a hand in front of the same camera."""
VIRTUAL = {
    "vendor": "edged",
    "model": "virtual",
    "serial": "",
    "address": "",
    "address_by": "",
    "is_lost": False,
    "trouble": None,
}
"""Description of a virtual camera in the daemon's own process."""
OTHER: Mapping[Side, Side] = {"left": "right", "right": "left"}


class CameraService:
    """The cameras of a cell in SETUP; used on the event loop only.

    addresses : of virtual cameras, left and right; None without any.
    """

    def __init__(
        self, cell: CellInUse, live: LivePictures, addresses: tuple[str, str] | None, activation: Activation
    ) -> None:
        self._cell = cell
        self._activation = activation
        self._addresses = addresses
        self._values: dict[Side, CameraValues] = {}
        self.judge = PictureJudge(cell.notices, self._gains)
        live.listen(self.judge.look)

    async def close(self) -> None:
        """Stop all work under way."""
        await self.judge.close()

    def configured(self) -> dict[Side, dict[str, Any]]:
        """Configuration of each side, with the values being tried that are not kept."""
        cameras, changes = self._cell.files.config.cameras, self._cell.session.camera_changes
        known: dict[Side, dict[str, Any]] = {}
        for side in SIDES:
            camera = getattr(cameras, side)
            tried = _tried(camera, changes.get(side))
            known[side] = {
                "chosen": tried.get("device", camera.device) != UNCHOSEN[side],
                "device": camera.device or self._address(side),
                "serial": camera.serial,
                "exposure_us": camera.exposure_us,
                "gain_db": camera.gain_db,
                "tried": tried,
            }
        return known

    def quality(self) -> Mapping[str, Any] | None:
        """Light and focus of the last live pair that was judged."""
        return self.judge.latest

    async def found(self) -> list[dict[str, Any]]:
        """Every camera that answers, with its side."""
        if self._cell.files.config.cameras.source == "virtual-inprocess":
            return [{**VIRTUAL, "side": side} for side in SIDES]
        cameras = [] if aravis_missing() else await asyncio.to_thread(_with_addresses)
        devices = self._devices()
        return [_described(info, heard, _side_of(info, devices)) for info, heard in cameras]

    async def give_address(self, token: str, serial: str, address: str = "") -> tuple[str, bool]:
        """Give a camera an address in this machine's network; "" for a free one.

        Returns the address, and whether the camera keeps it without power. Raises `SetupRefused`, and
        `CaptureError` if the camera is missing, is controlled, or refuses.
        """
        await self._cell.session.renew_setup(token)
        return await asyncio.to_thread(give_address, serial, address)

    async def test_packets(self, token: str) -> int:
        """Reopen both cameras, which makes each determine its largest usable packet, and take pairs.

        Returns how many of `TEST_PAIRS` arrived; lost packets are in the summary. Raises `SetupRefused`, and
        `CaptureError` if they cannot be opened.
        """
        kept = self._cell.session.camera_changes.items()
        changes = {
            side: ChosenCamera(device=change.device, serial=change.serial)
            for side, change in kept
            if change.device is not None
        }
        await self._try(token, changes)
        came = 0
        for _ in range(TEST_PAIRS):
            with contextlib.suppress(CaptureError):  # lost frames are what is counted
                await self._cell.session.capture(token)
                came += 1
        return came

    @property
    def trigger(self) -> TriggerSection:
        """Configured trigger of exposures."""
        return self._cell.files.config.cameras.trigger

    def open_cameras(self) -> Mapping[str, OpenCamera]:
        """Cameras that the cell has open, by side."""
        return self._cell.running.summary.cameras

    async def limits(self, token: str, side: Side) -> CameraLimits:
        """Limits of exposure and gain. Raises `SetupRefused`, `CaptureError`."""
        return await self._cell.session.limits(token, side)

    async def adjust(self, token: str, side: Side, values: CameraValues) -> CameraValues:
        """Set the stated values until SETUP ends; return those in force, as read back.

        Raises `UserError` for values outside their limits, `SetupRefused`, `CaptureError`.
        """
        if values != CameraValues() and (problem := (await self.limits(token, side)).problem(values)):
            raise UserError(problem)
        self._values[side] = await self._cell.session.adjust(token, side, values)
        return self._values[side]

    async def assign(self, token: str, side: Side, serial: str) -> None:
        """Make the camera with this serial number the left or right one, until SETUP ends.

        If it was on the other side, both are swapped.

        Raises `UserError` if it does not answer, `SetupRefused`, `CaptureError`.
        """
        self._check_exchangeable()
        cameras = await asyncio.to_thread(list_cameras)
        wanted = next((info for info in cameras if info.serial == serial), None)
        if wanted is None:
            raise UserError(f"no camera with serial number {serial!r} answers")
        await self._assign(token, side, wanted, cameras)

    async def _assign(self, token: str, side: Side, wanted: CameraInfo, cameras: list[CameraInfo]) -> None:
        devices, other = self._devices(), OTHER[side]
        before = self._camera_at(cameras, devices[side])
        if wanted is before:
            return
        changes: dict[Side, ChosenCamera] = {side: _with_camera(wanted)}
        if wanted is self._camera_at(cameras, devices[other]):
            if before is None:
                raise UserError(
                    f"{wanted.serial} is the {other} one, and the camera to take its place is silent"
                )
            changes[other] = _with_camera(before)
        elif (kept := self._cell.session.camera_changes.get(other)) is not None and kept.device is not None:
            changes[other] = ChosenCamera(device=kept.device, serial=kept.serial)
        elif devices[other] == UNCHOSEN[other]:
            # one cannot be tried alone: the other side gets the only remaining free camera
            rest = [info for info in cameras if info is not wanted and info.control in ("", "free")]
            if len(rest) != 1:
                raise UserError(
                    f"two free cameras are needed, and {len(rest) + 1} answer: unplug the others for a moment"
                )
            changes[other] = _with_camera(rest[0])
        await self._try(token, changes)

    async def keep(self, token: str) -> None:
        """Make the values being tried permanent: written beside the cell's rig, and loaded.

        Raises `UserError` if a rig was calibrated with other cameras, if the file cannot be written, or if
        the cell cannot be loaded with it; then nothing has changed. Raises `SetupRefused`.
        """
        await self._cell.session.renew_setup(token)
        changes = self._cell.session.camera_changes
        if self._cell.files.rig is not None and any(
            "device" in change.stated() for change in changes.values()
        ):
            raise UserError(
                "the rig was calibrated with the cameras as they are: calibrate, and activate both"
            )
        await self._activation.keep_cameras(Mandate(self._cell.session.holder, "cameras", token=token))

    async def wave(self, token: str, side: Side) -> tuple[Side | None, bool]:
        """Wait until a hand moves in front of one camera, and assign that camera to this side.

        Returns its former side, None if nobody waved or it was unclear, and whether both were swapped.

        Raises `UserError`, `SetupRefused`, `CaptureError`.
        """
        moved = await self._waved_at(token)
        if moved is None or moved == side:
            return moved, False
        self._check_exchangeable()
        cameras, devices = await asyncio.to_thread(list_cameras), self._devices()
        other = self._camera_at(cameras, devices[moved])
        if other is None:
            raise UserError(f"the {moved} camera does not answer")
        await self._assign(token, side, other, cameras)
        return moved, True

    def _check_exchangeable(self) -> None:
        if self._cell.files.config.cameras.source not in ("aravis", "virtual") or aravis_missing():
            raise UserError("these cameras cannot be exchanged: they are not on a network")

    async def _waved_at(self, token: str) -> Side | None:
        loop = asyncio.get_running_loop()
        deadline_s = loop.time() + WAVE_S
        first = await self._cell.session.capture(token)
        seen: list[Side | None] = []
        while loop.time() < deadline_s:
            seen.append(await self._moves(token, first))
            last = seen[-SURE:]
            if len(last) == SURE and last[0] is not None and len(set(last)) == 1:
                return last[0]
        return None

    async def _moves(self, token: str, first: FramePair) -> Side | None:
        """Side of the camera whose picture has changed since the first one; None if unclear."""
        try:
            pair = await self._cell.session.capture(token)
        except ExposuresDiffer as error:  # the hand moved between two exposures of one picture
            return next((side for side in SIDES if side == error.camera), None)
        shares: dict[Side, float] = {
            side: changed_share(first.side(side).image, pair.side(side).image) for side in SIDES
        }
        return changed_most(shares)

    def _gains(self) -> Mapping[Side, float]:
        return {side: values.gain_db for side, values in self._values.items() if values.gain_db is not None}

    def _address(self, side: Side) -> str:
        return "" if self._addresses is None else self._addresses[SIDES.index(side)]

    def _devices(self) -> dict[Side, str]:
        """Serial number or address of each side's camera, including one being tried."""
        return {
            side: str(entry["tried"].get("device", entry["device"]))
            for side, entry in self.configured().items()
        }

    def _camera_at(self, cameras: list[CameraInfo], device: str) -> CameraInfo | None:
        return next((info for info in cameras if _is_at(info, device)), None)

    async def _try(self, token: str, cameras: Mapping[Side, ChosenCamera]) -> None:
        """Use other cameras with the exposure being tried, set by `adjust`, to be undone when SETUP ends."""
        tried = self._cell.session.camera_changes
        await self._cell.session.try_cameras(token, cameras)
        for side, change in tried.items():
            values = CameraValues(change.exposure_us, change.gain_db)
            if values != CameraValues():
                await self.adjust(token, side, values)


def _tried(configured: CameraSection, change: ChosenCamera | None) -> dict[str, Any]:
    stated = {} if change is None else change.stated()
    return {name: value for name, value in stated.items() if value != getattr(configured, name)}


def _is_at(info: CameraInfo, device: str) -> bool:
    return device in (info.serial, info.address, info.device_id)


def _side_of(info: CameraInfo, devices: Mapping[Side, str]) -> Side | None:
    return next((side for side in SIDES if _is_at(info, devices[side])), None)


def _with_camera(info: CameraInfo) -> ChosenCamera:
    """Choice of a camera by address, and by serial number too, as swapped addresses must not swap cameras."""
    network = info.protocol == "GigEVision"
    return ChosenCamera(device=info.address if network else info.serial, serial=info.serial)


def _with_addresses() -> list[tuple[CameraInfo, DiscoveredCamera | None]]:
    return with_addresses(list_cameras())


def _described(info: CameraInfo, heard: DiscoveredCamera | None, side: Side | None) -> dict[str, Any]:
    trouble = None if info.control in ("", "free") else info.control
    if trouble == "controlled":
        trouble = None if side is not None else "controlled by another program or host"
    if heard is not None and heard.is_lost:
        trouble = "wrong subnet"
    return {
        "vendor": info.vendor,
        "model": info.model,
        "serial": info.serial,
        "address": info.address,
        "address_by": "" if heard is None else heard.ways,
        "is_lost": heard is not None and heard.is_lost,
        "trouble": trouble,
        "side": side,
    }
