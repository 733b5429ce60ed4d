"""A virtual GigE Vision camera of a motionless cell, in a process of its own that tests can kill.

python tests/helpers/camera_process.py ADDRESS SERIAL left|right
"""

from __future__ import annotations

import sys
import threading

from edged.sim.cell import PartMotion, VirtualCell, demo_part, demo_rig
from edged.sim.gige.camera import GigeCamera

STILL = PartMotion(shift_mm=(0.0, 0.0), depth_mm=0.0, tilt_rad=0.0, turn_rad=0.0)


def main() -> None:
    """Serve until killed."""
    address, serial, side = sys.argv[1:]
    cell = VirtualCell(demo_rig(), demo_part(), motion=STILL)
    with GigeCamera(address, serial, cell.exposure(side)):
        print("ready", flush=True)
        threading.Event().wait()


if __name__ == "__main__":
    main()
