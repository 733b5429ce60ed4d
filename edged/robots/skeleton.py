"""What a robot says and hears, once for all languages that have whole programs made of it.

`ROUTINES` is in words of its own, a statement a line; a `Dialect` puts them into a maker's. Its variables are
numbers that all routines share, `request` is a text, `field` holds the numbers of an answer. What the
languages do differently is written in each: `open_link`, `hang_up`, `send` (the number and the request, with
a line feed), `receive` (n_bytes: what has come now, 0 is nothing, -1 a lost link, -2 more than an answer),
`start_clock`, `read_clock` (elapsed, in s), `pause`, `add_place` (to the request: where the flange is, for
cameras that the robot carries; a cell whose cameras stand still does not look at it).

A REAL of 24 bits holds what is read exactly: 7 digits before the point, 6 after it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from edged.robot.orientations import Brand
from edged.robots.robotlines import filled

ROUTINES = """\
sub locate
remaining = 0
call next_number
command = number
request = "LOCATE," + text(job)
call add_place
call open_and_ask
pose part
end
sub perform
call next_number
command = number
call open_and_ask
end
sub open_and_ask
call open_link
if error == 0
call ask
end if
end
sub next
call next_number
request = "NEXT"
call ask
pose part
end
sub grasp
call next_number
request = "GRASP"
call ask
pose grasp
if error == 0
call next_number
request = "APPROACH"
call ask
pose approach
end if
end
sub acknowledge
number = command
request = "ACK"
timeout = 2
call ask
if remaining == 0
call hang_up
end if
end
sub next_number
sequence = sequence + 1
if sequence > 65535
sequence = 1
end if
number = sequence
end
sub ask
error = 0
if is_open == 0
error = @NO_LINK@
else
call send
end if
call start_clock
count = 0
is_whole = 0
call new_field
while (is_whole == 0) and (error == 0)
call receive
if n_bytes == -1
error = @NO_LINK@
end if
if n_bytes == -2
error = @NO_ANSWER@
end if
if n_bytes == 0
call read_clock
if elapsed >= timeout
error = @LATE@
else
call pause
end if
end if
index = 1
while (index <= n_bytes) and (error == 0)
code = the code
call take_code
index = index + 1
end while
end while
look again
if error == 0
if field[@STATUS@] <> 0
error = field[@STATUS@]
else
if field[@SEQUENCE@] <> number
error = @OTHERS@
end if
end if
end if
if error >= @LATE@
call hang_up
end if
end
sub new_field
whole = 0
part_of_1 = 0
scale = 1
whole_digits = 0
part_digits = 0
is_minus = 0
has_point = 0
end
sub take_code
is_good = 0
if is_whole == 0
if (code >= 48) and (code <= 57)
if has_point == 0
if whole_digits < 7
whole = whole * 10 + code - 48
whole_digits = whole_digits + 1
is_good = 1
end if
else
if part_digits < 6
part_of_1 = part_of_1 * 10 + code - 48
scale = scale * 10
part_digits = part_digits + 1
is_good = 1
end if
end if
end if
if (code == 45) and (is_minus == 0) and (whole_digits == 0)
is_minus = 1
is_good = 1
end if
if (code == 46) and (has_point == 0) and (whole_digits > 0)
has_point = 1
is_good = 1
end if
if (whole_digits > 0) and (part_digits == has_point * 6)
if (code == 44) and (count < @FIELDS@ - 1)
call take_field
is_good = 1
end if
if (code == 10) and (count == @FIELDS@ - 1)
call take_field
is_whole = 1
is_good = 1
pass over
end if
end if
end if
if is_good == 0
error = @NO_ANSWER@
end if
end
sub take_field
count = count + 1
value = whole + part_of_1 / scale
if is_minus == 1
value = 0 - value
end if
field[count] = value
call new_field
end
"""
PASS_OVER = """\
if (field[@SEQUENCE@] <> number) and (field[@SEQUENCE@] <> 0)
count = 0
is_whole = 0
end if
"""
"""Where a link cannot be closed, what was meant for an earlier request is not heard."""
LOOK_AGAIN = """\
if error == 0
call receive
if n_bytes > 0
error = @NO_ANSWER@
end if
end if
"""
"""Where bytes are fetched one by one, whatever stands behind an answer is looked for."""
NUMBERS = (
    *("error", "remaining", "sequence", "command", "number", "timeout", "elapsed", "job"),
    *("is_open", "count", "is_whole", "n_bytes", "index", "code", "whole"),
    *("part_of_1", "scale", "whole_digits", "part_digits", "is_minus", "has_point", "is_good", "value"),
    *("age", "sigma_x", "sigma_y", "sigma_z"),
)


@dataclass(frozen=True, slots=True)
class Dialect:
    """How a maker's language says it.

    variable : the name of a number. request : the text's. routine, called : the name of one, and its call.
    statements : of "if", "else", "end if", "while", "end while"; {} is the condition. to_text : a number as
    digits. code : of the index-th byte that came. element : of the numbers of an answer. pose : the parts
    of one, {name} is "part", "grasp" or "approach"; posed : what is made of them. operators : those that
    are written in another way. first : of an array. assigned : a variable and its value. closes : whether a
    program can close its link. by_byte : whether `receive` gives one at a time.
    """

    brand: Brand
    variable: Callable[[str], str]
    request: str
    routine: Callable[[str], str]
    called: str
    statements: Mapping[str, str]
    to_text: str
    code: str
    element: str
    pose: tuple[str, ...]
    operators: Mapping[str, str] = field(default_factory=dict)
    first: int = 1
    assigned: str = "{} = {}"
    posed: str = ""
    closes: bool = True
    by_byte: bool = False


def routines(dialect: Dialect) -> dict[str, list[str]]:
    """Lines of each routine, by the dialect's name of it."""
    text = ROUTINES.replace("pass over\n", "" if dialect.closes else PASS_OVER)
    text = text.replace("look again\n", LOOK_AGAIN if dialect.by_byte else "")
    made: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in filled(text, dialect.brand, first=1).splitlines():
        if line.startswith("sub "):
            lines = made[dialect.routine(line[4:])] = []
        elif line.startswith("pose "):
            lines += _taken(line[5:], dialect)
        elif line != "end":
            lines.append(_statement(line, dialect))
    return made


