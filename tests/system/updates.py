"""Software releases for a cell under a real systemd, step by step; runs as root in a throwaway machine.

PYTHONPATH=tests python -m system.updates /out/verdicts.json

One verdict per step. Units, versions, cell and repositories exist already; nothing is imported from edged.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from system.scenario import (
    CELL,
    command,
    has_result,
    journal,
    main_pid,
    make_groups,
    messages,
    page,
    play,
    shown,
    until,
)

OLD, GOOD, BLIND = "0.1.0", "edged-0.2.0", "edged-0.3.0"
OPT, GATE = Path("/opt/edged"), Path("/var/lib/private/edged_page/fleet/gate.json")
CUT = Path("/run/cut")
CUTS = ("1", "2", "3", "2", "2+", "1")
"""Exchanges of a file at which the agent dies; "+": after it. They are the link agent, its note, the links
previous and current, and after the restart its note; it does not repeat what is done already."""
SWITCH = "edged-switch.service"
PROBATION_S = 300.0
"""A thousand cycles at most, five a second."""
DONE = ("committed", "refused", "rolled back", "left")


def gate() -> dict[str, Any]:
    """The state of the gate."""
    return dict(json.loads(GATE.read_text())) if GATE.exists() else {"step": "none", "why": ""}


def reached(name: str, *steps: str) -> dict[str, Any]:
    """The gate's note, once it has brought a release to one of these steps."""

    def seen() -> dict[str, Any] | None:
        note = gate()
        return note if note["step"] in steps and note["staged"]["offer"]["name"] == name else None

    try:
        return dict(until(seen, f"{name}: {steps}", PROBATION_S))
    except AssertionError as error:
        raise AssertionError(f"{error}; it is {gate()['step']}: {gate()['why']}") from error


def current() -> str:
    """The version of the link `current`, which is complete."""
    name = (OPT / "current").readlink().name
    assert (OPT / "current" / ".complete").exists()
    return name


def running() -> str:
    """The version of the daemon that measures now, from its journal entries."""
    pid = str(main_pid())
    until(has_result, "a result for the PLC")
    versions = {
        entry["EDGED_VERSION"] for entry in journal() if entry.get("_PID") == pid and "LOGGER" in entry
    }
    assert len(versions) == 1, versions
    return str(versions.pop())


def has_ended(before: str) -> bool:
    """Whether another process of the agent than this one has failed."""
    return shown("ActiveState", SWITCH) == "failed" and shown("ExecMainPID", SWITCH) != before


def measures() -> str:
    """The old version runs the cell and records."""
    make_groups()
    command("systemctl", "enable", "--now", "edged-switch.path", SWITCH)
    command("systemctl", "start", "edged")
    until(lambda: page("/ready") == 200, "the page says ready")
    folder = Path("/var/lib/edged/recordings")
    until(lambda: len([*folder.rglob("*.zip")]) > 40, "40 recordings")
    assert (OLD, OLD) == (current(), running())
    assert "compiling" not in messages() + messages("edged-page")
    return f"{len([*folder.rglob('*.zip')])} recordings"


def kills_leave_one_version() -> str:
    """After SIGKILL of the agent at each of its steps the old or the new version is current, and complete.

    The cell measures on. The next start of the agent, as after a power cut, continues.
    """
    CUT.write_text(CUTS[0])
    start_s = time.monotonic()
    command(f"{OPT}/current/bin/edged", "release", "pull", str(CELL))
    pulled_s = time.monotonic() - start_s
    seen, ended = list[str](), "0"
    for number in range(len(CUTS)):
        # a default of a lambda has no type
        until(lambda before=ended: has_ended(before) or gate()["step"] in DONE, "the agent's end")  # type: ignore[misc]
        ended = shown("ExecMainPID", SWITCH)
        assert gate()["step"] in ("activating", "probation"), gate()["why"]
        assert ("signal", "9") == (shown("Result", SWITCH), shown("ExecMainStatus", SWITCH))
        seen.append(current())
        command(str(OPT / "current/bin/edged"), "--version")
        until(has_result, "a result for the PLC")
        CUT.write_text([*CUTS, ""][number + 1])
        command("systemctl", "start", "--no-block", SWITCH)
    assert [OLD] * 4 + [GOOD] * 2 == seen, seen
    return f"pulled in {pulled_s:.1f} s; current after each kill: {', '.join(seen)}"


def good_one_stays() -> str:
    """The new version is committed after its own cycles, and its daemon runs."""
    note = reached(GOOD, *DONE)
    assert ("committed", GOOD, "0.2.0") == (note["step"], current(), running()), note["why"]
    until(lambda: shown("ActiveState", SWITCH) == "inactive", "the agent's end")
    return str(note["why"])


def blind_one_goes_back() -> str:
    """A version that passes with recorded cycles but finds nothing is rolled back by itself, with the
    reason."""
    command(f"{OPT}/current/bin/edged", "release", "pull", str(CELL), "--from", "/srv/later")
    reached(BLIND, "probation", "rolling back", *DONE)
    assert "0.3.0" in {entry.get("EDGED_VERSION") for entry in journal()}
    start_s = time.monotonic()
    note = reached(BLIND, *DONE)
    assert ("rolled back", GOOD, "0.2.0") == (note["step"], current(), running()), note["why"]
    return f"{note['why']}; back {time.monotonic() - start_s:.1f} s after its probation began"


STEPS: tuple[Callable[[], str], ...] = (
    measures,
    kills_leave_one_version,
    good_one_stays,
    blind_one_goes_back,
)


if __name__ == "__main__":
    sys.exit(play(Path(sys.argv[1]), STEPS))
