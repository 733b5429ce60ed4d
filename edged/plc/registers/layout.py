"""Blocks of the map, word by word: the only place where addresses are defined.

A row of a table is: name, kind, unit ("-": none; "_" is a space), meaning. A name with [XYZABC] stands for
one register per axis, in the first unit for lengths and in the second for angles.
"""

from __future__ import annotations

from edged.domain.acceptance import AcceptanceState
from edged.domain.cell import SetupSource
from edged.domain.events import CommandKind
from edged.domain.golden import GoldenState
from edged.domain.marks import MarksState
from edged.domain.measurement import Reject
from edged.domain.registration import Method
from edged.plc.registers.schema import (
    JOB_ROWS,
    NAME_WORDS,
    ROW_WORDS,
    TABLE_ROWS,
    Block,
    CellBit,
    ControlBit,
    Flag,
    Option,
    ResultCode,
    StatusBit,
    Warn,
    list_bits,
    list_codes,
    make_block,
)
from edged.robot.orientations import Convention

AXES = ("X", "Y", "Z", "A", "B", "C")

CONSTANTS = make_block(
    "constants",
    0,
    f"""
    MAGIC            u16 - 0x4544: this is edged, and the base address is right
    MAP_VERSION      u16 - grows when a word changes its meaning
    PROBE_U32        u32 - 0x01020304: reads so only with the right word order
    PROBE_F32        f32 - 123.456, for the same check of floats
    POSE_CONVENTION  u16 - what A, B, C mean: {list_codes(Convention)}
    UNIT_LENGTH      u16 - unit of X, Y, Z: 1 is µm
    UNIT_ANGLE       u16 - unit of A, B, C: 1 is 0.001°
    RESERVED_9       u16 - 0
    CONFIG_CRC       u32 - fingerprint of the configuration, rig and jobs that are loaded
    CALIBRATION      u32 - CRC-32 of the id of the calibration that is loaded
    TABLE_ROWS       u16 - rows of the target table
    ROW_WORDS        u16 - words of each row
    """,
)

COMMAND = make_block(
    "command",
    100,
    f"""
    COMMAND          u16 - {list_codes(CommandKind)}. GRAB takes the picture only; VERIFY measures and
        answers OK or NOK, but no robot gets coordinates from it; NEXT_PART goes on with the parts of the
        last LOCATE; NEXT_GRASP gives another way to take the part that is shown; GOLDEN measures and keeps
        where the one good part lies: RESULT is then KEPT, and later results have an offset from it; the
        others register the rig by the robot's own program, where `[registration]` allows it
    JOB              u16 - job number; 0: the active one
    CMD_SEQ          u16 - write it last: the command runs when this changes. 0: no command, shows a
        free-running cell. The first one of a connection, and after the start or another client's, runs
        nothing (NACK 8)
    ACK_SEQ          u16 - write SEQ of the result here when it is used: RESULT_VALID drops
    CLIENT_HEARTBEAT u16 - optional: count it up; when it stops the result is withdrawn. 0: not supervised
    OPTIONS          u16 bits {list_bits(Option)}; reads back as 0. RELEASE gives up the right to write. The
        others count in one request with CMD_SEQ. ONCE: it is not written again and again, so it runs as the
        first of a connection, too. ALL_JOBS: every job is tried, none is begun after 3 s; JOB of the result
        is the one whose part agrees best. SKIP: the part that was shown last could not be picked; the one
        nearest to its place, within 30 mm, comes behind all other good parts of this picture. BELT:
        BELT_COUNT and BELT_SPEED are those of now
    FLANGE_[XYZABC]  i32 µm/0.001° pose of the flange at the exposure, A, B, C as POSE_CONVENTION says, for a
        rig that the robot carries (LOCATE and GOLDEN are refused without it), and for REGISTER_ADD (after
        TOUCH_START of the tool's tip where it touched); with [limits.gripper] the tool turns least from
        there; serves one command, then reads 0
    TIMEOUT          u16 ms time-out of the command, NACK after it; 0: none
    AUTO_LOCK        u16 - 1: the plant runs; nobody may take the cell for SETUP, and who has it loses it.
        0: they may; so it is without the connection that wrote 1
    BOX              u16 - of the boxes of the cell's `[limits]` this one alone counts for the command, from
        1; 0: each of them. Stays as it was written
    CONTROL          u16 bits {list_bits(ControlBit)}; bits 8 to 15 are the job, 0: the active one. For a
        program without CMD_SEQ, which it then must not write; BITS answers. Written last, or alone
    BELT_COUNT       u32 - of the conveyor belt's encoder, as the client read it just before it wrote; for a
        command with BELT in OPTIONS
    BELT_SPEED       u32 µm/s of the belt, then; 0: it stands
    """,
    writable=True,
)