def _taken(name: str, dialect: Dialect) -> list[str]:
    """The pose of an answer, and what is said beside it."""
    axes = filled("@X@ @Y@ @Z@ @A@ @B@ @C@", dialect.brand, first=1).split()
    rest = "remaining=@REMAINING@ sigma_x=@SIGMA_X@ sigma_y=@SIGMA_Y@ sigma_z=@SIGMA_Z@ age=@AGE@"
    pairs = [one.split("=") for one in filled(rest, dialect.brand, first=1).split()]
    return [
        _statement("if error == 0", dialect),
        *(
            dialect.assigned.format(part.format(name=name, title=name.title()), _element(axis, dialect))
            for part, axis in zip(dialect.pose, axes, strict=True)
        ),
        *([dialect.posed.format(name=name)] if dialect.posed else []),
        *(_statement(f"{one} = field[{number}]", dialect) for one, number in pairs),
        # of a part that has no grasp others may follow
        *(_statement(line, dialect) for line in ("else", "remaining = 0") if name == "part"),
        _statement("end if", dialect),
    ]


def _statement(line: str, dialect: Dialect) -> str:
    if line.startswith("call "):
        return dialect.called.format(dialect.routine(line[5:]))
    for word in ("if ", "while "):
        if line.startswith(word):
            return dialect.statements[word.strip()].format(_expression(line[len(word) :], dialect))
    if line in dialect.statements:
        return dialect.statements[line]
    target, _, value = line.partition(" = ")
    said = dialect.code if value == "the code" else _expression(value, dialect)
    return dialect.assigned.format(_expression(target, dialect), said)


def _expression(text: str, dialect: Dialect) -> str:
    def word(found: re.Match[str]) -> str:
        token = found[0]
        if token.startswith("field["):
            return _element(token[6:-1], dialect)
        if token.startswith("text("):
            return dialect.to_text.format(dialect.variable(token[5:-1]))
        if token == "request":
            return dialect.request
        if token in NUMBERS:
            return dialect.variable(token)
        return dialect.operators.get(token, token)

    return re.sub(r'"[^"]*"|field\[\w+\]|text\(\w+\)|\w+|[=<>]+', word, text)


def _element(index: str, dialect: Dialect) -> str:
    if index.isdigit():
        return dialect.element.format(int(index) - 1 + dialect.first)
    less = "" if dialect.first == 1 else f"-{1 - dialect.first}"
    return dialect.element.format(dialect.variable(index) + less)


def indented(lines: list[str], opens: str, closes: str, between: str, by: str = "  ") -> list[str]:
    """Lines set in by their blocks; the three are patterns of how such a line begins."""
    made, depth = [], 1
    for line in lines:
        if re.match(f"(?:{closes}|{between})", line):
            depth -= 1
        made.append(by * depth + line)
        if re.match(f"(?:{opens}|{between})", line):
            depth += 1
    return made
