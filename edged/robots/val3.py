"""The robot's side in VAL 3, for Stäubli's CS8 and CS9: a library of programs.

From the "VAL 3 Reference Manual" (D28062804A, version 5.3; D28093501, version 8), chapter "sio type":

* A socket is set up on the controller; a program is linked to it, and it connects with the first reading or
  writing. It is disconnected when the application ends; a program cannot be sure to close it earlier:
  `clearBuffer` empties what was received, and closes the socket on some versions. Hence answers with another
  sequence are passed over.
* `sioSet` of an array sends each element as a byte; a string gets the end that is configured. It returns how
  many were sent, -1 after the time-out or an error. So a request fills its array, with blanks, which the cell
  ignores.
* `sioGet` of one number reads a byte: 1; with `sioCtrl` "timeout" -1 it returns at once, 0 is nothing, -1 no
  link.
* `string`: at most 128 characters, an answer has more. `asc` gives the code of a character, counted from 0.
* `here(flange, world)` is the point of the flange in the world, `toString(".4", n)` writes four decimals.
* `num` has 64 bits. Arrays are counted from 0, data keep their values until the application is loaded anew.

The files' form is that of VAL 3 s7 (Program/2, Data/2, Project/3), which s8 converts when it is opened.
"""

from __future__ import annotations

from edged.plc.lines import answer_fields
from edged.robot.orientations import Brand
from edged.robots.robotlines import filled, statuses
from edged.robots.skeleton import NUMBERS, Dialect, indented, routines

REQUEST_BYTES = 128
REQUESTS = {"locate": "locate", "next": "nextPart", "grasp": "grasp"}
"""Programs with a time-out, by the skeleton's name; locate has a job before it. `next` is an instruction."""
SPACE = "http://www.staubli.com/robotics/VAL3"
XSI = 'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
HEAD = '<?xml version="1.0" encoding="utf-8"?>\n'
NATIVE = {
    "openLink": """\
call hangUp()
nError=0
nIsOpen=1""",
    "hangUp": """\
clearBuffer(siEdged)
nIsOpen=0""",
    "send": """\
sLine="@BRAND@,"+toString("",nNumber)+","+sRequest
nIndex=0
while nIndex<@BYTES@
  nOut[nIndex]=32
  if nIndex<len(sLine)
    nOut[nIndex]=asc(sLine,nIndex)
  endIf
  nIndex=nIndex+1
endWhile
nOut[@LAST@]=10
nUnused=sioCtrl(siEdged,"timeout",2)
if sioSet(siEdged,nOut)!=@BYTES@
  nError=@NO_LINK@
endIf
nUnused=sioCtrl(siEdged,"timeout",-1)""",
    "receive": """\
nBytes=sioGet(siEdged,nByte)""",
    "addPlace": """\
pHere=here(flange,world)
sRequest=sRequest+","+toString(".4",pHere.trsf.x)
sRequest=sRequest+","+toString(".4",pHere.trsf.y)
sRequest=sRequest+","+toString(".4",pHere.trsf.z)
sRequest=sRequest+","+toString(".4",pHere.trsf.rx)
sRequest=sRequest+","+toString(".4",pHere.trsf.ry)
sRequest=sRequest+","+toString(".4",pHere.trsf.rz)""",
    "startClock": "nStart=clock()",
    "readClock": "nElapsed=clock()-nStart",
    "pause": "delay(0.01)",
}
START = """\
// edged: written by `edged registers --format val3`. A library: import it into your application.
// Needs [modbus.socket] in the cell's configuration, and a client socket "Edged".
//
//   call edged:locate(0,5)                        // job 0: the active one; seconds
//   if edged:nError==0
//     pPick.trsf=edged:trPart                   // mm and degrees, in the frame that the rig is registered to
//     movel(appro(pPick,{0,0,-100,0,0,0}),tTool,mSlow)
//   endIf
//   call edged:acknowledge()
//
// nextPart(5): the next part of the same picture, nRemaining says how many there are. grasp(5): trGrasp and
// trApproach of the part that was given last. nSigmaX, nSigmaY, nSigmaZ: mm, -1 is not known; nAge: seconds.
// Move only while nError is 0. Otherwise it says why:
@STATUSES@"""


def _camel(name: str) -> str:
    first, *rest = name.split("_")
    return first + "".join(word.title() for word in rest)


def _number(name: str) -> str:
    return "n" + "".join(word.title() for word in name.removeprefix("n_").split("_"))


