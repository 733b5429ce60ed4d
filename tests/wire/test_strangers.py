"""The daemon with a shell's 1024 descriptors, and more connections of strangers than that."""

from __future__ import annotations

import contextlib
import json
import resource
import socket
import struct
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.smallcell import DaemonProcess, SmallCell
from helpers.waiting import LIMIT_S, wait_until

DESCRIPTORS = 1024
STRANGERS = 1100
PLC = "127.0.0.9"


@contextlib.contextmanager
def descriptors(wanted: int) -> Iterator[None]:
    """Set this process's limit of descriptors within the context."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


def magic(port: int) -> bool:
    """Whether a new connection of the PLC reads the first register."""
    with socket.socket() as plc, contextlib.suppress(OSError):
        plc.bind((PLC, 0))
        plc.settimeout(LIMIT_S)
        plc.connect(("127.0.0.1", port))
        plc.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 0, 1))
        return len(plc.recv(100)) == 11
    return False


def is_ready(port: int) -> bool:
    """What /ready answers."""
    with (
        contextlib.suppress(OSError),
        urllib.request.urlopen(f"http://127.0.0.1:{port}/ready", timeout=LIMIT_S) as answer,
    ):
        return bool(json.load(answer)["ready"])
    return False


@pytest.mark.long
def test_more_strangers_than_descriptors_take_nothing_from_the_cell(tmp_path: Path) -> None:
    """With 1100 strangers each at page, Zenoh and Modbus, the PLC connects, recordings go on, the log stays
    short, and READY returns."""
    cell = SmallCell(tmp_path / "cell", recordings=tmp_path / "recordings", period_s=0.2)
    text = cell.config.read_text().replace("[modbus]\n", f'[modbus]\nreserved = {{ "{PLC}" = 2 }}\n', 1)
    cell.config.write_text(text)

    def newest() -> int:
        return max(
            (int(path.name[:9]) for path in (tmp_path / "recordings" / "cycles").glob("*.zip")), default=-1
        )

    daemon = DaemonProcess(cell.config)
    try:
        daemon.wait_ready()
        resource.prlimit(daemon.process.pid, resource.RLIMIT_NOFILE, (DESCRIPTORS, DESCRIPTORS))
        for port in (cell.web_port, cell.zenoh_port, cell.modbus_port):
            with descriptors(2 * STRANGERS), contextlib.ExitStack() as strangers:
                for _ in range(STRANGERS):
                    one = strangers.enter_context(socket.socket())
                    one.settimeout(LIMIT_S)
                    with contextlib.suppress(OSError):
                        one.connect(("127.0.0.1", port))
                wait_until(lambda: magic(cell.modbus_port))
                before = newest()
                wait_until(lambda before=before: newest() > before + 1)
                wait_until(lambda: is_ready(cell.web_port))
        assert daemon.process.poll() is None
    finally:
        daemon.stop()

    assert 30 > len(daemon.log), "\n".join(daemon.log)
    assert not [line for line in daemon.log if "Traceback" in line]
