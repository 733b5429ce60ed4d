"""The robot's side in KAREL, called from TP, for FANUC controllers with R632 and R648.

From the "KAREL Reference Manual" (MARRC75KR07091E) and the "Ethernet Function Operator's Manual" (B-82974EN):

* Chapter "Socket Messaging": a client tag C1: to C8: is set up in SETUP > Host Comm (protocol SM),
  `MSG_CONNECT` connects it, the tag is opened like a file with the attribute ATR_IA; `MSG_DISCO` hangs up.
  How long `MSG_CONNECT` tries is the controller's affair.
* Chapter "File input/output operations": `READ` of a string ends at an end of line, which is not part of it.
  So an answer is whole with the sixth decimal of its last number, whether the line feed is seen or not.
* `BYTES_AHEAD` counts what has arrived; a `READ` of more would wait for ever.
* STRING: at most 254 characters (128 on old controllers): an answer is read in pieces of 100.
* `CNV_INT_STR` puts a blank before the number; the cell ignores it.
* Words and limits of names: `grammars/karel.toml`. INTEGER has 32 bits, REAL 24 of them.
* Variables keep their values between calls, until the program is loaded anew: then they are uninitialised.
* A file that a program opened is closed when the task ends: hence every target is fetched in one call.
* `CURPOS` is in the user and tool frame that the TP program has set; with UTOOL_NUM=0 it is the flange's.
  `$MNUTOOLNUM[1]` and `$MNUFRAMENUM[1]` are the numbers of group 1.
* `CURPOS` gives a position with the configuration that the arm has now; W, P, R are degrees about fixed axes.
* A listing of the teach pendant has negative constants in parentheses: `grammars/tp.toml`.
"""

from __future__ import annotations

from edged.plc.lines import LineStatus
from edged.robot.orientations import Brand
from edged.robots.robotlines import filled, statuses
from edged.robots.walk import CODES, steps

