r"""The robot's side for Yaskawa's DX200, YRC1000 and YRC1000micro: a MotoPlus task in C, and a job.

INFORM has no sockets; MotoPlus runs C beside the job. After public MotoPlus programs, among them
ROS-Industrial's driver (`simple_socket.h`: `mpSocket`, `mpConnect`, `mpSend`, `mpRecv`, `mpSelect`, which are
those of BSD), and from memory of the "INFORM II" and "MotoPlus" reference manuals, which were not at hand:

* `mpGetVarData`, `mpPutVarData` read and write the job's variables; they fail for some seconds after the
  controller was switched on, and are tried again.
* The job counts I085 up for each request and waits until the task says it back in I086. It alone writes I083:
  nothing that comes after its time-out can look like a result; the task sees another number and gives up.
* How long `mpConnect` waits is the controller's affair: the job's time-out holds all the same.
* `mpGetCartPosEx` says where the tip of a tool is in a frame (0: the base's), in the units of positions.
* The task writes numbers, the job makes the position: `GETS PX080 $PX001` is where the arm is, with its
  figure, and `SETE` changes X to Rz in 0.001 mm and 0.0001 degrees.
"""

from __future__ import annotations

from edged.plc.lines import answer_fields
from edged.robot.orientations import Brand
from edged.robots.robotlines import filled, statuses
from edged.robots.skeleton import NUMBERS, Dialect, indented, routines

