"""Commands run as root on a folder that the daemon's user owns follow no link to root's files."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from helpers.cells import small_rig
from rich.console import Console

from edged.commands.audit import audit
from edged.commands.backup import backup, restore
from edged.commands.demo import DemoOptions, prepare_cell
from edged.commands.web import invite
from edged.config.chosencameras import read_chosen
from edged.config.reading import load
from edged.errors import UserError
from edged.files.atomic import write_file
from edged.files.dxf import read_dxf
from edged.files.images import load_image
from edged.files.jobs import load_job, save_job
from edged.files.outputs import make_folder
from edged.files.private import read_shared_key
from edged.files.recording import load_snapshot
from edged.files.rig import load_rig
from edged.files.step import read_step
from edged.files.stl import read_stl
from edged.files.tables import read_table
from edged.identity.audit import AuditEntry, AuditFile
from edged.identity.invite import Invite
from edged.identity.passwords import hash_password
from edged.identity.users import User, UserFile
from edged.owners import as_owner
from edged.setup.releases.archive import read
from edged.sim.cell import VirtualCell, demo_part

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="only root can be led to write what is root's")

DAEMON = 65534
"""The daemon's user: the uid of nobody, which every machine has."""
SECRET = b"root's alone\n"
CELL = (
    "[cell]\nname = 'c'\nrig = 'rig.json'\njobs = 'jobs'\njob = 'a'\n[cameras]\nsource = 'virtual'\n"
    "[web]\ncommissioning = true\n"
)
CONFIG = Path("cell.toml")
"""Configuration of root's, for the tests that read."""
QUIET = Console(quiet=True)
STATE_FILES = ("audit.jsonl", "audit.head", "invite.json", "users.json")


def give(path: Path) -> Path:
    """Give a file, a link or a folder with its contents to the daemon's user."""
    for place in (path, *(path.rglob("*") if path.is_dir() and not path.is_symlink() else ())):
        os.chown(place, DAEMON, DAEMON, follow_symlinks=False)
    return path


@dataclass(frozen=True, slots=True)
class Machine:
    """A configuration owned by root, a state folder of the daemon's user, and the target of an attack.

    above : parent of the state folder, owned by the daemon's user. prize : root's folder, with a file.
    """

    config: Path
    above: Path
    state: Path
    prize: Path

    @property
    def secret(self) -> Path:
        """A file that only root may read."""
        return self.prize / "secret"

    def what_root_has(self) -> dict[str, tuple[int, int, int, bytes]]:
        """Owner, group, mode and content of everything that the daemon's user may not touch."""
        found = {}
        for file in (self.prize, *sorted(self.prize.rglob("*"))):
            about = file.lstat()
            content = file.read_bytes() if file.is_file() else b""
            found[file.name] = (about.st_uid, about.st_gid, about.st_mode, content)
        return found


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    """Everything lies in a folder that only root can enter, like /var/lib/private."""
    prize, above = tmp_path / "prize", tmp_path / "above"
    for folder in (prize, above / "state", tmp_path / "etc"):
        folder.mkdir(parents=True)
    (prize / "secret").write_bytes(SECRET)
    (prize / "secret").chmod(0o600)
    (tmp_path / "etc" / "cell.toml").write_text(CELL)
    give(above)
    tmp_path.chmod(0o700)
    monkeypatch.setenv("STATE_DIRECTORY", str(above / "state"))
    return Machine(tmp_path / "etc" / "cell.toml", above, above / "state", prize)


@pytest.fixture(autouse=True)
def still_root() -> Iterator[None]:
    """After a command this process has its rights again, and the command is limited in time."""
    before = os.getresuid(), os.getresgid(), os.getgroups()
    former = signal.signal(signal.SIGALRM, _give_up)
    signal.alarm(20)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, former)
    assert before == (os.getresuid(), os.getresgid(), os.getgroups())


def _give_up(_number: int, _frame: object) -> None:
    raise AssertionError("it waits for something that never comes")


# --- attacks by the daemon's user -----------------------------------------------------------------

Trap = Callable[[Machine], None]


def linked(name: str) -> Trap:
    """Replace a file of the state folder by a link to root's file."""

    def set_trap(machine: Machine) -> None:
        (machine.state / name).unlink(missing_ok=True)
        (machine.state / name).symlink_to(machine.secret)
        give(machine.state / name)

    return set_trap


