"""Structured text as TwinCAT 3 keeps it: one XML file for each type, function and block.

`.TcPOU` and `.TcDUT` hold declaration and implementation as text ("TcPlcObject"), so nothing is lost on the
way in; "Add > Existing Item" takes them.

TwinCAT maps no Modbus registers cyclically: `FB_EDGED_TC` calls the blocks of TF6250 (Tc2_ModbusSrv) around
`FB_EDGED`, one request after the other. What is particular to them, from Beckhoff's information system
("TF6250 | TwinCAT 3 Modbus TCP", FB_MBReadRegs and FB_MBWriteRegs): a rising edge of bExecute begins, bBusy
is up until the end, registers are words in the PLC's own byte order, and nUnitID is 16#FF for a device that
is addressed by TCP/IP directly.
"""

from __future__ import annotations

import uuid

from edged.plc.registers import COMMAND, GRASP, RESULT, STATUS
from edged.robot.orientations import Convention
from edged.robots.structured_text import CONTROL_WORDS, structured_text_source
from edged.robots.units import Code, Structure, codes, filled, structures

NAMESPACE = uuid.UUID("6b1f1c1e-4f0b-5f5e-9a53-edf6e4444544")
"""Of the ids of the objects: the same name has the same id in every print, so a file can be replaced."""


MODBUS = """\
(* The cell, with its Modbus requests: call it once in every cycle of the task. Needs TF6250 and a reference
to Tc2_ModbusSrv. Inputs and outputs are those of FB_EDGED; udErrorId is the last error of a request. *)
FUNCTION_BLOCK FB_EDGED_TC
VAR_INPUT
    sAddress : STRING(15) := '192.168.10.20';
    uiPort : UINT := 1502;
    uiBase : UINT; (* base_address of the cell *)
    xExecute : BOOL;
    uiCommand : UINT := 1;
    uiJob : UINT;
    xAllJobs : BOOL;
    uiConvention : UINT := @FIXED_XYZ@; (* what the robot takes A, B, C for, as in FB_EDGED *)
    tTimeout : TIME := T#5S;
    xLowWordFirst : BOOL;
    xAllowRigFrame : BOOL;
    xAllowSimulated : BOOL;
    adiFlange : ARRAY[0..5] OF DINT;
END_VAR
VAR_OUTPUT
    xReady : BOOL;
    xBusy : BOOL;
    xExposureDone : BOOL;
    xDone : BOOL;
    xError : BOOL;
    uiError : UINT;
    xLinkOk : BOOL;
    udErrorId : UDINT;
    stResult : ST_EDGED_RESULT;
    stGrasp : ST_EDGED_GRASP;
END_VAR
VAR
    fbEdged : FB_EDGED;
    fbRead : FB_MBReadRegs;
    fbWrite : FB_MBWriteRegs;
    awStatus : ARRAY[0..@STATUS_LAST@] OF WORD;
    awResult : ARRAY[0..@RESULT_LAST@] OF WORD;
    awGrasp : ARRAY[0..@GRASP_LAST@] OF WORD;
    awCommand : ARRAY[0..@CONTROL_LAST@] OF WORD;
    iStep : INT; (* 0 reads the status, 1 the result, 2 the grasp, 3 writes the command *)
    xRequest : BOOL;
    xRequestError : BOOL;
    xEnded : BOOL;
END_VAR
(* one request after the other; the block that works is called in every cycle *)
CASE iStep OF
    0:
        fbRead(sIPAddr := sAddress, nTCPPort := uiPort, nUnitID := 16#FF, nQuantity := @STATUS_WORDS@,
            nMBAddr := UINT_TO_WORD(uiBase + @STATUS@), cbLength := SIZEOF(awStatus),
            pDestAddr := ADR(awStatus), bExecute := xRequest, tTimeout := T#2S);
    1:
        fbRead(sIPAddr := sAddress, nTCPPort := uiPort, nUnitID := 16#FF, nQuantity := @RESULT_WORDS@,
            nMBAddr := UINT_TO_WORD(uiBase + @RESULT@), cbLength := SIZEOF(awResult),
            pDestAddr := ADR(awResult), bExecute := xRequest, tTimeout := T#2S);
    2:
        fbRead(sIPAddr := sAddress, nTCPPort := uiPort, nUnitID := 16#FF, nQuantity := @GRASP_WORDS@,
            nMBAddr := UINT_TO_WORD(uiBase + @GRASP@), cbLength := SIZEOF(awGrasp),
            pDestAddr := ADR(awGrasp), bExecute := xRequest, tTimeout := T#2S);
    3:
        fbWrite(sIPAddr := sAddress, nTCPPort := uiPort, nUnitID := 16#FF, nQuantity := @CONTROL_WORDS@,
            nMBAddr := UINT_TO_WORD(uiBase + @COMMAND@), cbLength := SIZEOF(awCommand),
            pSrcAddr := ADR(awCommand), bExecute := xRequest, tTimeout := T#2S);
END_CASE;
IF iStep = 3 THEN
    xEnded := xRequest AND NOT fbWrite.bBusy;
    xRequestError := fbWrite.bError;
ELSE
    xEnded := xRequest AND NOT fbRead.bBusy;
    xRequestError := fbRead.bError;
END_IF;

(* bExecute is FALSE for a cycle between two requests: each begins with its rising edge *)
IF NOT xRequest THEN
    xRequest := TRUE;
ELSIF xEnded AND xRequestError THEN
    IF iStep = 3 THEN
        udErrorId := fbWrite.nErrId;
    ELSE
        udErrorId := fbRead.nErrId;
    END_IF;
    xLinkOk := FALSE;
    xRequest := FALSE;
    iStep := 0;
ELSIF xEnded THEN
    IF iStep = 3 THEN
        xLinkOk := TRUE; (* all of them have succeeded *)
        iStep := 0;
    ELSE
        iStep := iStep + 1;
    END_IF;
    xRequest := FALSE;
END_IF;

fbEdged(xLinkOk := xLinkOk, xExecute := xExecute, uiCommand := uiCommand, uiJob := uiJob,
    xAllJobs := xAllJobs, uiConvention := uiConvention, tTimeout := tTimeout, xLowWordFirst := xLowWordFirst,
    xAllowRigFrame := xAllowRigFrame, xAllowSimulated := xAllowSimulated, adiFlange := adiFlange,
    awStatus := awStatus, awResult := awResult, awGrasp := awGrasp,
    xReady => xReady, xBusy => xBusy, xExposureDone => xExposureDone, xDone => xDone, xError => xError,
    uiError => uiError, stResult => stResult, stGrasp => stGrasp);
(* what is being sent must not change; it is taken anew before each write *)
IF iStep <> 3 OR NOT xRequest THEN
    awCommand := fbEdged.awCommand;
END_IF;
END_FUNCTION_BLOCK
"""


