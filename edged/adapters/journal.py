"""Log of the daemon: structured entries in systemd's journal, or lines on stderr without it.

Entries go to journald's own socket, each with fields to search for:

    journalctl -u edged EDGED_CYCLE=4711        # everything about one cycle
    journalctl -u edged EDGED_FAULT=101 -o json # a fault by the code that the PLC reads

A journal that does not accept an entry at once never stops the cell: lost entries are counted, and the next
entry says how many.
Source: systemd.io/JOURNAL_NATIVE_PROTOCOL, systemd.exec(5) on JOURNAL_STREAM.
"""

from __future__ import annotations

import atexit
import logging
import os
import socket
import struct
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TextIO

from edged import __version__
from edged.logs import RepeatLimit, fields_of

SOCKET = Path("/run/systemd/journal/socket")
MAX_VALUE_BYTES = 32_768
"""Longer values are cut, as an entry must fit into one datagram (the default send buffer is 208 KiB)."""

PRIORITIES = (
    (logging.CRITICAL, 2),
    (logging.ERROR, 3),
    (logging.WARNING, 4),
    (logging.INFO, 6),
)
"""Lowest level and its priority of syslog(3); below all of them: 7, debug."""


def set_up_logging(
    cell: str | None = None,
    level: int = logging.INFO,
    *,
    environment: Mapping[str, str] | None = None,
    journal: Path = SOCKET,
) -> None:
    """Log to the journal if stderr is connected to it and its socket can be reached, else to stderr.

    cell : for the field EDGED_CELL. Replaces all handlers set up before.
    """
    handler: logging.Handler = _CurrentStderr()
    if not _leads_to_journal(environment or os.environ):
        handler.setFormatter(_TerminalFormatter("%(asctime)s %(levelname)-7s %(name)s: %(message)s"))
    else:
        try:
            handler = JournalHandler(journal, cell)
        except OSError:  # the socket is missing in this container: use lines with priorities instead
            handler.setFormatter(_PrefixFormatter("%(name)s: %(message)s"))
    limit = RepeatLimit(partial(_emit, handler))
    handler.addFilter(limit)
    # report suppressed messages at exit, before `logging` closes its handlers
    atexit.register(limit.tell)
    for old in tuple(logging.root.handlers):
        logging.root.removeHandler(old)
        old.close()
    logging.basicConfig(level=level, handlers=[handler])


def _emit(handler: logging.Handler, record: logging.LogRecord) -> None:
    """Write a record, bypassing the handler's filters."""
    handler.acquire()
    try:
        handler.emit(record)
    finally:
        handler.release()


class _CurrentStderr(logging.StreamHandler[TextIO]):
    """Writes lines to the current `sys.stderr`, which a live table redirects to stay in its place."""

    def __init__(self) -> None:
        logging.Handler.__init__(self)

    @property
    def stream(self) -> TextIO:  # type: ignore[override]  # an attribute there, looked up anew here
        """The current stderr."""
        return sys.stderr


def priority(level: int) -> int:
    """Priority of syslog(3) for a level of `logging`."""
    return next((number for least, number in PRIORITIES if level >= least), 7)


class JournalHandler(logging.Handler):
    """Writes entries to journald. Raises `OSError` when its socket cannot be reached.

    cell : value of EDGED_CELL, None for none.
    """

    def __init__(self, address: Path, cell: str | None = None) -> None:
        super().__init__()
        self.setFormatter(logging.Formatter("%(message)s"))
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        try:
            self._socket.connect(str(address))
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        self._always = {"SYSLOG_IDENTIFIER": "edged", "EDGED_VERSION": __version__}
        if cell is not None:
            self._always["EDGED_CELL"] = cell
        self._lost = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Send an entry, or count it as lost."""
        try:
            entry = encode(self._entry(record))
        except Exception:  # noqa: BLE001 - as every handler of logging does: a bad log call is reported, not raised
            self.handleError(record)
            return
        try:
            self._socket.send(entry)
        except OSError:
            self._lost += 1
        else:
            self._lost = 0

    def _entry(self, record: logging.LogRecord) -> dict[str, object]:
        lost = f" ({self._lost} entries before this one were lost)" if self._lost else ""
        entry: dict[str, object] = {
            "MESSAGE": self.format(record) + lost,
            "PRIORITY": priority(record.levelno),
            "LOGGER": record.name,
            "CODE_FILE": record.pathname,
            "CODE_LINE": record.lineno,
            "CODE_FUNC": record.funcName or "",
            "THREAD_NAME": record.threadName or "",
            **self._always,
        }
        return entry | {f"EDGED_{name.upper()}": value for name, value in fields_of(record).items()}

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
        super().close()


def encode(entry: Mapping[str, object]) -> bytes:
    """Encode an entry in the native protocol: NAME=value, or with its length if a value has newlines."""
    parts = []
    for name, value in entry.items():
        data = str(value).encode(errors="replace")
        if len(data) > MAX_VALUE_BYTES:
            data = data[:MAX_VALUE_BYTES] + b" ... (cut)"
        if b"\n" in data:
            parts.append(name.encode() + b"\n" + struct.pack("<Q", len(data)) + data + b"\n")
        else:
            parts.append(name.encode() + b"=" + data + b"\n")
    return b"".join(parts)


def _leads_to_journal(environment: Mapping[str, str]) -> bool:
    """Whether stderr is the journal, by the file that systemd names; a redirected stderr is another file."""
    try:
        status = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):  # stderr is closed, or not a file
        return False
    return environment.get("JOURNAL_STREAM") == f"{status.st_dev}:{status.st_ino}"


class _TerminalFormatter(logging.Formatter):
    """Appends the number of the cycle to a line."""

    def format(self, record: logging.LogRecord) -> str:
        number = fields_of(record).get("cycle")
        return super().format(record) + ("" if number is None else f" [cycle {number}]")


class _PrefixFormatter(logging.Formatter):
    """Prefixes lines with their priority, <N> by sd-daemon(3)."""

    def format(self, record: logging.LogRecord) -> str:
        prefix = f"<{priority(record.levelno)}>"
        return "\n".join(prefix + line for line in super().format(record).splitlines())