def dangling(name: str) -> Trap:
    """Replace a file of the state folder by a link to a missing file of root's."""

    def set_trap(machine: Machine) -> None:
        (machine.state / name).unlink(missing_ok=True)
        (machine.state / name).symlink_to(machine.prize / "new")
        give(machine.state / name)

    return set_trap


def folder_linked(machine: Machine) -> None:
    """Replace the state folder by a link to root's folder."""
    machine.state.rename(machine.above / "aside")
    machine.state.symlink_to(machine.prize)
    give(machine.state)


def parent_linked(machine: Machine) -> None:
    """Replace a parent folder by a link to root's folder, which has a folder of that name."""
    (machine.prize / "state").mkdir()
    home = machine.above.parent / "home"
    home.mkdir()
    machine.above.rename(home / "above")
    machine.above.symlink_to(machine.prize)
    give(machine.above)


def folder_missing_above_a_link(machine: Machine) -> None:
    """Remove the state folder, whose parent is a link to root's folder."""
    parent_linked(machine)
    (machine.prize / "state").rmdir()


def hard_linked(machine: Machine) -> None:
    """Make the chain a hard link to root's file, as some kernels allow everyone."""
    os.link(machine.secret, machine.state / "audit.jsonl")


def pipe(machine: Machine) -> None:
    """Make the chain a pipe that never yields data."""
    os.mkfifo(machine.state / "audit.jsonl")
    give(machine.state / "audit.jsonl")


TRAPS: dict[str, Trap] = {
    **{f"{name} is a link": linked(name) for name in STATE_FILES},
    **{f"{name} is a link to nothing": dangling(name) for name in STATE_FILES},
    "the folder is a link": folder_linked,
    "the parent is a link": parent_linked,
    "the folder is missing": folder_missing_above_a_link,
    "a hard link": hard_linked,
    "a pipe": pipe,
}
any_trap = pytest.mark.parametrize("trap", TRAPS.values(), ids=TRAPS)
OF_FILES = [name for name in TRAPS if name.startswith(STATE_FILES)] + ["a pipe"]


@any_trap
def test_an_invitation_changes_nothing_of_roots(
    machine: Machine, trap: Trap, capsys: pytest.CaptureFixture[str]
) -> None:
    """The invitation is made as the daemon's user or refused, root's files stay, and a missing audit is
    reported."""
    trap(machine)
    before = machine.what_root_has()
    try:
        invite(machine.config, "Anna")
    except UserError as error:
        assert str(machine.state) in str(error)
    else:
        out, err = capsys.readouterr()
        assert Invite(machine.state).take(out.split()[0], "Anna", is_new=True)
        kept = AuditFile(machine.state).verify().records if not err else ()
        assert bool(kept) != bool(err)
    assert before == machine.what_root_has()


def test_an_invitation_belongs_to_the_daemons_user(machine: Machine) -> None:
    """Invitation, chain and its head belong to the daemon's user with mode 600."""
    invite(machine.config, "Anna")
    found = {file.name: file.stat() for file in machine.state.iterdir()}
    owners = {name: (about.st_uid, about.st_mode & 0o777) for name, about in found.items()}
    assert dict.fromkeys(("invite.json", "audit.jsonl", "audit.head"), (DAEMON, 0o600)) == owners


@any_trap
def test_looking_at_the_audit_tells_nothing_of_roots(
    machine: Machine, trap: Trap, capsys: pytest.CaptureFixture[str]
) -> None:
    """Root's files are neither read nor changed, and an invalid or unreadable chain is reported."""
    AuditFile(machine.state).add(AuditEntry("Anna", "", "", "make", "x", "ok"))
    AuditFile(machine.prize).add(AuditEntry("root", "", "", "hide", "treasure", "ok"))
    give(machine.state)
    if trap in (hard_linked, pipe):
        (machine.state / "audit.jsonl").unlink()
    trap(machine)
    before = machine.what_root_has()
    try:
        audit(machine.config, Console(), as_json=False, last=50)
    except UserError as error:
        assert str(machine.state) in str(error)
    assert before == machine.what_root_has()
    assert "treasure" not in "".join(capsys.readouterr())