def twincat_files() -> dict[str, str]:
    """Name and text of each file."""
    source = structured_text_source() + _modbus()
    files = {f"{one.name}.TcDUT": _object("DUT", one.name, _type(one)) for one in structures(source)}
    return files | {f"{one.name}.TcPOU": _object("POU", one.name, _code(one)) for one in codes(source)}


def _object(kind: str, name: str, inside: str) -> str:
    special = ' SpecialFunc="None"' if kind == "POU" else ""
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        '<TcPlcObject Version="1.1.0.1">\n'
        f'  <{kind} Name="{name}" Id="{{{uuid.uuid5(NAMESPACE, name)}}}"{special}>\n'
        f"{inside}"
        f"  </{kind}>\n"
        "</TcPlcObject>\n"
    )


def _type(one: Structure) -> str:
    fields = [f"    {field.name} : {field.type}; // {field.comment}" for field in one.fields]
    # as TwinCAT writes it: no semicolon behind END_STRUCT
    text = "\n".join([f"TYPE {one.name} :", "STRUCT", *fields, "END_STRUCT", "END_TYPE", ""])
    return f"    <Declaration>{_data(text)}</Declaration>\n"


def _code(one: Code) -> str:
    comment = f"{one.comment}\n" if one.comment else ""
    return (
        f"    <Declaration>{_data(comment + one.declaration)}</Declaration>\n"
        "    <Implementation>\n"
        f"      <ST>{_data(one.body)}</ST>\n"
        "    </Implementation>\n"
    )


def _data(text: str) -> str:
    if "]]>" in text:
        raise ValueError("text ends a CDATA section")
    return f"<![CDATA[{text}]]>"


def _modbus() -> str:
    numbers = {
        "STATUS_LAST": STATUS.words - 1,
        "RESULT_LAST": RESULT.words - 1,
        "GRASP_LAST": GRASP.words - 1,
        "CONTROL_LAST": CONTROL_WORDS - 1,
        "STATUS_WORDS": f"16#{STATUS.words:X}",
        "RESULT_WORDS": f"16#{RESULT.words:X}",
        "GRASP_WORDS": f"16#{GRASP.words:X}",
        "CONTROL_WORDS": f"16#{CONTROL_WORDS:X}",
        "STATUS": STATUS.address,
        "RESULT": RESULT.address,
        "GRASP": GRASP.address,
        "COMMAND": COMMAND.address,
        "FIXED_XYZ": Convention.FIXED_XYZ.value,
    }
    return filled(MODBUS, numbers)
