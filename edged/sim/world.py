"""A running virtual cell: scenes, and two cameras that image them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import TracebackType

from edged.domain.arrays import SIDES, Image, Side
from edged.sim.belt import VirtualBelt
from edged.sim.cell import VirtualCell, demo_part, demo_rig
from edged.sim.exposure import ExposureRequest
from edged.sim.gige.camera import GigeCamera
from edged.sim.inprocess import InProcessCamera
from edged.sim.showing import Thing
from edged.sim.stage import Stage, stage_board
from edged.vision.geometry.camera import StereoRig

ADDRESSES = ("127.0.0.1", "127.0.0.2")
FLASH_US = 2000.0
"""Exposure time equivalent to the flash over a belt."""
SERIALS = ("EDGED-VIRTUAL-L", "EDGED-VIRTUAL-R")


def cross_wire(left: GigeCamera, right: GigeCamera) -> None:
    """Connect Line2 (output) of each camera to Line1 (input) of the other: either can trigger the other."""
    left.line("Line2").feeds(right.line("Line1"))
    right.line("Line2").feeds(left.line("Line1"))


class VirtualWorld:
    """Two virtual cameras on one virtual cell; a context manager.

    rig : the true rig, including the size of its pictures; None: the demo's.
    addresses : (left, right) of the GigE Vision cameras; None for cameras inside this process.
    stage : for showing board and part interactively; None: the part has a new random pose at every exposure.
    belt : carries the parts; None without a belt.
    """

    def __init__(
        self, *, gige: bool, rig: StereoRig | None = None, seed: int = 0, staged: bool = False
    ) -> None:
        board = stage_board() if staged else None
        self.cell = VirtualCell(rig or demo_rig(), demo_part(), seed=seed, board=board)
        self.stage = Stage(self.cell, seed=seed) if staged else None
        self.addresses = ADDRESSES if gige else None
        self._devices: list[GigeCamera] = []
        self.belt: VirtualBelt | None = None

    def carry(self, belt: VirtualBelt) -> None:
        """Let parts pass on a belt, under a flash; the left camera reports the belt's count."""
        self.belt = belt
        self.cell.show(Thing.PART, belt.pose)

    def __enter__(self) -> VirtualWorld:
        """Start the GigE Vision cameras. Raises `ListenError` if their port is taken."""
        try:
            for address, serial, side in zip(self.addresses or (), SERIALS, SIDES, strict=False):
                width, height = self._size(side)
                device = GigeCamera(address, serial, self.cell.exposure(side), size=(width, height))
                device.start()
                self._devices.append(device)
            if self._devices:
                cross_wire(*self._devices)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop the GigE Vision cameras."""
        while self._devices:
            self._devices.pop().stop()

    @property
    def devices(self) -> tuple[GigeCamera, ...]:
        """The running GigE Vision cameras."""
        return tuple(self._devices)

    def in_process_cameras(self) -> tuple[InProcessCamera, InProcessCamera]:
        """Make cameras that need neither Aravis nor a network."""
        left, right = (
            InProcessCamera(
                side,
                self.cell.exposure(side) if self.belt is None else self._flashed(side),
                width=width,
                height=height,
                count=self._count if side == "left" and self.belt is not None else None,
            )
            for side in SIDES
            for width, height in [self._size(side)]
        )
        return left, right

    def _flashed(self, side: Side) -> Callable[[ExposureRequest], Image]:
        expose = self.cell.exposure(side)
        return lambda request: expose(replace(request, exposure_us=FLASH_US))

    def _count(self, request: ExposureRequest) -> int:
        """The belt's count at the moment shown by both pictures of the pair."""
        assert self.belt is not None
        return self.belt.count(self.cell.moment("left", request).exposed_ns)

    def _size(self, side: Side) -> tuple[int, int]:
        camera = self.cell.view(side).camera
        return camera.width, camera.height
