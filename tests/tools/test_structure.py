"""The structure of the code: places, docstrings of files, and how many files a task reads."""

from __future__ import annotations

import ast
import pkgutil
import re
import socket
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

import pytest
from helpers import webcell
from helpers.cells import frame_pair, region_around
from helpers.livecell import LiveCell

import edged.sim
import edged.vision
from edged.adapters.modbus import LineSettings, ModbusSettings
from edged.pipeline import inspect, prepare
from edged.robot.orientations import Brand
from edged.sim.cell import VirtualCell, demo_part, demo_rig
from edged.vision.teaching.pair import teach

ROOT = Path(__file__).parents[2]
EDGED = ROOT / "edged"
SOURCES = sorted(EDGED.rglob("*.py"))
PACKAGES = sorted({source.parent for source in SOURCES})
TESTS = sorted((ROOT / "tests").rglob("test_*.py"))
READ = sorted([*SOURCES, *(ROOT / "tests").rglob("*.py"), *(ROOT / "tools").glob("*.py")])
FACES = re.compile(r"\.|(adapters|plc)/\w+|files/(rigformats|jobs)")
"""Packages that are used by the names in their `__init__.py`; of all others the modules are named."""

MOST_FILES_ENTERED = 30
"""Files entered by `inspect` today; to read how a part is found one opens as many. The goal is 20. The joint
fit is two of them, its data and its step, because one file of 750 lines would be no easier; the effect of
broken rims is a third. What a face shows by chance is a file of the search."""

MOST_FILES_OF_A_REQUEST = {"ACK": 10, "GRASP": 10, "LOCATE": 31}
"""Files entered from a robot's line to its answer, by its command. LOCATE goes through the whole cycle."""

MOST_FILES_OF_A_CLICK = 12
"""Files of the page's process entered from a request that changes a user to the file with it: each answers a
question of its own: session, right, route."""

SUPPRESSION = re.compile(
    r"#\s*(?:type: ignore(?:\[[\w, -]+\])?|noqa(?:: [A-Z]+\d+(?:, [A-Z]+\d+)*)?)(?P<reason>.*)"
)


def _name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def _decorators(source: Path) -> Iterator[str]:
    """Names of the decorators of all functions of a file."""
    for node in ast.walk(ast.parse(source.read_text())):
        for decorator in getattr(node, "decorator_list", ()):
            called = decorator.func if isinstance(decorator, ast.Call) else decorator
            yield ast.unparse(called).rpartition(".")[2]


@pytest.mark.long
def test_every_kernel_is_compiled_by_warm() -> None:
    """Every module with kernels is in a package that `warm` compiles, so none is compiled when the cell
    starts."""
    walked = {
        module.name
        for package in (edged.vision, edged.sim)
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    }
    holding = {
        ".".join(source.relative_to(ROOT).with_suffix("").parts)
        for source in SOURCES
        if "kernel" in _decorators(source)
    }

    assert len(holding) > 20
    assert set() == holding - walked


def test_every_topic_of_setting_up_is_held_to_the_order_of_topics() -> None:
    """Every topic with routes, a service, work or a model of its own is in import-linter's contract."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (held,) = [contract["containers"] for contract in contracts if "(work)" in contract.get("layers", ())]
    topics = {
        path.parent.name for name in ("service", "work", "model") for path in EDGED.glob(f"setup/*/{name}.py")
    }

    assert {f"edged.setup.{topic}" for topic in topics} == set(held)


def test_a_package_says_what_it_is_and_nothing_else() -> None:
    """A package has a docstring and nothing else, except those that are used by their names."""
    for package in PACKAGES:
        tree = ast.parse((package / "__init__.py").read_text())
        is_face = FACES.fullmatch(str(package.relative_to(EDGED)))

        assert ast.get_docstring(tree), package
        assert is_face or len(tree.body) == 1, package


@pytest.mark.long
def test_every_test_states_a_truth() -> None:
    """Every test's docstring ends with a full stop and is unique in its file."""
    for path in TESTS:
        tests = [
            node
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_")
        ]
        stated = [ast.get_docstring(test) or "" for test in tests]

        assert [] == [test.name for test, text in zip(tests, stated, strict=True) if not text.endswith(".")]
        assert len(set(stated)) == len(stated), path


def _without_reason(text: str) -> list[int]:
    """Lines whose check is switched off without a reason, there or in a comment above."""
    lines = text.splitlines()
    found = []
    for number, line in enumerate(lines, 1):
        off = SUPPRESSION.search(line)
        above = lines[number - 2].strip() if number > 1 else ""
        if off and not re.search(r"\w{3}", off["reason"]) and not above.startswith("#"):
            found.append(number)
    return found


@pytest.mark.slow
def test_whoever_switches_a_check_off_says_why() -> None:
    """A switched off check has a reason on the same line, or in a comment above."""
    assert [] == [f"{path}:{line}" for path in READ for line in _without_reason(path.read_text())]


