"""A repository of signed releases, made with the commands, and a static HTTPS server for it."""

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
    """Folders `keys` and `repository` below a folder; the passphrase is in EDGED_PASSPHRASE."""

    def __init__(self, folder: Path) -> None:
        self.keys, self.repository = folder / "keys", folder / "repository"

    def private(self, name: str) -> Path:
        """Path of a private key."""
        return self.keys / f"{name}.key"

    def public(self, name: str) -> Path:
        """Path of its public key."""
        return self.keys / f"{name}.pub"

    @property
    def root(self) -> Path:
        """Path of the root of trust."""
        return self.repository / "metadata" / "1.root.json"

    def run(self, verb: str, *arguments: object, key: str) -> int:
        """Run a release command with the given key."""
        return exit_code("release", verb, self.repository, *arguments, "--key", self.private(key))

    def make(self) -> None:
        """Create the repository: two of three root keys sign; both plants have a key but nothing signed."""
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
        """Publish, so that cells see the release."""
        return self.run("publish", *arguments, key="online")

    def section(self, place: object | None = None) -> str:
        """The `[fleet]` section of a cell."""
        return SECTION.format(place=self.repository if place is None else place, root=self.root)


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *arguments: object) -> None:
        """Suppress the log."""


@contextmanager
def served(folder: Path, certificates: Path, port: int = 0) -> Iterator[str]:
    """Serve a folder at https://127.0.0.1:PORT; its CA is `ca.pem` among the certificates."""
    with over_tls(functools.partial(_Quiet, directory=str(folder)), certificates, port) as url:
        yield url


@contextmanager
def over_tls(handler: Callable[..., BaseRequestHandler], certificates: Path, port: int = 0) -> Iterator[str]:
    """Run a server at https://127.0.0.1:PORT; its CA is `ca.pem` among the certificates."""
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
