"""Discovery of devices: cameras in this machine's networks, and the PLC whose memory the cell uses."""

from edged.adapters.aravis import (
    CameraInfo,
    HeardCamera,
    aravis_missing,
    control_state,
    give_address,
    list_cameras,
    with_addresses,
)
from edged.adapters.plcmemory import ask as ask_plc

__all__ = [
    "CameraInfo",
    "HeardCamera",
    "aravis_missing",
    "ask_plc",
    "control_state",
    "give_address",
    "list_cameras",
    "with_addresses",
]
