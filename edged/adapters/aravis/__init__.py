"""GenICam cameras (GigE Vision and USB3 Vision) through Aravis.

    library    finding Aravis, its errors as ours, what is on the network
    features   GenICam nodes by name: checked, written in a safe order, read back
    session    one connection: everything that talks to the device, on one thread
    camera     `AravisCamera`: the port, on the event loop

Needs `gir1.2-aravis-0.8` and PyGObject when a camera is used; importing this package does not.
"""

from edged.adapters.aravis.camera import AravisCamera
from edged.adapters.aravis.library import CameraInfo, aravis_missing, list_cameras
from edged.adapters.aravis.session import AravisSettings

__all__ = ["AravisCamera", "AravisSettings", "CameraInfo", "aravis_missing", "list_cameras"]
