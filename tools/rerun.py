#!/usr/bin/env python3
"""Run every command of a page of the manual again, and write its present output below it.

    tools/rerun.py docs/tutorial/first-part.md
    tools/rerun.py --check docs/tutorial/first-part.md     # changes nothing; 1: a command's output differs

The page is the script. In a block marked `console`,

    $ edged check cell.toml          is run, and its output replaces the text below it
    cell$ edged run cell.toml        is started in another terminal, "cell", and stays there

and a block after a line that ends in "`cell.toml`:" is written to that file. A picture that the page shows
and a command made is put beside the page. All of it happens in a new home folder with a clone of this
checkout, as it is committed, in ~/edged. When a command fails, the page stays as it is.

With --check the checkout and the Python that runs this program are in ~/edged, as they are; nothing is
installed, and no port of this machine is used. These do not count as differences, as they change from one run
or PC to the next: measured numbers, times, identifiers, the width of tables, the findings of `edged doctor`
about the PC, and that a camera was late and was tried again.

The page's own sentences about measured numbers are checked by remarks that no reader sees:

    <!-- held: /stereo rms ([\\d.]+) px/ in 0.001 to 0.01 -->        the last output of a command above
    <!-- held: /x ([\\d.]+)/ - /true ([\\d.]+)/ in 0 to 0.01 -->     the difference of two of them

A paragraph with a measured number and without such a remark is an error, as is a remark that does not hold.
"""

from __future__ import annotations

import argparse
import difflib
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from edged.domain.arrays import Image

