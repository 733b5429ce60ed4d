"""The robot's side in URScript, for Universal Robots: Modbus signals are single unsigned 16-bit words.

A robot reads each of its signals in a request of its own, so words of two results could meet. They do
not: a command empties the block before its result fills it, head and tail must both carry the command's
sequence, and everything is read twice, a refresh apart, until it agrees.
"""

from __future__ import annotations

from edged.domain import CommandKind
from edged.plc.handshake import Reason
from edged.plc.registers import ADDRESS, MAP_VERSION, UR, Flag, Kind, StatusBit

REFRESH_HZ = 50
OUTPUTS = ("COMMAND", "JOB", "CMD_SEQ", "ACK_SEQ", "CLIENT_HEARTBEAT")
AXES = ("X", "Y", "Z", "RX", "RY", "RZ")

SCRIPT = """\
# edged, map version @VERSION@: written by `edged registers --format urscript`.
# Put this into the program's "Before Start"; then:
#     edged_setup("192.168.10.20")
#     target = edged_locate(0, 5.0)       # job 0: the active one; seconds
#     if edged_ok:
#         movel(pose_trans(target, p[0, 0, -0.1, 0, 0, 0]))
#     end
#     edged_acknowledge()
# The cell listens on port 502 (a robot's Modbus client knows no other). Positions are in m and rad in the
# robot's base. edged_error: 0 none, a NACK_REASON (@REASONS@),
# 100 not in time, 101 nothing usable found, 102 the rig is not registered to the robot, 103 a virtual cell
# (set edged_allow_simulated to True to move by what it says).

global edged_ok = False
global edged_error = 0
global edged_sequence = 0
global edged_beat = 0
global edged_allow_simulated = False

def edged_setup(ip):
@SIGNALS@
    sleep(@SETTLE@)
    # one more than the cell has seen: after a restart no sequence is used again
    edged_sequence = modbus_get_signal_status("edged_echo", False)
end

def edged_bit(word, weight):
    return floor(word / weight) % 2 == 1
end

# Two words as a signed number.
def edged_signed(high, low):
    if high >= 32768:
        return (high - 65536) * 65536 + low
    end
    return high * 65536 + low
end

# Once begun, call it more often than the cell's heartbeat_s: when it stops, coordinates are withdrawn.
def edged_alive():
    edged_beat = edged_beat % 65535 + 1
    modbus_set_output_register("edged_out_CLIENT_HEARTBEAT", edged_beat, False)
end

def edged_words():
    return [@WORDS@]
end

def edged_same(one, other):
    local i = 0
    while i < @COUNT@:
        if one[i] != other[i]:
            return False
        end
        i = i + 1
    end
    return True
end

def edged_acknowledge():
    modbus_set_output_register("edged_out_ACK_SEQ", edged_sequence, False)
    edged_ok = False
end

# Run a command and wait for its end. Returns True for ACK.
def edged_run(command, job, timeout):
    local waited = 0.0
    local bits = 0
    edged_ok = False
    edged_error = 0
    edged_sequence = edged_sequence % 65535 + 1
    # after a restart or a new connection the first CMD_SEQ runs nothing: 0 never does
    modbus_set_output_register("edged_out_CMD_SEQ", 0, False)
    modbus_set_output_register("edged_out_ACK_SEQ", 0, False)
    modbus_set_output_register("edged_out_COMMAND", command, False)
    modbus_set_output_register("edged_out_JOB", job, False)
    # each output is written in a request of its own: the one that starts the command goes last
    sleep(@SETTLE@)
    modbus_set_output_register("edged_out_CMD_SEQ", edged_sequence, False)
    while waited < timeout:
        sleep(@STEP@)
        waited = waited + @STEP@
        if modbus_get_signal_status("edged_echo", False) == edged_sequence:
            if modbus_get_signal_status("edged_UR_DONE_SEQ", False) == edged_sequence:
                # the bits may be one refresh older than the number
                sleep(@SETTLE@)
                bits = modbus_get_signal_status("edged_UR_STATUS_BITS", False)
                if edged_bit(bits, @ACK@):
                    return True
                end
                if edged_bit(bits, @NACK@):
                    edged_error = modbus_get_signal_status("edged_reason", False)
                    return False
                end
            end
        end
    end
    # taken back: it must not run when the link returns
    modbus_set_output_register("edged_out_CMD_SEQ", 0, False)
    edged_error = 100
    return False
end

# Measure. Returns the pose; it may be used only if edged_ok is True.
def edged_locate(job, timeout):
    local tries = 0
    local first = edged_words()
    local second = edged_words()
    if edged_run(@LOCATE@, job, timeout):
        while tries < 50:
            sleep(@SETTLE@)
            first = edged_words()
            sleep(@SETTLE@)
            second = edged_words()
            if edged_same(first, second):
                if first[@HEAD@] == edged_sequence and first[@TAIL@] == edged_sequence:
                    return edged_pose(first)
                end
            end
            tries = tries + 1
        end
        edged_error = 100
    end
    return p[0, 0, 0, 0, 0, 0]
end

# The pose in a block of words that belong together; sets edged_ok.
def edged_pose(words):
    if not edged_bit(words[@FLAGS@], @VALID@):
        edged_error = 101
        return p[0, 0, 0, 0, 0, 0]
    end
    if not edged_bit(words[@FLAGS@], @ROBOT_FRAME@):
        edged_error = 102
        return p[0, 0, 0, 0, 0, 0]
    end
    if edged_bit(words[@FLAGS@], @SIMULATED@):
        if not edged_allow_simulated:
            edged_error = 103
            return p[0, 0, 0, 0, 0, 0]
        end
    end
    edged_ok = True
    return p[@POSE@]
end
"""


