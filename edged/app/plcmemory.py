"""Whether the PLC answers whose own memory the cell reads and writes."""

from edged.adapters.plcmemory import ask

__all__ = ["ask"]
