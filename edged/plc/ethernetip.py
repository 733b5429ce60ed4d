"""The cell as a device of EtherNet/IP: identity, assemblies and limits, for adapter and EDS file."""

from __future__ import annotations

from edged.config.servers import ETHERNETIP_PORT
from edged.plc.processimage import FROM_CELL_BYTES, TO_CELL_BYTES

TCP_PORT, IO_PORT = ETHERNETIP_PORT, 2222
"""Messages over TCP and UDP; inputs and outputs over UDP. Registered for EtherNet/IP by IANA."""
VENDOR, VENDOR_NAME = 65_500, "edged (no vendor id of ODVA)"
"""As test devices have it: ODVA has assigned none."""
DEVICE_TYPE, DEVICE_TYPE_NAME = 43, "Generic Device (keyable)"
"""0x2B: what has no profile (CIP volume 1, 6-1)."""
PRODUCT, PRODUCT_NAME = 1, "edged stereo cell"
REVISION = (1, 1)
"""Major, minor; the major one grows when an image changes its meaning, as MAP_VERSION does."""

FROM_CELL_ASSEMBLY, TO_CELL_ASSEMBLY, CONFIGURATION, HEARTBEAT = 100, 150, 151, 152
"""Instances. Configuration has no bytes; HEARTBEAT is what a scanner writes that only reads."""
ASSEMBLIES = {
    FROM_CELL_ASSEMBLY: FROM_CELL_BYTES,
    TO_CELL_ASSEMBLY: TO_CELL_BYTES,
    CONFIGURATION: 0,
    HEARTBEAT: 0,
}
"""Bytes of each."""
LEAST_RPI_US, USUAL_RPI_US, MOST_RPI_US = 10_000, 20_000, 1_000_000
"""Requested packet interval; below 10 ms a PC that measures beside it does not keep it."""
MOST_CONNECTIONS = 8
"""One that writes, and others that only read."""
