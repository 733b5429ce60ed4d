"""The cell as an EtherNet/IP device: identity, assemblies and limits, for adapter and EDS file."""

from __future__ import annotations

from edged.config.servers import ETHERNETIP_PORT
from edged.plc.processimage import FROM_CELL_BYTES, TO_CELL_BYTES

TCP_PORT, IO_PORT = ETHERNETIP_PORT, 2222
"""Explicit messages over TCP and UDP; I/O data over UDP. Registered for EtherNet/IP by IANA."""
VENDOR, VENDOR_NAME = 65_500, "edged (no vendor id of ODVA)"
"""A vendor id as test devices use it: ODVA has assigned none."""
DEVICE_TYPE, DEVICE_TYPE_NAME = 43, "Generic Device (keyable)"
"""0x2B: a device without a device profile (CIP volume 1, 6-1)."""
PRODUCT, PRODUCT_NAME = 1, "edged stereo cell"
REVISION = (1, 1)
"""Major, minor; the major one grows when an image changes its meaning, like MAP_VERSION."""

FROM_CELL_ASSEMBLY, TO_CELL_ASSEMBLY, CONFIGURATION, HEARTBEAT = 100, 150, 151, 152
"""Assembly instances. CONFIGURATION has no bytes; HEARTBEAT is written by a scanner that only reads."""
ASSEMBLIES = {
    FROM_CELL_ASSEMBLY: FROM_CELL_BYTES,
    TO_CELL_ASSEMBLY: TO_CELL_BYTES,
    CONFIGURATION: 0,
    HEARTBEAT: 0,
}
"""Bytes of each assembly."""
LEAST_RPI_US, USUAL_RPI_US, MOST_RPI_US = 10_000, 20_000, 1_000_000
"""Limits of the requested packet interval; below 10 ms a PC that also measures does not keep it."""
MOST_CONNECTIONS = 8
"""One connection that writes, and others that only read."""
