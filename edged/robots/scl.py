"""The PLC's side for SIMATIC S7-1200 and S7-1500: an SCL source with the Modbus requests in it.

TIA Portal maps no Modbus registers cyclically: the program itself calls MB_CLIENT, one request after the
other. `FB_EDGED_S7` does that around `FB_EDGED`, which is the same as everywhere.

What is particular to these PLCs, from the "S7-1200 Programmable controller, System Manual" (V4.2, 13.5,
"MODBUS TCP"): MB_MODE 103 reads 1 to 125 holding registers from the address 0 to 65535 that MB_DATA_ADDR
gives, 116 writes 1 to 123; a request begins with REQ and its parameters must stay until DONE or ERROR; the
buffer lies in a data block with standard access. A source for "Generate blocks from source" is ANSI, or UTF
with a byte order mark: hence ASCII. A function's call names its parameters, SHL and SHR too.
"""

from __future__ import annotations

import re

from edged.plc.registers import COMMAND, GRASP, MAP_VERSION, RESULT, STATUS
from edged.robot.orientations import Convention
from edged.robots.structured_text import CONTROL_WORDS, structured_text_source
from edged.robots.units import COMMENT, Code, Structure, Variable, codes, filled, structures

ADDRESS_BYTES = ("16#C0", "16#A8", "16#0A", "16#14")  # 192.168.10.20
SHIFT = re.compile(r"\b(SHL|SHR)\(((?:[^(),]|\([^()]*\))+), (\d+)\)")
WORD = re.compile(r"(?<![\w.#\"])[A-Za-z_]\w*(?![\w#])")

