r"""The robot's side in RAPID, for ABB controllers with sockets (IRC5: option 616-1 "PC Interface"; OmniCore).

From the "Technical reference manual: RAPID Instructions, Functions and Data types" (3HAC050917, 3HAC065038):

* `string`: at most 80 characters. An answer has more, so it is received as bytes (`SocketReceive \Data`, at
  most 1024) and read field by field.
* `SocketReceive`: what has arrived until now, which may be half an answer or two; `\Time` is 60 s unless
  given. ERR_SOCK_TIMEOUT and ERR_SOCK_CLOSED go to the ERROR handler of the routine that called it.
* `SocketSend \Str` adds no end of line; "\0A" is a line feed (data type `string`: a character as two
  hexadecimal digits).
* `orient`: q1 is the scalar; the sum of the squares must be 1, which six decimals are not: `NOrient`.
* `num` holds 23 bits and a sign exactly: 0.0001 mm at 1 m.
* `RelTool`: a displacement in the active tool's frame, and turns about its x, its new y and its new z.
  `CRobT`: where the robot stands now; `WaitTime \InPos` waits until it stands still. A `tooldata` that moves
  the robot is a persistent: so is the parameter.
"""

from __future__ import annotations

from edged.robot.orientations import Brand
from edged.robots.robotlines import filled, statuses
from edged.robots.walk import CODES, steps

