"""The URScript that edged writes, run as Python: the two differ in `end` and in how poses are written.

There is no URScript interpreter outside the robot's controller. The translation is line by line and knows
only what the snippet uses; an unknown line is an error. Numbers are checked to fit the 32-bit
integers of the controller.
"""

from __future__ import annotations

import ast
import math
import re
import time
from typing import Any

import numpy as np
from pymodbus.client import ModbusTcpClient

from edged.robot.orientations import Brand, pose_of, transform_of
from helpers.drl import declared
from helpers.robotlink import standing

OPENS = re.compile(r"(def|if|while) .+:$")
ELSE = re.compile(r"(elif .+|else):$")
STATEMENT = re.compile(r"(return .+|(local |global )?\w+(\[\w+\])? = .+|\w+\(.*\))$")


def translate(source: str) -> str:
    """Python with the same meaning."""
    lines: list[str] = []
    names = set(re.findall(r"^global (\w+) =", source, re.M))
    depth = 0
    for number, raw in enumerate(source.splitlines(), start=1):
        line = raw.strip()
        if not line or line.startswith("#"):
            continue
        if line == "end":
            depth -= 1
            assert depth >= 0, f"line {number}: end without a beginning"
            continue
        if ELSE.match(line):
            assert len(raw) - len(raw.lstrip()) == 4 * (depth - 1), f"line {number}: indentation"
            lines.append("    " * (depth - 1) + line)
            continue
        assert OPENS.match(line) or STATEMENT.match(line), f"line {number}: {line}"
        assert len(raw) - len(raw.lstrip()) == 4 * depth, f"line {number}: indentation"
        text = re.sub(r"\bp\[", "pose[", line)
        text = re.sub(r"^(local|global) ", "", text)
        lines.append("    " * depth + text)
        if OPENS.match(line):
            depth += 1
            if line.startswith("def"):
                lines.append("    global " + ", ".join(sorted(names)))
    assert depth == 0, "a block has no end"
    return "\n".join(lines) + "\n"


class _Pose:
    def __getitem__(self, values: tuple[float, ...]) -> tuple[float, ...]:
        assert len(values) == 6
        return values


POSE = _Pose()
"""Object that stands for URScript's p[...] in a translated program."""


def load(source: str, builtins: dict[str, Any]) -> dict[str, Any]:
    """Names that the script defines, run with the given functions of the controller."""
    names: dict[str, Any] = {"pose": POSE, **builtins}
    tree = ast.parse(translate(source))
    declared(tree, "urscript")
    exec(compile(tree, "edged.script", "exec"), names)
    return names


class Controller:
    """The robot controller's Modbus client, as PolyScope's Script Manual describes it.

    Signals are read and written at their update frequency while the program sleeps, whether it asks or not,
    and written repeatedly once they were set; a program sees the value read last.
    """

    def __init__(self, port: int) -> None:
        self._port = port
        self.arm = standing()
        self._inputs: dict[str, tuple[int, int, list[int]]] = {}
        self._outputs: dict[str, tuple[int, int, list[int]]] = {}
        self._frequencies: dict[str, int] = {}
        self.connect()

    def connect(self) -> None:
        """Reconnect; the program is not informed."""
        self._client = ModbusTcpClient("127.0.0.1", port=self._port, timeout=2)
        assert self._client.connect()
        self.linked = True

    def builtins(self) -> dict[str, Any]:
        """Functions that URScript calls."""
        return {
            "get_actual_tool_flange_pose": lambda: pose_of(Brand.UR, self.arm.flange),
            "pose_trans": lambda first, then: pose_of(
                Brand.UR, transform_of(Brand.UR, first) @ transform_of(Brand.UR, then)
            ),
            "pose_inv": lambda pose: pose_of(Brand.UR, np.linalg.inv(transform_of(Brand.UR, pose))),
            "floor": math.floor,
            "sleep": self._sleep,
            "sync": lambda: None,
            "modbus_add_signal": self._add,
            "modbus_set_signal_update_frequency": self._frequencies.__setitem__,
            "modbus_set_signal_watchdog": lambda name, _s: self._frequencies[name],
            "modbus_get_signal_status": lambda name, _secondary: list(self._inputs[name][2]),
            "modbus_set_output_register": self._set,
        }

    def _add(
        self, ip: str, unit: int, address: int, kind: int, name: str, sequential: bool, count: int
    ) -> None:
        assert ("192.168.10.20", 1, False) == (ip, unit, sequential)
        assert 1 <= len(name) <= 20 and 1 <= count <= 123
        self._frequencies.pop(name, None)
        if kind == 2:
            self._inputs[name] = (address, count, [0] * count)
        else:
            assert kind == 16
            self._outputs[name] = (address, count, [])

    def _set(self, name: str, words: list[int], _secondary: bool) -> None:
        address, count, _ = self._outputs[name]
        assert len(words) == count and all(type(word) is int and 0 <= word <= 65535 for word in words)
        self._outputs[name] = (address, count, list(words))

    def _sleep(self, seconds: float) -> None:
        # the program waits 1 s for a heartbeat, which the cell counts every 0.1 s however fast the robot is
        time.sleep(seconds / 4)
        self.refresh()

    def refresh(self) -> None:
        """Write and read each signal once."""
        assert self._frequencies.keys() == self._inputs.keys() | self._outputs.keys(), "explicit frequencies"
        if not self.linked:
            return
        for address, _, words in self._outputs.values():
            if words:
                assert not self._client.write_registers(address, words).isError()
        for name, (address, count, _) in self._inputs.items():
            words = self._client.read_input_registers(address, count=count).registers
            self._inputs[name] = (address, count, words)

    def __enter__(self) -> Controller:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._client.close()
