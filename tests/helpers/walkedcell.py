"""A daemon whose cameras see a virtual robot's surroundings: a board on its flange or in the cell, a part.

The poses of the robot, rig and board are exact; the cameras' pictures are rendered from them.
"""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import numpy as np

from edged.app.cell import load_cell
from edged.app.daemon import Daemon
from edged.commands.demo import DemoOptions, prepare_cell
from edged.domain.arrays import FloatArray, Image
from edged.files.rig import load_rig
from edged.robot.orientations import Brand, pose_of
from edged.robots.registervalues import SHIFTS_MM, TURNS_DEG
from edged.sim.cell import VirtualCell
from edged.sim.exposure import ExposureRequest
from edged.sim.inprocess import InProcessCamera
from edged.sim.render.scene import PlacedPart, Scene, Surface, Table, chessboard_plate
from edged.sim.views import stereo_views
from edged.sim.world import VirtualWorld
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rigid import apply, invert, rotation_matrix, transform
from helpers.cells import patient
from helpers.ports import free_port
from helpers.smallcell import HEIGHT, SIDES, STILL_UPRIGHT, TOKEN, WIDTH, tiny_rig
from helpers.snapshots import make_transform
from helpers.waiting import LIMIT_S, POLL_S

BOARD = "chessboard:9x6:4.0"
PLATE = chessboard_plate(9, 6, 4.0)
CENTRE_MM = np.array([16.0, 10.0, 0.0])
"""Centre of the board's marks, in its own frame."""
PLACE_MM = np.array([6.0, 0.0, 235.0])
"""Point that the cameras look at."""
TAUGHT_MM = np.array([8.0, 0.0, 205.0])
"""Place of the part when it was taught."""
ROBOT_FROM_RIG = make_transform((2.9, 0.3, -0.2), (420.0, -60.0, 510.0))
FLANGE_FROM_BOARD = make_transform((0.2, 0.1, -0.5), (12.0, 5.0, 80.0))
FLANGE_FROM_RIG = make_transform((0.02, -0.03, 1.2), (55.0, -8.0, 90.0))
ROBOT_FROM_BOARD = make_transform((3.0, -0.05, 0.7), (610.0, -120.0, 35.0))


class Arm(VirtualWorld):
    """The robot and what the cameras see of it.

    flange : robot_from_flange now. carries_rig : the cameras are on the flange, and the board lies still.
    shows : "board", "part" or "nothing". part : rig_from_part of the part in view.
    """

    def __init__(self, *, carries_rig: bool = False) -> None:
        super().__init__(gige=False)
        self.rig = tiny_rig()
        self.carries_rig = carries_rig
        self.shows = "board"
        self.part = np.eye(4)
        self.flange = self.walk()[0]
        self._views = stereo_views(self.rig)

    def walk(self, turns_deg: Sequence[Sequence[float]] = TURNS_DEG) -> list[FloatArray]:
        """Poses of the flange at which the board is seen, turned about its centre."""
        poses = []
        for turn_deg, shift_mm in zip(turns_deg, SHIFTS_MM, strict=False):
            board = transform(rotation_matrix(np.radians(turn_deg)), PLACE_MM + shift_mm)
            board[:3, 3] -= board[:3, :3] @ CENTRE_MM
            if self.carries_rig:
                poses.append(ROBOT_FROM_BOARD @ invert(board) @ invert(FLANGE_FROM_RIG))
            else:
                poses.append(ROBOT_FROM_RIG @ board @ invert(FLANGE_FROM_BOARD))
        return poses

    @property
    def board(self) -> FloatArray:
        """rig_from_board now."""
        if self.carries_rig:
            return np.asarray(invert(self.flange @ FLANGE_FROM_RIG) @ ROBOT_FROM_BOARD)
        return np.asarray(invert(ROBOT_FROM_RIG) @ self.flange @ FLANGE_FROM_BOARD)

    def in_process_cameras(self) -> tuple[InProcessCamera, InProcessCamera]:
        """Cameras that render the scene at the exposure."""
        left, right = (
            InProcessCamera(side, self._exposure(side), width=WIDTH, height=HEIGHT) for side in SIDES
        )
        return left, right

    def _exposure(self, side: str):  # type: ignore[no-untyped-def]  # of the same shape as VirtualCell's
        def expose(request: ExposureRequest) -> Image:
            table = np.eye(4)
            table[:3, 3] = (*PLACE_MM[:2], 320.0)
            placed = {
                "board": (PlacedPart(PLATE.part, self.board),),
                "part": (PlacedPart(TOKEN, self.part),),
            }.get(self.shows, ())
            scene = Scene(Table(Surface(albedo=0.12), table), placed)
            rng = np.random.default_rng((request.frame_id, SIDES.index(side)))
            return self._views[side].render(scene, rng)

        return expose


