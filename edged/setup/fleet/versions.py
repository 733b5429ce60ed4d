"""The installed versions of edged on a machine, in the layout of `tools/install`, and which one is current.

    versions/NAME/            one environment each; `.complete` is written last, with the release's SHA-256
    current, previous, agent  links to the version that runs, the one before, and the one that switches
    order.json                in the page's folder: the version that its gate wants; `VersionOrder`
    switched.json             beside the links: the order that was followed last, and its outcome; `Switched`

The page decides, but has no write access to the versions. Root follows: it switches only to versions that it
has installed, and back on its own if the new version does not come up. A link is replaced in one step, so
that whenever the power fails, one complete version is current.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Literal, Protocol

from pydantic import Field

from edged.errors import FileFormatError, UserError
from edged.files.atomic import make_folders, read_bytes, sync, write_atomically
from edged.setup.documents import read_model
from edged.setup.fleet.offers import FOLDER, GATE
from edged.setup.fleet.wheelset import Wheel, requirements
from edged.setup.history import Kept, Text

COMPLETE, ORDER, SWITCHED = ".complete", "order.json", "switched.json"
CURRENT, PREVIOUS, AGENT = "current", "previous", "agent"
START_S = 900.0
"""A new version not judged within this time has not come up; on another processor it compiles first."""
RESTARTS = 3
"""Restarts during probation from which on the daemon counts as not running."""
POLL_S = 1.0

WARM = "warm"
"""The command that compiles the kernels."""

VersionName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]{0,63}$")]


class VersionOrder(Kept):
    """The version that the gate wants to run. number : counts its orders. back : return to the former one."""

    number: Annotated[int, Field(ge=1)]
    to: VersionName
    back: bool


class Switched(Kept):
    """An order and its outcome. why : reason if it failed."""

    order: VersionOrder
    former: VersionName
    state: Literal["begun", "runs", "failed"]
    why: Text = ""


class Unit(Protocol):
    """The systemd service of a cell."""

    def restart(self) -> str:
        """Restart it and wait until it is ready; return "" or why it is not."""

    def restarts(self) -> int:
        """Number of automatic restarts since then."""


class Versions:
    """Versions installed in a folder, /opt/edged. Writing requires root. Raises `OSError`, `UserError`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def python(self, name: str) -> Path:
        """Path of a version's Python interpreter."""
        return self.folder / "versions" / name / "bin" / "python"

    def linked(self, link: str) -> str:
        """Name of the version that a link points to; "" if there is no link."""
        place = self.folder / link
        return place.readlink().name if place.is_symlink() else ""

    def digest(self, name: str) -> str | None:
        """SHA-256 of the release that a version was installed from; None if it is not complete.

        "" for one made by `tools/install`.
        """
        file = self.folder / "versions" / name / COMPLETE
        return file.read_text().strip() if file.is_file() else None

    def install(self, name: str, digest: str, wheels: tuple[Wheel, ...], files: Path) -> None:
        """Make the environment of a release from a folder with its wheels, beside the running one."""
        place = self.folder / "versions" / name
        from edged.vision.kernels.jitcache import take_over  # loads the compiler, half a second

        there = self.digest(name)
        if there is not None and there != digest:
            raise UserError(f"{place}: another software is installed by this name: sign it by another one")
        if there is not None:
            return
        shutil.rmtree(place, ignore_errors=True)  # left by an interrupted run
        make_folders(place.parent)
        _run([sys.executable, "-m", "venv", "--system-site-packages", place], f"{place}: cannot be made")
        wanted = place / "requirements.txt"
        wanted.write_text(requirements(wheels))
        pip = "-m pip install -q --disable-pip-version-check --no-index --only-binary :all: --require-hashes"
        exact = ("--ignore-installed", "--find-links", files, "-r", wanted)
        _run([self.python(name), *pip.split(), *exact], f"{place}: pip")
        _run([place / "bin" / "edged", "--version"], f"{place}: edged")
        running = self.folder / CURRENT
        take_over(running / "kernels", _packages(running), place / "kernels", _packages(place))
        kernels = {**os.environ, "NUMBA_CACHE_DIR": str(place / "kernels")}
        _run([place / "bin" / "edged", WARM], f"{place}: compiling", kernels)
        os.sync()  # everything must be on disc before the mark
        write_atomically(place / COMPLETE, digest.encode())
        self._remove_others(name)

    def switch(self, name: str) -> None:
        """Make another version current, and the current one the previous."""
        former = self.linked(CURRENT)
        if self.digest(name) is None:
            raise UserError(f"{self.folder}: version {name} is not installed, or not complete")
        if former != name:
            self._link(PREVIOUS, former)
            self._link(CURRENT, name)

    def keep_agent(self, name: str) -> None:
        """Make a version that is known to run the one that switches."""
        self._link(AGENT, name)

    def switched(self) -> Switched | None:
        """The order that was followed last. Raises `FileFormatError`."""
        file = self.folder / SWITCHED
        return read_model(file, Switched, "a switch of version") if file.exists() else None

    def note(self, switched: Switched) -> Switched:
        """Write the progress of an order."""
        write_atomically(self.folder / SWITCHED, switched.model_dump_json(indent=1).encode())
        return switched

    def _link(self, link: str, name: str) -> None:
        draft = self.folder / f".{link}"
        draft.unlink(missing_ok=True)
        draft.symlink_to(Path("versions", name))
        os.replace(draft, self.folder / link)  # noqa: PTH105  (the kill points of the tests)
        sync(self.folder)

    def _remove_others(self, name: str) -> None:
        """Remove versions of releases that no link points to: an environment has some 600 MB."""
        kept = {name, *map(self.linked, (CURRENT, PREVIOUS, AGENT))}
        for place in (self.folder / "versions").iterdir():
            if place.name not in kept and self.digest(place.name):
                (place / COMPLETE).unlink()
                shutil.rmtree(place)


