"""Generated programs are valid for a public grammar."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from edged.robots.formats import render


def checked(source: str, folder: Path) -> str:
    """The output of rapidchecker for a module, run as a process of its own.

    It knows neither LOCAL before a routine nor ERROR in a function, which are removed before.
    """
    file = folder / "EDGED.mod"
    known = re.sub(r"LOCAL (?=FUNC|PROC)", "", source.replace("\r\n", "\n"))
    file.write_text(re.sub(r"\n  ERROR\n(?:    .*\n|\n)*", "\n", known), encoding="utf-8")
    command = [sys.executable, "-m", "rapidchecker", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode == 0) == ("No RAPID format errors found" in done.stdout), done.stderr
    return "" if done.returncode == 0 else done.stdout


@pytest.mark.long
def test_a_public_grammar_of_rapid_reads_the_module(tmp_path: Path) -> None:
    """The module is valid for a public grammar of RAPID, apart from two words that it lacks; a broken
    module is not."""
    source = render("rapid")
    assert "" == checked(source, tmp_path)
    for whole, broken in (("fields+1;", "fields+;"), ("ENDWHILE", ""), ("left_s", "ELSEIF")):
        assert whole in source
        assert "" != checked(source.replace(whole, broken), tmp_path)
