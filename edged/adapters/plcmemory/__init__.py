"""Memory of a PLC: the cell as a client that reads and writes its process images there."""

from edged.adapters.plcmemory.publisher import PlcMemoryPublisher, make_memory, probe
