"""Answers of `edged` to unusable input: the place, what was found, what was expected."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.cells import flange, small_rig
from helpers.commandline import exit_code

from edged.commands.demo import DemoOptions, prepare_cell
from edged.sim.cell import VirtualCell, demo_part

Change = tuple[str, str] | str | bytes | Callable[[Path], None]
"""Change of a file: an old and a new text, its whole content, or a function."""


@dataclass(frozen=True, slots=True)
class Bad:
    """A mistake, the command that meets it, and the answer; ~ is the cell's folder."""

    command: str
    message: str
    files: dict[str, Change] = field(default_factory=dict)
    code: int = 2


def remove(path: Path) -> None:
    """Remove a file or folder."""
    shutil.rmtree(path) if path.is_dir() else path.unlink()


def picture(width: int, height: int, grey: int = 50) -> Callable[[Path], None]:
    """Write a uniform picture."""
    return lambda path: path.write_bytes(
        cv2.imencode(".png", np.full((height, width), grey, np.uint8))[1].tobytes()
    )


def folder(path: Path) -> None:
    """Make an empty folder."""
    path.mkdir()


CHECK = "check cell.toml"
TEACH = "teach --rig rig.json --left left.png --right right.png --name new -o new"
LOCATE = "locate --rig rig.json --job jobs/flange left.png right.png"
DXF = "teach --rig rig.json --dxf part.dxf --depth 205 --name new -o new"
CONTOUR = "teach --rig rig.json --contour part.csv --depth 205 --name new -o new"
TOUCH = "register touch --rig rig.json --points touched.csv -o new.json"
BOARD = "calibrate boards --board {} -o new.json"
JOB = "jobs/flange/job.toml"
KINDS = """chessboard:COLSxROWS:SQUARE_MM (inner corners), e.g. chessboard:11x8:4.0
dots:COLSxROWS:PITCH_MM[:DIAMETER_MM] (diameter half the pitch if not given), e.g. dots:7x7:5.0
circles:COLSxROWS:PITCH_MM[:DIAMETER_MM] (asymmetric, in OpenCV's terms: circles in a row x rows, \
pitch from row to row; diameter half the pitch if not given), e.g. circles:4x11:5.0
charuco:COLSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY (squares), e.g. charuco:12x9:4:3:5X5_250"""
HEAD = "0\nSECTION\n2\nHEADER\n9\n$INSUNITS\n70\n{}\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n"
CIRCLE = "0\nCIRCLE\n8\n0\n10\n0\n20\n0\n30\n0\n40\n14\n"
END = "0\nENDSEC\n0\nEOF\n"


def cell(old: str, new: str, message: str) -> Bad:
    """A wrong line in cell.toml."""
    return Bad(CHECK, f"edged: cell.toml: 1 problem\n{message}", {"cell.toml": (old, new)})


def board(spec: str, message: str) -> Bad:
    """An impossible board."""
    return Bad(BOARD.format(spec), f"edged: {message}", {"boards": folder})


def region(spec: str, message: str) -> Bad:
    """A wrong region of the left picture."""
    return Bad(f"{TEACH} --region {spec}", f"edged: {message}")


def drawn(unit: int, message: str, command: str = DXF) -> Bad:
    """A wrong drawing of a circle; `unit` is $INSUNITS of DXF."""
    return Bad(command, f"edged: {message}", {"part.dxf": HEAD.format(unit) + CIRCLE + END})


def touched(points: str, message: str) -> Bad:
    """A wrong table of touched points."""
    return Bad(TOUCH, f"edged: {message}", {"touched.csv": points})


