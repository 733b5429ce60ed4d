"""The robot's side in URScript, for Universal Robots e-Series (PolyScope 5) and PolyScope X.

Three signals: the blocks ur and ur grasp, read in one request, so that its words always belong together, the
cell's convention, and the command block, written in one. What the controller's Modbus client does is in the
"Script Manual" of PolyScope 5: `modbus_add_signal` (names of at most 20 characters, `register_count` to 123,
type 16 writes by function 16), `modbus_set_signal_update_frequency`, `modbus_set_output_register`,
`modbus_set_signal_watchdog`; CB3 controllers know no `register_count`. It goes on writing the output for
ever, also when no program runs: the command block is one of those that the first CMD_SEQ of a connection is
for.

There is no exclusive or for integers in URScript, hence the table; and no division that is certainly one of
integers, hence `floor`.
"""

from __future__ import annotations

import math

from edged.domain.events import CommandKind
from edged.plc.answers import Reason
from edged.plc.registers import ADDRESS, COMMAND, MAP_VERSION, UR, UR_GRASP, Block, Flag, Option, StatusBit
from edged.robot.orientations import Convention
from edged.robots.units import filled
from edged.robots.walk import CODES, SETTLE_S, steps

REFRESH_HZ = 50
STALE_S = 1.0
CONTROL_WORDS = ADDRESS["TIMEOUT"] - COMMAND.address + 1
"""COMMAND to TIMEOUT, in one write."""
WATCHDOG_S = 10
"""Beyond STALE_S: a lost link is an edged_error first, and only later stops the program (default: 2 s)."""
AXES = ("X", "Y", "Z", "RX", "RY", "RZ")

