"""A release takes the place of a cell's files. A failure leaves them as they were, a power cut one of both.

    installing.tar.gz   the release, from before its first file is written until the cell runs by it
    before.tar.gz       what the last one replaced, as `edged restore` reads it

The page hands a release over; what is in it is hostile until it is read here. This is done by a process of
the cell's own, with bounds of its own, so that neither the cell's loop nor its memory has to do with it:
`python -m edged.setup.releases.installing CONFIG DESCRIPTOR`. It writes, says so, and waits: for "undo" where
the cell cannot run by it, else for its end. It ends with the cell, at any moment.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import resource
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from queue import SimpleQueue

from edged.codec.plainerrors import plain_error
from edged.config.chosencameras import chosen_file
from edged.config.chosenconnections import connections_file
from edged.config.reading import load
from edged.errors import EdgedError, FileFormatError, UserError
from edged.files.atomic import make_folders, read_bytes, sync, write_atomically
from edged.files.statefolder import state_folder
from edged.link.memory import sealed_bytes
from edged.setup.releases.archive import MAX_BYTES, Parts, pack, parts_at, parts_of, unpack, with_parts
from edged.setup.releases.jobsfolder import write_jobs

log = logging.getLogger(__name__)

INSTALLING, BEFORE = "installing.tar.gz", "before.tar.gz"
PLACE = "the release"
UNDO = "undo"
MOST_MEMORY_BYTES, MOST_CPU_S = 4 << 30, 60
"""Limits of its addresses and its processor time: libraries take 1 GiB, and the largest release is several
times in memory, packed and not."""


class Installation:
    """One release, on the way into a cell. config : its configuration. folder : for what the cell keeps."""

    def __init__(self, config: Path, folder: Path) -> None:
        self._config = config
        self._folder = folder
        section = load(config).cell
        self._rig, self._jobs = section.rig, section.jobs
        self._former: Parts | None = None

    def begin(self, archive: bytes) -> None:
        """Prove that the cell can be read with it, and write it. Raises `EdgedError`, `OSError`."""
        taken = unpack(archive, PLACE)
        wanted = parts_of(taken)
        if with_parts(self._config, wanted).fingerprint != taken.fingerprint:
            raise UserError(
                f"{PLACE}: was made for another configuration than {self._config}: activate it again"
            )
        there = parts_at(self._rig, self._jobs)
        make_folders(self._folder)
        self._keep_before(there)
        write_atomically(self._folder / INSTALLING, archive, mode=0o600)
        try:
            self._write(wanted, there)
        except (EdgedError, OSError):
            with contextlib.suppress(EdgedError, OSError):  # where nothing can be written, nothing was
                self._write(there, parts_at(self._rig, self._jobs))
            note_installed(self._folder)
            raise
        self._former = there

    def undo(self) -> None:
        """The cell cannot run by it: its files are as before, byte for byte. Raises as `begin`."""
        if self._former is not None:
            self._write(self._former, parts_at(self._rig, self._jobs))
        note_installed(self._folder)

    def finish(self) -> bool:
        """Do what a kill or a power cut has interrupted; whether there was something."""
        file = self._folder / INSTALLING
        if not file.is_file():
            return False
        try:
            wanted = parts_of(unpack(read_bytes(file, "a release", MAX_BYTES), str(file)))
            self._write(wanted, parts_at(self._rig, self._jobs))
            note_installed(self._folder)
        except (EdgedError, OSError) as error:
            # the message names the file: a traceback says no more
            log.error("the activation of a release cannot be finished: %s", error)  # noqa: TRY400
            return False
        return True

    def _keep_before(self, there: Parts) -> None:
        """Keep what is replaced, where there is enough for an archive."""
        try:
            archive = pack(with_parts(self._config, there))
        except UserError as error:
            log.warning("what the release replaces is not kept: %s", error)
            return
        write_atomically(self._folder / BEFORE, archive, mode=0o600)

    def _write(self, wanted: Parts, there: Parts) -> None:
        """Write the files of rig, cameras, connections and jobs. there : what they hold.

        Each by itself is in one step, and every mixture loads: a daemon that starts between them finishes it.
        """
        try:
            make_folders(self._rig.parent)
            if wanted.cameras != there.cameras:
                _put(chosen_file(self._rig), wanted.cameras)
            if wanted.connections != there.connections:
                # with a password's hash: for the cell and its page, which share a group
                _put(connections_file(self._rig), wanted.connections, mode=0o640)
            if wanted.rig != there.rig:
                _put(self._rig, wanted.rig)
        except OSError as error:
            raise self._refused("cell.rig", self._rig, error) from error
        try:
            write_jobs(self._jobs, wanted.jobs, there.jobs)
        except OSError as error:
            raise self._refused("cell.jobs", self._jobs, error) from error

    def _refused(self, key: str, place: Path, error: OSError) -> FileFormatError:
        kind = "a file in" if key == "cell.rig" else "a folder in"
        return FileFormatError(
            f"{place}: the daemon cannot write there ({error.strerror or error}): let {key} of "
            f"{self._config} name {kind} its state directory, for example {self._folder / place.name}, "
            "and reload"
        )


def note_installed(folder: Path) -> None:
    """The cell runs by its files as they are: there is nothing to finish. Raises `OSError`."""
    (folder / INSTALLING).unlink(missing_ok=True)
    sync(folder)


def finish_installation(config: Path) -> None:
    """Before a cell is loaded: a release that was being installed when the daemon ended is installed now."""
    folder = state_folder(config)
    if (folder / INSTALLING).exists() and Installation(config, folder).finish():
        log.warning("the daemon ended while it installed a release: finished that now")


def _put(file: Path, content: bytes | None, mode: int = 0o644) -> None:
    if content is not None:
        write_atomically(file, content, mode=mode)
    elif file.exists():
        file.unlink()
        sync(file.parent)


def main(arguments: Sequence[str]) -> int:
    """Install what a descriptor of sealed memory has, and do what the cell says of it."""
    config, memory = Path(arguments[0]), int(arguments[1])
    for what, most in ((resource.RLIMIT_AS, MOST_MEMORY_BYTES), (resource.RLIMIT_CPU, MOST_CPU_S)):
        hard = resource.getrlimit(what)[1]
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
    words: SimpleQueue[str] = SimpleQueue()

    def listen() -> None:
        for line in sys.stdin:
            words.put(line.strip())
        os._exit(0)  # the cell has all that it needs, or has gone: then it finishes this when it starts

    threading.Thread(target=listen, daemon=True).start()
    try:
        installation = Installation(config, state_folder(config))
        installation.begin(sealed_bytes(memory, MAX_BYTES))
        _say(None)
        if words.get() == UNDO:
            installation.undo()
    except (EdgedError, OSError) as error:
        _say(error)
        return 1
    except (MemoryError, ValueError) as error:
        _say(FileFormatError(f"{PLACE}: {error or 'needs more memory than it may have'}"))
        return 1
    _say(None)
    return 0


def _say(error: EdgedError | OSError | None) -> None:
    """One line: how it went."""
    print(json.dumps(None if error is None else plain_error(error), default=str), flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