class WalkedCell:
    """The daemon of such a cell, as a context. registration : the section's lines, "" for none."""

    def __init__(
        self,
        folder: Path,
        arm: Arm,
        brand: str = "fanuc",
        registration: str = f'board = "{BOARD}"\nlimit_mm = 0.1',
        convention: str = "fixed_xyz",
    ) -> None:
        self.arm = arm
        self.port, self.line_port = free_port(), free_port()
        options = DemoOptions(modbus_port=self.port, web_port=None)
        self.config = prepare_cell(
            folder, VirtualCell(arm.rig, TOKEN, motion=STILL_UPRIGHT), options, gige=False
        )
        text = patient(self.config.read_text()).replace('mode = "free"', 'mode = "command"')
        text = text.replace("[zenoh]", "[zenoh]\nenabled = false")
        text = text.replace("[modbus]", f'[modbus]\nconvention = "{convention}"\nvalidity_s = 60.0')
        text += f'\n[modbus.socket]\nport = {self.line_port}\nbrand = "{brand}"\nallow_simulated = true\n'
        self.write(text + (f"\n[registration]\n{registration}\n" if registration else ""))
        self.brand = Brand(brand)
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))

    def write(self, text: str) -> None:
        """Write another configuration, for `reload`."""
        self.config.write_text(text)

    def __enter__(self) -> WalkedCell:
        self._thread.start()
        assert self._ready.wait(LIMIT_S)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._loop.call_soon_threadsafe(self._daemon.stop)
        self._thread.join(LIMIT_S)
        assert not self._thread.is_alive()

    def reload(self) -> bool:
        """Reload as SIGHUP does, and wait until it is in force, as earlier commands would be refused."""
        return asyncio.run_coroutine_threadsafe(self._reloaded(), self._loop).result(LIMIT_S)

    @property
    def rig(self) -> StereoRig:
        """The rig in its file now."""
        return load_rig(self.config.parent / "rig.json")

    def error_mm(self) -> float:
        """Error of the registration on disk, at the place that the cameras look at."""
        found = self.rig.flange_from_rig if self.arm.carries_rig else self.rig.robot_from_rig
        assert found is not None
        truth = FLANGE_FROM_RIG if self.arm.carries_rig else ROBOT_FROM_RIG
        return float(np.linalg.norm(apply(found, PLACE_MM) - apply(truth, PLACE_MM)))

    def robot(self) -> Talk:
        """A robot that sends lines of text."""
        return Talk(self)

    async def _reloaded(self) -> bool:
        done = await self._daemon.reload()
        while self._daemon._cycle._cell.pending is not None:  # noqa: ASYNC110, SLF001  (there is no event for it)
            await asyncio.sleep(POLL_S)
        return done

    async def _run(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._daemon = Daemon(self.config, load_cell(self.config), world=self.arm)
        task = asyncio.create_task(self._daemon.run())
        while not task.done():
            try:
                _, writer = await asyncio.open_connection("127.0.0.1", self.line_port)
            except OSError:
                await asyncio.sleep(0.01)
                continue
            writer.close()
            await writer.wait_closed()
            break
        self._ready.set()
        await task


class Talk:
    """Sends lines to a cell, and returns the answers as numbers."""

    def __init__(self, cell: WalkedCell) -> None:
        self._cell = cell
        self._sequence = 0
        self._socket = socket.create_connection(("127.0.0.1", cell.line_port), timeout=LIMIT_S)
        self._lines = self._socket.makefile("rb")

    def __enter__(self) -> Talk:
        return self

    def __exit__(self, *_: object) -> None:
        self._lines.close()
        self._socket.close()

    def ask(self, request: str, pose: FloatArray | None = None, brand: Brand | None = None) -> list[float]:
        """Send a request. pose : of the flange, as this brand shows it; None: the cell's brand."""
        self._sequence += 1
        numbers = () if pose is None else pose_of(brand or self._cell.brand, pose)
        line = ",".join([str(self._sequence), request, *(f"{number:.6f}" for number in numbers)])
        self._socket.sendall(line.encode() + b"\n")
        answer = [float(field) for field in self._lines.readline().decode().split(",")]
        assert self._sequence == answer[0], answer
        return answer[1:]

    def add(self, pose: FloatArray, brand: Brand | None = None) -> float:
        """Move to a pose and add it; returns the status."""
        self._cell.arm.flange = pose
        return self.ask("REGISTER_ADD,0", pose, brand)[0]
