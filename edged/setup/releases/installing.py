"""Installs a release in place of a cell's files. A failure restores the old ones; a power cut leaves either.

    installing.tar.gz   the release, from before its first file is written until the cell runs with it
    before.tar.gz       the files that the last one replaced, as `edged restore` reads them

The page hands a release over; its content is untrusted until it has been checked here. This runs in a child
process of the cell with limits of its own, so that it affects neither the cell's loop nor its memory:
`python -m edged.setup.releases.installing CONFIG DESCRIPTOR`. It writes, reports that, and waits: for "undo"
if the cell cannot run with the release, otherwise for the end of its input. It ends with the cell.
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
"""Limits on address space and processor time: libraries take 1 GiB, and the largest release is in memory
several times, packed and unpacked."""


class Installation:
    """Installation of one release. config : the cell's configuration. folder : the cell's state folder."""

    def __init__(self, config: Path, folder: Path) -> None:
        self._config = config
        self._folder = folder
        section = load(config).cell
        self._rig, self._jobs = section.rig, section.jobs
        self._former: Parts | None = None

    def begin(self, archive: bytes) -> None:
        """Check that the cell can be read with the release, and write it. Raises `EdgedError`, `OSError`."""
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
            with contextlib.suppress(EdgedError, OSError):  # if nothing can be written, nothing was
                self._write(there, parts_at(self._rig, self._jobs))
            note_installed(self._folder)
            raise
        self._former = there

    def undo(self) -> None:
        """Restore the former files, byte for byte, as the cell cannot run with it. Raises as `begin`."""
        if self._former is not None:
            self._write(self._former, parts_at(self._rig, self._jobs))
        note_installed(self._folder)

    def finish(self) -> bool:
        """Finish an installation interrupted by a kill or a power cut; return whether one was finished."""
        file = self._folder / INSTALLING
        if not file.is_file():
            return False
        try:
            wanted = parts_of(unpack(read_bytes(file, "a release", MAX_BYTES), str(file)))
            self._write(wanted, parts_at(self._rig, self._jobs))
            note_installed(self._folder)
        except (EdgedError, OSError) as error:
            # the message names the file: a traceback adds nothing
            log.error("the activation of a release cannot be finished: %s", error)  # noqa: TRY400
            return False
        return True

    def _keep_before(self, there: Parts) -> None:
        """Archive the files that are replaced, if they make up a readable cell."""
        try:
            archive = pack(with_parts(self._config, there))
        except UserError as error:
            log.warning("what the release replaces is not kept: %s", error)
            return
        write_atomically(self._folder / BEFORE, archive, mode=0o600)

    def _write(self, wanted: Parts, there: Parts) -> None:
        """Write the files of rig, cameras, connections and jobs. there : their present content.

        Each is replaced in one step, and every mixture loads: a daemon that starts in between finishes it.
        """
        try:
            make_folders(self._rig.parent)
            if wanted.cameras != there.cameras:
                _put(chosen_file(self._rig), wanted.cameras)
            if wanted.connections != there.connections:
                # contains a password's hash: readable for the cell and its page, which share a group
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
    """Remove the mark of an unfinished installation: the cell runs with its files. Raises `OSError`."""
    (folder / INSTALLING).unlink(missing_ok=True)
    sync(folder)


def finish_installation(config: Path) -> None:
    """Install a release whose installation was cut off when the daemon ended; call before loading a cell."""
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
    """Install a release from a descriptor of sealed memory, then wait for the cell's answer."""
    config, memory = Path(arguments[0]), int(arguments[1])
    for what, most in ((resource.RLIMIT_AS, MOST_MEMORY_BYTES), (resource.RLIMIT_CPU, MOST_CPU_S)):
        hard = resource.getrlimit(what)[1]
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
    words: SimpleQueue[str] = SimpleQueue()

    def listen() -> None:
        for line in sys.stdin:
            words.put(line.strip())
        os._exit(0)  # the cell is done, or has ended: then it finishes this at its next start

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
    """Print the outcome as one line of JSON."""
    print(json.dumps(None if error is None else plain_error(error), default=str), flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
