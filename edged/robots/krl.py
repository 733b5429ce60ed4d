"""The robot's side in KRL, for KUKA controllers with the option KUKA.EthernetKRL 2.2 or later.

From "KUKA.EthernetKRL 2.2" (KST EthernetKRL 2.2 V1) and "KUKA.Ethernet KRL 3.0" (KST Ethernet KRL 3.0 V3):

* 6.1.2 "XML structure for data reception": RAW with TYPE STREAM and EOS takes lines that are no XML; EOS 10
  is the line feed, at most 3600 bytes. 6.1.1: ENVIRONMENT Program closes the link with the program.
* 6.2.4 "Sending data": with a string, EOS of the SEND section is appended. EKI 3.0 sends up to the first zero
  unless the length is given; so the request fills its array, with blanks, which the cell ignores. It has room
  for a pose.
* 6.2.5 "Reading out data": a string to be read into is initialised first.
* 6.2.7 "EKI_STATUS": MSG_NO is 0 without an error, BUFF the lines that wait. Errors are shown on the smartHMI
  and stop the program unless MESSAGES DISPLAY is "disabled"; closing what is not open cannot be silenced: a
  link is closed only while its flag (ALIVE) says that it is there.

From the "KUKA System Software 8.x: Operating and Programming Instructions for System Integrators": names of
at most 24 characters; arrays are handed over as OUT; INT of 32 bits, whose quotient is whole; REAL of 32
bits; FRAME with X, Y, Z, A, B, C; the geometric operator ":" joins frames, and a position and a frame to a
frame; `$POS_ACT` is where the tip of `$TOOL` is in `$BASE`, `INV_POS` turns a frame round. `WAIT SEC` stops
the advance run, so that `$POS_ACT` is read where the robot stands. Digits are looked up in a string: no
conversion of CHAR to INT is relied on.
"""

from __future__ import annotations

from edged.plc.lines import LineStatus
from edged.robot.orientations import Brand
from edged.robots.robotlines import filled, statuses
from edged.robots.skeleton import NUMBERS, Dialect, routines
from edged.robots.walk import CODES, steps

ADVANCE = 10
"""Targets that one call fetches at most."""
REQUEST_BYTES = 128

