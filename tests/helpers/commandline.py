"""`edged`, as it is typed, in the process of a test."""

from __future__ import annotations

import sys
from unittest import mock

import pytest

from edged.__main__ import main


def exit_code(*arguments: object) -> int:
    """Run `edged ARGUMENTS` to its end."""
    with mock.patch.object(sys, "argv", ["edged", *map(str, arguments)]), pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


def printed(capsys: pytest.CaptureFixture[str]) -> str:
    """All that was printed, on one line."""
    captured = capsys.readouterr()
    return " ".join((captured.out + captured.err).split())
