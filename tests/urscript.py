"""The URScript that edged writes, run as Python: the two differ in `end` and in how poses are written.

There is no URScript interpreter outside the robot's controller. The translation is line by line and knows
only what the snippet uses; a line it does not know is an error. Numbers are checked to stay in the 32-bit
integers of the controller.
"""

from __future__ import annotations

import re
from typing import Any

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


def load(source: str, builtins: dict[str, Any]) -> dict[str, Any]:
    """Names that the script defines, with the controller's functions given."""
    names: dict[str, Any] = {"pose": _Pose(), **builtins}
    exec(compile(translate(source), "edged.script", "exec"), names)
    return names
