"""Every format of `edged registers`: the register map, and the programs for robots, PLCs and PCs."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files

from edged.errors import UserError
from edged.plc.registers import BLOCKS, MAP_VERSION
from edged.robot.orientations import Brand
from edged.robots.grammar import grammar
from edged.robots.registervalues import register_values
from edged.robots.robotlines import line_values
from edged.robots.templating import rendered


@dataclass(frozen=True, slots=True)
class Format:
    """What `edged registers --format NAME` writes, from the templates in the folder of that name.

    files : language of each file by its name: a table of `grammars`, or "" for none. brand : the maker whose
    poses a program reads in lines of text; None for Modbus. first : index of an array's first element.
    """

    files: Mapping[str, str]
    brand: Brand | None = None
    first: int = 1


FORMATS = {
    "md": Format({"edged.md": ""}),
    "csv": Format({"edged.csv": ""}),
    "json": Format({"edged.json": ""}),
    "st": Format({"edged.st": "iec"}),
    "plcopen": Format({"edged.xml": "iec"}),
    "scl": Format({"edged.scl": "scl"}),
    "urscript": Format({"edged.script": "urscript"}),
    "python": Format({"edged_cell.py": ""}),
    "rapid": Format({"EDGED.mod": "rapid"}, Brand.ABB),
    "drl": Format({"edged.drl": "drl"}, Brand.DOOSAN, first=0),
    "as": Format({"edged.as": "as"}, Brand.KAWASAKI),
    "spel": Format({"Edged.prg": "spel"}, Brand.EPSON),
    "twincat": Format(
        {
            "ST_EDGED_RESULT.TcDUT": "iec",
            "ST_EDGED_GRASP.TcDUT": "iec",
            "F_EDGED_DWORD.TcPOU": "iec",
            "F_EDGED_NEXT.TcPOU": "iec",
            "F_EDGED_UDINT_OF_64.TcPOU": "iec",
            "FB_EDGED.TcPOU": "iec",
            "FB_EDGED_TC.TcPOU": "iec",
        }
    ),
    "karel": Format({"edged.kl": "karel", "edgepick.ls": "tp", "edgedreg.ls": "tp"}, Brand.FANUC),
    "krl": Format({"edged.src": "krl", "edged.dat": "krl", "edged.xml": ""}, Brand.KUKA),
    "val3": Format(
        {
            "edged.pjx": "",
            "edged.dtx": "val3",
            **{
                f"{program}.pgx": "val3"
                for program in (
                    *("runLocate", "runPerform", "openAndAsk", "runFetch", "runGrasp", "acknowledge"),
                    *("nextNumber", "ask", "newField", "takeCode", "takeField", "openLink", "hangUp"),
                    *("send", "receive", "addPlace", "startClock", "readClock", "pause"),
                    *("locate", "expose", "result", "nextPart", "grasp", "perform", "start", "stop"),
                )
            },
        },
        Brand.STAUBLI,
        first=0,
    ),
    "melfa": Format({"EDGED.prg": "melfa", "EDGEDL.prg": "melfa"}, Brand.MITSUBISHI),
    "motoplus": Format({"edged.c": "c", "EDGED.JBI": "inform"}, Brand.YASKAWA, first=0),
}


def written(fmt: str) -> dict[str, str]:
    """Files of a format by name.

    Raises `UserError` for an unknown format, `ValueError` for a program that its controller would not read.
    """
    if fmt not in FORMATS:
        raise UserError(f"--format {fmt}: expected {', '.join(FORMATS)}")
    if fmt in ("csv", "json"):
        return {f"edged.{fmt}": _csv() if fmt == "csv" else _json()}
    values = register_values() | {"files": list(FORMATS[fmt].files)}
    if (brand := FORMATS[fmt].brand) is not None:
        values |= line_values(brand, FORMATS[fmt].first)
    return {file: _text(fmt, file, values) for file in FORMATS[fmt].files}


def render(fmt: str) -> str:
    """Text of a format that is one file. Raises as `written`."""
    (text,) = written(fmt).values()
    return text


def _text(fmt: str, file: str, values: Mapping[str, object]) -> str:
    if fmt == "python":
        # read, not imported: printing it takes no pymodbus
        source = files("edged.robots").joinpath("cell_client.py").read_text(encoding="utf-8")
        head, _, rest = source.partition("# <map>\n")
        return head + rendered(fmt, "map.py", values) + rest.partition("# </map>\n")[2]
    text = rendered(fmt, file, values)
    language = FORMATS[fmt].files[file]
    return grammar(language).checked(text) if language else text


def _rows() -> Iterator[dict[str, str | int]]:
    for block in BLOCKS:
        for register in block.registers:
            yield {
                "address": register.address,
                "words": register.kind.words,
                "block": block.name,
                "name": register.name,
                "type": register.kind.name,
                "unit": register.unit,
                "access": "rw" if block.writable else "r",
                "meaning": register.help,
            }


def _csv() -> str:
    rows = list(_rows())
    out = io.StringIO()
    writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def _json() -> str:
    table = {"map_version": MAP_VERSION, "registers": list(_rows())}
    return json.dumps(table, indent=1, ensure_ascii=False) + "\n"