def test_the_search_for_reasons_finds_their_lack() -> None:
    """The search finds missing reasons for several codes, and none if a reason is in either place."""
    off, ignore = "# no" + "qa", "# type: " + "ignore"
    bare = f"a {off}: BLE001, ARG001\nb {off}\nc {ignore}[misc]\n"
    reasoned = f"d {off}: B1  (as asked)\n# because\ne {ignore}[misc]\n"

    assert [1, 2, 3] == _without_reason(bare + reasoned)


class _Trace:
    """The files of edged that a thread enters between the calls of `begin` and `end`."""

    def __init__(self) -> None:
        self.entered: set[str] = set()

    def begin(self) -> None:
        """Forget the former files."""
        self.entered = set()
        sys.setprofile(self._note)

    def _note(self, frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(str(EDGED)):
            self.entered.add(_name(Path(frame.f_code.co_filename)))

    def end(self, what: str) -> set[str]:
        """The entered files, printed for a run with `-s`."""
        sys.setprofile(None)
        print(f"{what}: {len(self.entered)} files entered:", *sorted(self.entered))
        return self.entered


@pytest.mark.long
def test_the_way_of_a_measurement_is_short() -> None:
    """From `inspect` to the demo's measured flange no more files are entered than today."""
    cell = VirtualCell(demo_rig(), demo_part())
    left, right, truth = cell.teach_pair()
    outline = max(truth.circles, key=lambda circle: circle.radius_mm)
    rig, region = prepare(cell.rig), region_around(cell.rig, outline.centre_mm, outline.radius_mm)
    job, pair = teach(left, right, rig.rectification, region, "flange"), frame_pair(left, right)
    assert 1 == len(inspect(pair, job, rig).measured)

    trace = _Trace()
    trace.begin()  # the other camera's thread does the same
    inspect(pair, job, rig)
    entered = trace.end("inspect")

    assert {"edged/pipeline.py", "edged/vision/part/measure.py"} < entered
    assert len(entered) <= MOST_FILES_ENTERED


async def test_the_way_of_a_click_is_short() -> None:
    """From a request that changes a user to the file with it no more files are entered than today."""
    trace = _Trace()
    async with webcell.running(visitor="Anna") as cell:
        for language in ("de", "en"):  # the first one imports
            trace.begin()
            assert 200 == (await cell.ask("PUT", "/api/v1/me", {"language": language}))[0]
            entered = trace.end("a click")
    assert {"edged/adapters/web/gate.py", "edged/identity/users.py"} <= entered
    assert len(entered) <= MOST_FILES_OF_A_CLICK


def test_the_way_of_a_robots_request_is_short() -> None:
    """From a line on the socket to its answer no more files are entered than today."""
    settings = ModbusSettings(port=0, validity_s=30.0, line=LineSettings(0, Brand.KUKA))
    trace = _Trace()
    with (
        LiveCell(settings) as cell,
        socket.create_connection(("127.0.0.1", cell.server.line_port), timeout=15) as robot,
        robot.makefile("rb") as answers,
    ):
        robot.sendall(b"1,LOCATE,0\n")  # prepares what is encoded with
        assert answers.readline().startswith(b"1,")
        for sequence, (command, most) in enumerate(MOST_FILES_OF_A_REQUEST.items(), 2):
            cell.call(trace.begin)
            robot.sendall(f"{sequence},{command},0\n".encode())
            assert answers.readline().startswith(f"{sequence},".encode())
            entered = cell.call(lambda command=command: trace.end(command))
            assert {"edged/adapters/modbus/lines.py", "edged/plc/handshake.py"} <= entered
            assert len(entered) <= most


def test_lines_imports_and_signatures_are_counted_as_described(tmp_path: Path) -> None:
    """The tool of the table in CONTRIBUTING counts lines, imports and signatures: no comment as line, no
    loose module as folder."""
    files = {
        "edged/a/one.py": '"""Doc."""\n\nfrom edged.b import two  # why\nfrom edged.loose import it\n',
        "edged/b/two.py": "X = [\n    1,\n]\n\ndef f(a, b, c, d, e, f, g, h, i): ...\n",
        "edged/loose.py": "import edged.a.one\n",
        "tools/bench": "#!/usr/bin/env python\nimport edged.b.two\n",
        "tests/none.txt": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    ran = subprocess.run(
        [sys.executable, ROOT / "tools/structure.py", tmp_path], capture_output=True, text=True, check=True
    )
    assert "folders of edged with tools: 3 in 2 layers, 2 imports between them" in ran.stdout
    assert "functions of edged: 1, with more than 8 parameters: 1" in ran.stdout
    assert "edged: 3 files, 7 lines of code, 10 in all" in ran.stdout
