"""INFORM and MotoPlus as Yaskawa's controllers run them, as far as `edged registers --format motoplus` needs.

The job is interpreted after the form of public jobs and from memory of "INFORM II" (`SET`, `INC`, `JUMP ...
IF`, `TIMER`, `GETS`, `SETE`; I of 16 bits, D of 32, positions in 0.001 mm and 0.0001 degrees). The task is
compiled by the machine's C compiler, with the header and the controller in `tests/helpers/motoplus`, and runs
as a process of its own.
"""

from __future__ import annotations

import re
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np

from edged.domain.arrays import FloatArray
from edged.robot.orientations import Brand, pose_of, transform_of
from helpers.robotlink import Link
from helpers.robotwords import Declared
from helpers.waiting import LIMIT_S, WHOLE_S

HERE = Path(__file__).parent / "motoplus"
WAITS, SENT, FAILS, READS, PLACE, NUMBERS = 200, 201, 202, 203, 210, 256
STRICT = (
    "-std=gnu89",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-Wdeclaration-after-statement",
)


def translate(source: str, folder: Path) -> Path:
    """Compile the task and its controller into a program. Fails with the compiler's output."""
    (folder / "edged.c").write_text(source, "ascii")
    made = folder / "controller"
    files = [str(folder / "edged.c"), str(HERE / "controller.c")]
    command = ["gcc", *STRICT, f"-I{HERE}", *files, "-o", str(made), "-lpthread"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=WHOLE_S, check=False)
    assert 0 == done.returncode, done.stderr
    return made


class Controller:
    """Variables, the running task, and one job."""

    def __init__(self, program: Path, memory: Path, job: str, link: Link) -> None:
        self.link = link
        memory.write_bytes(bytes(4 * NUMBERS))
        self.memory = np.memmap(memory, np.int32, "r+")
        self.command = [str(program), str(memory), str(link.port), str(link.piece)]
        self.task: subprocess.Popen[bytes] | None = None
        self.positions: dict[int, np.ndarray] = {}
        self.moves: list[np.ndarray] = []
        self.here = np.arange(6)
        self.declared = Declared("inform")
        self.lines = self._read(job)
        self._waited: int | None = None
        self._sent = 0

    def _read(self, job: str) -> list[str]:
        assert job.isascii() and job.endswith("\r\n")
        head, _, text = job.replace("\r\n", "\n").partition("\nNOP\n")
        expected = "/JOB //NAME EDGED //POS ///NPOS 0,0,0,0,0,0 //INST ///DATE ///ATTR SC,RW ///GROUP1 RB1"
        assert expected.split() == re.sub(r"(///DATE) \d{4}/\d\d/\d\d \d\d:\d\d", r"\1", head).split()
        lines = text.splitlines()
        assert "END" == lines[-1]
        for name in ("EDGED", *(line[1:] for line in lines if line.startswith("*"))):
            self.declared(name)
        return lines

    def _switch_on(self) -> subprocess.Popen[bytes]:
        """Start the task; returns after its first look at the pending request; its first accesses fail."""
        self.memory[[WAITS, FAILS, READS]] = 0, 7, 0
        task = subprocess.Popen(self.command, stdin=subprocess.PIPE)
        deadline_s = time.monotonic() + LIMIT_S
        while not self.memory[READS]:
            assert time.monotonic() < deadline_s and task.poll() is None
            time.sleep(0.001)
        return task

    def number(self, name: str) -> int:
        """Value of a variable or a literal."""
        if name.lstrip("-").isdigit():
            return int(name)
        found = re.fullmatch(r"([ID])(\d{3})", name)
        assert found is not None and int(found[2]) < 100, name
        return int(self.memory[int(found[2]) + 100 * (found[1] == "D")])

    def put(self, name: str, value: int) -> None:
        """Write an I variable."""
        assert re.fullmatch(r"I0\d\d", name) and -32768 <= value < 32768, name
        self.memory[int(name[1:])] = value

    def call(self) -> None:
        """CALL JOB:EDGED."""
        self.task = self.task or self._switch_on()
        is_tip = self.number("I080") == 12  # PLACE asks where tool 1 is
        numbers = np.array(pose_of(Brand.YASKAWA, self.link.arm.tip if is_tip else self.link.arm.flange))
        self.memory[PLACE : PLACE + 6] = np.rint(numbers * ([1e3] * 3 + [1e4] * 3))
        self._sent, self._waited = int(self.memory[SENT]), None
        self.run(self.lines)

    def run(self, lines: list[str]) -> None:
        """Execute instructions up to END."""
        at = 0
        while (line := lines[at]) != "END":
            at += 1
            if line.startswith(("*", "NOP", 'MSG "')):
                continue
            if found := re.match(r"JUMP (\*[A-Z]{1,8})(?: IF (\w+)(=|<|>=|<>)(\w+))?$", line):
                if not found[2] or self._holds(*found.groups()[1:]):
                    at = lines.index(found[1])
            elif found := re.match(r"SET (I\d{3}) (\w+)$", line):
                self.put(found[1], self.number(found[2]))
            elif found := re.match(r"INC (I\d{3})$", line):
                self.put(found[1], self.number(found[1]) + 1)
            elif line == "CALL JOB:EDGED":
                self.call()
            elif found := re.match(r"MOVL P(\d{3}) V=\d+\.\d$", line):
                self.moves.append(self.positions[int(found[1])])
            elif found := re.match(r"MULMAT P(\d{3}) P(\d{3}) P(\d{3})$", line):
                target, one, other = map(int, found.groups())
                pose = self._matrix(self.positions[one]) @ self._matrix(self.positions[other])
                numbers = np.array(pose_of(Brand.YASKAWA, pose))
                self.positions[target] = np.rint(numbers * ([1e3] * 3 + [1e4] * 3))
            elif line == "TIMER T=0.010":
                self._pause(0.01)
            elif found := re.match(r"GETS PX(\d{3}) \$PX001$", line):
                self.positions[int(found[1])] = self.here.copy()
            else:
                found = re.match(r"SETE P(\d{3}) \(([1-6])\) (D\d{3})$", line)
                assert found is not None, f"no instruction: {line}"
                self.positions[int(found[1])][int(found[2]) - 1] = self.number(found[3])

    @staticmethod
    def _matrix(position: Any) -> FloatArray:
        return transform_of(Brand.YASKAWA, tuple((np.asarray(position) / ([1e3] * 3 + [1e4] * 3)).tolist()))

    def _holds(self, left: str, mark: str, right: str) -> bool:
        one, other = self.number(left), self.number(right)
        return {"=": one == other, "<": one < other, ">=": one >= other, "<>": one != other}[mark]

    def _pause(self, duration_s: float) -> None:
        """Wait as `Link` does, whose socket belongs to the task here."""
        assert self.task and self.task.poll() is None, "the task has ended"
        end_s = self.link.now_s() + duration_s
        while self.link.now_s() < end_s and not self._holds("I086", "=", "I085") and not self._is_silent():
            time.sleep(0.001)
        self.link.jump(end_s)

    def _is_silent(self) -> bool:
        """Whether the task has looked for data since the other end finished sending."""
        sent, waited = int(self.memory[SENT]), int(self.memory[WAITS])
        if sent == self._sent or not self.link.is_done(sent):
            self._waited = None
            return False
        if self._waited is None:
            self._waited = waited
        return waited >= self._waited + 2  # one of these looks may have begun earlier

    def close(self) -> None:
        """Power off."""
        if self.task:
            self.task.communicate(b"\n", timeout=WHOLE_S)
            self.task = None
