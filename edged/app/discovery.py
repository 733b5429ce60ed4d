"""Which cameras answer in the networks of this machine, and who controls them."""

from edged.adapters.aravis import CameraInfo, aravis_missing, control_state, list_cameras

__all__ = ["CameraInfo", "aravis_missing", "control_state", "list_cameras"]
