"""The PLC's side in IEC 61131-3 structured text: result type, conversions, function block with the handshake.

No global variables, no vendor library: the PLC's own Modbus client copies registers to `awStatus` and
`awResult` and writes `awCommand`; every maker configures that in another way, and all of them can.
"""

from __future__ import annotations

from edged.domain.events import CommandKind
from edged.plc.answers import Reason
from edged.plc.registers import (
    ADDRESS,
    COMMAND,
    GRASP,
    MAP_VERSION,
    RESULT,
    STATUS,
    Block,
    Flag,
    Kind,
    Option,
    Register,
    StatusBit,
)
from edged.robot.orientations import Convention
from edged.robots.units import filled

TYPES = {Kind.U16: ("ui", "UINT"), Kind.I32: ("di", "DINT"), Kind.U32: ("ud", "UDINT")}
ARRAYS = {RESULT: "awResult", GRASP: "awGrasp"}
CONTROL_WORDS = ADDRESS["TIMEOUT"] - COMMAND.address + 1
"""COMMAND to TIMEOUT, in one write."""


def structured_text_source() -> str:
    """Types, functions and the function block `FB_EDGED`, as text."""
    types = (_type("ST_EDGED_RESULT", RESULT), _type("ST_EDGED_GRASP", GRASP))
    text = "\n".join((_header(), *types, FUNCTIONS, _block()))
    return text.replace("µ", "u").replace("°", " degrees")  # compilers differ in what a source is encoded in


def _header() -> str:
    return f"""(* edged, map version {MAP_VERSION}: written by `edged registers --format st`.

Configure the Modbus client of the PLC (addresses are 0-based PDU addresses; add base_address of the cell):
    read  {STATUS.words:3} words from {STATUS.address} into awStatus,  cyclically, 20 to 50 ms
    read  {RESULT.words:3} words from {RESULT.address} into awResult,  cyclically, 20 to 50 ms, in ONE request
    read  {GRASP.words:3} words from {GRASP.address} into awGrasp,   the same, where jobs have grasps
    write {CONTROL_WORDS:3} words to   {COMMAND.address} from awCommand, cyclically, in ONE request (FC 16)
and xLinkOk: TRUE while all succeed. Call FB_EDGED in every scan. *)
"""


def _fields(block: Block, register: Register) -> list[tuple[str, str, str]]:
    """Name, type and conversion of a register in the type of its block; 64 bits become two UDINT."""
    offset = register.address - block.address
    array = ARRAYS[block]
    if register.kind is Kind.U64:
        halves = ("HIGH", "LOW")
        first, second = (
            f"F_EDGED_UDINT_OF_64(awWords := {array}, iAt := {offset}, iHalf := {i}, "
            "xLowWordFirst := xLowWordFirst)"
            for i in (0, 1)
        )
        names = [f"ud{register.name}_{half}" for half in halves]
        return [(names[0], "UDINT", first), (names[1], "UDINT", second)]
    prefix, kind = TYPES[register.kind]
    name = prefix + register.name.removeprefix("G_")
    if register.kind is Kind.U16:
        return [(name, kind, f"WORD_TO_UINT({array}[{offset}])")]
    words = f"wFirst := {array}[{offset}], wSecond := {array}[{offset + 1}]"
    joined = f"F_EDGED_DWORD({words}, xLowWordFirst := xLowWordFirst)"
    return [(name, kind, f"DWORD_TO_{kind}({joined})")]


def _used(block: Block) -> list[Register]:
    return [one for one in block.registers if "RESERVED" not in one.name and not one.name.endswith("CRC16")]


def _type(title: str, block: Block) -> str:
    lines = [f"TYPE {title} :", "STRUCT", "    xValid : BOOL; (* a robot may use the coordinates *)"]
    for register in _used(block):
        for name, kind, _ in _fields(block, register):
            unit = f"{register.unit}: " if register.unit else ""
            lines.append(f"    {name} : {kind}; (* {unit}{register.help} *)")
    return "\n".join([*lines, "END_STRUCT;", "END_TYPE", ""])


