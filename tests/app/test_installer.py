"""A release from the page: read by another process, written as a whole, undone byte for byte."""

from __future__ import annotations

import asyncio
import gzip
import os
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
from helpers.waiting import WHOLE_S

from edged.app import installer as installers
from edged.app.installer import Installer
from edged.errors import EdgedError, LinkError, SetupRefused, UserError
from edged.files.rig import load_rig, rig_text
from edged.files.statefolder import state_folder
from edged.link.memory import is_sealed, sealed, sealed_bytes
from edged.setup.cellfiles import read_cell
from edged.setup.releases.archive import Backup, pack, parts_at, parts_of, read, with_parts
from edged.setup.releases.installing import BEFORE, INSTALLING, finish_installation


@dataclass
class Place:
    """A cell's folder, and releases for it. refuses : the answer of a reload."""

    folder: Path
    refuses: str = ""
    reloads: list[str] = field(default_factory=list)

    @property
    def config(self) -> Path:
        return self.folder / "cell.toml"

    @property
    def state(self) -> Path:
        return state_folder(self.config)

    def files(self) -> dict[str, bytes]:
        """All files that the cell runs with."""
        found = (file for file in self.folder.rglob("*") if file.is_file())
        names = {file.relative_to(self.folder).as_posix(): file.read_bytes() for file in found}
        return {name: data for name, data in names.items() if not name.startswith(".cell.state/")}

    def wider(self) -> Backup:
        """A release with another baseline."""
        rig = load_rig(self.folder / "rig.json")
        moved = rig.right_from_left.copy()
        moved[:3, 3] *= 1.001
        text = rig_text(replace(rig, right_from_left=moved, calibration_id="cal-other"))
        there = parts_at(self.folder / "rig.json", self.folder / "jobs")
        return with_parts(self.config, replace(there, rig=text))

    def install(self, archive: bytes | Callable[[], int]) -> None:
        """Install by a process of its own. Raises as `Installer.install`."""

        async def reload() -> str:
            self.reloads.append(read_cell(self.config).fingerprint)
            return self.refuses

        async def installed(memory: int) -> None:
            async with asyncio.timeout(WHOLE_S):
                await Installer(self.config, reload).install(memory)

        memory = sealed(archive) if isinstance(archive, bytes) else archive()
        try:
            asyncio.run(installed(memory))
        finally:
            os.close(memory)


@pytest.fixture
def place(own_cell: Path) -> Place:
    """A place of the test's own."""
    return Place(own_cell)


def test_a_release_is_in_use_and_the_one_before_is_kept(place: Place) -> None:
    """A release is in use, and the replaced files are an archive that can be restored."""
    before, wanted = place.files(), place.wider()
    place.install(pack(wanted))
    assert [wanted.fingerprint] == place.reloads == [read_cell(place.config).fingerprint]
    assert not (place.state / INSTALLING).exists()
    kept = read(place.state / BEFORE)
    assert before["rig.json"] == parts_of(kept).rig
    assert 0o600 == (place.state / BEFORE).stat().st_mode & 0o777


def test_what_the_cell_cannot_run_by_leaves_no_trace(place: Place) -> None:
    """If the reload is refused, every file is as before."""
    before, place.refuses = place.files(), "modbus.port: in use"
    with pytest.raises(UserError, match=r"goes on as before: modbus\.port"):
        place.install(pack(place.wider()))
    assert before == place.files()
    assert not (place.state / INSTALLING).exists()


def unsealed() -> int:
    """Memory that its sender can change while it is read."""
    return os.memfd_create("open", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)


def other_file() -> int:
    """A device that never ends."""
    return os.open("/dev/zero", os.O_RDONLY)


@pytest.mark.parametrize("opened", [unsealed, other_file])
def test_only_memory_that_nobody_changes_is_read(place: Place, opened: Callable[[], int]) -> None:
    """Anything other than sealed memory is refused before it is read."""
    before = place.files()
    with pytest.raises(EdgedError, match="expected sealed memory"):
        place.install(opened)
    assert (before, []) == (place.files(), place.reloads)