S7 = """\
DATA_BLOCK "DB_EDGED"
{ S7_Optimized_Access := 'FALSE' }
VERSION : 0.1
NON_RETAIN
   STRUCT
      awStatus : Array[0..@STATUS_LAST@] of Word;
      awResult : Array[0..@RESULT_LAST@] of Word;
      awGrasp : Array[0..@GRASP_LAST@] of Word;
      awCommand : Array[0..@CONTROL_LAST@] of Word;
   END_STRUCT;
BEGIN
END_DATA_BLOCK

(* The cell, with its Modbus requests: call it in every cycle of OB1, once, and nothing else for this cell.
Inputs and outputs are those of FB_EDGED. wStatus is the last error of MB_CLIENT. *)
FUNCTION_BLOCK "FB_EDGED_S7"
{ S7_Optimized_Access := 'TRUE' }
VERSION : 0.1
   VAR_INPUT
      xExecute : Bool;
      uiCommand : UInt := 1;
      uiJob : UInt;
      xAllJobs : Bool;
      uiConvention : UInt := @FIXED_XYZ@; (* what the robot takes A, B, C for, as in FB_EDGED *)
      tTimeout : Time := T#5S;
      xAllowRigFrame : Bool;
      xAllowSimulated : Bool;
      xLowWordFirst : Bool;
      adiFlange : Array[0..5] of DInt;
      bIp1 : Byte := @IP1@; (* 192.168.10.20 *)
      bIp2 : Byte := @IP2@;
      bIp3 : Byte := @IP3@;
      bIp4 : Byte := @IP4@;
      uiPort : UInt := 1502;
      uiBase : UInt; (* base_address of the cell *)
      hwInterface : HW_ANY := 64; (* of the PROFINET port: PLC tags, system constants *)
      idConnection : CONN_OUC := 1; (* a number that no other connection of the PLC has *)
   END_VAR
   VAR_OUTPUT
      xReady : Bool;
      xBusy : Bool;
      xExposureDone : Bool;
      xDone : Bool;
      xError : Bool;
      uiError : UInt;
      xLinkOk : Bool;
      wStatus : Word;
      stResult : "ST_EDGED_RESULT";
      stGrasp : "ST_EDGED_GRASP";
   END_VAR
   VAR
      fbEdged : "FB_EDGED";
      mbClient : MB_CLIENT;
      stConnection : TCON_IP_V4;
      iStep : Int; (* 0 reads the status, 1 the result, 2 the grasp, 3 writes the command *)
      xRequest : Bool;
      xRequestDone : Bool;
      xRequestBusy : Bool;
      xRequestError : Bool;
      wRequestStatus : Word;
   END_VAR
BEGIN
   #stConnection.InterfaceId := #hwInterface;
   #stConnection.ID := #idConnection;
   #stConnection.ConnectionType := 16#0B; (* TCP *)
   #stConnection.ActiveEstablished := TRUE;
   #stConnection.RemoteAddress.ADDR[1] := #bIp1;
   #stConnection.RemoteAddress.ADDR[2] := #bIp2;
   #stConnection.RemoteAddress.ADDR[3] := #bIp3;
   #stConnection.RemoteAddress.ADDR[4] := #bIp4;
   #stConnection.RemotePort := #uiPort;

   (* one request after the other; MB_CLIENT is called in every cycle, also while it works *)
   CASE #iStep OF
      0:
         #mbClient(REQ := #xRequest, DISCONNECT := FALSE, MB_MODE := 103,
            MB_DATA_ADDR := UINT_TO_UDINT(#uiBase) + @STATUS@, MB_DATA_LEN := @STATUS_WORDS@,
            MB_DATA_PTR := "DB_EDGED".awStatus, CONNECT := #stConnection, DONE => #xRequestDone,
            BUSY => #xRequestBusy, ERROR => #xRequestError, STATUS => #wRequestStatus);
      1:
         #mbClient(REQ := #xRequest, DISCONNECT := FALSE, MB_MODE := 103,
            MB_DATA_ADDR := UINT_TO_UDINT(#uiBase) + @RESULT@, MB_DATA_LEN := @RESULT_WORDS@,
            MB_DATA_PTR := "DB_EDGED".awResult, CONNECT := #stConnection, DONE => #xRequestDone,
            BUSY => #xRequestBusy, ERROR => #xRequestError, STATUS => #wRequestStatus);
      2:
         #mbClient(REQ := #xRequest, DISCONNECT := FALSE, MB_MODE := 103,
            MB_DATA_ADDR := UINT_TO_UDINT(#uiBase) + @GRASP@, MB_DATA_LEN := @GRASP_WORDS@,
            MB_DATA_PTR := "DB_EDGED".awGrasp, CONNECT := #stConnection, DONE => #xRequestDone,
            BUSY => #xRequestBusy, ERROR => #xRequestError, STATUS => #wRequestStatus);
      3:
         #mbClient(REQ := #xRequest, DISCONNECT := FALSE, MB_MODE := 116,
            MB_DATA_ADDR := UINT_TO_UDINT(#uiBase) + @COMMAND@, MB_DATA_LEN := @CONTROL_WORDS@,
            MB_DATA_PTR := "DB_EDGED".awCommand, CONNECT := #stConnection, DONE => #xRequestDone,
            BUSY => #xRequestBusy, ERROR => #xRequestError, STATUS => #wRequestStatus);
   END_CASE;

   (* REQ is FALSE for a cycle between two requests: each begins with its rising edge *)
   IF #xRequestError THEN
      #xLinkOk := FALSE;
      #wStatus := #wRequestStatus;
      #xRequest := FALSE;
      #iStep := 0;
   ELSIF #xRequestDone THEN
      #xRequest := FALSE;
      IF #iStep = 3 THEN
         #xLinkOk := TRUE; (* all of them have succeeded *)
         #iStep := 0;
      ELSE
         #iStep := #iStep + 1;
      END_IF;
   ELSE
      #xRequest := TRUE;
   END_IF;

   #fbEdged(xLinkOk := #xLinkOk, xExecute := #xExecute, uiCommand := #uiCommand, uiJob := #uiJob,
      xAllJobs := #xAllJobs, uiConvention := #uiConvention,
      tTimeout := #tTimeout, xLowWordFirst := #xLowWordFirst, xAllowRigFrame := #xAllowRigFrame,
      xAllowSimulated := #xAllowSimulated, adiFlange := #adiFlange, awStatus := "DB_EDGED".awStatus,
      awResult := "DB_EDGED".awResult, awGrasp := "DB_EDGED".awGrasp,
      xReady => #xReady, xBusy => #xBusy, xExposureDone => #xExposureDone,
      xDone => #xDone, xError => #xError, uiError => #uiError, stResult => #stResult,
      stGrasp => #stGrasp);
   (* what is being sent must not change; it is taken anew before each write *)
   IF #iStep <> 3 OR NOT #xRequest THEN
      "DB_EDGED".awCommand := #fbEdged.awCommand;
   END_IF;
END_FUNCTION_BLOCK
"""