STATUS = make_block(
    "status",
    200,
    f"""
    STATE            u16 - 0 STARTING, 1 READY, 2 BUSY, 3 FAULT, 4 STOPPING, 5 SETUP
    STATUS_BITS      u16 bits {list_bits(StatusBit)}; ACK and NACK belong to DONE_SEQ; 13 and 14 are not
        raised by this version
    CMD_SEQ_ECHO     u16 - the CMD_SEQ that was taken note of
    HEARTBEAT        u16 0.1_s counts at 10 Hz while the server lives
    ERROR            u16 - 0: none; 1xx: cameras; 1: other, see the log
    WARNING          u16 bits {list_bits(Warn)}: no client's CMD_SEQ is known, the next one runs nothing
    ACTIVE_JOB       u16 - the job that is loaded and warm
    RESULT_AGE       u32 ms since the exposure of the result on display; 0xFFFFFFFF: none
    MISSED_TRIGGERS  u16 - since start; stays at 65535
    CLIENTS          u16 - connected clients
    DONE_SEQ         u16 - the last command that ended, the newest one from its end on; ACK, NACK,
        NACK_REASON speak of it
    OPEN_COMMANDS    u16 - accepted and not ended, at most 8
    NACK_REASON      u16 - 0 none, 1 unknown command, 2 refused, 3 queue full, 4 time-out, 5 failed,
        6 camera fault, 7 the cell is in SETUP, 8 first CMD_SEQ of a connection, or after a start or another
        client's: nothing ran, 9 no next part or grasp; of a registration 10 none is under way, 11 not seen,
        12 same place, 13 too few, 14 turn more, 15 not good, 16 other reading; 17 there was a reload while
        it waited
    WRITE_OWNER      u16 - 1: a client holds the right to write
    LAST_SEQ         u16 - the newest CMD_SEQ other than 0 since the start: a program that begins goes on
        after it
    START_EPOCH      u32 - another number after each start of the daemon or of this server, and after each
        exchange of what results stand on (rig, jobs, limits, cameras); never 0
    SETUP_SOURCE     u16 - why the cell is in SETUP: {list_codes(SetupSource)}
    CONVENTION       u16 - as POSE_CONVENTION, for a program to know before it commands
    """,
)

