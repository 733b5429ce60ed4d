"""A repository of signed releases, made by the commands; and a static HTTPS server before it."""

from __future__ import annotations

import functools
import http.server
import ssl
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from socketserver import BaseRequestHandler

from helpers.certificates import make_certificates
from helpers.commandline import exit_code

PASSPHRASE = "correct horse battery"
KEYS = ("root1", "root2", "root3", "targets", "online", "north", "south")
PLANT = "north"
SECTION = """
[fleet]
repository = "{place}"
plant = "north"
root = "{root}"
"""


class Releases:
    """Folders `keys` and `repository` below a folder; the passphrase stands in EDGED_PASSPHRASE."""

    def __init__(self, folder: Path) -> None:
        self.keys, self.repository = folder / "keys", folder / "repository"

    def private(self, name: str) -> Path:
        """A private key."""
        return self.keys / f"{name}.key"

    def public(self, name: str) -> Path:
        """The public half."""
        return self.keys / f"{name}.pub"

    @property
    def root(self) -> Path:
        """The root of trust."""
        return self.repository / "metadata" / "1.root.json"

    def run(self, verb: str, *arguments: object, key: str) -> int:
        """A command of a key's owner."""
        return exit_code("release", verb, self.repository, *arguments, "--key", self.private(key))

    def make(self) -> None:
        """Two of three root keys sign; both plants have a key; nothing is signed by them."""
        self.keys.mkdir(parents=True)
        assert [0] * len(KEYS) == [exit_code("release", "key", self.private(name)) for name in KEYS]
        roots = [self.private("root1"), self.public("root2"), self.public("root3")]
        keys = [argument for key in roots for argument in ("--key", key)]
        counts = ("--targets", self.public("targets"), "--online", self.public("online"))
        assert 0 == exit_code("release", "root", self.repository, *keys, *counts)
        assert 0 == self.run("countersign", key="root2")
        assert 0 == self.run("delegate", PLANT, "--plant-key", self.public(PLANT), key="targets")

    def sign(self, name: str, *arguments: object, key: str = PLANT, plant: str = PLANT) -> int:
        """Sign a release."""
        return self.run("sign", plant, name, *arguments, key=key)

    def publish(self, *arguments: object) -> int:
        """Let cells see it."""
        return self.run("publish", *arguments, key="online")

    def section(self, place: object | None = None) -> str:
        """`[fleet]` of a cell."""
        return SECTION.format(place=self.repository if place is None else place, root=self.root)


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *arguments: object) -> None:
        """Say nothing."""


@contextmanager
def served(folder: Path, certificates: Path, port: int = 0) -> Iterator[str]:
    """A folder at https://127.0.0.1:PORT; its authority is `ca.pem` among the certificates."""
    with over_tls(functools.partial(_Quiet, directory=str(folder)), certificates, port) as url:
        yield url


@contextmanager
def over_tls(handler: Callable[..., BaseRequestHandler], certificates: Path, port: int = 0) -> Iterator[str]:
    """A server at https://127.0.0.1:PORT; its authority is `ca.pem` among the certificates."""
    if not certificates.exists():
        certificates.mkdir()
        make_certificates(certificates)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", port), handler)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificates / "server.pem", certificates / "server.key")
    server.socket = context.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    try:
        yield f"https://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
