"""DRL's socket and flange functions, as the "Doosan Robotics Programming Manual" describes them.

DRL is Python.
"""

from __future__ import annotations

import ast
from types import SimpleNamespace
from typing import Any

from edged.robot.orientations import Brand, pose_of
from helpers.robotlink import Link
from helpers.robotwords import Declared


class Controller:
    """The socket functions; a program has one connection at a time."""

    def __init__(self, link: Link) -> None:
        self.link = link

    def client_socket_open(self, ip: str, port: int) -> Link:
        """Connect; the real one retries until it succeeds, and the test's listener is there."""
        assert ("192.168.10.20", 1503) == (ip, port)
        assert self.link.open()
        return self.link

    def client_socket_close(self, link: Link) -> int:
        """Close an open socket."""
        assert link.is_open
        link.close()
        return 0

    def client_socket_write(self, link: Link, data: bytes) -> int:
        """Send; -2 is a socket error."""
        assert isinstance(data, bytes) and link.is_open
        return 0 if link.send(data) else -2

    def client_socket_read(self, link: Link, length: int, timeout: float) -> tuple[int, bytes | None]:
        """Length and received bytes; -1: the peer has closed, -3: nothing in time."""
        assert length == -1 and timeout > 0 and link.is_open
        data = link.receive(timeout)
        if data is None:
            return -3, None
        return (len(data), data) if data else (-1, None)

    def get_current_tool_flange_posx(self, ref: str) -> list[float]:
        """Flange pose, independent of the active tool."""
        assert ref == "base"
        return list(pose_of(Brand.DOOSAN, self.link.arm.flange))

    def close(self) -> None:
        """Power off."""
        self.link.close()


def declared(tree: ast.AST, language: str) -> Declared:
    """Names of functions, parameters and assigned variables; also used for URScript, parsed as Python."""
    names = Declared(language)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            names(node.name)
        elif isinstance(node, ast.arg):
            names(node.arg)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names(node.id)
    return names


def load(source: str, controller: Controller) -> dict[str, Any]:
    """Names that the script defines; it must not import and must not use syntax newer than Python 3.2."""
    tree = ast.parse(source, feature_version=(3, 7))
    banned = (ast.Import, ast.ImportFrom, ast.JoinedStr, ast.NamedExpr, ast.AnnAssign)
    assert not any(isinstance(node, banned) for node in ast.walk(tree))
    declared(tree, "drl")
    names: dict[str, Any] = {
        "time": SimpleNamespace(time=controller.link.now_s),
        **{
            name: getattr(controller, name)
            for name in dir(controller)
            if name.startswith(("client_", "get_"))
        },
        "DR_BASE": "base",
    }
    exec(compile(tree, "edged.drl", "exec"), names)
    return names