CONFIGURATION = """\
<ETHERNETKRL>
  <CONFIGURATION>
    <EXTERNAL>
      <IP>192.168.10.20</IP>
      <PORT>@PORT@</PORT>
      <TYPE>Server</TYPE>
    </EXTERNAL>
    <INTERNAL>
      <ENVIRONMENT>Program</ENVIRONMENT>
      <BUFFERING Mode="FIFO" Limit="16"/>
      <BUFFSIZE Limit="16384"/>
      <TIMEOUT Connect="3000"/>
      <ALIVE Set_Flag="@FLAG@"/>
      <PROTOCOL>TCP</PROTOCOL>
      <MESSAGES Logging="error" Display="disabled"/>
    </INTERNAL>
  </CONFIGURATION>
  <RECEIVE>
    <RAW>
      <ELEMENT Tag="Line" Type="STREAM" EOS="10" Size="256"/>
    </RAW>
  </RECEIVE>
  <SEND>
    <RAW>
      <ELEMENT Tag="Line" Type="STREAM" EOS="10" Size="256"/>
    </RAW>
  </SEND>
</ETHERNETKRL>
"""
DATA = """\
&ACCESS RVP
&COMMENT edged: written by edged registers --format krl
DEFDAT EDGED PUBLIC
DECL GLOBAL INT EDGED_ERROR=0
DECL GLOBAL INT EDGED_COUNT=0
DECL GLOBAL INT EDGED_REMAINING=0
DECL GLOBAL REAL EDGED_AGE=-1.0
DECL GLOBAL FRAME EDGED_PART[@TARGETS@]
DECL GLOBAL FRAME EDGED_GRASP[@TARGETS@]
DECL GLOBAL FRAME EDGED_APPROACH[@TARGETS@]
DECL GLOBAL REAL EDGED_SIGMA[3]
DECL REAL FIELD[@FIELDS@]
DECL FRAME POSE
DECL FRAME FLANGE
DECL INT ED_KIND=0
DECL CHAR ED_LINE[256]
@NUMBERS@
ENDDAT
"""
SOURCE = """\
&ACCESS RVP
&COMMENT edged: written by edged registers --format krl
; Needs [modbus.socket] in the cell's configuration.
;
;   IF EDGED_LOCATE(0,5.0) THEN      ; job 0: the active one; seconds
;     PICK=EDGED_PART[1]:{X 0,Y 0,Z -100,A 0,B 0,C 0}
;     LIN PICK                       ; to EDGED_PART[EDGED_COUNT]; mm and degrees in the robot's base
;   ENDIF
;
; EDGED_LOCATE_GRASPS(0,5.0) is the same, and EDGED_GRASP[] is where the tool takes each part,
; EDGED_APPROACH[] from where it comes. EDGED_LOCATE leaves them as they were: of parts long gone.
;
; Move only when it is TRUE. Otherwise EDGED_ERROR says why:
@STATUSES@
DEF EDGED()
END

; Measure, fetch the targets, acknowledge, hang up.
GLOBAL DEFFCT BOOL EDGED_LOCATE(JOB:IN,TIMEOUT_S:IN)
DECL INT JOB
DECL REAL TIMEOUT_S
RETURN FETCH(JOB,TIMEOUT_S,FALSE)
ENDFCT

; The same, and of each target where the tool takes it; the sigmas are then the tool's.
GLOBAL DEFFCT BOOL EDGED_LOCATE_GRASPS(JOB:IN,TIMEOUT_S:IN)
DECL INT JOB
DECL REAL TIMEOUT_S
RETURN FETCH(JOB,TIMEOUT_S,TRUE)
ENDFCT

; Register the rig: at ten poses about the one where the robot stands, turned about the tip of $TOOL, which
; is in the middle of the board (a rig on the flange: where the cameras look). $BASE=$NULLFRAME.
GLOBAL DEFFCT BOOL EDGED_HAND_EYE(TIMEOUT_S:IN)
DECL REAL TIMEOUT_S
DECL FRAME CENTRE
DECL FRAME PLACE
WAIT SEC 0.0
CENTRE=$POS_ACT:{X 0.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}
SAY(@HAND_EYE_START@,TIMEOUT_S)
@WALK@
IF EDGED_ERROR==0 THEN
LIN CENTRE
WAIT SEC 0.0
SAY(@REGISTER_SOLVE@,TIMEOUT_S)
ENDIF
RETURN EDGED_ERROR==0
ENDFCT

; One pose; where the board is not seen it is left out.
DEF ED_STEP(PLACE:IN,TIMEOUT_S:IN)
DECL FRAME PLACE
DECL REAL TIMEOUT_S
IF EDGED_ERROR==0 THEN
LIN PLACE
WAIT SEC @SETTLE@
FLANGE=$POS_ACT:INV_POS($TOOL)
SAY(@REGISTER_ADD@,TIMEOUT_S)
IF (EDGED_ERROR==@NOT_SEEN@) OR (EDGED_ERROR==@SAME_PLACE@) THEN
EDGED_ERROR=0
ENDIF
ENDIF
END

; One command that has no pose for an answer, over a link of its own.
DEF SAY(KIND:IN,TIMEOUT_S:IN)
DECL INT KIND
DECL REAL TIMEOUT_S
DECL EKI_STATUS RET
EDGED_ERROR=@NO_LINK@
RET=EKI_INIT("edged")
IF RET.MSG_NO==0 THEN
RET=EKI_OPEN("edged")
IF RET.MSG_NO==0 THEN
ED_IS_OPEN=1
ED_TIMEOUT=TIMEOUT_S
ASK_FOR(KIND)
ED_HANG_UP()
ENDIF
RET=EKI_CLEAR("edged")
ENDIF
END

; A link of its own: nothing old can be waiting in it.
DEFFCT BOOL FETCH(JOB:IN,TIMEOUT_S:IN,HAS_GRASPS:IN)
DECL INT JOB
DECL REAL TIMEOUT_S
DECL BOOL HAS_GRASPS
DECL INT COMMAND
DECL INT IGNORED
DECL EKI_STATUS RET
EDGED_COUNT=0
EDGED_REMAINING=0
EDGED_ERROR=@NO_LINK@
RET=EKI_INIT("edged")
IF RET.MSG_NO<>0 THEN
RETURN FALSE
ENDIF
RET=EKI_OPEN("edged")
IF RET.MSG_NO==0 THEN
ED_IS_OPEN=1
ED_TIMEOUT=TIMEOUT_S
ED_JOB=JOB
; where the flange is: cameras on it see from there
WAIT SEC 0.0
FLANGE=$POS_ACT:INV_POS($TOOL)
ASK_FOR(1)
ED_COMMAND=ED_NUMBER
IF EDGED_ERROR==0 THEN
TAKE_PART(HAS_GRASPS)
WHILE (EDGED_ERROR==0) AND (EDGED_REMAINING>0) AND (EDGED_COUNT<@TARGETS@)
ASK_FOR(2)
IF EDGED_ERROR==0 THEN
TAKE_PART(HAS_GRASPS)
ENDIF
ENDWHILE
IF EDGED_ERROR==@NO_FURTHER@ THEN
EDGED_ERROR=0
ENDIF
; the result was taken: it is withdrawn. If this fails, the cell withdraws it by its age
IF EDGED_ERROR==0 THEN
ED_NUMBER=ED_COMMAND
ED_KIND=3
ED_TIMEOUT=1.0
ED_ASK()
EDGED_ERROR=0
ENDIF
ENDIF
ED_HANG_UP()
ENDIF
RET=EKI_CLEAR("edged")
IF EDGED_ERROR<>0 THEN
EDGED_COUNT=0
ENDIF
RETURN EDGED_ERROR==0
ENDFCT

; 1 LOCATE, 2 NEXT, 3 ACK, 4 GRASP, 5 APPROACH, others as COMMAND; with a number of its own.
DEF ASK_FOR(KIND:IN)
DECL INT KIND
ED_NEXT_NUMBER()
ED_KIND=KIND
ED_ASK()
END

; What was answered, and perhaps its grasp. EDGED_ERROR says what is wrong with that.
DEF TAKE_PART(HAS_GRASPS:IN)
DECL BOOL HAS_GRASPS
EDGED_COUNT=EDGED_COUNT+1
EDGED_REMAINING=FIELD[@REMAINING@]
TAKE_POSE()
EDGED_PART[EDGED_COUNT]=POSE
IF HAS_GRASPS THEN
ASK_FOR(4)
IF EDGED_ERROR==0 THEN
TAKE_POSE()
EDGED_GRASP[EDGED_COUNT]=POSE
ASK_FOR(5)
IF EDGED_ERROR==0 THEN
TAKE_POSE()
EDGED_APPROACH[EDGED_COUNT]=POSE
ENDIF
ENDIF
ENDIF
END

; The numbers of an answer: its pose, and how good and how old the first target is.
DEF TAKE_POSE()
POSE.X=FIELD[@X@]
POSE.Y=FIELD[@Y@]
POSE.Z=FIELD[@Z@]
POSE.A=FIELD[@A@]
POSE.B=FIELD[@B@]
POSE.C=FIELD[@C@]
IF EDGED_COUNT==1 THEN
EDGED_AGE=FIELD[@AGE@]
EDGED_SIGMA[1]=FIELD[@SIGMA_X@]
EDGED_SIGMA[2]=FIELD[@SIGMA_Y@]
EDGED_SIGMA[3]=FIELD[@SIGMA_Z@]
ENDIF
END

DEF ED_SEND()
DECL INT I
DECL INT AT
DECL CHAR REQUEST[@REQUEST@]
DECL CHAR MAKER[16]
DECL CHAR WORD[16]
DECL EKI_STATUS RET
FOR I=1 TO @REQUEST@
REQUEST[I]=" "
ENDFOR
AT=0
MAKER[]="@BRAND@,"
PUT_WORD(REQUEST[],AT,MAKER[])
PUT_NUMBER(REQUEST[],AT,ED_NUMBER)
IF ED_KIND==1 THEN
WORD[]=",LOCATE,"
PUT_WORD(REQUEST[],AT,WORD[])
PUT_NUMBER(REQUEST[],AT,ED_JOB)
ENDIF
IF ED_KIND==2 THEN
WORD[]=",NEXT"
PUT_WORD(REQUEST[],AT,WORD[])
ENDIF
IF ED_KIND==3 THEN
WORD[]=",ACK"
PUT_WORD(REQUEST[],AT,WORD[])
ENDIF
IF ED_KIND==4 THEN
WORD[]=",GRASP"
PUT_WORD(REQUEST[],AT,WORD[])
ENDIF
IF ED_KIND==5 THEN
WORD[]=",APPROACH"
PUT_WORD(REQUEST[],AT,WORD[])
ENDIF
IF ED_KIND==@HAND_EYE_START@ THEN
WORD[]=",HAND_EYE_START"
PUT_WORD(REQUEST[],AT,WORD[])
ENDIF
IF ED_KIND==@REGISTER_SOLVE@ THEN
WORD[]=",REGISTER_SOLVE"
PUT_WORD(REQUEST[],AT,WORD[])
ENDIF
IF ED_KIND==@REGISTER_ADD@ THEN
WORD[]=",REGISTER_ADD,0"
PUT_WORD(REQUEST[],AT,WORD[])
ENDIF
IF (ED_KIND==1) OR (ED_KIND==@REGISTER_ADD@) THEN
PUT_REAL(REQUEST[],AT,FLANGE.X)
PUT_REAL(REQUEST[],AT,FLANGE.Y)
PUT_REAL(REQUEST[],AT,FLANGE.Z)
PUT_REAL(REQUEST[],AT,FLANGE.A)
PUT_REAL(REQUEST[],AT,FLANGE.B)
PUT_REAL(REQUEST[],AT,FLANGE.C)
ENDIF
; EthernetKRL 2.2 has no third argument: leave it out there
RET=EKI_SEND("edged",REQUEST[],@REQUEST@)
IF RET.MSG_NO<>0 THEN
EDGED_ERROR=@NO_LINK@
ENDIF
END

; A whole line and a blank, which stands for its end.
DEF ED_RECEIVE()
DECL INT I
DECL EKI_STATUS RET
ED_N_BYTES=0
RET=EKI_CHECKBUFFER("edged","Line")
IF (RET.BUFF==0) AND (NOT $FLAG[@FLAG@]) THEN
ED_N_BYTES=-1
ENDIF
IF RET.BUFF>1 THEN
ED_N_BYTES=-2
ENDIF
IF RET.BUFF==1 THEN
FOR I=1 TO 256
ED_LINE[I]=" "
ENDFOR
RET=EKI_GETSTRING("edged","Line",ED_LINE[])
ED_N_BYTES=-2
I=1
WHILE (ED_N_BYTES==-2) AND (I<=256)
IF ED_LINE[I]==" " THEN
ED_N_BYTES=I
ENDIF
I=I+1
ENDWHILE
IF RET.MSG_NO<>0 THEN
ED_N_BYTES=-1
ENDIF
ENDIF
END

DEFFCT INT CODE_OF(MARK:IN)
DECL CHAR MARK
DECL INT D
DECL CHAR DIGITS[10]
DIGITS[]="0123456789"
FOR D=1 TO 10
IF MARK==DIGITS[D] THEN
RETURN 47+D
ENDIF
ENDFOR
IF MARK=="-" THEN
RETURN 45
ENDIF
IF MARK=="." THEN
RETURN 46
ENDIF
IF MARK=="," THEN
RETURN 44
ENDIF
IF MARK==" " THEN
RETURN 10
ENDIF
RETURN 0
ENDFCT

DEF ED_HANG_UP()
DECL EKI_STATUS RET
IF $FLAG[@FLAG@] THEN
RET=EKI_CLOSE("edged")
ENDIF
ED_IS_OPEN=0
END

DEF ED_START_CLOCK()
ED_ELAPSED=0.0
END

DEF ED_READ_CLOCK()
END

DEF ED_PAUSE()
WAIT SEC 0.012
ED_ELAPSED=ED_ELAPSED+0.012
END

DEF PUT_WORD(TEXT[]:OUT,AT:OUT,WORD[]:OUT)
DECL CHAR TEXT[]
DECL INT AT
DECL CHAR WORD[]
DECL INT I
FOR I=1 TO STRLEN(WORD[])
AT=AT+1
TEXT[AT]=WORD[I]
ENDFOR
END

; A comma and a number: ten thousandths, and that they are it.
DEF PUT_REAL(TEXT[]:OUT,AT:OUT,NUMBER:IN)
DECL CHAR TEXT[]
DECL INT AT
DECL REAL NUMBER
DECL INT PARTS
DECL CHAR WORD[4]
AT=AT+1
TEXT[AT]=","
PARTS=NUMBER*10000.0
IF PARTS<0 THEN
AT=AT+1
TEXT[AT]="-"
PARTS=-PARTS
ENDIF
PUT_NUMBER(TEXT[],AT,PARTS)
WORD[]="E-4"
PUT_WORD(TEXT[],AT,WORD[])
END

DEF PUT_NUMBER(TEXT[]:OUT,AT:OUT,NUMBER:IN)
DECL CHAR TEXT[]
DECL INT AT
DECL INT NUMBER
DECL CHAR DIGITS[10]
DECL INT WEIGHT
DECL INT DIGIT
DECL INT REST
DIGITS[]="0123456789"
WEIGHT=1
WHILE NUMBER/WEIGHT>=10
WEIGHT=WEIGHT*10
ENDWHILE
REST=NUMBER
WHILE WEIGHT>=1
DIGIT=REST/WEIGHT
REST=REST-DIGIT*WEIGHT
AT=AT+1
TEXT[AT]=DIGITS[DIGIT+1]
WEIGHT=WEIGHT/10
ENDWHILE
END
"""
FLAG = 900
"""That says whether the link is there; one that nothing else uses."""


