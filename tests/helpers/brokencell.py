"""A daemon whose disk fills up, then is read-only, and whose clock is set; needs its own mount namespace.

unshare --mount python -m helpers.brokencell FOLDER; prints what the PLC and the log said as JSON.
"""

from __future__ import annotations

import json
import sys
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

from edged.files import recording
from edged.plc.registers import StatusBit
from helpers.plcwitness import Witness
from helpers.servicefaults import FakeClock, comes_true, full, read_only, tmpfs
from helpers.smallcell import DaemonProcess, SmallCell


def says(daemon: DaemonProcess, word: str, other: str) -> bool:
    """Whether the last log line that contains either word contains the first one."""
    return next((word in line for line in reversed(daemon.log) if word in line or other in line), False)


def newest(disk: Path) -> datetime:
    """Time of the newest recording, by the cell's clock."""
    entries = recording.entries(disk / "recordings")
    return max((entry.recorded for entry in entries), default=datetime.min.replace(tzinfo=UTC))


def main(folder: Path) -> None:
    """Run the daemon through all three faults."""
    with tmpfs(folder / "disk", mib=4) as disk:
        cell = SmallCell(folder / "cell", recordings=disk / "recordings")
        clock = FakeClock(folder / "clock")
        daemon = DaemonProcess(cell.config, clock.environment)
        try:
            with Witness(cell.modbus_port) as witness:
                daemon.wait_ready()
                start_s = time.monotonic()
                for fault in (full(disk), read_only(disk)):
                    with fault:
                        comes_true(lambda: says(daemon, "no recordings", "recording again"), 60)
                        time.sleep(1.0)
                    comes_true(lambda: says(daemon, "recording again", "no recordings"), 60)
                with clock.jumped(3600):
                    was_set = comes_true(lambda: newest(disk) > datetime.now(UTC) + timedelta(minutes=30), 60)
                    time.sleep(1.0)
                time.sleep(1.0)
                end_s = time.monotonic()
        finally:
            daemon.stop()
        kept = len(recording.entries(disk / "recordings"))
    sights = witness.report.between(start_s, end_s)
    told = {
        "wrong": witness.report.wrong,
        "always_ready": all(StatusBit.READY in sight.bits for sight in sights),
        "results": len({sight.exposed_ns for sight in sights}),
        "clock_was_set": was_set,
        "log": daemon.log,
        "recordings": kept,
    }
    print(json.dumps(told))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
