"""Which cameras answer in the networks of this machine, who controls them, and which addresses they have."""

from edged.adapters.aravis import (
    CameraInfo,
    HeardCamera,
    aravis_missing,
    control_state,
    give_address,
    list_cameras,
    with_addresses,
)

__all__ = [
    "CameraInfo",
    "HeardCamera",
    "aravis_missing",
    "control_state",
    "give_address",
    "list_cameras",
    "with_addresses",
]