REALS = ("timeout", "elapsed", "scale", "value")
"""Of the skeleton's numbers; the others are whole, and their quotients would be."""
UNUSED = ("error", "remaining", "age", "sigma_x", "sigma_y", "sigma_z")
ROUTINES = ("next_number", "ask", "new_field", "take_code", "take_field")
DIALECT = Dialect(
    brand=Brand.KUKA,
    variable=lambda name: f"EDGED_{name.upper()}" if name in UNUSED else f"ED_{name.upper()}",
    request="",
    routine=lambda name: f"ED_{name.upper()}",
    called="{}()",
    statements={
        "if": "IF {} THEN",
        "else": "ELSE",
        "end if": "ENDIF",
        "while": "WHILE {}",
        "end while": "ENDWHILE",
    },
    to_text="",
    code="CODE_OF(ED_LINE[ED_INDEX])",
    element="FIELD[{}]",
    pose=("",) * 6,
    operators={"and": "AND"},
    assigned="{}={}",
)


def krl_files() -> dict[str, str]:
    """Files by name: the module's source and data, and the configuration of its link."""
    numbers = [name for name in NUMBERS if name not in UNUSED]
    declared = (f"DECL {'REAL' if name in REALS else 'INT'} {DIALECT.variable(name)}=0" for name in numbers)
    walk = steps(
        lambda x, y, z, rx, ry, rz: (
            f"PLACE=CENTRE:{{X {x}.0,Y {y}.0,Z {z}.0,A {rz}.0,B {ry}.0,C {rx}.0}}\nED_STEP(PLACE,TIMEOUT_S)"
        )
    )
    values: dict[str, object] = {
        **CODES,
        "WALK": walk,
        "FLAG": FLAG,
        "TARGETS": ADVANCE,
        "REQUEST": REQUEST_BYTES,
        "NO_FURTHER": int(LineStatus.NO_FURTHER),
        "STATUSES": statuses(";   "),
        "NUMBERS": "\n".join(declared),
    }
    made = routines(DIALECT)
    names = map(DIALECT.routine, ROUTINES)
    shared = "".join("\n".join(["", f"DEF {name}()", *made[name], "END", ""]) for name in names)
    files = {"edged.src": SOURCE + shared, "edged.dat": DATA, "edged.xml": CONFIGURATION}
    return {name: filled(text, Brand.KUKA, first=1, **values) for name, text in files.items()}
