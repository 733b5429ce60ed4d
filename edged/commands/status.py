"""`edged status`: prints the present state of a cell, read from its status page."""

from __future__ import annotations

import getpass
import json
import os
import sys
import urllib.error
import urllib.request
from base64 import b64encode
from typing import Any
from urllib.parse import urlsplit

from rich.console import Console
from rich.table import Table

from edged.errors import UserError

TIMEOUT_S = 5.0
MAX_BYTES = 16 * 1024 * 1024
PASSWORD_VARIABLE = "EDGED_PASSWORD"


def status(url: str, as_json: bool, console: Console) -> int:
    """Print the status; 0 if the cell is ready, else 1. Raises `UserError` if it is not a status page."""
    if urlsplit(url).scheme not in ("http", "https"):
        raise UserError(f"--url {url}: expected http://HOST:PORT or https://HOST:PORT")
    try:
        document = _fetch(url, os.environ.get(PASSWORD_VARIABLE, ""))
    except urllib.error.HTTPError as error:
        if error.code != 401:
            raise UserError(f"{url}: {error.code} {error.reason}") from error
        if not sys.stdin.isatty():
            raise UserError(f"{url}: asks for a password, expected in {PASSWORD_VARIABLE}") from error
        document = _fetch(url, getpass.getpass("password: ", stream=sys.stderr))
    except (urllib.error.URLError, OSError) as error:
        reason = getattr(error, "reason", error)
        reason = getattr(reason, "strerror", None) or reason
        print(f"edged: {url}: not reached: {reason}", file=sys.stderr)
        return 1
    if as_json:
        print(json.dumps(document))
    else:
        _print(document, console)
    return 0 if (document.get("state") or {}).get("ready") else 1


def _fetch(url: str, password: str) -> dict[str, Any]:
    request = urllib.request.Request(url.rstrip("/") + "/status.json")
    if password:
        request.add_header("Authorization", "Basic " + b64encode(f"edged:{password}".encode()).decode())
    with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
        try:
            document = json.loads(answer.read(MAX_BYTES))
        except ValueError as error:
            raise UserError(f"{url}: not the status page of edged") from error
    if not isinstance(document, dict) or "cell" not in document:
        raise UserError(f"{url}: not the status page of edged")
    return document


def _in_words(state: dict[str, Any]) -> str:
    word, setup = str(state.get("state", "starting")), state.get("setup")
    if not setup:
        return word
    reason = str(setup["source"]).lower().replace("_", " ")
    return f"{word}: {setup['by'] or 'unattended' if reason == 'person' else reason}"


def _text(fact: Any) -> str:
    """Return a fact in English: a value, a sentence with its code, or several of them."""
    if isinstance(fact, list):
        return "; ".join(_text(part) for part in fact)
    return str(fact["text"] if isinstance(fact, dict) else fact)


def _print(document: dict[str, Any], console: Console) -> None:
    state, result = document.get("state") or {}, document.get("result")
    table = Table(show_header=False, title=f"cell {document['cell']}", title_justify="left")
    table.add_row("state", state.get("error") or _in_words(state))
    table.add_row("job", f"{state.get('job_number', '')} {state.get('job', '')}")
    if result:
        table.add_row("last cycle", f"{result['cycle']}: {result['status']}")
        for target in result["targets"]:
            pose = target.get("pose_robot", target)
            places = zip("XYZ", pose["position_mm"], pose["sigma_mm"], strict=True)
            table.add_row("position", "  ".join(f"{axis} {mm:.3f} ± {s:.4f} mm" for axis, mm, s in places))
    for group, facts in document.get("facts", {}).items():
        table.add_row(group, ", ".join(f"{name} {_text(value)}" for name, value in facts.items()))
    faults = document.get("faults", [])
    if faults:
        why = ". ".join(_text(sentence) for sentence in faults[0]["why"])
        table.add_row("last fault", f"cycle {faults[0]['cycle']}: {why}")
    console.print(table)