@pytest.mark.slow
@pytest.mark.parametrize("name", OF_FILES)
def test_a_daemon_that_is_root_follows_no_link_either(machine: Machine, name: str) -> None:
    """Files get the folder's owner by descriptor, and a link in place of one is an error or is replaced."""
    TRAPS[name](machine)
    before = machine.what_root_has()
    anna = User(name="Anna", role="engineer", password_hash=hash_password("secret words"))
    for act in (
        lambda: AuditFile(machine.state).add(AuditEntry("Anna", "", "", "make", "x", "ok")),
        lambda: Invite(machine.state).make(),
        lambda: UserFile(machine.state / "users.json").put(anna),
    ):
        try:
            act()
        except (OSError, UserError) as error:
            assert "link" in str(error) or "plain" in str(error)
    assert before == machine.what_root_has()
    for file in machine.state.iterdir():
        assert DAEMON == file.lstat().st_uid


def test_a_link_at_a_temporary_name_is_not_followed(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A draft never uses an existing name: another one is taken."""
    names = iter(["guessed", "free", *(f"more{number}" for number in range(20))])
    monkeypatch.setattr("edged.files.atomic.token_hex", lambda _bytes: next(names))
    trap = machine.state / ".invite.json.guessed"
    trap.symlink_to(machine.prize / "new")
    give(trap)
    before = machine.what_root_has()
    Invite(machine.state).make()
    assert before == machine.what_root_has()
    assert trap.is_symlink()
    assert (machine.state / "invite.json").is_file()


# --- outputs ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Configuration file of a cell with rig and job."""
    folder = tmp_path_factory.mktemp("cell")
    return prepare_cell(folder, VirtualCell(small_rig(), demo_part()), DemoOptions(), gige=False)


@pytest.fixture(scope="module")
def archive(cell: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A backup of the cell."""
    file = tmp_path_factory.mktemp("backup") / "cell.tar.gz"
    assert 0 == backup(cell, file, QUIET)
    return file


def test_a_file_that_root_asks_for_is_not_written_through_a_folder_that_is_a_link(machine: Machine) -> None:
    """Output through a folder that is another user's link is refused, unless it leads to that user's own
    folder."""
    folder_linked(machine)
    before = machine.what_root_has()
    with pytest.raises(UserError, match="link of another user"):
        write_file(machine.state / "rig.json", b"rig")
    assert before == machine.what_root_has()
    machine.state.unlink()
    machine.state.symlink_to("aside")
    give(machine.state)
    write_file(machine.state / "rig.json", b"rig")
    assert b"rig" == (machine.above / "aside" / "rig.json").read_bytes()


@pytest.mark.parametrize("trap", [folder_linked, parent_linked])
def test_a_folder_that_root_asks_for_is_not_made_through_a_link(machine: Machine, trap: Trap) -> None:
    """An output folder is made as the daemon's user, or not at all."""
    trap(machine)
    before = machine.what_root_has()
    with pytest.raises(UserError, match="cannot be written"):
        make_folder(machine.state / "export" / "cycles")
    with pytest.raises(UserError):
        write_file(machine.state / "report.html", b"report")
    assert before == machine.what_root_has()
    machine.above.unlink() if machine.above.is_symlink() else machine.state.unlink()
    machine.above.mkdir(exist_ok=True)
    give(machine.above)
    make_folder(machine.above / "export" / "cycles")
    assert DAEMON == (machine.above / "export" / "cycles").stat().st_uid


@pytest.mark.slow
def test_a_backup_is_not_written_through_a_folder_that_is_a_link(cell: Path, machine: Machine) -> None:
    """It is refused where it would be written into root's folder."""
    folder_linked(machine)
    before = machine.what_root_has()
    with pytest.raises(UserError, match=r"cell\.tar\.gz: cannot be written"):
        backup(cell, machine.state / "cell.tar.gz", QUIET)
    assert before == machine.what_root_has()


@pytest.mark.slow
@pytest.mark.parametrize(
    "place", ["rig.json", "jobs/flange/taught/secret", "jobs/flange/job.toml", "jobs/flange", "jobs"]
)
def test_a_backup_takes_nothing_that_a_link_leads_to(cell: Path, machine: Machine, place: str) -> None:
    """A link of the daemon's user to files of root's is refused, and no archive is made."""
    shutil.copytree(cell.parent, machine.state, dirs_exist_ok=True)
    hidden = machine.prize / "hidden"
    hidden.mkdir()
    name = Path(place).name
    if (machine.state / place).exists():
        (machine.state / place).rename(hidden / name)
    else:
        (machine.state / place).parent.mkdir(exist_ok=True)
        (hidden / name).write_bytes(SECRET)
    (machine.state / place).symlink_to(hidden / name)
    give(machine.state)
    with pytest.raises(UserError, match="link"):
        backup(machine.state / cell.name, machine.prize / "cell.tar.gz", QUIET)
    assert not (machine.prize / "cell.tar.gz").exists()


@pytest.mark.slow
def test_a_link_of_the_daemons_user_to_its_own_files_is_followed(cell: Path, machine: Machine) -> None:
    """Links of the daemon's user to its own files are followed, as are links of root's."""
    shutil.copytree(cell.parent, machine.state, dirs_exist_ok=True)
    (machine.state / "jobs").rename(machine.above / "jobs")
    (machine.state / "jobs").symlink_to(machine.above / "jobs")
    give(machine.above)
    (machine.prize / "here").symlink_to(machine.above)
    assert 0 == backup(machine.prize / "here" / "state" / cell.name, machine.prize / "cell.tar.gz", QUIET)
    assert "jobs/flange/job.toml" in read(machine.prize / "cell.tar.gz").files


@pytest.mark.slow
@pytest.mark.parametrize("trap", [folder_linked, parent_linked])
def test_a_restore_changes_nothing_of_roots(archive: Path, machine: Machine, trap: Trap) -> None:
    """The restore into a folder of the daemon's user is refused, and root's files stay."""
    trap(machine)
    before = machine.what_root_has()
    with pytest.raises(UserError, match="cannot be written"):
        restore(archive, machine.state, QUIET, force=True)
    assert before == machine.what_root_has()


@pytest.mark.slow
def test_a_restore_into_a_folder_of_the_daemons_user_is_theirs(archive: Path, machine: Machine) -> None:
    """All restored files and folders belong to the daemon's user."""
    os.chown(archive, 0, 0)
    assert 0 == restore(archive, machine.state, QUIET, force=True)
    assert {DAEMON} == {file.lstat().st_uid for file in (machine.state, *machine.state.rglob("*"))}


@pytest.mark.slow
def test_a_folder_of_somebody_else_in_roots_leads_root_nowhere(
    cell: Path, archive: Path, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If its owner replaces a folder by a link during a restore by root, nothing is written through it."""
    etc = machine.config.parent
    shutil.copytree(cell.parent, etc, dirs_exist_ok=True)
    (etc / "notes" / "old").mkdir(parents=True)
    (etc / "notes" / "old" / "secret").write_bytes(b"theirs")
    give(etc / "notes")
    before = machine.what_root_has()
    by_path, by_descriptor = os.chown, os.fchown

    def then_exchanged(place: Path | int, user: int, group: int) -> None:
        """Replaces the folder as soon as it belongs to its owner."""
        if isinstance(place, int):
            by_descriptor(place, user, group)
        else:
            by_path(place, user, group)
        for folder in etc.parent.glob(".etc.*/notes/old"):
            if DAEMON == folder.stat().st_uid and not folder.is_symlink():
                folder.rename(folder.with_name("aside"))
                folder.symlink_to(machine.prize)

    monkeypatch.setattr(os, "chown", then_exchanged)
    monkeypatch.setattr(os, "fchown", then_exchanged)
    try:
        restore(archive, etc, QUIET, force=True)
    except UserError as error:
        assert "cannot be written" in str(error)
    assert before == machine.what_root_has()


@pytest.mark.slow
def test_a_job_is_not_written_through_a_folder_that_is_a_link(cell: Path, machine: Machine) -> None:
    """Root saves the job as the folder's owner, and refuses a link."""
    job = load_job(cell.parent / "jobs" / "flange")
    save_job(machine.state / "flange", job)
    assert {DAEMON} == {file.lstat().st_uid for file in (machine.state / "flange").rglob("*")}
    folder_linked(machine)
    before = machine.what_root_has()
    with pytest.raises(UserError):
        save_job(machine.state / "flange", job)
    assert before == machine.what_root_has()


# --- the mechanism ----------------------------------------------------------------------------------


def test_root_is_the_owner_meanwhile_without_roots_groups(machine: Machine) -> None:
    """Effective user and group are the folder's owner's, without other groups, and rights are limited to
    theirs."""
    os.setgroups([0, 4])
    try:
        with as_owner(machine.state) as place:
            assert (DAEMON, DAEMON, []) == (os.geteuid(), os.getegid(), os.getgroups())
            assert os.path.samestat(place.stat(), machine_stat := place.stat())
            assert DAEMON == machine_stat.st_uid
            with pytest.raises(PermissionError):
                machine.secret.read_bytes()
        assert [0, 4] == os.getgroups()
    finally:
        os.setgroups([])


def test_roots_own_folder_needs_nobody_else(machine: Machine) -> None:
    """Root stays root in its own folder, also behind a link of root's."""
    (machine.prize / "link").symlink_to(machine.prize)
    for place in (machine.prize, machine.prize / "link" / "new"):
        with as_owner(place) as same:
            assert (0, place) == (os.geteuid(), same)


@pytest.mark.long
def test_root_runs_no_code_from_a_cache_of_the_daemons_user(machine: Machine) -> None:
    """numba's cache in a folder of the daemon's user is not used by root, which says so."""
    cache = machine.state / "numba"
    cache.mkdir()
    give(cache)
    program = (
        "import os, sys; from edged.__main__ import main; sys.argv = ['edged', 'registers']\n"
        "try: main()\nexcept SystemExit: pass\nprint(os.environ.get('NUMBA_CACHE_DIR'), file=sys.stderr)"
    )
    for folder, left in ((cache, "None"), (machine.prize, str(machine.prize))):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
        ran = subprocess.run(
            [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
        )
        assert left == ran.stderr.splitlines()[-1]
        assert (left == "None") == (f"belongs to user {DAEMON}" in ran.stderr)


# --- reading as root --------------------------------------------------------------------------------

READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "a configuration": ("cell.toml", load),
    "chosen cameras": ("rig.cameras.json", lambda path: read_chosen(path.with_name("rig.json"))),
    "a rig": ("rig.json", load_rig),
    "a picture": ("left.png", load_image),
    "a recording": ("cycle.zip", load_snapshot),
    "a drawing": ("part.dxf", read_dxf),
    "a STEP file": ("part.step", read_step),
    "an STL file": ("part.stl", read_stl),
    "a table": ("points.csv", lambda path: read_table(path, "a table")),
    "an archive": ("cell.tar.gz", read),
    "a key": ("shared.key", read_shared_key),
    "the journal": (
        "journal.json",
        lambda path: audit(CONFIG, QUIET, as_json=False, last=0, against=str(path)),
    ),
}


@pytest.mark.parametrize("way", ["link", "link above", "pipe"])
@pytest.mark.parametrize("reader", READERS)
def test_root_reads_nothing_that_a_link_leads_to_and_waits_at_no_pipe(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, reader: str, way: str
) -> None:
    """Links and pipes of the daemon's user are refused anywhere in a path, and no content is shown."""
    name, read_it = READERS[reader]
    monkeypatch.setattr(f"{__name__}.CONFIG", machine.config)
    place = machine.state / name
    if way == "link":
        place.symlink_to(machine.secret)
    elif way == "link above":
        machine.secret.rename(machine.prize / name)
        machine.state.rmdir()
        machine.state.symlink_to(machine.prize)
    else:
        os.mkfifo(place)
    give(machine.above)
    with pytest.raises(UserError) as refused:
        read_it(place)
    assert re.search("link|plain|no such file|no file|Permission denied", str(refused.value))
    assert "root's alone" not in str(refused.value)


def test_root_reads_from_a_pipe_that_it_was_given() -> None:
    """A pipe given to root, such as /dev/stdin, is read."""
    reading, writing = os.pipe()
    os.fchown(reading, DAEMON, DAEMON)
    os.write(writing, CELL.encode())
    os.close(writing)
    try:
        assert "c" == load(Path(f"/proc/self/fd/{reading}")).cell.name
    finally:
        os.close(reading)
