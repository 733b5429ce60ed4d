"""A PLC's own memory: the cell as a client that reads and writes its process image there."""

from edged.adapters.plcmemory.publisher import PlcMemoryPublisher, ask, make_memory
