"""EtherNet/IP: the cell as an adapter that exchanges inputs and outputs with a scanner (class 1)."""

from edged.adapters.enip.publisher import EnipPublisher
from edged.adapters.enip.server import EnipSettings
