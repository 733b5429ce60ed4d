"""The behaviour of the service under a real systemd, step by step; runs as root inside a throwaway machine.

PYTHONPATH=tests python -m system.scenario /out/verdicts.json

One verdict per step. The units are those of `systemd/`, with a drop-in that shortens the watchdog's time
and shows this checkout to the sandbox. Standard library only; nothing is imported from edged.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
import urllib.parse
import urllib.request
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

WATCHDOG_S = 10.0
"""Shorter than that of the units; a cycle on a very busy test machine is shorter still."""
PATIENCE_S = 120.0
"""A very busy test machine starts the daemon in this time; a quiet one in three seconds."""
CELL = Path("/etc/edged/cell.toml")
ORIGIN = "http://127.0.0.1:8080"
PASSWORD = "correct horse"


def command(*words: str) -> str:
    """Output of a command that must succeed."""
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(words)}: {done.returncode} {done.stdout} {done.stderr}"
    return done.stdout


def shown(name: str, unit: str = "edged") -> str:
    """A property of a unit."""
    return command("systemctl", "show", "--value", "--property", name, unit).strip()


def journal(unit: str = "edged", *words: str) -> list[dict[str, Any]]:
    """Every journal entry of the unit's processes or about it."""
    command("journalctl", "--sync")
    text = command("journalctl", "--output=json", "--no-pager", "--unit", unit, *words)
    return [json.loads(line) for line in text.splitlines()]


def messages(unit: str = "edged") -> str:
    """The texts of the journal entries."""
    return "\n".join(str(entry.get("MESSAGE", "")) for entry in journal(unit))


