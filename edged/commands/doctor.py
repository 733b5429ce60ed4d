"""`edged doctor`: finds likely problems, and the command that fixes each."""

from __future__ import annotations

import json
from pathlib import Path

from rich.console import Console

from edged.doctor.examination import examine
from edged.doctor.findings import Check, CheckResult

MARKS = {
    CheckResult.OK: "[green]ok[/]  ",
    CheckResult.WARN: "[yellow]warn[/]",
    CheckResult.BAD: "[red]BAD[/] ",
    CheckResult.SKIP: "[dim]skip[/]",
}


def doctor(config: Path, as_json: bool, console: Console, *, trigger: bool, daemon: int | None = None) -> int:
    """Run and print the checks; 0 if none is bad, else 1. daemon : its process id; None: search for it."""
    checks = []
    for check in examine(config, trigger=trigger, process=daemon):
        checks.append(check)
        if not as_json:
            show(check, console)
    bad = sum(check.verdict is CheckResult.BAD for check in checks)
    if as_json:
        print(json.dumps({"bad": bad, "checks": [check.to_json() for check in checks]}))
    else:
        warned = sum(check.verdict is CheckResult.WARN for check in checks)
        console.print(f"{len(checks)} checks, {bad} bad, {warned} to look at")
    return 1 if bad else 0


def show(check: Check, console: Console) -> None:
    """Print one line for a good check, three for others; never wrapped, so that commands can be copied."""
    console.print(MARKS[check.verdict], end=" ")
    console.print(f"{check.name}: {check.finding}", markup=False, highlight=False, soft_wrap=True)
    if check.verdict in (CheckResult.WARN, CheckResult.BAD):
        console.print(f"       then: {check.consequence}", markup=False, highlight=False, soft_wrap=True)
        console.print(f"       help: {check.remedy}", markup=False, highlight=False, soft_wrap=True)