HEAD = """\
/* edged: written by `edged registers --format motoplus`. A MotoPlus application; EDGED.JBI calls it.
 * Needs [modbus.socket] in the cell's configuration, whose address is here:
 */
#define ED_ADDRESS "192.168.10.20"
#define ED_PORT @PORT@
/* Where the robot carries the cameras: a tool file whose numbers are all 0, so that its tip is the flange. */
#define ED_FLANGE_TOOL (-1)
/*
 *   SET I080 1          1 LOCATE, 2 NEXT, 3 GRASP, 4 ACK, 5 CHANGE_JOB
 *   SET I081 0          job; 0: the active one
 *   SET I082 500        time-out in 10 ms
 *   CALL JOB:EDGED
 *   JUMP *FAIL IF I083<>0
 *   SET I080 3
 *   CALL JOB:EDGED
 *   JUMP *FAIL IF I083<>0
 *   MOVL P082 V=200.0   from where the tool comes, and then
 *   MOVL P081 V=50.0
 *
 * P080: the part; P081, P082: after GRASP where the tool takes it, and from where it comes; in the frame
 * that the rig was registered to. I084: how many more NEXT gives. D070 to D072: sigma of X, Y, Z in 0.1
 * micrometre, negative is not known; D073: age in ms. I080 to I089, D070 to D073, D080 to D097, P080 to P082
 * are the program's.
 * Move only while I083 is 0. Otherwise it says why:
@STATUSES@
 */
#include "motoPlus.h"

#define ED_HEARD 255

@DECLARED@
static double ed_field[@FIELDS@];
static double ed_part[6], ed_grasp[6], ed_approach[6];
static const char *ed_request = "";
static char ed_text[160];
static unsigned char ed_heard[ED_HEARD + 1];
static int ed_socket = -1;
static LONG ed_ticket = 0;
static int ed_waited = 0;

@PROTOTYPES@
static LONG ed_get(USHORT type, USHORT index)
{
    MP_VAR_INFO info;
    LONG value = 0;

    info.usType = type;
    info.usIndex = index;
    while (mpGetVarData(&info, &value, 1) != 0)
        mpTaskDelay(4);
    return value;
}

static void ed_put(USHORT type, USHORT index, LONG value)
{
    MP_VAR_DATA data;

    data.usType = type;
    data.usIndex = index;
    data.ulValue = value;
    while (mpPutVarData(&data, 1) != 0)
        mpTaskDelay(4);
}

static LONG ed_rounded(double value)
{
    return (LONG)(value < 0 ? value - 0.5 : value + 0.5);
}

static void ed_put_pose(USHORT index, const double *pose)
{
    int i;

    for (i = 0; i < 6; i++)
        ed_put(MP_RESTYPE_VAR_D, (USHORT)(index + i), ed_rounded(pose[i] * (i < 3 ? 1000.0 : 10000.0)));
}

static const char *ed_joined(const char *word, double number)
{
    sprintf(ed_text, "%s%d", word, (int)number);
    return ed_text;
}

/* Where the flange is: cameras on it see from there. */
static void ed_do_add_place(void)
{
    MP_CARTPOS_EX_SEND_DATA asked;
    MP_CART_POS_RSP_DATA_EX heard;
    int i;

    if (ED_FLANGE_TOOL < 0)
        return;
    asked.sRobotNo = 0;
    asked.sFrame = 0;
    asked.sToolNo = ED_FLANGE_TOOL;
    if (mpGetCartPosEx(&asked, &heard) != 0)
        return;
    for (i = 0; i < 6; i++)
        sprintf(ed_text + strlen(ed_text), ",%dE-%d", (int)heard.lPos[i], i < 3 ? 3 : 4);
}

static void ed_do_open_link(void)
{
    struct sockaddr_in address;

    ed_do_hang_up();
    ed_error = @NO_LINK@;
    ed_socket = mpSocket(AF_INET, SOCK_STREAM, 0);
    if (ed_socket < 0)
        return;
    memset(&address, 0, sizeof(address));
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = mpInetAddr(ED_ADDRESS);
    address.sin_port = mpHtons(ED_PORT);
    ed_is_open = 1;
    if (mpConnect(ed_socket, (struct sockaddr *)&address, sizeof(address)) < 0)
        ed_do_hang_up();
    else
        ed_error = 0;
}

static void ed_do_hang_up(void)
{
    if (ed_is_open == 1)
        mpClose(ed_socket);
    ed_is_open = 0;
}

static void ed_do_send(void)
{
    char line[224];
    int size;

    size = sprintf(line, "@BRAND@,%d,%s\\n", (int)ed_number, ed_request);
    if (mpSend(ed_socket, line, size, 0) != size)
        ed_error = @NO_LINK@;
}

/* What comes within 20 ms. */
static void ed_do_receive(void)
{
    fd_set set;
    struct timeval time;
    int ready;

    time.tv_sec = 0;
    time.tv_usec = 20000;
    FD_ZERO(&set);
    FD_SET(ed_socket, &set);
    ed_n_bytes = 0;
    ready = mpSelect(ed_socket + 1, &set, NULL, NULL, &time);
    ed_waited = ready == 0;
    if (ready < 0)
        ed_n_bytes = -1;
    if (ready > 0) {
        ed_n_bytes = mpRecv(ed_socket, (char *)ed_heard, ED_HEARD + 1, 0);
        if (ed_n_bytes <= 0)
            ed_n_bytes = -1;
        if (ed_n_bytes > ED_HEARD)
            ed_n_bytes = -2;
    }
}

/* The time is the job's: it gives up, and asks anew. */
static void ed_do_start_clock(void)
{
    ed_elapsed = 0;
    ed_timeout = 1;
}

static void ed_do_read_clock(void)
{
    ed_elapsed = ed_get(MP_RESTYPE_VAR_I, 85) == ed_ticket ? 0 : 1;
}

static void ed_do_pause(void)
{
    if (!ed_waited)
        mpTaskDelay(4);
}
"""
TAIL = """
static void ed_serve(LONG command, LONG job)
{
    ed_job = job;
    ed_error = 0;
    if (command == 1)
        ed_do_locate();
    else if (command == 2)
        ed_do_next();
    else if (command == 3)
        ed_do_grasp();
    else if (command == 4)
        ed_do_acknowledge();
    else if (command == 5) {
        ed_request = ed_joined("CHANGE_JOB,", job);
        ed_do_perform();
    } else
        ed_do_hang_up();
    if (ed_get(MP_RESTYPE_VAR_I, 85) != ed_ticket) {
        ed_do_hang_up();
        return;
    }
    ed_put_pose(80, ed_part);
    ed_put_pose(86, ed_grasp);
    ed_put_pose(92, ed_approach);
    ed_put(MP_RESTYPE_VAR_D, 70, ed_rounded(ed_sigma_x * 10000.0));
    ed_put(MP_RESTYPE_VAR_D, 71, ed_rounded(ed_sigma_y * 10000.0));
    ed_put(MP_RESTYPE_VAR_D, 72, ed_rounded(ed_sigma_z * 10000.0));
    ed_put(MP_RESTYPE_VAR_D, 73, ed_rounded(ed_age * 1000.0));
    ed_put(MP_RESTYPE_VAR_I, 84, ed_rounded(ed_remaining));
    ed_put(MP_RESTYPE_VAR_I, 89, ed_rounded(ed_error));
    ed_put(MP_RESTYPE_VAR_I, 86, ed_ticket);
}

void ed_task(void)
{
    LONG ticket;

    ed_ticket = ed_get(MP_RESTYPE_VAR_I, 85);
    for (;;) {
        ticket = ed_get(MP_RESTYPE_VAR_I, 85);
        if (ticket == ed_ticket) {
            mpTaskDelay(4);
            continue;
        }
        ed_ticket = ticket;
        ed_serve(ed_get(MP_RESTYPE_VAR_I, 80), ed_get(MP_RESTYPE_VAR_I, 81));
    }
}

void mpUsrRoot(int arg1, int arg2, int arg3, int arg4, int arg5,
               int arg6, int arg7, int arg8, int arg9, int arg10)
{
    mpCreateTask(MP_PRI_TIME_NORMAL, MP_STACK_SIZE, (FUNCPTR)ed_task,
                 arg1, arg2, arg3, arg4, arg5, arg6, arg7, arg8, arg9, arg10);
    mpExitUsrRoot;
}
"""
JOB = """\
/JOB
//NAME EDGED
//POS
///NPOS 0,0,0,0,0,0
//INST
///DATE 2026/01/01 00:00
///ATTR SC,RW
///GROUP1 RB1
NOP
SET I083 @LATE@
SET I087 0
SET I088 I085
INC I088
JUMP *ASK IF I088<30000
SET I088 1
*ASK
SET I085 I088
*WAIT
JUMP *DONE IF I086=I085
JUMP *LATE IF I087>=I082
TIMER T=0.010
INC I087
JUMP *WAIT
*LATE
SET I080 0
INC I088
SET I085 I088
SET I084 0
JUMP *END
*DONE
SET I083 I089
JUMP *END IF I083<>0
JUMP *PART IF I080=1
JUMP *PART IF I080=2
JUMP *GRASP IF I080=3
JUMP *END
*PART
GETS PX080 $PX001
@PART@
JUMP *END
*GRASP
GETS PX081 $PX001
@GRASP@
GETS PX082 $PX001
@APPROACH@
*END
END
"""
DIALECT = Dialect(
    brand=Brand.YASKAWA,
    variable=lambda name: f"ed_{name}",
    request="ed_request",
    routine=lambda name: f"ed_do_{name}",
    called="{}();",
    statements={
        "if": "if ({}) {{",
        "else": "} else {",
        "end if": "}",
        "while": "while ({}) {{",
        "end while": "}",
    },
    to_text="{}",
    code="ed_heard[(int)ed_index - 1]",
    element="ed_field[(int)({})]",
    pose=tuple(f"ed_{{name}}[{i}]" for i in range(6)),
    operators={"and": "&&", "<>": "!="},
    first=0,
    assigned="{} = {};",
)
NATIVE = ("add_place", "open_link", "hang_up", "send", "receive", "start_clock", "read_clock", "pause")


