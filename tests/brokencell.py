"""A daemon whose disk fills and becomes read-only and whose clock is set; to be run in a mount name space.

unshare --mount python tests/brokencell.py FOLDER; prints what the PLC and the log said as JSON.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from plcwitness import Witness
from servicefaults import FAKETIME, FakeClock, full, live_through, read_only, tmpfs
from smallcell import DaemonProcess, SmallCell

from edged import recording
from edged.registers import StatusBit


def main(folder: Path) -> None:
    """Live through all three."""
    with tmpfs(folder / "disk", mib=4) as disk:
        cell = SmallCell(folder / "cell", recordings=disk / "recordings")
        clock = FakeClock(folder / "clock") if FAKETIME.exists() else None
        daemon = DaemonProcess(cell.config, clock.environment if clock else None)
        try:
            with Witness(cell.modbus_port) as witness:
                daemon.wait_ready()
                faults = [("full", full(disk)), ("read-only", read_only(disk))]
                faults += [("clock", clock.jumped(3600))] if clock else []
                phases = live_through(faults, each_s=2.0)
        finally:
            daemon.stop()
        kept = len(recording.entries(disk / "recordings"))
    sights = witness.report.between(phases[0].start_s, phases[-1].end_s)
    true_ns = max(sight.exposed_ns for sight in sights if sight.at_s < phases[0].end_s)
    told = {
        "wrong": witness.report.wrong,
        "always_ready": all(StatusBit.READY in sight.bits for sight in sights),
        "results": len({sight.exposed_ns for sight in sights}),
        "results_ahead": len({s.exposed_ns for s in sights if s.exposed_ns > true_ns + 1800 * 10**9}),
        "log": daemon.log,
        "recordings": kept,
    }
    print(json.dumps(told))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