RESULT = make_block(
    "result",
    300,
    f"""
    SEQ_HEAD         u16 - CMD_SEQ of the command; cycle number of a free-running cell; 0: no result
    RESULT           u16 - {list_codes(ResultCode)}
    JOB              u16 - job that was measured
    REJECT           u16 bits {list_bits(Reject)}
    COUNT            u16 - targets that were found
    INDEX            u16 - row of the target table that is shown here; NEXT_PART shows a later one
    SCORE            u16 0.01_% visible share of the model that agrees
    FLAGS            u16 bits {list_bits(Flag)}; coordinates are in the rig frame without ROBOT_FRAME
    [XYZABC]         i32 µm/0.001° INT32_MIN when not VALID
    RADIUS           i32 µm of the largest circle; INT32_MIN when there is none
    DEPTH            i32 µm of the reference point along the left camera's axis
    SIGMA_[XYZABC]   u16 0.1_µm/0.001° one sigma; 65535: not known, or larger than can be written
    SIGMA_RADIUS     u16 0.1_µm one sigma; 65535: not known, or larger than can be written
    SIGMA_DEPTH      u16 0.1_µm one sigma; 65535: not known, or larger than can be written
    EPIPOLAR_ERROR   u16 0.001_px rms row difference of corresponding points; 65535: not known
    REMAINING        u16 - good parts of the same exposure that NEXT_PART can still give
    EXPOSURE_NS      u64 ns UTC of the exposure since 1970
    CYCLE            u32 - cycle number
    LATENCY          u32 µs from exposure to publication
    CALIBRATION      u32 - CRC-32 of the calibration id
    START_EPOCH      u32 - as in the status: the start to which this result belongs
    CRC16            u16 - CRC-16/MODBUS of the words before, each high byte first
    SEQ_TAIL         u16 - equals SEQ_HEAD as long as the block says what it said when the result appeared;
        0 once it is withdrawn: acknowledged, too old, or RESULT is RELOADED
    """,
)

UR = make_block(
    "ur",
    400,
    """
    UR_SEQ_HEAD      u16 - as SEQ_HEAD
    UR_FLAGS         u16 bits as FLAGS
    UR_RESULT        u16 - as RESULT
    UR_[XYZ]         i32 µm high word, low word; 32768, 0 when not VALID
    UR_R[XYZ]        i32 µrad rotation vector, high word, low word; 32768, 0 when not VALID
    UR_JOB           u16 - as JOB
    UR_STATUS_BITS   u16 bits as STATUS_BITS
    UR_DONE_SEQ      u16 - as DONE_SEQ
    UR_HEARTBEAT     u16 0.1_s as HEARTBEAT
    UR_CMD_SEQ_ECHO  u16 - as CMD_SEQ_ECHO
    UR_NACK_REASON   u16 - as NACK_REASON
    UR_LAST_SEQ      u16 - as LAST_SEQ
    UR_START_EPOCH   u32 - as START_EPOCH
    UR_CRC16         u16 - CRC-16/MODBUS of the words before, each high byte first
    UR_SEQ_TAIL      u16 - as SEQ_TAIL
    UR_REMAINING     u16 - as REMAINING
    """,
    high_first=True,
)

UR_GRASP = make_block(
    "ur grasp",
    427,
    """
    UG_SEQ_HEAD       u16 - as SEQ_HEAD
    UG_FLAGS          u16 bits as FLAGS; VALID when the part has a grasp
    UG_GRASP          u16 - as GRASP
    UG_[XYZ]          i32 µm of the grasp; 32768, 0 when not VALID
    UG_R[XYZ]         i32 µrad rotation vector; 32768, 0 when not VALID
    UG_APPROACH_[XYZ] i32 µm from where the tool comes, turned alike
    UG_RETREAT        i32 µm as G_RETREAT
    UG_START_EPOCH    u32 - as START_EPOCH
    UG_CRC16          u16 - CRC-16/MODBUS of the words of this block before, each high byte first
    UG_SEQ_TAIL       u16 - as SEQ_TAIL
    """,
    high_first=True,
)

FLOAT = make_block(
    "float",
    500,
    """
    F_SEQ_HEAD       u16 - as SEQ_HEAD
    F_FLAGS          u16 bits as FLAGS
    F_[XYZABC]       f32 mm/° NaN when not VALID
    F_RADIUS         f32 mm NaN when not VALID
    F_DEPTH          f32 mm NaN when not VALID
    F_SIGMA_[XYZABC] f32 mm/° one sigma
    F_RESULT         u16 - as RESULT
    F_START_EPOCH    u32 - as START_EPOCH
    F_CRC16          u16 - CRC-16/MODBUS of the words before, each high byte first
    F_SEQ_TAIL       u16 - as SEQ_TAIL
    """,
)

