"""An audit with a journald of its own: outcome of `edged audit --against journal` after each action.

unshare --mount python -m helpers.journaledcell FOLDER; prints one JSON object: by step [exit code, output].
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import logging
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from edged.adapters.journal import SOCKET, encode, set_up_logging
from edged.adapters.web.auditing import Auditor
from edged.commands.audit import audit
from edged.files.statefolder import state_folder
from edged.identity.audit import AuditEntry, AuditFile
from helpers.waiting import LIMIT_S

JOURNALD = Path("/usr/lib/systemd/systemd-journald")
CELL = "[cell]\nname = 'c'\nrig = 'rig.json'\njobs = 'jobs'\njob = 'a'\n[cameras]\nsource = 'virtual'\n"
DEED = AuditEntry("Anna", "engineer", "10.0.0.7", "POST", "setup", "ok")
DEEDS = 25
"""More than the limit on identical lines logged at a time."""
STRANGER = 65534


def main(folder: Path) -> None:
    """Run journald, the actions and the command."""
    for place in ("/run", "/var/log"):
        subprocess.run(["mount", "-t", "tmpfs", "none", place], check=True)
    settings = Path("/run/systemd/journald.conf.d/test.conf")
    settings.parent.mkdir(parents=True)
    settings.write_text("[Journal]\nStorage=volatile\nAudit=no\nReadKMsg=no\nForwardToWall=no\n")
    SOCKET.parent.mkdir(parents=True)
    with subprocess.Popen([JOURNALD]) as journald:
        try:
            end_s = time.monotonic() + LIMIT_S
            while not SOCKET.exists() and time.monotonic() < end_s:
                time.sleep(0.02)
            print(json.dumps(_steps(folder)))
        finally:
            journald.terminate()


def _steps(folder: Path) -> dict[str, tuple[int, str]]:
    config = folder / "cell.toml"
    config.write_text(CELL)
    state = state_folder(config)
    about = os.fstat(sys.stderr.fileno())
    set_up_logging("c", environment={"JOURNAL_STREAM": f"{about.st_dev}:{about.st_ino}"})
    logging.getLogger("asyncio").setLevel(logging.WARNING)
    _done(state)
    kept = folder / "kept"
    found = {}

    def asked(step: str, act: Callable[[], object] = lambda: None) -> None:
        if kept.exists():
            shutil.rmtree(state, ignore_errors=True)
            shutil.copytree(kept, state)
        act()
        subprocess.run(["journalctl", "--sync"], check=True)
        output = io.StringIO()
        console = Console(file=output, width=1000)
        code = audit(config, console, as_json=False, last=0, against="journal")
        found[step] = (code, output.getvalue())

    asked("as it is")
    shutil.copytree(state, kept)
    asked("deleted", lambda: [file.unlink() for file in state.iterdir()])
    asked("deleted with its folder", lambda: shutil.rmtree(state))
    asked("another history", lambda: _another(state))
    asked("one more in the files", lambda: AuditFile(state).add(DEED))
    asked("a stranger's entries", _lie)
    shutil.rmtree(state)
    kept = folder / "full"
    state.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", state], check=True)
    _done_on_a_full_disc(state)
    shutil.copytree(state, kept)
    subprocess.run(["umount", state], check=True)
    found["a full disc"] = (0, AuditFile(kept).verify().records[-2]["reason"])
    return found


def _done_on_a_full_disc(state: Path) -> None:
    """Record one entry, lose two on a full disk, then record again once there is space."""
    auditor = Auditor(AuditFile(state))
    for fills in (False, True, True, False):
        if fills:
            with contextlib.suppress(OSError), (state / "other").open("ab", buffering=0) as other:
                while other.write(bytes(4096)):
                    pass
        else:
            (state / "other").unlink(missing_ok=True)
        auditor.post(DEED).result(LIMIT_S)
    asyncio.run(auditor.close())


def _done(state: Path) -> None:
    auditor = Auditor(AuditFile(state))
    for _ in range(DEEDS):
        auditor.post(DEED)
    asyncio.run(auditor.close())


def _another(state: Path) -> None:
    """A different chain that is valid and as long as the first one."""
    shutil.rmtree(state)
    for _ in range(DEEDS):
        AuditFile(state).add(AuditEntry("Ben", "engineer", "10.0.0.8", "POST", "setup", "ok"))


def _lie() -> None:
    """Another user of the machine forges a journal entry of the cell."""
    entry = {"SYSLOG_IDENTIFIER": "edged", "EDGED_CELL": "c", "EDGED_AUDIT": 3, "EDGED_AUDIT_HASH": "0" * 64}
    child = os.fork()
    if child == 0:
        os.setuid(STRANGER)
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as journal:
            journal.sendto(encode({"MESSAGE": "a lie", **entry}), str(SOCKET))
        os._exit(0)
    os.waitpid(child, 0)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
