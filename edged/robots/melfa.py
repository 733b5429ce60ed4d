r"""The robot's side in MELFA-BASIC V and VI, for Mitsubishi's CR750, CR751 and CR800 controllers.

Written from memory of the "Instruction Manual: Detailed explanations of functions and operations" (BFP-A8869)
and of programs that are known to run: the manual was not at hand, and the places could not be looked up.

* `Open "COM3:" As #1` of a device that the Ethernet parameters make a client connects; `M_Open(1)` is 1 once
  it is there. `Close` hangs up.
* `Print #` ends with a carriage return, or with a line feed behind it, and `Input #` waits for the same: so
  say the parameters NETTERM (whether there is an end) and CTERME11 to CTERME19 (0: CR, 1: CR LF) of the
  device; it is CR unless they were changed. The cell ends its answer as the request ended.
* `Input #` waits for a whole line, without a time-out, and puts what stands between its commas into the
  variables. Numbers beyond these are ignored: hence the request's number stands at the end of an answer once
  more. What is no number is an error, and stops the program.
* So a second task slot does the talking, and the first one stops it after the time-out: `XRun`, `XStp`,
  `XRst`, `XClr`; `M_Wai` is 1 of a slot that was stopped, `M_Psa` of one that was reset.
* `M_Timer` counts ms. `M_00` to `M_19` and `P_100(1)` to `P_102(10)` are known to all programs, and kept.
* A position is X, Y, Z in mm and A, B, C in degrees about X, Y, Z, turned about Z first, and structure flags
  (CR750 manual, 4.5.3 "About position data", read); a component of it that is an angle is in radians: `Rad`.
  `P_Curr` has the arm's structure flags, and is where the tip of `P_Tool` is: `P_Curr*Inv(P_Tool)` is the
  flange. `Str$` writes a number as digits.
* M makes a name a number's, C a text's, P a position's; % that of a whole number of 16 bits. Words and
  limits: `grammars/melfa.toml`.
"""

from __future__ import annotations

from edged.plc.lines import LineStatus
from edged.robot.orientations import Brand
from edged.robots.robotlines import filled, statuses