def until(look: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
    """Wait for a true value, and return it."""
    deadline_s = time.monotonic() + patience_s
    while not (seen := look()):
        assert time.monotonic() < deadline_s, f"not within {patience_s:g} s: {what}"
        time.sleep(0.05)
    return seen


def page(path: str, port: int = 8080) -> int:
    """Status code of the web server; 0 without an answer."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=2) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return int(error.code)
    except OSError:
        return 0


def registers(address: int, count: int, port: int = 1502) -> tuple[int, ...]:
    """Input registers, by the bytes of the specification; () without an answer."""
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=2) as plc:
            plc.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, address, count))
            answer = plc.recv(9 + 2 * count, socket.MSG_WAITALL)
    except OSError:
        return ()
    return struct.unpack(f">{count}H", answer[9:]) if len(answer) == 9 + 2 * count else ()


def has_result() -> bool:
    """Whether the PLC has a valid result now."""
    status = registers(200, 16)
    return bool(status) and bool(status[1] & 1 << 5)


def main_pid(unit: str = "edged") -> int:
    """The process id of the running daemon."""
    return int(shown("MainPID", unit))


def runs_again(old_pid: int) -> bool:
    """Whether another process is ready, with a result for the PLC."""
    return main_pid() not in (0, old_pid) and shown("ActiveState") == "active" and has_result()


# --- the steps -------------------------------------------------------------------------------------


def make_groups() -> None:
    """Make the groups as tools/install does; others may not read the configuration."""
    command("systemd-sysusers", "edged.conf")
    for file in CELL.parent.glob("*.toml"):
        shutil.chown(file, "root", "edged-config")
        file.chmod(0o640)


def becomes_ready() -> str:
    """`systemctl start` returns when the daemon measures: the page is ready, the PLC gets a result.

    The configuration is not readable for others.
    """
    make_groups()
    start_s = time.monotonic()
    command("systemctl", "start", "edged")
    took_s = time.monotonic() - start_s
    assert (shown("ActiveState"), shown("SubState")) == ("active", "running")
    until(lambda: page("/ready") == 200, "the page says ready")
    until(has_result, "a valid result for the PLC")
    until(lambda: "READY: job flange" in shown("StatusText"), "the status line")
    return f"ready {took_s:.1f} s after systemctl start; status: {shown('StatusText')}"


def is_confined() -> str:
    """It runs as a user of its own with two capabilities and raised priority, and writes in its own
    directories only."""
    pid = main_pid()
    status = dict(line.split(":\t", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    user = int(status["Uid"].split()[0])
    assert 61184 <= user <= 65519, f"dynamic users are 61184-65519, this is {user}"
    net_bind, net_raw = 1 << 10, 1 << 13
    assert int(status["CapEff"], 16) == int(status["CapBnd"], 16) == net_bind | net_raw
    assert (status["NoNewPrivs"], status["Seccomp"]) == ("1", "2")
    assert os.getpriority(os.PRIO_PROCESS, pid) == -10
    written = [until(lambda: list(Path("/var/lib/edged/recordings").rglob("*.zip")), "a recording")[0]]
    written += [Path("/var/cache/edged/numba")]
    assert {path.stat().st_uid for path in written} == {user}
    assert not Path("/etc/edged/numba").exists()
    return f"user {user}, CAP_NET_BIND_SERVICE, CAP_NET_RAW, nice -10; recordings in /var/lib/edged"


PAGE = "edged-page"


def page_has_less() -> str:
    """The page has its own user, no capability, less memory and priority, and a higher OOM score."""
    until(lambda: page("/ready") == 200, "an answer of the page")
    pid = main_pid(PAGE)
    status = dict(line.split(":\t", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    users = {int(number) for number in status["Uid"].split()}
    (user,) = users
    assert user not in (0, Path(f"/proc/{main_pid()}").stat().st_uid)
    capabilities = ("CapEff", "CapAmb", "CapPrm", "CapBnd", "CapInh")
    assert {0} == {int(status[name], 16) for name in capabilities}
    assert (status["NoNewPrivs"], status["Seccomp"]) == ("1", "2")
    assert os.getpriority(os.PRIO_PROCESS, pid) == 5
    assert int(Path(f"/proc/{pid}/oom_score_adj").read_text()) == 500
    most = int(shown("MemoryMax", PAGE))
    assert most < int(shown("MemoryMax"))
    return f"user {user}, no capabilities, nice 5, oom score 500, at most {most >> 20} MiB"


def as_page(*words: str) -> int:
    """Exit code of a command with the rights and the namespaces of the page."""
    pid = main_pid(PAGE)
    status = dict(line.split(":\t", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    user, group, groups = (status[name].split() for name in ("Uid", "Gid", "Groups"))
    rights = (f"--reuid={user[0]}", f"--regid={group[0]}", f"--groups={','.join(groups)}")
    command = ("nsenter", f"--target={pid}", "--mount", "setpriv", *rights, "--bounding-set=-all", *words)
    return subprocess.run(command, capture_output=True, check=False).returncode


def page_writes_its_own_alone() -> str:
    """The page reads what the cell writes, but writes in its own folder alone and cannot signal the cell."""
    recording = str(until(lambda: list(Path("/var/lib/edged/recordings").rglob("*.zip")), "a recording")[0])
    for file in (recording, str(CELL), "/etc/edged/rig.json"):
        assert as_page("cat", file) == 0, file
        assert as_page("sh", "-c", f"echo >>{file}") != 0, file
    for folder in ("/var/lib/edged", "/run/edged", "/etc/edged", "/opt/edged/current", "/var/cache/edged"):
        assert as_page("touch", f"{folder}/made") != 0, folder
    for words in (("touch",), ("rm",)):
        assert as_page(*words, "/var/lib/edged_page/own") == 0
    assert as_page("kill", "-0", str(main_pid())) != 0
    socket_ = Path("/run/edged/page").stat()
    assert (socket_.st_mode & 0o777, socket_.st_uid) == (0o660, Path(f"/proc/{main_pid()}").stat().st_uid)
    return "reads recordings, configuration and rig; writes in /var/lib/edged_page alone"


def strangers_are_no_page() -> str:
    """Another user than the page's is refused at the socket, though in its group."""
    come = "import socket; s = socket.socket(socket.AF_UNIX); s.connect('/run/edged/page'); s.recv(1)"
    command("systemctl", "stop", PAGE)
    group = Path("/run/edged/page").stat().st_gid
    stranger = ("setpriv", "--reuid=12345", f"--regid={group}", "--clear-groups", sys.executable, "-c", come)
    assert subprocess.run(stranger, capture_output=True, timeout=30, check=False).returncode == 0
    until(lambda: "user 12345 came as the page, expected edged_page" in messages(), "the refusal in the log")
    command("systemctl", "start", PAGE)
    until(lambda: page("/ready") == 200, "an answer of the page")
    return "user 12345 was refused by name"


def page_is_back() -> str:
    """After kill -9 of the page it is back beside the same cell."""
    pid, before = main_pid(), main_pid(PAGE)
    start_s = time.monotonic()
    os.kill(before, signal.SIGKILL)
    until(lambda: main_pid(PAGE) not in (0, before) and page("/ready") == 200, "another page")
    took_s = time.monotonic() - start_s
    assert pid == main_pid()
    return f"page {before}, then {main_pid(PAGE)} after {took_s:.1f} s, cell {pid}"


def release_is_handed_over() -> str:
    """An engineer copies a job on the page: the cell writes it, as its own user, and keeps the former files.

    With root's invitation, the page's user who reads the cell's files, the link, and the installing process.
    """
    state, cell, before = Path("/var/lib/edged"), Path(f"/proc/{main_pid()}").stat(), CELL.read_text()
    constants = registers(0, 16)
    for name in ("rig.json", "jobs"):
        command("cp", "-r", f"/etc/edged/{name}", str(state / name))
        command("chown", "-R", f"{cell.st_uid}:{cell.st_gid}", str(state / name))
    text = before.replace('rig = "rig.json"', f'rig = "{state}/rig.json"').replace(
        'jobs = "jobs"', f'jobs = "{state}/jobs"'
    )
    CELL.write_text(text.replace("[web]", "[web]\ncommissioning = true"))
    command("systemctl", "reload", "edged")
    until(lambda: page("/invite") == 200, "the page of invitations")
    program = ("/opt/edged/current/bin/edged", "web", "invite", str(CELL), "Anna")
    code = command(*program).split()[0]
    form = {"code": code, "name": "Anna", "password": PASSWORD, "again": PASSWORD}
    browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    browser.addheaders = [("Origin", ORIGIN)]
    browser.open(f"{ORIGIN}/invite", urllib.parse.urlencode(form).encode(), timeout=30)
    copy = json.dumps({"new_name": "copy", "number": 7, "note": "a copy", "signed": "of this test"})
    asked = urllib.request.Request(
        f"{ORIGIN}/api/v1/jobs/flange/duplicate", copy.encode(), {"Content-Type": "application/json"}
    )
    with browser.open(asked, timeout=PATIENCE_S) as answer:
        assert answer.status == 201
    job = state / "jobs" / "copy" / "job.toml"
    assert job.stat().st_uid == cell.st_uid
    assert (state / "before.tar.gz").stat().st_mode & 0o777 == 0o600
    assert not (state / "installing.tar.gz").exists()
    owner = Path(f"/proc/{main_pid(PAGE)}").stat().st_uid
    kept = {path.name: path.stat() for path in Path("/var/lib/edged_page").rglob("*") if path.is_file()}
    assert {"users.json", "audit.jsonl", "0001.tar.gz", "0002.json"} <= kept.keys(), kept.keys()
    assert {owner} == {about.st_uid for about in kept.values()}, kept
    assert Path("/var/lib/edged_page").resolve().stat().st_mode & 0o777 == 0o700
    assert "Anna has let the cell run by other files: a copy" in messages()
    command("/opt/edged/current/bin/edged", "audit", str(CELL), "--against", "journal")
    CELL.write_text(before)
    command("systemctl", "reload", "edged")
    # systemctl does not wait for the reload: a result may still be one of the files that were handed over
    until(lambda: registers(0, 16) == constants, "the fingerprint of the former files")
    until(has_result, "a result by the former files")
    return f"job copy of user {cell.st_uid}; users, audit and releases of user {owner}"


def reloads() -> str:
    """`systemctl reload` takes another configuration in the same process; one with a mistake changes
    nothing."""
    pid, before = main_pid(), registers(0, 16)
    good = CELL.read_text()
    CELL.write_text(good.replace("period_s = 0.5", "period_s = 0.4"))
    command("systemctl", "reload", "edged")
    until(lambda: registers(0, 16) not in ((), before), "another fingerprint in the PLC's constants")
    until(lambda: shown("SubState") == "running", "the end of the reload")
    after = registers(0, 16)
    CELL.write_text(good.replace("period_s = 0.5", "periods_s = 0.4"))
    command("systemctl", "reload", "edged")
    until(lambda: "reload refused" in shown("StatusText"), "the refusal in the status")
    assert (pid, "active", after) == (main_pid(), shown("ActiveState"), registers(0, 16))
    refused = shown("StatusText")
    CELL.write_text(good)
    command("systemctl", "reload", "edged")
    until(lambda: registers(0, 16) == before, "the first fingerprint again")
    assert main_pid() == pid
    return f"same process, fingerprint taken and given back; mistake: {refused}"


def hung_cycle_is_killed() -> str:
    """A hanging measurement is killed although page and PLC are still served, because queries do not feed
    the watchdog."""
    until(lambda: page("/health") == 200, "an answer of the page, which a reload may have started again")
    pid = main_pid()
    command("kill", "-USR1", str(pid))
    start_s, answered = time.monotonic(), 0
    while main_pid() == pid and shown("ActiveState") == "active":
        answered += page("/health") == 200 and bool(registers(200, 16))
        assert time.monotonic() < start_s + PATIENCE_S, "the watchdog did not bite"
        time.sleep(0.1)
    bitten_s = time.monotonic() - start_s
    until(lambda: runs_again(pid), "a new process with a result")
    assert answered >= 3, f"the servers answered {answered} times only: that was no hang of the cycle alone"
    assert "stand_still" in messages(), "the journal does not say where it hung"
    return f"{answered} queries answered meanwhile, killed after {bitten_s:.1f} s, measures again"


def hung_loop_is_killed() -> str:
    """A stopped event loop is killed by the watchdog."""
    pid = main_pid()
    command("kill", "-USR2", str(pid))
    start_s = time.monotonic()
    until(lambda: runs_again(pid), "a new process with a result")
    assert messages().count("Watchdog timeout") >= 2
    return f"measures again after {time.monotonic() - start_s:.1f} s"


def crash_is_restarted() -> str:
    """After SIGKILL the daemon is restarted."""
    pid, restarts = main_pid(), int(shown("NRestarts"))
    command("kill", "-KILL", str(pid))
    start_s = time.monotonic()
    until(lambda: runs_again(pid), "a new process with a result")
    assert int(shown("NRestarts")) == restarts + 1
    return f"measures again after {time.monotonic() - start_s:.1f} s"


def logs_in_fields() -> str:
    """The daemon's log is in the journal under the unit's name, with fields to search for."""
    told = journal("edged", "EDGED_CELL=service")
    assert {"edged.commands.run", "edged.app.daemon"} <= {entry["LOGGER"] for entry in told}
    assert all({"PRIORITY", "CODE_FILE", "CODE_LINE", "EDGED_VERSION"} <= set(entry) for entry in told)
    refused = [entry for entry in told if "reload refused" in entry["MESSAGE"]]
    assert [("3", True)] == [(entry["PRIORITY"], "\n" in entry["MESSAGE"]) for entry in refused]
    return f"{len(told)} entries found by EDGED_CELL=service"


def stops_cleanly() -> str:
    """After a stop the exit code is 0, the port is free, no process is left, and the page is stopped, too."""
    start_s = time.monotonic()
    command("systemctl", "stop", "edged")
    took_s = time.monotonic() - start_s
    assert (shown("Result"), shown("ExecMainStatus"), shown("ActiveState")) == ("success", "0", "inactive")
    assert registers(0, 1) == ()
    running = command("ps", "-eo", "args").splitlines()
    assert [line for line in running if "edged run" in line or "edged.app.page" in line] == []
    assert shown("ActiveState", PAGE) == "inactive"
    return f"{took_s:.1f} s, exit code 0"


def cells_side_by_side() -> str:
    """Two cells of edged@NAME have their own user, ports and directories, and one can be stopped alone."""
    units = ("edged@left", "edged@right")
    command("systemctl", "start", *units)
    assert [shown("ActiveState", unit) for unit in units] == ["active", "active"]
    until(lambda: all(registers(0, 1, port) for port in (1503, 1504)), "both PLC servers")
    for port in (8081, 8082):
        until(lambda port=port: page("/ready", port) == 200, "both pages")  # type: ignore[misc]  (of this turn)
    pages = ("edged-page@left", "edged-page@right")
    users = {Path(f"/proc/{main_pid(unit)}").stat().st_uid for unit in (*units, *pages)}
    assert len(users) == 4
    command("systemctl", "stop", "edged@left")
    assert shown("ActiveState", "edged@right") == "active"
    assert (registers(0, 1, 1503), len(registers(0, 1, 1504))) == ((), 1)
    command("systemctl", "stop", "edged@right")
    assert [shown("Result", unit) for unit in units] == ["success", "success"]
    return f"users {sorted(users)}"


STEPS: tuple[Callable[[], str], ...] = (
    becomes_ready,
    is_confined,
    page_has_less,
    page_writes_its_own_alone,
    strangers_are_no_page,
    page_is_back,
    release_is_handed_over,
    reloads,
    hung_cycle_is_killed,
    hung_loop_is_killed,
    crash_is_restarted,
    logs_in_fields,
    stops_cleanly,
    cells_side_by_side,
)


def play(path: Path, steps: Sequence[Callable[[], str]] = STEPS) -> int:
    """Run every step in order; returns 0 if all are good. The first bad one ends the run: the others need
    it."""
    verdicts: dict[str, dict[str, Any]] = {}
    for step in steps:
        start_s = time.monotonic()
        try:
            detail, good = step(), True
        except Exception as error:  # noqa: BLE001 - the error is the verdict of the step
            detail, good = f"{type(error).__name__}: {error}", False
        took_s = round(time.monotonic() - start_s, 1)
        verdicts[step.__name__] = {"good": good, "detail": detail, "took_s": took_s}
        print(f"{'ok ' if good else 'BAD'} {took_s:5.1f} s  {step.__name__}: {detail}", flush=True)
        if not good:
            print(
                subprocess.run(
                    ["journalctl", "--no-pager", "-n", "60"], capture_output=True, text=True, check=False
                ).stdout
            )
            break
    path.write_text(json.dumps(verdicts))
    return int(not all(verdict["good"] for verdict in verdicts.values()))


if __name__ == "__main__":
    sys.exit(play(Path(sys.argv[1])))