DIALECT = Dialect(
    brand=Brand.STAUBLI,
    variable=_number,
    request="sRequest",
    routine=lambda name: _camel(f"run_{name}" if name in (*REQUESTS, "perform") else name),
    called="call {}()",
    statements={
        "if": "if {}",
        "else": "else",
        "end if": "endIf",
        "while": "while {}",
        "end while": "endWhile",
    },
    to_text='toString("",{})',
    code="nByte",
    element="nField[{}]",
    pose=tuple(f"tr{{title}}.{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")),
    operators={"<>": "!="},
    first=0,
    assigned="{}={}",
    closes=False,
    by_byte=True,
)


def _program(name: str, lines: list[str], parameters: dict[str, str]) -> str:
    rows = "".join(
        f'      <Parameter name="{one}" type="{kind}" xsi:type="element" use="value" />\n'
        for one, kind in parameters.items()
    )
    given = f'    <Parameters xmlns="{SPACE}/Param/1">\n{rows}    </Parameters>\n' if rows else ""
    code = "\n".join(["begin", *lines, "end"])
    return (
        f'{HEAD}<Programs {XSI} xmlns="{SPACE}/Program/2">\n  <Program name="{name}" access="public">\n'
        f"{given}    <Code><![CDATA[{code}]]></Code>\n  </Program>\n</Programs>\n"
    )


def _data() -> str:
    fields = len(answer_fields(Brand.STAUBLI))
    rows = [("num", _number(name), 1) for name in (*NUMBERS, "unused", "start", "byte")]
    rows += [("num", "nField", fields), ("num", "nOut", REQUEST_BYTES)]
    rows += [("string", "sRequest", 1), ("string", "sLine", 1)]
    rows += [("trsf", name, 1) for name in ("trPart", "trGrasp", "trApproach")]
    plain = "".join(
        f'    <Data name="{name}" access="public" xsi:type="array" type="{kind}" size="{size}" />\n'
        for kind, name, size in rows
    )
    link = (
        '    <Data name="siEdged" access="public" xsi:type="array" type="sio" size="1">\n'
        '      <Value key="0" link="Socket\\Edged" />\n    </Data>\n'
    )
    here = (
        '    <Data name="pHere" access="public" xsi:type="array" type="pointRx" size="1">\n'
        '      <Value key="0" fatherId="world[0]" />\n    </Data>\n'
    )
    datas = f"  <Datas>\n{plain}{link}{here}  </Datas>\n"
    return f'{HEAD}<Database {XSI} xmlns="{SPACE}/Data/2">\n{datas}</Database>\n'


def val3_files() -> dict[str, str]:
    """Files of the library by name."""
    programs: dict[str, tuple[list[str], dict[str, str]]] = {}
    for name, lines in routines(DIALECT).items():
        blocks = indented(lines, "if |while ", "endIf|endWhile", "else")
        programs[name] = (blocks, {})
    for name, text in NATIVE.items():
        code = filled(text, Brand.STAUBLI, first=0, BYTES=REQUEST_BYTES, LAST=REQUEST_BYTES - 1)
        programs[name] = (["  " + line for line in code.splitlines()], {})
    for name, program in REQUESTS.items():
        takes = ["  nTimeout=x_nTimeout", f"  call {DIALECT.routine(name)}()"]
        given = {"x_nTimeout": "num"}
        if name == "locate":
            takes, given = ["  nJob=x_nJob", *takes], {"x_nJob": "num", **given}
        programs[program] = (takes, given)
    programs["perform"] = (
        ["  sRequest=x_sRequest", "  nTimeout=x_nTimeout", "  call runPerform()"],
        {"x_sRequest": "string", "x_nTimeout": "num"},
    )
    notes = filled(START, Brand.STAUBLI, first=0, STATUSES=statuses("//   "))
    programs["start"] = (["  " + line for line in notes.splitlines()], {})
    programs["stop"] = (["  call hangUp()"], {})
    files = {f"{name}.pgx": _program(name, *one) for name, one in programs.items()}
    rows = "".join(f'    <Program file="{name}" />\n' for name in files)
    project = (
        f'{HEAD}<Project xmlns="{SPACE}/Project/3">\n'
        '  <Parameters version="s7.9.1" stackSize="5000" millimeterUnit="true" />\n'
        f"  <Programs>\n{rows}  </Programs>\n"
        '  <Database>\n    <Data file="edged.dtx" />\n  </Database>\n'
        "  <Libraries>\n  </Libraries>\n  <Types>\n  </Types>\n</Project>\n"
    )
    return {"edged.pjx": project, "edged.dtx": _data(), **files}