FUNCTIONS = """\
(* Two words as 32 bits. *)
FUNCTION F_EDGED_DWORD : DWORD
VAR_INPUT
    wFirst : WORD;
    wSecond : WORD;
    xLowWordFirst : BOOL;
END_VAR
IF xLowWordFirst THEN
    F_EDGED_DWORD := SHL(WORD_TO_DWORD(wSecond), 16) OR WORD_TO_DWORD(wFirst);
ELSE
    F_EDGED_DWORD := SHL(WORD_TO_DWORD(wFirst), 16) OR WORD_TO_DWORD(wSecond);
END_IF;
END_FUNCTION

(* The sequence after this one: 1 to 65535, never 0. *)
FUNCTION F_EDGED_NEXT : UINT
VAR_INPUT
    uiSequence : UINT;
END_VAR
IF uiSequence = 65535 THEN
    F_EDGED_NEXT := 1;
ELSE
    F_EDGED_NEXT := uiSequence + 1;
END_IF;
END_FUNCTION

(* Half of a 64-bit value at iAt: iHalf 0 is the upper, 1 the lower one. *)
FUNCTION F_EDGED_UDINT_OF_64 : UDINT
VAR_INPUT
    awWords : ARRAY[0..47] OF WORD;
    iAt : INT;
    iHalf : INT;
    xLowWordFirst : BOOL;
END_VAR
VAR
    iFirst : INT;
END_VAR
IF xLowWordFirst THEN
    iFirst := iAt + 2 - 2 * iHalf;
ELSE
    iFirst := iAt + 2 * iHalf;
END_IF;
F_EDGED_UDINT_OF_64 := DWORD_TO_UDINT(F_EDGED_DWORD(wFirst := awWords[iFirst],
    wSecond := awWords[iFirst + 1], xLowWordFirst := xLowWordFirst));
END_FUNCTION
"""