PARTS = 10
"""Elements of P_100."""
SLOT = 2
"""The task slot that talks; one that runs nothing else."""
MAIN = """\
' edged: written by `edged registers --format melfa`. Needs EDGEDL beside it, and task slot @SLOT@.
' Needs [modbus.socket] in the cell's configuration, and COM3: as its client.
'
'   CallP "EDGED",0,5000,1,0
'     job (0: the active one), ms to wait, how many parts at most (@PARTS@), 1 for grasps as well
'   M_00 0: P_100(1) is the pose of the part, and may be used; anything else: do not move
'   M_01 how many parts there are        M_02 how many more were found
'   M_03 seconds since the exposure      M_04 M_05 M_06 sigma of X, Y, Z in mm (-1: not known)
'   P_101(1) where the tool takes the part, P_102(1) from where it comes; the sigmas are then the tool's
' Positions are in the frame that the rig was registered to: normally the base. M_10 to M_15 are the link's.
' M_00 is, beside 0:
@STATUSES@
FPrm MJob,MMs,MMax,MGrasp
M_00=@LATE@
M_01=0
M_02=0
M_10=MJob
M_11=MMax
If M_11>@PARTS@ Then M_11=@PARTS@
M_12=MGrasp
M_13=0
M_Timer(1)=0
XRun @SLOT@,"EDGEDL",1
*LWAIT
If M_13=1 Then GoTo *LDONE
If M_13=2 Then GoTo *LUSED
If M_Timer(1)>=MMs Then GoTo *LLATE
Dly 0.01
GoTo *LWAIT
*LUSED
' the parts are here; that they were used is said for at most a second
M_Timer(1)=0
*LACK
If M_13=1 Then GoTo *LDONE
If M_Timer(1)>=1000 Then GoTo *LSTOP
Dly 0.01
GoTo *LACK
*LLATE
GoSub *LRESET
M_00=@LATE@
M_01=0
M_02=0
GoTo *LEND
*LSTOP
GoSub *LRESET
GoTo *LEND
*LDONE
Wait M_Psa(@SLOT@)=1
XClr @SLOT@
*LEND
End
*LRESET
XStp @SLOT@
Wait M_Wai(@SLOT@)=1
XRst @SLOT@
Wait M_Psa(@SLOT@)=1
XClr @SLOT@
Return
"""
LINK = """\
' edged: the link, which EDGED runs in a task slot of its own
MErr=@NO_LINK@
MTaken=0
MMore=0
M_Timer(2)=0
Open "COM3:" As #1
*LOPEN
If M_Open(1)=1 Then GoTo *LLINK
If M_Timer(2)>=3000 Then GoTo *LEND
Dly 0.01
GoTo *LOPEN
*LLINK
GoSub *LNUMBER
MCmd%=MSeq%
MJob%=M_10
CAsk$="LOCATE,"+Str$(MJob%)
GoSub *LPLACE
GoSub *LASK
*LPART
If MErr<>0 Then GoTo *LEND
MMore=MF@REMAINING@
MTaken=MTaken+1
If MTaken=1 Then GoSub *LGOOD
GoSub *LPOSE
P_100(MTaken)=PNew
If M_12=0 Then GoTo *LNEXT
GoSub *LNUMBER
CAsk$="GRASP"
GoSub *LASK
If MErr<>0 Then GoTo *LEND
If MTaken=1 Then GoSub *LGOOD
GoSub *LPOSE
P_101(MTaken)=PNew
GoSub *LNUMBER
CAsk$="APPROACH"
GoSub *LASK
If MErr<>0 Then GoTo *LEND
GoSub *LPOSE
P_102(MTaken)=PNew
*LNEXT
If MMore=0 Then GoTo *LUSED
If MTaken>=M_11 Then GoTo *LUSED
GoSub *LNUMBER
CAsk$="NEXT"
GoSub *LASK
If MErr<>@NO_FURTHER@ Then GoTo *LPART
MMore=0
*LUSED
M_01=MTaken
M_02=MMore
M_00=0
M_13=2
MSeq%=MCmd%
CAsk$="ACK"
GoSub *LASK
MErr=0
*LEND
Close #1
M_00=MErr
M_13=1
End
*LNUMBER
MSeq%=M_15
If MSeq%>=30000 Then MSeq%=0
MSeq%=MSeq%+1
M_15=MSeq%
Return
*LASK
Print #1,"@BRAND@,"+Str$(MSeq%)+","+CAsk$
MF1=0
MF2=@NO_ANSWER@
MF@FIELDS@=-1
Input #1,@VARIABLES@
MErr=@NO_ANSWER@
If MF@FIELDS@<>MF1 Then GoTo *LBACK
MErr=MF2
If MErr<>0 Then GoTo *LBACK
If MF1<>MSeq% Then MErr=@OTHERS@
*LBACK
Return
*LPLACE
' where the flange is: cameras on it see from there
PFlange=P_Curr*Inv(P_Tool)
CAsk$=CAsk$+","+Str$(PFlange.X)+","+Str$(PFlange.Y)+","+Str$(PFlange.Z)
CAsk$=CAsk$+","+Str$(Deg(PFlange.A))+","+Str$(Deg(PFlange.B))+","+Str$(Deg(PFlange.C))
Return
*LPOSE
PNew=P_Curr
PNew.X=MF@X@
PNew.Y=MF@Y@
PNew.Z=MF@Z@
PNew.A=Rad(MF@A@)
PNew.B=Rad(MF@B@)
PNew.C=Rad(MF@C@)
Return
*LGOOD
M_03=MF@AGE@
M_04=MF@SIGMA_X@
M_05=MF@SIGMA_Y@
M_06=MF@SIGMA_Z@
Return
"""


def _numbered(text: str) -> str:
    """Each line with its number, as the controller keeps a program."""
    return "".join(f"{number} {line}\n" for number, line in enumerate(text.splitlines(), 1))


def melfa_files() -> dict[str, str]:
    """Programs by their files' names: the one that is called, and the link."""
    fields = int(filled("@FIELDS@", Brand.MITSUBISHI, first=1))
    values = {
        "STATUSES": statuses("'   "),
        "PARTS": PARTS,
        "SLOT": SLOT,
        "NO_FURTHER": int(LineStatus.NO_FURTHER),
        "VARIABLES": ",".join(f"MF{number}" for number in range(1, fields + 1)),
    }
    files = {"EDGED.prg": MAIN, "EDGEDL.prg": LINK}
    return {
        name: _numbered(filled(text, Brand.MITSUBISHI, first=1, **values)) for name, text in files.items()
    }