SCRIPT = """\
# edged, map version @VERSION@: written by `edged registers --format urscript`.
# For PolyScope 5.x and later. Put this into the program's "Before Start"; then:
#     edged_setup("192.168.10.20")
#     target = edged_locate(0, 5.0)       # job 0: the active one; seconds
#     if edged_ok:
#         movel(pose_trans(target, p[0, 0, -0.1, 0, 0, 0]))
#     end
#     edged_acknowledge()
#     while edged_remaining > 0:
#         target = edged_next(5.0)        # the next part of the same picture, in the order of the job
#         ...
#     end
# edged_locate_all_jobs(5.0) tries every job; edged_job is then the one whose part agrees best.
# Where the job has grasps, edged_grasp() after edged_locate or edged_next is where the tool takes the part,
# and edged_approach from where it comes.
# The cell listens on port 502 (a robot's Modbus client knows no other). Positions are in m and rad in the
# robot's base. edged_error: 0 none, a NACK_REASON (@REASONS@),
# 100 not in time, 101 nothing usable found, 102 the rig is not registered to the robot, 103 a virtual cell
# (set edged_allow_simulated to True to move by what it says), 104 the cell's heartbeat stands still,
# 105 the cell was started anew, or another client's command took the place of this one, 106 the CRC is
# wrong, 107 another job was measured, 108 the part has no grasp, 109 a pose of the flange cannot be said:
# the cell's convention is not "ur_rotation_vector". Parts are given in rotation vectors all the same.

global edged_ok = False
global edged_error = 0
global edged_remaining = 0
global edged_job = 0
global edged_approach = p[0, 0, 0, 0, 0, 0]
global edged_sequence = 0
global edged_allow_simulated = False
global edged_in = [@ZEROS_IN@]
global edged_out = [@ZEROS_OUT@]
global edged_angles = [0, 0]
# a exclusive or b of two numbers below 16 stands at 16 * a + b
global edged_xor16 = [@XOR@]
# CRC-16/MODBUS of the numbers below 16
global edged_crc16 = [@CRC_TABLE@]

def edged_setup(ip):
    modbus_add_signal(ip, 1, @UR@, 2, "edged_in", False, @UR_WORDS@)
    modbus_set_signal_update_frequency("edged_in", @HZ@)
    modbus_set_signal_watchdog("edged_in", @WATCHDOG@)
    # what A, B, C mean; the word beside it makes it a list
    modbus_add_signal(ip, 1, @CONVENTION@, 2, "edged_angles", False, 2)
    modbus_set_signal_update_frequency("edged_angles", @HZ@)
    modbus_set_signal_watchdog("edged_angles", @WATCHDOG@)
    modbus_add_signal(ip, 1, @COMMAND@, 16, "edged_out", False, @CONTROL_WORDS@)
    modbus_set_signal_update_frequency("edged_out", @HZ@)
    modbus_set_signal_watchdog("edged_out", @WATCHDOG@)
    sleep(@SETTLE@)
    edged_in = modbus_get_signal_status("edged_in", False)
    # after a restart of the program no sequence is used again
    edged_sequence = edged_in[@LAST@]
    edged_out[@O_CMD_SEQ@] = 0
    edged_send()
end

def edged_send():
    modbus_set_output_register("edged_out", edged_out, False)
end

def edged_mod(number, base):
    return number - floor(number / base) * base
end

def edged_bit(word, weight):
    return edged_mod(floor(word / weight), 2) == 1
end

# Two words as a signed number.
def edged_signed(high, low):
    if high >= 32768:
        return (high - 65536) * 65536 + low
    end
    return high * 65536 + low
end

def edged_xor(one, other):
    local a = one
    local b = other
    local weight = 1
    local sum = 0
    while weight < 65536:
        sum = sum + weight * edged_xor16[16 * edged_mod(a, 16) + edged_mod(b, 16)]
        a = floor(a / 16)
        b = floor(b / 16)
        weight = weight * 16
    end
    return sum
end

def edged_crc_step(crc, four):
    return edged_xor(floor(crc / 16), edged_crc16[edged_xor16[16 * edged_mod(crc, 16) + four]])
end

# CRC-16/MODBUS of the words before the CRC, each high byte first, each byte low half first.
def edged_crc(words):
    return edged_crc_of(words, 0, @CRC@)
end

def edged_crc_of(words, first, end_of_words):
    local crc = 65535
    local i = first
    while i < end_of_words:
        crc = edged_crc_step(crc, edged_mod(floor(words[i] / 256), 16))
        crc = edged_crc_step(crc, floor(words[i] / 4096))
        crc = edged_crc_step(crc, edged_mod(words[i], 16))
        crc = edged_crc_step(crc, edged_mod(floor(words[i] / 16), 16))
        i = i + 1
        # computation without a pause is stopped by the controller ("Thread scheduling")
        sync()
    end
    return crc
end

# Once begun, call it more often than the cell's heartbeat_s: when it stops, coordinates are withdrawn.
def edged_alive():
    edged_out[@O_BEAT@] = edged_mod(edged_out[@O_BEAT@], 65535) + 1
    edged_send()
end

def edged_acknowledge():
    edged_out[@O_ACK_SEQ@] = edged_sequence
    edged_send()
    edged_ok = False
end

# Taken back: it must not run when the link returns.
def edged_fail(reason):
    edged_error = reason
    edged_out[@O_CMD_SEQ@] = 0
    edged_send()
    return False
end

# Run a command and wait for its end. Returns True for ACK; edged_in is then the picture that says so.
def edged_run(command, job, options, timeout):
    local waited = 0.0
    local stale = 0.0
    local beat = -1
    local is_sent = False
    local is_taken = False
    local is_damaged = False
    local first = 0
    local second = 0
    local before = 0
    edged_ok = False
    edged_error = 0
    edged_remaining = 0
    edged_job = 0
    while waited < timeout:
        edged_in = modbus_get_signal_status("edged_in", False)
        if edged_in[@HEARTBEAT@] != beat:
            beat = edged_in[@HEARTBEAT@]
            stale = 0.0
        end
        if stale > @STALE@:
            return edged_fail(104)
        end
        if not is_sent:
            # after a start or a new connection the first CMD_SEQ runs nothing: that must be the one before
            if edged_in[@ECHO@] == edged_out[@O_CMD_SEQ@]:
                before = edged_in[@ECHO@]
                first = edged_in[@EPOCH@]
                second = edged_in[@EPOCH_LOW@]
                edged_sequence = edged_mod(edged_sequence, 65535) + 1
                edged_out[@O_COMMAND@] = command
                edged_out[@O_JOB@] = job
                edged_out[@O_ACK_SEQ@] = 0
                edged_out[@O_OPTIONS@] = options
                edged_out[@O_TIMEOUT@] = floor(timeout * 1000)
                if timeout > 60:
                    edged_out[@O_TIMEOUT@] = 60000
                end
                edged_out[@O_CMD_SEQ@] = edged_sequence
                edged_send()
                is_sent = True
                is_taken = False
            end
        elif edged_in[@EPOCH@] != first or edged_in[@EPOCH_LOW@] != second:
            return edged_fail(105)
        elif edged_in[@ECHO@] != edged_sequence:
            if is_taken or edged_in[@ECHO@] != before:
                return edged_fail(105)
            end
        else:
            is_taken = True
            if edged_in[@DONE@] == edged_sequence:
                if edged_in[@CRC@] != edged_crc(edged_in):
                    is_damaged = True
                elif edged_bit(edged_in[@BITS@], @ACK@):
                    return True
                elif edged_bit(edged_in[@BITS@], @NACK@):
                    if edged_in[@REASON@] == @BASELINE@:
                        # the connection is a new one: nothing ran, and now the cell knows our CMD_SEQ
                        is_sent = False
                    else:
                        edged_error = edged_in[@REASON@]
                        return False
                    end
                end
            end
        end
        sleep(@STEP@)
        waited = waited + @STEP@
        stale = stale + @STEP@
    end
    if is_damaged:
        return edged_fail(106)
    end
    return edged_fail(100)
end

# LOCATE, with where the flange is: cameras on it see from there. True: there is a result.
def edged_measured(job, options, timeout):
    local is_done = False
    if edged_knows_flanges():
        edged_flange(get_actual_tool_flange_pose())
    end
    is_done = edged_run(@LOCATE@, job, options, timeout)
    # a pose serves one command: it must not go with the next one
    edged_flange(p[0, 0, 0, 0, 0, 0])
    edged_send()
    return is_done
end

# Measure. Returns the pose; it may be used only if edged_ok is True.
def edged_locate(job, timeout):
    if edged_measured(job, 0, timeout):
        return edged_pose(edged_in, job)
    end
    return p[0, 0, 0, 0, 0, 0]
end

# The same with every job on one picture: the part that agrees best, edged_job is the number of its job.
def edged_locate_all_jobs(timeout):
    if edged_measured(0, @ALL_JOBS@, timeout):
        return edged_pose(edged_in, 0)
    end
    return p[0, 0, 0, 0, 0, 0]
end

# The next part of the picture that edged_locate took. Without one edged_error is @NO_LIST@.
def edged_next(timeout):
    if edged_run(@NEXT_PART@, 0, 0, timeout):
        return edged_pose(edged_in, 0)
    end
    return p[0, 0, 0, 0, 0, 0]
end

# Register the rig: at ten poses about the one where the robot stands, turned about its tool centre point,
# which is in the middle of the board (a rig on the flange: where the cameras look). True: it is registered.
def edged_hand_eye(timeout):
    local centre = get_actual_tcp_pose()
    if not edged_knows_flanges():
        edged_error = 109
        return False
    end
    if not edged_run(@HAND_EYE_START@, 0, 0, timeout):
        return False
    end
@WALK@
    movel(centre, 0.3, 0.1)
    return edged_run(@REGISTER_SOLVE@, 0, 0, timeout)
end

# One pose; where the board is not seen it is left out. False: something else is wrong.
def edged_step(place, timeout):
    local is_taken = False
    movel(place, 0.3, 0.1)
    sleep(@SETTLE_S@)
    edged_flange(get_actual_tool_flange_pose())
    is_taken = edged_run(@REGISTER_ADD@, 0, 0, timeout)
    # a pose serves one command: it must not go with the next one
    edged_flange(p[0, 0, 0, 0, 0, 0])
    edged_send()
    return is_taken or edged_error == @NOT_SEEN@ or edged_error == @SAME_PLACE@
end

# Whether the cell reads A, B, C of FLANGE as the rotation vector that they are.
def edged_knows_flanges():
    edged_angles = modbus_get_signal_status("edged_angles", False)
    return edged_angles[0] == @UR_ROTATION_VECTOR@
end

def edged_flange(place):
    edged_words(@FLANGE@, place[0] * 1000000.0)
    edged_words(@FLANGE@ + 2, place[1] * 1000000.0)
    edged_words(@FLANGE@ + 4, place[2] * 1000000.0)
    # rad to 0.001 degrees
    edged_words(@FLANGE@ + 6, place[3] * 57295.779513)
    edged_words(@FLANGE@ + 8, place[4] * 57295.779513)
    edged_words(@FLANGE@ + 10, place[5] * 57295.779513)
end

# A number as two words of edged_out, the high one first.
def edged_words(at, number):
    local whole = floor(number + 0.5)
    local high = floor(whole / 65536)
    local second = at + 1
    edged_out[at] = edged_mod(high, 65536)
    edged_out[second] = whole - high * 65536
end

# Where the tool takes the part that was found; sets edged_approach. Without a grasp edged_ok becomes False.
def edged_grasp():
    if not edged_ok:
        return p[0, 0, 0, 0, 0, 0]
    end
    edged_ok = False
    if edged_in[@G_HEAD@] != edged_sequence:
        edged_error = 105
    elif not edged_bit(edged_in[@G_FLAGS@], @VALID@):
        edged_error = 108
    elif edged_in[@G_TAIL@] != edged_sequence:
        edged_error = 105
    elif edged_in[@G_CRC@] != edged_crc_of(edged_in, @G_HEAD@, @G_CRC@):
        edged_error = 106
    else:
        edged_ok = True
        edged_approach = p[@APPROACH@]
        return p[@TOOL@]
    end
    return p[0, 0, 0, 0, 0, 0]
end

# The pose in a block of words; sets edged_ok, edged_remaining and edged_job.
def edged_pose(words, job):
    if words[@HEAD@] != edged_sequence:
        edged_error = 105
    elif job != 0 and words[@JOB@] != job:
        edged_error = 107
    elif not edged_bit(words[@FLAGS@], @VALID@):
        edged_error = 101
    elif words[@TAIL@] != edged_sequence:
        edged_error = 105
    elif not edged_bit(words[@FLAGS@], @ROBOT_FRAME@):
        edged_error = 102
    elif edged_bit(words[@FLAGS@], @SIMULATED@) and not edged_allow_simulated:
        edged_error = 103
    else:
        edged_ok = True
        edged_remaining = words[@REMAINING@]
        edged_job = words[@JOB@]
        return p[@POSE@]
    end
    return p[0, 0, 0, 0, 0, 0]
end
"""