KAREL = """\
PROGRAM edged
-- edged: written by `edged registers --format karel`. Translate it with ROBOGUIDE or ktrans (V7.70 or later).
-- Needs [modbus.socket] in the cell's configuration, and the client tag C3:
--
--   CALL EDGED(0,5000,81,81,1)
--     job (0: the active one), ms to wait, first R, first PR, how many PR may be written
--   R[81] 0: PR[81] is the pose of the part, and may be used; anything else: do not move
--   R[82] how many PR were written        R[83] how many more were found
--   R[84] seconds since the exposure      R[85] R[86] R[87] sigma of X, Y, Z in mm (-1: not known)
--   CALL EDGED(0,5000,81,81,1,91,92)
--     the same, and of each part where the tool takes it (from PR[91] on) and from where it comes (from
--     PR[92] on); the sigmas are then the tool's
--   CALL EDGED((-@HAND_EYE_START@),5000,81,81,0) and so on register the rig: EDGEDREG does it
-- Cameras that the robot carries see from the flange: UTOOL_NUM=0, UFRAME_NUM=0 before the call.
-- PR are in the frame that the rig was registered to: normally UFRAME 0.
-- R[81] is, beside 0:
@STATUSES@
%COMMENT = 'edged'
%STACKSIZE = 4000
%NOLOCKGROUP
CONST
  tag = 'C3:'
  n_fields = @FIELDS@
VAR
  link : FILE
  sequence : INTEGER
  count : INTEGER
  field : ARRAY[@FIELDS@] OF REAL
  is_whole : BOOLEAN
  whole : INTEGER
  part : INTEGER
  scale : REAL
  w_digits : INTEGER
  p_digits : INTEGER
  is_minus : BOOLEAN
  has_point : BOOLEAN
  first_r : INTEGER
  grasp_pr : INTEGER
  approach_pr : INTEGER
  place : STRING[128]

ROUTINE new_number
BEGIN
  whole = 0
  part = 0
  scale = 1.0
  w_digits = 0
  p_digits = 0
  is_minus = FALSE
  has_point = FALSE
END new_number

ROUTINE take_number
BEGIN
  count = count + 1
  field[count] = whole + part / scale
  IF is_minus THEN
    field[count] = -field[count]
  ENDIF
  new_number
END take_number

-- One character of an answer. FALSE: this is no answer.
ROUTINE take_char(code : INTEGER) : BOOLEAN
BEGIN
  IF is_whole THEN
    RETURN((code = 10) OR (code = 13) OR (code = 32))
  ENDIF
  IF (code >= 48) AND (code <= 57) THEN
    IF has_point THEN
      p_digits = p_digits + 1
      part = part * 10 + code - 48
      scale = scale * 10
      IF p_digits = 6 THEN
        IF count = n_fields - 1 THEN
          take_number
          is_whole = TRUE
        ENDIF
      ENDIF
      RETURN(p_digits <= 6)
    ENDIF
    w_digits = w_digits + 1
    IF w_digits > 9 THEN
      RETURN(FALSE)
    ENDIF
    whole = whole * 10 + code - 48
    RETURN(TRUE)
  ENDIF
  IF code = 45 THEN
    IF is_minus OR has_point OR (w_digits > 0) THEN
      RETURN(FALSE)
    ENDIF
    is_minus = TRUE
    RETURN(TRUE)
  ENDIF
  IF w_digits = 0 THEN
    RETURN(FALSE)
  ENDIF
  IF code = 46 THEN
    IF has_point THEN
      RETURN(FALSE)
    ENDIF
    has_point = TRUE
    RETURN(TRUE)
  ENDIF
  IF (code <> 44) OR (count >= n_fields - 1) THEN
    RETURN(FALSE)
  ENDIF
  IF has_point AND (p_digits < 6) THEN
    RETURN(FALSE)
  ENDIF
  take_number
  RETURN(TRUE)
END take_char

-- One request and its answer. 0: it is ours, and says so.
ROUTINE ask(request : STRING; number : INTEGER; wait_ms : INTEGER) : INTEGER
VAR
  i : INTEGER
  n_bytes : INTEGER
  status : INTEGER
  waited : INTEGER
  data : STRING[128]
  text : STRING[128]
BEGIN
  CNV_INT_STR(number, 1, 0, text)
  text = '@BRAND@,' + text + ',' + request + CHR(10)
  WRITE link (text)
  IF IO_STATUS(link) <> 0 THEN
    RETURN(@NO_LINK@)
  ENDIF
  count = 0
  is_whole = FALSE
  new_number
  waited = 0
  WHILE NOT is_whole DO
    BYTES_AHEAD(link, n_bytes, status)
    IF status <> 0 THEN
      RETURN(@NO_LINK@)
    ENDIF
    IF n_bytes = 0 THEN
      IF waited >= wait_ms THEN
        RETURN(@LATE@)
      ENDIF
      DELAY 10
      waited = waited + 10
    ELSE
      IF n_bytes > 100 THEN
        n_bytes = 100
      ENDIF
      data = ''
      READ link (data::n_bytes)
      IF IO_STATUS(link) <> 0 THEN
        RETURN(@NO_LINK@)
      ENDIF
      IF STR_LEN(data) = 0 THEN
        waited = waited + 10
        IF waited >= wait_ms THEN
          RETURN(@LATE@)
        ENDIF
      ENDIF
      FOR i = 1 TO STR_LEN(data) DO
        IF NOT take_char(ORD(data, i)) THEN
          RETURN(@NO_ANSWER@)
        ENDIF
      ENDFOR
    ENDIF
  ENDWHILE
  IF field[@STATUS@] <> 0 THEN
    RETURN(ROUND(field[@STATUS@]))
  ENDIF
  IF ROUND(field[@SEQUENCE@]) <> number THEN
    RETURN(@OTHERS@)
  ENDIF
  RETURN(0)
END ask

ROUTINE next_number
BEGIN
  sequence = sequence + 1
  IF sequence > 65535 THEN
    sequence = 1
  ENDIF
END next_number

-- The pose of an answer.
ROUTINE put_pose(pr_number : INTEGER) : INTEGER
VAR
  pose : XYZWPR
  status : INTEGER
BEGIN
  pose = CURPOS(0, 0)
  pose.x = field[@X@]
  pose.y = field[@Y@]
  pose.z = field[@Z@]
  pose.w = field[@A@]
  pose.p = field[@B@]
  pose.r = field[@C@]
  SET_POS_REG(pr_number, pose, status)
  IF status <> 0 THEN
    RETURN(@NO_REGISTER@)
  ENDIF
  RETURN(0)
END put_pose

-- How good and how old what an answer says is.
ROUTINE put_quality
VAR
  status : INTEGER
BEGIN
  SET_REAL_REG(first_r + 3, field[@AGE@], status)
  SET_REAL_REG(first_r + 4, field[@SIGMA_X@], status)
  SET_REAL_REG(first_r + 5, field[@SIGMA_Y@], status)
  SET_REAL_REG(first_r + 6, field[@SIGMA_Z@], status)
END put_quality

-- Where the tool takes the part that was given last, and from where it comes; i : of the part, from 0.
ROUTINE put_grasp(i : INTEGER; wait_ms : INTEGER) : INTEGER
VAR
  result : INTEGER
BEGIN
  next_number
  result = ask('GRASP', sequence, wait_ms)
  IF result = 0 THEN
    result = put_pose(grasp_pr + i)
  ENDIF
  IF result = 0 THEN
    next_number
    result = ask('APPROACH', sequence, wait_ms)
  ENDIF
  IF result = 0 THEN
    result = put_pose(approach_pr + i)
  ENDIF
  RETURN(result)
END put_grasp

-- A number as ten thousandths; together they are the pose of a request.
ROUTINE add_number(value : REAL)
VAR
  text : STRING[40]
BEGIN
  CNV_INT_STR(ROUND(value * 10000), 1, 0, text)
  place = place + ',' + text + 'E-4'
END add_number

-- Where the flange is, for cameras on it: CURPOS says so while no tool and no user frame is active.
ROUTINE add_flange
VAR
  pose : XYZWPR
BEGIN
  IF ($MNUTOOLNUM[1] = 0) AND ($MNUFRAMENUM[1] = 0) THEN
    pose = CURPOS(0, 0)
    add_number(pose.x)
    add_number(pose.y)
    add_number(pose.z)
    add_number(pose.w)
    add_number(pose.p)
    add_number(pose.r)
  ENDIF
END add_flange

-- Measure, fetch the targets, acknowledge. Returns what R[first_r] becomes.
ROUTINE locate(job : INTEGER; wait_ms : INTEGER; first_pr : INTEGER; n_pr : INTEGER) : INTEGER
VAR
  locate_no : INTEGER
  result : INTEGER
  status : INTEGER
  taken : INTEGER
  more : INTEGER
  text : STRING[40]
BEGIN
  next_number
  locate_no = sequence
  CNV_INT_STR(job, 1, 0, text)
  place = 'LOCATE,' + text
  add_flange
  result = ask(place, locate_no, wait_ms)
  taken = 0
  more = 1
  WHILE (result = 0) AND (more > 0) DO
    more = ROUND(field[@REMAINING@])
    result = put_pose(first_pr + taken)
    IF (result = 0) AND (grasp_pr > 0) THEN
      result = put_grasp(taken, wait_ms)
    ENDIF
    IF result = 0 THEN
      IF taken = 0 THEN
        put_quality
      ENDIF
      taken = taken + 1
      SET_INT_REG(first_r + 1, taken, status)
      SET_INT_REG(first_r + 2, more, status)
      IF taken >= n_pr THEN
        more = 0
      ENDIF
      IF more > 0 THEN
        next_number
        result = ask('NEXT', sequence, wait_ms)
        IF result = @NO_FURTHER@ THEN
          result = 0
          more = 0
        ENDIF
      ENDIF
    ENDIF
  ENDWHILE
  IF result <> 0 THEN
    RETURN(result)
  ENDIF
  -- the result was taken: it is withdrawn. If this fails, the cell withdraws it by its age
  status = ask('ACK', locate_no, 1000)
  RETURN(0)
END locate

-- A command of a registration, with the pose of the flange where it needs one (UTOOL_NUM=0).
ROUTINE registered(kind : INTEGER; wait_ms : INTEGER) : INTEGER
VAR
  result : INTEGER
  status : INTEGER
BEGIN
  next_number
  place = 'REGISTER_SOLVE'
  IF kind = @HAND_EYE_START@ THEN
    place = 'HAND_EYE_START'
  ENDIF
  IF kind = @REGISTER_ADD@ THEN
    place = 'REGISTER_ADD,0'
    add_flange
  ENDIF
  result = ask(place, sequence, wait_ms)
  IF result = 0 THEN
    SET_INT_REG(first_r + 1, ROUND(field[@REMAINING@]), status)
    SET_REAL_REG(first_r + 3, field[@Y@], status)
  ENDIF
  RETURN(result)
END registered

-- An argument of the call; -1: it has none.
ROUTINE argument(number : INTEGER) : INTEGER
VAR
  kind : INTEGER
  int_value : INTEGER
  real_value : REAL
  str_value : STRING[40]
  status : INTEGER
BEGIN
  kind = 0
  GET_TPE_PRM(number, kind, int_value, real_value, str_value, status)
  IF (status <> 0) OR (kind <> 1) THEN
    RETURN(-1)
  ENDIF
  RETURN(int_value)
END argument

ROUTINE run_edged
VAR
  result : INTEGER
  status : INTEGER
BEGIN
  first_r = argument(3)
  -- until the end, and when this program is aborted, there is no pose
  SET_INT_REG(first_r, @LATE@, status)
  SET_INT_REG(first_r + 1, 0, status)
  SET_INT_REG(first_r + 2, 0, status)
  IF UNINIT(sequence) THEN
    sequence = 0
  ENDIF
  -- a link of its own: nothing old can be waiting in it
  MSG_DISCO(tag, status)
  SET_FILE_ATR(link, ATR_IA)
  MSG_CONNECT(tag, status)
  IF status = 0 THEN
    OPEN FILE link ('RW', tag)
    status = IO_STATUS(link)
  ENDIF
  IF status <> 0 THEN
    result = @NO_LINK@
  ELSE
    grasp_pr = argument(6)
    approach_pr = argument(7)
    result = argument(1)
    IF result < 0 THEN
      result = registered(-result, argument(2))
    ELSE
      result = locate(result, argument(2), argument(4), argument(5))
    ENDIF
    CLOSE FILE link
  ENDIF
  MSG_DISCO(tag, status)
  IF result <> 0 THEN
    SET_INT_REG(first_r + 1, 0, status)
  ENDIF
  SET_INT_REG(first_r, result, status)
END run_edged

BEGIN
  run_edged
END edged
"""
TEACH_PENDANT = """\
/PROG  EDGEPICK
/ATTR
COMMENT = "edged: one part";
DEFAULT_GROUP = 1,*,*,*,*;
/MN
   1:  !PR[80]: 0,0,(-100),0,0,0 ;
   2:  UFRAME_NUM=0 ;
   3:  UTOOL_NUM=0 ;
   4:  CALL EDGED(0,5000,81,81,1) ;
   5:  UTOOL_NUM=1 ;
   6:  IF R[81]<>0,JMP LBL[9] ;
   7:L PR[81] 100mm/sec FINE Tool_Offset,PR[80] ;
   8:  END ;
   9:  LBL[9] ;
  10:  UALM[1] ;
/POS
/END
"""
REGISTER = """\
/PROG  EDGEDREG
/ATTR
COMMENT = "edged: hand-eye";
DEFAULT_GROUP = 1,*,*,*,*;
/MN
@LINES@
/POS
/END
"""
"""Registers the rig: ten poses about the one where the robot stands, turned about the tip of tool 1."""
NO_REGISTER = 204
"""The position register could not be written."""


