"""GenICam cameras (GigE Vision and USB3 Vision) through Aravis.

    library    finding Aravis, its errors as ours, what is on the network
    addresses  how cameras get their IP addresses, and another one where it is needed
    features   GenICam nodes by name: checked, written in a safe order, read back
    trigger    what starts an exposure: software, free run, line, action command
    clock      the camera's time against the host's
    exposure   exposure time and gain, also while it streams
    names      what cameras of many makers call the same thing
    processing filters, tables and test patterns: off
    lacks      what a camera has not
    setup      settings of a camera before it is armed, and what is refused
    link       how fast it may send
    pacing     that, written to it
    stream     buffers as images
    session    one connection: everything that talks to the device, on one thread
    camera     `AravisCamera`: the port, on the event loop

Needs `gir1.2-aravis-0.8` and PyGObject when a camera is used; importing this package does not.
"""

from edged.adapters.aravis.addresses import HeardCamera, give_address, with_addresses
from edged.adapters.aravis.camera import AravisCamera
from edged.adapters.aravis.library import CameraInfo, aravis_missing, control_state, list_cameras
from edged.adapters.aravis.session import CameraHealth
from edged.adapters.aravis.settings import AravisSettings
from edged.adapters.aravis.trigger import Action, FreeRun, LineTrigger, Output, Software, Trigger
