"""The robot's side in SPEL+, for Epson's RC700 and RC90 controllers.

From the "EPSON RC+ SPEL+ Language Reference" (7.0 and 8.0):

* `SetNet` gives port 201 its address and the line feed as end of line; `OpenNet ... As Client` and `WaitNet`
  connect, with a time-out in seconds. `CloseNet` hangs up.
* `ChkNet`: how many characters wait, or without any the state of the port: -1 not connected, -2 another
  task's, -3 closed. `Read` takes so many into a string, of at most 255 characters.
* `Print #` adds the end of line. It is an error on a port that is closed: `OnErr GoTo`, `EResume`.
* Names have at most 32 characters, in either case the same; those of strings end with $. `Global` makes a
  variable known to all functions; an array's number is its last index, its first is 0. `TmReset` and `Tmr`
  count seconds.
* `Here` is where the active tool is, `CX` to `CW` its coordinates, tool 0 the flange; `Tool` alone is the
  number of the active one.
* `XY(X, Y, Z, U, V, W)`: mm, and degrees about Z, the new Y, the new X; SCARA robots have X, Y, Z, U.
  `+TLZ(-100)` is back along the tool's Z, `+Z(100)` up along the frame's.
"""

from __future__ import annotations

from edged.plc.lines import answer_fields
from edged.robot.orientations import Brand
from edged.robots.robotlines import filled, statuses
from edged.robots.skeleton import NUMBERS, Dialect, indented, routines

TIMER = 15
"""Of 0 to 15; one that nothing else uses."""
HEAD = """\
' edged: written by `edged registers --format spel`. A program file for EPSON RC+.
' Needs [modbus.socket] in the cell's configuration; its address is in EdgedOpenLink.
'
'   EdgedLocate 0, 5                  ' job 0: the active one; seconds
'   If edgedError = 0 Then
'     P10 = XY(edgedPart(1), edgedPart(2), edgedPart(3), edgedPart(4), edgedPart(5), edgedPart(6))
'     Go P10 +TLZ(-100)               ' mm and degrees, in the frame that the rig was registered to
'   EndIf
'   EdgedAck
'
' EdgedNext 5: the next part of the same picture, edgedRemaining says how many there are.
' EdgedFetchGrasp 5: edgedGrasp and edgedApproach of the part that was given last.
' edgedSigmaX, edgedSigmaY, edgedSigmaZ: mm, -1 is not known; edgedAge: seconds.
' Move only while edgedError is 0. Otherwise it says why:
@STATUSES@
@GLOBALS@
Function EdgedLocate(job As Long, timeout As Double)
  edgedJob = job
  edgedTimeout = timeout
  Call EdgedRunLocate
Fend

Function EdgedNext(timeout As Double)
  edgedTimeout = timeout
  Call EdgedRunNext
Fend

Function EdgedFetchGrasp(timeout As Double)
  edgedTimeout = timeout
  Call EdgedRunGrasp
Fend

Function EdgedAck
  Call EdgedRunAcknowledge
Fend

Function EdgedDo(request$ As String, timeout As Double)
  edgedRequest$ = request$
  edgedTimeout = timeout
  Call EdgedRunPerform
Fend

Function EdgedRunOpenLink
  Call EdgedRunHangUp
  edgedError = @NO_LINK@
  OnErr GoTo EdgedNoLink
  SetNet #201, "192.168.10.20", @PORT@, LF, NONE, 0
  OpenNet #201 As Client
  WaitNet #201, 3
  If ChkNet(201) >= 0 Then
    edgedError = 0
    edgedIsOpen = 1
  EndIf
  OnErr GoTo 0
  Exit Function
EdgedNoLink:
  EResume EdgedLinkEnd
EdgedLinkEnd:
  OnErr GoTo 0
Fend

Function EdgedRunAddPlace
  edgedTool = Tool
  Tool 0
  edgedRequest$ = edgedRequest$ + "," + Str$(CX(Here)) + "," + Str$(CY(Here)) + "," + Str$(CZ(Here))
  edgedRequest$ = edgedRequest$ + "," + Str$(CU(Here)) + "," + Str$(CV(Here)) + "," + Str$(CW(Here))
  Tool edgedTool
Fend

Function EdgedRunHangUp
  If ChkNet(201) <> -3 Then
    CloseNet #201
  EndIf
  edgedIsOpen = 0
Fend

Function EdgedRunSend
  If ChkNet(201) < 0 Then
    edgedError = @NO_LINK@
    Exit Function
  EndIf
  OnErr GoTo EdgedNotSent
  Print #201, "@BRAND@," + Str$(edgedNumber) + "," + edgedRequest$
  OnErr GoTo 0
  Exit Function
EdgedNotSent:
  edgedError = @NO_LINK@
  EResume EdgedSendEnd
EdgedSendEnd:
  OnErr GoTo 0
Fend

Function EdgedRunReceive
  edgedBytes = ChkNet(201)
  If edgedBytes < 0 Then
    edgedBytes = -1
  EndIf
  If edgedBytes > 255 Then
    edgedBytes = -2
  EndIf
  If edgedBytes > 0 Then
    Read #201, edgedHeard$, edgedBytes
  EndIf
Fend

Function EdgedRunStartClock
  TmReset @TIMER@
Fend

Function EdgedRunReadClock
  edgedElapsed = Tmr(@TIMER@)
Fend

Function EdgedRunPause
  Wait 0.01
Fend
"""


def _words(name: str) -> str:
    return "".join(word.title() for word in name.removeprefix("n_").split("_"))


DIALECT = Dialect(
    brand=Brand.EPSON,
    variable=lambda name: "edged" + _words(name),
    request="edgedRequest$",
    routine=lambda name: "EdgedRun" + _words(name),
    called="Call {}",
    statements={
        "if": "If {} Then",
        "else": "Else",
        "end if": "EndIf",
        "while": "Do While {}",
        "end while": "Loop",
    },
    to_text="Str$({})",
    code="Asc(Mid$(edgedHeard$, edgedIndex, 1))",
    element="edgedField({})",
    pose=tuple(f"edged{{title}}({i})" for i in range(1, 7)),
    operators={"and": "And", "==": "="},
)


def spel_source() -> str:
    """A program file, as text."""
    fields = len(answer_fields(Brand.EPSON))
    declared = [f"Global Double {DIALECT.variable(name)}" for name in (*NUMBERS, "tool")]
    declared += [f"Global Double edged{name}(6)" for name in ("Part", "Grasp", "Approach")]
    declared += [f"Global Double edgedField({fields})"]
    declared += ["Global String edgedRequest$", "Global String edgedHeard$"]
    more = {"STATUSES": statuses("'   "), "GLOBALS": "\n".join([*declared, ""]), "TIMER": TIMER}
    text = filled(HEAD, Brand.EPSON, first=1, **more)
    for name, lines in routines(DIALECT).items():
        body = indented(lines, "If |Do While ", "EndIf|Loop", "Else")
        text += "\n".join(["", f"Function {name}", *body, "Fend", ""])
    return text
