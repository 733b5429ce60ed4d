"""EtherNet/IP: the cell as an adapter, which a scanner exchanges inputs and outputs with (class 1)."""

from edged.adapters.enip.publisher import EnipPublisher
from edged.adapters.enip.server import EnipSettings
