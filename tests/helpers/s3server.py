"""An S3 server (moto) in a process of its own; its data are lost when it ends."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

from pyarrow import fs

from helpers.ports import free_port
from helpers.waiting import wait_until

BUCKET = "cells"


class S3Server:
    """A server on a port of its own, with one bucket; can be killed and started again."""

    def __init__(self, log: Path) -> None:
        self.port = free_port()
        self._log = log
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def address(self) -> str:
        """Address in the form that a configuration uses."""
        return f"s3://{BUCKET}/history?endpoint_override=127.0.0.1:{self.port}&scheme=http"

    def start(self) -> None:
        """Start it, wait until it answers, and create the bucket."""
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(self.port)],
                stdout=log,
                stderr=log,
            )
        wait_until(self._answers)
        client = fs.S3FileSystem(
            endpoint_override=f"127.0.0.1:{self.port}", scheme="http", allow_bucket_creation=True
        )
        client.create_dir(BUCKET)

    def kill(self) -> None:
        """Kill it without warning."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def _answers(self) -> bool:
        with socket.socket() as connection:
            return connection.connect_ex(("127.0.0.1", self.port)) == 0