BITS = make_block(
    "bits",
    535,
    f"""
    BITS             u16 bits {list_bits(CellBit)}; of the client that wrote CONTROL last
    BITS_REASON      u16 - as NACK_REASON, of the command of CONTROL
    """,
)

GRASP = make_block(
    "grasp",
    540,
    """
    G_SEQ_HEAD       u16 - as SEQ_HEAD
    G_FLAGS          u16 bits as FLAGS; VALID when the part that is shown has a grasp
    GRASP            u16 - number of the grasp in the job, from 1; 0: the job has none
    G_TURN           i32 0.001° by how much it is turned about the part's z against the taught one
    G_[XYZABC]       i32 µm/0.001° of the tool; INT32_MIN when not VALID
    G_APPROACH_[XYZ] i32 µm from where the tool comes, turned alike
    G_RETREAT        i32 µm how far it goes back along its z
    G_SIGMA_[XYZABC] u16 0.1_µm/0.001° one sigma, as SIGMA_X
    G_START_EPOCH    u32 - as START_EPOCH
    G_CRC16          u16 - CRC-16/MODBUS of the words before, each high byte first
    G_SEQ_TAIL       u16 - as SEQ_TAIL
    """,
)

REGISTRATION = make_block(
    "registration",
    576,
    f"""
    H_SEQ            u16 - CMD_SEQ of the command of a registration that this is the state after; 0: none
    H_METHOD         u16 - {list_codes(Method)}
    H_SAMPLES        u16 - poses or points that were taken
    H_USED           u16 - of them, those that REGISTER_SOLVE did not reject as outliers
    H_WORST          u16 - number of the one that agrees least, from 1; 0: none stands out
    H_RMS            i32 µm of all used, at the board or the points; INT32_MIN: not solved
    H_HELD_OUT       i32 µm the same, each seen by all the others; at most H_LIMIT is good
    H_LIMIT          i32 µm `registration.limit_mm`
    H_SIGMA_[XYZABC] u16 0.1_µm/0.001° of the robot's frame in the middle of the samples, A, B, C about
        X, Y, Z; 65535: not known
    H_START_EPOCH    u32 - as START_EPOCH
    H_CRC16          u16 - CRC-16/MODBUS of the words before, each high byte first
    """,
)


def _row(index: int) -> Block:
    t = f"T{index}_"
    return make_block(
        f"target {index}",
        600 + ROW_WORDS * index,
        f"""
        {t}SEQ      u16 - as SEQ_HEAD; 0: empty row
        {t}JOB      u16 - job
        {t}REJECT   u16 bits as REJECT
        {t}SCORE    u16 0.01_% as SCORE
        {t}[XYZABC] i32 µm/0.001° as in the result
        {t}RADIUS   i32 µm as RADIUS
        {t}FLAGS    u16 bits as FLAGS; not VALID when an earlier row than INDEX
        {t}CRC16    u16 - of the row's words before
        """,
    )


TABLE_END = make_block(
    "targets",
    600 + ROW_WORDS * TABLE_ROWS,
    """
    TABLE_SEQ_HEAD    u16 - as SEQ_HEAD
    TABLE_START_EPOCH u32 - as START_EPOCH
    TABLE_CRC16       u16 - CRC-16/MODBUS of all words before, from the first row of the table on
    TABLE_SEQ_TAIL    u16 - as SEQ_TAIL
    """,
)

COUNTERS = make_block(
    "counters",
    940,
    """
    N_CYCLES         u32 - cycles that measured, whoever asked, since START_EPOCH; as all of these
    N_NO_TARGET      u32 - of them: nothing found
    N_FAULTS         u32 - cycles without a pair of images
    N_PARTS          u32 - parts found, good and bad
    N_GOOD           u32 - good ones
    N_REJECTED       u32 - bad ones
    """
    + "\n    ".join(
        f"N_{bit.name} u32 - bad ones for {bit.name}; a part may be bad for several" for bit in Reject
    ),
)


