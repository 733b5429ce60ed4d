"""Sources for the programs at the other end, written from the schema of the registers.

`structured_text` for PLCs (IEC 61131-3), `urscript` for Universal Robots, `python` for PCs.
"""

from edged.plc.clients.python import python_source
from edged.plc.clients.structured_text import structured_text_source
from edged.plc.clients.urscript import urscript_source

__all__ = ["python_source", "structured_text_source", "urscript_source"]
