"""Detects this cell's own daemon and its state; if it runs, it rightly holds ports and cameras."""

from __future__ import annotations

import json
import os
import re
import socket
import ssl
import struct
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from edged.config.configuration import Config
from edged.doctor.findings import Check, ok, warn
from edged.doctor.host import at_home, run
from edged.plc.registers import CONSTANTS, MAGIC, decode

ANSWER_S = 2.0
MAX_BYTES = 64 * 1024
READ_HOLDING = 3


@dataclass(frozen=True, slots=True)
class OurDaemon:
    """The process that runs this cell's configuration.

    loaded : fingerprint of the files that it runs with; "" if unknown. ready : whether it would
    measure; None if unknown. why : why it would not.
    """

    process: int
    loaded: str
    ready: bool | None
    why: str

    @property
    def is_set_up(self) -> bool:
        """Whether a person holds the cell for SETUP and can see its pictures."""
        return self.why.startswith("setup by ")

    @property
    def has_cameras(self) -> bool:
        """Whether it controls the cameras."""
        return self.ready is not False or self.is_set_up

    def has(self, port: int) -> bool:
        """Whether it or a descendant listens on a port; True if the listener's process is not visible."""
        listeners = run("ss", "-Hltnp", f"sport = :{port}") or ""
        processes = re.findall(r"pid=([0-9]+)", listeners)
        if not processes:
            return bool(listeners.strip())
        return any(self.process in _with_parents(int(process)) for process in processes)

    def look(self, fingerprint: str) -> Check:
        """Check its state. fingerprint : of the present files; "": they cannot be read."""
        name, text = "daemon", f"this cell's own runs, process {self.process}"
        if self.loaded and fingerprint and self.loaded != fingerprint:
            return warn(
                name,
                f"{text}, by configuration {self.loaded}; the files are {fingerprint} now",
                "what was changed does not count yet",
                f"sudo systemctl reload edged   (in a terminal: kill -HUP {self.process})",
                "reload",
            )
        if self.is_set_up:
            return ok(name, f"{text}, {self.why}")
        if self.ready is False:
            return warn(
                name,
                f"{text}, and is not ready: {self.why or 'it does not say why'}",
                "a trigger is refused",
                "edged status; journalctl -u edged -e",
            )
        return ok(name, text + (", ready" if self.ready else ""))


def our_daemon(path: Path, config: Config, process: int | None = None) -> OurDaemon | None:
    """Return the daemon that runs this configuration file on this machine; None if there is none.

    process : its id, if known; it need not be visible then.
    """
    process = next(_running(path), None) if process is None else process
    if process is None:
        return None
    ready, why = _readiness(config)
    return OurDaemon(process, _loaded(config), ready, why)


def _running(path: Path) -> Iterator[int]:
    """Yield processes that were started as `edged run` or `edged demo` with this file or its folder."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = [os.fsdecode(word) for word in (folder / "cmdline").read_bytes().split(b"\0")[:-1]]
            starts = [place for place, word in enumerate(words) if "edged" in Path(word).name]
            command = words[starts[0] + 1 :] if starts else []
            if int(folder.name) == os.getpid() or command[:1] not in (["run"], ["demo"]):
                continue
            if any(_names(word, folder, path) for word in command[1:]):
                yield int(folder.name)
        except OSError:  # it may just have ended
            continue


def _names(word: str, process: Path, path: Path) -> bool:
    """Whether an argument of a process is this file or its folder."""
    try:
        named = Path(word) if Path(word).is_absolute() else (process / "cwd").readlink() / word
        return named.samefile(path) or named.samefile(path.parent)
    except OSError:  # no such file, or a process of another user
        return False


def _with_parents(process: int) -> Iterator[int]:
    """Yield the process and all its ancestors."""
    while process > 1:
        yield process
        try:
            process = int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError, IndexError):
            return


def _readiness(config: Config) -> tuple[bool | None, str]:
    """Return readiness and reason from the page, which needs no password for them."""
    if config.web is None:
        return None, ""
    secure = config.web.certificate is not None
    host = at_home(config.web.host)
    place = f"[{host}]" if ":" in host else host
    url = f"{'https' if secure else 'http'}://{place}:{config.web.port}/ready"
    context = ssl.create_default_context()
    context.check_hostname = False  # no secret is sent, and the certificate may be for another name
    context.verify_mode = ssl.CERT_NONE
    try:
        with urllib.request.urlopen(url, timeout=ANSWER_S, context=context) as answer:
            body = answer.read(MAX_BYTES)
    except urllib.error.HTTPError as error:
        body = error.read(MAX_BYTES)
    except (OSError, ValueError):
        return None, ""
    try:
        document = json.loads(body)
        return bool(document["ready"]), str(document["error"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return None, ""


def _loaded(config: Config) -> str:
    """Return the fingerprint from the registers; "" if they cannot be read."""
    modbus = config.modbus
    if not modbus.enabled or modbus.tls is not None:
        return ""
    request = (modbus.base_address + CONSTANTS.address, CONSTANTS.words)
    length = 9 + 2 * CONSTANTS.words
    try:
        with socket.create_connection((at_home(modbus.host), modbus.port), ANSWER_S) as line:
            line.settimeout(ANSWER_S)
            line.sendall(struct.pack(">HHHBBHH", 1, 0, 6, modbus.unit_id, READ_HOLDING, *request))
            answer = line.recv(length, socket.MSG_WAITALL)
    except OSError:
        return ""
    if len(answer) != length or answer[7] != READ_HOLDING:
        return ""
    values = decode(CONSTANTS, struct.unpack(f">{CONSTANTS.words}H", answer[9:]), modbus.word_order)
    return f"{int(values['CONFIG_CRC']):08x}" if values["MAGIC"] == MAGIC else ""