def urscript_source() -> str:
    """Functions for the robot's program, as text."""
    text = SCRIPT
    for name, value in _values().items():
        text = text.replace(f"@{name}@", value)
    return text


def _values() -> dict[str, str]:
    names = [name for name, _ in _words()]
    settle_s = 3 / REFRESH_HZ  # every signal has been read at least once in between
    return {
        "VERSION": str(MAP_VERSION),
        "REASONS": ", ".join(f"{reason.value} {reason.name.lower()}" for reason in Reason if reason),
        "SIGNALS": "\n".join(f"    {line}" for line in _signals()),
        "SETTLE": f"{settle_s:g}",
        "STEP": f"{1 / REFRESH_HZ:g}",
        "WORDS": ", ".join(f'modbus_get_signal_status("edged_{name}", False)' for name in names),
        "COUNT": str(len(names)),
        "HEAD": str(names.index("UR_SEQ_HEAD")),
        "TAIL": str(names.index("UR_SEQ_TAIL")),
        "FLAGS": str(names.index("UR_FLAGS")),
        "POSE": ", ".join(_pose_term(names, axis) for axis in AXES),
        "LOCATE": str(CommandKind.LOCATE.value),
        "VALID": str(Flag.VALID.value),
        "ROBOT_FRAME": str(Flag.ROBOT_FRAME.value),
        "SIMULATED": str(Flag.SIMULATED.value),
        "ACK": str(StatusBit.ACK.value),
        "NACK": str(StatusBit.NACK.value),
    }


def _words() -> list[tuple[str, int]]:
    """Name and address of each word of the block that a pose needs."""
    skipped = ("UR_STATUS_BITS", "UR_DONE_SEQ", "UR_HEARTBEAT")  # they change while a result stands
    words: list[tuple[str, int]] = []
    for register in UR.registers:
        if register.kind is Kind.I32:
            words += [(f"{register.name}_H", register.address), (f"{register.name}_L", register.address + 1)]
        elif register.name not in skipped:
            words.append((register.name, register.address))
    return words


def _signals() -> list[str]:
    address = {register.name: register.address for register in UR.registers}
    inputs = [
        *_words(),
        *((name, address[name]) for name in ("UR_STATUS_BITS", "UR_DONE_SEQ")),
        ("echo", ADDRESS["CMD_SEQ_ECHO"]),
        ("reason", ADDRESS["NACK_REASON"]),
    ]
    lines = []
    for name, place in inputs:
        lines.append(f'modbus_add_signal(ip, 1, {place}, 2, "edged_{name}")')
        lines.append(f'modbus_set_signal_update_frequency("edged_{name}", {REFRESH_HZ})')
    outputs = (f'modbus_add_signal(ip, 1, {ADDRESS[name]}, 3, "edged_out_{name}")' for name in OUTPUTS)
    return [*lines, *outputs]


def _pose_term(names: list[str], axis: str) -> str:
    high = names.index(f"UR_{axis}_H")
    scale = "1000000.0" if axis in "XYZ" else "10000.0"  # um to m, 0.1 mrad to rad
    return f"edged_signed(words[{high}], words[{high + 1}]) / {scale}"