def urscript_source() -> str:
    """Functions for the robot's program, as text."""
    return filled(SCRIPT, _values())


def _values() -> dict[str, str]:
    numbers = {
        "VERSION": MAP_VERSION,
        "UR": UR.address,
        "UR_WORDS": UR.words + UR_GRASP.words,
        "G_HEAD": _at("SEQ_HEAD", UR_GRASP),
        "G_TAIL": _at("SEQ_TAIL", UR_GRASP),
        "G_FLAGS": _at("FLAGS", UR_GRASP),
        "G_CRC": _at("CRC16", UR_GRASP),
        "COMMAND": COMMAND.address,
        "CONVENTION": ADDRESS["POSE_CONVENTION"],
        "UR_ROTATION_VECTOR": Convention.UR_ROTATION_VECTOR.value,
        "CONTROL_WORDS": CONTROL_WORDS,
        "HZ": REFRESH_HZ,
        "WATCHDOG": WATCHDOG_S,
        "HEAD": _at("SEQ_HEAD"),
        "TAIL": _at("SEQ_TAIL"),
        "FLAGS": _at("FLAGS"),
        "JOB": _at("JOB"),
        "BITS": _at("STATUS_BITS"),
        "DONE": _at("DONE_SEQ"),
        "HEARTBEAT": _at("HEARTBEAT"),
        "ECHO": _at("CMD_SEQ_ECHO"),
        "REASON": _at("NACK_REASON"),
        "LAST": _at("LAST_SEQ"),
        "EPOCH": _at("START_EPOCH"),
        "EPOCH_LOW": _at("START_EPOCH") + 1,
        "CRC": _at("CRC16"),
        "REMAINING": _at("REMAINING"),
        "LOCATE": CommandKind.LOCATE.value,
        "NEXT_PART": CommandKind.NEXT_PART.value,
        "NO_LIST": Reason.NO_LIST.value,
        "BASELINE": Reason.BASELINE.value,
        "VALID": Flag.VALID.value,
        "ROBOT_FRAME": Flag.ROBOT_FRAME.value,
        "SIMULATED": Flag.SIMULATED.value,
        "ALL_JOBS": Option.ALL_JOBS.value,
        "ACK": StatusBit.ACK.value,
        "NACK": StatusBit.NACK.value,
        **{f"O_{name}": ADDRESS[name] - COMMAND.address for name in ("COMMAND", "JOB", "CMD_SEQ", "ACK_SEQ")},
        "O_BEAT": ADDRESS["CLIENT_HEARTBEAT"] - COMMAND.address,
        "O_OPTIONS": ADDRESS["OPTIONS"] - COMMAND.address,
        "O_TIMEOUT": ADDRESS["TIMEOUT"] - COMMAND.address,
        "FLANGE": ADDRESS["FLANGE_X"] - COMMAND.address,
        **CODES,
        "SETTLE_S": SETTLE_S,
    }
    return {name: str(value) for name, value in numbers.items()} | {
        "REASONS": ", ".join(f"{reason.value} {reason.name.lower()}" for reason in Reason if reason),
        "SETTLE": f"{5 / REFRESH_HZ:g}",
        "WALK": steps(_step),
        "STEP": f"{1 / REFRESH_HZ:g}",
        "STALE": f"{STALE_S:g}",
        "ZEROS_IN": ", ".join(["0"] * (UR.words + UR_GRASP.words)),
        "ZEROS_OUT": ", ".join(["0"] * CONTROL_WORDS),
        "XOR": ", ".join(str(one ^ other) for one in range(16) for other in range(16)),
        "CRC_TABLE": ", ".join(str(_crc_of_four(four)) for four in range(16)),
        "POSE": ", ".join(_pose_term("words", axis, UR) for axis in AXES),
        "TOOL": ", ".join(_pose_term("edged_in", axis, UR_GRASP) for axis in AXES),
        "APPROACH": ", ".join(
            _pose_term("edged_in", axis if axis.startswith("R") else f"APPROACH_{axis}", UR_GRASP)
            for axis in AXES
        ),
    }


def _step(x: int, y: int, z: int, *turns_deg: int) -> str:
    """One pose; the turns as a rotation vector, which they are up to the order of small ones."""
    offset = ", ".join(
        [*(f"{mm / 1000:g}" for mm in (x, y, z)), *(f"{math.radians(turn):.4f}" for turn in turns_deg)]
    )
    return f"    if not edged_step(pose_trans(centre, p[{offset}]), timeout):\n        return False\n    end"


def _at(name: str, block: Block = UR) -> int:
    """Place in what is read, which begins with the block ur."""
    prefix = block.registers[0].name.partition("_")[0]
    return next(one.address for one in block.registers if one.name == f"{prefix}_{name}") - UR.address


def _crc_of_four(bits: int) -> int:
    """Four steps of the reflected polynomial 0x8005 ("MODBUS over serial line", section 6.2.2)."""
    for _ in range(4):
        bits = (bits >> 1) ^ (0xA001 if bits & 1 else 0)
    return bits


def _pose_term(words: str, axis: str, block: Block) -> str:
    high = _at(axis, block)
    return f"edged_signed({words}[{high}], {words}[{high + 1}]) / 1000000.0"  # µm to m, µrad to rad