def _job(index: int) -> Block:
    name = "u16 - two characters of its name, the first in the high byte; 0: its end"
    rows = [f"J{index}_NUMBER u16 - how COMMAND's JOB calls it; 0: empty row. The least numbers come first"]
    rows += [f"J{index}_NAME_{word} {name}" for word in range(1, NAME_WORDS + 1)]
    return make_block(f"job {index}", 1000 + (1 + NAME_WORDS) * index, "\n".join(rows))


OFFSET = make_block(
    "offset",
    1300,
    f"""
    O_SEQ_HEAD        u16 - as SEQ_HEAD
    O_FLAGS           u16 bits as FLAGS; VALID when the part that is shown has an offset
    O_STATE           u16 - {list_codes(GoldenState)}; HELD: the job has a golden part, as GOLDEN kept it
    O_GOLDEN          u32 s UTC of the golden part's exposure since 1970; 0: none is held
    O_[XYZABC]        i32 µm/0.0001° robot_now robot_golden^-1, to multiply a taught path by from the left; A,
        B, C as POSE_CONVENTION; INT32_MIN when not VALID
    O_SIGMA_[XYZABC]  u16 0.1_µm/0.001° one sigma of where that lays the part, and of A, B, C; 65535: unknown
    OP_[XYZABC]       i32 µm/0.0001° the same motion in the golden part's own frame, golden_from_now
    OP_SIGMA_[XYZABC] u16 0.1_µm/0.001° one sigma of it
    O_START_EPOCH     u32 - as START_EPOCH
    O_CRC16           u16 - CRC-16/MODBUS of the words of this block before, each high byte first
    O_SEQ_TAIL        u16 - as SEQ_TAIL
    """,
)

UR_OFFSET = make_block(
    "ur offset",
    1350,
    """
    UO_SEQ_HEAD       u16 - as SEQ_HEAD
    UO_FLAGS          u16 bits as O_FLAGS
    UO_STATE          u16 - as O_STATE
    UO_[XYZ]          i32 µm of O_X; 32768, 0 when not VALID
    UO_R[XYZ]         i32 µrad rotation vector; 32768, 0 when not VALID
    UO_START_EPOCH    u32 - as START_EPOCH
    UO_CRC16          u16 - CRC-16/MODBUS of the words of this block before, each high byte first
    UO_SEQ_TAIL       u16 - as SEQ_TAIL
    """,
    high_first=True,
)

REFERENCE_MARKS = make_block(
    "reference marks",
    1380,
    f"""
    M_STATE           u16 - {list_codes(MarksState)}
    M_VALID           u16 - 1: results may be given; 0: not, by what the marks say
    M_SEEN            u16 - marks that were used
    M_TAUGHT          u16 - marks that were taught
    M_EXCLUDED        u16 - marks that disagree with the others
    M_FIRST_EXCLUDED  u16 - code of the first of them; 65535: none
    M_FIT             u16 0.01 squared misfit over what is expected, about 1; 65535: nothing was compared
    M_LEFT            u16 0.1_µm from where it was taught to where the left camera is; 65535: not known
    M_RIGHT           u16 0.1_µm the right one
    """,
)

ACCEPTANCE = make_block(
    "acceptance",
    1390,
    f"""
    A_STATE           u16 - {list_codes(AcceptanceState)}
    A_DAYS            i32 - days until the test is due again, negative since; 32768, 0: none was made
    A_DUE             u32 s UTC since 1970, when it is due; 0: none was made
    """,
)

ROBOT_MAP = make_block(
    "robot map",
    1400,
    """
    E_DEGREE          u16 - of the map of the robot's error; 0: there is none
    E_POINTS          u16 - places that were touched for it
    E_ALONE           u16 0.1_µm rms of places that were left out, by the registration alone; 65535: more
    E_HELD_OUT        u16 0.1_µm with the map
    E_NOISE           u16 0.1_µm one sigma of what it does not tell
    """,
)