def _packages(place: Path) -> Path:
    """Folder with the packages of an environment."""
    return next(place.resolve().glob("lib/python3*/site-packages"), place)


def order_in(folder: Path) -> VersionOrder | None:
    """The order of a page's gate; None without any. folder : of releases. Raises `FileFormatError`."""
    file = folder / ORDER
    return read_model(file, VersionOrder, "an order of the gate") if file.exists() else None


def follow(
    versions: Versions,
    page: Path,
    unit: Unit,
    start_s: float = START_S,
    poll_s: float = POLL_S,
    is_over: Callable[[], bool] = lambda: False,
) -> Switched | None:
    """Follow the orders of the gate, and supervise a new version through its probation.

    Returns the last order's outcome, None without any. page : its folder. Can be stopped and started again at
    any moment. is_over : ends the supervision, for tests.
    """
    order, done = order_in(page / FOLDER), versions.switched()
    while order is not None and not (done is not None and done.order == order and done.state == "failed"):
        if done is None or done.order != order:
            former = versions.linked(CURRENT)
            if not order.back and former != order.to:
                versions.keep_agent(former)
            done = versions.note(Switched(order=order, former=former, state="begun"))
        if done.state == "begun":
            versions.switch(order.to)
            why = unit.restart()
            if not why and not order.back:
                why = _confirmed(page, start_s, poll_s)
            if why and not order.back:
                return _undone(versions, done, unit, why)
            done = versions.note(done.model_copy(update={"state": "failed" if why else "runs", "why": why}))
        while not order.back and not is_over() and _step(page) == "probation":
            if unit.restarts() >= RESTARTS:
                return _undone(versions, done, unit, f"it ended {unit.restarts()} times by itself")
            time.sleep(10 * poll_s)
        further = order_in(page / FOLDER)  # checked here, as systemd does not start a unit that still runs
        if further == order:
            return done
        order = further
    return done


def _undone(versions: Versions, done: Switched, unit: Unit, why: str) -> Switched:
    """Go back to the former version on its own."""
    versions.switch(done.former)
    done = versions.note(done.model_copy(update={"state": "failed", "why": why}))
    unit.restart()
    return done


def _confirmed(page: Path, start_s: float, poll_s: float) -> str:
    """Wait until the gate of the new version has begun to judge it; return "" or why it has not."""
    end_s = time.monotonic() + start_s
    while _step(page) == "activating":
        if time.monotonic() >= end_s:
            return f"it did not come up within {start_s:g} s"
        time.sleep(poll_s)
    return ""


def _step(page: Path) -> str:
    """Step in the gate's note; only this key is read, as another version may have written the note."""
    try:
        found = json.loads(read_bytes(page / FOLDER / GATE, "the gate's note"))
        return str(found["step"])
    except (FileFormatError, ValueError, KeyError, TypeError):
        return "activating"  # unreadable: it may not have begun


class SystemdUnit:
    """A unit controlled by systemctl."""

    def __init__(self, name: str) -> None:
        self._name = name

    def restart(self) -> str:
        """See `Unit`."""
        done = subprocess.run(
            ["systemctl", "restart", self._name], capture_output=True, text=True, check=False
        )
        return "" if done.returncode == 0 else f"{self._name} does not start: {done.stderr.strip()[-500:]}"

    def restarts(self) -> int:
        """See `Unit`."""
        command = ["systemctl", "show", "-P", "NRestarts", self._name]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return int(done.stdout.strip() or 0) if done.returncode == 0 else 0


def _run(command: Sequence[str | Path], what: str, environment: dict[str, str] | None = None) -> None:
    done = subprocess.run(
        [*map(str, command)], capture_output=True, text=True, stdin=subprocess.DEVNULL, env=environment,
        check=False,
    )  # fmt: skip
    if done.returncode:
        raise UserError(f"{what}: {(done.stderr or done.stdout).strip()[-1000:]}")