CASES: dict[str, Bad] = {
    # --- cell.toml ---
    "no configuration": Bad(
        "check none.toml", "edged: none.toml: 1 problem\ncannot be read: No such file or directory"
    ),
    "a folder as configuration": Bad("check jobs", "edged: jobs: 1 problem\ncannot be read: Is a directory"),
    "not TOML": cell(
        "[cell]", "[cell", "line 2: not TOML: Expected ']' at the end of a table declaration, got '[cell'"
    ),
    "Latin-1": Bad(
        CHECK,
        "edged: cell.toml: 1 problem\nline 1: not UTF-8 text (a byte 0xfc): save it as UTF-8",
        {"cell.toml": "# Zelle für Flansche\n".encode("latin-1")},
    ),
    "empty": Bad(CHECK, "edged: cell.toml: 2 problems\ncell: missing\ncameras: missing", {"cell.toml": ""}),
    "misspelt key": cell("period_s", "periods", "cycle.periods: unknown key, did you mean period_s?"),
    "misspelt section": cell("[modbus]", "[modbuss]", "modbuss: unknown key, did you mean modbus?"),
    "text for a number": cell(
        "period_s = 0.25", 'period_s = "0.25"', "cycle.period_s: expected a number, got '0.25'"
    ),
    "decimal comma": cell(
        "period_s = 0.25",
        "period_s = 0,25",
        "line 10: not TOML: Expected newline or end of document after a statement, got 'period_s = 0,25'",
    ),
    "negative": cell("period_s = 0.25", "period_s = -1", "cycle.period_s: expected at least 0, got -1"),
    "port too large": cell("port = 1502", "port = 70000", "modbus.port: expected at most 65535, got 70000"),
    "unknown mode": cell(
        'mode = "free"',
        'mode = "continuous"',
        "cycle.mode: expected 'free', 'command' or 'external', got 'continuous'",
    ),
    "blanks in the name": cell(
        'name = "demo"',
        'name = "cell one"',
        "cell.name: expected 1 to 64 letters, digits, '_', '.' and '-', a letter or digit first, got "
        "'cell one'",
    ),
    "one port twice": cell(
        "port = 1502", "port = 7447", "(file): modbus.port and zenoh.listen are both 7447"
    ),
    "endpoint without protocol": cell(
        "tcp/127.0.0.1:7447",
        "127.0.0.1:7447",
        "zenoh.listen.0: expected PROTOCOL/ADDRESS, for example tcp/192.168.10.20:7447, got '127.0.0.1:7447'",
    ),
    "open to the network": cell(
        "tcp/127.0.0.1:7447",
        "tcp/0.0.0.0:7447",
        "zenoh: listen: over tcp/0.0.0.0:7447 other machines could trigger and change the job: set "
        "zenoh.config_file with mutual TLS or access control (config/zenoh-acl-example.json5), or "
        'zenoh.commands = "refused" for readers only, or "anyone" where everybody there may',
    ),
    "shared key that can be guessed": Bad(
        CHECK,
        "edged: cell.toml: 1 problem\nzenoh.shared_key: ~/zenoh.key: 6 bytes: expected a shared key of 32 at "
        "least, as of openssl rand -hex 32",
        {"cell.toml": ("[zenoh]", '[zenoh]\nshared_key = "zenoh.key"'), "zenoh.key": b"secret\n"},
    ),
    "page without password": cell(
        "[modbus]",
        '[web]\nhost = "0.0.0.0"\n[modbus]',
        "web: host '0.0.0.0' can be reached from other machines: password_hash is missing (`edged password`)",
    ),
    "host with http": cell(
        "[modbus]",
        '[web]\nhost = "http://127.0.0.1"\n[modbus]',
        'web.host: expected an address, for example "0.0.0.0" or "localhost", got \'http://127.0.0.1\'',
    ),
    "cameras without address": cell(
        '"virtual-inprocess"',
        '"aravis"',
        'cameras: source "aravis" needs left.device and right.device (serial number or IP)',
    ),
    "replay without folder": cell(
        '"virtual-inprocess"', '"replay"', 'cameras: source "replay" needs `folder`'
    ),
    "job that is not there": cell(
        'job = "flange"', 'job = "flnge"', "cell.job: no usable job 'flnge' in ~/jobs (there: flange)"
    ),
    "rig that is not there": cell(
        '"rig.json"',
        '"rigs.json"',
        "cell.rig: ~/rigs.json: cannot read a rig: No such file or directory\nnothing else is wrong: the "
        "daemon would start, in SETUP, and measure nothing",
    ),
    "jobs that are not there": Bad(
        CHECK,
        "edged: cell.toml: 1 problem\ncell.jobs: ~/jobs: no such folder\n"
        "nothing else is wrong: the daemon would start, in SETUP, and measure nothing",
        {"jobs": remove},
    ),
    # --- jobs ---
    "job: not TOML": Bad(
        CHECK,
        "edged: cell.toml: 2 problems\n"
        "cell.jobs: ~/jobs/flange/job.toml: line 32: not TOML: Expected ']' at the end of a table "
        "declaration, got '[search'\n"
        "cell.job: no usable job 'flange' in ~/jobs (there: none)",
        {JOB: ("[search]", "[search")},
    ),
    "job: misspelt key": Bad(
        CHECK,
        "edged: cell.toml: 2 problems\n"
        "cell.jobs: ~/jobs/flange/job.toml: search.min_scor: unknown key, did you mean min_score?\n"
        "cell.job: no usable job 'flange' in ~/jobs (there: none)",
        {JOB: ("min_score", "min_scor")},
    ),
    "job: score above 1": Bad(
        LOCATE,
        "edged: jobs/flange/job.toml: search.min_score: expected at most 1, got 70.6",
        {JOB: ("min_score = 0.", "min_score = 70.")},
    ),
    "job: shape is missing": Bad(
        LOCATE,
        "edged: jobs/flange/shape.npz: cannot read a job: No such file or directory",
        {"jobs/flange/shape.npz": remove},
    ),
    "job: shape is cut": Bad(
        LOCATE,
        "edged: jobs/flange/shape.npz: not an edged-shape file, or damaged: File is not a zip file",
        {"jobs/flange/shape.npz": b"PK\x03\x04half"},
    ),
    "job: none": Bad(LOCATE.replace("jobs/flange", "jobs/flang"), "edged: jobs/flang: no such job folder"),
    # --- rig.json ---
    "rig: none": Bad(
        LOCATE.replace("rig.json", "rigs.json"),
        "edged: rigs.json: cannot read a rig: No such file or directory",
    ),
    "rig: not JSON": Bad(
        LOCATE,
        "edged: rig.json: not JSON: Expecting property name enclosed in double quotes: line 1 "
        "column 2 (char 1)",
        {"rig.json": "{"},
    ),
    "rig: of another program": Bad(
        LOCATE,
        'edged: rig.json: not a rig file (expected "format": "edged-rig")',
        {"rig.json": '{"K1": [1, 2, 3]}'},
    ),
    "rig: newer": Bad(
        LOCATE,
        "edged: rig.json: version 9, this edged reads 1",
        {"rig.json": ('"version": 1', '"version": 9')},
    ),
    "rig: a text as number": Bad(
        LOCATE,
        "edged: rig.json: left.fx: expected a number, got 'f'",
        {"rig.json": ('"fx": ', '"fx": "f", "f": ')},
    ),
    # --- images ---
    "image: none": Bad(LOCATE.replace("left.png", "lft.png"), "edged: lft.png: no such file"),
    "image: text": Bad(
        LOCATE,
        "edged: left.png: not an image that can be read; save it as PNG, TIFF, BMP or JPEG",
        {"left.png": "no picture"},
    ),
    "image: more pixels than a PC holds": Bad(
        LOCATE,
        "edged: left.png: 50000x40000 pixels, unpacked 2000000000 bytes: "
        "expected at most 67108864 pixels and 268435456 bytes",
        {"left.png": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\xc3\x50\0\0\x9c\x40\x08\0\0\0\0"},
    ),
    "image: empty": Bad(LOCATE, "edged: left.png: an empty file, expected an image", {"left.png": b""}),
    "image: a folder": Bad(LOCATE.replace("left.png", "jobs"), "edged: jobs: is a folder, expected an image"),
    "image: another size": Bad(
        LOCATE,
        "edged: left image: 320x240, the rig was calibrated for 640x480",
        {"left.png": picture(320, 240)},
    ),
    "image: nothing on it": Bad(
        LOCATE,
        "status NO_TARGET\n"
        "nothing in the left picture is like the part. Try: is it in the picture, at the taught "
        "distance, and in the taught light?",
        {"left.png": picture(640, 480), "right.png": picture(640, 480)},
        1,
    ),
    # --- boards ---
    "board: no kind": board(
        "11x8:4.0", "board '11x8:4.0': '11x8' is not a kind of board; expected one of\n" + KINDS
    ),
    "board: unknown kind": board(
        "checker:11x8:4.0",
        "board 'checker:11x8:4.0': 'checker' is not a kind of board; expected one of\n" + KINDS,
    ),
    "board: no square": board(
        "chessboard:11x8",
        "board 'chessboard:11x8': 1 value after the kind, expected chessboard:COLSxROWS:SQUARE_MM (inner "
        "corners), e.g. chessboard:11x8:4.0",
    ),
    "board: one row": board(
        "chessboard:11x1:4", "board 'chessboard:11x1:4': 11x1: columns and rows must be 3 to 100"
    ),
    "board: unit": board(
        "chessboard:11x8:4mm",
        "board 'chessboard:11x8:4mm': square '4mm' is not a length in mm (0.001 to 10000); expected "
        "chessboard:COLSxROWS:SQUARE_MM (inner corners), e.g. chessboard:11x8:4.0",
    ),
    "board: no folder": Bad(
        BOARD.format("chessboard:11x8:4"),
        "edged: boards: not a folder; expected pairs NAME_left.png and NAME_right.png",
    ),
    "board: no pictures": board(
        "chessboard:11x8:4",
        "boards: no pictures NAME_left.* and NAME_right.* (png, jpg, jpeg, bmp, tif, tiff)",
    ),
    "board: half a pair": Bad(
        BOARD.format("chessboard:11x8:4"),
        "edged: boards: incomplete pairs\na_left.png: a_right is missing",
        {"boards": folder, "boards/a_left.png": b""},
    ),
    "board: lens": Bad(
        BOARD.format("chessboard:11x8:4") + " --model fisheye",
        "edged: --model 'fisheye': expected one of auto, division, brown",
        {"boards": folder},
    ),
    "board: not in the pictures": Bad(
        BOARD.format("chessboard:11x8:4"),
        "edged: 0 of 3 pairs show the board in both images, expected at least 3 (20 are good)\n"
        "a: left: the left and the right picture are the same file twice\n"
        "b: left: the left and the right picture are the same file twice\n"
        "c: left: the left and the right picture are the same file twice",
        {
            "boards": folder,
            **{f"boards/{n}_{s}.png": picture(640, 480) for n in "abc" for s in ("left", "right")},
        },
    ),
    # --- regions ---
    "region: three numbers": region(
        "10,10,100",
        "--region '10,10,100': expected X,Y,W,H, circle:X,Y,R, polygon:X,Y;X,Y;X,Y... or mask:FILE.png, "
        "in pixels of the left image",
    ),
    "region: outside": region(
        "9000,10,100,100",
        "region: outside the 640x480 image, or empty; expected at least 16 px of the left image",
    ),
    "region: no width": region(
        "10,10,0,100",
        "region (10.0, 10.0, 0.0, 100.0): expected X,Y,W,H with a width and height of at least 16 px",
    ),
    "region: unknown form": region(
        "square:1,2,3",
        "--region 'square:1,2,3': expected X,Y,W,H, circle:X,Y,R, polygon:X,Y;X,Y;X,Y... or "
        "mask:FILE.png, in pixels of the left image",
    ),
    "region: polygon of two": region("polygon:1,1;2,2", "region polygon: expected 3 to 1000 corners X,Y"),
    "region: no mask": region("mask:none.png", "none.png: no such file"),
    "region: nothing in it": region(
        "1,1,40,40",
        "1 circle(s) found in the left image, but none of them in the right one; is the part seen by "
        "both cameras, and does the rig belong to these images? Where its face is bright in one and dark in "
        "the other: light from more sides, or its STEP file besides",
    ),
    "region: contrast": Bad(
        f"{TEACH} --contrast 40,10", "edged: contrast_low 40: expected at most contrast_high, 10"
    ),
    "region: pair and drawing": Bad(
        f"{TEACH} --dxf part.dxf",
        "edged: teach: expected either --left and --right, or one of --dxf, --contour and --step",
    ),
    # --- drawings ---
    "dxf: none": Bad(DXF, "edged: part.dxf: cannot read a drawing: No such file or directory"),
    "dxf: text": Bad(
        DXF,
        "edged: part.dxf: not a DXF drawing that can be read: File 'part.dxf' is not a DXF file.",
        {"part.dxf": "a flange"},
    ),
    "dxf: no unit": drawn(
        0, "part.dxf: the drawing does not say its unit ($INSUNITS is 0); state it (mm, cm, m, in)"
    ),
    "dxf: unknown unit": drawn(4, "part.dxf: unit 'ft': expected one of mm, cm, m, in", f"{DXF} --unit ft"),
    "dxf: no layer": drawn(4, "part.dxf: no layer 'PART', there are '0', 'Defpoints'", f"{DXF} --layer PART"),
    "dxf: nothing drawn": Bad(
        DXF,
        "edged: part.dxf: no closed outline in it; expected lines, arcs, circles or polylines",
        {"part.dxf": HEAD.format(4) + END},
    ),
    "dxf: metres": drawn(
        6,
        "the part does not fit the image at this distance: 21171841x135472511 px with its margin, of "
        "816x464; are unit and distance right?",
    ),
    "dxf: no depth": drawn(
        4,
        "teach: --depth missing: the nominal distance of the drawn face, in mm",
        DXF.replace(" --depth 205", ""),
    ),
    "contour: words": Bad(
        CONTOUR,
        "edged: part.csv: line 3: expected x,y in mm, got '10, ten'",
        {"part.csv": "0,0\n10,0\n10,ten\n"},
    ),
    # --- registration ---
    "touched: none": Bad(TOUCH, "edged: touched.csv: cannot read a table: No such file or directory"),
    "touched: empty": touched("", "touched.csv: empty: no line with numbers in it"),
    "touched: two numbers": touched(
        "a.json, 1, 2\n",
        "touched.csv: line 1: expected rig x,y,z and robot x,y,z, or FILE.json and robot x,y,z, in mm; "
        "got 3 values",
    ),
    "touched: no result": touched(
        "a.json, 1, 2, 3\nb.json, 4, 5, 6\nc.json, 7, 8, 9\n",
        "a.json: cannot read a result of edged locate --json: No such file or directory",
    ),
    "touched: two points": touched(
        "0,0,200, 1,2,3\n10,0,200, 11,2,3\n",
        "registration needs three or more points in both frames, got 2 and 2",
    ),
    "touched: on one line": touched(
        "0,0,200, 1,2,3\n10,0,200, 11,2,3\n20,0,200, 21,2,3\n",
        "the points lie on one line in the rig's frame: the rotation about it stays open; touch a point "
        "beside it",
    ),
    "touched: metres": touched(
        "0,0,200, 0,0,.2\n100,0,200, .1,0,.2\n0,100,200, 0,.1,.2\n90,90,200, .09,.09,.2\n",
        "the robot's lengths are 0.001 times the rig's: they look like m, expected mm",
    ),
    "touched: mirrored": touched(
        "0,0,0, 0,0,0\n100,0,0, -100,0,0\n0,100,0, 0,100,0\n0,0,100, 0,0,100\n",
        "the robot's points are a mirror image of the rig's: one axis has the wrong sign, or two are swapped",
    ),
    # --- recordings, backups ---
    "recording: none": Bad("replay none.zip", "edged: none.zip: no such file or folder"),
    "recording: empty folder": Bad(
        "replay recordings",
        "edged: recordings: no recordings (expected a file, or a folder with cycles/*.zip)",
        {"recordings": folder},
    ),
    "recording: text": Bad(
        "replay a.zip",
        "a.zip: not replayed: a.zip: not a recording: File is not a zip file\n"
        "0 the same to the last bit, 0 different, 1 not replayed",
        {"a.zip": "text"},
        1,
    ),
    "backup: none": Bad(
        "restore none.tar.gz", "edged: none.tar.gz: cannot read a backup: No such file or directory"
    ),
    "backup: text": Bad(
        "restore a.tar.gz",
        "edged: a.tar.gz: not a backup, or damaged: Not a gzipped file (b'te')",
        {"a.tar.gz": "text"},
    ),
    "backup: another kind of archive": Bad(
        "backup cell.toml -o cell.zip",
        "edged: cell.zip: an archive is a tar: expected a name that ends in .tar.gz",
    ),
    "backup: exists": Bad(
        "backup cell.toml -o a.tar.gz",
        "edged: a.tar.gz: exists; choose another name, or --force to replace it",
        {"a.tar.gz": "text"},
    ),
    # --- command line ---
    "no such command": Bad(
        "loacte",
        "Usage: edged [OPTIONS] COMMAND [ARGS]...\n"
        "Try 'edged -h' for help.\n"
        "Error\n"
        "No such command 'loacte'. Did you mean 'locate'?",
    ),
    "no such option": Bad(
        f"{LOCATE} --overley seen.png",
        "Usage: edged locate [OPTIONS] {left} {right}\n"
        "Try 'edged locate -h' for help.\n"
        "Error\n"
        "No such option: --overley (Possible options: --overlay)",
    ),
    "option forgotten": Bad(
        "locate left.png right.png --rig rig.json",
        "Usage: edged locate [OPTIONS] {left} {right}\n"
        "Try 'edged locate -h' for help.\n"
        "Error\n"
        "Missing option '--job'.",
    ),
    "option without value": Bad("watch --count", "Error\nOption '--count' requires an argument."),
    "count of nothing": Bad(
        "grab cell.toml -o new --count 0",
        "Usage: edged grab [OPTIONS] {config}\n"
        "Try 'edged grab -h' for help.\n"
        "Error\n"
        "Invalid value for '--count': Input should be greater than or equal to 1",
    ),
    "register format": Bad(
        "registers --format xml",
        "edged: --format xml: expected md, json, st, scl, s7db, l5x, plcopen, twincat, urscript, krl, "
        "krl6, karel, rapid, motoplus, val3, as, drl, melfa, spel, pacscript, eds, python, csv",
    ),
    "locate: convention": Bad(
        f"{LOCATE} --convention kuka",
        "edged: --convention 'kuka': expected one of fixed_xyz, kuka_abc, ur_rotation_vector, staubli_xyz, "
        "kawasaki_oat, abb_zyx",
    ),
    "file to be lost": Bad(
        f"{LOCATE} --overlay left.png",
        "edged: --overlay is LEFT, left.png, which would be lost; expected another file",
    ),
    "one file for two": Bad(
        f"{LOCATE} --overlay new.png --ply new.png",
        "edged: --overlay and --ply are the same file, new.png: expected two",
    ),
    "no folder for a file": Bad(
        f"{LOCATE} --overlay none/new.png", "edged: none/new.png: there is no folder ~/none to write into"
    ),
    "status of no URL": Bad(
        "status --url 127.0.0.1:8080",
        "edged: --url 127.0.0.1:8080: expected http://HOST:PORT or https://HOST:PORT",
    ),
    "status of nobody": Bad(
        "status --url http://127.0.0.1:9",
        "edged: http://127.0.0.1:9: not reached: Connection refused",
        code=1,
    ),
    "registers of nobody": Bad(
        "registers --read 127.0.0.1:9", "edged: --read 127.0.0.1:9: nothing answers at 127.0.0.1, port 9"
    ),
    "verify without witness": Bad(
        "verify --rig rig.json left.png right.png",
        "edged: state either --board SPEC or --job DIR, whichever the images show",
    ),
    "verify: length": Bad(
        "verify --rig rig.json left.png right.png --job jobs/flange --length c0",
        "edged: --length 'c0': expected NAME=MM, e.g. c0=40.0 or c0-c1=60.0",
    ),
    "sim: fault": Bad(
        "sim --fault packet_los=1",
        "edged: no fault 'packet_los'; expected one of packet_loss, unplugged, stalled, delay_s, "
        "frozen, drop_next, repeat_id, lost_packets, no_resend, reordering, duplication, "
        "answer_loss, answer_delay_s",
    ),
    "sim: pattern": Bad(
        "sim --pattern big", "edged: --pattern 'big': expected WIDTHxHEIGHT in px, as 640x480"
    ),
    # --- the machine ---
    "folder without rights": Bad(
        f"{LOCATE} --overlay /proc/new.png",
        "edged: /proc/new.png: cannot be written into /proc: No such file or directory",
    ),
    "job without rights": Bad(
        TEACH.replace("-o new", "-o /proc/new"),
        "edged: /proc/new: cannot be written into /proc: No such file or directory",
    ),
    "backup without rights": Bad(
        "backup cell.toml -o /proc/new.tar.gz",
        "edged: /proc/new.tar.gz: cannot be written into /proc: No such file or directory",
    ),
    "restored where a file is": Bad(
        "restore a.tar.gz -o cell.toml",
        "edged: a.tar.gz: not a backup, or damaged: Not a gzipped file (b'te')",
        {"a.tar.gz": "text"},
    ),
    # --- edged watch ---
    "watch: no endpoint": Bad(
        "watch --connect 192.168.1.5",
        "edged: --connect '192.168.1.5': expected PROTOCOL/ADDRESS, for example tcp/192.168.10.20:7447",
    ),
    "watch: protocol": Bad(
        "watch --connect http/192.168.1.5:7447",
        "edged: --connect 'http/192.168.1.5:7447': expected one of tcp, tls, udp, quic, ws, serial,"
        " unixsock-stream, unixpipe, vsock before the /",
    ),
    "watch: no port": Bad(
        "watch --connect tcp/192.168.1.5",
        "edged: --connect 'tcp/192.168.1.5': expected tcp/HOST:PORT; the port is usually 7447",
    ),
    "watch: state": Bad(
        "watch --state BROKEN",
        "edged: --state 'BROKEN': expected one of FAULT, GONE, SETUP, STARTING, STOPPING, ?, BUSY, READY",
    ),
    "watch: name": Bad(
        "watch --cell a/b",
        "edged: --cell 'a/b': expected a cell's name (letters, digits, '_', '.', '-'), in which * "
        "and ? stand for others",
    ),
    "watch: half a pair": Bad(
        "watch --connect tls/127.0.0.1:1 --certificate a.pem",
        "edged: --certificate and --key belong together: expected both or none",
    ),
    "watch: no certificate": Bad(
        "watch --connect tls/127.0.0.1:1 --authority a.pem",
        "edged: a.pem: No such file or directory, expected PEM files that belong together",
    ),
    "watch: certificate without TLS": Bad(
        "watch --connect tcp/127.0.0.1:1 --authority a.pem",
        "edged: --connect tcp/127.0.0.1:1: expected tls/HOST:PORT with a certificate or an authority",
    ),
}


@pytest.fixture(scope="module")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cell's folder with configuration, rig, job and a pair."""
    path = tmp_path_factory.mktemp("cell")
    prepare_cell(path, VirtualCell(small_rig(), demo_part(), seed=11), DemoOptions(), gige=False)
    part = flange()
    for side, image in (("left", part.left), ("right", part.right)):
        cv2.imwrite(str(path / f"{side}.png"), image)
    return path


@pytest.fixture
def place(pristine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy that a case may spoil, as the current folder."""
    path = Path(shutil.copytree(pristine, tmp_path / "cell"))
    monkeypatch.chdir(path)
    monkeypatch.setenv("COLUMNS", "400")
    return path


@pytest.fixture(scope="module")
def busy() -> Iterator[int]:
    """A port in use."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield int(server.getsockname()[1])


def spoil(path: Path, change: Change, busy: int) -> None:
    """Apply the change."""
    if callable(change):
        change(path)
    elif isinstance(change, bytes):
        path.write_bytes(change)
    elif isinstance(change, str):
        path.write_text(change)
    else:
        text = path.read_text()
        assert change[0] in text
        path.write_text(text.replace(change[0], change[1].replace("BUSY", str(busy)), 1))


def plain(said: str, place: Path, busy: int) -> str:
    """The message without frames, the same for any folder."""
    said = re.sub(r"[╭╮╰╯│─]+", " ", said).replace(str(place), "~").replace(str(busy), "BUSY")
    said = said.replace("python -m pytest.edged", "edged")
    return "\n".join(" ".join(line.split()) for line in said.splitlines() if line.strip())


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_mistake_is_named(name: str, place: Path, busy: int, capsys: pytest.CaptureFixture[str]) -> None:
    """The message is exactly as listed, with the documented exit status."""
    case = CASES[name]
    for file, change in case.files.items():
        spoil(place / file, change, busy)
    code, said = exit_code(*case.command.split()), capsys.readouterr()
    answer = plain(said.err + said.out, place, busy)

    assert (case.message, case.code) == (answer, code)


@pytest.mark.slow
def test_of_registers_that_nobody_serves_one_line_is_said() -> None:
    """No line of the Modbus library stands beside it."""
    asked = [sys.executable, "-m", "edged", "registers", "--read", "127.0.0.1:9"]
    run = subprocess.run(asked, capture_output=True, text=True, timeout=60)
    assert "edged: --read 127.0.0.1:9: nothing answers at 127.0.0.1, port 9\n" == run.stderr


@pytest.mark.long
def test_a_port_in_use_is_named(place: Path, busy: int) -> None:
    """The daemon's error names the address and how to find out what uses it."""
    spoil(place / "cell.toml", ("port = 1502", "port = BUSY"), busy)
    run = subprocess.run(
        [sys.executable, "-m", "edged", "run", "cell.toml"], capture_output=True, text=True, timeout=60
    )

    assert 2 == run.returncode
    message = f"the port is in use; `ss -ltnp sport = :{busy}` shows by whom"
    assert f"edged: modbus: cannot listen on 127.0.0.1:{busy}: {message}" == run.stderr.splitlines()[-1]


def test_the_table_is_long_enough_to_be_of_use() -> None:
    """There are more than 100 cases."""
    assert len(CASES) > 100
