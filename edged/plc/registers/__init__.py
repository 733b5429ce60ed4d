"""The Modbus map: one schema, from which encoder, documentation and client sources come.

Addresses are PDU addresses, 0-based, before `base_address` is added. Strings of words never hold
half of two results: sequence head and tail and the CRC of a block belong to one encoding.

`schema` is the vocabulary, `layout` the map itself, `codec` turns values into words and back,
`values` turns a snapshot into values.
"""

from edged.plc.registers.codec import CRC_START, crc16, decode, encode
from edged.plc.registers.layout import (
    ADDRESS,
    AXES,
    BLOCKS,
    COMMAND,
    CONSTANTS,
    FLOAT,
    RESULT,
    STATUS,
    TABLE,
    UR,
)
from edged.plc.registers.schema import (
    INT32_MAX,
    INT32_MIN,
    MAGIC,
    MAP_VERSION,
    ROW_WORDS,
    TABLE_ROWS,
    UINT16_MAX,
    UINT32_MAX,
    Block,
    Flag,
    Kind,
    Number,
    Option,
    Register,
    ResultCode,
    StatusBit,
    Warn,
    WordOrder,
)
from edged.plc.registers.values import (
    NOTHING,
    Measured,
    Pose,
    constant_values,
    measured,
    result_values,
    row_values,
)

__all__ = [
    "ADDRESS",
    "AXES",
    "BLOCKS",
    "COMMAND",
    "CONSTANTS",
    "CRC_START",
    "FLOAT",
    "INT32_MAX",
    "INT32_MIN",
    "MAGIC",
    "MAP_VERSION",
    "NOTHING",
    "RESULT",
    "ROW_WORDS",
    "STATUS",
    "TABLE",
    "TABLE_ROWS",
    "UINT16_MAX",
    "UINT32_MAX",
    "UR",
    "Block",
    "Flag",
    "Kind",
    "Measured",
    "Number",
    "Option",
    "Pose",
    "Register",
    "ResultCode",
    "StatusBit",
    "Warn",
    "WordOrder",
    "constant_values",
    "crc16",
    "decode",
    "encode",
    "measured",
    "result_values",
    "row_values",
]
