"""The robot's side in AS, for Kawasaki's D, E and F controllers.

From the "AS Language Reference Manual" (90209-1014) and the manual "TCP/IP Communication" (90210-1190):

* `TCP_CONNECT` gives the number of a socket, or a negative error; `TCP_SEND` and `TCP_RECV` 0 or a negative
  error, -34024 after their time-out. Time-outs are whole seconds, from 1 on, and so are those of a locate.
* `TCP_RECV` fills an array of strings, each of at most 255 characters, with what has come until now: half an
  answer, or one and more. An answer has less than 255.
* Variables are global unless a point stands before their name (at most 15 characters), and undefined until
  they are written; REAL has 24 bits. `.REALS` gives them values when the file is loaded.
* `$ENCODE(/I6,n)` puts blanks before a number; the cell ignores them. `ASC` counts characters from 1.
* `HERE` is where the tip of `TOOL` is in `BASE`; `-` joins the inverse of a transformation: `HERE-TOOL` is
  the flange. `DECOMPOSE` puts the numbers of a transformation into an array. The functions HERE and TOOL in
  an expression are from memory.
* `UTIMER` counts seconds. `POINT` and `TRANS` make a pose of X, Y, Z, O, A, T.
"""

from __future__ import annotations

from edged.robot.orientations import Brand
from edged.robots.robotlines import filled, statuses
from edged.robots.skeleton import NUMBERS, Dialect, indented, routines

RECEIVE_TIMED_OUT = -34024
"""90210-1190, error codes."""
HEAD = """\
.PROGRAM edged_notes() ; edged
; Written by `edged registers --format as`.
; Needs [modbus.socket] in the cell's configuration; its address is in .REALS below.
;
;   CALL edged_locate(0,5)        ; job 0: the active one; seconds
;   IF ed_error == 0 THEN
;     LAPPRO ed_part,100          ; mm and degrees, in the frame that the rig was registered to
;     BREAK
;   END
;   CALL edged_ack
;
; edged_next(5): the next part of the same picture, ed_remaining says how many there are.
; edged_grasp(5): ed_grasp and ed_approach of the part that was given last.
; ed_sigma_x, ed_sigma_y, ed_sigma_z: mm, -1 is not known; ed_age: seconds.
; Near A = 0 or 180 only O + T or O - T means something: look at the position and the tilt, not at O or T.
; Move only while ed_error is 0. Otherwise it says why:
@STATUSES@
.END
.PROGRAM edged_locate(.job,.timeout)
  ed_job = .job
  ed_timeout = .timeout
  CALL ed_locate
.END
.PROGRAM edged_next(.timeout)
  ed_timeout = .timeout
  CALL ed_next
.END
.PROGRAM edged_grasp(.timeout)
  ed_timeout = .timeout
  CALL ed_grasp_poses
.END
.PROGRAM edged_ack()
  CALL ed_acknowledge
.END
.PROGRAM edged_do(.$request,.timeout)
  $ed_request = .$request
  ed_timeout = .timeout
  CALL ed_perform
.END
.PROGRAM ed_open_link()
  CALL ed_hang_up
  ed_error = 0
  TCP_CONNECT ed_socket,ed_port,ed_ip[1],3
  IF ed_socket >= 0 THEN
    ed_is_open = 1
  END
.END
.PROGRAM ed_add_place()
  POINT ed_flange = HERE-TOOL
  DECOMPOSE ed_place[1] = ed_flange
  $ed_request = $ed_request + "," + $ENCODE(/F12.4,ed_place[1])
  $ed_request = $ed_request + "," + $ENCODE(/F12.4,ed_place[2])
  $ed_request = $ed_request + "," + $ENCODE(/F12.4,ed_place[3])
  $ed_request = $ed_request + "," + $ENCODE(/F12.4,ed_place[4])
  $ed_request = $ed_request + "," + $ENCODE(/F12.4,ed_place[5])
  $ed_request = $ed_request + "," + $ENCODE(/F12.4,ed_place[6])
.END
.PROGRAM ed_hang_up()
  IF ed_is_open == 1 THEN
    TCP_CLOSE ed_return,ed_socket
  END
  ed_is_open = 0
.END
.PROGRAM ed_send()
  $ed_sent[1] = "@BRAND@," + $ENCODE(/I6,ed_number) + "," + $ed_request + $CHR(10)
  TCP_SEND ed_return,ed_socket,$ed_sent[1],1,3
  IF ed_return < 0 THEN
    ed_error = @NO_LINK@
  END
.END
.PROGRAM ed_receive()
  ed_n_bytes = -1
  ed_n_strings = 0
  TCP_RECV ed_return,ed_socket,$ed_heard[1],ed_n_strings,1,255
  IF ed_return == @TIMED_OUT@ THEN
    ed_n_bytes = 0
  END
  IF (ed_return >= 0) AND (ed_n_strings == 1) THEN
    IF LEN($ed_heard[1]) > 0 THEN
      ed_n_bytes = LEN($ed_heard[1])
    END
  END
  IF (ed_return >= 0) AND (ed_n_strings > 1) THEN
    ed_n_bytes = -2
  END
.END
.PROGRAM ed_start_clock()
  UTIMER @ed_clock = 0
.END
.PROGRAM ed_read_clock()
  ed_elapsed = UTIMER(@ed_clock)
.END
.PROGRAM ed_pause()
  TWAIT 0.01
.END
"""
REALS = """\
.REALS
ed_ip[1] = 192
ed_ip[2] = 168
ed_ip[3] = 10
ed_ip[4] = 20
ed_port = @PORT@
"""
DIALECT = Dialect(
    brand=Brand.KAWASAKI,
    variable=lambda name: f"ed_{name}",
    request="$ed_request",
    routine=lambda name: "ed_grasp_poses" if name == "grasp" else f"ed_{name}",
    called="CALL {}",
    statements={
        "if": "IF {} THEN",
        "else": "ELSE",
        "end if": "END",
        "while": "WHILE {} DO",
        "end while": "END",
    },
    to_text="$ENCODE(/I6,{})",
    code="ASC($ed_heard[1],ed_index)",
    element="ed_field[{}]",
    pose=tuple(f"ed_pose[{i}]" for i in range(1, 7)),
    posed="POINT ed_{name} = TRANS(" + ",".join(f"ed_pose[{i}]" for i in range(1, 7)) + ")",
    operators={"and": "AND"},
)


def as_source() -> str:
    """A file to load, as text."""
    text = filled(HEAD, Brand.KAWASAKI, first=1, STATUSES=statuses(";   "), TIMED_OUT=RECEIVE_TIMED_OUT)
    for name, lines in routines(DIALECT).items():
        body = indented(lines, "IF |WHILE ", "END$", "ELSE$")
        text += "\n".join([f".PROGRAM {name}()", *body, ".END"]) + "\n"
    known = [name for name in NUMBERS if name != "error"]
    reals = filled(REALS, Brand.KAWASAKI, first=1) + "".join(f"ed_{name} = 0\n" for name in known)
    return f"{text}{reals}ed_error = -1\n.END\n"