BLOCK = """\
(* The handshake. A rising edge of xExecute runs uiCommand for uiJob; keep xExecute TRUE while the result is
used. Its falling edge acknowledges the result, which is then withdrawn.
    xDone          the command was carried out; read stResult. Use coordinates only while stResult.xValid.
    xExposureDone  the picture is taken: the robot may move although the result is still to come.
    xError         it was not, or its result is lost; uiError: a NACK_REASON (@REASONS@),
                   100 not within tTimeout, 101 link down, 102 the cell's heartbeat stands still,
                   103 the cell was started anew, what it measures by was exchanged (a reload), or another
                   client's command took the place of this one,
                   104 A, B, C of the cell are not what uiConvention says: nothing was commanded.
After 100 to 103 the command is taken back (CMD_SEQ 0): it does not run when the link returns.
While stResult.uiREMAINING > 0, uiCommand @NEXT_PART@ gives the next part of the same picture. *)
FUNCTION_BLOCK FB_EDGED
VAR_INPUT
    xLinkOk : BOOL;
    xExecute : BOOL;
    uiCommand : UINT := @LOCATE@; (* @COMMANDS@ *)
    uiJob : UINT; (* 0: the active one *)
    xAllJobs : BOOL; (* TRUE: every job is tried, the part that agrees best counts *)
    uiConvention : UINT := @FIXED_XYZ@; (* what the robot takes A, B, C for: @CONVENTIONS@ *)
    tTimeout : TIME := T#5S;
    xLowWordFirst : BOOL; (* word_order = "low" in the cell *)
    xAllowRigFrame : BOOL; (* TRUE: xValid also in the rig's frame, which no robot knows *)
    xAllowSimulated : BOOL; (* TRUE: xValid also from a virtual cell, where no part is *)
    adiFlange : ARRAY[0..5] OF DINT; (* pose of the flange, um and 0.001 degrees; optional *)
    awStatus : ARRAY[0..@STATUS_LAST@] OF WORD;
    awResult : ARRAY[0..@RESULT_LAST@] OF WORD;
    awGrasp : ARRAY[0..@GRASP_LAST@] OF WORD; (* optional *)
END_VAR
VAR_OUTPUT
    xReady : BOOL;
    xBusy : BOOL;
    xExposureDone : BOOL;
    xDone : BOOL;
    xError : BOOL;
    uiError : UINT;
    stResult : ST_EDGED_RESULT;
    stGrasp : ST_EDGED_GRASP; (* of the same part; xValid a cycle later, perhaps *)
    awCommand : ARRAY[0..@CONTROL_LAST@] OF WORD;
END_VAR
VAR
    iState : INT; (* 0 idle; waits: 5 to be known, 10 for an answer, 20 for a result; 30 in use, 40 failed *)
    uiRunning : UINT;
    uiSequence : UINT;
    wBefore : WORD;
    wEpochFirst : WORD;
    wEpochSecond : WORD;
    wBits : WORD;
    wAlive : WORD;
    wHeartbeat : WORD;
    xAlive : BOOL;
    xKnown : BOOL;
    xSame : BOOL;
    xMine : BOOL;
    xFits : BOOL;
    xTaken : BOOL;
    xWasExecute : BOOL;
    xRigFrame : BOOL;
    xSimulated : BOOL;
    tLimit : TIME;
    tonAnswer : TON;
    tonAlive : TON;
    tonBeat : TON;
    i : INT;
    dwFlange : DWORD;
END_VAR

(* Does the cell live? Its heartbeat counts at 10 Hz. *)
tonAlive(IN := awStatus[@HEARTBEAT@] = wAlive, PT := T#1S);
wAlive := awStatus[@HEARTBEAT@];
xAlive := xLinkOk AND NOT tonAlive.Q;

(* Our heartbeat: when it stops, the cell withdraws the result. 0 would end the supervision. *)
tonBeat(IN := NOT tonBeat.Q, PT := T#200MS);
IF tonBeat.Q THEN
    IF wHeartbeat = 16#FFFF THEN
        wHeartbeat := 16#1;
    ELSE
        wHeartbeat := UINT_TO_WORD(WORD_TO_UINT(wHeartbeat) + 1);
    END_IF;
END_IF;
awCommand[@O_CLIENT_HEARTBEAT@] := wHeartbeat;

wBits := awStatus[@BITS@];
(* after a start or a new connection the first CMD_SEQ runs nothing: that must be the one before *)
xKnown := xAlive AND awStatus[@ECHO@] = awCommand[@O_CMD_SEQ@];
xReady := xKnown AND iState = 0 AND (wBits AND @READY@) <> 16#0;
tonAnswer(IN := iState = 5 OR iState = 10 OR iState = 20, PT := tLimit);

(* Everything that says what to do is taken here: what changes while the command runs is for the next one. *)
IF iState = 0 AND xExecute AND NOT xWasExecute THEN
    uiRunning := uiCommand;
    awCommand[@O_COMMAND@] := UINT_TO_WORD(uiCommand);
    awCommand[@O_JOB@] := UINT_TO_WORD(uiJob);
    awCommand[@O_ACK_SEQ@] := 16#0;
    awCommand[@O_OPTIONS@] := 16#0;
    IF xAllJobs THEN
        awCommand[@O_OPTIONS@] := @ALL_JOBS@;
    END_IF;
    tLimit := tTimeout;
    awCommand[@O_TIMEOUT@] := DWORD_TO_WORD(DINT_TO_DWORD(TIME_TO_DINT(tTimeout)));
    IF tTimeout > T#60S THEN
        awCommand[@O_TIMEOUT@] := 16#EA60; (* 60000 ms; the register ends at 65535 *)
    END_IF;
    xRigFrame := xAllowRigFrame;
    xSimulated := xAllowSimulated;
    FOR i := 0 TO 5 DO
        dwFlange := DINT_TO_DWORD(adiFlange[i]);
        IF xLowWordFirst THEN
            awCommand[@FLANGE@ + 2 * i] := DWORD_TO_WORD(dwFlange AND 16#FFFF);
            awCommand[@FLANGE@ + 1 + 2 * i] := DWORD_TO_WORD(SHR(dwFlange, 16));
        ELSE
            awCommand[@FLANGE@ + 2 * i] := DWORD_TO_WORD(SHR(dwFlange, 16));
            awCommand[@FLANGE@ + 1 + 2 * i] := DWORD_TO_WORD(dwFlange AND 16#FFFF);
        END_IF;
    END_FOR;
    uiError := 0;
    xExposureDone := FALSE;
    iState := 5;
END_IF;

IF iState = 5 AND xKnown AND awStatus[@CONVENTION@] <> UINT_TO_WORD(uiConvention) THEN
    uiError := 104;
    iState := 40;
END_IF;

IF iState = 5 AND xKnown THEN
    wBefore := awStatus[@ECHO@];
    wEpochFirst := awStatus[@EPOCH@];
    wEpochSecond := awStatus[@EPOCH@ + 1];
    xTaken := FALSE;
    uiSequence := F_EDGED_NEXT(uiSequence := uiSequence);
    awCommand[@O_CMD_SEQ@] := UINT_TO_WORD(uiSequence);
    iState := 10;
END_IF;

xSame := awStatus[@EPOCH@] = wEpochFirst AND awStatus[@EPOCH@ + 1] = wEpochSecond;
xTaken := xTaken OR awStatus[@ECHO@] = UINT_TO_WORD(uiSequence);
(* both in one picture: DONE_SEQ alone could be an older command with the same number *)
xMine := awStatus[@DONE@] = UINT_TO_WORD(uiSequence) AND awStatus[@ECHO@] = UINT_TO_WORD(uiSequence);

(* What takes the command or its result away. Before the cell has taken it, it shows the one before. *)
IF iState = 5 OR iState = 10 OR iState = 20 OR iState = 30 THEN
    IF NOT xLinkOk THEN
        uiError := 101;
        iState := 40;
    ELSIF NOT xAlive THEN
        uiError := 102;
        iState := 40;
    ELSIF iState <> 5 AND NOT xSame THEN
        uiError := 103;
        iState := 40;
    ELSIF iState <> 5 AND awStatus[@ECHO@] <> UINT_TO_WORD(uiSequence)
        AND (xTaken OR awStatus[@ECHO@] <> wBefore) THEN
        uiError := 103;
        iState := 40;
    ELSIF tonAnswer.Q THEN
        uiError := 100;
        iState := 40;
    END_IF;
END_IF;

IF iState = 10 THEN
    IF xTaken AND (wBits AND @EXPOSURE_DONE@) <> 16#0 THEN
        xExposureDone := TRUE;
    END_IF;
    IF xMine AND (wBits AND @NACK@) <> 16#0 AND awStatus[@REASON@] = @BASELINE@ THEN
        iState := 5; (* the connection is a new one: nothing ran, and now the cell knows our CMD_SEQ *)
    ELSIF xMine AND (wBits AND @NACK@) <> 16#0 THEN
        uiError := WORD_TO_UINT(awStatus[@REASON@]);
        iState := 40;
    ELSIF xMine AND (wBits AND @ACK@) <> 16#0 THEN
        IF uiRunning = @CHANGE_JOB@ OR uiRunning >= @HAND_EYE_START@ THEN
            iState := 30; (* a job change, or a step of a registration, has no result *)
        ELSE
            iState := 20;
        END_IF;
    END_IF;
END_IF;

(* Head, tail and epoch are read in one request: all are ours, or it is not our result. Tail 0: it is, and was
withdrawn. What may be used was always decoded in this scan: the result grows old, a new command ends it. *)
xFits := awResult[0] = UINT_TO_WORD(uiSequence)
    AND (awResult[@RESULT_LAST@] = UINT_TO_WORD(uiSequence) OR awResult[@RESULT_LAST@] = 16#0)
    AND awResult[@RESULT_EPOCH@] = wEpochFirst AND awResult[@RESULT_EPOCH@ + 1] = wEpochSecond;
stResult.xValid := FALSE;
IF (iState = 20 OR iState = 30) AND xFits AND uiRunning <> @CHANGE_JOB@ AND uiRunning < @HAND_EYE_START@ THEN
@DECODE@
    stResult.xValid := (awResult[@FLAGS@] AND @VALID@) <> 16#0 AND awResult[@RESULT_LAST@] <> 16#0
        AND ((awResult[@FLAGS@] AND @ROBOT_FRAME@) <> 16#0 OR (xRigFrame AND xAllowRigFrame))
        AND ((awResult[@FLAGS@] AND @F_SIMULATED@) = 16#0 OR (xSimulated AND xAllowSimulated));
    xExposureDone := TRUE;
    iState := 30;
END_IF;

(* The grasp comes by another request: of another command it is not valid. *)
stGrasp.xValid := FALSE;
IF stResult.xValid AND awGrasp[0] = UINT_TO_WORD(uiSequence)
    AND awGrasp[@GRASP_LAST@] = UINT_TO_WORD(uiSequence)
    AND awGrasp[@GRASP_EPOCH@] = wEpochFirst AND awGrasp[@GRASP_EPOCH@ + 1] = wEpochSecond THEN
@DECODE_GRASP@
    stGrasp.xValid := (awGrasp[@GRASP_FLAGS@] AND @VALID@) <> 16#0;
END_IF;

(* A command that failed must not run later: 0 is no command, whenever it arrives. *)
IF NOT xAlive OR (iState = 40 AND uiError >= 100) THEN
    awCommand[@O_CMD_SEQ@] := 16#0;
END_IF;

(* xDone and xError are up for a scan at least, also when xExecute was a pulse (PLCopen, "Creating PLCopen
compliant libraries": Done, Error and Execute). *)
IF (xDone OR xError) AND NOT xExecute THEN
    awCommand[@O_ACK_SEQ@] := UINT_TO_WORD(uiSequence);
    stResult.xValid := FALSE;
    stGrasp.xValid := FALSE;
    iState := 0;
END_IF;
xBusy := iState = 5 OR iState = 10 OR iState = 20;
xDone := iState = 30;
xError := iState = 40;
xWasExecute := xExecute;
END_FUNCTION_BLOCK
"""


