"""DRL's functions of sockets, as the "Doosan Robotics Programming Manual" tells them; DRL is Python."""

from __future__ import annotations

import ast
import socket
import time
from types import SimpleNamespace
from typing import Any


class Controller:
    """Sockets. piece : bytes that the network brings at a time."""

    def __init__(self, port: int, piece: int = 1024) -> None:
        self.port = port
        self.piece = piece
        self.links: list[socket.socket] = []

    def client_socket_open(self, ip: str, port: int) -> socket.socket:
        """Tries until it is connected; the test's listener is there."""
        assert ("192.168.10.20", 1503) == (ip, port)
        link = socket.create_connection(("127.0.0.1", self.port), timeout=5)
        self.links.append(link)
        return link

    def client_socket_close(self, link: socket.socket) -> int:
        """Of an open one."""
        self.links.remove(link)
        link.close()
        return 0

    def client_socket_write(self, link: socket.socket, data: bytes) -> int:
        """-2: an error of the socket."""
        assert isinstance(data, bytes) and link in self.links
        try:
            link.sendall(data)
        except OSError:
            return -2
        return 0

    def client_socket_read(
        self, link: socket.socket, length: int, timeout: float
    ) -> tuple[int, bytes | None]:
        """What has come; -1 hung up, -2 an error, -3 nothing in time."""
        assert length == -1 and timeout > 0 and link in self.links
        link.settimeout(timeout)
        try:
            data = link.recv(self.piece)
        except TimeoutError:
            return -3, None
        except OSError:
            return -2, None
        return (len(data), data) if data else (-1, None)

    def close(self) -> None:
        """Power off."""
        for link in self.links:
            link.close()
        self.links.clear()


def load(source: str, controller: Controller) -> dict[str, Any]:
    """Names that the script defines; it imports nothing, and has no syntax beyond Python 3.2."""
    tree = ast.parse(source, feature_version=(3, 7))
    banned = (ast.Import, ast.ImportFrom, ast.JoinedStr, ast.NamedExpr, ast.AnnAssign)
    assert not any(isinstance(node, banned) for node in ast.walk(tree))
    names: dict[str, Any] = {
        "time": SimpleNamespace(time=time.monotonic),
        **{name: getattr(controller, name) for name in dir(controller) if name.startswith("client_")},
    }
    exec(compile(tree, "edged.drl", "exec"), names)
    return names
