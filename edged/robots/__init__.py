"""Sources for the programs at the other end, written from the schema of the registers.

`structured_text` for PLCs (IEC 61131-3), and as files for TwinCAT (`twincat`), CODESYS and others (`plcopen`)
and SIMATIC S7 (`scl`); `urscript` for Universal Robots, `python` for PCs.
"""

from edged.robots.as_language import as_source
from edged.robots.drl import drl_source
from edged.robots.karel import karel_files
from edged.robots.krl import krl_files
from edged.robots.melfa import melfa_files
from edged.robots.motoplus import motoplus_files
from edged.robots.plcopen import plcopen_source
from edged.robots.python import python_source
from edged.robots.rapid import rapid_source
from edged.robots.scl import scl_source
from edged.robots.spel import spel_source
from edged.robots.structured_text import structured_text_source
from edged.robots.twincat import twincat_files
from edged.robots.urscript import urscript_source
from edged.robots.val3 import val3_files

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