def _block() -> str:
    words = {
        "LOCATE": CommandKind.LOCATE.value,
        "CHANGE_JOB": CommandKind.CHANGE_JOB.value,
        "HAND_EYE_START": CommandKind.HAND_EYE_START.value,
        "NEXT_PART": CommandKind.NEXT_PART.value,
        "FIXED_XYZ": Convention.FIXED_XYZ.value,
        "CONVENTIONS": ", ".join(f"{mean.value} {mean.name}" for mean in Convention),
        "COMMANDS": ", ".join(f"{kind.value} {kind.name}" for kind in CommandKind),
        "REASONS": ", ".join(f"{reason.value} {reason.name.lower()}" for reason in Reason if reason),
        "BASELINE": f"16#{Reason.BASELINE.value:04X}",
        "STATUS_LAST": STATUS.words - 1,
        "RESULT_LAST": RESULT.words - 1,
        "CONTROL_LAST": CONTROL_WORDS - 1,
        "HEARTBEAT": _at("HEARTBEAT"),
        "BITS": _at("STATUS_BITS"),
        "DONE": _at("DONE_SEQ"),
        "CONVENTION": _at("CONVENTION"),
        "ECHO": _at("CMD_SEQ_ECHO"),
        "REASON": _at("NACK_REASON"),
        "FLANGE": ADDRESS["FLANGE_X"] - COMMAND.address,
        "EPOCH": _at("START_EPOCH"),
        "RESULT_EPOCH": _in(RESULT, "START_EPOCH"),
        "FLAGS": _in(RESULT, "FLAGS"),
        "GRASP_LAST": GRASP.words - 1,
        "GRASP_EPOCH": _in(GRASP, "G_START_EPOCH"),
        "GRASP_FLAGS": _in(GRASP, "G_FLAGS"),
        "VALID": f"16#{Flag.VALID.value:04X}",
        "ROBOT_FRAME": f"16#{Flag.ROBOT_FRAME.value:04X}",
        "F_SIMULATED": f"16#{Flag.SIMULATED.value:04X}",
        "ALL_JOBS": f"16#{Option.ALL_JOBS.value:04X}",
        "DECODE": _decoded("stResult", RESULT),
        "DECODE_GRASP": _decoded("stGrasp", GRASP),
    }
    words |= {bit.name or "": f"16#{bit.value:04X}" for bit in StatusBit}
    words |= {
        f"O_{name}": ADDRESS[name] - COMMAND.address
        for name in ("COMMAND", "JOB", "CMD_SEQ", "ACK_SEQ", "CLIENT_HEARTBEAT", "OPTIONS", "TIMEOUT")
    }
    return filled(BLOCK, words)


def _decoded(variable: str, block: Block) -> str:
    return "\n".join(
        f"    {variable}.{name} := {conversion};"
        for register in _used(block)
        for name, _, conversion in _fields(block, register)
    )


def _at(name: str) -> int:
    return ADDRESS[name] - STATUS.address


def _in(block: Block, name: str) -> int:
    return next(one.address for one in block.registers if one.name == name) - block.address
