"""The robot's side in DRL, for Doosan controllers: Python with the controller's functions.

From the "Doosan Robotics Programming Manual" (chapter "TCP/Client"):

* `client_socket_open(ip, port)` tries until it is connected: while the cell is not reached, the program
  stands.
* `client_socket_write(sock, bytes)` returns 0, or a negative number.
* `client_socket_read(sock, length, timeout)` returns (bytes read, data): what has come until now, which may
  be half an answer; -1 the link is gone, -2 an error of the socket, -3 nothing in `timeout` seconds.
* `get_current_tool_flange_posx(ref)`: where the flange is, whatever tool is active.
* `posx(x, y, z, a, b, c)`: mm, and degrees about Z, the new Y, the new Z. `trans(pos, delta, ref=DR_TOOL)`
  shifts along the axes of the pose itself.
"""

from __future__ import annotations

from edged.robot.orientations import Brand
from edged.robots.robotlines import filled, statuses

SCRIPT = """\
# edged: written by `edged registers --format drl`.
# Needs [modbus.socket] in the cell's configuration. Put it before your program:
#     part = edged_locate(0, 5.0)             # job 0: the active one; seconds
#     if part is not None:
#         target = posx(part[0], part[1], part[2], part[3], part[4], part[5])
#         movel(trans(target, posx(0, 0, -100, 0, 0, 0), ref=DR_TOOL), vel=100, acc=100)
#     edged_acknowledge()
# Move only by what is not None. Otherwise edged_error says why:
@STATUSES@
edged_ip = "192.168.10.20"
edged_port = @PORT@
edged_error = 0
edged_remaining = 0       # targets that edged_next can still give
edged_sigma = [-1.0, -1.0, -1.0]   # mm; -1: not known
edged_age = -1.0          # seconds since the exposure
edged_socket = None
edged_sequence = 0
edged_command = 0


# Measure. Returns the pose's numbers, or None.
def edged_locate(job, timeout):
    global edged_command, edged_socket
    # a link of its own: nothing old can be waiting in it
    edged_close()
    edged_socket = client_socket_open(edged_ip, edged_port)
    edged_command = edged_number()
    return edged_part(edged_ask("LOCATE," + str(job) + edged_place(), edged_command, timeout))


# The next target of the same picture.
def edged_next(timeout):
    return edged_part(edged_ask("NEXT", edged_number(), timeout))


# Where the tool takes the part that was given last, and from where it comes; edged_error 119: nowhere.
def edged_grasp(timeout):
    return edged_pose(edged_ask("GRASP", edged_number(), timeout))


def edged_approach(timeout):
    return edged_pose(edged_ask("APPROACH", edged_number(), timeout))


# The part was used: it is withdrawn. After the last one the link is closed.
def edged_acknowledge():
    edged_ask("ACK", edged_command, 2.0)
    if edged_remaining == 0:
        edged_close()


# Where the flange is: cameras on it see from there.
def edged_place():
    flange = get_current_tool_flange_posx(DR_BASE)
    text = ""
    for i in range(6):
        text = text + ",%.4f" % flange[i]
    return text


def edged_number():
    global edged_sequence
    edged_sequence = edged_sequence % 65535 + 1
    return edged_sequence


def edged_close():
    global edged_socket
    if edged_socket is not None:
        client_socket_close(edged_socket)
    edged_socket = None


# Whatever comes after a failure is not heard: the link is closed.
def edged_fail(reason):
    global edged_error
    edged_error = reason
    edged_close()
    return None


def edged_part(fields):
    global edged_remaining
    if fields is None:
        edged_remaining = 0
    return edged_pose(fields)


def edged_pose(fields):
    global edged_remaining, edged_sigma, edged_age
    if fields is None:
        return None
    edged_remaining = int(fields[@REMAINING@])
    edged_sigma = fields[@SIGMA_X@:@SIGMA_Z@ + 1]
    edged_age = fields[@AGE@]
    return fields[@X@:@C@ + 1]


# One request and its answer: the numbers of its fields, or None.
def edged_ask(request, number, timeout):
    global edged_error
    edged_error = 0
    if edged_socket is None:
        return edged_fail(@NO_LINK@)
    line = "@BRAND@," + str(number) + "," + request + "\\n"
    if client_socket_write(edged_socket, line.encode()) != 0:
        return edged_fail(@NO_LINK@)
    start = time.time()
    data = b""
    while b"\\n" not in data:
        left = timeout - (time.time() - start)
        if left <= 0:
            return edged_fail(@LATE@)
        count, more = client_socket_read(edged_socket, -1, left)
        if count == -3:
            return edged_fail(@LATE@)
        if count <= 0:
            return edged_fail(@NO_LINK@)
        data = data + more
        if len(data) > 256:
            return edged_fail(@NO_ANSWER@)
    if data.find(b"\\n") != len(data) - 1:
        return edged_fail(@NO_ANSWER@)
    fields = []
    for field in data[:-1].split(b","):
        # digits, at most one point within them, perhaps a minus: not nan, not inf
        digits = field[1:] if field[:1] == b"-" else field
        if not digits.replace(b".", b"", 1).isdigit():
            return edged_fail(@NO_ANSWER@)
        fields.append(float(field))
    if len(fields) != @FIELDS@:
        return edged_fail(@NO_ANSWER@)
    if fields[@STATUS@] != 0:
        edged_error = int(fields[@STATUS@])
        return None
    if fields[@SEQUENCE@] != number:
        return edged_fail(@OTHERS@)
    return fields
"""


def drl_source() -> str:
    """Functions for the robot's program, as text."""
    return filled(SCRIPT, Brand.DOOSAN, first=0, STATUSES=statuses("#     "))
