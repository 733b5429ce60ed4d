"""GenICam cameras (GigE Vision and USB3 Vision) through Aravis.

    library    loading Aravis, translating its errors, discovery
    addresses  IP addresses of cameras: how each got its own, and assigning another
    features   GenICam nodes by name: checked, written in a safe order, read back
    trigger    trigger of an exposure: software, free run, line, action command
    clock      mapping the camera's clock to the host's
    exposure   exposure time and gain, also while the camera streams
    names      different makers' names for the same feature
    processing switching off filters, look-up tables and test patterns
    lacks      features that a camera does not have
    setup      settings written before a camera is armed, and settings that are refused
    link       computing how fast a camera may send
    pacing     writing that to the camera
    stream     turning buffers into images
    session    one connection: everything that talks to the device, on one thread
    camera     `AravisCamera`: the `Camera` port, on the event loop

Using a camera needs `gir1.2-aravis-0.8` and PyGObject; importing this package does not.
"""

from edged.adapters.aravis.addresses import DiscoveredCamera, give_address, with_addresses
from edged.adapters.aravis.camera import AravisCamera
from edged.adapters.aravis.library import CameraInfo, aravis_missing, control_state, list_cameras
from edged.adapters.aravis.session import CameraHealth
from edged.adapters.aravis.settings import AravisSettings
from edged.adapters.aravis.trigger import Action, FreeRun, LineTrigger, Output, Software, Trigger