MODULE = r"""MODULE EDGED
  ! edged: written by `edged registers --format rapid`.
  ! Needs [modbus.socket] in the cell's configuration.
  !
  !   VAR pose part;
  !   IF EdgedLocate(0, 5, part) THEN          ! job 0: the active one; seconds
  !     pick.trans:=part.trans;                ! mm, in the frame that the rig was registered to
  !     pick.rot:=part.rot;
  !     MoveL RelTool(pick,0,0,-100),v200,fine,tool1\WObj:=wobj0;
  !   ENDIF
  !   EdgedAcknowledge;
  !
  ! Move only when EdgedLocate or EdgedNext is TRUE. Otherwise edged_error says why:
@STATUSES@

  PERS string edged_ip:="192.168.10.20";
  PERS num edged_port:=@PORT@;
  VAR num edged_error:=0;
  VAR num edged_remaining:=0;  ! targets that EdgedNext can still give
  VAR pos edged_sigma;         ! mm; -1: not known
  VAR num edged_age:=-1;       ! seconds since the exposure
  LOCAL VAR socketdev edged_socket;
  LOCAL VAR clock edged_clock;
  LOCAL VAR byte edged_data{1024};
  LOCAL VAR num edged_field{@FIELDS@};
  LOCAL VAR num edged_sequence:=0;
  LOCAL VAR num edged_command:=0;
  LOCAL VAR string edged_place:="";

  ! Measure. TRUE: part is the pose of the part.
  FUNC bool EdgedLocate(num job,num timeout_s,INOUT pose part)
    edged_remaining:=0;
    edged_sequence:=edged_sequence MOD 65535+1;
    edged_command:=edged_sequence;
    EdgedSayPlace;
    IF EdgedAsk("LOCATE,"+NumToStr(job,0),edged_sequence,timeout_s,TRUE) THEN
      EdgedTake part;
      RETURN TRUE;
    ENDIF
    RETURN FALSE;
  ENDFUNC

  ! The next target of the same picture.
  FUNC bool EdgedNext(num timeout_s,INOUT pose part)
    edged_sequence:=edged_sequence MOD 65535+1;
    IF EdgedAsk("NEXT",edged_sequence,timeout_s,FALSE) THEN
      EdgedTake part;
      RETURN TRUE;
    ENDIF
    edged_remaining:=0;
    RETURN FALSE;
  ENDFUNC

  ! Where the tool takes the part that was given last, and from where it comes; edged_error 119: nowhere.
  FUNC bool EdgedGrasp(num timeout_s,INOUT pose grasp,INOUT pose approach)
    edged_sequence:=edged_sequence MOD 65535+1;
    IF EdgedAsk("GRASP",edged_sequence,timeout_s,FALSE) THEN
      EdgedTake grasp;
      edged_sequence:=edged_sequence MOD 65535+1;
      IF EdgedAsk("APPROACH",edged_sequence,timeout_s,FALSE) THEN
        EdgedTake approach;
        RETURN TRUE;
      ENDIF
    ENDIF
    RETURN FALSE;
  ENDFUNC

  ! The part was used: it is withdrawn. After the last one the link is closed.
  PROC EdgedAcknowledge()
    VAR bool is_done;
    is_done:=EdgedAsk("ACK",edged_command,2,FALSE);
    IF edged_remaining=0 THEN
      SocketClose edged_socket;
    ENDIF
  ENDPROC

  ! Any other command: "GRAB,0", "VERIFY,0", "CHANGE_JOB,2".
  FUNC bool EdgedDo(string request,num timeout_s)
    edged_sequence:=edged_sequence MOD 65535+1;
    edged_command:=edged_sequence;
    RETURN EdgedAsk(request,edged_sequence,timeout_s,TRUE);
  ENDFUNC

  ! Register the rig: at ten poses about the one where the robot stands, turned about the tip of the tool,
  ! which is in the middle of the board (a rig on the flange: where the cameras look). edged_error 0: it is.
  PROC EdgedHandEye(num timeout_s,PERS tooldata tool)
    VAR robtarget centre;
    VAR bool is_done;
    centre:=CRobT(\Tool:=tool\WObj:=wobj0);
    is_done:=EdgedDo("HAND_EYE_START",timeout_s);
@WALK@
    IF edged_error=0 THEN
      MoveL centre,v100,fine,tool\WObj:=wobj0;
      is_done:=EdgedDo("REGISTER_SOLVE",timeout_s);
    ENDIF
    SocketClose edged_socket;
  ENDPROC

  ! Where the flange is goes with the next request: cameras on it see from there.
  LOCAL PROC EdgedSayPlace()
    VAR robtarget flange;
    flange:=CRobT(\Tool:=tool0\WObj:=wobj0);
    edged_place:=","+NumToStr(flange.trans.x,3)+","+NumToStr(flange.trans.y,3)+","+NumToStr(flange.trans.z,3);
    edged_place:=edged_place+","+NumToStr(flange.rot.q1,6)+","+NumToStr(flange.rot.q2,6);
    edged_place:=edged_place+","+NumToStr(flange.rot.q3,6)+","+NumToStr(flange.rot.q4,6);
  ENDPROC

  ! One pose; where the board is not seen it is left out.
  LOCAL PROC EdgedStep(robtarget place,num timeout_s,PERS tooldata tool)
    VAR bool is_done;
    IF edged_error=0 THEN
      MoveL place,v100,fine,tool\WObj:=wobj0;
      WaitTime \InPos,@SETTLE@;
      EdgedSayPlace;
      is_done:=EdgedDo("REGISTER_ADD,0",timeout_s);
      IF edged_error=@NOT_SEEN@ OR edged_error=@SAME_PLACE@ THEN
        edged_error:=0;
      ENDIF
    ENDIF
  ENDPROC

  LOCAL PROC EdgedTake(INOUT pose part)
    part.trans.x:=edged_field{@X@};
    part.trans.y:=edged_field{@Y@};
    part.trans.z:=edged_field{@Z@};
    part.rot.q1:=edged_field{@Q1@};
    part.rot.q2:=edged_field{@Q2@};
    part.rot.q3:=edged_field{@Q3@};
    part.rot.q4:=edged_field{@Q4@};
    part.rot:=NOrient(part.rot);
    edged_remaining:=edged_field{@REMAINING@};
    edged_sigma.x:=edged_field{@SIGMA_X@};
    edged_sigma.y:=edged_field{@SIGMA_Y@};
    edged_sigma.z:=edged_field{@SIGMA_Z@};
    edged_age:=edged_field{@AGE@};
  ENDPROC

  ! One request and its answer. A command begins with a link of its own: nothing old can be waiting in it.
  LOCAL FUNC bool EdgedAsk(string request,num sequence,num timeout_s,bool is_command)
    VAR num left_s;
    VAR num count;
    VAR num fields:=0;
    VAR string text:="";
    VAR string place;
    VAR bool is_whole:=FALSE;
    place:=edged_place;
    edged_place:="";
    edged_error:=0;
    ClkStop edged_clock;
    ClkReset edged_clock;
    ClkStart edged_clock;
    IF is_command THEN
      SocketClose edged_socket;
      SocketCreate edged_socket;
      SocketConnect edged_socket,edged_ip,edged_port\Time:=timeout_s;
    ENDIF
    SocketSend edged_socket\Str:="@BRAND@,"+NumToStr(sequence,0)+","+request;
    SocketSend edged_socket\Str:=place+"\0A";
    WHILE NOT is_whole DO
      left_s:=timeout_s-ClkRead(edged_clock);
      IF left_s<=0 THEN
        RETURN EdgedFailed(@LATE@);
      ENDIF
      SocketReceive edged_socket\Data:=edged_data\NoRecBytes:=count\Time:=left_s;
      FOR i FROM 1 TO count DO
        IF is_whole THEN
          RETURN EdgedFailed(@NO_ANSWER@);
        ENDIF
        IF edged_data{i}=10 OR edged_data{i}=44 THEN
          fields:=fields+1;
          IF fields>@FIELDS@ THEN
            RETURN EdgedFailed(@NO_ANSWER@);
          ENDIF
          IF NOT StrToVal(text,edged_field{fields}) THEN
            RETURN EdgedFailed(@NO_ANSWER@);
          ENDIF
          text:="";
          is_whole:=(edged_data{i}=10);
        ELSE
          IF StrLen(text)>30 THEN
            RETURN EdgedFailed(@NO_ANSWER@);
          ENDIF
          text:=text+ByteToStr(edged_data{i}\Char);
        ENDIF
      ENDFOR
    ENDWHILE
    IF fields<>@FIELDS@ THEN
      RETURN EdgedFailed(@NO_ANSWER@);
    ENDIF
    IF edged_field{@STATUS@}<>0 THEN
      edged_error:=edged_field{@STATUS@};
      RETURN FALSE;
    ENDIF
    IF edged_field{@SEQUENCE@}<>sequence THEN
      RETURN EdgedFailed(@OTHERS@);
    ENDIF
    RETURN TRUE;
  ERROR
    IF ERRNO=ERR_SOCK_TIMEOUT THEN
      RETURN EdgedFailed(@LATE@);
    ENDIF
    RETURN EdgedFailed(@NO_LINK@);
  ENDFUNC

  ! Whatever comes after a failure is not heard: the link is closed.
  LOCAL FUNC bool EdgedFailed(num reason)
    edged_error:=reason;
    SocketClose edged_socket;
    RETURN FALSE;
  ENDFUNC
ENDMODULE
"""


def rapid_source() -> str:
    """A module to load, as text."""
    walk = steps(
        lambda x, y, z, rx, ry, rz: (
            f"    EdgedStep RelTool(centre,{x},{y},{z}\\Rx:={rx}\\Ry:={ry}\\Rz:={rz}),timeout_s,tool;"
        )
    )
    return filled(MODULE, Brand.ABB, first=1, STATUSES=statuses("  !   "), WALK=walk, **CODES)