def scl_source() -> str:
    """Types, functions, `FB_EDGED`, the buffer `DB_EDGED` and `FB_EDGED_S7`, as text."""
    source = structured_text_source()
    all_codes = codes(source)
    functions = {code.name for code in all_codes if code.keyword == "FUNCTION"}
    header = f"(* edged, map version {MAP_VERSION}: written by `edged registers --format scl`. *)"
    return "\n".join(
        (
            header,
            *(_type(structure) for structure in structures(source)),
            *(_code(code, functions) for code in all_codes),
            _s7(),
        )
    )


def _type(structure: Structure) -> str:
    fields = [f"      {_declared(field)}" for field in structure.fields]
    return "\n".join(
        [f'TYPE "{structure.name}"', "VERSION : 0.1", "   STRUCT", *fields, "   END_STRUCT;", "END_TYPE", ""]
    )


def _declared(variable: Variable) -> str:
    kind = {"TON": "TON_TIME"}.get(variable.type, variable.type)
    kind = f'"{kind}"' if kind.startswith("ST_") else kind
    if variable.bounds is not None:
        kind = f"Array[{variable.bounds[0]}..{variable.bounds[1]}] of {kind}"
    system = " {InstructionName := 'TON_TIME'; LibVersion := '1.0'}" if kind == "TON_TIME" else ""
    initial = f" := {variable.initial}" if variable.initial else ""
    comment = f" // {variable.comment}" if variable.comment else ""
    return f"{variable.name}{system} : {kind}{initial};{comment}"


def _code(code: Code, functions: set[str]) -> str:
    returns = f" : {code.returns}" if code.returns else ""
    lines = [
        *([code.comment] if code.comment else []),
        f'{code.keyword} "{code.name}"{returns}',
        "{ S7_Optimized_Access := 'TRUE' }",
        "VERSION : 0.1",
    ]
    for section, variables in code.sections:
        # a function keeps nothing from call to call: its own variables are temporary
        keyword = "VAR_TEMP" if section == "VAR" and code.keyword == "FUNCTION" else section
        lines += [f"   {keyword}", *(f"      {_declared(one)}" for one in variables), "   END_VAR"]
    own = {variable.name for _, variables in code.sections for variable in variables} | {code.name}
    return "\n".join(
        [*lines, "BEGIN", _body(code.body, own, functions - {code.name}) + f"END_{code.keyword}", ""]
    )


def _body(text: str, own: set[str], functions: set[str]) -> str:
    """Own names get their #, blocks their quotes, shifts the names of their parameters; comments stay."""
    parts, end = [], 0
    for comment in COMMENT.finditer(text):
        parts += [_marked(text[end : comment.start()], own, functions), comment[0]]
        end = comment.end()
    return "".join((*parts, _marked(text[end:], own, functions)))


def _marked(text: str, own: set[str], functions: set[str]) -> str:
    text = SHIFT.sub(r"\1(IN := \2, N := \3)", text)
    depth, marked, end = 0, [], 0
    for word in WORD.finditer(text):
        between = text[end : word.start()]
        depth += between.count("(") - between.count(")")
        name, end_of_word = word[0], word.end()
        is_formal = depth > 0 and text[end_of_word:].lstrip().startswith(":=")
        if name in functions:
            name = f'"{name}"'
        elif name in own and not is_formal:
            name = f"#{name}"
        marked += [between, name]
        end = end_of_word
    return "".join((*marked, text[end:]))


def _s7() -> str:
    values = {
        "STATUS_LAST": STATUS.words - 1,
        "RESULT_LAST": RESULT.words - 1,
        "GRASP_LAST": GRASP.words - 1,
        "CONTROL_LAST": CONTROL_WORDS - 1,
        "STATUS_WORDS": STATUS.words,
        "RESULT_WORDS": RESULT.words,
        "GRASP_WORDS": GRASP.words,
        "CONTROL_WORDS": CONTROL_WORDS,
        "STATUS": STATUS.address,
        "RESULT": RESULT.address,
        "GRASP": GRASP.address,
        "COMMAND": COMMAND.address,
        "FIXED_XYZ": Convention.FIXED_XYZ.value,
        **{f"IP{i}": byte for i, byte in enumerate(ADDRESS_BYTES, start=1)},
    }
    return filled(S7, values)
