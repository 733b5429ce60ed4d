"""OPC UA: the cell as a vision system of OPC 40100-1, with registers as variables and commands as methods."""

from edged.adapters.opcua.publisher import OpcUaPublisher
from edged.adapters.opcua.security import ServerIdentity, identity_of
from edged.adapters.opcua.settings import OpcUaSettings
