"""The Modbus map: one schema, from which encoder, documentation and client sources are made.

Addresses are PDU addresses, 0-based, before `base_address` is added. A block never mixes two results:
its sequence head, sequence tail and CRC come from one encoding.

`schema` defines the types and codes, `layout` the map itself, `codec` turns values into words and back,
`values` turns a snapshot into values.
"""

from edged.plc.registers.codec import CRC_START, crc16, decode, encode
from edged.plc.registers.layout import (
    ACCEPTANCE,
    ADDRESS,
    AXES,
    BELT,
    BITS,
    BLOCKS,
    COMMAND,
    CONSTANTS,
    COUNTERS,
    FLOAT,
    GRASP,
    JOBS,
    OFFSET,
    PLACE,
    REFERENCE_MARKS,
    REGISTRATION,
    RESULT,
    ROBOT_MAP,
    ROWS,
    STATUS,
    TABLE,
    TABLE_END,
    TRAY,
    UR,
    UR_GRASP,
    UR_OFFSET,
)
from edged.plc.registers.schema import (
    INT32_MAX,
    INT32_MIN,
    MAGIC,
    MAP_PUBLISHED,
    MAP_VERSION,
    ROW_WORDS,
    TABLE_ROWS,
    UINT16_MAX,
    UINT32_MAX,
    Block,
    CellBit,
    ControlBit,
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
    PREFIXES,
    Pose,
    RegisterResult,
    acceptance_values,
    basis_values,
    constant_values,
    counted,
    exchanged,
    job_values,
    map_values,
    marks_values,
    measured,
    registration_values,
    result_values,
    row_values,
)