ROOT = Path(__file__).resolve().parents[1]
COMMAND = re.compile(r"(?P<terminal>\w*)\$ (?P<command>.+)")
FILE = re.compile(r"`(?P<name>[\w.]+)`:$")
PICTURE = re.compile(r"!\[[^]]*\]\((?P<name>\w+\.png)\)")
FENCE = "```"
CONSOLE = f"{FENCE}console"
DONE = "command-ended-with"
QUIET_S = 10.0
"""Silence after which a program counts as started: the page takes seconds on a busy PC."""
PATIENCE_S = 60.0
"""Limit for the first output of a program in another terminal."""
COLUMNS = "100"
SHOWN_PX = 1280
"""Width of the page's pictures."""
HERE_ONLY = ("PYTHONPATH", "NUMBA_CACHE_DIR")
ALONE = ("unshare", "--map-root-user", "--net", "sh", "-c", 'ip link set lo up && exec "$@"', "sh")
"""Runs a program in a network of its own, where the page's ports are free."""
SETTING_UP = ("==> ", "edged: compiling ", "compiling ")
"""Output that only appears if something had to be installed."""
LATE = "; trying again"
"""End of `edged grab`'s message about cameras that were late, on a busy PC; only the next output counts."""
FINDING = re.compile(r"(?:ok|warn|bad|skip) +(?P<check>[^:]+):.*|\d+ checks, .*| +(?:then|help):.*")
"""Output of `edged doctor`, whose findings depend on the PC; only the names of the checks are the same."""
MASKS = (
    (re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d+"), "TIME"),
    (re.compile(r"(?<=cal-)[0-9a-f]{8}\b|\b[0-9a-f]{8}\b|\b[0-9a-f]{28,32}\b"), "ID"),
    (re.compile(r"(?<=edged-demo-)\w+"), "ID"),
    (re.compile(r"(?<![\d.])[-+]?\d+\.\d+(?!\.?\d)(?: [nµm]?m\b)?|±?\d+ (?:ms|µs|µm)\b"), "MEASURED"),
    (re.compile(r"[─━]+|[^\w\s]*[┌┬┐├┼┤└┴┘│┏┳┓┡╇┩┃][┌┬┐├┼┤└┴┘┏┳┓┡╇┩]*"), " "),
)

HELD = re.compile(
    r"<!-- held: /(?P<first>.+?)/(?: - /(?P<second>.+?)/)? in (?P<low>[\d.]+) to (?P<high>[\d.]+) -->"
)
"""Remark on the sentences of its paragraph: patterns that find their numbers in the output, and the range."""
FIGURE = re.compile(r"\d\.\d{3}|\d (?:ms|µs|µm|px|mm)\b")
"""A figure in a sentence that was measured, or may have been."""


class CommandFailed(Exception):
    """A command of the page that did not end with 0."""


class Machine:
    """A separate home folder with a shell in it; programs of other terminals run beside it."""

    def __init__(self, home: Path, around: Sequence[str] = ()) -> None:
        """Start the shell. around : a program that runs the shell."""
        self._home = home
        kept = {name: value for name, value in os.environ.items() if name not in HERE_ONLY}
        self._shell = subprocess.Popen(
            [*around, "bash", "--norc"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=home,
            env={**kept, "HOME": str(home), "COLUMNS": COLUMNS, "TERM": "dumb", "NO_COLOR": "1"},
        )
        self.run("set -m")  # programs of other terminals become process groups, which end as a whole

    def write(self, name: str, text: str) -> None:
        """Write a file in the shell's folder."""
        self.run(f"cat > {name} <<'END-OF-FILE'\n{text}END-OF-FILE")

    def run(self, command: str) -> list[str]:
        """Run a command; return its output. Raises `CommandFailed`."""
        assert self._shell.stdin is not None and self._shell.stdout is not None
        self._shell.stdin.write(f"{command}\ncode=$?; echo; echo {DONE} $code\n")
        self._shell.stdin.flush()
        said: list[str] = []
        for line in self._shell.stdout:
            if line.startswith(DONE):
                lines = self._plain("".join(said))
                if (code := line.split()[1]) != "0":
                    raise CommandFailed("\n".join([f"$ {command}", *lines, f"it ended with {code}"]))
                return lines
            said.append(line)
        raise CommandFailed(f"$ {command}\nthe shell ended")

    def start(self, terminal: str, command: str) -> list[str]:
        """Start a program; return its output until it is quiet. It runs until the machine is closed."""
        log = self._home / f".{terminal}.log"
        self.run(f"{{ {command}; }} >{log} 2>&1 </dev/null &")
        seen, since = "", time.monotonic()
        while time.monotonic() - since < (QUIET_S if seen else PATIENCE_S):
            time.sleep(0.1)
            if (said := log.read_text()) != seen:
                seen, since = said, time.monotonic()
        if not seen:
            raise CommandFailed(f"{terminal}$ {command}\nit has said nothing for {PATIENCE_S:g} s")
        return self._plain(seen)

    def close(self) -> None:
        """End every program that was started."""
        self.run("for job in $(jobs -p); do kill -- -$job; done; wait")
        self._shell.communicate()

    def picture(self, name: str) -> Image | None:
        """A picture that a command made in the shell's folder, SHOWN_PX wide."""
        folder = Path(self.run("pwd")[0].replace("~", str(self._home), 1))
        picture = cv2.imread(str(folder / name)) if (folder / name).is_file() else None
        if picture is None:
            return None
        height = round(SHOWN_PX * picture.shape[0] / picture.shape[1])
        return cv2.resize(picture, (SHOWN_PX, height), interpolation=cv2.INTER_AREA).astype(np.uint8)

    def _plain(self, text: str) -> list[str]:
        text = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", text).replace(str(self._home), "~")
        lines = [line.rpartition("\r")[2].rstrip() for line in text.split("\n")]
        return "\n".join(lines).strip("\n").split("\n") if any(lines) else []


def rerun(page: Sequence[str], machine: Machine) -> list[str]:
    """The page with the present output of its commands. Raises `CommandFailed`."""
    written: list[str] = []
    fence, body, sentence = "", "", ""
    for line in page:
        if not fence:
            written.append(line)
            fence, body = (line, "") if line.startswith(FENCE) else ("", "")
            sentence = line if line and not fence else sentence
        elif line == FENCE:
            written.append(line)
            if fence != CONSOLE and (file := FILE.search(sentence)):
                machine.write(file["name"], body)
            fence = sentence = ""
        elif fence != CONSOLE:
            written.append(line)
            body += f"{line}\n"
        elif typed := COMMAND.fullmatch(line):
            print(line, file=sys.stderr)
            terminal, command = typed["terminal"], typed["command"]
            said = machine.start(terminal, command) if terminal else machine.run(command)
            written += [line, *said]
    return written


def stand_in(home: Path) -> None:
    """Put this checkout in ~/edged as `tools/setup.sh` would leave it, with the Python that runs this."""
    tools, activate = home / "edged/tools", home / "edged/.venv/bin/activate"
    tools.mkdir(parents=True)
    (tools / "practice.py").symlink_to(ROOT / "tools/practice.py")
    (tools / "demo").write_text('#!/bin/sh\n. ~/edged/.venv/bin/activate\nexec edged demo "$@"\n')
    (tools / "demo").chmod(0o755)
    activate.parent.mkdir(parents=True)
    kernels = os.environ.get("NUMBA_CACHE_DIR", ROOT / ".venv/numba-cache")
    activate.write_text(
        f'export PATH="{Path(sys.executable).parent}:$PATH" PYTHONPATH="{ROOT}" NUMBA_CACHE_DIR="{kernels}"\n'
    )


def differences(page: Sequence[str], now: Sequence[str]) -> list[str]:
    """Commands of a page whose output differs now, each with what is gone (-) and new (+)."""
    return [
        "\n".join([command, *changed])
        for (command, told), (_, said) in zip(_answers(page), _answers(now), strict=True)
        if (changed := [line for line in difflib.ndiff(_words(told), _words(said)) if line[0] in "-+"])
    ]


def untrue(page: Sequence[str]) -> list[str]:
    """Statements of a page that contradict its commands, or have no remark that checks them."""
    found, said, paragraph, fence = list[str](), "", "", ""
    for line in [*page, ""]:
        if line.startswith(FENCE):
            fence = "" if fence else line
        elif fence:
            said += f"{line}\n" if fence == CONSOLE else ""
        elif line:
            paragraph += f"{line}\n"
            if (remark := HELD.fullmatch(line)) and (wrong := _broken(remark, said)):
                found.append(wrong)
        if paragraph and (fence or not line):
            sentences = re.sub(r"`[^`]*`|<!--.*?-->|\]\([^)]*\)|<http[^>]*>", "", paragraph)
            if FIGURE.search(sentences) and not HELD.search(paragraph):
                found.append(f"measured numbers without a remark that holds them:\n{paragraph}")
            paragraph = ""
    return found


def _broken(remark: re.Match[str], said: str) -> str:
    """Why a remark does not hold; "" if it does."""
    numbers = list[float]()
    for pattern in filter(None, (remark["first"], remark["second"])):
        seen = re.findall(pattern, said)
        if not seen:
            return f"{remark[0]}\nno command above says /{pattern}/"
        numbers.append(float(seen[-1]))
    value = numbers[0] if len(numbers) == 1 else abs(numbers[0] - numbers[1])
    return "" if float(remark["low"]) <= value <= float(remark["high"]) else f"{remark[0]}\nit is {value:g}"


def _answers(page: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    fence, command, answer = "", "", list[str]()
    for line in page:
        typed = fence == CONSOLE and COMMAND.fullmatch(line)
        if (typed or line == FENCE) and command:
            yield command, answer
            command = ""
        if typed:
            command, answer = line, []
        elif line.startswith(FENCE):
            fence = "" if fence else line
        else:
            answer.append(line)


def _words(answer: Sequence[str]) -> list[str]:
    """Words to compare: tables by their words, as numbers determine their width."""
    words: list[str] = []
    for line in answer:
        if not line.startswith(SETTING_UP) and not line.endswith(LATE):
            finding = FINDING.fullmatch(line)
            text = (finding["check"] or "") if finding else line
            for what, mask in MASKS:
                text = what.sub(mask, text)
            words += text.split()
    return words


def main() -> int:
    """Return 0 if all commands ran; 1 if one failed, or (--check) if something differs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("page", type=Path)
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    page: Path = options.page
    with tempfile.TemporaryDirectory(prefix="edged-rerun-") as home:
        if options.check:
            stand_in(Path(home))
        else:
            subprocess.run(["git", "clone", "-q", ROOT, Path(home) / "edged"], check=True)
        machine = Machine(Path(home), ALONE if options.check else ())
        try:
            old = page.read_text().splitlines()
            text = rerun(old, machine)
            pictures = {name: machine.picture(name) for name in PICTURE.findall("\n".join(text))}
        except CommandFailed as error:
            print(error, file=sys.stderr)
            return 1
        finally:
            machine.close()
    wrong = untrue(text)
    if options.check:
        changed = [*differences(old, text), *wrong]
        print("\n\n".join(changed))
        return 1 if changed else 0
    page.write_text("\n".join(text) + "\n")
    for name, picture in pictures.items():
        if picture is not None:
            cv2.imwrite(str(page.parent / name), picture)
    print("\n\n".join(wrong), file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