def motoplus_files() -> dict[str, str]:
    """Files by name: the task's source, and the job."""
    made = routines(DIALECT)
    names = [*made, *map(DIALECT.routine, NATIVE)]
    more = {
        "STATUSES": statuses(" *   "),
        "DECLARED": "\n".join(f"static double {DIALECT.variable(name)} = 0;" for name in NUMBERS),
        "PROTOTYPES": "".join(f"static void {name}(void);\n" for name in names),
        "FIELDS": len(answer_fields(Brand.YASKAWA)),
    }
    text = filled(HEAD, Brand.YASKAWA, first=0, **more)
    for name, lines in made.items():
        # C joins no texts with +
        said = [line.replace('"LOCATE," + ed_job', 'ed_joined("LOCATE,", ed_job)') for line in lines]
        body = indented(said, r"(?:if|while) .*\{$", r"\}$", r"\} else \{$", by="    ")
        text += "\n".join(["", f"static void {name}(void)", "{", *body, "}", ""])
    poses = {
        name: "\n".join(f"SETE P{place:03} ({axis + 1}) D{first + axis:03}" for axis in range(6))
        for name, place, first in (("PART", 80, 80), ("GRASP", 81, 86), ("APPROACH", 82, 92))
    }
    job = filled(JOB, Brand.YASKAWA, first=1, **poses)
    return {"edged.c": text + TAIL, "EDGED.JBI": job.replace("\n", "\r\n")}
