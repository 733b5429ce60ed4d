"""OPC UA: the cell as a vision system of OPC 40100-1, its registers as variables, commands as methods."""

from edged.adapters.opcua.publisher import OpcUaPublisher, Registers
from edged.adapters.opcua.security import Identity, identity_of
from edged.adapters.opcua.settings import OpcUaSettings

__all__ = ["Identity", "OpcUaPublisher", "OpcUaSettings", "Registers", "identity_of"]
