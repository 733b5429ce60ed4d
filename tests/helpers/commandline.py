"""Runs the `edged` command line in the test's own process."""

from __future__ import annotations

import sys
from unittest import mock

import pytest

from edged.__main__ import main


def exit_code(*arguments: object) -> int:
    """Run `edged ARGUMENTS` and return its exit code."""
    with mock.patch.object(sys, "argv", ["edged", *map(str, arguments)]), pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


def printed(capsys: pytest.CaptureFixture[str]) -> str:
    """Everything printed so far, joined on one line."""
    captured = capsys.readouterr()
    return " ".join((captured.out + captured.err).split())
