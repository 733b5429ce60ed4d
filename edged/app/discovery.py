"""Discovery of devices: cameras in this machine's networks, and the PLC whose memory the cell uses."""

from edged.adapters.aravis import (
    CameraInfo,
    DiscoveredCamera,
    aravis_missing,
    control_state,
    give_address,
    list_cameras,
    with_addresses,
)
from edged.adapters.plcmemory import probe as probe_plc

__all__ = [
    "CameraInfo",
    "DiscoveredCamera",
    "aravis_missing",
    "control_state",
    "give_address",
    "list_cameras",
    "probe_plc",
    "with_addresses",
]
