"""Sources for the programs at the other end, written from the schema of the registers.

`structured_text` for PLCs (IEC 61131-3), and as files for TwinCAT (`twincat`), CODESYS and others (`plcopen`)
and SIMATIC S7 (`scl`); `urscript` for Universal Robots, `python` for PCs.
"""

from edged.plc.clients.as_language import as_source
from edged.plc.clients.drl import drl_source
from edged.plc.clients.karel import karel_files
from edged.plc.clients.krl import krl_files
from edged.plc.clients.melfa import melfa_files
from edged.plc.clients.motoplus import motoplus_files
from edged.plc.clients.plcopen import plcopen_source
from edged.plc.clients.python import python_source
from edged.plc.clients.rapid import rapid_source
from edged.plc.clients.scl import scl_source
from edged.plc.clients.spel import spel_source
from edged.plc.clients.structured_text import structured_text_source
from edged.plc.clients.twincat import twincat_files
from edged.plc.clients.urscript import urscript_source
from edged.plc.clients.val3 import val3_files

__all__ = [
    "as_source",
    "drl_source",
    "karel_files",
    "krl_files",
    "melfa_files",
    "motoplus_files",
    "plcopen_source",
    "python_source",
    "rapid_source",
    "scl_source",
    "spel_source",
    "structured_text_source",
    "twincat_files",
    "urscript_source",
    "val3_files",
]