def karel_files() -> dict[str, str]:
    """Files by name: the program, and one on the teach pendant that calls it."""
    notes = statuses("--   ") + f"\n--   {NO_REGISTER} a PR that cannot be written"
    text = filled(
        KAREL,
        Brand.FANUC,
        first=1,
        STATUSES=notes,
        NO_REGISTER=NO_REGISTER,
        NO_FURTHER=int(LineStatus.NO_FURTHER),
        **CODES,
    )
    return {"edged.kl": text, "edgepick.ls": TEACH_PENDANT, "edgedreg.ls": _walk()}


def _walk() -> str:
    """R[81] is 0 at its end when the rig is registered; R[82] poses were taken, R[84] mm is how far off."""

    def call(command: str, milliseconds: int) -> str:
        return f"CALL EDGED((-@{command}@),{milliseconds},81,81,0) ;"

    def step(*numbers: int) -> str:
        places = [
            f"PR[91,{axis}]={number if number >= 0 else f'({number})'}"
            for axis, number in enumerate(numbers, 1)
        ]
        return "\n".join(
            [
                *(f"{place} ;" for place in places),
                "L PR[90] 50mm/sec FINE Tool_Offset,PR[91] ;",
                "WAIT @SETTLE@0(sec) ;",
                "UTOOL_NUM=0 ;",
                call("REGISTER_ADD", 10000),
                "UTOOL_NUM=1 ;",
                "IF R[81]<>0 AND R[81]<>@NOT_SEEN@ AND R[81]<>@SAME_PLACE@,JMP LBL[9] ;",
            ]
        )

    lines = [
        "UFRAME_NUM=0 ;",
        "UTOOL_NUM=1 ;",
        "PR[90]=LPOS ;",
        "PR[91]=PR[90] ;",
        call("HAND_EYE_START", 10000),
        "IF R[81]<>0,JMP LBL[9] ;",
        *steps(step).splitlines(),
        "L PR[90] 50mm/sec FINE ;",
        call("REGISTER_SOLVE", 10000),
        "IF R[81]<>0,JMP LBL[9] ;",
        "END ;",
        "LBL[9] ;",
        "UALM[1] ;",
    ]
    numbered = "\n".join(
        f"{number:4}:{line}" if line.startswith("L ") else f"{number:4}:  {line}"
        for number, line in enumerate(lines, 1)
    )
    return filled(REGISTER, Brand.FANUC, first=1, LINES=filled(numbered, Brand.FANUC, first=1, **CODES))
