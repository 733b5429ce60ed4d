"""Whether the PLC answers whose own memory the cell reads and writes, and has both images."""

from __future__ import annotations

from edged.app.plcmemory import ask
from edged.config.plc import PlcSection
from edged.doctor.findings import Check, bad, ok
from edged.errors import ListenError, PlcFault


def look_at_plc(section: PlcSection) -> Check:
    """Connect, read, hang up; nothing is written."""
    name = "PLC's memory"
    try:
        return ok(name, ask(section))
    except ListenError as error:
        return bad(name, str(error), "the daemon does not start", "install it")
    except PlcFault as fault:
        return bad(
            name,
            str(fault),
            "the PLC gets nothing and commands nothing; the cell tries again for ever",
            f"ping {section.host}; what the PLC must permit: docs/how-to/plc-memory.md",
        )