def hostile(good: Backup) -> dict[str, bytes]:
    """Invalid archives, by what is wrong with them."""
    whole = pack(good)
    damaged = bytearray(gzip.decompress(whole))
    damaged[damaged.index(b"calibration_id")] ^= 1
    return {
        "nothing": b"",
        "cut": whole[: len(whole) // 2],
        "damaged": gzip.compress(bytes(damaged)),
        "a bomb": gzip.compress(bytes(300 << 20), 1),
        "no rig file": pack(replace(good, files={**good.files, "rig.json": b"{}"})),
        "another cell's": pack(replace(good, fingerprint="00000000")),
    }


@pytest.mark.long
def test_archives_that_are_none_change_nothing(place: Place) -> None:
    """Each invalid archive is refused with a reason, without a reload or a change."""
    before = place.files()
    for what, archive in hostile(place.wider()).items():
        with pytest.raises(EdgedError) as refused:
            place.install(archive)
        assert str(refused.value), what
        assert (before, []) == (place.files(), place.reloads), what


@pytest.mark.parametrize("moment", ["at once", "as it reads", "as it writes"])
def test_a_process_that_is_killed_leaves_one_of_both(
    place: Place, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    """After kill -9 the cell loads, and the next start completes the release if it was begun."""
    before, wanted = read_cell(place.config).fingerprint, place.wider()
    real = subprocess.Popen

    def killed(*arguments: object, **options: object) -> subprocess.Popen[bytes]:
        process = real(*arguments, **options)  # type: ignore[call-overload]  (as it was called)
        if moment == "as it reads":
            time.sleep(0.5)
        while moment == "as it writes" and not (place.state / INSTALLING).exists() and process.poll() is None:
            pass
        process.send_signal(signal.SIGKILL)
        return process

    monkeypatch.setattr(installers.subprocess, "Popen", killed)
    with suppress(LinkError):
        place.install(pack(wanted))
    assert read_cell(place.config).fingerprint in (before, wanted.fingerprint)
    # half a second is enough for a quick machine to be done
    was_begun = bool(place.reloads) or (place.state / INSTALLING).exists()
    assert was_begun in {"at once": [False], "as it writes": [True]}.get(moment, [False, True])
    finish_installation(place.config)
    assert (wanted.fingerprint if was_begun else before) == read_cell(place.config).fingerprint
    assert not (place.state / INSTALLING).exists()


def test_a_process_that_cannot_be_killed_is_left_behind(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a disk that hangs: the cell names it within its limit, goes on, and can end itself."""
    started: list[subprocess.Popen[bytes]] = []
    real = subprocess.Popen

    def hung(_command: list[str], **options: object) -> subprocess.Popen[bytes]:
        process = real(["sleep", "600"], **options)  # type: ignore[call-overload]  (as it was called)
        monkeypatch.setattr(process, "kill", lambda: None)
        started.append(process)
        return process

    monkeypatch.setattr(installers.subprocess, "Popen", hung)
    monkeypatch.setattr(installers, "MOST_S", 0.3)
    before = place.files()
    try:
        with pytest.raises(LinkError, match="has ended, or hangs"):
            place.install(pack(place.wider()))
        assert started[0].poll() is None
        assert (before, []) == (place.files(), place.reloads)
    finally:
        os.kill(started[0].pid, signal.SIGKILL)
        started[0].wait()


@pytest.mark.skipif(os.geteuid() != 0, reason="to be tricked takes root")
def test_root_installs_through_no_link_of_another_user(place: Place) -> None:
    """Links in the state folder are not followed: root's file is neither read nor changed."""
    secret, before = place.folder.parent / "secret", place.files()
    secret.write_bytes(pack(place.wider()))
    secret.chmod(0o600)
    about, other = secret.stat(), 65534
    place.state.mkdir()
    for name in (INSTALLING, BEFORE):
        (place.state / name).symlink_to(secret)
        os.chown(place.state / name, other, other, follow_symlinks=False)
    os.chown(place.state, other, other)
    finish_installation(place.config)
    assert before == place.files()
    place.install(pack(place.wider()))
    assert (about.st_ino, about.st_mtime_ns) == (secret.stat().st_ino, secret.stat().st_mtime_ns)
    assert not (place.state / BEFORE).is_symlink()
    assert read(place.state / BEFORE).fingerprint != read_cell(place.config).fingerprint


def test_one_at_a_time(place: Place) -> None:
    """While one release is installed another one is refused."""

    async def reload() -> str:
        await asyncio.sleep(0.1)
        return ""

    async def both() -> list[BaseException | None]:
        installer = Installer(place.config, reload)
        memory = sealed(pack(place.wider()))
        try:
            return await asyncio.gather(
                installer.install(memory), installer.install(memory), return_exceptions=True
            )
        finally:
            os.close(memory)

    first, second = asyncio.run(both())
    assert first is None
    assert isinstance(second, SetupRefused)


def test_sealed_memory_is_what_it_was() -> None:
    """Sealed memory reads from its start, up to the limit, and cannot be written."""
    memory = sealed(b"0123456789")
    try:
        os.lseek(memory, 5, os.SEEK_SET)
        assert b"0123456789" == sealed_bytes(memory, 10)
        with pytest.raises(ValueError, match="at most 9"):
            sealed_bytes(memory, 9)
        with pytest.raises(PermissionError):
            os.pwrite(memory, b"x", 0)
        assert is_sealed(memory)
    finally:
        os.close(memory)
    with pytest.raises(ValueError, match="sealed"):
        sealed_bytes(0, 10)