TRAY = make_block(
    "tray",
    1410,
    """
    P_SEQ_HEAD        u16 - as SEQ_HEAD
    P_POCKETS         u16 - pockets of the job's tray; 0: it has none, or the result is withdrawn
    POCKET            u16 - pocket of the part that is shown, from 1; 0 when not VALID
    P_TAKEN           u16 - pockets in which a part was found, good or bad
    P_FIRST_EMPTY     u16 - the first pocket in which none was found; 0: a part was found in each
    P_PARTS_1         u16 bits pockets 1 to 16, bit 0 the first: a part was found there
    P_PARTS_2         u16 bits pockets 17 to 32
    P_PARTS_3         u16 bits pockets 33 to 48
    P_PARTS_4         u16 bits pockets 49 to 64
    P_START_EPOCH     u32 - as START_EPOCH
    P_CRC16           u16 - CRC-16/MODBUS of the words of this block before, each high byte first
    P_SEQ_TAIL        u16 - as SEQ_TAIL
    """,
)

RESERVED = make_block(
    "reserved",
    1423,
    """
    RESERVED_1423     u64 - 0; so that tray, belt and place can be read in one request
    RESERVED_1427     u32 - 0
    RESERVED_1429     u16 - 0
    """,
)

BELT = make_block(
    "belt",
    1430,
    """
    B_SEQ_HEAD        u16 - as SEQ_HEAD
    B_FLAGS           u16 bits as FLAGS; VALID when the part that is shown is on a belt
    B_PART            u16 - number of the part, from 1; the same as often as it is seen
    B_COUNT           u32 - of the encoder in the middle of the exposure, rounded; the pose here is that at it
    B_SPEED           u32 µm/s of the belt
    B_[XYZABC]        i32 µm/0.001° in the belt's frame, x along its travel; INT32_MIN when not VALID
    B_SIGMA_[XYZABC]  u16 0.1_µm/0.001° one sigma; X has the speed times the jitter in it; 65535: not known
    B_START_EPOCH     u32 - as START_EPOCH
    B_CRC16           u16 - CRC-16/MODBUS of the words of this block before, each high byte first
    B_SEQ_TAIL        u16 - as SEQ_TAIL
    """,
)

PLACE = make_block(
    "place",
    1459,
    """
    L_SEQ_HEAD        u16 - as SEQ_HEAD
    L_FLAGS           u16 bits as FLAGS; VALID when the part that is shown has an offset, and FLANGE was given
    L_[XYZABC]        i32 µm/0.001° of a part that the gripper holds as FLANGE says, now and at GOLDEN:
        multiply a taught place by it from the right; INT32_MIN when not VALID
    L_START_EPOCH     u32 - as START_EPOCH
    L_CRC16           u16 - CRC-16/MODBUS of the words of this block before, each high byte first
    L_SEQ_TAIL        u16 - as SEQ_TAIL
    """,
)

JOBS = tuple(_job(index) for index in range(JOB_ROWS))
TABLE = tuple(_row(index) for index in range(TABLE_ROWS))

BLOCKS = (
    *(CONSTANTS, COMMAND, STATUS),
    *(RESULT, UR, UR_GRASP, FLOAT, BITS, GRASP, REGISTRATION),
    *(*TABLE, TABLE_END, COUNTERS, *JOBS, OFFSET, UR_OFFSET, REFERENCE_MARKS, ACCEPTANCE, ROBOT_MAP),
    *(TRAY, RESERVED, BELT, PLACE),
)
ROWS = (TABLE, JOBS)
"""Groups of blocks that repeat as rows of a table."""

ADDRESS = {
    register.name: register.address for block in (CONSTANTS, COMMAND, STATUS) for register in block.registers
}
"""Address of the first word by name, for the blocks in which the server itself looks something up."""
